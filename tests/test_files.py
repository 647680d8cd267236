"""`atomic_write`: whole files or none, and what is left behind when something fails."""

import os
import signal
import stat
import subprocess
import sys
import textwrap
import threading

import pytest

from treelod.files import atomic_write


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_writes_bytes_and_callables(tmp_path):
    path = tmp_path / "a.bin"
    atomic_write(path, b"one")
    assert path.read_bytes() == b"one"
    atomic_write(str(path), lambda file: file.writelines([b"t", b"wo"]))
    assert path.read_bytes() == b"two"
    assert names(tmp_path) == ["a.bin"]


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "a.bin"
    atomic_write(path, b"old")

    def fail(file):
        file.write(b"new")
        msg = "half-way"
        raise LookupError(msg)

    with pytest.raises(LookupError, match="half-way"):
        atomic_write(path, fail)
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["a.bin"]


def test_a_full_disk_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "a.bin"
    atomic_write(path, b"old")

    def no_space(handle):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", no_space)
    with pytest.raises(OSError, match="No space"):
        atomic_write(path, b"new")
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["a.bin"]


def test_missing_folder_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no folder .*missing"):
        atomic_write(tmp_path / "missing" / "a.bin", b"")
    assert names(tmp_path) == []


def test_a_folder_is_not_replaced(tmp_path):
    (tmp_path / "a").mkdir()
    with pytest.raises(IsADirectoryError, match="it is a folder"):
        atomic_write(tmp_path / "a", b"")
    assert names(tmp_path) == ["a"]


def test_permissions_follow_the_old_file_or_the_umask(tmp_path):
    path = tmp_path / "a.bin"
    old = os.umask(0o027)
    try:
        atomic_write(path, b"")
    finally:
        os.umask(old)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    path.chmod(0o600)
    atomic_write(path, b"again")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "real").mkdir()
    link = tmp_path / "link.bin"
    link.symlink_to(tmp_path / "real" / "a.bin")
    atomic_write(link, b"x")
    assert link.is_symlink()
    assert (tmp_path / "real" / "a.bin").read_bytes() == b"x"


def test_readers_never_see_a_part(tmp_path):
    path = tmp_path / "a.bin"
    size = 200_000
    atomic_write(path, b"\0" * size)
    done = threading.Event()

    def write():
        for value in range(60):
            atomic_write(path, bytes([value]) * size)
        done.set()

    writer = threading.Thread(target=write)
    writer.start()
    reads = 0
    while not done.is_set():
        seen = path.read_bytes()
        assert len(seen) == size
        assert seen == seen[:1] * size
        reads += 1
    writer.join()
    assert reads > 10


def test_a_killed_writer_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.bin"
    atomic_write(path, b"old")
    code = """
        import os, signal, sys
        from treelod.files import atomic_write
        def die(file):
            file.write(b"new")
            file.flush()
            os.kill(os.getpid(), signal.SIGKILL)
        atomic_write(sys.argv[1], die)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(code), path], check=False)
    assert done.returncode == -signal.SIGKILL
    assert path.read_bytes() == b"old"
