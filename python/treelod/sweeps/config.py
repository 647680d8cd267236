"""
What a file says about a sweep: plants, cameras, techniques and settings, in TOML.

    [plants]                                a file, or a preset to grow
    oak = "oak.glb"
    chestnut = { preset = "chestnut", leaf_count = 2000 }

    [cameras]                               circles around each plant
    azimuths = 8
    distances = [2.5, 10]

    [techniques.slicings]                   lists are crossed
    slice_count = [3, 5, 7]
    resolution = { from = 64, to = 256, count = 3, scale = "log" }
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from treelod.cameras import (
    DEFAULT_AZIMUTH_COUNT,
    DEFAULT_DISTANCES,
    DEFAULT_ELEVATIONS_DEG,
    default_cameras,
)
from treelod.loading import load_plant
from treelod.plants import PRESETS, grow_plant
from treelod.provenance import file_sha256
from treelod.render import check_size
from treelod.sweeps.cells import Settings, whole
from treelod.sweeps.grid import ParameterSets, crossed, expand, zipped
from treelod.sweeps.parameters import is_whole, known
from treelod.techniques import REGISTRY

if TYPE_CHECKING:
    import os

    from treelod.cameras import Camera
    from treelod.plants import Plant

__all__ = ["Config", "check_settings", "read_config"]

_RANGE = {"from", "to", "count", "step", "scale"}

_SETTINGS = {
    "samples",
    "reference_samples",
    "repeats",
    "warmup",
    "timing",
    "threads",
    "ppd",
    "yee",
    "retries",
    "backend",
    "adapter",
}

_CAMERAS = {"azimuths", "elevations", "distances", "size"}

_PLANT_FILE = {"file", "foliage", "unit", "up"}

_PLANT_GROWN = {"preset", "seed", "leaf_count"}

MAX_RANGE = 10_000
"""Most values of a range: more is taken for a mistake."""


@dataclass(frozen=True, kw_only=True)
class Config:
    """
    A sweep as a file describes it.

    Attributes
    ----------
    plants : dict of str to (dict of str to object)
        What makes each plant; see `make_plant`.
    grid : dict of str to object
        As `sweep` takes it.
    cameras : callable
        Gives a plant's cameras.
    settings : dict of str to object
        Arguments of `sweep`.
    folder : Path
        What the names of plant files are relative to.
    """

    plants: dict[str, dict[str, Any]]
    grid: dict[str, Any]
    cameras: Callable[[Plant], Sequence[Camera]]
    settings: dict[str, Any]
    folder: Path

    def make_plant(self, name: str) -> tuple[Plant, dict[str, Any]]:
        """
        Load or grow a plant.

        Parameters
        ----------
        name : str
            One of `plants`.

        Returns
        -------
        Plant, dict of str to object
            The plant, and where it came from.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        PlantFileError
            If it cannot be read.
        ValueError
            If a value is out of range.
        """
        facts = self.plants[name]
        if "preset" in facts:
            settings = {key: facts[key] for key in ("seed", "leaf_count") if key in facts}
            plant = grow_plant(facts["preset"], **settings)
            source = {
                "preset": facts["preset"],
                "seed": settings.get("seed", 1),
                "leaf_count": plant.foliage.leaf_count,
            }
            return plant, source
        path = self.folder / facts["file"]
        options = {key: facts[key] for key in ("foliage", "unit", "up") if key in facts}
        plant = load_plant(path, **options)
        source = {"file": path.name, "sha256": file_sha256(path), "unit": 1.0, "up": "y"}
        return plant, source | options


def read_config(path: str | os.PathLike[str]) -> Config:
    """
    Read a sweep's file.

    Parameters
    ----------
    path : path-like
        A TOML file.

    Returns
    -------
    Config

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is no TOML, or says what a sweep does not know; the message names it.
    TypeError
        If a value is of another type.
    """
    file = Path(path)
    try:
        facts = tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        msg = f"{file}: it is no TOML: {error}"
        raise ValueError(msg) from error
    try:
        _only("the file", facts, {"plants", "cameras", "techniques", "settings"})
        grid = _grid(_table("techniques", facts.get("techniques", {})))
        expand(grid)
        settings = _table("[settings]", facts.get("settings", {}))
        _only("[settings]", settings, _SETTINGS)
        check_settings(settings)
        return Config(
            plants=_plants(_table("[plants]", facts.get("plants", {}))),
            grid=grid,
            cameras=_cameras(_table("[cameras]", facts.get("cameras", {}))),
            settings=settings,
            folder=file.parent,
        )
    except (ValueError, TypeError) as error:
        msg = f"{file}: {error}"
        raise type(error)(msg) from None


def check_settings(settings: Mapping[str, Any]) -> None:
    """
    Refuse settings that `sweep` would refuse, before plants are loaded.

    Parameters
    ----------
    settings : mapping of str to object
        Arguments of `sweep`.

    Raises
    ------
    ValueError
        If a value is out of range.
    TypeError
        If a value is of another type.
    """
    if whole("retries", settings.get("retries", 0)) < 0:
        msg = f"retries must be at least 0, got {settings['retries']}"
        raise ValueError(msg)
    Settings.checked(**{name: value for name, value in settings.items() if name != "retries"})


def _plants(facts: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    if not facts:
        msg = "[plants] names no plant"
        raise ValueError(msg)
    plants = {}
    for name, value in facts.items():
        said = value
        if isinstance(value, str):
            said = {"preset": value} if value in PRESETS else {"file": value}
        said = _table(f"plants.{name}", said)
        if ("preset" in said) == ("file" in said):
            msg = f"plants.{name} must have a file or a preset, one of the two"
            raise ValueError(msg)
        _only(f"plants.{name}", said, _PLANT_GROWN if "preset" in said else _PLANT_FILE)
        if isinstance(said.get("preset"), str) and said["preset"] not in PRESETS:
            msg = f"plants.{name}: no preset {said['preset']!r}; there are {', '.join(PRESETS)}"
            raise ValueError(msg)
        for key in ("preset", "file", "up"):
            if key in said and not isinstance(said[key], str):
                msg = f"plants.{name}: {key} must be text, got {said[key]!r}"
                raise TypeError(msg)
        for key in ("seed", "leaf_count"):
            if key in said and whole(f"plants.{name}: {key}", said[key]) < 0:
                msg = f"plants.{name}: {key} must be at least 0, got {said[key]}"
                raise ValueError(msg)
        plants[name] = said
    return plants


def _cameras(facts: Mapping[str, Any]) -> Callable[[Plant], Sequence[Camera]]:
    _only("[cameras]", facts, _CAMERAS)
    size = facts.get("size", [1024, 768])
    if not (isinstance(size, list) and len(size) == 2):
        msg = f"[cameras]: size must be [width, height], got {size!r}"
        raise ValueError(msg)
    if min(whole("[cameras]: size", pixels) for pixels in size) < 1:
        msg = f"[cameras]: size must be at least 1 pixel each way, got {size!r}"
        raise ValueError(msg)
    check_size((size[0], size[1]))
    elevations = _numbers("[cameras]: elevations", facts.get("elevations", DEFAULT_ELEVATIONS_DEG))
    distances = _numbers("[cameras]: distances", facts.get("distances", DEFAULT_DISTANCES))
    count = facts.get("azimuths", DEFAULT_AZIMUTH_COUNT)
    if whole("[cameras]: azimuths", count) < 1:
        msg = f"[cameras]: azimuths must be at least 1, got {count}"
        raise ValueError(msg)
    if not all(-90.0 <= degrees <= 90.0 for degrees in elevations):
        msg = f"[cameras]: elevations must be in -90..90, got {elevations}"
        raise ValueError(msg)
    if not all(0.0 < distance < math.inf for distance in distances):
        msg = f"[cameras]: distances must be finite and above 0, got {distances}"
        raise ValueError(msg)

    def cameras(plant: Plant) -> Sequence[Camera]:
        return default_cameras(
            plant,
            azimuth_count=count,
            elevations_deg=elevations,
            distances=distances,
            size=(size[0], size[1]),
        )

    return cameras


def _grid(facts: Mapping[str, Any]) -> dict[str, Any]:
    if not facts:
        msg = "[techniques] names no technique"
        raise ValueError(msg)
    grid: dict[str, Any] = {}
    for name, value in facts.items():
        if name not in REGISTRY:
            msg = f"techniques: unknown technique {name!r}; there are {', '.join(sorted(REGISTRY))}"
            raise ValueError(msg)
        tables = value if isinstance(value, list) else [value]
        grid[name] = [_sets(name, _table(f"techniques.{name}", table)) for table in tables]
    return grid


def _sets(technique: str, facts: Mapping[str, Any]) -> ParameterSets:
    """Read one table of parameters: what is in ``zip`` moves together, the rest is crossed."""
    single = {name: value for name, value in facts.items() if name != "zip"}
    parts: list[Any] = [{name: _values(technique, name, value) for name, value in single.items()}]
    if "zip" in facts:
        together = _table(f"techniques.{technique}: zip", facts["zip"])
        parts.insert(
            0, zipped(**{n: _values(technique, n, value) for n, value in together.items()})
        )
    return crossed(*parts)


def _values(technique: str, name: str, value: Any) -> Any:
    """Read one parameter: a value, a list of values, or a range."""
    if isinstance(value, Mapping) and "from" in value and set(value) <= _RANGE:
        # an unknown parameter is refused with the others
        whole = name not in known(technique) or is_whole(technique, name)
        return _range(f"{technique}: {name}", value, whole=whole)
    return value


def _range(where: str, facts: Mapping[str, Any], *, whole: bool) -> list[Any]:
    for key in ("from", "to", "step"):
        number = facts.get(key, 1.0)
        if isinstance(number, bool) or not isinstance(number, int | float):
            msg = f"{where}: {key} must be a number, got {number!r}"
            raise TypeError(msg)
    if "to" not in facts or ("count" in facts) == ("step" in facts):
        msg = f"{where}: a range has from, to, and one of count and step"
        raise ValueError(msg)
    low, high = float(facts["from"]), float(facts["to"])
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        msg = f"{where}: from must be at most to, got {low:g} and {high:g}"
        raise ValueError(msg)
    if "step" in facts:
        if "scale" in facts:
            msg = f"{where}: scale goes with count, not with step"
            raise ValueError(msg)
        step = float(facts["step"])
        # the end is met although 0.1 is none of the binary fractions
        count = math.floor((high - low) / step + 1e-9) + 1 if 0.0 < step < math.inf else 0
        if not 1 <= count <= MAX_RANGE:
            msg = f"{where}: step must be above 0 and give at most {MAX_RANGE} values, got {step:g}"
            raise ValueError(msg)
        values = [low + step * index for index in range(count)]
    else:
        values = _spread(where, low, high, facts["count"], facts.get("scale", "linear"))
    if whole:
        return [*dict.fromkeys(round(value) for value in values)]
    # of what is written in decimals, decimals
    return [float(f"{value:.12g}") for value in values]


def _spread(where: str, low: float, high: float, count: Any, scale: Any) -> list[float]:
    if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= MAX_RANGE:
        msg = f"{where}: count must be a whole number of at most {MAX_RANGE}, got {count!r}"
        raise ValueError(msg)
    if scale not in ("linear", "log"):
        msg = f"{where}: scale must be 'linear' or 'log', got {scale!r}"
        raise ValueError(msg)
    if scale == "log" and low <= 0.0:
        msg = f"{where}: a range with scale 'log' must begin above 0, got {low:g}"
        raise ValueError(msg)
    if count == 1:
        return [low]
    shares = [index / (count - 1) for index in range(count)]
    if scale == "log":
        return [low * (high / low) ** share for share in shares]
    return [low + (high - low) * share for share in shares]


def _table(where: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        msg = f"{where} must be a table, got {value!r}"
        raise TypeError(msg)
    return value


def _only(where: str, facts: Mapping[str, Any], names: set[str]) -> None:
    unknown = sorted(set(facts) - names)
    if unknown:
        msg = f"{where}: {unknown[0]!r} is not known; there are {', '.join(sorted(names))}"
        raise ValueError(msg)


def _numbers(where: str, value: Any) -> list[float]:
    values = list(value) if isinstance(value, list | tuple) else [value]
    if not values or any(isinstance(v, bool) or not isinstance(v, int | float) for v in values):
        msg = f"{where} must be a number or a list of numbers, got {value!r}"
        raise TypeError(msg)
    return [float(v) for v in values]
