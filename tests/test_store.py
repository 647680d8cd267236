"""Does a store give back what was put in, and nothing else, whatever lies in its folder?"""

import json
import os
import shutil
import time
import warnings

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import treelod as tl
from made_sweeps import GRID, PLANT, QUICK, cameras
from treelod.errors import StoreError, SweepWarning
from treelod.sweeps.cells import key_of
from treelod.sweeps.store import Shard, Store


def identity(number=0):
    return {
        "plant": "p" * 64,
        "technique": "slicings",
        "number": number,
        "params": {},
        "camera": {},
        "timing": {"mode": "none"},
    }


def shard(number=0, **row):
    facts = identity(number)
    columns = {"plant": "crown", "params": "{}", "view": 0, "date": "now", "flip": 0.5}
    empty = dict.fromkeys(("frame_millis", "overdraw", "adapter"))
    return Shard({"key": key_of(facts), **columns, **empty, **row}, facts, ["slice_count"])


@pytest.fixture
def store(tmp_path):
    return Store.open(tmp_path / "rows", make=True)


def test_a_row_comes_back_as_it_was(store):
    row = {
        "one": 1,
        "third": 1 / 3,
        "infinite": float("inf"),
        "text": "a\nb",
        "yes": True,
        "none": None,
        "seed": None,
        "git_commit": None,
        "frame_millis": None,
    }
    store.write(shard(**row))
    back = store.read(key_of(identity()))
    assert back.row == shard(**row).row
    assert back.row["infinite"] == float("inf")
    assert back.identity == identity()
    assert back.given == ["slice_count"]
    assert back.is_timed, "no times were asked for"
    assert store.read(key_of(identity(1))) is None
    # a column without a value has the type it has elsewhere, so files can be joined
    types = {f.name: str(f.type) for f in pq.read_schema(store.path(key_of(identity())))}
    assert (types["seed"], types["git_commit"], types["frame_millis"]) == (
        "int64",
        "string",
        "double",
    )


def test_a_row_replaces_an_earlier_one(store):
    store.write(shard(flip=0.1))
    store.write(shard(flip=0.2))
    assert [found.row["flip"] for found in store.read_all()] == [0.2]
    assert [path.name for path in (store.folder / "cells").iterdir()] == [
        f"{key_of(identity())}.parquet"
    ]


def test_any_change_of_what_decides_changes_the_key():
    keys = {key_of(identity(number)) for number in (0, 1, 1.5, "1", None, True)}
    # true and 1 are different numbers in JSON, as are 1 and 1.0
    assert len(keys) == 6
    shuffled = dict(reversed(identity().items()))
    assert key_of(shuffled) == key_of(identity())
    with pytest.raises(ValueError, match="JSON"):
        key_of({"x": float("nan")})


def spoil(store, how):
    """Put the row of cell 1 in place, and spoil it; returns its path."""
    store.write(shard(1))
    path = store.path(key_of(identity(1)))
    data = path.read_bytes()
    if how == "empty":
        path.write_bytes(b"")
    elif how == "torn":
        path.write_bytes(data[: len(data) // 2])
    elif how == "without its end":
        path.write_bytes(data[:-1])
    elif how == "other bytes":
        path.write_bytes(os.urandom(len(data)))
    elif how == "a flipped bit":
        # in a value, where only the checksum can tell
        at = data.index(key_of(identity(1)).encode())
        path.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
    elif how == "of another program":
        pq.write_table(pa.table({"key": [path.stem]}), path)
    elif how == "of another cell":
        store.write(shard(2))
        store.path(key_of(identity(2))).replace(path)
    elif how == "of another version":
        rewrite(path, version=99)
    elif how == "of another magic":
        rewrite(path, magic="sapling sweep")
    elif how == "with other parameters given":
        rewrite(path, given=["resolution"])
    elif how == "with an identity of no number":
        rewrite(path, identity={"number": float("nan")})
    elif how == "with a renamed column":
        table = pq.read_table(path)
        names = ["flap" if name == "flip" else name for name in table.column_names]
        rewrite(path, table.rename_columns(names))
    elif how == "without a plant":
        facts = {name: value for name, value in identity(1).items() if name != "plant"}
        other = Shard({**shard(1).row, "key": key_of(facts)}, facts, [])
        store.write(other)
        path.unlink()
        return store.path(key_of(facts))
    elif how == "without an identity":
        rewrite(path, identity=None)
    elif how == "a folder":
        path.unlink()
        path.mkdir()
    return path


def rewrite(path, table=None, **changes):
    """Change what a file says of itself."""
    table = pq.read_table(path) if table is None else table
    header = json.loads(pq.read_metadata(path).metadata[b"treelod"]) | changes
    with pq.ParquetWriter(path, table.schema) as writer:
        writer.add_key_value_metadata({b"treelod": json.dumps(header).encode()})
        writer.write_table(table)


SPOILED = {
    "empty": "is skipped: it is damaged",
    "torn": "is skipped: it is damaged",
    "without its end": "is skipped: it is damaged",
    "other bytes": "is skipped: it is damaged",
    "a flipped bit": "is skipped: it is damaged",
    "a folder": "is skipped: it is damaged",
    "of another program": "is skipped: it was not written by a sweep",
    "of another cell": "is skipped: it belongs to another cell than its name says",
    "of another version": "is skipped: it has version 99, not 3",
    "of another magic": "is skipped: it was not written by a sweep",
    "with other parameters given": "its row is not the one that was written",
    "with a renamed column": "its row is not the one that was written",
    "with an identity of no number": "is skipped: it is damaged .ValueError",
    "without a plant": "its row lacks columns",
    "without an identity": "is skipped: it belongs to another cell",
}


@pytest.mark.parametrize("how", SPOILED)
def test_what_cannot_be_used_is_named_and_skipped(store, how):
    store.write(shard(0))
    path = spoil(store, how)
    with pytest.warns(SweepWarning, match=SPOILED[how]) as caught:
        assert store.read(path.stem) is None
    assert str(path) in str(caught[0].message)
    with pytest.warns(SweepWarning, match=SPOILED[how]):
        assert [found.identity["number"] for found in store.read_all()] == [0]


def test_an_unspoiled_row_is_not_skipped(store):
    # the negative control of the test above: rewriting alone does no harm
    path = spoil(store, "not at all")
    rewrite(path)
    assert store.read(path.stem).identity == identity(1)


def test_a_file_with_flipped_bits_is_the_row_or_no_row(store):
    row = shard(3, seed=7, cpu="one of many").row
    store.write(shard(3, **row))
    path = store.path(row["key"])
    data = path.read_bytes()
    random = np.random.default_rng(5)
    skipped = 0
    for _ in range(400):
        flipped = np.frombuffer(data, np.uint8).copy()
        for at in random.integers(0, len(data), random.integers(1, 4)):
            flipped[at] ^= 1 << random.integers(8)
        path.write_bytes(flipped.tobytes())
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            back = store.read(path.stem)
        skipped += back is None
        assert len(caught) == (back is None), "skipped and said so, or read"
        # padding and statistics decide nothing
        assert back is None or (back.row, back.identity, back.given) == (
            row,
            identity(3),
            ["slice_count"],
        )
    assert skipped > 200


def test_other_files_are_named_and_leftovers_are_not(store):
    store.write(shard(0))
    cells = store.folder / "cells"
    (cells / f".{'0' * 64}.parquet.abc.tmp").write_bytes(b"torn")
    (cells / "notes.txt").write_text("mine")
    (cells / "abc.parquet").write_bytes(b"")
    with pytest.warns(SweepWarning, match="it is no row of a sweep") as caught:
        assert len([*store.read_all()]) == 1
    names = sorted(str(warning.message).split(" is skipped")[0] for warning in caught)
    assert names == [str(cells / "abc.parquet"), str(cells / "notes.txt")]


def test_old_leftovers_are_removed(store):
    cells = store.folder / "cells"
    old, fresh = cells / ".old.tmp", cells / ".fresh.tmp"
    for path in (old, fresh):
        path.write_bytes(b"torn")
    os.utime(old, (time.time() - 7200,) * 2)
    Store.open(store.folder, make=True)
    assert [path.name for path in cells.iterdir()] == [".fresh.tmp"]


# Opening


def test_folders_of_others_are_refused(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(StoreError, match="is not empty and holds no sweep"):
        Store.open(tmp_path, make=True)
    with pytest.raises(StoreError, match=r"holds no sweep: it has no store\.json"):
        Store.open(tmp_path, make=False)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    with pytest.raises(NotADirectoryError, match=r"mine\.txt is a file"):
        Store.open(tmp_path / "mine.txt", make=True)
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        tl.load_results(tmp_path / "nowhere")
    # so does one in which another writer was killed as it began
    (tmp_path / "begun").mkdir()
    (tmp_path / "begun" / ".store.json.a1b2.tmp").write_bytes(b"{")
    Store.open(tmp_path / "begun", make=True)
    # an empty folder becomes a store, and so does one that is not there, with its parents
    (tmp_path / "empty").mkdir()
    for folder in (tmp_path / "empty", tmp_path / "a" / "b"):
        Store.open(folder, make=True)
        Store.open(folder, make=False)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"magic": "treelod sweep", "version": 1}', "has version 1; this treelod reads 3"),
        ('{"magic": "other", "version": 1}', r"store\.json is not a sweep's"),
        ("{}", r"store\.json is not a sweep's"),
        ("[]", r"store\.json is not a sweep's"),
        ("{", r"store\.json is not a sweep's"),
    ],
)
def test_other_stores_are_refused(store, text, message):
    (store.folder / "store.json").write_text(text)
    for make in (True, False):
        with pytest.raises(StoreError, match=message):
            Store.open(store.folder, make=make)


def test_an_empty_store_is_an_empty_table(store):
    table = tl.load_results(store.folder)
    assert len(table) == 0
    assert isinstance(table, tl.SweepResults)


# With real rows


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("swept") / "rows"
    tl.sweep(PLANT, GRID, cameras(PLANT), store=folder, timing="none", **QUICK)
    return folder


def test_a_spoiled_row_is_computed_again_and_the_others_are_not(swept, tmp_path):
    folder = tmp_path / "rows"
    shutil.copytree(swept, folder)
    before = tl.load_results(folder)
    torn = sorted((folder / "cells").iterdir())[3]
    torn.write_bytes(torn.read_bytes()[:1000])
    with pytest.warns(SweepWarning, match=torn.name):
        assert len(tl.load_results(folder)) == len(before) - 1
    others = {path: path.stat().st_mtime_ns for path in (folder / "cells").iterdir()}
    with pytest.warns(SweepWarning, match=torn.name):
        again = tl.sweep(PLANT, GRID, cameras(PLANT), store=folder, timing="none", **QUICK)
    assert again.attrs["work"]["stored"] == len(before) - 1
    changed = [p for p in others if p.stat().st_mtime_ns != others[p]]
    assert changed == [torn]
    columns = [name for name in before if name not in ("date", "build_secs")]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        after = tl.load_results(folder)
    assert after[columns].equals(before[columns])
