"""Closed forms of the absolute error (19) for groundtruth positions with the same noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import i0e

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.likelihood.relative_density import LOG_2_PI

Array = NDArray[np.float64]

_NODES = 300


def position_error(groundtruth: Array, estimate: Array, sigma_m: float, gauge: Gauge) -> float:
    """Return log L_AE of positions (M, 3), exactly.

    Rotations follow a von Mises distribution for yaw, a matrix Fisher distribution for SE(3).

    Args:
        groundtruth: (M, 3), metres.
        estimate: (M, 3), metres, in its own frame.
        sigma_m: Standard deviation along each axis of every position.
        gauge: `yaw` or `se3`.

    Raises:
        SettingsError: Another gauge.
    """
    if gauge not in (Gauge.YAW, Gauge.SE3):
        raise SettingsError(f"there is no closed form for gauge {gauge.value}; use yaw or se3")
    count, variance = len(groundtruth), sigma_m**2
    p, q = groundtruth - groundtruth.mean(axis=0), estimate - estimate.mean(axis=0)
    spread = p.T @ q / variance
    value = -1.5 * (count - 1) * (LOG_2_PI + np.log(variance)) - 1.5 * np.log(count)
    value -= 0.5 * float(np.vdot(p, p) + np.vdot(q, q)) / variance
    if gauge is Gauge.YAW:
        kappa = np.hypot(spread[0, 0] + spread[1, 1], spread[1, 0] - spread[0, 1])
        return float(value + spread[2, 2] + LOG_2_PI + np.log(i0e(kappa)) + kappa)
    return float(value + np.log(8.0 * np.pi**2) + log_matrix_fisher(spread))


def log_matrix_fisher(spread: Array) -> float:
    """Return the logarithm of the mean of exp(tr(F^T R)) over all rotations R, F (3, 3)."""
    u, values, vt = np.linalg.svd(spread)
    first, second, third = values * [1.0, 1.0, np.linalg.det(u @ vt)]
    # With u = 1 - x / (s2 + s3), the integrand falls like exp(-x) from x = 0.
    fall = max(second + third, 1.0)
    end = min(2.0 * fall, 800.0)
    points, weights = np.polynomial.legendre.leggauss(_NODES)
    # Squared, so that the nodes are dense where the integrand is steep.
    root = 0.5 * np.sqrt(end) * (points + 1.0)
    x, weights = root**2, 0.5 * np.sqrt(end) * weights * 2.0 * root
    near = 0.5 * (first - second) * x / fall
    far = 0.5 * (first + second) * (2.0 - x / fall)
    exponent = near + far + third * (1.0 - x / fall) - (first + second + third)
    integrand = i0e(near) * i0e(far) * np.exp(exponent)
    integral = float(weights @ integrand) / fall
    return float(np.log(0.5 * integral) + first + second + third)
