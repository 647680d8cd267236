"""What a validation finds: figures with their limits, by section, and pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Check", "Panel", "Section", "rmse", "words_for"]


@dataclass(frozen=True, kw_only=True)
class Check:
    """
    One figure and its limit.

    Attributes
    ----------
    name : str
        What is measured, in a few words; the same for every plant.
    value : float
        The figure.
    relation : {'<=', '>='}
        On which side of `limit` it must lie.
    limit : float
        Its limit.
    note : str
        What else is worth knowing of this plant's figure, or nothing.
    """

    name: str
    value: float
    relation: Literal["<=", ">="]
    limit: float
    note: str = ""

    @property
    def passed(self) -> bool:
        """Whether the figure keeps to its limit; NaN and infinity do not."""
        if not math.isfinite(self.value):
            return False
        return self.value <= self.limit if self.relation == "<=" else self.value >= self.limit


def words_for(value: float) -> str:
    """
    Say what a figure is that cannot be written in digits.

    Parameters
    ----------
    value : float
        Any.

    Returns
    -------
    str
        "not a number", "infinite", or nothing for a finite figure.
    """
    if math.isnan(value):
        return "not a number"
    return "infinite" if math.isinf(value) else ""


def rmse(a: NDArray[Any], b: NDArray[Any]) -> float:
    """
    Return the root mean square difference of two pictures.

    Parameters
    ----------
    a, b : ndarray
        Of the same shape.

    Returns
    -------
    float
    """
    return math.sqrt(float(np.mean(np.square(np.subtract(a, b, dtype=np.float64)))))


@dataclass(frozen=True, kw_only=True, eq=False)
class Panel:
    """
    Two pictures and their difference; 0 to 1.

    Attributes
    ----------
    title : str
        What they show.
    ours, reference : ndarray of shape (H, W) or (H, W, 3)
        sRGB values, or coverage.
    difference : ndarray of shape (H, W)
        Black is none.
    """

    title: str
    ours: NDArray[Any]
    reference: NDArray[Any]
    difference: NDArray[Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class Section:
    """
    Checks of one kind.

    Attributes
    ----------
    title : str
        For the report.
    what : str
        What is compared with what.
    checks : list of Check
        The figures.
    panels : list of Panel
        Pictures.
    """

    title: str
    what: str
    checks: list[Check]
    panels: list[Panel] = field(default_factory=list)

    @property
    def passed(self) -> bool:
        """Whether all checks passed."""
        return all(check.passed for check in self.checks)
