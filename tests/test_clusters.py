"""Are leaves grouped by planes as defined? Against a twin in NumPy, eigh, and all partitions."""

import itertools
import os
import subprocess
import sys
import textwrap

import numpy as np
import pytest

import treelod as tl
from treelod import _core

SUMMED = 1e-9
"""Of |B| or of N (R^2 + alpha): f64 sums in another order, and a grid of 2^-46 of the crown."""

RISE = 1e-12
"""Of N (R^2 + alpha): what rounding may raise the error by in a turn."""

STOP_SECS = 1.0
"""From Ctrl-C to the exception."""


def crown(count, seed=1, radius=5.0):
    """Leaves of all directions in a ball."""
    rng = np.random.default_rng(seed)
    toward = rng.normal(size=(2, count, 3))
    toward /= np.linalg.norm(toward, axis=2, keepdims=True)
    reach = radius * rng.random((count, 1)) ** (1 / 3)
    return (toward[0] * reach).astype(np.float32), toward[1].astype(np.float32)


# The definitions, slow and obvious


def twin_errors(centers, normals, planes, alpha):
    """Error of each leaf and plane: (L, K)."""
    p, n = np.asarray(centers, float), np.asarray(normals, float)
    distance = p @ planes[:, :3].T + planes[:, 3]
    across = np.cross(n[:, None], planes[None, :, :3])
    return distance**2 + alpha * (across**2).sum(axis=2)


def twin_matrix(centers, normals, alpha):
    """B, about the mean: its smallest eigenvalue is the error of the best plane."""
    p, n = np.asarray(centers, float), np.asarray(normals, float)
    apart = p - p.mean(axis=0)
    return apart.T @ apart + alpha * ((n**2).sum() * np.eye(3) - n.T @ n)


def twin_plane(centers, normals, alpha):
    normal = np.linalg.eigh(twin_matrix(centers, normals, alpha))[1][:, 0]
    return np.append(normal, -np.asarray(centers, float).mean(axis=0) @ normal)


def twin_run(centers, normals, planes, alpha, iterations):
    """Ids and the error after each turn; no cluster may become empty."""
    planes, errors, ids = planes.copy(), [], None
    for _ in range(iterations):
        before, ids = ids, twin_errors(centers, normals, planes, alpha).argmin(axis=1)
        for k in range(len(planes)):
            planes[k] = twin_plane(centers[ids == k], normals[ids == k], alpha)
        found = twin_errors(centers, normals, planes, alpha)
        errors.append(found[np.arange(len(ids)), ids].sum())
        if before is not None and (ids == before).all():
            break
    return ids, planes, np.array(errors)


def planes_of_leaves(centers, normals, leaves):
    normal = np.asarray(normals, float)[leaves]
    return np.column_stack([normal, -(np.asarray(centers, float)[leaves] * normal).sum(axis=1)])


@pytest.mark.parametrize("count", [63, 64, 65, 1023, 1024, 1025, 4096])
@pytest.mark.parametrize("alpha", [0.0, 2.5])
def test_turns_are_those_of_the_twin(count, alpha):
    centers, normals = crown(count)
    start = planes_of_leaves(centers, normals, np.arange(9) * 7)
    start[:, :3] /= np.linalg.norm(start[:, :3], axis=1, keepdims=True)
    ids, planes, errors = twin_run(centers, normals, start, alpha, 30)
    found = tl.cluster_leaves(
        centers, normals, cluster_count=9, alpha=alpha, init=start, max_iterations=30
    )
    np.testing.assert_array_equal(found.cluster_ids, ids)
    size = count * (25 + alpha)
    np.testing.assert_allclose(found.errors, errors, atol=SUMMED * size, rtol=0)
    assert found.iteration_count == len(errors)
    alike = (found.planes * planes).sum(axis=1)
    np.testing.assert_allclose(np.abs(alike), 1 + planes[:, 3] ** 2, rtol=SUMMED)
    assert (found.planes[:, 3] >= 0).all()


@pytest.mark.parametrize("simd", ["scalar", "sse2", "avx2"])
def test_ids_are_the_same_by_all_ways_and_on_all_threads(simd):
    centers, normals = crown(3000)
    facts = {
        "cluster_count": 40,
        "alpha": 1.0,
        "init": "plus_plus",
        "seed": 3,
        "restarts": 1,
        "max_iterations": 50,
        "eigen": "exact",
    }
    naive = _core.cluster_leaves(centers, normals, **facts, method="naive")
    for method, threads in itertools.product(["full", "pruned"], [1, 2, 3]):
        try:
            got = _core.cluster_leaves(
                centers, normals, **facts, method=method, threads=threads, simd=simd
            )
        except ValueError as error:
            # any other refusal is a fault
            if str(error) != f"simd: this machine has no {simd}":
                raise
            pytest.skip(str(error))
        for one, other in zip(got, naive, strict=True):
            np.testing.assert_array_equal(one, other)


# Planes


def hard_cases():
    """Leaves of one cluster each: name, centres, normals."""
    rng = np.random.default_rng(5)
    centers, normals = (array.astype(float) for array in crown(40))
    x, _, z = np.eye(3)
    t = np.linspace(-2, 3, 12)[:, None]
    tilt = np.array([0.48, 0.6, 0.64])
    flat = np.column_stack([rng.uniform(-3, 3, (20, 2)), np.zeros(20)])
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    yield "one leaf", centers[:1], normals[:1]
    yield "two equal leaves", centers[[0, 0]], normals[[0, 0]]
    yield "on a line", 1.0 + t * tilt, normals[:12]
    yield "on a line, along it", t * x, np.tile(x, (12, 1))
    yield "in a plane", flat, np.tile(z, (20, 1))
    yield "in a tilted plane", flat @ np.linalg.qr(rng.normal(size=(3, 3)))[0] + 2, normals[:20]
    yield "isotropic", axes, axes
    yield "normals of mixed signs", centers, np.where(rng.random((40, 1)) < 0.5, 1, -1) * tilt
    yield "no normals", centers, np.zeros((40, 3))
    yield "through the origin", np.concatenate([centers, -centers]), np.tile(normals, (2, 1))


CASES = {name: (centers, normals) for name, centers, normals in hard_cases()}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("alpha", [0.0, 1e-3, 2.5, 1e6])
@pytest.mark.parametrize(
    ("scale", "away"), [(1.0, 0.0), (1.0, 1e6), (2e-5, 0.0), (2e3, 0.0)], ids=str
)
def test_planes_are_the_best_there_are(name, alpha, scale, away):
    centers, normals = CASES[name]
    # a place of whole 2^-10 keeps what f32 holds of a small crown
    centers = (centers * scale).astype(np.float32).astype(float) + away * np.array([1, -1, 0.5])
    normals = normals.astype(np.float32)
    found = tl.cluster_leaves(centers, normals, cluster_count=1, alpha=alpha)
    # what f32 makes of the centres once they are near zero
    origin = (centers.min(axis=0) + centers.max(axis=0)) / 2
    near = (centers - origin).astype(np.float32)
    matrix = twin_matrix(near, normals, alpha)
    size = np.linalg.norm(matrix)
    least = np.linalg.eigvalsh(matrix)[0]
    normal, d = found.planes[0, :3], found.planes[0, 3]
    cost = normal @ matrix @ normal
    assert np.linalg.norm(normal) == pytest.approx(1, abs=1e-12)
    assert np.linalg.norm(matrix @ normal - cost * normal) <= SUMMED * size
    assert cost <= least + SUMMED * size
    assert found.errors[-1] == pytest.approx(cost, abs=SUMMED * size)
    # through the mean, with the sign that planes have; d is that of a plane 1e6 m away
    mean = near.mean(axis=0, dtype=float) + origin
    assert mean @ normal + d == pytest.approx(0, abs=1e-12 * (scale + away))
    ordered = [d, *normal]
    assert next(value for value in ordered if value != 0) > 0


def test_a_crown_far_away_has_the_ids_of_one_at_hand():
    centers, normals = crown(2000)
    place = np.array([1e6, -2e6, 5e5])
    at = [
        tl.cluster_leaves(centers.astype(float) + shift, normals, cluster_count=16, alpha=2.0)
        for shift in (0.0, place)
    ]
    np.testing.assert_array_equal(at[0].cluster_ids, at[1].cluster_ids)
    # 1e6 m and f64: the centres themselves moved by 1e-10
    np.testing.assert_allclose(at[0].errors, at[1].errors, rtol=1e-6)
    foot = at[1].planes[:, 3] + at[1].planes[:, :3] @ place
    alike = at[0].planes[:, 3] * foot + (at[0].planes[:, :3] * at[1].planes[:, :3]).sum(axis=1)
    np.testing.assert_allclose(np.abs(alike), at[0].planes[:, 3] ** 2 + 1, atol=1e-5)
    # planes to start from are stated where the crown stands
    again = tl.cluster_leaves(
        centers + place, normals, cluster_count=16, alpha=2.0, init=at[1].planes
    )
    np.testing.assert_array_equal(again.cluster_ids, at[1].cluster_ids)
    assert again.iteration_count <= 2


def test_errors_never_rise_and_end_in_a_fixed_point():
    centers, normals = crown(3000)
    for alpha in (0.0, 0.1, 30.0, 1e6):
        for init in ("random", "plus_plus"):
            found = tl.cluster_leaves(
                centers, normals, cluster_count=20, alpha=alpha, init=init, max_iterations=300
            )
            assert found.converged
            assert (np.diff(found.errors) <= RISE * 3000 * (25 + alpha)).all()
            again = tl.cluster_leaves(
                centers, normals, cluster_count=20, alpha=alpha, init=found.cluster_ids
            )
            least = found.errors[-1] * (1 - 1e-11) - RISE * 3000 * (25 + alpha)
            assert again.errors[-1] >= least


# All partitions of a few leaves


def best_partition(centers, normals, plane_count, alpha):
    """The least error of all ways to group the leaves, and one that has it."""
    best = (np.inf, None)
    costs = {}
    for ids in itertools.product(range(plane_count), repeat=len(centers)):
        if ids[0] != 0 or len(set(ids)) != plane_count:
            continue
        error = 0.0
        for k in range(plane_count):
            members = tuple(i for i, own in enumerate(ids) if own == k)
            if members not in costs:
                rows = list(members)
                matrix = twin_matrix(centers[rows], normals[rows], alpha)
                costs[members] = max(np.linalg.eigvalsh(matrix)[0], 0.0)
            error += costs[members]
        if error < best[0]:
            best = (error, np.array(ids, np.uint32))
    return best


SEEDS = 64
TINY = [(leaves, planes, seed) for leaves, planes in ((6, 2), (8, 2), (8, 3)) for seed in (1, 2)]

REACHED = {"random": 61 / 384, "plus_plus": 91 / 384}
"""Share of starts that end in the best partition, over `TINY`, as measured. Starts are drawn with
integers, so that it is the same on every machine."""


def test_no_start_beats_the_best_partition_and_this_share_finds_it():
    reached = dict.fromkeys(REACHED, 0)
    for leaves, planes, seed in TINY:
        centers, normals = crown(leaves, seed)
        alpha = 2.5
        least, ids = best_partition(centers, normals, planes, alpha)
        slack = SUMMED * leaves * (25 + alpha)
        facts = {"cluster_count": planes, "alpha": alpha}
        kept = tl.cluster_leaves(centers, normals, init=ids, **facts)
        assert kept.errors[-1] == pytest.approx(least, abs=slack)
        np.testing.assert_array_equal(kept.cluster_ids, ids)
        for init, start in itertools.product(REACHED, range(SEEDS)):
            found = tl.cluster_leaves(centers, normals, init=init, seed=start, **facts)
            assert found.errors[-1] >= least - slack
            reached[init] += found.errors[-1] <= least + slack
    shares = {init: count / SEEDS / len(TINY) for init, count in reached.items()}
    assert shares == pytest.approx(REACHED, abs=1e-12)


# The paper's iteration


def test_misses_are_those_of_the_smallest_magnitude():
    centers, normals = crown(2000)
    for alpha in (0.01, 2.5, 250.0):
        ids = tl.cluster_leaves(centers, normals, cluster_count=12, alpha=alpha).cluster_ids
        misses = tl.plane_misses(centers, normals, ids, alpha=alpha)
        for k in range(12):
            own = ids == k
            matrix = twin_matrix(centers[own], normals[own], alpha)
            values, vectors = np.linalg.eigh(matrix)
            size = np.linalg.norm(matrix)
            shifted = values - alpha * (normals[own].astype(float) ** 2).sum()
            nearest = np.abs(shifted).argmin()
            assert misses.leaf_count[k] == own.sum()
            assert misses.best_costs[k] == pytest.approx(values[0], abs=SUMMED * size)
            gap = np.sort(np.abs(shifted))
            if gap[0] < 0.9 * gap[1]:  # else the paper's steps have not come to rest
                assert misses.paper_costs[k] == pytest.approx(values[nearest], abs=SUMMED * size)
                assert misses.missed[k] == (nearest != 0)
                axis = misses.paper_planes[k, :3] @ vectors[:, nearest]
                assert abs(axis) == pytest.approx(1, abs=1e-6)
    assert misses.missed.all()
    assert misses.missed_share == 1.0
    assert misses.total_ratio > 1.5
    assert (misses.ratio > 1).all()


def test_ratios_of_no_error_are_one():
    # a leaf alone: its own plane is the best, and the paper's iteration ends across it
    misses = tl.plane_misses([[0, 0, 0]], [[0, 0, 1]], [0], alpha=1.0)
    assert (misses.best_costs[0], misses.ratio[0]) == (0.0, np.inf)
    misses = tl.plane_misses([[0, 0, 0]], [[0, 0, 0]], [0], alpha=1.0)
    assert (misses.ratio[0], misses.missed[0], misses.total_ratio) == (1.0, False, 1.0)


# What is refused


GOOD = {"cluster_count": 2, "alpha": 1.0}


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"centers": np.zeros((4, 2))}, r"centers must have shape \(L, 3\), got \(4, 2\)"),
        ({"centers": np.zeros(3)}, "centers must have shape"),
        ({"centers": np.zeros((0, 3)), "normals": np.zeros((0, 3))}, "centers is empty"),
        ({"centers": np.array([[0, 0, np.nan]] * 4)}, "centers must be finite: element 0"),
        ({"centers": np.array([[0, 0, np.inf]] * 4, np.float32)}, "centers must be finite"),
        ({"centers": np.diag([1e300, -1e300, 0, 0])[:, :3]}, "centers must be finite"),
        ({"centers": np.array([["a"] * 3] * 4)}, "centers must be real numbers"),
        ({"normals": np.zeros((3, 3))}, "normals: must be as many as centers"),
        ({"normals": np.full((4, 3), 1.0)}, "normals: must have length 1 or 0"),
        ({"normals": np.full((4, 3), np.nan)}, "normals must be finite"),
        ({"normals": np.full((4, 3), 1j)}, "normals must be real numbers"),
        ({"cluster_count": 0}, "cluster_count must be in"),
        ({"cluster_count": 65537}, "cluster_count must be in"),
        ({"alpha": -1.0}, "alpha must be in"),
        ({"alpha": float("nan")}, "alpha must be in"),
        ({"init": "grid"}, 'init must be "plus_plus" or "random"'),
        ({"init": np.zeros((2, 3))}, "init must be"),
        ({"init": np.zeros((2, 4))}, "init: normals must have length 1"),
        ({"init": np.full((2, 4), np.nan)}, "init must be finite"),
        ({"init": np.eye(4)[:1]}, "init: must hold cluster_count = 2"),
        ({"init": np.array([0, 1, 2, 0])}, "init: ids must be below 2"),
        ({"init": np.array([0, 1, -1, 0])}, "init must be in"),
        ({"init": np.array([0, 1])}, "init: must hold an id for each of 4"),
        ({"init": np.array([0.5, 1, 0, 0])}, "init must be"),
        ({"init": np.array([0, 1, 0, 0]), "restarts": 2}, "restarts: must be 1"),
        ({"restarts": 0}, "restarts must be in"),
        ({"max_iterations": 0}, "max_iterations must be in"),
        ({"eigen": "best"}, 'eigen must be "exact" or "paper"'),
        ({"threads": 0}, "threads must be in"),
    ],
    ids=str,
)
def test_bad_arguments_are_named(bad, message):
    centers, normals = crown(4)
    facts = {"centers": centers, "normals": normals, **GOOD, **bad}
    with pytest.raises(ValueError, match=message):
        tl.cluster_leaves(**facts)


def test_bad_ids_of_misses_are_named():
    centers, normals = crown(4)
    for ids, message in [
        ([0, 1], "cluster_ids: must hold an id for each of 4"),
        ([0.0] * 4, "cluster_ids must be integers"),
        ([-1, 0, 0, 0], "cluster_ids must be in"),
        ([[0, 0, 0, 0]], "cluster_ids must have shape"),
    ]:
        with pytest.raises(ValueError, match=message):
            tl.plane_misses(centers, normals, ids, alpha=1.0)


def test_input_is_left_alone_and_any_layout_will_do():
    centers, normals = crown(100)
    rows = np.asfortranarray(np.repeat(centers, 2, axis=0))[::2]
    init = planes_of_leaves(centers, normals, [0, 1, 2])
    before = (rows.copy(), init.copy())
    found = tl.cluster_leaves(rows, normals, cluster_count=3, alpha=1.0, init=init)
    same = tl.cluster_leaves(centers, normals, cluster_count=3, alpha=1.0, init=init)
    np.testing.assert_array_equal(found.cluster_ids, same.cluster_ids)
    np.testing.assert_array_equal(rows, before[0])
    np.testing.assert_array_equal(init, before[1])


def test_progress_counts_turns_and_can_end_the_call():
    centers, normals = crown(200_000)
    seen = []
    facts = {"cluster_count": 64, "alpha": 1.0, "max_iterations": 30}
    tl.cluster_leaves(centers, normals, **facts, progress=lambda *at: seen.append(at))
    assert seen[-1] == (30, 30)
    assert seen == sorted(seen)

    def stop(done, total):
        msg = "enough"
        raise RuntimeError(msg)

    with pytest.raises(RuntimeError, match="enough"):
        tl.cluster_leaves(centers, normals, **facts, progress=stop)


@pytest.mark.parametrize("init", ["plus_plus", "random"])
def test_ctrl_c_ends_it_within_a_second(init):
    code = f"""
        import os, signal, threading, time
        import numpy as np
        import treelod as tl
        rng = np.random.default_rng(1)
        centers = rng.normal(size=(1_500_000, 3)).astype(np.float32)
        normals = np.tile(np.float32([0, 0.6, 0.8]), (1_500_000, 1))
        sent = []
        def interrupt():
            sent.append(time.monotonic())
            os.kill(os.getpid(), signal.SIGINT)
        threading.Timer(0.7, interrupt).start()
        try:
            tl.cluster_leaves(centers, normals, cluster_count=4096, alpha=1.0, init="{init}")
            print("finished")
        except KeyboardInterrupt:
            print(time.monotonic() - sent[0])
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
        env={**os.environ, "TREELOD_NUM_THREADS": "2"},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() != "finished", "too short a call to be interrupted"
    assert float(done.stdout) < STOP_SECS
