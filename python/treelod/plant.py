"""
What a plant is to a Python program: wood, foliage and materials, lit once.

The arrays live in the Rust core. Each array that is read here is copied out once, kept, and marked
read-only: a plant never changes, and everything built from it relies on that.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from numbers import Real
from typing import Literal, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from treelod import _core
from treelod.mesh_arrays import as_indices, mesh_arrays
from treelod.plant_content import content_digest, core_from_bytes, core_to_bytes

__all__ = ["Foliage", "Lighting", "Material", "Mesh", "Plant"]

Vec3 = tuple[float, float, float]
Wrap = Literal["repeat", "mirror", "clamp"]


@dataclass(frozen=True, kw_only=True)
class Lighting:
    """
    A sun, a sky above and a ground below, which light a plant once and for all.

    Colours are linear RGB of at least 0. If a white leaf that faces the sun would be brighter than
    1, everything is scaled down until it is 1.

    Parameters
    ----------
    sun_direction : tuple of 3 floats
        Points to the sun; any length above 0.
    sun : tuple of 3 floats
        Irradiance of a surface that faces the sun.
    sky : tuple of 3 floats
        Irradiance of a surface that faces up, without the sun.
    ground : tuple of 3 floats
        Irradiance of a surface that faces down.
    translucency : float
        Share of the light that goes through a leaf, in [0, 1]. Wood lets none through.
    occlusion : float
        How much of the sky's and the ground's light the plant keeps from itself, in [0, 1]. Each is
        multiplied by ``1 - occlusion * (1 - v)``, ``v`` the share of it that this side of a vertex
        sees past the rest of the plant [1]_; the sun's light is not changed. 0 is off and costs
        nothing.

    Notes
    -----
    For `occlusion` the plant counts as a cloud: its box is cut into cubes, 64 along its longest
    side, and a cube dims light by half the area of the leaves in it (a quarter of that of the wood)
    over its volume. Along 64 fixed directions from each vertex's cube, that one and its neighbours
    left out, ``exp(-depth)`` gets through. It takes
    0.3 s of processor time for the chestnut and 9 s for one of a million leaves.

    References
    ----------
    .. [1] K. Hegeman, S. Premoze, M. Ashikhmin, G. Drettakis. Approximate ambient occlusion for
       trees. Symposium on Interactive 3D Graphics and Games 2006.
    """

    sun_direction: Vec3 = (0.45, 0.77, 0.45)
    sun: Vec3 = (1.0, 0.95, 0.85)
    sky: Vec3 = (0.32, 0.38, 0.48)
    ground: Vec3 = (0.12, 0.11, 0.09)
    translucency: float = 0.25
    occlusion: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no number; the core refuses numbers out of range."""
        for name in ("sun_direction", "sun", "sky", "ground"):
            value = getattr(self, name)
            parts = [] if isinstance(value, str) else value
            if not (np.iterable(parts) and [*map(_is_number, parts)] == [True] * 3):
                msg = f"{name} must be 3 numbers, got {value!r}"
                raise TypeError(msg)
        for name in ("translucency", "occlusion"):
            value = getattr(self, name)
            if not _is_number(value):
                msg = f"{name} must be a number, got {value!r}"
                raise TypeError(msg)

    def _facts(self) -> "_core._LightingFacts":
        return cast("_core._LightingFacts", asdict(self))


@dataclass(frozen=True, kw_only=True, eq=False)
class Material:
    """
    How the triangles of one material are coloured.

    Parameters
    ----------
    name : str
        As in the file.
    texture : ndarray of shape (H, W, 4), dtype uint8, optional
        sRGB with straight alpha, row 0 on top; multiplies the vertex colour. At most 16384 a side
        and 2**26 texels.
    wrap : pair of {'repeat', 'mirror', 'clamp'}
        What texture coordinates outside [0, 1] read, for u and v.
    alpha_mode : {'opaque', 'mask', 'blend'}
        What alpha means.
    alpha_cutoff : float
        With 'mask', drawn where alpha is at least this.
    double_sided : bool
        As in the file; both sides are always drawn.
    """

    name: str
    texture: NDArray[np.uint8] | None = field(default=None, repr=False)
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")
    alpha_mode: Literal["opaque", "mask", "blend"] = "opaque"
    alpha_cutoff: float = 0.5
    double_sided: bool = True

    def _facts(self) -> "_core._MaterialFacts":
        texture = None if self.texture is None else np.ascontiguousarray(self.texture)
        return {
            "name": self.name,
            "texture": texture,
            "wrap": self.wrap,
            "alpha_mode": self.alpha_mode,
            "alpha_cutoff": self.alpha_cutoff,
            "double_sided": self.double_sided,
        }


@dataclass(frozen=True, eq=False, repr=False)
class Mesh:
    """
    Triangles with everything that drawing them needs; all arrays are read-only.

    Attributes
    ----------
    positions : ndarray of shape (V, 3), dtype float32
        Metres, relative to `Plant.origin`.
    normals : ndarray of shape (V, 3), dtype float32
        Unit length, or zero where none is known.
    uvs : ndarray of shape (V, 2), dtype float32
        Texture coordinates, v = 0 on the texture's top row.
    base : ndarray of shape (V, 4), dtype float32
        Linear base colour with straight alpha, without the texture.
    front, back : ndarray of shape (V, 3), dtype float32
        Lit linear colour of the side whose corners run counter-clockwise, and of the other.
    triangles : ndarray of shape (T, 3), dtype uint32
        Corner indices.
    material_ids : ndarray of shape (T,), dtype uint32
        Indices into `Plant.materials`.
    """

    positions: NDArray[np.float32]
    normals: NDArray[np.float32]
    uvs: NDArray[np.float32]
    base: NDArray[np.float32]
    front: NDArray[np.float32]
    back: NDArray[np.float32]
    triangles: NDArray[np.uint32]
    material_ids: NDArray[np.uint32]

    def __repr__(self) -> str:
        return f"Mesh({len(self.positions)} vertices, {len(self.triangles)} triangles)"


@dataclass(frozen=True, eq=False, repr=False)
class Foliage:
    """
    The leaves: a mesh in which leaf ``i`` is triangles ``leaf_offsets[i]:leaf_offsets[i + 1]``.

    Attributes
    ----------
    mesh : Mesh
        Per-vertex arrays, the lit colours and per-vertex normals among them.
    leaf_offsets : ndarray of shape (L + 1,), dtype uint32
        Rises from 0 to the triangle count.
    centers : ndarray of shape (L, 3), dtype float32
        Area-weighted centroids, in metres relative to `Plant.origin`.
    normals : ndarray of shape (L, 3), dtype float32
        Unit length, or zero for a leaf without area. Triangles on the far side count with the sign
        of the leaf's largest triangle.
    areas : ndarray of shape (L,), dtype float32
        Square metres.
    """

    mesh: Mesh
    leaf_offsets: NDArray[np.uint32]
    centers: NDArray[np.float32]
    normals: NDArray[np.float32]
    areas: NDArray[np.float32]
    _core: "_core.Plant" = field(repr=False)

    @cached_property
    def rectangles(self) -> NDArray[np.float64]:
        """
        Corners of the rectangle of least area around each leaf, shape (L, 4, 3), float64.

        Metres relative to `Plant.origin`; counter-clockwise as seen by whom the leaf's normal
        points to, the first side a longer one. A leaf's vertices are projected onto the plane
        through its centre and across its normal. Without a normal, its plane is spanned by the
        directions in which its vertices spread, and the order may be either. A leaf on a line has
        a rectangle without height, one in a point four equal corners.

        Computed when first asked for: 4 s of processor time for a million leaves of ten triangles.
        """
        return _frozen(self._core.leaf_rectangles())

    @property
    def leaf_count(self) -> int:
        """How many leaves there are."""
        return len(self.areas)

    @property
    def positions(self) -> NDArray[np.float32]:
        """``mesh.positions``: metres relative to `Plant.origin`, shape (V, 3)."""
        return self.mesh.positions

    @property
    def triangles(self) -> NDArray[np.uint32]:
        """``mesh.triangles``: corner indices, shape (T, 3)."""
        return self.mesh.triangles

    def __repr__(self) -> str:
        return f"Foliage({self.leaf_count} leaves, {len(self.triangles)} triangles)"


@dataclass(frozen=True)
class Tally:
    """How many connected pieces of a material were classed as they were for one reason."""

    material: int
    reason: str
    piece_count: int
    triangle_count: int


_REASONS = {
    "named": ("foliage", "named as foliage"),
    "cutout": ("foliage", "its texture cuts it out"),
    "sheet": ("foliage", "open sheets"),
    "thin": ("foliage", "flat, or with two faces"),
    "small": ("foliage", "solid but small"),
    "limb": ("wood", "solid, with a limb among them"),
    "unnamed": ("wood", "not named as foliage"),
}


class Plant:
    """
    A plant: wood and foliage, lit once. Made by the loaders or by `from_arrays`; never changes.

    Coordinates are metres, right-handed, y up. Positions are stored relative to `origin`, which is
    (0, 0, 0) unless the plant stands so far away that 32-bit floats would lose its detail.
    """

    def __init__(self, core: _core.Plant, tallies: Sequence[Tally] = ()) -> None:
        self._core = core
        self._tallies = tuple(tallies)

    @classmethod
    def from_mesh(
        cls,
        mesh: Mapping[str, ArrayLike],
        *,
        foliage_mask: ArrayLike | None = None,
        materials: Sequence[Material] | None = None,
        name: str = "plant",
        origin: Vec3 = (0.0, 0.0, 0.0),
        lighting: Lighting | None = None,
    ) -> "Plant":
        """
        Make a plant from one mesh, and tell its wood from its leaves.

        Parameters
        ----------
        mesh : mapping of str to array_like
            As `wood` and `foliage` of `from_arrays`.
        foliage_mask : array_like of shape (T,), dtype bool, optional
            Which triangles are foliage. Default: connected pieces are classed by shape and alpha,
            as `load_plant` says.
        materials : sequence of Material, optional
            Default: one opaque white one.
        name : str
            For tables and file names.
        origin : tuple of 3 floats
            World position that the positions are relative to.
        lighting : Lighting, optional
            Default: ``Lighting()``.

        Returns
        -------
        Plant
            Its leaves are the connected pieces of foliage, by material, then in order of their
            first triangle.

        Raises
        ------
        ValueError
            As `from_arrays`, and if `foliage_mask` has not one value a triangle.

        Notes
        -----
        Near-linear time: a million leaves of two triangles take 2.6 s on two cores.

        Examples
        --------
        >>> corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [6, 0, 0], [5, 1, 0]]
        >>> plant = Plant.from_mesh({"positions": corners, "triangles": [[0, 1, 2], [3, 4, 5]]})
        >>> plant.foliage.leaf_count
        2
        """
        mask = None
        if foliage_mask is not None:
            mask = np.ascontiguousarray(foliage_mask, dtype=np.bool_)
            if mask.ndim != 1:
                msg = f"foliage_mask must have shape (T,), got {mask.shape}"
                raise ValueError(msg)
        core, tallies = _core.split_plant(
            name,
            origin,
            [material._facts() for material in materials or [Material(name="default")]],
            mesh_arrays("mesh", mesh),
            mask,
            (lighting or Lighting())._facts(),
        )
        return cls(core, [Tally(*row) for row in tallies])

    @classmethod
    def from_arrays(
        cls,
        *,
        wood: Mapping[str, ArrayLike] | None = None,
        foliage: Mapping[str, ArrayLike] | None = None,
        leaf_offsets: ArrayLike | None = None,
        materials: Sequence[Material] | None = None,
        name: str = "plant",
        origin: Vec3 = (0.0, 0.0, 0.0),
        lighting: Lighting | None = None,
    ) -> "Plant":
        """
        Make a plant from meshes that are already told apart.

        Parameters
        ----------
        wood, foliage : mapping of str to array_like, optional
            The arrays of a mesh: ``positions`` (V, 3) in metres relative to `origin` and
            ``triangles`` (T, 3); if wanted also ``normals`` (V, 3; default: smooth, weighted by
            area), ``uvs`` (V, 2; default 0), ``colors`` (V, 4) or (V, 3), linear with straight
            alpha (default white), ``material_ids`` (T,; default 0).
        leaf_offsets : array_like of shape (L + 1,), optional
            Leaf ``i`` is triangles ``leaf_offsets[i]:leaf_offsets[i + 1]``: rises from 0 to the
            triangle count. Required with `foliage`.
        materials : sequence of Material, optional
            Default: one opaque white one.
        name : str
            For tables and file names.
        origin : tuple of 3 floats
            World position that the positions are relative to.
        lighting : Lighting, optional
            Default: ``Lighting()``.

        Returns
        -------
        Plant

        Raises
        ------
        ValueError
            If there is no triangle, or an array has another shape than stated, holds NaN or
            infinity, or an index out of range; the message names the array.

        Examples
        --------
        >>> square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
        >>> quad = {"positions": square, "triangles": [[0, 1, 2], [0, 2, 3]]}
        >>> plant = Plant.from_arrays(foliage=quad, leaf_offsets=[0, 2])
        >>> plant.foliage.areas.tolist(), plant.foliage.normals.tolist()
        ([1.0], [[0.0, 0.0, 1.0]])
        """
        if foliage is not None and leaf_offsets is None:
            msg = "leaf_offsets is required with foliage"
            raise ValueError(msg)
        if foliage is None and leaf_offsets is not None:
            msg = "leaf_offsets without foliage"
            raise ValueError(msg)
        offsets = np.asarray([0] if leaf_offsets is None else leaf_offsets)
        core = _core.Plant(
            name,
            origin,
            [material._facts() for material in materials or [Material(name="default")]],
            mesh_arrays("wood", wood),
            mesh_arrays("foliage", foliage),
            as_indices("leaf_offsets", offsets, 1),
            (lighting or Lighting())._facts(),
        )
        return cls(core)

    @property
    def name(self) -> str:
        """For tables and file names."""
        return self._core.name

    @property
    def triangle_count(self) -> int:
        """Triangles of wood and foliage together."""
        return self._core.triangle_count

    @cached_property
    def bounds(self) -> NDArray[np.float64]:
        """Lowest and highest corner of the box around the plant, world metres, shape (2, 3)."""
        return _frozen(np.array(self._core.bounds))

    @cached_property
    def origin(self) -> NDArray[np.float64]:
        """World position that all positions are relative to, shape (3,)."""
        return _frozen(np.array(self._core.origin))

    @cached_property
    def sphere(self) -> tuple[NDArray[np.float64], float]:
        """Centre of the box (world, shape (3,)) and largest distance of the plant from it."""
        center, radius = self._core.sphere
        return _frozen(np.array(center)), radius

    @cached_property
    def wood(self) -> Mesh:
        """Trunk and limbs; may have no triangle."""
        return _mesh(self._core.wood)

    @cached_property
    def foliage(self) -> Foliage:
        """The leaves; there may be none."""
        offsets, centers, normals, areas = self._core.leaves
        return Foliage(
            mesh=_mesh(self._core.foliage),
            leaf_offsets=_frozen(offsets),
            centers=_frozen(centers),
            normals=_frozen(normals),
            areas=_frozen(areas),
            _core=self._core,
        )

    @cached_property
    def materials(self) -> tuple[Material, ...]:
        """Shared by wood and foliage; ``material_ids`` index it."""
        materials = []
        for facts in self._core.materials:
            texture = facts["texture"]
            frozen = None if texture is None else _frozen(texture)
            materials.append(Material(**{**facts, "texture": frozen}))  # type: ignore[arg-type]
        return tuple(materials)

    @cached_property
    def lighting(self) -> Lighting:
        """What the front and back colours were computed from."""
        facts = self._core.lighting
        return Lighting(
            sun_direction=_vec3(facts["sun_direction"]),
            sun=_vec3(facts["sun"]),
            sky=_vec3(facts["sky"]),
            ground=_vec3(facts["ground"]),
            translucency=facts["translucency"],
            occlusion=facts["occlusion"],
        )

    @cached_property
    def digest(self) -> str:
        """
        Names all that the plant draws: SHA-256 in 64 hexadecimal digits.

        Of meshes, leaves, branches, materials, textures, light and origin; the plant's name does
        not count. Computed when first asked for: 0.1 s for the chestnut.
        """
        return content_digest(self._core)

    def to_bytes(self) -> bytes:
        """
        Write the plant down, to be read by `from_bytes` in another process or later.

        Returns
        -------
        bytes
            An uncompressed NumPy archive. Pickling a plant gives the same.
        """
        return core_to_bytes(self._core, [asdict(tally) for tally in self._tallies])

    @classmethod
    def from_bytes(cls, data: bytes) -> "Plant":
        """
        Read a plant that `to_bytes` has written.

        Parameters
        ----------
        data : bytes
            What it returned. It is read as data: nothing in it is executed.

        Returns
        -------
        Plant
            The same plant: every picture of it has the same bytes.

        Raises
        ------
        StoreError
            If it is no plant, or damaged.
        """
        core, tallies = core_from_bytes(data)
        return cls(core, [Tally(**tally) for tally in tallies])

    def __reduce__(self) -> tuple[Callable[[bytes], "Plant"], tuple[bytes]]:
        return Plant.from_bytes, (self.to_bytes(),)

    def lit(
        self,
        lighting: Lighting,
        *,
        threads: int | None = None,
        progress: Callable[[int, int], object] | None = None,
    ) -> "Plant":
        """
        Give the same plant under other light.

        Parameters
        ----------
        lighting : Lighting
            Replaces the light that the plant has.
        threads : int, optional
            In ``1..=1024``. Default: ``TREELOD_NUM_THREADS``, else all cores. The colours do not
            depend on it.
        progress : callable, optional
            Called as ``progress(done, total)`` while occlusion is computed; what it raises stops
            the call.

        Returns
        -------
        Plant
            A new plant; this one stays as it is.

        Raises
        ------
        ValueError
            If a colour is negative or not finite, the sun's direction is zero, or the translucency
            or the occlusion lies outside [0, 1]; if `threads` is out of range.
        """
        core = self._core.lit(lighting._facts(), threads=threads, progress=progress)
        return Plant(core, self._tallies)

    def summary(self) -> str:
        """
        Say what the plant consists of, and why its materials count as wood or foliage.

        Returns
        -------
        str
            A few lines of text, without a line end at the end.
        """
        size = self.bounds[1] - self.bounds[0]
        wood_count = len(self.wood.triangles)
        areas = self.foliage.areas
        lines = [
            f"{self.name}: {self.triangle_count:,} triangles, "
            f"{size[0]:.4g} x {size[1]:.4g} x {size[2]:.4g} m (x, y, z)",
            f"  foliage: {_plural(self.foliage.leaf_count, 'leaf', 'leaves')}, "
            f"{_plural(len(self.foliage.triangles), 'triangle')}",
            f"  wood: {_plural(wood_count, 'triangle')}",
        ]
        if len(areas):
            lines[1] += (
                f", {areas.sum(dtype=np.float64):.4g} m2, median leaf {np.median(areas):.4g} m2"
            )
        rows = []
        for tally in self._tallies:
            material = self.materials[tally.material]
            kind, why = _REASONS[tally.reason]
            pieces = ("leaf", "leaves") if kind == "foliage" else ("piece", "pieces")
            rows.append(
                (
                    material.name,
                    kind,
                    _plural(tally.piece_count, *pieces),
                    _plural(tally.triangle_count, "triangle"),
                    f"{why}; {_surface(material)}",
                )
            )
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        for row in rows:
            cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=True)]
            lines.append("    " + "  ".join(cells).rstrip())
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"<Plant {self.name!r}: {self.triangle_count} triangles>"


def _plural(count: int, one: str, many: str | None = None) -> str:
    return f"{count:,} {one if count == 1 else many or one + 's'}"


def _surface(material: Material) -> str:
    """Say what a material looks like, in a few words."""
    words: str = material.alpha_mode
    if material.alpha_mode == "mask":
        words += f" at {material.alpha_cutoff:.3g}"
    if material.texture is None:
        return f"{words}, no texture"
    height, width = material.texture.shape[:2]
    return f"{words}, texture {width} x {height}"


Scalar = TypeVar("Scalar", bound=np.generic)


def _frozen(array: NDArray[Scalar]) -> NDArray[Scalar]:
    array.flags.writeable = False
    return array


def _is_number(value: object) -> bool:
    return isinstance(value, Real)


def _vec3(values: Sequence[float]) -> Vec3:
    x, y, z = values
    return (x, y, z)


def _mesh(arrays: "_core._LitMeshArrays") -> Mesh:
    return Mesh(**{name: _frozen(array) for name, array in arrays.items()})  # type: ignore[arg-type]
