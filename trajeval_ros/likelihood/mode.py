"""The most likely alignment, by Gauss-Newton from a weighted alignment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.geometry import se3, so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.likelihood.residuals import Residuals, Slope

_MOST_ITERATIONS = 100
# Largest step at convergence, relative to the alignment's standard deviation.
_SMALL_STEP = 1e-10
_MOST_DAMPING = 1e8
# Least eigenvalue of the information with unit diagonal for an observable direction.
_UNSEEN = 1e-11


@dataclass(frozen=True, eq=False)
class Mode:
    """The most likely alignment.

    Attributes:
        element: (4, 4).
        log_density: Eq. (18) at the element.
        slope: Derivatives at the element.
    """

    element: Floats
    log_density: float
    slope: Slope


def find_mode(residuals: Residuals) -> Mode:
    """Return the alignment that maximises eq. (18).

    Raises:
        DegenerateGeometryError: The poses do not determine the alignment, or a groundtruth pose
            has no variance.
    """
    _ = residuals.root  # raises before a division by a zero variance
    element = _first_alignment(residuals)
    value = float(residuals.log_density(element[None])[0])
    damping = 0.0
    for _ in range(_MOST_ITERATIONS):
        slope = residuals.slope(element)
        if not residuals.chart.dimension:
            break
        scale = unit_diagonal(slope.information)
        while True:
            damped = slope.information * scale * scale[:, None] + damping * np.eye(len(scale))
            step = scale * np.linalg.solve(damped, scale * slope.gradient)
            tried = residuals.chart.elements(step[None])[0] @ element
            tried_value = float(residuals.log_density(tried[None])[0])
            if tried_value >= value - 1e-12 * abs(value) or damping > _MOST_DAMPING:
                break
            damping = max(10.0 * damping, 1e-6)
        small = step @ slope.information @ step < _SMALL_STEP**2 * max(1.0, abs(value) * 1e-6)
        element, value = tried, tried_value
        damping = damping / 10.0 if damping > 1e-7 else 0.0
        if small:
            break
    return Mode(element, value, residuals.slope(element))


def unit_diagonal(information: Floats) -> Floats:
    """Return the factors that scale an information matrix (d, d) to a unit diagonal, (d,).

    Raises:
        DegenerateGeometryError: It is singular.
    """
    diagonal = np.diag(information)
    if (diagonal > 0.0).all():
        scale: Floats = 1.0 / np.sqrt(diagonal)
        if np.linalg.eigvalsh(information * scale * scale[:, None])[0] > _UNSEEN:
            return scale
    raise DegenerateGeometryError(
        "the poses do not determine all directions of the gauge, such as the scale of a body at "
        "rest, or the roll about a straight path; choose a gauge with fewer degrees of freedom"
    )


def _first_alignment(residuals: Residuals) -> Floats:
    """Return an initial alignment by rotations and positions, weighted by mean variances."""
    gauge, covariances = residuals.gauge, residuals.covariances
    truth, other = residuals.belief.poses, residuals.estimate
    p, q = truth[:, :3, 3], other[:, :3, 3]
    weights = 3.0 / np.trace(covariances[:, :3, :3], axis1=1, axis2=2)
    total = float(weights.sum())
    p_mean, q_mean = weights @ p / total, weights @ q / total
    if not gauge.has_translation:
        return np.eye(4)
    if not len(residuals.chart.axes):
        return se3.poses(np.eye(3), p_mean - q_mean)
    spread = (weights[:, None] * (p - p_mean)).T @ (q - q_mean)
    turns = np.zeros((3, 3))
    if residuals.oriented:
        known = 3.0 / np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2)
        turns = np.einsum("n,nij,nkj->ik", known, truth[:, :3, :3], other[:, :3, :3])
    size = float(weights @ np.square(q - q_mean).sum(axis=1))
    scale = 1.0
    for _ in range(3 if gauge.has_scale else 1):
        both = turns + scale * spread
        if gauge.turns_freely:
            u, _, vt = np.linalg.svd(both)
            rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        else:
            rotation = so3.exp(np.array([0.0, 0.0, so3.yaw_of_matrix(both)]))
        if gauge.has_scale and size > 0.0:
            scale = max(float(np.vdot(spread, rotation)) / size, 1e-6)
    return se3.poses(scale * rotation, p_mean - scale * rotation @ q_mean)
