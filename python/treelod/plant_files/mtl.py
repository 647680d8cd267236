"""
MTL, the materials of an OBJ file: colour, opacity and pictures.

Conventions where the format leaves them open: with a picture (map_Kd) the colour Kd is ignored, as
most programs do, since exporters write black or grey there; Kd without a picture is linear; a
map_d, or a map_Kd with alpha, cuts out at 0.5; without either, d below 1 blends. Options of a map
are read past, but for ``-clamp on``.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from treelod.errors import PlantFileError
from treelod.plant_files.model import AlphaMode, MaterialFacts, Wrap
from treelod.plant_files.sources import Source

__all__ = ["MAX_BYTES", "Entry", "parse"]

MAX_BYTES = 1 << 22
"""Longest MTL file: 4 MiB, a kilobyte for each of 4,096 materials; most files hold a dozen."""

MASK_CUTOFF = 0.5

OPTION_LENGTHS = {
    "-blendu": 1,
    "-blendv": 1,
    "-bm": 1,
    "-boost": 1,
    "-cc": 1,
    "-clamp": 1,
    "-imfchan": 1,
    "-mm": 2,
    "-texres": 1,
    "-type": 1,
}
"""How many words follow an option; -o, -s and -t take one to three numbers."""

PLACING = ("-o", "-s", "-t")


@dataclass
class Entry:
    """One material while it is being read."""

    name: str
    kd: tuple[float, float, float] = (1.0, 1.0, 1.0)
    opacity: float = 1.0
    picture: str | None = None
    opacity_picture: str | None = None
    clamp: bool = False
    is_placed: bool = False

    @property
    def color(self) -> tuple[float, float, float, float]:
        """Linear colour factor with straight alpha."""
        kd = self.kd if self.picture is None else (1.0, 1.0, 1.0)
        return (*kd, self.opacity)

    def facts(self, source: Source, warnings: list[str]) -> MaterialFacts:
        """Decode the pictures; what is read past is added to `warnings`."""
        if self.is_placed:
            warnings.append(f"the options -o, -s and -t of material {self.name!r} are ignored")
        texture = self.texture(source)
        mode: AlphaMode = "opaque"
        if texture is not None and int(texture[..., 3].min()) < 255:
            mode = "mask"
        elif self.opacity < 1:
            mode = "blend"
        wrap: Wrap = "clamp" if self.clamp else "repeat"
        return MaterialFacts(
            name=self.name,
            texture=texture,
            wrap=(wrap, wrap),
            alpha_mode=mode,
            alpha_cutoff=MASK_CUTOFF,
            double_sided=True,
        )

    def texture(self, source: Source) -> NDArray[np.uint8] | None:
        """Colours of map_Kd with the alpha of map_d."""
        texture = None
        what = f"material {self.name!r}"
        if self.picture is not None:
            texture = source.read_picture(self.picture, what, f"the map_Kd of {what}")
        if self.opacity_picture is None:
            return texture
        opacity = source.read_picture(self.opacity_picture, what, f"the map_d of {what}")
        # a grey picture states opacity as its brightness, one with alpha as its alpha
        alpha = opacity[..., 3] if int(opacity[..., 3].min()) < 255 else opacity[..., 0]
        if texture is None:
            texture = np.full((*alpha.shape, 4), 255, np.uint8)
        texture = texture.copy()
        if alpha.shape != texture.shape[:2]:
            size = (texture.shape[1], texture.shape[0])
            alpha = np.asarray(Image.fromarray(alpha).resize(size, Image.Resampling.NEAREST))
        texture[..., 3] = alpha
        return texture


def parse(text: str) -> dict[str, Entry]:
    """Materials of an MTL file by name."""
    entries: dict[str, Entry] = {}
    entry = Entry(name="")
    for line in text.split("\n"):
        words = line.split()
        if not words:
            continue
        key, values = words[0].lower(), words[1:]
        if key == "newmtl":
            entry = Entry(name=line.split(None, 1)[1].strip() if values else "")
            entries[entry.name] = entry
        elif key == "kd":
            entry.kd = _color(values, entry.name)
        elif key in ("d", "tr"):
            value = _number(values[-1:], entry.name)
            entry.opacity = value if key == "d" else 1 - value
        elif key == "map_kd":
            entry.picture = _file_name(values, entry)
        elif key == "map_d":
            entry.opacity_picture = _file_name(values, entry)
    return entries


def _number(values: list[str], name: str) -> float:
    try:
        value = float(values[0])
    except (IndexError, ValueError):
        value = float("nan")
    if not 0 <= value <= 1:
        msg = f"material {name!r}: {' '.join(values) or 'nothing'} where a number in [0, 1] is due"
        raise PlantFileError(msg)
    return value


def _color(values: list[str], name: str) -> tuple[float, float, float]:
    red = _number(values[:1], name)
    if len(values) == 1:
        return (red, red, red)
    return (red, _number(values[1:2], name), _number(values[2:3], name))


def _file_name(values: list[str], entry: Entry) -> str:
    """Return what is left of a map line after its options; names may hold spaces."""
    rest = list(values)
    while rest and rest[0].startswith("-"):
        option = rest.pop(0).lower()
        if option in PLACING:
            entry.is_placed = True
            for _ in range(3):
                if len(rest) > 1 and _is_number(rest[0]):
                    rest.pop(0)
        elif option in OPTION_LENGTHS:
            if option == "-clamp" and rest[:1] == ["on"]:
                entry.clamp = True
            del rest[: OPTION_LENGTHS[option]]
        else:
            msg = f"material {entry.name!r}: unknown map option {option}"
            raise PlantFileError(msg)
    if not rest:
        msg = f"material {entry.name!r}: a map without a file"
        raise PlantFileError(msg)
    return " ".join(rest)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
