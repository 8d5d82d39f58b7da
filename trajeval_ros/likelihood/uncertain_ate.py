"""The position ATE against groundtruth that is known better here than there.

Inside a dropout the groundtruth's mean is off by more than a good estimate is. A plain rmse then
measures the groundtruth. Two rmses don't: of all poses, weighted by what is known of them, and of
the well-supported ones alone, with the share that they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.continuous_time.joint_groundtruth import JointPosterior
from trajeval_ros.geometry import se3
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.weighted_alignment import weighted_errors

# A pose is well supported where its groundtruth is better known than half of the error, or about
# as well as a sample is.
_SHARE_OF_ERROR, _SAMPLE_SIGMAS = 0.5, 1.5 * 3.0**0.5
_PROBES = 16
_STRETCHES = 20
_SIGMAS_95 = 1.959963984540054


@dataclass(frozen=True, eq=False)
class UncertainAte:
    """Position errors, metres, of N poses.

    Attributes:
        weighted_m: Root of the mean square, each weighted by its information.
        supported_m: Of the well-supported poses; None where there is none.
        supported: (N,), which they are.
        interval_m: Of the ATE that exact groundtruth would give, approximately 95 %, on the safe
            side: from the errors less what the groundtruth explains, up to the errors as they
            are. None with fewer than two well-supported poses.
    """

    weighted_m: float
    supported_m: float | None
    supported: Booleans
    interval_m: tuple[float, float] | None

    @property
    def supported_share(self) -> float:
        """Share of the poses that are well supported."""
        return float(np.mean(self.supported))


def uncertain_ate(
    groundtruth: Floats,
    covariances: Floats,
    estimate: Floats,
    gauge: Gauge | None,
    sample_sigma_m: float,
    joint: JointPosterior,
) -> UncertainAte:
    """Return the ATE against uncertain groundtruth.

    Args:
        groundtruth: (N, 3), metres, the most likely positions.
        covariances: (N, 3, 3), about the world's axes.
        estimate: (N, 3), metres.
        gauge: To align it by, weighted; None if it is aligned already.
        sample_sigma_m: Standard deviation of a groundtruth sample along an axis.
        joint: Correlations of the groundtruth's errors at the N times.

    Raises:
        DegenerateGeometryError: Too few poses, or no motion, for the gauge's alignment.
    """
    errors, weighted = weighted_errors(gauge, groundtruth, estimate, covariances)
    variances = np.trace(covariances, axis1=1, axis2=2)
    limit = max(_SHARE_OF_ERROR * weighted, _SAMPLE_SIGMAS * sample_sigma_m)
    supported = np.sqrt(variances) < limit
    squared = np.square(errors).sum(axis=1)
    if np.count_nonzero(supported) < 2:
        return UncertainAte(weighted, None, supported, None)
    mean = float(squared[supported].mean())
    less = mean - float(variances[supported].mean())
    shrunk = errors * np.sqrt(max(less, 0.0) / mean) if mean > 0.0 else errors
    explained = _explained_variance(covariances, supported, shrunk, joint)
    elsewhere = float(np.mean(~supported)) * _variance_of_mean(squared[supported])
    reach = _SIGMAS_95 * float(np.sqrt(explained + elsewhere))
    interval = (float(np.sqrt(max(less - reach, 0.0))), float(np.sqrt(mean + reach)))
    return UncertainAte(weighted, float(np.sqrt(mean)), supported, interval)


def _explained_variance(
    covariances: Floats, supported: Booleans, errors: Floats, joint: JointPosterior
) -> float:
    """Return the variance of mean(2 e.x + |x|^2) over supported poses, x the groundtruth's error.

    For x of covariance P it is 4 e.P e + 2 tr P^2 over the squared number; the trace is the mean
    of |P z|^2 over random signs z. Correlations are those of `joint`, variances the model's own.
    """
    own = np.linalg.cholesky(covariances)
    theirs = np.asarray(np.linalg.inv(np.linalg.cholesky(joint.marginals())))
    scaling: Floats = (own @ theirs) * supported[:, None, None]
    signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(*errors.shape, _PROBES))
    vectors = np.concatenate([errors[..., None], signs], axis=2)
    products = scaling @ joint.times(se3.transposed(scaling) @ vectors)
    linear = 4.0 * float(np.vdot(errors, products[..., 0]))
    quadratic = 2.0 * float(np.square(products[..., 1:]).sum()) / _PROBES
    return (linear + quadratic) / float(np.count_nonzero(supported)) ** 2


def _variance_of_mean(values: Floats) -> float:
    """Return the variance of the mean of values that are alike along the way, by stretches."""
    means = [float(each.mean()) for each in np.array_split(values, _STRETCHES) if len(each)]
    return float(np.var(means, ddof=1)) / len(means) if len(means) > 1 else 0.0
