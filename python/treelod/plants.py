"""
What a plant is to a Python program: wood, foliage and materials, lit once; and how to load one.

The arrays live in the Rust core. Each array that is read here is copied out once, kept, and marked
read-only: a plant never changes, and everything built from it relies on that.
"""

import operator
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from treelod import _core
from treelod.plant_files import Model, Piece, read

__all__ = [
    "PRESETS",
    "Foliage",
    "Lighting",
    "Material",
    "Mesh",
    "Plant",
    "grow_plant",
    "load_plant",
]

Vec3 = tuple[float, float, float]
Wrap = Literal["repeat", "mirror", "clamp"]

PRESETS: tuple[str, ...] = tuple(_core.preset_names())
"""Plants that `grow_plant` knows."""


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
            _mesh_arrays("mesh", mesh),
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
            _mesh_arrays("wood", wood),
            _mesh_arrays("foliage", foliage),
            _as_indices("leaf_offsets", offsets, 1),
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


def grow_plant(
    preset: str,
    *,
    seed: int = 1,
    leaf_count: int | None = None,
    lighting: Lighting | None = None,
) -> Plant:
    """
    Grow a plant: the same one for the same arguments, on every machine.

    Parameters
    ----------
    preset : str
        One of `PRESETS`: the trees ``"chestnut"``, ``"broadleaf"``, ``"grove"``, ``"pine"`` and
        ``"palm"``, the flowers ``"sunflower"`` and ``"daisy"``, and ``"grass"``.
        ``docs/plants.md`` has a table of their sizes and counts, and a picture.
    seed : int, default 1
        In ``0..2**64 - 1``. Another seed gives another plant with the same foliage counts; the
        wood's may differ, by at most 1 % (30 % for a grove, whose solid wood has no twigs).
    leaf_count : int, optional
        Elements of the foliage, at most 5,000,000, met exactly; the wood stays the same. Default:
        the preset's. Twigs of a grove and leaves, rays and bracts of flowers come in fixed numbers
        and count too; the rest is leaves, florets of flowers, blades of grass, and at least one.
        Leaves in excess of the preset's number are smaller, so that the leaf area stays.
    lighting : Lighting, optional
        Default: ``Lighting()``.

    Returns
    -------
    Plant
        In metres, y up, the foot at the origin, without textures. Materials ``wood`` and
        ``leaves`` (trees), ``stems``, ``leaves`` and ``flowers`` (flowers), or ``leaves`` (grass,
        which has no wood).

    Raises
    ------
    ValueError
        If `preset` is unknown (the message lists all), `seed` or `leaf_count` is out of range, or
        the lighting is.

    Notes
    -----
    Stems bend, fork and bear side branches after Weber and Penn [1]_; the crown's outline, the
    leaves' number and the wood's are given instead of following from the branches' numbers.
    Florets sit in Vogel's spiral [2]_.

    References
    ----------
    .. [1] J. Weber and J. Penn. Creation and rendering of realistic trees. SIGGRAPH 1995.
    .. [2] H. Vogel. A better way to construct the sunflower head. Mathematical Biosciences 44,
       1979.

    Examples
    --------
    >>> plant = grow_plant("chestnut", leaf_count=500)
    >>> plant.foliage.leaf_count, len(plant.foliage.triangles)
    (500, 5000)
    """
    seed = operator.index(seed)
    if not 0 <= seed < 2**64:
        msg = f"seed must be in [0, 2**64 - 1], got {seed}"
        raise ValueError(msg)
    if leaf_count is not None:
        leaf_count = operator.index(leaf_count)
        # what does not even fit the core's integers; the limit itself is the core's
        if not 0 <= leaf_count < 2**63:
            msg = f"leaf_count must be at least 1 and at most 5000000, got {leaf_count}"
            raise ValueError(msg)
    facts = (lighting or Lighting())._facts()
    return Plant(_core.grow(preset, seed, leaf_count, facts))


def load_plant(
    path: str | os.PathLike[str],
    foliage: Sequence[str] | None = None,
    *,
    unit: float = 1.0,
    up: Literal["x", "y", "z"] = "y",
    lighting: Lighting | None = None,
) -> Plant:
    """
    Load a plant from a GLB, glTF, OBJ or PLY file, and tell its wood from its leaves.

    Parameters
    ----------
    path : path-like
        The file. Pictures and buffers that it names must lie in its folder or below.
    foliage : sequence of str, optional
        Names of materials or meshes (objects in OBJ, the file's stem in PLY) that are foliage;
        everything else is wood, and an empty sequence makes all of it wood. Default: automatic, see
        Notes.
    unit : float
        Metres per unit of the file, in [1e-6, 1e6]. glTF is in metres by definition; its authors
        differ.
    up : {'y', 'z', 'x'}
        Axis of the file that points up; the plant is turned so that it becomes y.
    lighting : Lighting, optional
        Default: ``Lighting()``.

    Returns
    -------
    Plant
        Its `Plant.summary` tells what was classed as what, and why.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    PlantFileError
        If the file is damaged, refused, of a kind that is not read, or holds no triangles. The
        message names the file and what is wrong in it. Refused are paths out of the file's folder,
        pictures above 16384 a side or 2**26 texels, and required extensions that are not read.
    LimitError
        If the file holds more than 2**25 triangles, instances counted, or 2**17 nodes.
    ValueError
        If a name in `foliage` is neither a material nor a mesh, or `unit` or `up` is out of range.

    Warns
    -----
    UserWarning
        If something that the file holds is ignored: points and lines beside triangles,
        KHR_materials_transmission, undefined OBJ materials.

    Notes
    -----
    Read are positions, normals (else smooth ones, weighted by area), one set of texture
    coordinates, vertex colours, base colour texture and factor, alpha mode, cutoff and wrap; scene
    transforms and instances (EXT_mesh_gpu_instancing) are applied. Skins and morph targets stay at
    rest.

    The automatic split classes connected pieces (triangles of a material that share positions). A
    piece is a leaf if its texture cuts it out (texels it uses lie below the cutoff, whatever the
    alpha mode says), if it is an open sheet, or if it is flat or has two faces. The rest is solid:
    wood if the largest solid of its material is at least a tenth of the plant, else buds, fruit or
    needles, which count as foliage. Crowns modelled as large closed blobs are solid: name them.

    Vertex colours of PLY and OBJ are taken as sRGB, those of glTF are linear by definition. OBJ's
    Kd is linear and ignored beside a map_Kd.

    Examples
    --------
    >>> load_plant("no/such/tree.glb")
    Traceback (most recent call last):
    FileNotFoundError: [Errno 2] No such file or directory: 'no/such/tree.glb'
    """
    if isinstance(foliage, str):
        msg = f"foliage must be a sequence of names, got the text {foliage!r}"
        raise TypeError(msg)
    if not (isinstance(unit, (int, float)) and 1e-6 <= unit <= 1e6):
        msg = f"unit must be a number in [1e-6, 1e6], got {unit!r}"
        raise ValueError(msg)
    if up not in _UPRIGHT:
        msg = f"up must be 'x', 'y' or 'z', got {up!r}"
        raise ValueError(msg)
    model = read(path)
    mask = None if foliage is None else _named_triangles(model, foliage)
    turn = _UPRIGHT[up] * float(unit)
    is_turned = not np.array_equal(turn, np.eye(3))
    positions = [p.positions @ turn.T if is_turned else p.positions for p in model.pieces]
    origin = _origin(positions, model)
    materials = [
        Material(
            name=facts.name,
            texture=facts.texture,
            wrap=facts.wrap,
            alpha_mode=facts.alpha_mode,
            alpha_cutoff=facts.alpha_cutoff,
            double_sided=facts.double_sided,
        )
        for facts in model.materials
    ]
    return Plant.from_mesh(
        _joined(model, positions, origin, turn),
        foliage_mask=mask,
        materials=materials,
        name=Path(path).stem,
        origin=_vec3(origin.tolist()),
        lighting=lighting,
    )


_UPRIGHT = {
    "x": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "y": np.eye(3),
    "z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
}
"""Turns that bring an axis up to y."""

_FAR_RADII = 8
"""Farther than so many bounding radii from the world's origin, positions get an origin of their
own: up to here a 32-bit float keeps at least a millionth of the plant's size."""


def _origin(positions: list[NDArray[np.float64]], model: Model) -> NDArray[np.float64]:
    used = [
        p[piece.triangles].reshape(-1, 3) for p, piece in zip(positions, model.pieces, strict=True)
    ]
    used = [corners for corners in used if len(corners)]
    low = np.min([corners.min(axis=0) for corners in used], axis=0)
    high = np.max([corners.max(axis=0) for corners in used], axis=0)
    center: NDArray[np.float64] = (low + high) / 2
    radius = np.linalg.norm(high - low) / 2
    is_far = np.linalg.norm(center) > _FAR_RADII * radius
    return center if is_far else np.zeros(3)


def _named_triangles(model: Model, foliage: Sequence[str]) -> NDArray[np.bool_]:
    known = {facts.name for facts in model.materials} | {piece.mesh for piece in model.pieces}
    unknown = sorted(set(foliage) - known)
    if unknown:
        msg = (
            f"foliage: no material or mesh is named {', '.join(map(repr, unknown))}; "
            f"there are {', '.join(map(repr, sorted(known)))}"
        )
        raise ValueError(msg)
    chosen = set(foliage)
    return np.concatenate(
        [
            np.full(
                len(piece.triangles),
                piece.mesh in chosen or model.materials[piece.material].name in chosen,
            )
            for piece in model.pieces
        ]
    )


def _joined(
    model: Model,
    positions: list[NDArray[np.float64]],
    origin: NDArray[np.float64],
    turn: NDArray[np.float64],
) -> dict[str, ArrayLike]:
    """All pieces as one mesh, relative to the origin."""
    counts = [len(piece.positions) for piece in model.pieces]
    starts = np.cumsum([0, *counts[:-1]])
    local = [(p - origin).astype(np.float32) for p in positions]
    triangles = [piece.triangles + start for piece, start in zip(model.pieces, starts, strict=True)]
    uvs = [
        np.zeros((count, 2), np.float32) if piece.uvs is None else piece.uvs
        for piece, count in zip(model.pieces, counts, strict=True)
    ]
    ids = [np.full(len(piece.triangles), piece.material, np.uint32) for piece in model.pieces]
    normals = [_normals(piece, p, turn) for piece, p in zip(model.pieces, local, strict=True)]
    return {
        "positions": np.concatenate(local),
        "triangles": np.concatenate(triangles).astype(np.uint32),
        "normals": np.concatenate(normals),
        "uvs": np.concatenate(uvs),
        "colors": np.concatenate([piece.colors for piece in model.pieces]),
        "material_ids": np.concatenate(ids),
    }


def _normals(
    piece: Piece, positions: NDArray[np.float32], turn: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return unit normals: the file's where it has any, else smooth ones."""
    triangles = piece.triangles.astype(np.uint32)
    if piece.normals is None:
        return _core.smooth_normals(positions, triangles)
    turned = piece.normals @ turn.T
    lengths = np.linalg.norm(turned, axis=1, keepdims=True)
    if not ((lengths > 1e-100) & (lengths < 1e100)).all():
        # squares of tiny and huge normals leave the range; zero ones have no direction
        scale = np.abs(turned).max(axis=1, keepdims=True)
        turned = turned / np.where(scale > 0, scale, 1)
        lengths = np.linalg.norm(turned, axis=1, keepdims=True)
        missing = lengths[:, 0] == 0
        if missing.any():
            turned[missing] = _core.smooth_normals(positions, triangles)[missing]
            lengths[missing] = 1
    units: NDArray[np.float32] = (turned / lengths).astype(np.float32)
    return units


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


def _vec3(values: Sequence[float]) -> Vec3:
    x, y, z = values
    return (x, y, z)


def _mesh(arrays: "_core._LitMeshArrays") -> Mesh:
    return Mesh(**{name: _frozen(array) for name, array in arrays.items()})  # type: ignore[arg-type]


def _as_floats(name: str, array: ArrayLike, width: int) -> NDArray[np.float32]:
    floats = np.ascontiguousarray(array, dtype=np.float32)
    if floats.ndim != 2 or floats.shape[1] != width:
        msg = f"{name} must have shape (N, {width}), got {floats.shape}"
        raise ValueError(msg)
    return floats


def _as_indices(name: str, array: ArrayLike, ndim: int) -> NDArray[np.uint32]:
    values = np.asarray(array)
    if values.ndim != ndim or (ndim == 2 and values.shape[1] != 3):
        shape = "(N, 3)" if ndim == 2 else "(N,)"
        msg = f"{name} must have shape {shape}, got {values.shape}"
        raise ValueError(msg)
    if values.size and not np.issubdtype(values.dtype, np.integer):
        msg = f"{name} must be integers, got {values.dtype}"
        raise ValueError(msg)
    if values.size and (values.min() < 0 or values.max() >= 2**32):
        msg = f"{name} must be in [0, 2**32), got {values.min()} to {values.max()}"
        raise ValueError(msg)
    return np.ascontiguousarray(values, dtype=np.uint32)


_MESH_KEYS = {"positions", "triangles", "normals", "uvs", "colors", "material_ids"}


def _mesh_arrays(part: str, mesh: Mapping[str, ArrayLike] | None) -> "_core._MeshArrays":
    if mesh is None:
        mesh = {"positions": np.empty((0, 3)), "triangles": np.empty((0, 3), np.uint32)}
    unknown = sorted(set(mesh) - _MESH_KEYS)
    missing = sorted({"positions", "triangles"} - set(mesh))
    if unknown or missing:
        msg = f"{part}: unknown arrays {unknown}, missing arrays {missing}"
        raise ValueError(msg)
    positions = _as_floats(f"{part} positions", mesh["positions"], 3)
    triangles = _as_indices(f"{part} triangles", mesh["triangles"], 2)
    colors = np.asarray(mesh.get("colors", np.ones((len(positions), 4))), dtype=np.float32)
    if colors.ndim == 2 and colors.shape[1] == 3:
        colors = np.column_stack([colors, np.ones(len(colors), np.float32)])
    normals = mesh.get("normals")
    return {
        "positions": positions,
        "normals": _core.smooth_normals(positions, triangles)
        if normals is None
        else _as_floats(f"{part} normals", normals, 3),
        "uvs": _as_floats(f"{part} uvs", mesh.get("uvs", np.zeros((len(positions), 2))), 2),
        "colors": _as_floats(f"{part} colors", colors, 4),
        "triangles": triangles,
        "material_ids": _as_indices(
            f"{part} material_ids", mesh.get("material_ids", np.zeros(len(triangles), np.uint32)), 1
        ),
    }
