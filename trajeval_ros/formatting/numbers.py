"""Formats of numbers in text: digits, percentages and missing values."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

NOTHING = "-"
_SMALLEST = 1e-4  # smaller numbers do not add decimals to a table
_ROUNDING = 1e-9  # percent; 100 * 0.29 is 28.999999999999996


def natural_key(name: str) -> list[tuple[bool, int, str]]:
    """Return a key that sorts names by their numbers, of any length: bag_2 before bag_10."""
    pieces = re.findall(r"0*([0-9]+)|([^0-9]+)", name)
    return [(not digits, len(digits), digits or text) for digits, text in pieces]


def four_digits(value: float) -> str:
    """Return four significant digits without an exponent."""
    if value == 0.0 or abs(value) < 5e-7:
        return "0"
    if abs(value) >= 1000.0:
        return f"{value:.1f}"
    return f"{value:.4g}" if abs(value) >= 1e-3 else f"{value:.6f}"


def one_digit(value: float) -> str:
    """Return one significant digit, from 1000 on with an exponent: 0, 500, 1e3, 1e8."""
    return f"{value:g}" if value < 1000.0 else f"{value:.0e}".replace("e+0", "e")


def significant(value: float, digits: int) -> str:
    """Return significant digits; a large number has all digits before its point instead."""
    return f"{value:.{digits}g}" if abs(value) < 10.0**digits else f"{value:.0f}"


def with_unit(value: float, unit: str) -> str:
    """Return four significant digits and the unit, if any."""
    return f"{significant(value, 4)} {unit}".rstrip()


def three_decimals(value: float | None) -> str:
    """Return three decimals, fewer for a large number and more for a small one.

    Only numbers below a millionth have an exponent. Infinity means a failed run.
    """
    if value is None:
        return NOTHING
    if math.isinf(value):
        return "failed"
    size = abs(value)
    if size >= 1000.0:
        return f"{value:.1f}"
    if size >= 0.01 or size == 0.0:
        return f"{value:.3f}"
    return f"{value:.{2 - math.floor(math.log10(size))}f}" if size >= 1e-6 else f"{value:.3g}"


def decimals_of(values: Iterable[float | None]) -> int:
    """Return the decimals of a table: three, or as many as three digits of the smallest need."""
    sizes = [abs(value) for value in values if value is not None and math.isfinite(value)]
    smallest = min((size for size in sizes if size >= _SMALLEST), default=1.0)
    return 3 if smallest >= 0.01 else 2 - math.floor(math.log10(smallest))


def whole_percent(share: float | None) -> str:
    """Return a share in the nearest whole percent; 100 % only if complete, 0 % only if zero."""
    if share is None:
        return NOTHING
    whole = math.floor(100.0 * share + 0.5 + _ROUNDING)
    least, most = 1 if share > 0.0 else 0, 99 if 100.0 * share < 100.0 - _ROUNDING else 100
    return f"{min(max(whole, least), most)} %"


def percent(share: float) -> str:
    """Return a share in percent with one decimal."""
    return f"{100.0 * share:.1f} %"


def change_percent(share: float, sign: str = "+") -> str:
    """Return a relative change in percent, with one decimal below ten; `sign=""` for a size."""
    return f"{100.0 * share:{sign}.{0 if abs(share) >= 0.1 else 1}f} %"


def data_size(count: int) -> str:
    """Return a number of bytes with at most three significant digits: 12.3 MB."""
    size = float(count)
    for unit in ("B", "kB", "MB", "GB"):
        if size < 999.5:
            return f"{size:.3g} {unit}"
        size /= 1000.0
    return f"{size:.3g} TB"


def metres(value: float | None) -> str:
    """Return a length with its unit."""
    return NOTHING if value is None else f"{three_decimals(value)} m"


def degrees(value: float | None) -> str:
    """Return an angle with its unit."""
    return NOTHING if value is None else f"{three_decimals(value)}°"


def counted(count: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun: "1 run", "2 runs"."""
    return f"{count} {noun if count == 1 else plural or noun + 's'}"
