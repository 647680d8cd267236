"""What ``treelod sweep`` does: reads a file, sweeps, writes tables and plots beside the rows."""

from __future__ import annotations

import io
import re
import warnings
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import pandas as pd

from treelod import plots
from treelod.columns import without_infinity
from treelod.errors import SweepWarning
from treelod.files import atomic_write
from treelod.render import opened_card
from treelod.sweeps.config import check_settings, read_config
from treelod.sweeps.driver import sweep
from treelod.sweeps.results import PARAM
from treelod.sweeps.store import Store

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator

    from matplotlib.figure import Figure

    from treelod.comparison import Progress
    from treelod.sweeps.cells import Timing
    from treelod.sweeps.results import SweepResults

__all__ = ["run_config"]

_OWN_PICTURE = re.compile(
    r"(\d{2,}_[\w.-]*_)?(speed_against_error(_\d+_threads)?|memory_against_error"
    r"|error_against_\w+|error_by_(azimuth|distance))\.png"
)
"""What the pictures of this command are called, with more than one plant or with one."""


def run_config(
    config: str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    workers: int | None,
    scheduler: str | None,
    timing: str | None,
    threads: int | None,
    goes_on: bool,
    progress: Progress,
    backend: str | None = None,
    adapter: str | None = None,
) -> SweepResults:
    """
    Run the sweep of a file.

    Parameters
    ----------
    config : path-like
        The file.
    folder : path-like
        Where rows, tables and plots go.
    workers : int or None
        Processes of this machine that work.
    scheduler : str or None
        Address of a dask scheduler whose workers work.
    timing : str or None
        In place of the file's.
    threads : int or None
        In place of the file's.
    goes_on : bool
        Whether to go on where a cell fails.
    progress : callable
        Told how far each stage is.
    backend, adapter : str, optional
        In place of the file's.

    Returns
    -------
    SweepResults
        Written to ``results.parquet``, ``results.csv`` and ``plots``.
    """
    wanted = read_config(config)
    settings = dict(wanted.settings)
    if timing is not None:
        settings["timing"] = cast("Timing", timing)
    if threads is not None:
        settings["threads"] = threads
    if backend is not None:
        settings["backend"] = backend
        if backend == "cpu":
            # the file's card is not asked for
            settings.pop("adapter", None)
    if adapter is not None:
        settings["adapter"] = adapter
    # all that can be refused is, before plants are loaded for minutes
    check_settings(settings)
    if scheduler is None and settings.get("backend") == "gpu" and settings.get("timing") != "none":
        opened_card(settings.get("adapter"))
    with _executor(workers, scheduler) as executor, warnings.catch_warnings():
        if goes_on:
            # the command lists them itself
            warnings.filterwarnings("ignore", "^[0-9]+ of [0-9]+ cells failed", SweepWarning)
        store = Store.open(folder, make=True)
        plants, sources = {}, {}
        for done, name in enumerate(wanted.plants):
            progress("plants", done, len(wanted.plants))
            plants[name], sources[name] = wanted.make_plant(name)
        progress("plants", len(plants), len(plants))
        table = sweep(
            plants,
            wanted.grid,
            wanted.cameras,
            store=store.folder,
            executor=executor,
            on_error="record" if goes_on else "raise",
            sources=sources,
            progress=progress,
            **settings,
        )
    _write(table, store.folder)
    return table


@contextmanager
def _executor(workers: int | None, scheduler: str | None) -> Iterator[int | Executor | None]:
    if scheduler is None:
        if workers is not None and workers < 1:
            msg = f"workers must be at least 1, got {workers}"
            raise ValueError(msg)
        yield workers
        return
    try:
        from distributed import Client
    except ImportError as error:
        msg = "--scheduler needs dask: pip install 'treelod[cluster]'"
        raise ImportError(msg) from error
    with Client(scheduler) as client:
        yield client.get_executor(pure=False)


def _write(table: SweepResults, folder: Path) -> None:
    stored = without_infinity(table)
    # lists of what failed are for the caller
    stored.attrs = {}
    parquet = io.BytesIO()
    stored.to_parquet(parquet, index=False)
    atomic_write(folder / "results.parquet", parquet.getvalue())
    atomic_write(folder / "results.csv", stored.to_csv(index=False).encode())
    (folder / "plots").mkdir(exist_ok=True)
    # of an earlier run, perhaps of other plants
    for path in (folder / "plots").iterdir():
        if path.is_file() and _OWN_PICTURE.fullmatch(path.name):
            path.unlink()
    plants = table["plant"].unique()
    for number, plant in enumerate(plants):
        for name, figure in _figures(table[table["plant"] == plant]).items():
            # the number keeps apart names that differ only in signs a file name cannot hold
            plain = re.sub(r"[^\w.-]+", "_", str(plant))
            stem = f"{number:02d}_{plain}_{name}"
            path = folder / "plots" / f"{stem if len(plants) > 1 else name}.png"
            atomic_write(path, plots.encode(figure, "png"))


def _figures(rows: pd.DataFrame) -> dict[str, Figure]:
    """Draw the plots of one plant."""
    figures: dict[str, Any] = {}
    # times of workers with more threads and with fewer are no one's
    timed = rows[rows["frame_millis"].notna()].groupby("threads")
    for threads, those in timed:
        end = f"_{threads}_threads" if len(timed) > 1 else ""
        figures[f"speed_against_error{end}"] = plots.speed_against_error(those)
    figures["memory_against_error"] = plots.memory_against_error(rows)
    for name in _swept(rows):
        figures[f"error_against_{name}"] = plots.error_against_parameter(rows, name)
    figures["error_by_azimuth"] = plots.error_by_azimuth(rows)
    figures["error_by_distance"] = plots.error_by_distance(rows)
    return figures


def _swept(rows: pd.DataFrame) -> list[str]:
    """Parameters that have several numbers."""
    columns = [name for name in map(str, rows.columns) if name.startswith(PARAM)]
    return [
        name.removeprefix(PARAM)
        for name in columns
        if pd.api.types.is_numeric_dtype(rows[name])
        and not pd.api.types.is_bool_dtype(rows[name])
        and rows[name].nunique() > 1
    ]
