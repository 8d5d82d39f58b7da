"""What can be said from the covariance of each pose alone, as ROS messages carry it.

`nav_msgs/Odometry` has no covariance between poses. In the gauge of the estimator's own first
pose nothing else is needed; in every other gauge only a bound is left.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros.consistency.s_transformation import STransformation
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Booleans, Floats

# Drivers put this, or more, where they know nothing: 1e6 m^2 are a kilometre.
_SENTINEL = 1e6
# Rounding of a covariance that was written with seven digits.
_ASYMMETRY, _NEGATIVE = 1e-6, 1e-9


def unknown_covariances(covariances: Floats) -> str:
    """Return why covariances (N, 6, 6) say nothing, or an empty string.

    Zeros, negative variances, sentinels and what is no covariance at all mean "unknown"; zero is
    an answer only for poses whose others are known, as in the gauge of the first pose.
    """
    if not np.isfinite(covariances).all():
        return "some are not finite"
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    if (variances < 0.0).any():
        return "a variance is negative, which means unknown"
    if (variances >= _SENTINEL).any():
        return f"a variance is {variances.max():.3g}, which means unknown"
    said = np.abs(covariances[1:]).max(axis=(1, 2)) > 0.0
    if not said.any():
        return "all are zero, which means unknown"
    if not said.all():
        return "some are all zero, which means unknown"
    if not (variances[1:] > 0.0).all():
        return "some variances are zero"
    if not is_covariance(covariances[1:]).all():
        return "some are not symmetric, or have negative eigenvalues"
    return ""


def is_covariance(covariances: Floats) -> Booleans:
    """Whether each of (N, d, d) is symmetric and positive semi-definite, but for rounding."""
    units = np.sqrt(np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0.0))
    units = np.where(units > 0.0, units, 1.0)
    scaled = covariances / units[:, :, None] / units[:, None, :]
    transposed = np.swapaxes(scaled, 1, 2)
    symmetric = np.abs(scaled - transposed).max(axis=(1, 2)) < _ASYMMETRY
    smallest = np.linalg.eigvalsh((scaled + transposed) / 2.0)[:, 0]
    good: Booleans = symmetric & (smallest > -_NEGATIVE)
    return good


def initial_uncertainty(covariances: Floats, transformation: STransformation) -> Floats:
    """Return the covariance (k, k) of the first pose in the gauge's own directions."""
    gradient = transformation.coefficients[:, :6]
    uncertainty: Floats = gradient @ covariances[0] @ gradient.T
    return uncertainty


def without_initial_prior(covariances: Floats, transformation: STransformation) -> Floats:
    """Take a prior on the first pose's position and yaw out of every pose's covariance.

    Such a prior adds U P U' to the covariance of the gauge of the first pose, so that marginals
    suffice to take it off again (measured to 4e-10). It must have been independent of all else,
    and the first pose its own: a filter that has moved doesn't fulfil that.

    Args:
        covariances: (N, 6, 6) of aligned poses, the estimator's very first one included.
        transformation: Of an alignment by the first state.

    Raises:
        InputError: What is left is no covariance, so the prior was none of position and yaw.
    """
    prior = initial_uncertainty(covariances, transformation)
    orbit = transformation.orbit[:, :6]
    stripped: Floats = covariances - orbit @ prior @ np.swapaxes(orbit, 1, 2)
    stripped = (stripped + np.swapaxes(stripped, 1, 2)) / 2.0
    if not is_covariance(stripped[1:]).all():
        raise InputError(
            "the covariance of the first pose is not only a prior of position and yaw: its "
            "removal gives a later pose a negative variance"
        )
    return stripped


def upper_bounds(covariances: Floats, transformation: STransformation) -> Floats:
    """Return covariances (N, 6, 6) of aligned poses that hold whatever their correlations are.

    Covariance intersection: Cov(a + b) <= Cov(a) / w + Cov(b) / (1 - w) for any w. An aligned
    pose's error is its own less what the alignment makes of all, and the latter is a sum over
    poses. NEES with these covariances is a lower bound in expectation: it can show
    over-confidence, and never confirm consistency.

    Args:
        covariances: (N, 6, 6), of left perturbations of the aligned poses.
        transformation: Of the alignment.
    """
    count, _, open_ = transformation.orbit.shape
    orbit = transformation.orbit[:, :6]
    if not open_:
        return covariances
    pull = transformation.pull
    shares = pull @ covariances @ np.swapaxes(pull, 1, 2)
    # How far the gauge moves the poses, squared, is what a share's size is measured by.
    metric = np.einsum("nik,nil->kl", orbit[:, :3], orbit[:, :3]) / count
    sizes = np.sqrt(np.maximum(np.einsum("nkl,lk->n", shares, metric), 0.0))
    total = sizes.sum()
    present = sizes > 0.0
    of_alignment = np.einsum("nkl,n->kl", shares[present], total / sizes[present])
    moved = orbit @ of_alignment @ np.swapaxes(orbit, 1, 2)
    # Any weight is valid. This one compares the two in each coordinate, so that a pose whose
    # position is certain keeps its uncertain tilt.
    own, others = (np.diagonal(each, axis1=1, axis2=2) for each in (covariances, moved))
    both = np.maximum(own + others, np.finfo(float).tiny)
    own, others = (np.sqrt((np.maximum(each, 0.0) / both).sum(axis=1)) for each in (own, others))
    weight = np.divide(own, own + others, out=np.ones(count), where=own + others > 0.0)
    weight = weight[:, None, None]
    # Where one part is nothing the other has all the weight.
    bound: Floats = np.divide(covariances, weight, out=np.zeros_like(moved), where=weight > 0.0)
    bound += np.divide(moved, 1.0 - weight, out=np.zeros_like(moved), where=weight < 1.0)
    return bound
