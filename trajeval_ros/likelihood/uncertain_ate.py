"""The position ATE against groundtruth of varying accuracy.

Inside a dropout, the error of the groundtruth's mean is larger than that of a good estimate, and a
plain RMSE measures the groundtruth. Two alternatives are the RMSE of all poses, weighted by their
information, and the RMSE of the well-supported poses, with their share.

`ate_interval` is the interval of the ATE that exact groundtruth would give. Errors against
uncertain groundtruth are r = e + x, with e the estimate's and x the groundtruth's error. Their
mean square exceeds that of e by the mean square X of x and by 2 mean e.x, of either sign. X has an
upper bound with two terms:

* Noise of the samples: 3 s^2, or the model's variance if that is larger. It is not averaged over
  samples, so that any correlation in time is allowed.
* The rough part of r: motion that the model cannot follow, outliers, heavy tails, and samples with
  more noise than stated. It varies within a step of the groundtruth's samples, which an estimate's
  drift does not. Second differences over a step and over half of one measure it, including rough
  parts of e.

The interval is sqrt([m - X - reach, m + reach]), with m the mean square of r over supported poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.continuous_time.samples import Samples
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.pair_alignment import weighted_errors

# A pose is well supported if the groundtruth's standard deviation is below this share of the
# error, or below this multiple of a sample's.
_SHARE_OF_ERROR, _SAMPLE_SIGMAS = 0.5, 1.5 * 3.0**0.5


@dataclass(frozen=True, eq=False)
class UncertainAte:
    """Position ATE of N poses, metres."""

    weighted_m: float  # RMSE weighted by the information of the poses
    supported_m: float | None  # RMSE of the well-supported poses; None if there are none
    supported: Booleans  # (N,), which poses are well supported
    # Interval of the ATE against exact groundtruth with a coverage of at least 95 %: see
    # `ate_interval`. None if too few poses are well supported.
    interval_m: tuple[float, float] | None

    @property
    def supported_share(self) -> float:
        """Share of the poses that are well supported."""
        return float(np.mean(self.supported))


def uncertain_ate(
    times: Floats,
    groundtruth: Floats,
    covariances: Floats,
    estimate: Floats,
    gauge: Gauge | None,
    samples: Samples,
) -> UncertainAte:
    """Return the ATE against uncertain groundtruth at times (N,), seconds.

    Covariances (N, 3, 3), m^2, are about the world's axes. Without a gauge, the estimate is
    aligned already; otherwise the alignment is weighted.
    """
    errors, weighted = weighted_errors(gauge, groundtruth, estimate, covariances)
    variances = np.trace(covariances, axis1=1, axis2=2)
    sigma_m = samples.noise.position_m
    supported = np.sqrt(variances) < max(_SHARE_OF_ERROR * weighted, _SAMPLE_SIGMAS * sigma_m)
    if np.count_nonzero(supported) < 2:
        return UncertainAte(weighted, None, supported, None)
    rmse = float(np.sqrt(np.square(errors[supported]).sum(axis=1).mean()))
    order = np.argsort(times, kind="stable")
    interval = ate_interval(
        times[order],
        errors[order],
        variances[order],
        supported[order],
        sigma_m,
        samples.usual_step_s,
    )
    return UncertainAte(weighted, rmse, supported, interval)


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
    """Return an interval (m) for the ATE of all N poses, with a coverage of at least 95 %.

    It is None if too few supported poses are near enough to each other to separate the errors of
    estimate and groundtruth. docs/probabilistic.md has the measured coverage;
    `benchmarks/intervals.py` measures it.

    Times (N,), seconds, are in order. Errors (N, 3), metres, are against the most likely
    groundtruth, of which the variances (N,), m^2, are the traces of the covariances by its model.
    Groundtruth samples have a standard deviation along an axis and a median step.
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

    Errors (M, 3) at times (M,) are interpolated across at most one step. The result is None if too
    few of them have neighbours at that distance.
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
    """Return the effective number of independent values in a mean of products of errors (N, 3).

    N / (1 + 2 sum rho_k^2), with rho_k the autocorrelation of the errors at k steps. Errors that
    are not among the `count` in use are zero.
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
