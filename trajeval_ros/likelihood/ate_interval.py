"""In what interval the position ATE lies that exact groundtruth would give.

Errors against uncertain groundtruth are r = e + x, of the estimate and of the groundtruth, so that
their mean square lies above that of e by the mean square X of x, and by 2 mean e.x, of either
sign. X is bounded from above by two parts that add up:

* noise of the samples: 3 s^2, or what the model says where that is more. It is not taken to
  average out between samples, so that it may be correlated in time in whatever way;
* what is rough in r itself: the model's mistakes (motion that is harder than it can follow),
  outliers, heavy tails, and samples that are noisier than was said. They come and go within a step
  of the groundtruth's samples, which an estimate's drift does not: second differences over a step
  and over half of one show them, together with whatever of e is as rough.

The interval is sqrt([m - X - reach, m + reach]), m the mean square of r over supported poses.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats

_SIGMAS_95 = 1.959963984540054
_LAGS = (0.5, 1.0)
# A value less the mean of its two neighbours has this times the variance of each, if unrelated.
_OF_DIFFERENCE = 1.5
# Fewer differences than this don't show what is rough.
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
    """Return an interval for the ATE of all N poses, on the safe side of 95 %.

    docs/probabilistic.md has how often it held, and `benchmarks/intervals.py` measures it.

    Args:
        times: (N,), seconds, in order.
        errors: (N, 3), metres, against the most likely groundtruth.
        variances: (N,), m^2, traces of the groundtruth's covariances by its model.
        supported: (N,), whose errors are used.
        sample_sigma_m: Standard deviation of a groundtruth sample along an axis.
        sample_step_s: Usual step between groundtruth samples.

    Returns:
        Lower and upper end, metres; None where too few supported poses are close enough to each
        other to tell an estimate's error from the groundtruth's.
    """
    step_s = max(sample_step_s, float(np.median(np.diff(times))))
    seen = [rough_square(times[supported], errors[supported], lag, step_s) for lag in _LAGS]
    rough = max((each for each in seen if each is not None), default=None)
    if rough is None:
        return None
    noise = max(3.0 * sample_sigma_m**2, float(variances[supported].mean()))
    of_groundtruth = noise + rough
    squared = np.square(errors).sum(axis=1)
    mean = float(squared[supported].mean())
    # Of mean(2 e.x + |x|^2), for x of equal axes that is correlated in time as r is.
    variance = (4.0 * of_groundtruth * mean + 2.0 * of_groundtruth**2) / 3.0
    variance /= independent_number(errors * supported[:, None], int(supported.sum()))
    variance += float(np.mean(~supported)) * _variance_of_mean(squared[supported])
    reach = _SIGMAS_95 * float(np.sqrt(variance))
    lower = max(mean - of_groundtruth - reach, 0.0)
    return float(np.sqrt(lower)), float(np.sqrt(mean + reach))


def rough_square(times: Floats, errors: Floats, share: float, step_s: float) -> float | None:
    """Return the mean square of what comes and goes within a share of a step, m^2.

    Args:
        times: (M,), seconds, in order.
        errors: (M, 3), metres; between them they are interpolated, but not across more than a
            step.
        share: Of a step.
        step_s: Seconds.

    Returns:
        None where too few errors have others that far before and after them.
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
    """Return how many independent values a mean of products of such errors is worth.

    N / (1 + 2 sum rho_k^2), rho_k the autocorrelation of the errors at k steps.

    Args:
        errors: (N, 3), zero where they don't count.
        count: How many do.
    """
    spectrum = np.fft.rfft(errors, 2 * len(errors), axis=0)
    products = np.fft.irfft(np.square(np.abs(spectrum)).sum(axis=1))[: len(errors)]
    if products[0] <= 0.0:
        return float(count)
    return float(count / (1.0 + 2.0 * np.square(products[1:] / products[0]).sum()))


def _variance_of_mean(values: Floats) -> float:
    """Return the variance of the mean of values that are alike along the way, by stretches."""
    means = [float(each.mean()) for each in np.array_split(values, _STRETCHES) if len(each)]
    return float(np.var(means, ddof=1)) / len(means) if len(means) > 1 else 0.0
