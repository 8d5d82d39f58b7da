"""The density of an estimate given an alignment, eq. (18) and (20) of the probabilistic paper.

`find_mode` returns the most likely alignment, by Gauss-Newton from a weighted alignment.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trajeval_ros.continuous_time.samples import Belief
from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.geometry import se3, so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.likelihood.alignment_chart import Chart, act, scales
from trajeval_ros.likelihood.relative_density import LOG_2_PI

# Rows that fit into a core's cache, and largest number of poses times alignments in memory.
_ROWS, _MOST_AT_ONCE = 8192, 1 << 18


@dataclass(frozen=True, eq=False)
class Slope:
    """Derivatives of the log density at an alignment."""

    gradient: Floats  # (d,), by the chart's coordinates
    information: Floats  # (d, d), of Gauss-Newton
    whitened: Floats  # (M, k), residuals of unit variance


@dataclass(frozen=True, eq=False)
class Residuals:
    """Groundtruth, estimate and gauge, which determine the likelihood.

    Densities are with respect to the volume of the group, for which marginals are exact and
    invariant. The paper's are Gaussian in logarithms.
    """

    belief: Belief  # M independent groundtruth poses
    estimate: Floats  # (M, 4, 4), in its own frame
    gauge: Gauge  # gauge of the alignment
    # False to compare positions only; residuals then have 3 axes instead of 6.
    oriented: bool = True

    def __len__(self) -> int:
        return len(self.estimate)

    @property
    def axes(self) -> int:
        """Dimension of a residual, 6 or 3."""
        return 6 if self.oriented else 3

    @cached_property
    def chart(self) -> Chart:
        """The chart about the groundtruth's centre."""
        return Chart(self.gauge, self.belief.poses[:, :3, 3].mean(axis=0))

    @cached_property
    def covariances(self) -> Floats:
        """Covariances of the residuals, (M, k, k)."""
        return self.belief.covariances[:, : self.axes, : self.axes]

    @cached_property
    def root(self) -> Floats:
        """W (M, k, k) with W S W^T = 1."""
        try:
            return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariances)))
        except np.linalg.LinAlgError as error:
            raise DegenerateGeometryError(
                "a groundtruth pose has zero variance in some direction; set groundtruth noise "
                "greater than zero in all directions"
            ) from error

    @cached_property
    def _constant(self) -> float:
        """The normalisation of the log density."""
        roots = np.einsum("nii->ni", self.root)
        return float(np.log(roots).sum()) - 0.5 * self.axes * len(self) * LOG_2_PI

    @cached_property
    def _inverse(self) -> Floats:
        """Inverse groundtruth poses, (M, 4, 4)."""
        return se3.inverse(self.belief.poses)

    @cached_property
    def _carried(self) -> Floats:
        """Adjoints of the inverse groundtruth poses, (M, 6, 6)."""
        return se3.adjoint(self._inverse)

    def at(self, elements: Floats) -> Floats:
        """Return eps_i (..., M, k), eq. (20), for alignments (..., 4, 4).

        Without orientations, positions are compared along the body's axes of the covariances.
        """
        missed = self._inverse @ act(elements[..., None, :, :], self.estimate)
        return se3.log(missed) if self.oriented else missed[..., :3, 3]

    def log_density(self, elements: Floats) -> Floats:
        """Return log p(X | X_gt, g) (K,), eq. (18), for alignments (K, 4, 4)."""
        values = np.empty(len(elements))
        block = max(1, _MOST_AT_ONCE // len(self))
        for begin in range(0, len(elements), block):
            chunk = slice(begin, begin + block)
            residuals = self.at(elements[chunk])
            squared = np.square(se3.times(self.root, residuals)).sum(axis=(1, 2))
            values[chunk] = self._constant - 0.5 * squared
            if self.curved:
                values[chunk] -= 2.0 * se3.log_determinant(residuals[..., 3:]).sum(axis=1)
        return values

    def slope(self, element: Floats) -> Slope:
        """Return gradient and information at one alignment (4, 4).

        d eps_i / d delta = J_l^-1(eps_i) Ad(T_i)^-1 G_i, exactly.
        """
        gradient = np.zeros(self.chart.dimension)
        information = np.zeros((len(gradient), len(gradient)))
        whitened = np.empty((len(self), self.axes))
        moved = act(element, self.estimate)
        for begin in range(0, len(self), _ROWS):
            chunk = slice(begin, begin + _ROWS)
            missed = self._inverse[chunk] @ moved[chunk]
            by_delta = self._carried[chunk] @ self.chart.twists(moved[chunk, :3, 3])
            if self.oriented:
                residuals = se3.log(missed)
                by_delta = se3.inverse_left_jacobian(residuals) @ by_delta
            else:
                # Of a point, not of a body: a rotation of the body moves it, too.
                residuals = missed[..., :3, 3]
                by_delta = by_delta[:, :3] - so3.skew(residuals) @ by_delta[:, 3:]
            root = self.root[chunk]
            whitened[chunk] = se3.times(root, residuals)
            jacobian = (root @ by_delta).reshape(self.axes * len(root), len(gradient))
            gradient -= jacobian.T @ whitened[chunk].ravel()
            information += jacobian.T @ jacobian
            if self.curved:
                volume = se3.log_determinant_gradient(residuals[:, 3:])
                gradient -= 2.0 * np.einsum("nid,ni->d", by_delta[:, 3:], volume)
        return Slope(gradient, information, whitened)

    @property
    def curved(self) -> bool:
        """Whether the volume of the group differs from that of logarithms."""
        return self.oriented


_MOST_ITERATIONS = 100
# Largest step at convergence, relative to the alignment's standard deviation.
_SMALL_STEP = 1e-10
_MOST_DAMPING = 1e8
# Least scale of an alignment: a path of 1 km is then shorter than 1 um.
_LEAST_SCALE = 1e-9
# Least eigenvalue of the information with unit diagonal for an observable direction.
_UNSEEN = 1e-11


@dataclass(frozen=True, eq=False)
class Mode:
    """The most likely alignment."""

    element: Floats  # (4, 4)
    log_density: float  # eq. (18) at the element
    slope: Slope  # derivatives at the element


def find_mode(residuals: Residuals) -> Mode:
    """Return the alignment that maximises eq. (18)."""
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
            if scales(tried) < _LEAST_SCALE:
                raise DegenerateGeometryError(
                    "the most likely scale is zero, because positions and orientations do not "
                    "agree, as for a constant rotation between the bodies; correct the rotation "
                    "(--hand-eye auto), or choose a gauge without scale"
                )
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
    """Return the factors that scale an information matrix (d, d) to a unit diagonal, (d,)."""
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
    groundtruth, other = residuals.belief.poses, residuals.estimate
    p, q = groundtruth[:, :3, 3], other[:, :3, 3]
    weights = 3.0 / np.trace(covariances[:, :3, :3], axis1=1, axis2=2)
    total = float(weights.sum())
    p_mean, q_mean = weights @ p / total, weights @ q / total
    if not gauge.has_translation:
        return np.eye(4)
    if not len(residuals.chart.axes):
        return se3.poses(np.eye(3), p_mean - q_mean)
    spread = (weights[:, None] * (p - p_mean)).T @ (q - q_mean)
    of_rotations = np.zeros((3, 3))
    if residuals.oriented:
        known = 3.0 / np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2)
        of_rotations = np.einsum("n,nij,nkj->ik", known, groundtruth[:, :3, :3], other[:, :3, :3])
    size = float(weights @ np.square(q - q_mean).sum(axis=1))
    scale = 1.0
    for _ in range(3 if gauge.has_scale else 1):
        both = of_rotations + scale * spread
        if gauge.has_so3:
            u, _, vt = np.linalg.svd(both)
            rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        else:
            rotation = so3.exp(np.array([0.0, 0.0, so3.yaw_of_matrix(both)]))
        if gauge.has_scale and size > 0.0:
            scale = max(float(np.vdot(spread, rotation)) / size, 1e-6)
    return se3.poses(scale * rotation, p_mean - scale * rotation @ q_mean)
