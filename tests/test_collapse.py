"""Collapsing leaves: an independent twin in NumPy, every collapse's figures, and bad input."""

from __future__ import annotations

import itertools
import subprocess
import sys
import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import treelod as tl
from treelod import _core
from treelod.collapse import LeafForest

if TYPE_CHECKING:
    from numpy.typing import NDArray

ROUNDING = 1e-9
"""Relative: sums of a few dozen terms in float64, in another order."""


def _crown(count: int, seed: int, *, grid: bool) -> NDArray[np.float32]:
    """Squares turned at random, or on whole places and along axes, where many costs are equal."""
    rng = np.random.default_rng(seed)
    if grid:
        centers = rng.integers(0, 4, (count, 3)).astype(float)
        axes = np.eye(3)[rng.permuted(np.tile([0, 1, 2], (count, 1)), axis=1)]
        half = 0.5
    else:
        centers = rng.uniform(-1, 1, (count, 3))
        axes = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
        half = 0.15
    x, y = axes[:, 0] * half, axes[:, 1] * half
    corners = [-x - y, x - y, x + y, y - x]
    return np.stack([centers + corner for corner in corners], axis=1).astype(np.float32)


def _check(forest: LeafForest, *, weight: float = 1.0) -> None:
    """
    Check each collapse of one pair against the definitions, from the leaves alone.

    Squares give candidates that are equal but for rounding, so each step starts from the quad that
    was taken in the step before.
    """
    count = forest.leaf_count
    positions = forest.positions
    quads = {leaf: [4 * leaf + k for k in range(4)] for leaf in range(count)}

    def measures(quad: list[int]) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        a, b, c, d = positions[quad]
        vectors = np.array([np.cross(b - a, c - a), np.cross(c - a, d - a)]) / 2
        areas = np.linalg.norm(vectors, axis=1)
        centers = np.array([(a + b + c) / 3, (a + c + d) / 3])
        larger = vectors[1] if areas[1] > areas[0] else vectors[0]
        signs = np.where(vectors @ larger < 0, -1.0, 1.0)
        normal = (vectors * signs[:, None]).sum(axis=0)
        return (
            (centers * areas[:, None]).sum(axis=0) / areas.sum(),
            normal / np.linalg.norm(normal),
            areas.sum(),
        )

    areas = {leaf: measures(quad)[2] for leaf, quad in quads.items()}
    d_ref_sq = sum(areas.values()) / count
    for node in range(count, len(forest.vertices)):
        of = {node: measures(quad) for node, quad in quads.items()}

        def cost(pair: tuple[int, int], of: Any = of) -> float:
            (p, n, _), (q, m, _) = of[pair[0]], of[pair[1]]
            return float(((p - q) ** 2).sum() / d_ref_sq + weight * (np.cross(n, m) ** 2).sum())

        pairs = list(itertools.combinations(sorted(quads), 2))
        costs = np.array([cost(pair) for pair in pairs])
        i, j = pairs[int(np.flatnonzero(costs <= costs.min() * (1 + ROUNDING))[0])]
        assert forest.children[node].tolist() == [i, j]
        target = areas[i] + areas[j]
        big, small = (j, i) if areas[j] > areas[i] else (i, j)
        sign = -1.0 if of[i][1] @ of[j][1] < 0 else 1.0
        mean = of[big][1] * areas[big] + sign * of[small][1] * areas[small]
        keys: dict[frozenset[frozenset[int]], float] = {}
        for (a, b), (c, d) in itertools.product(
            itertools.combinations(quads[i], 2), itertools.combinations(quads[j], 2)
        ):
            for w, x, y, z in ([a, b, c, d], [a, b, d, c], [a, c, b, d]):
                corners = positions[[w, x, y, z]]
                if _crosses(*corners, mean) or _crosses(*np.roll(corners, -1, axis=0), mean):
                    continue
                p, q, r, s = corners
                area = (_length(np.cross(q - p, r - p)) + _length(np.cross(r - p, s - p))) / 2
                flat = _length(np.cross(r - p, s - q)) / 2
                flatness = flat / area if area > 0 else 0.0
                cut = frozenset([frozenset([w, y]), frozenset([x, z, -1])])
                keys[cut] = abs(area - target) / target + 1 - flatness
        w, x, y, z = taken = forest.vertices[node].tolist()
        cut = frozenset([frozenset([w, y]), frozenset([x, z, -1])])
        assert keys[cut] <= min(keys.values()) + ROUNDING
        facing = np.cross(positions[y] - positions[w], positions[z] - positions[x]) @ mean
        assert facing >= -ROUNDING
        quads[node] = taken
        del quads[i], quads[j]
        areas[node] = target


def _length(vector: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(vector))


def _crosses(
    p: NDArray[np.float64],
    q: NDArray[np.float64],
    r: NDArray[np.float64],
    s: NDArray[np.float64],
    normal: NDArray[np.float64],
) -> bool:
    """Whether pq and rs cross, seen along a normal."""

    def side(u: NDArray[np.float64], v: NDArray[np.float64], w: NDArray[np.float64]) -> float:
        return float(np.cross(v - u, w - u) @ normal)

    return side(p, q, r) * side(p, q, s) < 0 and side(r, s, p) * side(r, s, q) < 0


@pytest.mark.parametrize("seed", range(6))
def test_every_step_is_that_of_the_definitions(seed: int) -> None:
    _check(tl.collapse_leaves(_crown(24, seed, grid=False)))


@pytest.mark.parametrize("change", ["weight", "pair", "corners", "cut"])
def test_check_of_the_definitions_sees_what_is_wrong(change: str) -> None:
    forest = tl.collapse_leaves(_crown(24, 0, grid=False))
    weight = 1.0
    if change == "weight":
        weight = 5.0
    elif change == "pair":
        forest.children[30] = forest.children[31]
    elif change == "corners":
        a, b = forest.children[40]
        others = set(forest.vertices[a]) - set(forest.vertices[40])
        kept = [k for k in range(4) if forest.vertices[40, k] in forest.vertices[a]]
        forest.vertices[40, kept[0]] = others.pop()
        assert b >= 0
    else:
        forest.vertices[40] = np.roll(forest.vertices[40], 1)
    with pytest.raises((AssertionError, KeyError)):
        _check(forest, weight=weight)


@pytest.mark.parametrize("grid", [False, True])
@pytest.mark.parametrize("distance", ["centre", "hausdorff"])
def test_slow_twin_of_the_core_agrees(distance: Any, *, grid: bool) -> None:
    corners = _crown(150, 7, grid=grid)
    fast = tl.collapse_leaves(corners, distance=distance)
    areas = fast.areas[:150].copy()
    facts = {
        "distance": distance,
        "weight": 1.0,
        "d_ref": None,
        "choice": "balanced",
        "keep_area": True,
        "target_leaf_count": 1,
        "max_cost": None,
    }
    slow, cost_count, _ = _core.collapse_leaves(corners.reshape(-1, 12), areas, facts, naive=True)
    for name, array in slow.items():
        np.testing.assert_array_equal(getattr(fast, name), array, err_msg=name)
    # all pairs of 150, then of 149, ...: (150^3 - 150) / 6
    assert cost_count == sum(k * (k - 1) // 2 for k in range(2, 151)) == 562_475
    assert fast.cost_count < cost_count / 5


def test_areas_are_kept_and_figures_of_collapses_add_up() -> None:
    forest = tl.collapse_leaves(_crown(300, 3, grid=False))
    a, b, c, d = forest.quads().transpose(1, 0, 2)
    drawn = (_rows(np.cross(b - a, c - a)) + _rows(np.cross(c - a, d - a))) / 2
    np.testing.assert_allclose(drawn, forest.areas, rtol=1e-6)  # scales are float32
    own = forest.areas[300:] * (1 + forest.area_drifts)
    np.testing.assert_allclose(own * forest.scales[300:] ** 2, forest.areas[300:], rtol=1e-6)
    assert ((forest.planarities >= 0) & (forest.planarities <= 1 + ROUNDING)).all()
    for count in (1, 2, 37, 299, 300):
        nodes = forest.level(leaf_count=count)
        assert len(nodes) == count
        assert forest.areas[nodes].sum() == pytest.approx(forest.areas[:300].sum(), rel=1e-12)
    with pytest.raises(ValueError, match="leaf_count"):
        forest.level(leaf_count=0)
    with pytest.raises(ValueError, match="leaf_count"):
        forest.level(leaf_count=301)


def _rows(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.linalg.norm(vectors, axis=1)


def test_it_stops_where_it_is_told_to() -> None:
    corners = _crown(80, 5, grid=False)
    assert tl.collapse_leaves(corners, target_leaf_count=30).root_count == 30
    cheap = tl.collapse_leaves(corners, max_cost=0.5)
    assert 1 < cheap.root_count < 80
    assert cheap.costs.max() <= 0.5
    whole = tl.collapse_leaves(corners)
    np.testing.assert_array_equal(whole.costs[: len(cheap.costs)], cheap.costs)
    assert whole.costs[len(cheap.costs)] > 0.5


def test_crown_far_away_collapses_as_the_same_crown_near_by() -> None:
    # float64 corners on whole 1/1024ths, so that moving them is exact
    near = np.round(_crown(60, 9, grid=False).astype(np.float64) * 1024) / 1024
    offset = np.array([1e6, -2e6, 3e6])
    far = near + offset
    one, other = tl.collapse_leaves(near), tl.collapse_leaves(far)
    np.testing.assert_array_equal(one.children, other.children)
    np.testing.assert_array_equal(one.positions + offset, other.positions)
    np.testing.assert_allclose(one.balls[:, 3], other.balls[:, 3], rtol=1e-6)


def test_no_leaves_and_one_leaf() -> None:
    none = tl.collapse_leaves(np.zeros((0, 4, 3)))
    assert (none.leaf_count, none.root_count) == (0, 0)
    one = tl.collapse_leaves(np.zeros((1, 4, 3)))
    assert (one.leaf_count, one.root_count, one.parents.tolist()) == (1, 1, [-1])
    assert repr(one) == "LeafForest(1 leaves, 1 roots)"
    assert isinstance(one, LeafForest)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("corners", {"corners": np.zeros((2, 4, 2))}),
        ("corners", {"corners": np.full((2, 4, 3), np.nan)}),
        ("corners", {"corners": np.full((2, 4, 3), 1e300)}),
        ("corners", {"corners": np.full((2, 4, 3), "a")}),
        ("areas", {"areas": np.zeros(3)}),
        ("areas", {"areas": np.array([1.0, -1.0])}),
        ("areas", {"areas": np.array([1.0, np.inf])}),
        ("areas", {"areas": np.array([1.0, 1e37])}),
        ("d_ref", {"d_ref": 1e-101}),
        ("threads", {"threads": -1}),
        ("distance", {"distance": "far"}),
        ("weight", {"weight": -1.0}),
        ("weight", {"weight": np.inf}),
        ("d_ref", {"d_ref": 0.0}),
        ("choice", {"choice": "best"}),
        ("target_leaf_count", {"target_leaf_count": 0}),
        ("max_cost", {"max_cost": np.nan}),
    ],
)
def test_bad_arguments_are_named(name: str, change: dict[str, Any]) -> None:
    given: dict[str, Any] = {"corners": np.zeros((2, 4, 3)), **change}
    if name == "corners" and given["corners"].dtype.kind == "f" and given["corners"].max() > 1e100:
        given["corners"][0] = -1e300
    with pytest.raises(ValueError, match=f"^{name}"):
        tl.collapse_leaves(given.pop("corners"), **given)


def test_extreme_areas_stay_finite() -> None:
    corners = _crown(2, 0, grid=False)
    for areas in ([5e-324, 0.0], [1e36, 1e36], [0.0, 0.0]):
        forest = tl.collapse_leaves(corners, areas)
        assert np.isfinite(forest.d_ref)
        assert forest.d_ref > 0
        for name in ("costs", "areas", "scales", "balls"):
            assert np.isfinite(getattr(forest, name)).all(), (areas, name)


def test_ctrl_c_ends_a_search_among_leaves_at_one_place() -> None:
    code = """
        import _thread, threading, time
        import numpy as np
        import treelod as tl
        square = np.float32([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
        leaves = np.tile(square, (200_000, 1, 1))
        threading.Timer(0.5, _thread.interrupt_main).start()
        start = time.perf_counter()
        try:
            tl.collapse_leaves(leaves, threads=1)
        except KeyboardInterrupt:
            print(time.perf_counter() - start - 0.5)
    """
    command = [sys.executable, "-c", textwrap.dedent(code)]
    printed = subprocess.run(command, check=True, capture_output=True, text=True, timeout=120)
    # 1 s, with room for a machine on which other tests run
    assert float(printed.stdout) < 3


def test_wrong_types_are_named() -> None:
    for name, value in (("weight", "1"), ("keep_area", "yes"), ("target_leaf_count", 1.5)):
        with pytest.raises(TypeError, match=f"^{name}"):
            tl.collapse_leaves(np.zeros((2, 4, 3)), **{name: value})  # type: ignore[arg-type]
