"""
Which parts of a crown are drawn finer: what `FoliageHierarchy.view_dependent` is given.

A criterion marks nodes of the hierarchy as the *zone of interest*. Combine criteria with ``&``,
``|`` and ``~``, also with a function of your own.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from treelod.cameras import Camera

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = [
    "Criterion",
    "CriterionLike",
    "Nodes",
    "criterion_from",
    "distance",
    "frustum",
    "plane",
    "screen_size",
    "sphere",
]

MAX_DEPTH = 64
"""Criteria within one another."""

MAX_PART_COUNT = 1024
"""Criteria in one."""

MAX_COORDINATE = 1e18
"""Largest length in metres."""


class Nodes(NamedTuple):
    """
    All nodes of a hierarchy, as a function of one's own is given them. The arrays are read-only.

    The first L nodes are the leaves of the plant, in their order; the others are what collapses
    made, in the order of the collapses.

    Attributes
    ----------
    centers : ndarray of shape (N, 3), dtype float64
        Centre of each node's own quad, in metres, where the copy stands in the scene.
    ball_centers : ndarray of shape (N, 3), dtype float64
        Centre of a ball around each node and all that lies below it, in metres, in the scene.
    ball_radii : ndarray of shape (N,), dtype float64
        Radius of that ball in metres, in the scene.
    areas : ndarray of shape (N,), dtype float64
        Area of the plant's leaves below each node, in square metres of the plant itself.
    costs : ndarray of shape (N,), dtype float64
        Cost of the collapse that made each node; 0 for leaves.
    parents : ndarray of shape (N,), dtype int64
        What each node collapses into; -1 for a root.
    is_leaf : ndarray of shape (N,), dtype bool
        Whether a node is a leaf of the plant.
    """

    centers: NDArray[np.float64]
    ball_centers: NDArray[np.float64]
    ball_radii: NDArray[np.float64]
    areas: NDArray[np.float64]
    costs: NDArray[np.float64]
    parents: NDArray[np.int64]
    is_leaf: NDArray[np.bool_]


NodeFunction: TypeAlias = Callable[[Nodes, Camera], ArrayLike]


@dataclass(frozen=True)
class Criterion(ABC):
    """
    Which nodes are in the zone of interest; made by the functions of this module.

    ``a & b`` is where both are, ``a | b`` where any is, and ``~a`` where `a` is not. The other side
    may also be a function as in `criterion_from`.
    """

    def __and__(self, other: CriterionLike) -> Criterion:
        """Where both are."""
        return NotImplemented if not _is_like(other) else _joined(_And, self, other)

    def __rand__(self, other: CriterionLike) -> Criterion:
        """Where both are."""
        return NotImplemented if not _is_like(other) else _joined(_And, other, self)

    def __or__(self, other: CriterionLike) -> Criterion:
        """Where any is."""
        return NotImplemented if not _is_like(other) else _joined(_Or, self, other)

    def __ror__(self, other: CriterionLike) -> Criterion:
        """Where any is."""
        return NotImplemented if not _is_like(other) else _joined(_Or, other, self)

    def __invert__(self) -> Criterion:
        """Where it is not."""
        return self.part if isinstance(self, _Not) else _checked(_Not(self))

    def __bool__(self) -> bool:
        """Refuse ``and``, ``or`` and ``not``, which would drop half of what they join."""
        msg = "criteria are joined by & | ~, not by and, or, not"
        raise TypeError(msg)

    @property
    def parts(self) -> tuple[Criterion, ...]:
        """What it is combined of; empty for one that is not combined."""
        return ()

    @cached_property
    def _extent(self) -> tuple[int, int]:
        """How many criteria it is made of, itself included, and how deep they lie."""
        counts, depths = zip(*[part._extent for part in self.parts] or [(0, 0)], strict=True)
        return 1 + sum(counts), 1 + max(depths)

    @abstractmethod
    def _core(self) -> tuple[Any, ...]:
        """Name and numbers, or name and parts, as the core takes them."""


CriterionLike: TypeAlias = Criterion | NodeFunction
"""A criterion, or a function as in `criterion_from`."""


@dataclass(frozen=True)
class _Sphere(Criterion):
    center: tuple[float, float, float]
    radius: float
    inside: Literal["coarse", "fine"]
    growth: float

    def _core(self) -> tuple[Any, ...]:
        return "sphere", self.center, self.radius, self.inside == "fine", self.growth

    def __repr__(self) -> str:
        growth = f", growth={self.growth}" if self.growth else ""
        return f"sphere({self.center}, {self.radius}, inside={self.inside!r}{growth})"


@dataclass(frozen=True)
class _Plane(Criterion):
    point: tuple[float, float, float]
    normal: tuple[float, float, float]

    def _core(self) -> tuple[Any, ...]:
        return "plane", self.point, self.normal

    def __repr__(self) -> str:
        return f"plane({self.point}, {self.normal})"


@dataclass(frozen=True)
class _Frustum(Criterion):
    def _core(self) -> tuple[Any, ...]:
        return ("frustum",)

    def __repr__(self) -> str:
        return "frustum()"


@dataclass(frozen=True)
class _ScreenSize(Criterion):
    pixels: float

    def _core(self) -> tuple[Any, ...]:
        return "screen_size", self.pixels

    def __repr__(self) -> str:
        return f"screen_size({self.pixels})"


@dataclass(frozen=True)
class _Distance(Criterion):
    max_distance: float

    def _core(self) -> tuple[Any, ...]:
        return "distance", self.max_distance

    def __repr__(self) -> str:
        return f"distance({self.max_distance})"


@dataclass(frozen=True)
class _Function(Criterion):
    function: NodeFunction

    def _core(self) -> tuple[Any, ...]:
        return "function", self._answer

    def _answer(self, nodes: tuple[NDArray[Any], ...], camera: dict[str, Any]) -> NDArray[np.bool_]:
        """Call the function with what the core gives; check what it answers."""
        for array in nodes:
            array.flags.writeable = False
        named = Nodes(*nodes)
        answer = np.asarray(self.function(named, Camera(**camera)))
        count = len(named.centers)
        if answer.dtype != np.bool_ or answer.shape != (count,):
            msg = (
                f"criterion must return an array of shape ({count},) and dtype bool, "
                f"got shape {answer.shape} and dtype {answer.dtype}"
            )
            raise ValueError(msg)
        return np.ascontiguousarray(answer)

    def __repr__(self) -> str:
        return getattr(self.function, "__qualname__", repr(self.function))


@dataclass(frozen=True)
class _And(Criterion):
    both: tuple[Criterion, ...]

    @property
    def parts(self) -> tuple[Criterion, ...]:
        return self.both

    def _core(self) -> tuple[Any, ...]:
        return "and", [part._core() for part in self.both]

    def __repr__(self) -> str:
        return "(" + " & ".join(map(repr, self.both)) + ")"


@dataclass(frozen=True)
class _Or(Criterion):
    any: tuple[Criterion, ...]

    @property
    def parts(self) -> tuple[Criterion, ...]:
        return self.any

    def _core(self) -> tuple[Any, ...]:
        return "or", [part._core() for part in self.any]

    def __repr__(self) -> str:
        return "(" + " | ".join(map(repr, self.any)) + ")"


@dataclass(frozen=True)
class _Not(Criterion):
    part: Criterion

    @property
    def parts(self) -> tuple[Criterion, ...]:
        return (self.part,)

    def _core(self) -> tuple[Any, ...]:
        return "not", self.part._core()

    def __repr__(self) -> str:
        return f"~{self.part!r}"


def sphere(
    center: Sequence[float] | NDArray[Any],
    radius: float,
    *,
    inside: Literal["coarse", "fine"] = "coarse",
    growth: float = 0.0,
) -> Criterion:
    """
    Mark the inside or the outside of a sphere.

    A node is inside if the centre of its own quad is, the surface included.

    Parameters
    ----------
    center : sequence of 3 floats
        Where the plant stands as its file has it, in metres. A copy in a scene takes its sphere
        along.
    radius : float
        In metres, at least 0.
    inside : {"coarse", "fine"}, default "coarse"
        What is drawn finer: with "coarse" the outside, as in the paper [1]_; with "fine" the
        inside.
    growth : float, default 0
        Metres by which the radius grows for each metre between the eye and `center`, at least 0.
        In a copy of another size both are metres of the plant itself, so that a plant of twice the
        size seen from twice as far looks the same.

    Returns
    -------
    Criterion
        To be combined, or given to `FoliageHierarchy.view_dependent`.

    Raises
    ------
    ValueError
        If a number is out of range or not finite.

    References
    ----------
    .. [1] I. Remolar, M. Chover, J. Ribelles, O. Belmonte. View-Dependent Multiresolution Model for
       Foliage. Journal of WSCG 11(1), 2003.

    Examples
    --------
    >>> from treelod import criteria
    >>> criteria.sphere((0, 4, 0), 2.5, growth=0.1)
    sphere((0.0, 4.0, 0.0), 2.5, inside='coarse', growth=0.1)
    """
    if inside not in ("coarse", "fine"):
        msg = f"inside must be 'coarse' or 'fine', got {inside!r}"
        raise ValueError(msg)
    place = _vector("center", center)
    return _Sphere(place, _length("radius", radius), inside, _length("growth", growth))


def plane(
    point: Sequence[float] | NDArray[Any], normal: Sequence[float] | NDArray[Any]
) -> Criterion:
    """
    Mark one side of a plane: that which the normal points to.

    A node is on that side if the centre of its own quad is; on the plane itself it is not.

    Parameters
    ----------
    point : sequence of 3 floats
        On the plane, in metres, where the plant stands as its file has it. A copy in a scene takes
        its plane along.
    normal : sequence of 3 floats
        Towards the finer side, of any length above 0.

    Returns
    -------
    Criterion
        To be combined, or given to `FoliageHierarchy.view_dependent`.

    Raises
    ------
    ValueError
        If a number is not finite or too large, or if `normal` is the zero vector.

    Examples
    --------
    >>> from treelod import criteria
    >>> criteria.plane((0, 0, 0), (0, 0, 1))
    plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    """
    direction = _vector("normal", normal, limit=math.inf)
    if max(map(abs, direction)) == 0.0:
        msg = "normal must not be the zero vector"
        raise ValueError(msg)
    return _Plane(_vector("point", point), direction)


def frustum() -> Criterion:
    """
    Mark what the camera may see.

    A node is marked if the ball around it and all that lies below it reaches into the view, beyond
    the near plane and between the four sides. So whatever a picture shows is at full detail.

    Returns
    -------
    Criterion
        To be combined, or given to `FoliageHierarchy.view_dependent`.

    Examples
    --------
    >>> from treelod import criteria
    >>> criteria.frustum() & criteria.screen_size(8)
    (frustum() & screen_size(8.0))
    """
    return _Frustum()


def screen_size(pixels: float) -> Criterion:
    """
    Mark what looks large.

    A node is marked if the ball around it and all that lies below it looks more than `pixels` wide.
    In a perspective view that is the ball's outline as it would be in the middle of the picture,
    wherever the camera looks; there is no limit to it once the eye is inside. In a parallel view
    distance plays no part. A copy that is stretched counts with its longest axis.

    Parameters
    ----------
    pixels : float
        Width in pixels, at least 0.

    Returns
    -------
    Criterion
        To be combined, or given to `FoliageHierarchy.view_dependent`.

    Raises
    ------
    ValueError
        If `pixels` is negative or not finite.

    Examples
    --------
    >>> from treelod import criteria
    >>> criteria.screen_size(12)
    screen_size(12.0)
    """
    return _ScreenSize(_length("pixels", pixels))


def distance(max_distance: float) -> Criterion:
    """
    Mark what is near.

    A node is marked if the centre of its own quad is nearer to the eye, in any kind of view.

    Parameters
    ----------
    max_distance : float
        In metres of the scene, at least 0.

    Returns
    -------
    Criterion
        To be combined, or given to `FoliageHierarchy.view_dependent`.

    Raises
    ------
    ValueError
        If `max_distance` is negative or not finite.

    Examples
    --------
    >>> from treelod import criteria
    >>> ~criteria.distance(3)
    ~distance(3.0)
    """
    return _Distance(_length("max_distance", max_distance))


def criterion_from(value: CriterionLike) -> Criterion:
    """
    Take a criterion as it is, and make one of a function.

    Parameters
    ----------
    value : Criterion or callable
        A function ``f(nodes, camera)`` is given `Nodes` and a `Camera` that shows what is drawn,
        its target being some point on the line of sight, and returns an array of shape (N,) and
        dtype bool: which nodes are marked. It is called once for each copy and picture, with all
        nodes, and its answer must depend on its arguments alone. What it raises reaches the caller
        of `render`. It must not draw or build anything with treelod, which is refused, nor wait
        for a thread that does; and Ctrl-C waits until it returns.

    Returns
    -------
    Criterion
        Equal to `value` if that is one.

    Raises
    ------
    TypeError
        If `value` is neither.
    ValueError
        If criteria lie more than 64 deep within one another.

    Examples
    --------
    >>> from treelod import criteria
    >>> def upper_half(nodes, camera):
    ...     return nodes.centers[:, 1] > nodes.centers[:, 1].mean()
    >>> criteria.criterion_from(upper_half) & criteria.frustum()
    (upper_half & frustum())
    """
    if not isinstance(value, Criterion):
        if not _is_like(value):
            msg = f"criterion must be a Criterion or a function, got {type(value).__name__}"
            raise TypeError(msg)
        makers: tuple[object, ...] = (sphere, plane, frustum, screen_size, distance)
        if value in makers:
            msg = f"criterion must be made by calling {value!r}"
            raise TypeError(msg)
        return _Function(value)
    return _checked(value)


def _checked(criterion: Criterion) -> Criterion:
    """Refuse one that is too large, before it grows further."""
    count, depth = criterion._extent
    if depth > MAX_DEPTH:
        msg = f"criterion must not be more than {MAX_DEPTH} criteria within one another"
        raise ValueError(msg)
    if count > MAX_PART_COUNT:
        msg = f"criterion must not have more than {MAX_PART_COUNT} parts"
        raise ValueError(msg)
    return criterion


def _is_like(value: object) -> bool:
    return isinstance(value, Criterion) or (callable(value) and not isinstance(value, type))


def _joined(kind: type[_And] | type[_Or], first: CriterionLike, second: CriterionLike) -> Criterion:
    """Put two criteria side by side, with the parts of those that are of the same kind."""
    parts: list[Criterion] = []
    for value in (first, second):
        criterion = criterion_from(value)
        parts.extend(criterion.parts if isinstance(criterion, kind) else (criterion,))
    return _checked(kind(tuple(parts)))


def _vector(
    name: str, value: ArrayLike, *, limit: float = MAX_COORDINATE
) -> tuple[float, float, float]:
    array = np.asarray(value)
    if array.dtype.kind not in "iuf" or array.shape != (3,) or not np.isfinite(array).all():
        msg = f"{name} must be 3 finite numbers, got {value!r}"
        raise ValueError(msg)
    if np.abs(array).max() > limit:
        msg = f"{name} must lie within {limit:g} m of the origin, got {value!r}"
        raise ValueError(msg)
    return float(array[0]), float(array[1]), float(array[2])


def _length(name: str, value: float) -> float:
    if isinstance(value, str | bytes | bool | np.bool_) or not hasattr(value, "__float__"):
        msg = f"{name} must be a number, got {value!r}"
        raise TypeError(msg)
    number = float(value)
    if not 0.0 <= number <= MAX_COORDINATE:
        msg = f"{name} must be in [0, {MAX_COORDINATE:g}], got {number}"
        raise ValueError(msg)
    return number
