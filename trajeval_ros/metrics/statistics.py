"""Statistics of a set of errors, by name."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Floats

_BLOCK = 8192  # values per block, so that a block fits into a core's cache


@dataclass(frozen=True, repr=False)
class Statistics:
    """Statistics of non-negative errors, in the unit of the errors.

    `std` is the population's (ddof 0), as in rpg_trajectory_evaluation and evo. `p95` is the 95th
    percentile of the sample (linear between order statistics), not of a normal distribution.

    Example:
        >>> from trajeval_ros import Statistics
        >>> Statistics(rmse=5.0, mean=4.0, median=4.0, std=3.0, min=1.0, max=7.0, p95=6.7, count=2)
        <Statistics rmse 5, mean 4, median 4, std 3, min 1, max 7, p95 6.7, count 2>
    """

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float
    p95: float
    count: int

    def __repr__(self) -> str:
        """Return a summary in one line; `dataclasses.asdict` has all digits."""
        names = ("rmse", "mean", "median", "std", "min", "max", "p95")
        values = ", ".join(f"{name} {getattr(self, name):.4g}" for name in names)
        return f"<Statistics {values}, count {self.count}>"

    def scaled(self, factor: float) -> Statistics:
        """Return the statistics of the errors multiplied by `factor` > 0."""
        return Statistics(
            self.rmse * factor,
            self.mean * factor,
            self.median * factor,
            self.std * factor,
            self.min * factor,
            self.max * factor,
            self.p95 * factor,
            self.count,
        )


def statistics_of(errors: Floats | None) -> Statistics | None:
    """Return the statistics of errors (N,); None if there are none.

    The root mean square is eq. (24) of the tutorial.
    """
    return None if errors is None else statistics_in_place(errors.copy())


def statistics_in_place(errors: Floats) -> Statistics | None:
    """Return `statistics_of` errors (N,), which are partly sorted in place."""
    if not len(errors):
        return None
    mean = float(errors.mean())
    rmse, std = _root_mean_square(errors, 0.0), _root_mean_square(errors, mean)
    least, most = float(errors.min()), float(errors.max())
    p95, median = _quantiles(errors, 0.95, 0.5)
    return Statistics(rmse, mean, median, std, least, most, p95, len(errors))


def round_below(value: float) -> float:
    """Return the largest of 1, 2 or 5 times a power of ten that is at most `value` > 0."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value))


def quantile(ordered: Floats, share: float) -> float:
    """Return a quantile of sorted values (N,), interpolated linearly: numpy's default."""
    place = share * (len(ordered) - 1)
    below = int(place)
    above = min(below + 1, len(ordered) - 1)
    return float(ordered[below] + (place - below) * (ordered[above] - ordered[below]))


def median(values: NDArray[Any]) -> float:
    """Return the median of (N,) numbers as `np.median` does; NaN of none, or if one is NaN.

    Numpy's imports its masked arrays, which takes a tenth of the time of a small evaluation.
    """
    if not len(values) or np.isnan(values).any():
        return math.nan
    above = len(values) // 2
    below = above - 1 + len(values) % 2
    ordered = np.partition(values, (below, above))
    return (float(ordered[below]) + float(ordered[above])) / 2.0


def _root_mean_square(values: Floats, centre: float) -> float:
    """Return the root mean square distance of values (N,) from a centre, block by block."""
    parts = (
        float(np.square(values[begin : begin + _BLOCK] - centre).sum())
        for begin in range(0, len(values), _BLOCK)
    )
    return math.sqrt(math.fsum(parts) / len(values))


def _quantiles(values: Floats, *shares: float) -> list[float]:
    """Return quantiles of N > 0 values; partly sorts the values."""
    last = len(values) - 1
    below = [int(share * last) for share in shares]
    values.partition(sorted({*below, *(min(item + 1, last) for item in below)}))
    return [quantile(values, share) for share in shares]


# 32 bins per factor of two, every one 2.2 % wide.
_PER_OCTAVE = 32
# Powers of two of the lowest and the highest bin: 1e-6 to 2e9 of any unit.
_LOWEST, _HIGHEST = -20, 31
# Upper bounds of an octave's bins relative to its end; the first is the end of the octave below.
_BOUNDS = 2.0 ** (np.arange(_PER_OCTAVE) / _PER_OCTAVE - 1.0)


class LogHistogram:
    """Counts values in bins; the counts do not depend on the order or the batches of values."""

    def __init__(self) -> None:
        self._counts = np.zeros((_HIGHEST - _LOWEST) * _PER_OCTAVE + 1, dtype=np.int64)

    def add(self, values: Floats) -> None:
        """Count values (N,), not negative."""
        mantissa, exponent = np.frexp(values)
        bins = (exponent - _LOWEST) * _PER_OCTAVE + _BOUNDS.searchsorted(mantissa)
        size = len(self._counts)
        bins = np.where(values > 0.0, bins, 0).clip(0, size - 1)
        self._counts += np.bincount(bins, minlength=size)

    def quantile(self, share: float) -> float:
        """Return a quantile: the upper bound of the bin that contains it.

        It exceeds the exact quantile by at most 2.2 %. Without values it is 0.
        """
        counts = self._counts.cumsum()
        if not counts[-1]:
            return 0.0
        place = int(counts.searchsorted(max(1, math.ceil(share * int(counts[-1])))))
        octave, bound = divmod(place, _PER_OCTAVE)
        return math.ldexp(float(_BOUNDS[bound]), octave + _LOWEST)
