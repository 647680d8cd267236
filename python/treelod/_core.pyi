from collections.abc import Callable, Sequence
from typing import Any, Final, TypedDict, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Billboard",
    "FoliageHierarchy",
    "LayeredBillboards",
    "LeafClusters",
    "OctahedralImpostor",
    "Plant",
    "PointsAndLines",
    "Renderer",
    "Representation",
    "Scene",
    "StochasticPruning",
    "__version__",
    "_cut_for_test",
    "_fail_for_test",
    "_panic_for_test",
    "_spin_for_test",
    "adapters",
    "billboards",
    "build_profile",
    "circle_directions",
    "close_devices",
    "cloud",
    "cluster_leaves",
    "collapse_leaves",
    "cut_times",
    "encode_png",
    "foliage_hierarchy",
    "full_mesh",
    "grow",
    "layered_billboards",
    "leaf_clusters",
    "octahedral_impostor",
    "orthogonal_slices",
    "peak_rate",
    "plane_misses",
    "points_and_lines",
    "preset_names",
    "release_devices",
    "simplified_mesh",
    "slicings",
    "smooth_normals",
    "source_hash",
    "sphere_directions",
    "split_plant",
    "stochastic_pruning",
    "stored_hierarchy",
    "time_naive",
    "variant",
    "vector_peak",
]

_F32 = NDArray[np.float32]
_U32 = NDArray[np.uint32]
_Vec3 = tuple[float, float, float]

class _MaterialFacts(TypedDict):
    name: str
    texture: NDArray[np.uint8] | None
    wrap: tuple[str, str]
    alpha_mode: str
    alpha_cutoff: float
    double_sided: bool

class _LightingFacts(TypedDict):
    sun_direction: Sequence[float]
    sun: Sequence[float]
    sky: Sequence[float]
    ground: Sequence[float]
    translucency: float
    occlusion: float

class _MeshArrays(TypedDict):
    positions: _F32
    normals: _F32
    uvs: _F32
    colors: _F32
    triangles: _U32
    material_ids: _U32

class _StructureArrays(TypedDict):
    parents: NDArray[np.int64]
    levels: _U32
    starts: _F32
    ends: _F32
    radii: _F32
    wood_triangles: _U32
    leaves: _U32
    leaf_branches: _U32

class _LitMeshArrays(TypedDict):
    positions: _F32
    normals: _F32
    uvs: _F32
    base: _F32
    front: _F32
    back: _F32
    triangles: _U32
    material_ids: _U32

__version__: Final[str]
build_profile: Final[str]
source_hash: Final[str]

@final
class Plant:
    def __new__(
        cls,
        name: str,
        origin: Sequence[float],
        materials: Sequence[_MaterialFacts],
        wood: _MeshArrays,
        foliage: _MeshArrays,
        leaf_offsets: _U32,
        lighting: _LightingFacts,
        structure: _StructureArrays | None = None,
    ) -> Plant: ...
    def lit(
        self,
        lighting: _LightingFacts,
        *,
        threads: int | None = None,
        progress: Callable[[int, int], object] | None = None,
    ) -> Plant: ...
    @property
    def name(self) -> str: ...
    @property
    def origin(self) -> list[float]: ...
    @property
    def triangle_count(self) -> int: ...
    @property
    def bounds(self) -> tuple[list[float], list[float]]: ...
    @property
    def sphere(self) -> tuple[list[float], float]: ...
    @property
    def lighting(self) -> _LightingFacts: ...
    @property
    def materials(self) -> list[_MaterialFacts]: ...
    @property
    def wood(self) -> _LitMeshArrays: ...
    @property
    def foliage(self) -> _LitMeshArrays: ...
    @property
    def leaves(self) -> tuple[_U32, _F32, _F32, _F32]: ...
    @property
    def structure(self) -> _StructureArrays | None: ...
    def leaf_rectangles(self) -> NDArray[np.float64]: ...

def grow(
    preset: str,
    seed: int,
    leaf_count: int | None,
    lighting: _LightingFacts,
    *,
    progress: Callable[[int, int], object] | None = None,
) -> Plant: ...
def preset_names() -> list[str]: ...
def split_plant(
    name: str,
    origin: Sequence[float],
    materials: Sequence[_MaterialFacts],
    mesh: _MeshArrays,
    foliage_mask: NDArray[np.bool_] | None,
    lighting: _LightingFacts,
) -> tuple[Plant, list[tuple[int, str, int, int]]]: ...
def smooth_normals(positions: _F32, triangles: _U32) -> _F32: ...
def _panic_for_test() -> None: ...
def _spin_for_test(
    secs: float,
    *,
    threads: int | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> None: ...

class _CameraFacts(TypedDict):
    eye: Sequence[float]
    target: Sequence[float]
    up: Sequence[float]
    fov_y_deg: float | None
    height: float | None
    size: tuple[int, int]
    near: float
    time_secs: float

class _VarietyFacts(TypedDict):
    size: float
    hue_deg: float
    value: float
    mirror: bool
    color: tuple[float, float, float]
    seed: int

class _WindFacts(TypedDict):
    lean: float
    sway: float
    period_secs: float
    azimuth_deg: float | None
    seed: int

@final
class Representation:
    @property
    def footprint(self) -> dict[str, int]: ...
    @property
    def textures(
        self,
    ) -> list[tuple[str, list[NDArray[np.uint8]], list[list[float]] | None]]: ...

@final
class Scene:
    def __new__(
        cls,
        groups: Sequence[tuple[Representation, NDArray[np.float64]]],
        *,
        wind: _WindFacts | None = None,
        variety: _VarietyFacts | None = None,
    ) -> Scene: ...
    @property
    def instance_count(self) -> int: ...
    @property
    def bounds(self) -> tuple[list[float], list[float]] | None: ...
    def bounds_px(self, camera: _CameraFacts) -> tuple[int, int, int, int]: ...

@final
class Renderer:
    def __new__(cls, *, simd: str | None = None) -> Renderer: ...
    def render(
        self,
        scene: Scene,
        camera: _CameraFacts,
        *,
        samples: int,
        background: tuple[float, float, float, float],
        outputs: Sequence[str],
        threads: int | None,
        backend: str = "cpu",
        adapter: str | None = None,
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]: ...
    def time(
        self,
        scene: Scene,
        camera: _CameraFacts,
        *,
        samples: int,
        threads: int | None,
        backend: str = "cpu",
        adapter: str | None = None,
    ) -> dict[str, Any]: ...
    def signature(self, scene: Scene, camera: _CameraFacts) -> list[tuple[str, int, int]]: ...

def adapters() -> list[dict[str, str]]: ...
def close_devices() -> None: ...
def release_devices() -> None: ...
def _fail_for_test(kind: str, *, adapter: str | None = None) -> None: ...
def peak_rate() -> float: ...
def time_naive(scene: Scene, camera: _CameraFacts, *, samples: int) -> float: ...
def variant(variety: _VarietyFacts, group: int, copy: int) -> tuple[float, bool, list[float]]: ...

class _BillboardFacts(TypedDict):
    align: str
    axis: str
    max_turn_deg: float
    view_count: int
    elevations_deg: Sequence[float]
    view_blend: str
    resolution: tuple[int, int]
    samples: int
    drawing: str
    format: str
    views: list[_CameraFacts] | None
    wood: bool
    wood_triangle_count: int | None
    wood_as: str

@final
class Billboard:
    def representation(self) -> Representation: ...
    @property
    def pictures(self) -> list[tuple[int, list[list[float]], list[int]]]: ...
    def quads(self, camera: _CameraFacts) -> list[tuple[int, float, list[list[float]]]]: ...

def billboards(
    plants: Sequence[Plant],
    facts: _BillboardFacts,
    *,
    threads: int | None,
    progress: Callable[[int, int], object] | None,
) -> list[Billboard]: ...
def full_mesh(
    plant: Plant, *, wood: bool, wood_triangle_count: int | None, filter: str
) -> Representation: ...
def slicings(
    plant: Plant,
    orientations: NDArray[np.float64],
    sphere_triangles: _U32 | None,
    params: dict[str, Any],
    *,
    threads: int | None,
    progress: Callable[[int, int], object] | None,
) -> tuple[Representation, dict[str, Any]]: ...
def orthogonal_slices(
    plant: Plant,
    params: dict[str, Any],
    *,
    threads: int | None,
    progress: Callable[[int, int], object] | None,
) -> tuple[Representation, dict[str, Any]]: ...
def simplified_mesh(
    plant: Plant, facts: dict[str, Any], *, progress: Callable[[int, int], object] | None
) -> tuple[Representation, int, float]: ...

@final
class LeafClusters:
    def representation(self) -> Representation: ...
    def at(self, level: int, t: float) -> LeafClusters: ...
    @property
    def level_count(self) -> int: ...
    def cluster_ids(self, level: int) -> _U32: ...
    def planes(self, level: int) -> NDArray[np.float64]: ...
    def parents(self, level: int) -> _U32: ...
    @property
    def level_errors(self) -> list[float]: ...
    @property
    def kmeans_errors(self) -> tuple[list[float], bool]: ...
    @property
    def alpha(self) -> float: ...
    def card_sides(
        self, level: int
    ) -> list[
        tuple[int, bool, list[list[float]], list[list[float]], tuple[int, int, int, int] | None]
    ]: ...
    @property
    def atlas_fills(self) -> list[float]: ...

def leaf_clusters(
    plant: Plant,
    facts: dict[str, Any],
    *,
    threads: int | None,
    progress: Callable[[int, int], object] | None,
) -> LeafClusters: ...

@final
class OctahedralImpostor:
    def representation(self) -> Representation: ...
    def mixed(self, camera: _CameraFacts) -> list[tuple[int, float]]: ...
    def relit(self, lighting: _LightingFacts) -> OctahedralImpostor: ...
    @property
    def facts(self) -> dict[str, Any]: ...
    @property
    def frames(self) -> NDArray[np.float64]: ...

def octahedral_impostor(
    plant: Plant,
    facts: dict[str, Any],
    *,
    threads: int | None,
    progress: Callable[[int, int], object] | None,
) -> OctahedralImpostor: ...

@final
class PointsAndLines:
    def representation(self) -> Representation: ...
    def drawn(self, facts: dict[str, Any], *, threads: int | None) -> PointsAndLines: ...
    @property
    def parts(self) -> list[dict[str, Any]]: ...
    @property
    def groups(self) -> list[dict[str, Any]]: ...
    def selection(self, camera: _CameraFacts) -> list[dict[str, Any]]: ...
    @property
    def samples(self) -> list[tuple[_F32, _F32]]: ...
    @property
    def factors(self) -> list[float]: ...
    @property
    def bytes(self) -> list[int]: ...

def cloud(positions: _F32, colors: _F32, *, lines: bool, size_px: float) -> Representation: ...
def points_and_lines(
    plant: Plant,
    facts: dict[str, Any],
    *,
    threads: int | None,
    progress: Callable[[int, int], object] | None,
) -> PointsAndLines: ...

class _LayerFacts(TypedDict):
    direction: tuple[float, float, float]
    groups: str
    layer_count: int
    tilt: bool
    turn: str
    max_turn_deg: float
    motion: str
    growth: float
    drawing: str
    resolution: int
    samples: int
    format: str
    wood: bool
    wood_triangle_count: int | None
    wood_as: str
    views: Sequence[_CameraFacts] | None

@final
class LayeredBillboards:
    def representation(self) -> Representation: ...
    @property
    def layers(
        self,
    ) -> list[
        tuple[
            str,
            int | None,
            list[float],
            list[list[float]] | None,
            tuple[int, int, int, int] | None,
            int,
            int,
        ]
    ]: ...
    @property
    def atlas_fill(self) -> float: ...
    def poses(
        self, camera: _CameraFacts, *, wind: _WindFacts | None, copy: tuple[int, int]
    ) -> NDArray[np.float64]: ...

def layered_billboards(
    plant: Plant,
    facts: _LayerFacts,
    *,
    threads: int | None,
    progress: Callable[[int, int], object] | None,
) -> LayeredBillboards: ...

@final
class StochasticPruning:
    def representation(self) -> Representation: ...
    def at(self, kept_share: float) -> StochasticPruning: ...
    def level(self, camera: _CameraFacts) -> dict[str, float]: ...

def stochastic_pruning(
    plant: Plant,
    *,
    leaf_width_px: float,
    half_ratio: float,
    shrink: float,
    contrast: bool,
    seed: int,
    wood: bool,
    wood_triangle_count: int | None,
) -> StochasticPruning: ...
def cluster_leaves(
    centers: _F32,
    normals: _F32,
    *,
    cluster_count: int,
    alpha: float,
    init: str | NDArray[Any],
    seed: int,
    restarts: int,
    max_iterations: int,
    eigen: str,
    method: str = "pruned",
    simd: str | None = None,
    threads: int | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> tuple[_U32, NDArray[np.float64], NDArray[np.float64], bool]: ...
def collapse_leaves(
    corners: _F32,
    areas: NDArray[np.float64],
    facts: dict[str, Any],
    *,
    naive: bool = False,
    threads: int | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> tuple[dict[str, Any], int, float]: ...

@final
class FoliageHierarchy:
    def representation(self) -> Representation: ...
    def with_selection(self, selection: dict[str, Any]) -> FoliageHierarchy: ...
    def forest(self) -> dict[str, Any]: ...
    def stored(self, plant: bytes, note: bytes) -> bytes: ...
    @property
    def leaf_count(self) -> int: ...
    @property
    def root_count(self) -> int: ...
    @property
    def forest_bytes(self) -> tuple[int, int]: ...
    @property
    def wood_levels(self) -> list[tuple[int, float]]: ...
    def walk(
        self, cameras: Sequence[_CameraFacts], threads: int | None
    ) -> list[tuple[_U32, dict[str, int]]]: ...

def foliage_hierarchy(
    plant: Plant,
    collapse: dict[str, Any],
    facts: dict[str, Any],
    *,
    keep_coverage: bool,
    threads: int | None,
    progress: Callable[[int, int], object] | None,
) -> tuple[FoliageHierarchy, int, float]: ...
def stored_hierarchy(
    plant: Plant, bytes: bytes, digest: bytes, facts: dict[str, Any], *, threads: int | None
) -> tuple[FoliageHierarchy, bytes]: ...
def plane_misses(
    centers: _F32,
    normals: _F32,
    cluster_ids: _U32,
    *,
    cluster_count: int,
    alpha: float,
    threads: int | None = None,
) -> tuple[
    NDArray[np.uint64],
    tuple[NDArray[np.float64], NDArray[np.float64]],
    NDArray[np.float64],
    NDArray[np.float64],
]: ...
def _cut_for_test(
    stored: bytes,
    criterion: tuple[Any, ...],
    cameras: Sequence[_CameraFacts],
    *,
    origin: Sequence[float],
    rule: str = "inclusive",
    transform: Sequence[Sequence[float]] | None = None,
) -> list[list[int]]: ...
def cut_times(
    stored: bytes,
    criterion: tuple[Any, ...],
    cameras: Sequence[_CameraFacts],
    *,
    origin: Sequence[float],
    rule: str = "inclusive",
    rounds: int = 9,
    threads: int | None = None,
) -> list[tuple[float, float, int, int, int, int, int, int]]: ...
def vector_peak() -> tuple[int, float]: ...
def circle_directions(count: int) -> list[list[float]]: ...
def sphere_directions(count: int) -> list[list[float]]: ...
def encode_png(picture: NDArray[np.uint8]) -> bytes: ...
