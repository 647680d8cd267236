"""
Which graphics cards can draw?

``backend="gpu"`` of `render`, `time_frames`, `compare` and `sweep` draws with one of them, through
Vulkan, Metal or DirectX 12. Mesa's llvmpipe is such a card, too: it draws on the processor.
"""

from __future__ import annotations

import atexit
from dataclasses import dataclass

from treelod import _core

__all__ = ["Adapter", "adapters", "release"]


@dataclass(frozen=True, kw_only=True)
class Adapter:
    """
    A graphics card, as its driver describes it.

    Attributes
    ----------
    name : str
        Its name; a part of it chooses the card. Of equal cards the place in the list does: ``"#1"``
        is the second.
    kind : {'discrete', 'integrated', 'virtual', 'cpu', 'other'}
        What it is; ``'cpu'`` is a program that draws on the processor.
    api : {'vulkan', 'metal', 'dx12'}
        What it is spoken to through.
    driver : str
        Its driver and that one's version.
    """

    name: str
    kind: str
    api: str
    driver: str


def adapters() -> list[Adapter]:
    """
    List the graphics cards of this machine.

    Returns
    -------
    list of Adapter
        The one that is taken where nobody chooses first: cards of their own, then those inside a
        processor, and what draws on the processor last. Empty where there is none, or where this
        build of treelod has no GPU backend.

    Raises
    ------
    ForkedError
        In a child that was forked after its parent had asked.

    Examples
    --------
    >>> import treelod as tl
    >>> all(card.api in ("vulkan", "metal", "dx12") for card in tl.gpu.adapters())
    True
    """
    return [Adapter(**facts) for facts in _core.adapters()]


def release() -> None:
    """
    Let go of every graphics card, and of all memory on it.

    What techniques share is kept on a card as long as they live, and a picture's planes until one
    of another size is drawn. The next picture begins anew. Whoever draws in another thread draws
    to the end.

    Raises
    ------
    ForkedError
        In a child that was forked after its parent had drawn.
    """
    _core.release_devices()


# some drivers hang when they are left to the end of the process
atexit.register(_core.close_devices)
