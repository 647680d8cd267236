"""
How numbers are written, in the report and in the terminal.

Digits are those that mean something, and columns align: a minus is as wide as a plus.
"""

from __future__ import annotations

import math
import re

__all__ = [
    "count",
    "decibels",
    "error",
    "millis",
    "number",
    "pieces",
    "seconds",
    "signed",
    "similarity",
    "size_bytes",
    "times",
]

NONE = "\N{EN DASH}"
"""Stands where a number does not exist."""


def pieces(label: str) -> list[str]:
    """Cut a label where it may break, after colons and commas, as in ``a:b=1,c=2``."""
    return re.split(r"(?<=[:,])", label)


def error(value: float | None) -> str:
    """Return an error with four decimals; a dash for None and NaN."""
    if value is None or math.isnan(value):
        return NONE
    return f"{value:.4f}"


def similarity(value: float | None) -> str:
    """Return a similarity with three decimals; a dash for None and NaN."""
    return NONE if value is None or math.isnan(value) else f"{value:.3f}"


def signed(value: float | None) -> str:
    """Return a signed number with four decimals; a dash for None and NaN."""
    if value is None or math.isnan(value):
        return NONE
    # a minus sign as wide as the plus, so that columns align
    text = f"{value:+.4f}".replace("-", "\N{MINUS SIGN}")
    return "0.0000" if text[1:] == "0.0000" else text


def decibels(value: float | None) -> str:
    """Return decibels with one decimal; a dash for None and NaN."""
    if value is None or math.isnan(value):
        return NONE
    return "∞" if math.isinf(value) else f"{value:.1f}"


def millis(value: float) -> str:
    """Return milliseconds with three digits."""
    if value >= 100.0:
        return f"{value:,.0f}"
    return f"{value:.1f}" if value >= 10.0 else f"{value:.2f}"


def seconds(value: float) -> str:
    """Return seconds with their unit."""
    return f"{value:.2f} s" if value < 100.0 else f"{value:,.0f} s"


def times(value: float) -> str:
    """Return a factor with three digits and a multiplication sign."""
    digits = f"{value:.2f}" if value < 10.0 else f"{value:.0f}"
    return f"{digits}\N{MULTIPLICATION SIGN}"


def size_bytes(value: float) -> str:
    """Return bytes in decimal units."""
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if value >= scale:
            return f"{value / scale:.2f} {unit}"
    return f"{value:.0f} B"


def count(value: int) -> str:
    """Return a whole number in groups of three."""
    # thin spaces between groups, as in print
    return f"{int(value):,}".replace(",", "\N{NARROW NO-BREAK SPACE}")


def number(value: float) -> str:
    """Return a number with four digits, without an exponent where people read it easily."""
    return count(round(value)) if 1e4 <= abs(value) < 1e9 else f"{value:.4g}"
