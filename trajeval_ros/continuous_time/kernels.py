"""Kernels: the correlation of a trajectory between two times, eq. (32) of the paper."""

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
        scale: Factor of the normalised lag a = scale |d| / l.
        correlation: The kernel as a function of a, any shape.
        slope: Its derivative by log l, as a function of a.
    """

    scale: float
    correlation: Callable[[Floats], Floats]
    slope: Callable[[Floats], Floats]

    def between(self, lags: Floats, length: float) -> Floats:
        """Return the correlation at lags d of any shape, for the correlation time l, seconds."""
        return self.correlation(np.abs(lags) * (self.scale / length))

    def by_log_length(self, lags: Floats, length: float) -> Floats:
        """Return its derivative by log l."""
        return self.slope(np.abs(lags) * (self.scale / length))


SQUARED_EXPONENTIAL = Kernel(
    1.0, lambda a: np.exp(-0.5 * a * a), lambda a: a * a * np.exp(-0.5 * a * a)
)
"""Eq. (32). Its samples have derivatives of all orders, unlike real motion."""

MATERN_52 = Kernel(
    sqrt(5.0),
    lambda a: (1.0 + a * (1.0 + a / 3.0)) * np.exp(-a),
    lambda a: a * a * (1.0 + a) / 3.0 * np.exp(-a),
)
"""Its samples have a velocity and an acceleration: as smooth as real motion can be."""

MATERN_32 = Kernel(sqrt(3.0), lambda a: (1.0 + a) * np.exp(-a), lambda a: a * a * np.exp(-a))
"""Its samples have a velocity only."""
