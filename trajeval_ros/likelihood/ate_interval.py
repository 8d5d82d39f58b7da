"""Interval of the position ATE that exact groundtruth would give.

Errors against uncertain groundtruth are r = e + x, with e the estimate's and x the groundtruth's
error. Their mean square exceeds that of e by the mean square X of x and by 2 mean e.x, of either
sign. X has an upper bound with two terms:

* Noise of the samples: 3 s^2, or the model's variance if that is larger. It is not averaged over
  samples, so that any correlation in time is allowed.
* The rough part of r: motion that the model cannot follow, outliers, heavy tails, and samples with
  more noise than stated. It varies within a step of the groundtruth's samples, which an estimate's
  drift does not. Second differences over a step and over half of one measure it, including rough
  parts of e.

The interval is sqrt([m - X - reach, m + reach]), with m the mean square of r over supported poses.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats

_SIGMAS_95 = 1.959963984540054
_LAGS = (0.5, 1.0)
# Ratio of the variances of a value minus the mean of its neighbours, and of a value, if
# uncorrelated.
_OF_DIFFERENCE = 1.5
# Least number of differences.
_FEWEST = 10
_STRETCHES = 20
_INSTANT_S = 1e-9


def ate_interval(
    times: Floats,
    errors: Floats,
    variances: Floats,
    supported: Booleans,
    sample_sigma_m: float,
    sample_step_s: float,
) -> tuple[float, float] | None:
    """Return an interval for the ATE of all N poses, with a coverage of at least 95 %.

    docs/probabilistic.md has the measured coverage; `benchmarks/intervals.py` measures it.

    Args:
        times: (N,), seconds, in order.
        errors: (N, 3), metres, against the most likely groundtruth.
        variances: (N,), m^2, traces of the groundtruth's covariances by its model.
        supported: (N,), which errors are used.
        sample_sigma_m: Standard deviation of a groundtruth sample along an axis, metres.
        sample_step_s: Median step between groundtruth samples, seconds.

    Returns:
        Lower and upper end, metres; None if too few supported poses are near enough to each other
        to separate the errors of estimate and groundtruth.
    """
    step_s = max(sample_step_s, float(np.median(np.diff(times))))
    seen = [rough_square(times[supported], errors[supported], lag, step_s) for lag in _LAGS]
    rough = max((square for square in seen if square is not None), default=None)
    if rough is None:
        return None
    noise = max(3.0 * sample_sigma_m**2, float(variances[supported].mean()))
    of_groundtruth = noise + rough
    squared = np.square(errors).sum(axis=1)
    mean = float(squared[supported].mean())
    # Variance of mean(2 e.x + |x|^2) for an isotropic x with the correlation of r.
    variance = (4.0 * of_groundtruth * mean + 2.0 * of_groundtruth**2) / 3.0
    variance /= independent_number(errors * supported[:, None], int(supported.sum()))
    variance += float(np.mean(~supported)) * _variance_of_mean(squared[supported])
    reach = _SIGMAS_95 * float(np.sqrt(variance))
    lower = max(mean - of_groundtruth - reach, 0.0)
    return float(np.sqrt(lower)), float(np.sqrt(mean + reach))


def rough_square(times: Floats, errors: Floats, share: float, step_s: float) -> float | None:
    """Return the mean square of the part that varies within a share of a step, m^2.

    Args:
        times: (M,), seconds, in order.
        errors: (M, 3), metres; they are interpolated across at most one step.
        share: Share of a step.
        step_s: The step, seconds.

    Returns:
        None if too few errors have neighbours at that distance.
    """
    lag = share * step_s
    inside = (times - lag >= times[0]) & (times + lag <= times[-1])
    differences, seen = errors[inside], np.ones(np.count_nonzero(inside), dtype=bool)
    for asked in (times[inside] - lag, times[inside] + lag):
        after = np.clip(np.searchsorted(times, asked), 1, len(times) - 1)
        before = after - 1
        between = times[after] - times[before]
        part = (asked - times[before]) / np.maximum(between, _INSTANT_S)
        there = errors[before] + part[:, None] * (errors[after] - errors[before])
        differences = differences - 0.5 * there
        seen &= between <= step_s * (1.0 + _INSTANT_S)
    if np.count_nonzero(seen) < _FEWEST:
        return None
    return float(np.square(differences[seen]).sum(axis=1).mean()) / _OF_DIFFERENCE


def independent_number(errors: Floats, count: int) -> float:
    """Return the effective number of independent values in a mean of products of errors.

    N / (1 + 2 sum rho_k^2), with rho_k the autocorrelation of the errors at k steps.

    Args:
        errors: (N, 3), zero if not used.
        count: Number of errors in use.
    """
    spectrum = np.fft.rfft(errors, 2 * len(errors), axis=0)
    products = np.fft.irfft(np.square(np.abs(spectrum)).sum(axis=1))[: len(errors)]
    if products[0] <= 0.0:
        return float(count)
    return float(count / (1.0 + 2.0 * np.square(products[1:] / products[0]).sum()))


def _variance_of_mean(values: Floats) -> float:
    """Return the variance of the mean of correlated values (N,), from means of intervals."""
    means = [float(part.mean()) for part in np.array_split(values, _STRETCHES) if len(part)]
    return float(np.var(means, ddof=1)) / len(means) if len(means) > 1 else 0.0
