"""Kernels, eq. (32) of the probabilistic paper, and their parameters by maximum likelihood.

A kernel is the correlation of a trajectory between two times. Amplitude and time constant of a
motion are the most likely ones over all segments.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from trajeval_ros.geometry.arrays import Floats


@dataclass(frozen=True, eq=False)
class Kernel:
    """A stationary kernel of unit variance."""

    scale: float  # factor of the normalised lag a = scale |d| / l
    correlation: Callable[[Floats], Floats]  # the kernel as a function of a, any shape
    slope: Callable[[Floats], Floats]  # its derivative by log l, as a function of a

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

_MOST_SEGMENTS = 100
_IMPOSSIBLE = 1e25
# Initial time constants, in steps of the samples.
_STARTS = (2.0, 6.0)


@dataclass(frozen=True)
class Hyperparameters:
    """Hyperparameters of a process."""

    sigma: float  # standard deviation of the motion about the reference, metres or rad
    length: float  # correlation time, seconds
    noise: float  # standard deviation of samples, metres or rad


def most_likely(
    kernels: Sequence[Kernel], times: Floats, targets: Floats, noise: float, usual_step_s: float
) -> tuple[Kernel, Hyperparameters]:
    """Return the kernel and hyperparameters with the largest likelihood of all segments.

    Samples at times (S, n), in seconds, have coordinates (S, n, 3): three processes with equal
    hyperparameters. The noise of the samples is given.
    """
    if len(times) > _MOST_SEGMENTS:
        chosen = np.unique(np.linspace(0, len(times) - 1, _MOST_SEGMENTS).astype(np.int64))
        times, targets = times[chosen], targets[chosen]
    lags = times[:, :, None] - times[:, None, :]
    # The amplitude is at least the noise of the samples.
    spread = max(float(targets.std()), noise)
    log_spread, log_step = np.log(spread), np.log(usual_step_s)
    bounds = [
        (max(log_spread - 4.0, np.log(noise)), log_spread + 8.0),
        (log_step + np.log(0.3), np.log(200.0 * usual_step_s + 10.0)),
    ]

    def best_of(kernel: Kernel) -> OptimizeResult:
        def cost(parameters: Floats) -> tuple[float, Floats]:
            value, gradient = negative_log_likelihood(
                kernel, lags, targets, np.append(parameters, np.log(noise))
            )
            return value, gradient[:2]

        results = [
            minimize(
                cost,
                [log_spread, log_step + np.log(start)],
                jac=True,
                method="L-BFGS-B",
                bounds=bounds,
                options={"maxfun": 60},
            )
            for start in _STARTS
        ]
        return min(results, key=lambda result: float(result.fun))

    fits = [(kernel, best_of(kernel)) for kernel in kernels]
    kernel, best = min(fits, key=lambda fitted: float(fitted[1].fun))
    sigma, length = np.exp(best.x).tolist()
    return kernel, Hyperparameters(sigma, length, noise)


def negative_log_likelihood(
    kernel: Kernel, lags: Floats, targets: Floats, log_parameters: Floats
) -> tuple[float, Floats]:
    """Return -log p of the samples of all segments, and its gradient, eq. (30).

    Lags (S, n, n), in seconds, are within segments. The coordinates (S, n, c) are c processes with
    equal hyperparameters: sigma, length and noise, in logarithms.
    """
    sigma, length, noise = np.exp(log_parameters)
    segments, count, axes = targets.shape
    correlation = kernel.between(lags, float(length))
    prior = sigma**2
    covariance = prior * correlation + noise**2 * np.eye(count)
    try:
        root = np.linalg.cholesky(covariance)
        inverse = np.linalg.inv(covariance)
    except np.linalg.LinAlgError:
        return _IMPOSSIBLE, np.zeros(3)
    weights = inverse @ targets
    log_root = np.log(np.diagonal(root, axis1=1, axis2=2)).sum()
    value = 0.5 * np.vdot(targets, weights) + axes * log_root
    value += 0.5 * segments * count * axes * np.log(2.0 * np.pi)
    # d value / d K = (c K^-1 - a a^T) / 2.
    slope = 0.5 * (axes * inverse - weights @ np.swapaxes(weights, 1, 2))
    gradient = [
        2.0 * prior * np.vdot(slope, correlation),
        prior * np.vdot(slope, kernel.by_log_length(lags, float(length))),
        2.0 * noise**2 * np.einsum("sii->", slope),
    ]
    return float(value), np.array(gradient)
