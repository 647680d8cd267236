"""
Where rows of a sweep are kept: one Parquet file a cell, written whole or not at all.

    DIR/store.json          says that this is a store, and of which version
    DIR/cells/KEY.parquet   one row; KEY names everything that decides it
    DIR/plants/DIGEST.npz   plants on their way to workers; may be deleted

A file that cannot be read, or that is none of ours, is reported and skipped. It never spoils the
rest, and if its row is wanted it is computed again.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.parquet as pq

from treelod.errors import StoreError, SweepWarning
from treelod.files import atomic_write
from treelod.sweeps.cells import STORE_VERSION, key_of

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator

__all__ = ["Shard", "Store"]

MAGIC = "treelod sweep"

_HEADER = b"treelod"
"""Name of our entry in a file's metadata."""

_KEY = re.compile(r"[0-9a-f]{64}")

_STALE_SECS = 3600.0
"""Age from which a temporary file belongs to a writer that was killed."""

_TYPES = {bool: pa.bool_(), int: pa.int64(), float: pa.float64(), str: pa.string()}

_NULL_TYPES = {
    **dict.fromkeys(("adapter", "driver", "git_commit", "plant_sha256"), pa.string()),
    "seed": pa.int64(),
}
"""Types of columns that may be without a value, where they are no numbers with a fraction."""


_IDENTITY = {"plant", "technique", "params", "camera", "timing"}
_COLUMNS = {"plant", "params", "view", "key", "frame_millis", "date", "overdraw", "adapter"}
"""What tables are made by."""


class Shard:
    """
    One row of a store, with what decides it.

    Attributes
    ----------
    row : dict of str to object
        Columns.
    identity : dict of str to object
        Everything that decides the row.
    given : list of str
        Parameters that the grid named.
    """

    def __init__(self, row: dict[str, Any], identity: dict[str, Any], given: list[str]) -> None:
        self.row = row
        self.identity = identity
        self.given = given

    @property
    def is_timed(self) -> bool:
        """Whether it has the times that were asked for."""
        wanted = self.identity["timing"]["mode"] != "none"
        return not wanted or self.row["frame_millis"] is not None


class Store:
    """
    A folder of rows.

    Parameters
    ----------
    directory : path-like
        The folder.
    """

    def __init__(self, directory: str | os.PathLike[str]) -> None:
        self.folder = Path(directory)

    @classmethod
    def open(cls, directory: str | os.PathLike[str], *, make: bool) -> Store:
        """
        Open a store, or make one.

        Parameters
        ----------
        directory : path-like
            The folder.
        make : bool
            Whether to make it, with its parents, where there is none.

        Returns
        -------
        Store

        Raises
        ------
        FileNotFoundError
            If there is no such folder, and none is to be made.
        StoreError
            If it is a folder of something else, or of another version.
        NotADirectoryError
            If it is a file.
        """
        store = cls(directory)
        marker = store.folder / "store.json"
        if store.folder.exists() and not store.folder.is_dir():
            msg = f"store: {store.folder} is a file"
            raise NotADirectoryError(msg)
        if not marker.exists():
            if not make:
                if not store.folder.exists():
                    msg = f"store: there is no folder {store.folder}"
                    raise FileNotFoundError(msg)
                msg = f"store: {store.folder} holds no sweep: it has no store.json"
                raise StoreError(msg)
            if store.folder.exists() and not _is_empty(store.folder):
                msg = f"store: {store.folder} is not empty and holds no sweep"
                raise StoreError(msg)
            store.folder.mkdir(parents=True, exist_ok=True)
            facts = {"magic": MAGIC, "version": STORE_VERSION}
            atomic_write(marker, f"{json.dumps(facts)}\n".encode())
        try:
            facts = json.loads(marker.read_bytes())
            magic, version = facts["magic"], facts["version"]
        except (ValueError, TypeError, KeyError):
            magic = version = None
        if magic != MAGIC:
            msg = f"store: {marker} is not a sweep's"
            raise StoreError(msg)
        if version != STORE_VERSION:
            msg = f"store: {store.folder} has version {version}; this treelod reads {STORE_VERSION}"
            raise StoreError(msg)
        if make:
            for name in ("cells", "plants"):
                (store.folder / name).mkdir(exist_ok=True)
                _remove_stale(store.folder / name)
        return store

    def path(self, key: str) -> Path:
        """
        Return where a cell's row is, or would be.

        Parameters
        ----------
        key : str
            The cell's.

        Returns
        -------
        Path
        """
        return self.folder / "cells" / f"{key}.parquet"

    def plant_path(self, digest: str) -> Path:
        """
        Return where a plant waits for workers.

        Parameters
        ----------
        digest : str
            The plant's.

        Returns
        -------
        Path
        """
        return self.folder / "plants" / f"{digest}.npz"

    def write(self, shard: Shard) -> None:
        """
        Keep a row, in place of an earlier one of the same key.

        Parameters
        ----------
        shard : Shard
            The row.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        key = key_of(shard.identity)
        header = {
            "magic": MAGIC,
            "version": STORE_VERSION,
            "key": key,
            "given": shard.given,
            "identity": shard.identity,
            "row_sha256": _checksum(shard.row, shard.given),
        }
        schema = pa.schema([(name, _type_of(name, value)) for name, value in shard.row.items()])
        out = io.BytesIO()
        options = {"use_dictionary": False, "write_statistics": False, "store_schema": False}
        with pq.ParquetWriter(out, schema, write_page_checksum=True, **options) as writer:
            writer.add_key_value_metadata({_HEADER: json.dumps(header).encode()})
            writer.write_table(pa.Table.from_pylist([shard.row], schema=schema))
        atomic_write(self.path(key), out.getvalue())

    def read(self, key: str) -> Shard | None:
        """
        Read a row.

        Parameters
        ----------
        key : str
            The cell's.

        Returns
        -------
        Shard or None
            None where there is none, or none that can be used; of the latter a `SweepWarning`
            tells.
        """
        path = self.path(key)
        return _read(path) if path.exists() else None

    def read_all(self) -> Iterator[Shard]:
        """
        Read every row that can be used, by key; a `SweepWarning` tells of every other file.

        Yields
        ------
        Shard
        """
        cells = self.folder / "cells"
        for path in sorted(cells.iterdir()) if cells.is_dir() else []:
            # what a killed writer leaves behind was never a row
            if path.name.startswith(".") and path.name.endswith(".tmp"):
                continue
            shard = _read(path)
            if shard is not None:
                yield shard


def _read(path: Path) -> Shard | None:
    """Read a file, or warn that it is of no use."""

    def skip(why: str) -> None:
        warnings.warn(f"{path} is skipped: {why}", SweepWarning, stacklevel=4)

    if path.suffix != ".parquet" or not _KEY.fullmatch(path.stem):
        skip("it is no row of a sweep")
        return None
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            metadata = file.metadata.metadata or {}
            # one row: threads would cost more than they bring
            rows = file.read(use_threads=False).to_pylist()
        if _HEADER not in metadata:
            skip("it was not written by a sweep")
            return None
        shard, why = _told(rows, json.loads(metadata[_HEADER]), path.stem)
    except (
        OSError,
        pa.ArrowException,
        ValueError,
        KeyError,
        TypeError,
        OverflowError,
        RecursionError,
    ) as error:
        skip(f"it is damaged ({type(error).__name__}: {error})")
        return None
    if shard is None:
        skip(why)
    return shard


def _told(rows: list[dict[str, Any]], header: dict[str, Any], key: str) -> tuple[Shard | None, str]:
    """Return the row that a file holds, or why it is none."""
    if header["magic"] != MAGIC:
        return None, "it was not written by a sweep"
    if header["version"] != STORE_VERSION:
        return None, f"it has version {header['version']}, not {STORE_VERSION}"
    identity, given = header["identity"], header["given"]
    if key_of(identity) != key:
        return None, "it belongs to another cell than its name says"
    if len(rows) != 1 or rows[0]["key"] != key:
        return None, "its row is of another cell"
    (row,) = rows
    if header["row_sha256"] != _checksum(row, given):
        return None, "its row is not the one that was written"
    if not (identity.keys() >= _IDENTITY and row.keys() >= _COLUMNS):
        return None, "its row lacks columns"
    return Shard(row, identity, given), ""


def _type_of(name: str, value: Any) -> pa.DataType:
    if value is None:
        return _NULL_TYPES.get(name, pa.float64())
    return _TYPES[type(value)]


def _is_empty(folder: Path) -> bool:
    """Tell whether a folder holds nothing, or what a writer left that was killed as it began."""
    names = [path.name for path in folder.iterdir()]
    return all(name.startswith(".store.json.") and name.endswith(".tmp") for name in names)


def _checksum(row: dict[str, Any], given: list[str]) -> str:
    """Name a row's content; infinity is a value of it."""
    text = json.dumps([row, given], sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _remove_stale(folder: Path) -> None:
    """Remove what killed writers have left; younger files may be another writer's."""
    for path in folder.glob(".*.tmp"):
        try:
            if time.time() - path.stat().st_mtime > _STALE_SECS:
                path.unlink()
        except FileNotFoundError:
            continue
