"""
What a cell of a sweep is, and what names it: one representation from one camera, measured once.

The key is the SHA-256 of everything that decides the row: content of the plant, technique, all
parameters, the camera, how it is measured and timed, and the code that computes. Names of plants
and positions in lists of cameras decide nothing and are not in it.
"""

from __future__ import annotations

import hashlib
import operator
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from treelod import metrics
from treelod.render import check_backend, sample_count, thread_count
from treelod.sweeps.parameters import canonical, written

if TYPE_CHECKING:
    from treelod.cameras import Camera
    from treelod.results import View
    from treelod.sweeps.grid import Variant

__all__ = ["STORE_VERSION", "Cell", "Settings", "Timing", "key_of", "whole"]

STORE_VERSION = 3
"""Rises when rows of an older store would mean something else."""

Timing = Literal["shared", "exclusive", "none"]


@dataclass(frozen=True, kw_only=True)
class Settings:
    """
    How every cell of a sweep is measured.

    Attributes
    ----------
    samples, reference_samples : int
        Samples a pixel of frames that are timed, and of those that are measured.
    repeats, warmup : int
        Timed frames, and frames before them; both 0 where nothing is timed.
    timing : {'shared', 'exclusive', 'none'}
        Whether other cells may run while one is timed.
    threads : int or None
        Threads that were asked for.
    ppd : float
        Pixels a degree of sight.
    yee : bool
        Whether Yee's metric is measured.
    backend : {'cpu', 'gpu'}
        What draws the frames that are timed; where none is, the processor.
    adapter : str or None
        Which graphics card: as it was asked for, until `on_card` names it in full.
    """

    samples: int
    reference_samples: int
    repeats: int
    warmup: int
    timing: Timing
    threads: int | None
    ppd: float
    yee: bool
    backend: str
    adapter: str | None

    @classmethod
    def checked(
        cls,
        *,
        samples: int = 4,
        reference_samples: int = 64,
        repeats: int = 9,
        warmup: int = 2,
        timing: Timing = "shared",
        threads: int | None = None,
        ppd: float = metrics.DEFAULT_PPD,
        yee: bool = False,
        backend: str = "cpu",
        adapter: str | None = None,
    ) -> Settings:
        """
        Refuse settings of another type or out of range.

        Parameters
        ----------
        samples, reference_samples, repeats, warmup, timing, threads, ppd, yee, backend, adapter
            As `sweep` takes them.

        Returns
        -------
        Settings

        Raises
        ------
        ValueError
            If a number is out of range, timing is no word of the three, or backend names nothing.
        TypeError
            If a value is of another type; the message names it.
        """
        if timing not in ("shared", "exclusive", "none"):
            msg = f"timing must be 'shared', 'exclusive' or 'none', got {timing!r}"
            raise ValueError(msg)
        if whole("repeats", repeats) < 1 or whole("warmup", warmup) < 0:
            msg = f"repeats must be at least 1 and warmup at least 0, got {repeats} and {warmup}"
            raise ValueError(msg)
        if isinstance(ppd, bool | str) or not hasattr(ppd, "__float__"):
            msg = f"ppd must be a number, got {ppd!r}"
            raise TypeError(msg)
        metrics.check_ppd(ppd)
        if not isinstance(yee, bool | np.bool_):
            msg = f"yee must be True or False, got {yee!r}"
            raise TypeError(msg)
        check_backend(backend, adapter)
        is_timed = timing != "none"
        count = sample_count(whole("samples", samples))
        try:
            reference_count = sample_count(whole("reference_samples", reference_samples))
        except ValueError as error:
            msg = f"reference_{error}"
            raise ValueError(msg) from None
        return cls(
            samples=count,
            reference_samples=reference_count,
            repeats=operator.index(repeats) if is_timed else 0,
            warmup=operator.index(warmup) if is_timed else 0,
            timing=timing,
            threads=None if threads is None else thread_count(whole("threads", threads)),
            ppd=float(ppd),
            yee=bool(yee),
            # a card draws nothing but what is timed
            backend=backend if is_timed else "cpu",
            adapter=adapter if is_timed else None,
        )

    def on_card(self, name: str) -> Settings:
        """
        Name the graphics card in full: a part of the name may mean another one elsewhere.

        Parameters
        ----------
        name : str
            The card's.

        Returns
        -------
        Settings
        """
        return replace(self, adapter=name)


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell:
    """
    One representation from one camera.

    Attributes
    ----------
    plant : str
        The plant's name in this sweep.
    plant_digest : str
        What names its content.
    variant : Variant
        Technique and parameters.
    view : View
        The camera.
    identity : dict of str to object
        Everything that decides the row, as JSON holds it.
    key : str
        What names the identity.
    """

    plant: str
    plant_digest: str
    variant: Variant
    view: View
    identity: dict[str, Any]
    key: str

    @classmethod
    def of(
        cls,
        plant: str,
        plant_digest: str,
        variant: Variant,
        view: View,
        settings: Settings,
        kernel_version: str,
    ) -> Cell:
        """
        Name a cell.

        Parameters
        ----------
        plant : str
            The plant's name in this sweep.
        plant_digest : str
            What names its content.
        variant : Variant
            Technique and parameters.
        view : View
            The camera.
        settings : Settings
            How it is measured.
        kernel_version : str
            What computes.

        Returns
        -------
        Cell
        """
        timing: dict[str, Any] = {"mode": settings.timing}
        if settings.timing != "none":
            timing |= {
                "repeats": settings.repeats,
                "warmup": settings.warmup,
                "threads": settings.threads,
            }
        if settings.backend != "cpu":
            timing |= {"backend": settings.backend, "adapter": settings.adapter}
        identity = {
            "store": STORE_VERSION,
            "kernel": kernel_version,
            "plant": plant_digest,
            "technique": variant.technique,
            "params": variant.canonical_params(),
            "camera": _camera_facts(view.camera),
            "samples": settings.samples,
            "reference_samples": settings.reference_samples,
            "ppd": settings.ppd,
            "yee": settings.yee,
            "timing": timing,
        }
        return cls(
            plant=plant,
            plant_digest=plant_digest,
            variant=variant,
            view=view,
            identity=identity,
            key=key_of(identity),
        )

    def same_errors(self) -> list[str]:
        """
        Return the keys of rows whose errors are this cell's, if a graphics card is to be timed.

        Returns
        -------
        list of str
            Of the same cell timed on the processor, and of the same cell not timed. The processor
            draws all frames that are measured, so errors do not depend on the card.
        """
        timing = self.identity["timing"]
        if "backend" not in timing:
            return []
        here = {name: v for name, v in timing.items() if name not in ("backend", "adapter")}
        return [key_of(self.identity | {"timing": other}) for other in (here, {"mode": "none"})]


def whole(name: str, value: Any) -> int:
    """
    Return a whole number.

    Parameters
    ----------
    name : str
        The argument, for the message.
    value : object
        What was given for it.

    Returns
    -------
    int

    Raises
    ------
    TypeError
        If it is none.
    """
    if isinstance(value, bool) or not hasattr(value, "__index__"):
        msg = f"{name} must be a whole number, got {value!r}"
        raise TypeError(msg)
    return operator.index(value)


def key_of(identity: dict[str, Any]) -> str:
    """
    Name an identity.

    Parameters
    ----------
    identity : dict of str to object
        Of a cell.

    Returns
    -------
    str
        64 hexadecimal digits.
    """
    return hashlib.sha256(written(identity).encode()).hexdigest()


def _camera_facts(camera: Camera) -> dict[str, Any]:
    return {name: canonical(f"camera: {name}", value) for name, value in asdict(camera).items()}
