"""Covariances of single poses, as in ROS messages.

`nav_msgs/Odometry` has no covariances between poses. They are sufficient in the gauge of the
estimator's first pose; in every other gauge only a bound is possible.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros.consistency.s_transformation import STransformation
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Booleans, Floats

# Drivers set at least this variance, m^2, for unknown.
_SENTINEL = 1e6
# Rounding of covariances with seven digits.
_ASYMMETRY, _NEGATIVE = 1e-6, 1e-9


def unknown_covariances(covariances: Floats) -> str:
    """Return why covariances (N, 6, 6) are unknown or invalid; empty if they are valid.

    Zeros, negative variances and sentinels mean "unknown". Only the first pose can have zeros, in
    the gauge of the first pose.
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
    """Return which matrices (N, d, d) are symmetric and positive semi-definite, up to rounding."""
    units = np.sqrt(np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0.0))
    units = np.where(units > 0.0, units, 1.0)
    scaled = covariances / units[:, :, None] / units[:, None, :]
    transposed = np.swapaxes(scaled, 1, 2)
    symmetric = np.abs(scaled - transposed).max(axis=(1, 2)) < _ASYMMETRY
    smallest = np.linalg.eigvalsh((scaled + transposed) / 2.0)[:, 0]
    good: Booleans = symmetric & (smallest > -_NEGATIVE)
    return good


def initial_uncertainty(covariances: Floats, transformation: STransformation) -> Floats:
    """Return the covariance (k, k) of the first pose along the gauge's directions."""
    gradient = transformation.coefficients[:, :6]
    uncertainty: Floats = gradient @ covariances[0] @ gradient.T
    return uncertainty


def without_initial_prior(covariances: Floats, transformation: STransformation) -> Floats:
    """Remove a prior on the first pose's position and yaw from the covariances of all poses.

    Such a prior adds U P U' to the covariance in the gauge of the first pose, so that it can be
    subtracted from marginals (measured to 4e-10). The prior must be independent of everything else
    and of the first pose. This does not hold for a filter that has moved before.

    Args:
        covariances: (N, 6, 6) of aligned poses, including the estimator's first one.
        transformation: Transformation of an alignment by the first state.

    Raises:
        InputError: The result is no covariance, so that the prior was of another kind.
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
    """Return upper bounds (N, 6, 6) of the covariances of aligned poses for any correlation.

    Covariance intersection: Cov(a + b) <= Cov(a) / w + Cov(b) / (1 - w) for any w. The error of an
    aligned pose is its own error minus the effect of the alignment, which is a sum over all poses.
    NEES with these bounds is a lower bound in expectation. It can detect overconfidence, but
    cannot confirm consistency.

    Args:
        covariances: (N, 6, 6), of left perturbations of the aligned poses.
        transformation: Transformation of the alignment.
    """
    count, _, open_ = transformation.orbit.shape
    orbit = transformation.orbit[:, :6]
    if not open_:
        return covariances
    pull = transformation.pull
    shares = pull @ covariances @ np.swapaxes(pull, 1, 2)
    # The size of a contribution is the squared motion of the poses that it causes.
    metric = np.einsum("nik,nil->kl", orbit[:, :3], orbit[:, :3]) / count
    sizes = np.sqrt(np.maximum(np.einsum("nkl,lk->n", shares, metric), 0.0))
    total = sizes.sum()
    present = sizes > 0.0
    of_alignment = np.einsum("nkl,n->kl", shares[present], total / sizes[present])
    moved = orbit @ of_alignment @ np.swapaxes(orbit, 1, 2)
    # Any weight is valid. This one compares both terms by coordinate, so that a pose with an exact
    # position keeps its uncertain tilt.
    own, others = (np.diagonal(blocks, axis1=1, axis2=2) for blocks in (covariances, moved))
    both = np.maximum(own + others, np.finfo(float).tiny)
    own, others = (np.sqrt((np.maximum(v, 0.0) / both).sum(axis=1)) for v in (own, others))
    weight = np.divide(own, own + others, out=np.ones(count), where=own + others > 0.0)
    weight = weight[:, None, None]
    # If one term is zero, the other has all the weight.
    bound: Floats = np.divide(covariances, weight, out=np.zeros_like(moved), where=weight > 0.0)
    bound += np.divide(moved, 1.0 - weight, out=np.zeros_like(moved), where=weight < 1.0)
    return bound
