"""Kernels: how alike a trajectory is at two times, eq. (32) of the probabilistic paper."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

import numpy as np

from trajeval_ros.geometry.arrays import Floats


@dataclass(frozen=True)
class Kernel:
    """A stationary kernel of unit variance.

    Attributes:
        scale: Factor of the lag |d| / l, for a = scale |d| / l.
        correlation: Of a, of any shape.
        slope: Its derivative by log l, of a.
    """

    scale: float
    correlation: Callable[[Floats], Floats]
    slope: Callable[[Floats], Floats]

    def between(self, lags: Floats, length: float) -> Floats:
        """Return the correlation over lags d of any shape for the length l, seconds."""
        return self.correlation(np.abs(lags) * (self.scale / length))

    def by_log_length(self, lags: Floats, length: float) -> Floats:
        """Return its derivative by log l."""
        return self.slope(np.abs(lags) * (self.scale / length))


SQUARED_EXPONENTIAL = Kernel(
    1.0, lambda a: np.exp(-0.5 * a * a), lambda a: a * a * np.exp(-0.5 * a * a)
)
"""Eq. (32). Its draws have derivatives of all orders, as no real motion has."""

MATERN_52 = Kernel(
    sqrt(5.0),
    lambda a: (1.0 + a * (1.0 + a / 3.0)) * np.exp(-a),
    lambda a: a * a * (1.0 + a) / 3.0 * np.exp(-a),
)
"""Its draws have a velocity and an acceleration but no more: as sure as real motion allows."""

MATERN_32 = Kernel(sqrt(3.0), lambda a: (1.0 + a) * np.exp(-a), lambda a: a * a * np.exp(-a))
"""Its draws have a velocity alone."""
