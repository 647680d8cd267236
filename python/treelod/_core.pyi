from collections.abc import Callable, Sequence
from typing import Final, TypedDict, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Plant",
    "__version__",
    "_panic_for_test",
    "_spin_for_test",
    "build_profile",
    "grow",
    "preset_names",
    "smooth_normals",
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

class _MeshArrays(TypedDict):
    positions: _F32
    normals: _F32
    uvs: _F32
    colors: _F32
    triangles: _U32
    material_ids: _U32

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
    ) -> Plant: ...
    def lit(self, lighting: _LightingFacts) -> Plant: ...
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

def grow(preset: str, seed: int, leaf_count: int | None, lighting: _LightingFacts) -> Plant: ...
def preset_names() -> list[str]: ...
def smooth_normals(positions: _F32, triangles: _U32) -> _F32: ...
def _panic_for_test() -> None: ...
def _spin_for_test(
    secs: float,
    *,
    threads: int | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> None: ...
