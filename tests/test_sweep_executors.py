"""Do all who can work give the same rows, and is nothing lost when they die?"""

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import textwrap
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import psutil
import pytest

import made_sweeps
import treelod as tl
from made_sweeps import GRID, OTHER, PLANT, QUICK, cameras, errors_of
from treelod.errors import StoreError, SweepError, SweepWarning
from treelod.provenance import core_count
from treelod.sweeps import executors, worker
from treelod.sweeps.store import Store

HERE = Path(__file__).parent


def run(folder, plants=PLANT, grid=GRID, views=cameras, **settings):
    return tl.sweep(plants, grid, views, store=folder, **{**QUICK, **settings})


def forkserver(count, *initializer):
    start, arguments = (initializer[0], initializer[1:]) if initializer else (None, ())
    context = multiprocessing.get_context("forkserver")
    return ProcessPoolExecutor(count, context, initializer=start, initargs=arguments)


@pytest.fixture(scope="module")
def serial(tmp_path_factory):
    """Errors of the sweep that every executor runs, by this process alone."""
    both = {"crown": PLANT, "shrub": OTHER}
    return errors_of(run(tmp_path_factory.mktemp("serial") / "rows", both, timing="none"))


# Processes and threads of this machine


def test_own_processes_give_the_same_bits_and_read_each_plant_once(tmp_path, serial):
    both = {"crown": PLANT, "shrub": OTHER}
    table = run(tmp_path / "rows", both, executor=2)
    assert errors_of(table) == serial
    work = table.attrs["work"]["workers"]
    assert 1 <= len(work) <= 2
    assert sum(counts["cells"] for counts in work.values()) == 42
    assert all(counts["plants"] <= 2 for counts in work.values()), work
    # built once, but for those at the end that two share, and two full meshes in each
    assert sum(counts["builds"] for counts in work.values()) <= 14 + 2 * 7, work
    assert set(table["threads"]) == {max(1, core_count() // 2)}
    assert not multiprocessing.active_children()


def test_a_pool_of_the_callers_own_is_used_and_left_alone(tmp_path, serial):
    with forkserver(2) as pool:
        table = run(tmp_path / "rows", [PLANT, OTHER], executor=pool, timing="none")
        assert errors_of(table) == serial
        # the same processes go on with what they hold
        again = run(tmp_path / "again", [PLANT, OTHER], executor=pool, timing="none")
        assert errors_of(again) == serial
        assert all("plants" not in work for work in again.attrs["work"]["workers"].values())
        assert pool.submit(abs, -1).result() == 1


def test_threads_give_the_same_bits(tmp_path, serial):
    with ThreadPoolExecutor(3) as pool:
        table = run(tmp_path / "rows", [PLANT, OTHER], executor=pool, timing="none")
    assert errors_of(table) == serial
    ((_, work),) = table.attrs["work"]["workers"].items()
    # caches are shared: each is made once, whatever the threads want at the same time
    assert work == {"builds": 14, "references": 6, "cells": 42}
    assert not worker._held, "the driver's plants are let go"


def test_sweeps_of_one_plant_in_one_process_let_each_other_live(tmp_path, serial):
    inner = []

    def progress(stage, done, total):
        del total
        if stage == "cells" and done == 4 and not inner:
            # it begins, ends and lets go of the plant while the outer one goes on
            inner.append(run(tmp_path / "inner", grid={}, views=views, timing="none"))

    views = cameras(PLANT)
    table = run(tmp_path / "rows", timing="none", progress=progress)
    assert len(inner[0]) == 3
    assert errors_of(table) == {k: v for k, v in serial.items() if k[0] == "crown"}
    ((_, work),) = table.attrs["work"]["workers"].items()
    assert work["builds"] == 7, "the other sweep dropped nothing that is still needed"
    assert not worker._held
    assert not worker._holders


def test_a_plant_is_kept_until_the_last_who_brought_it_lets_it_go():
    other = Kept(40)
    for digest, holder in (("a" * 64, "one"), ("a" * 64, "two"), ("b" * 64, "two")):
        worker.hold_plant(digest, PLANT, holder)
    for key in ("a" * 64, "b" * 64):
        worker._plants.get(key, other.make)
        worker._built.get((key, "full_mesh"), other.make)
    try:
        worker.forget("a" * 64, "one")
        assert set(worker._held) == {"a" * 64, "b" * 64}
        worker.forget("a" * 64, "two")
        assert set(worker._held) == {"b" * 64}
        assert [*worker._plants._kept] == ["b" * 64]
        assert [*worker._built._kept] == [("b" * 64, "full_mesh")], "of another plant: kept"
        worker._plants.get("b" * 64, other.make)
        assert other.count == 4
        assert not worker._plants._making, "locks do not pile up"
    finally:
        worker.forget("b" * 64, "two")
    assert not worker._held


class Kept:
    def __init__(self, size):
        self.size, self.count = size, 0

    def make(self):
        self.count += 1
        return self.count, self.size


def test_threads_that_are_asked_for_are_used(tmp_path):
    table = run(tmp_path / "rows", grid={}, threads=1)
    assert set(table["threads"]) == {1}
    crew = executors.crew_of(2, Store.open(tmp_path / "rows", make=True))
    assert crew.threads(is_alone=False) == max(1, core_count() // 2)
    assert crew.threads(is_alone=True) == core_count()
    assert executors.crew_of(None, Store.open(tmp_path / "rows", make=True)).width == 1


def test_cells_timed_alone_have_all_cores(tmp_path):
    table = run(tmp_path / "rows", grid={}, executor=2, timing="exclusive")
    assert set(table["threads"]) == {core_count()}
    assert table["frame_millis"].notna().all()


# Workers that die


def test_a_pool_that_breaks_is_made_again_and_nothing_is_lost(tmp_path, serial):
    made = []

    def make():
        made.append(1)
        marker = str(tmp_path / "died")
        return forkserver(2, made_sweeps.kill_once, marker)

    table = run(tmp_path / "rows", [PLANT, OTHER], executor=make, timing="none")
    assert (tmp_path / "died").exists()
    assert len(made) == 2
    assert errors_of(table) == serial


POISON = {"slicings": {"slice_count": [1, 2, 3], "resolution": 8}}


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_cell_that_kills_its_worker_is_given_up(tmp_path):
    made = []

    def make():
        made.append(1)
        return forkserver(2, made_sweeps.kill_on_two_slices)

    with pytest.warns(SweepWarning, match=r"4 of 16 cells failed.*it killed its worker 2 times"):
        table = run(
            tmp_path / "rows",
            grid=POISON,
            views=cameras(PLANT, 4),
            executor=make,
            retries=1,
            on_error="record",
        )
    assert sorted(set(table["param_slice_count"].dropna())) == [1, 3]
    assert len(table) == 12
    assert [loss["view"] for loss in table.attrs["failed"]] == [0, 1, 2, 3]
    # the first time with others, perhaps twice, and then twice for each of two cells, alone; the
    # other two are given up with them
    assert 1 + 1 + 2 * 2 <= len(made) <= 1 + 2 + 2 * 2


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_broken_pool_that_nobody_can_make_again_is_an_error(tmp_path):
    with (
        forkserver(1, made_sweeps.kill_on_two_slices) as pool,
        pytest.raises(SweepError, match=r"the executor is broken.*a function that makes one"),
    ):
        run(tmp_path / "rows", grid=POISON, executor=pool)
    # what was done before is kept
    assert {"full_mesh"} <= set(tl.load_results(tmp_path / "rows")["label"])


def test_workers_that_cannot_start_are_not_the_cells_fault(tmp_path):
    pools = []

    def make():
        pools.append(forkserver(1, os._exit, 1))
        return pools[-1]

    with pytest.raises(SweepError, match=r"workers die before they work .*if __name__ == "):
        run(tmp_path / "rows", grid={}, executor=make, timing="none", on_error="record")
    assert len(pools) == 2
    assert len(tl.load_results(tmp_path / "rows")) == 0


def test_a_number_of_workers_may_be_one_of_numpy(tmp_path):
    assert executors.crew_of(np.int64(1), Store(tmp_path)).width == 1


def test_workers_of_other_code_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("treelod.sweeps.driver.kernel_version", lambda: "0" * 32)
    with pytest.raises(StoreError, match=r"runs another version of treelod.*same environment"):
        run(tmp_path / "rows", grid={}, executor=1)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_plant_that_was_changed_on_its_way_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(type(PLANT), "to_bytes", lambda _: original(OTHER))
    with pytest.raises(StoreError, match=f"it is {OTHER.digest[:12]}, not {PLANT.digest[:12]}"):
        run(tmp_path / "rows", grid={}, executor=1)


original = type(PLANT).to_bytes

SWEEP = """
    import sys
    import treelod as tl
    from made_sweeps import PLANT, QUICK, cameras

    if __name__ == "__main__":
        grid = {"slicings": {"slice_count": [*range(1, 13)], "resolution": 32}}
        views = cameras(PLANT, 6)
        tl.sweep(PLANT, grid, views, store=sys.argv[1], executor=2, **QUICK)
"""


def start(script, folder):
    """Start the sweep above in a session of its own."""
    script.write_text(textwrap.dedent(SWEEP), encoding="utf-8")
    path = os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")])
    # a file: whoever holds a pipe open keeps its reader waiting
    with (script.parent / "stderr.txt").open("w", encoding="utf-8") as errors:
        return subprocess.Popen(
            [sys.executable, str(script), str(folder)],
            env={**os.environ, "PYTHONPATH": path},
            start_new_session=True,
            stderr=errors,
        )


def rows(folder):
    return len([*(folder / "cells").glob("*.parquet")]) if folder.exists() else 0


def wait_for(condition, child=None, secs=60.0):
    end = time.monotonic() + secs
    while not condition():
        assert time.monotonic() < end, "it took too long"
        assert child is None or child.poll() is None, "it ended too early"
        time.sleep(0.02)


def family(pid):
    """A process with all that it started, forkserver and pool among them."""
    parent = psutil.Process(pid)
    return [parent, *parent.children(recursive=True)]


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_sweep_that_is_killed_again_and_again_ends_with_every_row_once(tmp_path):
    folder = tmp_path / "rows"
    counts = []
    for _ in range(4):
        before = rows(folder)
        child = start(tmp_path / "sweep.py", folder)
        # as soon as it has got a little farther
        wait_for(lambda before=before: rows(folder) >= before + 5, child)
        processes = family(child.pid)
        assert len(processes) >= 3, "driver, forkserver and workers"
        os.killpg(child.pid, signal.SIGKILL)
        child.wait(10)
        psutil.wait_procs(processes, timeout=10)
        counts.append(rows(folder))
    assert counts == sorted(counts)
    assert counts[-1] < 78, "it was never allowed to end"
    grid = {"slicings": {"slice_count": [*range(1, 13)], "resolution": 32}}
    table = run(folder, grid=grid, views=cameras(PLANT, 6))
    assert table.attrs["work"]["stored"] == counts[-1], "nothing is computed twice or torn"
    assert len(table) == 78
    assert table["key"].is_unique
    assert len(tl.load_results(folder)) == 78
    alone = run(tmp_path / "alone", grid=grid, views=cameras(PLANT, 6), timing="none")
    assert errors_of(table) == errors_of(alone)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_workers_end_when_their_driver_is_killed(tmp_path):
    child = start(tmp_path / "sweep.py", tmp_path / "rows")
    wait_for(lambda: rows(tmp_path / "rows") >= 3, child)
    others = family(child.pid)[1:]
    assert len(others) >= 2
    os.kill(child.pid, signal.SIGKILL)
    child.wait(10)
    _, alive = psutil.wait_procs(others, timeout=10)
    for process in alive:
        process.kill()
    assert alive == []


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_ctrl_c_ends_driver_and_workers_at_once_and_quietly(tmp_path):
    child = start(tmp_path / "sweep.py", tmp_path / "rows")
    wait_for(lambda: rows(tmp_path / "rows") >= 3, child)
    others = family(child.pid)[1:]
    begin = time.monotonic()
    # to all of them, as a terminal sends it
    os.killpg(child.pid, signal.SIGINT)
    child.wait(30)
    assert time.monotonic() - begin < 5, "within a second, and slack for a loaded machine"
    text = (tmp_path / "stderr.txt").read_text()
    assert text.count("KeyboardInterrupt") == 1, text
    assert child.returncode != 0
    _, alive = psutil.wait_procs(others, timeout=10)
    assert alive == []


# dask


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """A scheduler and two workers, each a process of its own, on loopback only."""
    with Cluster(tmp_path_factory.mktemp("dask")) as made:
        made.add_workers(2)
        yield made


class Cluster:
    """Processes of `dask scheduler` and `dask worker`."""

    def __init__(self, folder, **environment):
        self.folder = folder
        self.environment = environment
        self.workers = []
        self.processes = []

    def __enter__(self):
        file = self.folder / "scheduler.json"
        self.scheduler = self.begin(
            "scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file)
        )
        wait_for(lambda: file.exists() and file.read_text().strip(), self.scheduler)
        self.address = json.loads(file.read_text())["address"]
        return self

    def begin(self, role, *arguments):
        path = os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")])
        process = subprocess.Popen(
            [sys.executable, "-m", "dask", role, *arguments, "--dashboard-address", "127.0.0.1:0"],
            env={**os.environ, "PYTHONPATH": path, **self.environment},
            cwd=self.folder,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self.processes.append(process)
        return process

    def add_workers(self, count, *arguments):
        options = ("--host", "127.0.0.1", "--nthreads", "1", "--no-nanny", *arguments)
        for _ in range(count):
            name = f"w{len(self.processes)}"
            folder = self.folder / name
            folder.mkdir()
            self.workers.append(
                self.begin(
                    "worker",
                    self.address,
                    *options,
                    "--local-directory",
                    str(folder),
                )
            )

    def client(self):
        from distributed import Client

        client = Client(self.address, timeout=30)
        client.wait_for_workers(1, timeout=60)
        return client

    def __exit__(self, *_):
        for process in self.processes:
            process.kill()
            process.wait(20)


def test_a_cluster_gives_the_same_bits_and_is_sent_each_plant_once(cluster, tmp_path, serial):
    with cluster.client() as client:
        client.wait_for_workers(2, timeout=60)
        table = run(
            tmp_path / "rows",
            [PLANT, OTHER],
            executor=client.get_executor(retries=2),
            timing="none",
        )
        assert errors_of(table) == serial
        work = table.attrs["work"]["workers"]
        assert len(work) == 2, "both worked"
        assert all(counts["plants"] == 2 for counts in work.values()), work
        assert set(table["threads"]) == {1}, "those of a worker"
        # a client does as well, and nothing is left on the workers
        again = run(tmp_path / "again", grid={}, executor=client)
        assert len(again) == 3
        held = client.run(lambda: len(sys.modules["treelod.sweeps.worker"]._held))
        assert set(held.values()) == {0}


def test_two_sweeps_of_one_plant_share_a_cluster(cluster, tmp_path, serial):
    with cluster.client() as client, ThreadPoolExecutor(2) as pool:
        tables = [
            # as `pure` as dask makes it where nobody says otherwise
            pool.submit(run, tmp_path / str(i), timing="none", executor=client.get_executor())
            for i in range(2)
        ]
        for future in tables:
            crown = {k: v for k, v in serial.items() if k[0] == "crown"}
            assert errors_of(future.result(100)) == crown
        held = client.run(lambda: len(sys.modules["treelod.sweeps.worker"]._held))
        assert set(held.values()) == {0}


def test_a_job_of_a_cluster_is_not_replayed_from_memory(cluster, tmp_path, monkeypatch):
    with cluster.client() as client:
        crew = executors.crew_of(client.get_executor(), Store.open(tmp_path / "rows", make=True))
        monkeypatch.setattr(worker, "run", made_sweeps.count_calls)
        futures = [crew.submit(7) for _ in range(4)]
        counts = [future.result(60) for future in futures]
    assert sorted(counts) != [1] * 4, "the same answer is kept"
    # closed twice: nothing that is no more there hides another error
    crew._brought.append("0" * 64)
    with cluster.client() as client:
        executors.crew_of(client, Store.open(tmp_path / "rows", make=True)).close(at_once=True)
        crew.executor = client.get_executor()
        crew.close(at_once=True)


def test_a_cluster_listens_on_loopback_only(cluster):
    with cluster.client() as client:
        client.wait_for_workers(2, timeout=60)
        listening = [
            connection.laddr.ip
            for process in cluster.processes
            for connection in psutil.Process(process.pid).net_connections()
            if connection.status == psutil.CONN_LISTEN
        ]
    assert len(listening) >= 3
    assert set(listening) == {"127.0.0.1"}


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_worker_of_a_cluster_that_is_killed_loses_nothing(tmp_path):
    grid = {"slicings": {"slice_count": [*range(1, 13)], "resolution": 32}}
    views = cameras(PLANT, 6)
    with Cluster(tmp_path) as cluster:
        cluster.add_workers(2)
        with cluster.client() as client:
            client.wait_for_workers(2, timeout=60)
            killed = []

            def progress(stage, done, total):
                assert (stage, total) == ("cells", 78)
                if done >= 20 and not killed:
                    killed.append(done)
                    os.kill(cluster.workers[0].pid, signal.SIGKILL)
                    # one that joins late is brought the plant too
                    cluster.add_workers(1)
                if done >= 25 and len(killed) == 1:
                    client.wait_for_workers(2, timeout=60)
                    killed.append(done)

            table = run(
                tmp_path / "rows", grid=grid, views=views, executor=client, progress=progress
            )
    assert len(killed) == 2
    assert len(table) == 78
    assert table["key"].is_unique
    work = table.attrs["work"]["workers"]
    assert len(work) == 3, work
    assert all(counts["plants"] == 1 for counts in work.values()), work
    alone = run(tmp_path / "alone", grid=grid, views=views, timing="none")
    assert errors_of(table) == errors_of(alone)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_cell_that_kills_workers_of_a_cluster_is_given_up(tmp_path):
    # a job whose worker has died once is lost at once, not after the fourth worker
    with Cluster(tmp_path, DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES="0") as cluster:
        # it dies with others, then alone, and one is left for them
        cluster.add_workers(3, "--preload", str(HERE / "poison_preload.py"))
        with cluster.client() as client:
            client.wait_for_workers(3, timeout=100)
            grid = {"slicings": {"slice_count": [1, 2], "resolution": 8}}
            with pytest.warns(SweepWarning, match="1 of 3 cells failed.*it killed its worker"):
                table = run(
                    tmp_path / "rows",
                    grid=grid,
                    views=cameras(PLANT, 1),
                    executor=client,
                    retries=0,
                    on_error="record",
                )
    assert len(table) == 2


def test_a_cluster_without_treelod_is_told_apart_from_a_failure(tmp_path):
    from treelod.sweeps.schedule import _fatal

    text = "Error during deserialization of the task graph. This frequently occurs if the"
    error = _fatal(RuntimeError(text))
    assert isinstance(error, SweepError)
    assert "driver, scheduler and workers need the same environment" in str(error)
    assert "same environment" in str(_fatal(ModuleNotFoundError("No module named 'treelod'")))
    assert "the cluster is gone" in str(_fatal(None))
    assert "the executor failed" in str(_fatal(OSError("x")))
