"""The gate that every kernel call goes through: panics, signals, progress, threads, forks."""

import itertools
import multiprocessing
import os
import subprocess
import sys
import textwrap
import threading
import time
import tomllib
from pathlib import Path

import pytest

import treelod
from treelod import _core

PROJECT = Path(__file__).parents[1]


def test_version_is_cargos():
    with (PROJECT / "Cargo.toml").open("rb") as file:
        assert treelod.__version__ == tomllib.load(file)["package"]["version"]


def test_debug_build_warns():
    # the build under test is a release build or says that it is not; both ways are looked at here
    # in a fresh interpreter, because the warning comes once, at import
    code = """
        import sys, types, warnings
        core = types.ModuleType("treelod._core")
        import treelod._core as real
        core.__dict__.update(real.__dict__)
        core.build_profile = sys.argv[1]
        for name in [name for name in sys.modules if name.startswith("treelod")]:
            del sys.modules[name]
        sys.modules["treelod._core"] = core
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            sys.modules.pop("treelod", None)
            import treelod
        print([warning.category.__name__ for warning in caught])
    """
    for profile, expected in [("debug", "['RuntimeWarning']"), ("release", "[]")]:
        done = _python(code, profile)
        assert done.stdout.strip() == expected, done.stderr


def test_panic_is_an_exception_and_the_pool_lives_on():
    for _ in range(2):
        with pytest.raises(treelod.InternalError, match="panic at index 13"):
            _core._panic_for_test()
    _core._spin_for_test(0.001)


def test_internal_error_is_caught_by_except_exception():
    assert issubclass(treelod.InternalError, Exception)
    assert issubclass(treelod.InternalError, RuntimeError)


def test_interrupt_ends_a_kernel_within_a_second():
    # no pytest plugin's handler in between: a process of its own
    code = """
        import os, signal, threading, time
        from treelod import _core
        threading.Timer(0.2, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
        start = time.monotonic()
        try:
            _core._spin_for_test(30)
        except KeyboardInterrupt:
            print("interrupted", time.monotonic() - start)
        start = time.monotonic()
        _core._spin_for_test(0.05)
        print("ran", time.monotonic() - start)
    """
    first, second = _python(code).stdout.split("\n")[:2]
    word, secs = first.split()
    assert word == "interrupted"
    assert 0.2 <= float(secs) < 1.2
    word, secs = second.split()
    assert word == "ran"
    assert 0.05 <= float(secs) < 1.0


def test_a_signal_handlers_own_exception_arrives():
    code = """
        import os, signal, threading
        from treelod import _core
        def handler(number, frame):
            raise LookupError("mine")
        signal.signal(signal.SIGUSR1, handler)
        threading.Timer(0.1, lambda: os.kill(os.getpid(), signal.SIGUSR1)).start()
        try:
            _core._spin_for_test(30)
        except LookupError as error:
            print(error)
    """
    assert _python(code).stdout == "mine\n"


def test_progress_rises_to_the_total():
    seen = []
    _core._spin_for_test(0.3, progress=lambda done, total: seen.append((done, total)))
    assert len(seen) >= 3
    assert seen == sorted(seen)
    assert seen[-1] == (300, 300)


def test_what_progress_raises_stops_the_kernel():
    def refuse(done, total):
        msg = f"enough of {total}"
        raise LookupError(msg)

    start = time.monotonic()
    with pytest.raises(LookupError, match="enough of 30000"):
        _core._spin_for_test(30, progress=refuse)
    assert time.monotonic() - start < 1


def test_two_python_threads_at_once():
    # each spins on a pool of its own size; one after the other would take 0.8 s
    errors = []

    def spin(threads):
        try:
            _core._spin_for_test(0.4, threads=threads)
        except BaseException as error:
            errors.append(error)

    workers = [threading.Thread(target=spin, args=(count,)) for count in (1, 2)]
    start = time.monotonic()
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(timeout=20)
        assert not worker.is_alive()
    assert errors == []
    assert time.monotonic() - start < 0.75


def test_python_runs_while_a_kernel_does():
    ticks = []
    worker = threading.Thread(target=_core._spin_for_test, args=(0.3,))
    worker.start()
    while worker.is_alive():
        ticks.append(time.monotonic())
        time.sleep(0.005)
    # a kernel that held the interpreter would leave a gap as long as itself
    assert max(b - a for a, b in itertools.pairwise(ticks)) < 0.2


@pytest.mark.parametrize("threads", [0, 1025])
def test_thread_count_is_checked(threads):
    with pytest.raises(ValueError, match=rf"threads must be in \[1, 1024\], got {threads}"):
        _core._spin_for_test(0, threads=threads)


def test_thread_variable_is_read_and_checked():
    code = """
        from treelod import _core
        try:
            _core._spin_for_test(0)
        except ValueError as error:
            print(error)
    """
    done = _python(code, env={"TREELOD_NUM_THREADS": "many"})
    assert done.stdout == 'TREELOD_NUM_THREADS: must be in [1, 1024], got "many"\n'
    assert _python(code, env={"TREELOD_NUM_THREADS": "2"}).stdout == ""
    assert _python(code, env={"TREELOD_NUM_THREADS": " "}).stdout == "", "as if unset"


def _call_in_child(queue):
    try:
        _core._spin_for_test(0.001)
    except BaseException as error:
        queue.put(type(error).__name__)
    else:
        queue.put("ran")


# the parent has threads: that a fork is then dangerous is the point of the test
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
@pytest.mark.parametrize(
    ("method", "expected"), [("fork", "ForkedError"), ("spawn", "ran"), ("forkserver", "ran")]
)
def test_child_process(method, expected):
    _core._spin_for_test(0.001)
    context = multiprocessing.get_context(method)
    queue = context.SimpleQueue()
    child = context.Process(target=_call_in_child, args=(queue,))
    child.start()
    child.join(timeout=10)
    if child.is_alive():
        child.kill()
        child.join()
        pytest.fail("the child hangs")
    assert queue.get() == expected


def test_fork_before_the_first_call_is_fine():
    code = """
        import os
        from treelod import _core
        child = os.fork()
        if child == 0:
            _core._spin_for_test(0.001)
            os._exit(7)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
    """
    assert _python(code).stdout == "7\n"


def _python(code, *arguments, env=None):
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), *arguments],
        capture_output=True,
        text=True,
        timeout=20,
        check=True,
        env={**os.environ, **(env or {})},
    )
