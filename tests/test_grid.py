"""Which representations does a grid give, and what does it refuse before anything is drawn?"""

import collections.abc
import json
import sys
import types
import typing

import numpy as np
import pandas as pd
import pytest

import treelod as tl
from treelod.criteria import screen_size
from treelod.sweeps.config import read_config
from treelod.sweeps.grid import expand, labels
from treelod.sweeps.parameters import canonical, checked, defaults, known, written
from treelod.techniques import REGISTRY


def params_of(grid, technique, *names):
    """Values of some parameters of a technique's representations, in order."""
    return [
        tuple(variant.params[name] for name in names)
        for variant in expand(grid)
        if variant.technique == technique
    ]


def labels_of(grid):
    return labels([(v.technique, v.canonical_params()) for v in expand(grid)])


# What a grid gives


def test_lists_of_a_dict_are_crossed():
    grid = {"slicings": {"slice_count": [3, 5], "resolution": [64, 128], "samples": 4}}
    assert params_of(grid, "slicings", "slice_count", "resolution", "samples") == [
        (3, 64, 4),
        (3, 128, 4),
        (5, 64, 4),
        (5, 128, 4),
    ]


def test_the_full_mesh_is_always_first_and_once():
    for grid in ({}, [], {"full_mesh": {}}, ["slicings", "full_mesh"]):
        variants = expand(grid)
        assert [v.is_yardstick for v in variants] == [True] + [False] * (len(variants) - 1)
        assert sum(v.technique == "full_mesh" for v in variants) == 1
    changed = expand({"full_mesh": {"wood": [True, False]}})
    assert [v.params["wood"] for v in changed] == [True, False]
    assert [v.is_yardstick for v in changed] == [True, False]


def test_zipped_moves_together():
    grid = {"slicings": [tl.zipped(slice_count=[3, 5], resolution=[128, 256])]}
    assert params_of(grid, "slicings", "slice_count", "resolution") == [(3, 128), (5, 256)]
    # without the list too
    assert params_of({"slicings": grid["slicings"][0]}, "slicings", "slice_count") == [(3,), (5,)]


def test_a_list_is_a_union_and_holds_each_once():
    together = tl.zipped(slice_count=[3, 5], resolution=[128, 256])
    grid = {"slicings": [together, {"slice_count": [3, 7], "resolution": 128}, {}]}
    assert params_of(grid, "slicings", "slice_count", "resolution") == [
        (3, 128),
        (5, 256),
        (7, 128),
        # the defaults are (5, 256), which is there
    ]


def test_crossed_crosses_sets():
    sets = tl.crossed(tl.zipped(slice_count=[3, 5], resolution=[128, 256]), {"samples": [4, 16]})
    assert params_of({"slicings": sets}, "slicings", "slice_count", "resolution", "samples") == [
        (3, 128, 4),
        (3, 128, 16),
        (5, 256, 4),
        (5, 256, 16),
    ]
    assert tl.crossed() == tl.crossed({})


@pytest.mark.parametrize(
    "several",
    [
        [1, 3],
        range(1, 5, 2),
        np.array([1, 3]),
        np.array([1, 3], np.uint8),
        pd.Series([1, 3], index=["a", "b"]),
        pd.Index([1, 3]),
        [np.int64(1), np.int32(3)],
    ],
    ids=lambda value: type(value).__name__,
)
def test_several_values(several):
    found = params_of({"slicings": {"slice_count": several}}, "slicings", "slice_count")
    assert found == [(1,), (3,)]
    assert {type(value) for (value,) in found} == {int}


def test_tuples_words_and_matrices_are_one_value():
    grid = {"leaf_clusters": {"cluster_count": (32, 16, 8), "drawing": "blend"}}
    assert params_of(grid, "leaf_clusters", "cluster_count", "drawing") == [((32, 16, 8), "blend")]
    # a list in a list is a tuple
    grid = {"leaf_clusters": {"cluster_count": [[32, 16], (64, 32), 8]}}
    assert params_of(grid, "leaf_clusters", "cluster_count") == [((32, 16),), ((64, 32),), (8,)]
    up = np.array([[1.0, 0, 0], [0, 0, 1.0]])
    grid = {"slicings": {"orientations": [up, "sphere"]}}
    assert params_of(grid, "slicings", "orientations") == [
        (((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),),
        ("sphere",),
    ]
    weights = {"importance": {"foliage": 2.0}}
    assert params_of({"points_and_lines": weights}, "points_and_lines", "importance") == [
        ({"foliage": 2.0},)
    ]


def test_numbers_have_one_form():
    # 1 and 1.0 of a parameter with fractions are the same; 256 and (256, 256) are not
    grid = {"points_and_lines": {"splat_factor": [1, 1.0, np.float32(1.0), "coverage"]}}
    assert params_of(grid, "points_and_lines", "splat_factor") == [(1.0,), ("coverage",)]
    assert params_of(
        {"stochastic_pruning": {"contrast": np.True_}}, "stochastic_pruning", "contrast"
    ) == [(True,)]
    grid = {"slicings": {"resolution": [256, (256, 256)]}}
    assert len(params_of(grid, "slicings", "resolution")) == 2


def test_an_array_without_axes_is_its_number():
    grid = {"slicings": {"slice_count": np.array(3), "correction": np.array(0.25)}}
    assert params_of(grid, "slicings", "slice_count", "correction") == [(3, 0.25)]


def test_criteria_are_named_and_functions_are_not():
    grid = {"foliage_hierarchy": {"criterion": [screen_size(2), screen_size(4)]}}
    found = [v.canonical_params()["criterion"] for v in expand(grid)[1:]]
    assert found == [{"criterion": "screen_size(2.0)"}, {"criterion": "screen_size(4.0)"}]
    own = {"criterion": lambda nodes, camera: nodes.is_leaf}
    with pytest.raises(TypeError, match=r"criterion: nothing names .*lambda"):
        expand({"foliage_hierarchy": own})
    with pytest.raises(TypeError, match="criterion: nothing names"):
        expand({"foliage_hierarchy": {"criterion": screen_size(2) & own["criterion"]}})


def test_defaults_are_those_of_build():
    for name in REGISTRY:
        assert not {"views", "threads", "progress"} & set(known(name))
        # every default is of a type that the annotation names
        assert checked(name, defaults(name)) == defaults(name)
        assert json.loads(written([canonical("x", v) for v in defaults(name).values()]))


def test_every_default_and_every_word_of_every_technique_can_be_swept():
    words = 0
    for technique, made in REGISTRY.items():
        names = {**vars(sys.modules[made.build.__module__]), **NAMES}
        for name, default in defaults(technique).items():
            hint = eval(known(technique)[name].annotation, names)
            assert checked(technique, {name: default}) == {name: default}
            for word in words_of(hint):
                assert checked(technique, {name: word}) == {name: word}, f"{technique}: {name}"
                words += 1
    assert words > 40, "formats, methods and orders"
    assert len(expand({"slicings": {"format": ["rgba8", "bc7"]}})) == 3


NAMES = {name: getattr(collections.abc, name) for name in ("Callable", "Sequence", "Mapping")}
"""Types that modules import for the type checker alone; the others name no words."""
NAMES |= dict.fromkeys(("ArrayLike", "Camera", "CriterionLike", "NDArray", "Plant"), typing.Any)


def words_of(hint):
    if typing.get_origin(hint) is typing.Literal:
        return [*typing.get_args(hint)]
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return [word for part in typing.get_args(hint) for word in words_of(part)]
    return []


# Labels


def test_labels_say_what_varies():
    assert labels_of(["slicings", "simplified_mesh"]) == [
        "full_mesh",
        "slicings",
        "simplified_mesh",
    ]
    assert labels_of({"slicings": {"slice_count": [1, 3], "resolution": 64}}) == [
        "full_mesh",
        "slicings:slice_count=1",
        "slicings:slice_count=3",
    ]
    grid = {"leaf_clusters": {"cluster_count": [8, (32, 16)], "outline": [None, 6]}}
    assert labels_of(grid)[1:] == [
        "leaf_clusters:cluster_count=8,outline=none",
        "leaf_clusters:cluster_count=8,outline=6",
        "leaf_clusters:cluster_count=32+16,outline=none",
        "leaf_clusters:cluster_count=32+16,outline=6",
    ]
    assert labels_of({"full_mesh": {"wood": False}}) == ["full_mesh", "full_mesh:wood=false"]


def test_labels_are_short_where_they_stay_different():
    grid = {"stochastic_pruning": {"shrink": [0.1, 0.1 + 0.2]}}
    assert labels_of(grid)[1:] == ["stochastic_pruning:shrink=0.1", "stochastic_pruning:shrink=0.3"]
    grid = {"stochastic_pruning": {"shrink": [0.3, 0.1 + 0.2]}}
    assert len(set(labels_of(grid))) == 3


# What is refused


@pytest.mark.parametrize(
    ("grid", "error", "message"),
    [
        ({"sketches": {}}, ValueError, "unknown technique 'sketches'; there are billboard"),
        (["sketches"], ValueError, "unknown technique 'sketches'"),
        ("slicings", TypeError, "grid must map"),
        (7, TypeError, "grid must map"),
        ({"slicings": 7}, TypeError, "slicings must have a dict of parameters.* got 7"),
        ({"slicings": []}, ValueError, "the list of slicings is empty"),
        ({"slicings": ["x"]}, TypeError, "slicings must have a dict of parameters"),
        ({"slicings": {"slices": 3}}, ValueError, "slicings: slices is no parameter of it; there"),
        ({"slicings": {"views": []}}, ValueError, "slicings: views has no value"),
        ({"slicings": {"threads": 1}}, ValueError, "slicings: threads is not swept"),
        ({"slicings": {"slice_count": []}}, ValueError, "slicings: slice_count has no value"),
        ({"slicings": {"slice_count": "3"}}, TypeError, "slice_count must be int .*'3'"),
        ({"slicings": {"slice_count": [3, 2.5]}}, TypeError, "slice_count must be int .*2.5"),
        ({"slicings": {"slice_count": True}}, TypeError, "slice_count must be int .*True"),
        ({"slicings": {"slice_count": None}}, TypeError, "slice_count must be int .*None"),
        ({"slicings": {"resolution": (1, 2, 3)}}, TypeError, r"resolution must be int \| tuple"),
        ({"slicings": {"format": "png"}}, ValueError, "format must be 'rgba8' or 'rgb5a1' or"),
        ({"slicings": {"correction": "fat"}}, ValueError, "correction must be 'fit' or 'optical'"),
        ({"slicings": {"correction": np.nan}}, ValueError, "correction must be finite, got nan"),
        ({"slicings": {"correction": 10**400}}, ValueError, "correction must be finite, got a num"),
        ({"leaf_clusters": {"cluster_count": 3.5}}, TypeError, "cluster_count must be int .*3.5"),
        ({"slicings": {"wood": 1}}, TypeError, "slicings: wood must be bool, got 1"),
        (
            {"slicings": tl.zipped(slice_count=[1], resolution=["x"])},
            TypeError,
            "resolution must be int",
        ),
    ],
)  # fmt: skip
def test_refuses(grid, error, message):
    with pytest.raises(error, match=message):
        expand(grid)


def test_zipped_and_crossed_refuse():
    with pytest.raises(ValueError, match="zipped: slice_count has 2 values and resolution has 1"):
        tl.zipped(slice_count=[1, 2], resolution=[8])
    with pytest.raises(TypeError, match="zipped: resolution must be a list of values, got 8"):
        tl.zipped(slice_count=[1, 2], resolution=8)
    with pytest.raises(ValueError, match="zipped needs at least one"):
        tl.zipped()
    with pytest.raises(ValueError, match="zipped needs at least one"):
        tl.zipped(slice_count=[])
    with pytest.raises(ValueError, match="crossed: slice_count is in two parts"):
        tl.crossed({"slice_count": [1]}, tl.zipped(slice_count=[2], resolution=[3]))
    with pytest.raises(TypeError, match="crossed must have a dict"):
        tl.crossed([1, 2])


# Files


GOOD = """
[plants]
chestnut = "chestnut"
small = { preset = "chestnut", seed = 7, leaf_count = 60 }
oak = "trees/oak.glb"
ash = { file = "ash.obj", foliage = ["leaf"], up = "z", unit = 0.01 }

[cameras]
azimuths = 2
elevations = [0, 10]
distances = 2.5
size = [64, 48]

[techniques.slicings]
slice_count = [3, 5]
resolution = { from = 64, to = 256, count = 3, scale = "log" }
correction = { from = 0, to = 0.3, step = 0.1 }

[[techniques.leaf_clusters]]
cluster_count = [8, [32, 16]]
[[techniques.leaf_clusters]]
zip = { cluster_count = [4, 2], resolution = { from = 32, to = 64, count = 2 } }
drawing = ["test", "blend"]

[settings]
samples = 1
timing = "none"
"""


@pytest.fixture
def config(tmp_path):
    def write(text):
        path = tmp_path / "sweep.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_a_file_is_the_grid_that_it_says(config):
    read = read_config(config(GOOD))
    assert read.settings == {"samples": 1, "timing": "none"}
    assert read.plants == {
        "chestnut": {"preset": "chestnut"},
        "small": {"preset": "chestnut", "seed": 7, "leaf_count": 60},
        "oak": {"file": "trees/oak.glb"},
        "ash": {"file": "ash.obj", "foliage": ["leaf"], "up": "z", "unit": 0.01},
    }
    names = ("slice_count", "resolution", "correction")
    assert params_of(read.grid, "slicings", *names) == [
        (slices, resolution, correction)
        for slices in (3, 5)
        for resolution in (64, 128, 256)
        for correction in (0.0, 0.1, 0.2, 0.3)
    ]
    names = ("cluster_count", "resolution", "drawing")
    assert params_of(read.grid, "leaf_clusters", *names) == [
        (8, 512, "test"),
        ((32, 16), 512, "test"),
        (4, 32, "test"),
        (4, 32, "blend"),
        (2, 64, "test"),
        (2, 64, "blend"),
    ]
    plant, source = read.make_plant("small")
    assert plant.foliage.leaf_count == 60
    assert source == {"preset": "chestnut", "seed": 7, "leaf_count": 60}
    views = read.cameras(plant)
    assert len(views) == 4
    assert views[0].size == (64, 48)


def test_plant_files_are_beside_the_file(config, tmp_path):
    path = config('[plants]\ntree = "tree.ply"\n[techniques]\nslicings = {}\n')
    with pytest.raises(FileNotFoundError, match=r"tree\.ply"):
        read_config(path).make_plant("tree")
    text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    text += "property float z\nelement face 1\nproperty list uchar int vertex_indices\n"
    (tmp_path / "tree.ply").write_text(f"{text}end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    plant, source = read_config(path).make_plant("tree")
    assert plant.triangle_count == 1
    assert source["file"] == "tree.ply"
    assert len(source["sha256"]) == 64


PLANTS = '[plants]\nx = "chestnut"\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[plants", r"sweep\.toml: it is no TOML"),
        ("[techniques]\nslicings = {}", r"\[plants\] names no plant"),
        (PLANTS, r"\[techniques\] names no technique"),
        (f"{PLANTS}[techniques]\nsketches = {{}}", "unknown technique 'sketches'"),
        (f"{PLANTS}[techniques]\nslicings = 3", "techniques.slicings must be a table, got 3"),
        (f"{PLANTS}[techniques.slicings]\nslices = 3", "slicings: slices is no parameter"),
        (f"{PLANTS}[technique.slicings]", "the file: 'technique' is not known"),
        (f"{PLANTS}[techniques]\nslicings={{}}\n[settings]\nsample=1", "'sample' is not known"),
        (f"{PLANTS}[techniques]\nslicings={{}}\n[cameras]\nfov=1", "'fov' is not known"),
        (f"{PLANTS}[techniques]\nslicings={{}}\n[cameras]\nsize=1", "size must be .width, heigh"),
        (f"{PLANTS}[techniques]\nslicings={{}}\n[cameras]\nazimuths=1.5", "azimuths must be a wh"),
        (f"{PLANTS}[techniques]\nslicings={{}}\n[cameras]\ndistances=[]", "distances must be a n"),
        ("[plants]\nx = { seed = 1 }\n[techniques]\nslicings={}", "plants.x must have a file or"),
        ("[plants]\nx = { preset = 'oak' }\n[techniques]\nslicings={}", "no preset 'oak'; there"),
        ("[plants]\nx = { file='a', seed=1 }\n[techniques]\nslicings={}", "'seed' is not known"),
    ],
)  # fmt: skip
def test_a_file_is_refused(config, text, message):
    with pytest.raises((ValueError, TypeError), match=message):
        read_config(config(text))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{ from = 1, to = 5 }", "one of count and step"),
        ("{ from = 1, count = 5 }", "a range has from, to"),
        ("{ from = 1, to = 5, count = 2, step = 2 }", "one of count and step"),
        ("{ from = 5, to = 1, count = 2 }", "from must be at most to, got 5 and 1"),
        ("{ from = 1, to = inf, count = 2 }", "from must be at most to"),
        ("{ from = '1', to = 2, count = 2 }", "from must be a number, got '1'"),
        ("{ from = 1, to = 5, step = 0 }", "step must be above 0"),
        ("{ from = 1, to = 5, step = 1e-9 }", "at most 10000 values"),
        ("{ from = 1, to = 5, count = 0 }", "count must be a whole number"),
        ("{ from = 1, to = 5, count = 2.5 }", "count must be a whole number"),
        ("{ from = 0, to = 5, count = 2, scale = 'log' }", "must begin above 0"),
        ("{ from = 1, to = 5, count = 2, scale = 'cubic' }", "'linear' or 'log', got 'cubic'"),
        ("{ from = 1, to = 5, step = 2, scale = 'log' }", "scale goes with count"),
    ],
)
def test_a_range_is_refused(config, text, message):
    with pytest.raises((ValueError, TypeError), match=message):
        read_config(config(f"{PLANTS}[techniques.slicings]\nslice_count = {text}"))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("{ from = 1, to = 7, step = 2 }", [1, 3, 5, 7]),
        ("{ from = 1, to = 6, step = 2 }", [1, 3, 5]),
        ("{ from = 1, to = 5, count = 3 }", [1, 3, 5]),
        ("{ from = 2, to = 2, count = 1 }", [2]),
        ("{ from = 1, to = 4, count = 7 }", [1, 2, 3, 4]),
        ("{ from = 1, to = 100, count = 3, scale = 'log' }", [1, 10, 100]),
    ],
)
def test_ranges_of_whole_numbers(config, text, expected):
    read = read_config(config(f"{PLANTS}[techniques.slicings]\nslice_count = {text}"))
    assert params_of(read.grid, "slicings", "slice_count") == [(value,) for value in expected]
