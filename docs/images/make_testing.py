"""
Draw what the documents show of a test that fails: ``testing.png``.

Run it from the project's root: ``uv run python docs/images/make_testing.py``.
"""

from pathlib import Path

from PIL import Image

import treelod as tl
from treelod.testing import assert_frame_close

HERE = Path(__file__).parent
COLORS = 256


def main() -> None:
    """Let slicings of too few texels fail."""
    plant = tl.grow_plant("chestnut", leaf_count=3000)
    camera = tl.orbit(plant, count=1, distance=2.8, size=(280, 280))[0]
    truth = tl.render(tl.FullMesh.build(plant), camera, samples=64)
    coarse = tl.render(tl.Slicings.build(plant, resolution=24), camera, samples=64)
    try:
        assert_frame_close(coarse, truth, flip=0.05, out=HERE / "testing.png")
    except AssertionError as error:
        print(error)
    picture = Image.open(HERE / "testing.png").convert("RGB")
    small = picture.quantize(COLORS, dither=Image.Dither.NONE)
    small.save(HERE / "testing.png", optimize=True)


if __name__ == "__main__":
    main()
