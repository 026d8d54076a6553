"""Numbers with as many digits as mean something, and texts that move no cursor."""

import math
from collections.abc import Iterable
from unicodedata import category

UNKNOWN = "-"
#: A sigma is shown with so many significant digits, and its value to the last of them.
DIGITS = 2
MAX_DECIMALS = 6


def decimals_of(sigma: float) -> int:
    """Decimals with which a sigma has `DIGITS` significant digits."""
    return min(max(DIGITS - 1 - math.floor(math.log10(sigma)), 0), MAX_DECIMALS)


def number(value: float, digits: int = 3) -> str:
    """A number with significant digits and without an exponent where that is short."""
    if not math.isfinite(value):
        return UNKNOWN
    text = f"{value:.{digits}g}"
    if "e+" in text and abs(value) < 1e7:
        return f"{value:.0f}"
    return text


def with_sigma(values: Iterable[float], sigmas: Iterable[float]) -> str:
    """Values to the digits that the largest of their sigmas leaves: ``12.34 -0.05 ± 0.05``.

    Args:
        values: One or more values of the same unit.
        sigmas: One sigma of each; where none is usable, the values stand alone.
    """
    known = [s for s in sigmas if math.isfinite(s) and s > 0.0]
    if not known:
        return " ".join(number(v) for v in values)
    sigma = max(known)
    decimals = decimals_of(sigma)
    shown = (f"{v:.{decimals}f}" if math.isfinite(v) else UNKNOWN for v in values)
    return f"{' '.join(shown)} ± {sigma:.{decimals}f}"


def printable(text: str) -> str:
    """A text in one row that moves no cursor: what other nodes write may hold anything."""
    return "".join("?" if category(c) in ("Cc", "Cf", "Cs", "Co", "Cn") else c for c in text)
