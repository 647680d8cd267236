"""
The rows of a sweep as a table: the columns of a comparison, one for each parameter, and names.

Labels, parameters' columns and positions of cameras depend on what a table holds beside a row, so
they are not stored with it but made here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import pandas as pd

from treelod.columns import summarised, typed
from treelod.sweeps.grid import labels
from treelod.sweeps.parameters import written
from treelod.sweeps.store import Store
from treelod.techniques import REGISTRY, FullMesh

if TYPE_CHECKING:
    import os
    from collections.abc import Callable

    import xarray as xr

    from treelod.sweeps.store import Shard

__all__ = ["SweepResults", "load_results", "table_of"]

PARAM = "param_"
"""Before the name of a parameter's column."""

_PLACE = ("azimuth_deg", "elevation_deg", "distance")
"""What `to_xarray` says of a camera."""

_AXES = ("plant", "label", "technique", "view", *_PLACE)
"""What `to_xarray` needs."""

_MEASURED = (
    "time_samples",
    "reference_samples",
    "ppd",
    "timing",
    "kernel_version",
    "backend",
    "adapter",
)
"""How a row was measured: rows that differ in one of them are no mean of anything."""

_FIRST = ("plant", "label", "technique", "params")


class SweepResults(pd.DataFrame):
    """
    Rows of a sweep: a `pandas.DataFrame` with a summary and a way to xarray.

    One row a plant, technique, parameters and camera. The columns are those of
    `Comparison.table`, and ``param_NAME`` for each parameter that the grid names (null where a
    technique has none), ``plant_digest``, ``key`` and ``kernel_version`` (what names the plant's
    content, the row, and the code that made it), ``timing`` and ``overdraw`` (fragments a covered
    pixel). ``attrs["failed"]`` lists the cells without a row, ``attrs["work"]`` what each worker
    did.
    """

    @property
    def _constructor(self) -> Callable[..., SweepResults]:
        return SweepResults

    def summary(self, by: Sequence[str] = ()) -> pd.DataFrame:
        """
        Return errors and costs of each technique over all its views.

        Parameters
        ----------
        by : sequence of str, default ()
            Further columns to keep apart, ``"distance"`` for example.

        Returns
        -------
        pandas.DataFrame
            As `Comparison.summary`, one row a plant and label, and one for each way of measuring
            where the rows were not all measured alike. ``speedup`` is the median of the full
            mesh's times, each taken in turns with a row's own, over the median of those.
        """
        rows = pd.DataFrame(self)
        apart = [name for name in _MEASURED if name in rows and rows[name].nunique() > 1]
        keys = [*dict.fromkeys(["plant", *by, *apart])]
        table = summarised(rows, keys)
        # the full mesh's own rows may be of another run, on another machine
        base = rows.assign(base=rows["speedup"] * rows["frame_millis"])
        groups = base.groupby(["label", *keys], sort=False, dropna=False)
        table["speedup"] = groups["base"].median().to_numpy() / table["frame_millis"]
        first = ["plant", "label", *keys[1:]]
        return table[[*first, *(name for name in table.columns if name not in first)]]

    # a method of the base class that takes less and gives the index as the only axis
    def to_xarray(self, technique: str | None = None) -> xr.Dataset:  # type: ignore[misc]
        """
        Return the numbers as arrays with named axes.

        Parameters
        ----------
        technique : str, optional
            Whose rows. Default: the one technique beside the full mesh, if there is one; else the
            rows of all, with labels as an axis. Of a part without the columns that say what a row
            is, the index is the axis, as of any other `pandas.DataFrame`.

        Returns
        -------
        xarray.Dataset
            Axes ``plant``, each parameter of the technique that varies (or ``label``), and
            ``view``; the cameras' azimuth, elevation and distance as coordinates. What the sweep
            did not compute is NaN. The full mesh is there only where labels are an axis.

        Raises
        ------
        ImportError
            Without xarray, which the extra ``notebook`` brings.
        ValueError
            If there are no such rows, or two for one cell: of different samples, for example; or
            if a technique is asked for without the columns that name it.
        """
        try:
            import xarray as xr
        except ImportError as error:
            msg = "to_xarray needs xarray: pip install 'treelod[notebook]'"
            raise ImportError(msg) from error
        rows = pd.DataFrame(self)
        absent = [name for name in _AXES if name not in rows]
        if absent and technique is None:
            # whatever was made of the rows, and is a table of its own
            plain: xr.Dataset = rows.to_xarray()
            return plain
        if absent:
            msg = f"technique: there is no column {absent[0]!r} to tell its rows by"
            raise ValueError(msg)
        others = rows.loc[rows["label"] != FullMesh.name, "technique"].unique()
        if technique is None and len(others) == 1:
            technique = str(others[0])
        axes = ["label"]
        if technique is not None:
            is_one = rows["technique"] == technique
            rows = rows[is_one & (rows["label"] != FullMesh.name)] if len(others) else rows[is_one]
            if rows.empty:
                msg = f"technique: there are no rows of {technique!r}"
                raise ValueError(msg)
            axes = [
                name
                for name in map(str, rows.columns)
                if name.startswith(PARAM) and rows[name].nunique(dropna=False) > 1
            ]
        index = {"plant": _axis(rows["plant"])}
        index |= {name.removeprefix(PARAM): _axis(rows[name]) for name in axes}
        index |= {"view": rows["view"]}
        numbers = rows.select_dtypes(["number", "bool"])
        known = [name for name in map(str, numbers) if name.startswith(PARAM)]
        numbers = numbers.drop(columns=[*known, "view"])
        numbers = numbers.astype(
            {name: "float64" for name in numbers if numbers[name].dtype == "Int64"}
        )
        numbers.index = pd.MultiIndex.from_arrays([*index.values()], names=[*index])
        if numbers.index.has_duplicates:
            twice = numbers.index[numbers.index.duplicated()][0]
            msg = (
                f"two rows for {dict(zip(index, twice, strict=True))}: choose rows of one sweep "
                "first, by samples, timing, backend, adapter or kernel_version"
            )
            raise ValueError(msg)
        dataset = xr.Dataset.from_dataframe(pd.DataFrame(numbers))
        # in the table's order, and not in the alphabet's
        dataset = dataset.reindex({name: pd.unique(column) for name, column in index.items()})
        for name in _PLACE:
            dataset = dataset.assign_coords({name: _place(dataset[name])})
        return dataset


def load_results(directory: str | os.PathLike[str]) -> SweepResults:
    """
    Read every row of a store.

    Parameters
    ----------
    directory : path-like
        What was given to `sweep` as ``store``.

    Returns
    -------
    SweepResults
        Rows of all sweeps that wrote there, by plant, technique, parameters and view. Labels tell
        apart what varies in the store. A plant that sweeps named differently has its latest name.

    Raises
    ------
    FileNotFoundError
        If there is no such folder.
    StoreError
        If it is no store.

    Warns
    -----
    SweepWarning
        For each file that is damaged or none of ours; it is skipped.
    """
    shards = [*Store.open(directory, make=False).read_all()]
    latest = {
        shard.identity["plant"]: shard.row["plant"]
        for shard in sorted(shards, key=lambda shard: (shard.row["date"], shard.row["plant"]))
    }
    for shard in shards:
        shard.row["plant"] = latest[shard.identity["plant"]]
    places = _places(shards)
    order = {name: index for index, name in enumerate(REGISTRY)}
    given = {name for shard in shards for name in shard.given}

    def rank(position: int) -> tuple[Any, ...]:
        shard = shards[position]
        values = [_rank(value) for name, value in shard.identity["params"].items() if name in given]
        technique = shard.identity["technique"]
        return (
            shard.row["plant"],
            order.get(technique, len(order)),
            technique,
            values,
            places[position],
            shard.row["key"],
        )

    positions = sorted(range(len(shards)), key=rank)
    return table_of([shards[i] for i in positions], [places[i] for i in positions])


def table_of(shards: Sequence[Shard], views: Sequence[int]) -> SweepResults:
    """
    Make a table of rows.

    Parameters
    ----------
    shards : sequence of Shard
        The rows, in order.
    views : sequence of int
        Position of each row's camera among those of its plant.

    Returns
    -------
    SweepResults
    """
    if not shards:
        return SweepResults({name: pd.Series(dtype="str") for name in _FIRST})
    kept: dict[tuple[str, str], tuple[str, dict[str, Any]]] = {}
    for shard in shards:
        technique, params = shard.identity["technique"], shard.identity["params"]
        kept.setdefault((technique, written(params)), (technique, params))
    label_of = dict(zip(kept, labels([*kept.values()]), strict=True))
    given = dict.fromkeys(name for shard in shards for name in shard.given)
    records = []
    for shard, view in zip(shards, views, strict=True):
        technique, params = shard.identity["technique"], shard.identity["params"]
        first: dict[str, Any] = {
            "plant": shard.row["plant"],
            "label": label_of[technique, written(params)],
            "technique": technique,
            "params": shard.row["params"],
        }
        first |= {f"{PARAM}{name}": params.get(name) for name in given}
        # of this table, and not of the one that the row was stored for
        records.append({**first, **shard.row, "view": view})
    table = typed(pd.DataFrame.from_records(records))
    for name in given:
        # from the values themselves: in a column of numbers and gaps, whole ones are whole no more
        values = [shard.identity["params"].get(name) for shard in shards]
        table[f"{PARAM}{name}"] = _typed_param(values)
    return SweepResults(table.astype({"overdraw": "float64"}))


def _typed_param(values: Sequence[Any]) -> pd.Series[Any]:
    """Give a parameter's values one type: numbers where all are, else text."""
    kinds = {type(value) for value in values if value is not None}
    whole = [value for value in values if type(value) is int]
    low, high = min(whole, default=0), max(whole, default=0)
    if kinds == {bool}:
        return pd.Series(values, dtype="boolean")
    if kinds == {int} and low >= -(2**63) and high < 2**63:
        return pd.Series(values, dtype="Int64")
    if kinds == {int} and low >= 0 and high < 2**64:
        return pd.Series(values, dtype="UInt64")
    if float in kinds and kinds <= {int, float} and low >= -(2**53) and high <= 2**53:
        return pd.Series(values, dtype="float64")
    texts = [v if v is None or isinstance(v, str) else written(v) for v in values]
    return pd.Series(texts, dtype="string")


def _axis(column: pd.Series[Any]) -> pd.Series[Any]:
    """Return values as an axis holds them: plain numbers, or text."""
    if column.isna().any():
        return column.astype("object").map(lambda v: "none" if pd.isna(v) else str(v))
    if column.dtype == "Int64":
        return column.astype("int64")
    if column.dtype == "UInt64":
        return column.astype("uint64")
    if column.dtype == "boolean":
        return column.astype("bool")
    return column if pd.api.types.is_numeric_dtype(column) else column.astype("object")


def _place(values: xr.DataArray) -> xr.DataArray:
    """Reduce what says where a camera stands to the axes it depends on."""
    for axis in [str(name) for name in values.dims if name != "view"]:
        first = values.max(axis)
        if bool(((values == first) | values.isnull()).all()):
            values = first
    return values


def _places(shards: Sequence[Shard]) -> list[int]:
    """Give each plant's cameras numbers: their own, unless sweeps disagree about them."""
    stored: dict[str, dict[str, set[int]]] = {}
    for shard in shards:
        cameras = stored.setdefault(shard.identity["plant"], {})
        cameras.setdefault(written(shard.identity["camera"]), set()).add(shard.row["view"])
    numbers: dict[tuple[str, str], int] = {}
    for plant, cameras in stored.items():
        taken = [view for views in cameras.values() for view in views]
        is_clear = len(set(taken)) == len(taken) == len(cameras)
        for position, camera in enumerate(sorted(cameras, key=lambda c: (min(cameras[c]), c))):
            numbers[plant, camera] = min(cameras[camera]) if is_clear else position
    return [numbers[shard.identity["plant"], written(shard.identity["camera"])] for shard in shards]


def _rank(value: Any) -> tuple[Any, ...]:
    """Order values of different types."""
    if value is None:
        return (0,)
    if isinstance(value, bool | int | float):
        return (1, value)
    return (2, value if isinstance(value, str) else written(value))
