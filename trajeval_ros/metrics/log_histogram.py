"""Quantiles of a stream at a constant cost: counts in bins of constant ratio."""

from __future__ import annotations

import math

import numpy as np

from trajeval_ros.geometry.arrays import Floats

# 32 bins per factor of two, every one 2.2 % wide.
_PER_OCTAVE = 32
# Powers of two of the lowest and the highest bin: 1e-6 to 2e9 of any unit.
_LOWEST, _HIGHEST = -20, 31
# Upper bounds of an octave's bins relative to its end; the first is the end of the octave below.
_BOUNDS = 2.0 ** (np.arange(_PER_OCTAVE) / _PER_OCTAVE - 1.0)


class LogHistogram:
    """Counts values in bins; the counts do not depend on the order or the batches of values."""

    def __init__(self) -> None:
        """Create it empty."""
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
