"""Round numbers for axes, and their text."""

from __future__ import annotations

import math

# Coordinates above these (metres, multiples of the extent) are shown with an offset.
_LARGE_M, _LARGE_EXTENTS = 1000.0, 5.0
_LONGEST, _FINEST = 1e9, 1e-6  # numbers that are written without an exponent


def tick_places(low: float, high: float, most: int) -> list[float]:
    """Return at most `most` round numbers within limits, 1, 2 or 5 times a power of ten apart."""
    span = high - low
    if not (span > 0.0 and math.isfinite(span)):
        return []
    power = 10.0 ** math.floor(math.log10(span / most))
    for factor in (1.0, 2.0, 5.0, 10.0, 20.0):
        step = factor * power
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        if last - first < most:
            break
    return [multiple * step for multiple in range(first, last + 1)]


def tick_labels(places: list[float]) -> list[str]:
    """Return round numbers as texts with equal numbers of decimals."""
    if len(places) < 2:
        return [f"{place:g}" for place in places]
    step, largest = places[1] - places[0], max(map(abs, places))
    if largest >= _LONGEST or step < _FINEST:
        return [f"{place:.12g}" for place in places]
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    return [f"{place:.{decimals}f}".replace("-", "−") for place in places]


def common_offset(low: float, high: float) -> float:
    """Return a round offset of an axis' coordinates if they are large; else 0.0."""
    extent, largest = max(high - low, 1e-6), max(abs(low), abs(high))
    if largest < max(_LARGE_M, _LARGE_EXTENTS * extent):
        return 0.0
    step = 10.0 ** math.ceil(math.log10(extent))
    return math.floor(low / step) * step


def coordinate_label(name: str, offset: float) -> str:
    """Return the label of an axis in metres, with the offset subtracted from its numbers."""
    if offset == 0.0:
        return f"{name} [m]"
    return f"{name} {'−' if offset > 0.0 else '+'} {abs(offset):.10g} [m]"
