"""Harmful files: each its named exception within a second, in little memory, and never another."""

import copy
import json
import os
import re
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import treelod as tl
from attacks import ASCII_PLY, ATTACKS, BOMBS, OBJ
from made_gltf import textured
from treelod.errors import LimitError, PlantFileError

LIMIT_SECS = 1.0
"""Of work for one file; the machine may have other things to do."""

MEMORY_BYTES = 192 << 20
"""What a bomb may ask for beyond an idle loader: a picture at the limit decodes to 64 MiB."""


@pytest.fixture(scope="module", autouse=True)
def _loaded_libraries(tmp_path_factory):
    """Readers import their libraries at need, which is not a file's fault."""
    path = textured([[[1, 2, 3]]]).write(tmp_path_factory.mktemp("right") / "a.gltf")
    assert tl.load_plant(path).triangle_count == 2


@pytest.mark.parametrize("name", ATTACKS)
def test_attack(tmp_path, name):
    attack = ATTACKS[name]
    path = attack.write(tmp_path)
    start = time.process_time()
    with pytest.raises(attack.error, match=attack.message) as caught:
        tl.load_plant(path)
    assert time.process_time() - start < LIMIT_SECS
    assert str(caught.value).startswith(f"{path}: ")


def test_bombs(tmp_path):
    # in a process that cannot have much: what asks for more raises MemoryError instead
    files = {}
    for name, bomb in BOMBS.items():
        folder = tmp_path / name
        folder.mkdir()
        files[name] = str(bomb.write(folder))
    code = """
        import json, resource, sys, time
        import trimesh
        from PIL import Image
        import treelod as tl
        Image.init()
        files = json.load(sys.stdin)
        used = lambda: int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
        for suffix in ("gltf", "obj", "ply"):  # everything is imported before memory is counted
            tl.load_plant(f"{sys.argv[2]}/right.{suffix}")
        results = {}
        for name, path in files.items():
            limit = used() + int(sys.argv[1])
            resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))
            start = time.process_time()
            try:
                outcome = ["loaded", str(tl.load_plant(path))]
            except Exception as error:
                outcome = [type(error).__name__, str(error)]
            results[name] = [*outcome, time.process_time() - start]
        print(json.dumps(results))
    """
    textured([[[1, 2, 3]]]).write(tmp_path / "right.gltf")
    (tmp_path / "right.obj").write_text(OBJ + "f 1 2 3\n")
    (tmp_path / "right.ply").write_text(ASCII_PLY + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), str(MEMORY_BYTES), str(tmp_path)],
        input=json.dumps(files),
        capture_output=True,
        text=True,
        timeout=100,
        env={**os.environ, "TREELOD_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr
    results = json.loads(done.stdout)
    for name, bomb in BOMBS.items():
        kind, message, secs = results[name]
        assert kind == bomb.error.__name__, f"{name}: {message}"
        assert re.search(bomb.message, message), f"{name}: {message}"
        assert message.startswith(files[name]), name
        assert secs < LIMIT_SECS, f"{name}: {secs} s"


# --- any change to a right header ----------------------------------------------------------------

RIGHT = textured([[[1, 2, 3], [4, 5, 6]]], alphaMode="MASK", alphaCutoff=0.25)
RIGHT["samplers"] = [{"wrapS": 33071}]
RIGHT["textures"][0]["sampler"] = 0
RIGHT["nodes"] = [
    {"children": [1], "translation": [1, 2, 3], "rotation": [0, 0, 0, 1], "scale": [1, 1, 2]},
    {"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {}}}},
]
RIGHT["extensionsUsed"] = RIGHT["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]


def places_in(value, path=()):
    """Paths of everything in a JSON value."""
    yield path
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from places_in(inner, (*path, key))
    elif isinstance(value, list):
        for number, inner in enumerate(value):
            yield from places_in(inner, (*path, number))


HEADER = json.loads(json.dumps(RIGHT.finished()))
PLACES = [path for path in places_in(HEADER) if path]

json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-3, 9)
    | st.sampled_from([2**31, 2**32, 2**63, 2**64, -(2**63), 10**400, 5120, 5123, 5126])
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.sampled_from(["", "VEC3", "SCALAR", "MASK", "../a", "a.png", "data:;base64,AAAA"]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(
        ["mesh", "children", "attributes", "POSITION", "extensions", "index", "bufferView", "uri"]
    ), inner, max_size=3),
    max_leaves=4,
)  # fmt: skip


@st.composite
def changed_headers(draw):
    """A right header with one to three things replaced, doubled, or left out."""
    header = copy.deepcopy(HEADER)
    for _ in range(draw(st.integers(1, 3))):
        *parents, last = draw(st.sampled_from(PLACES))
        target = header
        try:
            for key in parents:
                target = target[key]
            kind = draw(st.sampled_from(["replace", "replace", "remove", "double"]))
            if kind == "remove":
                del target[last]
            elif kind == "double" and isinstance(target, list):
                target.append(copy.deepcopy(target[last]))
            else:
                target[last] = draw(json_values)
        except (KeyError, IndexError, TypeError):
            continue  # an earlier change took this place away
    return header


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("changed")


def loaded(folder, header):
    """Write a header with the right one's data, and load it."""
    path = Path(folder) / "a.gltf"
    if header.get("buffers") == HEADER["buffers"]:
        made = copy.copy(RIGHT)
        made.header = header
        made.write(path)
    else:
        path.write_text(json.dumps(header))
    return tl.load_plant(path)


@settings(max_examples=300)
@pytest.mark.filterwarnings("ignore:.*ignored:UserWarning")
@given(header=changed_headers())
def test_any_change_to_a_header_is_loaded_or_refused(folder, header):
    start = time.process_time()
    try:
        said = str(loaded(folder, header))
    except (PlantFileError, LimitError) as error:
        said = str(error)
    assert time.process_time() - start < LIMIT_SECS
    # said by a check of ours, not stumbled over
    assert "damaged, or no GLTF file" not in said


def test_the_unchanged_header_is_loaded(folder):
    assert loaded(folder, copy.deepcopy(HEADER)).triangle_count == 2
