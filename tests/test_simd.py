"""Is a picture the same with any vector instructions, and can they be chosen?"""

import hashlib
import os
import subprocess
import sys

import pytest

import treelod as tl
from treelod import _core
from treelod.render import camera_facts
from treelod.scenes import Scene

LEVELS = ("scalar", "sse2", "avx2", "avx512")

SCRIPT = """
import hashlib, treelod as tl
plant = tl.grow_plant("chestnut", leaf_count=200)
camera = tl.orbit(plant, count=1, size=(96, 64))[0]
digest = hashlib.sha256()
for lod in (tl.FullMesh.build(plant), tl.Slicings.build(plant, slicing_count=3, resolution=32)):
    for samples in (1, 4, 16, 17):
        frame = tl.render(lod, camera, samples=samples, outputs=("color", "depth", "ids"))
        digest.update(frame.color.tobytes() + frame.depth.tobytes() + frame.ids.tobytes())
    for texture in lod.textures:
        digest.update(texture.levels[0].tobytes())
print(digest.hexdigest())
"""


def run_with(level):
    environment = {key: value for key, value in os.environ.items() if key != "TREELOD_SIMD"}
    if level is not None:
        environment["TREELOD_SIMD"] = level
    return subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=False, env=environment
    )


def has(level):
    try:
        _core.Renderer(simd=level)
    except ValueError:
        return False
    return True


def test_bakes_and_pictures_are_the_same_bytes_at_every_level():
    done = {level: run_with(level) for level in (None, "", *filter(has, LEVELS))}
    assert {level: run.stderr for level, run in done.items() if run.returncode} == {}
    assert len({run.stdout for run in done.values()}) == 1
    assert "scalar" in done


def test_a_level_that_is_not_there_is_refused():
    done = run_with("avx9")
    assert done.returncode == 1
    assert "ValueError: TREELOD_SIMD: must be one of" in done.stderr
    with pytest.raises(ValueError, match="simd: must be one of"):
        _core.Renderer(simd="")


def test_a_renderer_uses_the_level_it_was_made_with():
    plant = tl.grow_plant("grass")
    scene, camera = (
        Scene([(tl.FullMesh.build(plant), None)]),
        camera_facts(tl.orbit(plant, count=1, size=(64, 64))[0]),
    )
    digests = set()
    for level in filter(has, LEVELS):
        planes, _ = _core.Renderer(simd=level).render(
            scene._core,
            camera,
            samples=4,
            background=(0.0, 0.0, 0.0, 0.0),
            outputs=["color"],
            threads=1,
        )
        digests.add(hashlib.sha256(planes["color"].tobytes()).hexdigest())
    assert len(digests) == 1
