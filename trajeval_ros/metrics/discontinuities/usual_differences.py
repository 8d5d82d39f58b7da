"""How much the motions of groundtruth and estimate usually differ, by the time between pairs."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.metrics.discontinuities.relative_motion import CELL_S

LAGS = np.array([1, 2, 4, 8, 16, 32, 64])  # cells between learned pairs, up to 32 s
LEAST_M, LEAST_DEG = 0.03, 2.0  # smallest limits: motion capture is not better
KEPT = 240  # learned differences of a lag: 2 min of cells
# Limit: the larger of these multiples of the median and of the 95th percentile. Six medians
# detect steps of 0.1 m of a good estimate, and report about 10 events per hour of a bad one.
_OF_MEDIAN, _OF_TAIL = 6.0, 2.5
_LEAST_SAMPLES = 6
_GROWTH = 1.5  # exponent of the usual difference beyond the learned lags: a random walk of speed


class UsualDifferences:
    """Limits of the differences by the time between two pairs, from those of the last minutes.

    They are learned over one period of the pairs, number 0, and over `lags`, from 1 on.
    """

    def __init__(self, period_s: float) -> None:
        self.lags = LAGS[1.5 * period_s < CELL_S * LAGS]  # those longer than a period
        self._times_s = np.append(period_s, CELL_S * self.lags)
        # Logarithms of times (K,) and of the limits (2, K); None if they are to be computed again.
        self._table: tuple[Floats, Floats] | None = None
        self.clear()

    def add(self, numbers: Indices | int, m: Floats, deg: Floats) -> None:
        """Learn N differences, metres and deg, over lags by their numbers (N,), or over one."""
        numbers = np.broadcast_to(numbers, m.shape)
        is_of_lag = numbers[:, None] == np.arange(len(self._counts))
        counts = self._counts + np.cumsum(is_of_lag, axis=0)  # with this difference
        rows = (counts[np.arange(len(m)), numbers] - 1) % KEPT
        self._samples[numbers, :, rows] = np.column_stack([m, deg])
        self._counts += is_of_lag.sum(axis=0)
        self._table = None

    def clear(self) -> None:
        """Forget all differences."""
        # By lag, metres and deg, and the newest samples in a ring.
        self._samples = np.full((len(self._times_s), 2, KEPT), np.inf)
        self._counts = np.zeros(len(self._times_s), dtype=np.int64)
        self._table = None

    def limit(self, seconds: Floats | float) -> tuple[Floats, Floats]:
        """Return the largest usual difference over times (...), metres and deg; else infinite.

        It is interpolated between lags in logarithms.
        """
        if self._table is None:
            self._table = self._logarithms()
        times, limits = self._table
        if not len(times):
            unknown = np.full(np.shape(seconds), np.inf)
            return unknown, unknown
        at = np.log(np.maximum(seconds, 1e-6))
        beyond = _GROWTH * np.maximum(at - times[-1], 0.0)
        m, deg = (np.exp(np.interp(at, times, values) + beyond) for values in limits)
        return np.maximum(m, LEAST_M), np.maximum(deg, LEAST_DEG)

    def _logarithms(self) -> tuple[Floats, Floats]:
        """Return the logarithms of times and limits, which grow with the time."""
        counts = np.minimum(self._counts, KEPT)
        known = np.flatnonzero(counts >= _LEAST_SAMPLES)
        counts = counts[known]
        ordered = np.sort(self._samples[known], axis=2)
        rows = np.arange(len(known))
        tails = np.minimum(counts - 1, (0.95 * counts).astype(np.int64))
        medians, tail = ordered[rows, :, counts // 2], ordered[rows, :, tails]
        limits = np.maximum(np.maximum(_OF_MEDIAN * medians, _OF_TAIL * tail), 1e-9)
        largest = np.maximum.accumulate(limits, axis=0)
        return np.log(self._times_s[known]), np.log(largest).T
