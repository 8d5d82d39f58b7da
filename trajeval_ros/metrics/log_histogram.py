"""Quantiles of a stream at a constant cost: counts in bins of equal ratio."""

from __future__ import annotations

import math

import numpy as np

from trajeval_ros.geometry.arrays import Floats

# A factor of two is a whole number of bins, each 2.2 % wide.
_PER_OCTAVE = 32
# Powers of two between which values are told apart: 1e-6 to 1e9 of any unit.
_LOWEST, _HIGHEST = -20, 31
# Upper bounds of an octave's bins, as shares of its end; the first is that of the octave before.
_BOUNDS = 2.0 ** (np.arange(_PER_OCTAVE) / _PER_OCTAVE - 1.0)


class LogHistogram:
    """Counts values in bins; the same counts whatever the order and the batches they come in."""

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
        """Return the upper bound of the bin of the least value that this share doesn't exceed.

        It is that value, or larger by at most 2.2 %. Of no values it is 0.
        """
        counts = self._counts.cumsum()
        if not counts[-1]:
            return 0.0
        place = int(counts.searchsorted(max(1, math.ceil(share * int(counts[-1])))))
        octave, bound = divmod(place, _PER_OCTAVE)
        return math.ldexp(float(_BOUNDS[bound]), octave + _LOWEST)
