"""
Level of detail of trees and foliage: every technique built, drawn and measured.

For this plant, seen like this: which technique, with which parameters, costs how much and looks how
wrong?
"""

import importlib
import warnings
from typing import TYPE_CHECKING, Any

from treelod import _core, criteria, gpu
from treelod._core import __version__
from treelod.cameras import Camera, orbit
from treelod.clusters import LeafClustering, PlaneMisses, cluster_leaves, plane_misses
from treelod.collapse import LeafForest, collapse_leaves
from treelod.errors import (
    DeviceError,
    ForkedError,
    InternalError,
    LimitError,
    NoAdapterError,
    PlantFileError,
    StoreError,
    SweepError,
    SweepWarning,
    TreelodError,
)
from treelod.plants import Foliage, Lighting, Material, Mesh, Plant, grow_plant, load_plant
from treelod.render import Frame, ViewState, render, time_frames
from treelod.scenes import Scene, scatter
from treelod.techniques import (
    Billboard,
    FoliageHierarchy,
    FullMesh,
    LayeredBillboards,
    LeafClusters,
    OctahedralImpostor,
    OrthogonalSlices,
    PointsAndLines,
    SimplifiedMesh,
    Slicings,
    StochasticPruning,
)
from treelod.variety import Variety
from treelod.wind import Wind

if TYPE_CHECKING:
    from treelod import metrics, plots, walks
    from treelod.popping import switches
    from treelod.sweeps import SweepResults, crossed, load_results, sweep, zipped

__all__ = [
    "Billboard",
    "Camera",
    "DeviceError",
    "Foliage",
    "FoliageHierarchy",
    "ForkedError",
    "Frame",
    "FullMesh",
    "InternalError",
    "LayeredBillboards",
    "LeafClustering",
    "LeafClusters",
    "LeafForest",
    "Lighting",
    "LimitError",
    "Material",
    "Mesh",
    "NoAdapterError",
    "OctahedralImpostor",
    "OrthogonalSlices",
    "PlaneMisses",
    "Plant",
    "PlantFileError",
    "PointsAndLines",
    "Scene",
    "SimplifiedMesh",
    "Slicings",
    "StochasticPruning",
    "StoreError",
    "SweepError",
    "SweepResults",
    "SweepWarning",
    "TreelodError",
    "Variety",
    "ViewState",
    "Wind",
    "__version__",
    "cluster_leaves",
    "collapse_leaves",
    "criteria",
    "crossed",
    "gpu",
    "grow_plant",
    "load_plant",
    "load_results",
    "metrics",
    "orbit",
    "plane_misses",
    "plots",
    "render",
    "scatter",
    "sweep",
    "switches",
    "time_frames",
    "walks",
    "zipped",
]

_HEAVY = {"metrics", "plots", "walks"}
"""Modules that import large libraries: imported at their first use, `tl.metrics` included."""

_HEAVY_NAMES = {
    **dict.fromkeys(
        ["SweepResults", "crossed", "load_results", "sweep", "zipped"], "treelod.sweeps"
    ),
    "switches": "treelod.popping",
}
"""Names of modules that import large libraries too, with their modules."""


def __getattr__(name: str) -> Any:
    if name in _HEAVY:
        return importlib.import_module(f"treelod.{name}")
    if name in _HEAVY_NAMES:
        return getattr(importlib.import_module(_HEAVY_NAMES[name]), name)
    msg = f"module 'treelod' has no attribute {name!r}"
    raise AttributeError(msg)


if _core.build_profile != "release":
    warnings.warn(
        "treelod was built without optimisation: its timings say nothing "
        "(`make build` makes a release build)",
        RuntimeWarning,
        stacklevel=2,
    )
