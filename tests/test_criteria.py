"""Do criteria mark what they say, refuse what has no meaning, and combine as sets do?"""

import math
import threading
from dataclasses import FrozenInstanceError
from pathlib import Path

import numpy as np
import pytest

import treelod as tl
from treelod import _core, criteria

SAMPLE = Path(__file__).parents[1] / "src/lod/foliage_hierarchy/stored/sample_v1.bin"
ORIGIN = (100.0, 20.0, -50.0)


@pytest.fixture(scope="module")
def stored():
    """
    Three leaves at (0, 0, 0), (1.5, 0.375, -1.5) and (4, 1, -4) from the origin.

        4
      3   \\
     0 1   2
    """
    return SAMPLE.read_bytes()


def camera(eye=(0.0, 0.0, 30.0), **changes):
    eye = np.add(eye, ORIGIN)
    facts = {"target": ORIGIN, "fov_y_deg": 40.0, "size": (640, 480), **changes}
    return tl.Camera.perspective(eye, **facts)


def facts(view):
    return {name: getattr(view, name) for name in view.__dataclass_fields__}


def active(stored, criterion, view=None, **options):
    core = criteria.criterion_from(criterion)._core()
    options = {"origin": ORIGIN, **options}
    (nodes,) = _core._cut_for_test(stored, core, [facts(view or camera())], **options)
    return nodes


def at(*offset):
    return np.add(ORIGIN, offset)


def everything(nodes, camera):
    return np.ones(len(nodes.centers), bool)


class TestZones:
    def test_places_are_the_worlds(self, stored):
        assert active(stored, criteria.sphere(at(0, 0, 0), 0.5, inside="fine")) == [2, 0, 1]
        assert active(stored, criteria.sphere(at(9, 9, 9), 0.5, inside="fine")) == [4]
        assert active(stored, criteria.sphere(at(9, 9, 9), 99)) == [4]
        assert active(stored, criteria.plane(at(0.1, 0, 0), (-1, 0, 0))) == [2, 0, 1]
        assert active(stored, criteria.plane(at(0.1, 0, 0), (-1, 0, 0)), origin=(0, 0, 0)) == [
            2, 0, 1
        ]  # fmt: skip

    def test_what_the_camera_sees_and_how_near(self, stored):
        assert active(stored, criteria.frustum()) == [2, 0, 1]
        away = camera(eye=(0, 0, 30), target=at(0, 0, 60))
        assert active(stored, criteria.frustum(), away) == [4]
        assert active(stored, criteria.screen_size(5)) == [2, 0, 1]
        assert active(stored, criteria.screen_size(5000)) == [4]
        assert active(stored, criteria.distance(30.1)) == [2, 0, 1]
        assert active(stored, criteria.distance(29.9)) == [4]

    def test_growth_follows_the_eye(self, stored):
        zone = criteria.sphere(at(-9, 0, 0), 6, inside="fine", growth=0.2)
        assert active(stored, zone, camera(eye=(0, 0, 30))) == [2, 0, 1]
        assert active(stored, zone, camera(eye=(-8, 0, 1))) == [4]

    def test_copies_take_their_zones_along_and_keep_metres(self, stored):
        # twice as large and moved, about the origin of the world
        move = {"transform": [[2, 0, 0, 7], [0, 2, 0, 8], [0, 0, 2, 9]]}
        zone = criteria.sphere(at(0, 0, 0), 0.5, inside="fine")
        assert active(stored, zone, **move) == [2, 0, 1]
        eye = 2 * np.array(ORIGIN) + (7, 8, 9 + 30)
        view = tl.Camera.perspective(eye, eye - (0, 0, 1))
        assert active(stored, criteria.distance(30.1), view, **move) == [2, 0, 1]
        assert active(stored, criteria.distance(29.9), view, **move) == [4]

    def test_the_papers_rule_leaves_the_node_itself_out(self, stored):
        def top(nodes, camera):
            return np.arange(len(nodes.centers)) == 4

        assert active(stored, top) == [2, 3]
        assert active(stored, top, rule="paper") == [4]
        with pytest.raises(ValueError, match='rule must be "inclusive" or "paper", got "other"'):
            active(stored, top, rule="other")


class TestCombining:
    def test_as_sets_do(self, stored):
        near, far = (criteria.sphere(at(*p), 0.5, inside="fine") for p in [(0, 0, 0), (9, 9, 9)])
        assert active(stored, near | far) == [2, 0, 1]
        assert active(stored, near & far) == [4]
        assert active(stored, ~far & near) == [2, 0, 1]
        assert active(stored, everything & far) == [4]
        assert active(stored, far | everything) == [2, 0, 1]
        assert active(stored, near & ~criteria.criterion_from(everything)) == [4]

    def test_equal_if_made_equally(self):
        assert criteria.distance(3) == criteria.distance(3.0)
        assert criteria.distance(3) != criteria.screen_size(3)
        assert ~~criteria.frustum() == criteria.frustum()
        assert len({criteria.sphere((0, 0, 0), 1), criteria.sphere([0, 0, 0], 1.0)}) == 1

    def test_chains_are_flat(self):
        chain = criteria.frustum()
        for pixels in range(100):
            chain = chain & criteria.screen_size(pixels)
        assert len(chain.parts) == 101
        assert criteria.criterion_from(chain) is chain

    def test_frozen(self):
        with pytest.raises(FrozenInstanceError):
            criteria.distance(3).max_distance = 4

    def test_too_deep_is_refused(self):
        nested = criteria.frustum()
        for _ in range(31):
            nested = ~(nested & criteria.distance(1))
        deepest = nested | criteria.distance(2)
        assert criteria.criterion_from(deepest) is deepest
        with pytest.raises(ValueError, match="not be more than 64 criteria within one another"):
            criteria.criterion_from(~deepest)

    def test_words_do_not_join_criteria(self):
        with pytest.raises(TypeError, match=r"joined by & \| ~"):
            criteria.screen_size(4) and criteria.distance(3)
        with pytest.raises(TypeError, match="calling <function screen_size"):
            criteria.criterion_from(criteria.screen_size)

    def test_too_many_are_refused_as_they_are_made(self):
        nested = criteria.frustum()
        for _ in range(8):
            nested = ~(nested & nested)
        with pytest.raises(ValueError, match="not have more than 1024 parts"):
            ~((nested & nested) | (nested & nested))

    @pytest.mark.parametrize("value", [None, 3, "frustum", criteria.Criterion, int])
    def test_what_is_neither_criterion_nor_function_is_refused(self, value):
        with pytest.raises(TypeError, match="criterion must be a Criterion or a function, got"):
            criteria.criterion_from(value)
        with pytest.raises(TypeError):
            criteria.frustum() & value
        with pytest.raises(TypeError):
            value | criteria.frustum()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: criteria.sphere((0, 0), 1), "center must be 3 finite numbers"),
        (lambda: criteria.sphere((0, 0, math.nan), 1), "center must be 3 finite numbers"),
        (lambda: criteria.sphere((0, 0, 1e19), 1), "center must lie within 1e.18 m"),
        (lambda: criteria.sphere((0, 0, 0), -1), r"radius must be in \[0, 1e.18\], got -1.0"),
        (lambda: criteria.sphere((0, 0, 0), math.nan), "radius must be in"),
        (lambda: criteria.sphere((0, 0, 0), 1, growth=-1), "growth must be in"),
        (lambda: criteria.sphere((0, 0, 0), 1, inside="out"), "inside must be 'coarse' or 'fine'"),
        (lambda: criteria.plane((0, 0, 0), (0, 0, 0)), "normal must not be the zero vector"),
        (lambda: criteria.plane((0, 0, 0), (0, math.inf, 0)), "normal must be 3 finite numbers"),
        (lambda: criteria.plane((0, 0, -1e19), (0, 0, 1)), "point must lie within"),
        (lambda: criteria.screen_size(-0.5), "pixels must be in"),
        (lambda: criteria.screen_size(math.inf), "pixels must be in"),
        (lambda: criteria.distance(-1), "max_distance must be in"),
    ],
)
def test_numbers_without_a_meaning_are_refused_by_name(make, message):
    with pytest.raises(ValueError, match=message):
        make()


class TestFunctions:
    def test_are_given_all_nodes_as_they_stand_in_the_scene(self, stored):
        seen = []

        def look(nodes, view):
            seen.append((nodes, view))
            return nodes.is_leaf

        shown = camera(eye=(0, 0, 30))
        assert active(stored, look, shown) == [2, 0, 1]
        ((nodes, view),) = seen
        offsets = [[0, 0, 0], [1.5, 0.375, -1.5], [4, 1, -4]]
        np.testing.assert_array_equal(nodes.centers[:3], np.add(ORIGIN, offsets))
        assert nodes.centers.shape == nodes.ball_centers.shape == (5, 3)
        np.testing.assert_array_equal(nodes.areas, [1, 1, 1, 2, 3])
        np.testing.assert_array_equal(nodes.costs, [0, 0, 0, 3, 4])
        np.testing.assert_array_equal(nodes.parents, [3, 3, 4, 4, -1])
        np.testing.assert_array_equal(nodes.is_leaf, [True, True, True, False, False])
        # a ball holds its own quad's centre and, at a corner, reaches half a diagonal
        away = np.linalg.norm(nodes.centers - nodes.ball_centers, axis=1)
        assert (away <= nodes.ball_radii).all()
        np.testing.assert_allclose(nodes.ball_radii[:3], math.sqrt(0.5), rtol=1e-6)
        assert (view.eye, view.size, view.near) == (shown.eye, shown.size, shown.near)
        assert view.fov_y_deg == pytest.approx(40.0)
        np.testing.assert_allclose(view.project(nodes.centers), shown.project(nodes.centers))

    def test_see_copies_where_they_stand(self, stored):
        seen = []

        def look(nodes, view):
            seen.append(nodes)
            return nodes.is_leaf

        active(stored, look, transform=[[0, 0, 2, 1], [0, 2, 0, 2], [-2, 0, 0, 3]])
        (nodes,) = seen
        x, y, z = ORIGIN
        np.testing.assert_allclose(nodes.centers[0], [2 * z + 1, 2 * y + 2, -2 * x + 3])
        np.testing.assert_allclose(nodes.ball_radii[:3], 2 * math.sqrt(0.5), rtol=1e-6)

    def test_are_called_once_a_view(self, stored):
        calls = []

        def count(nodes, view):
            calls.append(view.eye)
            return ~nodes.is_leaf

        core = criteria.criterion_from(count)._core()
        views = [camera(eye=(0, 0, z)) for z in (10, 20, 30)]
        cuts = _core._cut_for_test(stored, core, list(map(facts, views)), origin=ORIGIN)
        assert cuts == [[2, 0, 1]] * 3
        assert calls == [view.eye for view in views]

    def test_may_not_write_to_what_they_are_given(self, stored):
        def spoil(nodes, view):
            nodes.centers[:] = 0
            return nodes.is_leaf

        with pytest.raises(ValueError, match="read-only"):
            active(stored, spoil)

    def test_raise_what_they_raise(self, stored):
        class OwnError(Exception):
            pass

        error = OwnError("why")

        def fail(nodes, view):
            raise error

        with pytest.raises(OwnError) as caught:
            active(stored, criteria.frustum() & ~criteria.criterion_from(fail))
        assert caught.value is error

    @pytest.mark.parametrize(
        "answer",
        [[True], np.ones(5), np.ones((5, 1), bool), None, np.ones(5, np.uint8)],
        ids=["short", "floats", "matrix", "nothing", "bytes"],
    )
    def test_must_answer_for_each_node(self, stored, answer):
        expected = r"criterion must return an array of shape \(5,\) and dtype bool, got shape"
        with pytest.raises(ValueError, match=expected):
            active(stored, lambda nodes, view: answer)

    def test_run_in_several_threads_at_once(self, stored):
        results = []

        def work():
            results.append([active(stored, everything) for _ in range(20)])

        threads = [threading.Thread(target=work) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert results == [[[2, 0, 1]] * 20] * 4


class TestCore:
    """What the face would never hand over."""

    @pytest.mark.parametrize(
        ("core", "message"),
        [
            (("sphere", (0, 0, 0), -1.0, True, 0.0), "radius must be in"),
            (("plane", (0, 0, 0), (0, 0, 0)), "normal: must not be the zero vector"),
            (("nothing",), 'criterion "nothing" is none'),
        ],
    )
    def test_refuses_it_too(self, stored, core, message):
        with pytest.raises(ValueError, match=message):
            _core._cut_for_test(stored, core, [facts(camera())], origin=ORIGIN)

    def test_does_not_follow_it_without_end(self, stored):
        core = ("frustum",)
        for _ in range(100_000):
            core = ("not", core)
        with pytest.raises(tl.LimitError, match="criteria within one another"):
            _core._cut_for_test(stored, core, [facts(camera())], origin=ORIGIN)
        while len(core) == 2:  # Python takes nested tuples apart by recursion
            core = core[1]

    def test_damaged_bytes_are_a_store_error(self, stored):
        with pytest.raises(tl.StoreError, match="stored foliage: its checksum does not fit"):
            active(stored[:-1] + b"?", criteria.frustum())
        with pytest.raises(tl.StoreError, match="bytes are less than its header takes"):
            active(b"", criteria.frustum())

    def test_times_are_of_cuts_that_agree(self, stored):
        views = [facts(camera(eye=(0, 0, z))) for z in (30, 20, 20, 10)]
        core = criteria.distance(20.1)._core()
        rows = _core.cut_times(stored, core, views, origin=ORIGIN, rounds=2)
        scratch, followed, active_count, dirty_count, *_ = zip(*rows, strict=True)
        assert active_count == (1, 3, 3, 3)
        assert dirty_count == (0, 3, 0, 0)
        assert min(scratch) > 0
        assert min(followed) > 0
