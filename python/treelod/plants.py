"""Where plants come from: files, or a preset and a seed."""

import operator
from collections.abc import Callable

from treelod import _core
from treelod.loading import load_plant
from treelod.plant import Foliage, Lighting, Material, Mesh, Plant

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

PRESETS: tuple[str, ...] = tuple(_core.preset_names())
"""Plants that `grow_plant` knows."""


def grow_plant(
    preset: str,
    *,
    seed: int = 1,
    leaf_count: int | None = None,
    lighting: Lighting | None = None,
    progress: Callable[[int, int], object] | None = None,
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
    progress : callable, optional
        Called as ``progress(done, total)`` while leaves grow, and once more from 0 on while
        occlusion is computed, if there is any; what it raises stops the call.

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
    return Plant(_core.grow(preset, seed, leaf_count, facts, progress=progress))
