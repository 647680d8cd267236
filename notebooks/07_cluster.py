# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # 7 A sweep on a cluster
#
# A sweep of five techniques with a few parameters each, four plants and fifty cameras has
# thousands of cells. None depends on another, so they can be shared among processes, and among
# machines. This notebook does so with [dask](https://distributed.dask.org), kills a worker in the
# middle, and shows that nothing is lost.
#
# It needs the extra `cluster`: `pip install 'treelod[cluster]'`. On one machine `tl.sweep(...,
# executor=2)` does the same with two processes and no cluster at all.

# %%
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pandas as pd
from distributed import Client

import treelod as tl

# %% tags=["parameters"]
small = os.environ.get("TREELOD_NOTEBOOK_SCALE") == "small"

leaf_count = 1350 if small else 3000
slice_counts = list(range(1, 5 if small else 9))
cluster_counts = [8, 16] if small else [8, 16, 32, 64]
azimuth_count = 3 if small else 6
picture_size = (48, 36) if small else (160, 120)

# %% [markdown]
# ## A scheduler and two workers
#
# A dask cluster is a scheduler, which keeps the list of what is to be done, and workers, which do
# it. Each is a process of its own, started from the command line. On one machine as here all of
# them listen on its loopback address only. On several, give each its own address, and read dask's
# pages on TLS first: whoever reaches a port of a cluster can run code there. Scheduler and workers
# need the same versions of everything as this notebook.

# %%
scratch = tempfile.TemporaryDirectory()
folder = Path(scratch.name)
processes = {}


def start(name, role, *arguments):
    """Start `dask scheduler` or `dask worker`, on loopback alone."""
    common = ("--host", "127.0.0.1", "--dashboard-address", "127.0.0.1:0")
    processes[name] = subprocess.Popen(
        [sys.executable, "-m", "dask", role, *arguments, *common],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def start_worker(name):
    """Start a worker of one thread; without a nanny, which would start it again when it dies."""
    options = ("--nthreads", "1", "--no-nanny", "--local-directory", name, "--death-timeout", "60")
    start(name, "worker", address, *options)


# forgotten processes end by themselves
options = ("--port", "0", "--scheduler-file", "scheduler.json", "--idle-timeout", "600")
start("scheduler", "scheduler", *options)
scheduler_file = folder / "scheduler.json"
while not (scheduler_file.exists() and scheduler_file.read_text().strip()):
    assert processes["scheduler"].poll() is None, "the scheduler has ended"
    time.sleep(0.1)
address = json.loads(scheduler_file.read_text())["address"]

start_worker("worker 1")
start_worker("worker 2")
client = Client(address, timeout=60)
client.wait_for_workers(2, timeout=60)
print(f"{len(client.nthreads())} workers")

# %% [markdown]
# ## A sweep
#
# The only thing that changes is `executor=client`. The plant travels to each worker once; a
# representation is built where it is drawn. Workers send rows back, and this process alone writes
# them to the store, so the machines need not share a disk.
#
# So that something happens, `progress` is a function here. When a quarter of the cells is done it
# kills worker 1 the hard way, which loses whatever it was about to send, and starts another one.

# %%
plant = tl.grow_plant("grove", seed=1, leaf_count=leaf_count)
grid = {
    "slicings": {"slice_count": slice_counts, "resolution": 64},
    "leaf_clusters": {"cluster_count": cluster_counts, "resolution": 64, "samples": 4},
}
settings = {"reference_samples": 16, "timing": "none"}


def cameras(plant):
    """Place cameras around the plant, near and far."""
    return [
        camera
        for distance in (3, 10)
        for camera in tl.orbit(plant, azimuth_count, 5, distance, picture_size)
    ]


events = []


def watch(stage, done, total):
    """Kill a worker when a quarter of the cells is done, and start another one."""
    if done >= total // 4 and not events:
        processes["worker 1"].kill()
        start_worker("worker 3")
        events.append(f"worker 1 was killed at {done} of {total} cells")
    elif done >= total // 2 and len(events) == 1:
        client.wait_for_workers(2, timeout=60)
        events.append("worker 3 has joined")


store = folder / "rows"
table = tl.sweep(plant, grid, cameras, store=store, executor=client, progress=watch, **settings)
print(*events, sep="\n")

# %% [markdown]
# ## Nothing is lost
#
# All rows are there, each once:

# %%
expected = (1 + len(slice_counts) + len(cluster_counts)) * 2 * azimuth_count
print(f"{len(table)} rows of {expected}, {table['key'].nunique()} different ones")
print(f"failed: {table.attrs['failed']}")
assert len(table) == table["key"].nunique() == expected

# %% [markdown]
# Who did what? Cells that worker 1 had begun when it died are not among its own: others did them
# again. Worker 3, which joined late, was brought the plant too.

# %%
name_of = {process.pid: name for name, process in processes.items()}
work = table.attrs["work"]["workers"]
pd.DataFrame({name_of[int(key.rpartition(":")[2])]: counts for key, counts in work.items()}).T[
    ["cells", "builds", "plants"]
].sort_index()

# %% [markdown]
# ## The same numbers
#
# Errors do not depend on who computes them, on how many threads, in which order. To show it, this
# process does the whole sweep again by itself, in a store of its own:

# %%
alone = tl.sweep(plant, grid, cameras, store=folder / "alone", **settings)
errors = [
    "flip",
    "rmse",
    "psnr",
    "max_error",
    "ssim",
    "coverage_bias",
    "coverage_error",
    "fragments",
]
pd.testing.assert_frame_equal(
    pd.DataFrame(table)[["label", "view", *errors]],
    pd.DataFrame(alone)[["label", "view", *errors]],
    check_exact=True,
)
print(f"{len(alone)} rows have the same errors, to the last bit")

# %% [markdown]
# ## Go on where it stopped
#
# The store knows what it has. A larger grid computes only what it adds; here one more slice count,
# on workers 2 and 3:

# %%
grid["slicings"]["slice_count"] = [*slice_counts, 12]
larger = tl.sweep(plant, grid, cameras, store=store, executor=client, **settings)
done = sum(counts["cells"] for counts in larger.attrs["work"]["workers"].values())
print(f"{larger.attrs['work']['stored']} rows were there, {done} were computed")

# %%
tl.plots.memory_against_error(larger)

# %% [markdown]
# ## What to time on a cluster
#
# Here `timing="none"`: errors are the same wherever they are computed, times are not. Cells that
# run side by side slow one another down. `timing="exclusive"` computes all errors in parallel
# first, and then times one cell after the other with nothing else of the sweep running.
#
# ## Tidy up

# %%
client.close()
for process in processes.values():
    process.kill()
    process.wait(30)
scratch.cleanup()

# %% [markdown]
# ## What next
#
# - On machines of yours: `dask scheduler` on one of them, `dask worker tcp://HOST:8786 --nthreads
#   1` on all, and the scheduler's address above. Or `treelod sweep grid.toml -o rows --scheduler
#   tcp://HOST:8786` from the command line.
# - Kill this notebook in the middle of a long sweep, start it again, and watch it go on.
# - `tl.load_results(store)` reads a store from anywhere, while a sweep is still writing to it too.
