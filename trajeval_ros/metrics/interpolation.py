"""How far linear interpolation between an estimate's states may be off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.log_histogram import LogHistogram

_MOST = 0.99  # of the second differences: a jump of the estimate is no curve
_EIGHTH = 0.125


@dataclass(frozen=True)
class Interpolation:
    """Of the states that pairs are interpolated between.

    Attributes:
        step_s: Mean time from one to the next.
        off_m: Upper bound of the error of nearly all interpolated positions, in the estimate's
            unit of length: an eighth of the second differences.
    """

    step_s: float
    off_m: float


class InterpolationMeter:
    """Measures states that come in order, in batches of any size, at a constant cost."""

    def __init__(self) -> None:
        """Create it before the first state."""
        self._curves = LogHistogram()
        self._count = self._first_ns = self._last_ns = 0
        self._newest: Floats = np.empty((0, 3))  # positions, two of them

    def add(self, stamps: Stamps, positions: Floats) -> None:
        """Take states: stamps (N,), nanoseconds, and positions (N, 3)."""
        if not len(stamps):
            return
        if not self._count:
            self._first_ns = int(stamps[0])
        self._count, self._last_ns = self._count + len(stamps), int(stamps[-1])
        path = np.concatenate([self._newest, positions])
        self._curves.add(np.linalg.norm(np.diff(path, n=2, axis=0), axis=1))
        self._newest = path[-2:].copy()

    @property
    def found(self) -> Interpolation | None:
        """What the states tell so far; None of fewer than three."""
        if self._count < 3:
            return None
        step_s = (self._last_ns - self._first_ns) / NANOSECONDS / (self._count - 1)
        return Interpolation(step_s, _EIGHTH * self._curves.quantile(_MOST))
