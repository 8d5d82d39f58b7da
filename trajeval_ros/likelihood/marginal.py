"""The generalised absolute error, eq. (19): density of an estimate, integrated over alignments.

The integral is with respect to the right Haar measure of the gauge's group. Over R^6, as in the
paper, it diverges, because Exp covers every rotation many times. Over rotation vectors up to pi,
it depends on the estimate's frame. With the Haar measure it is the exact density of the relative
poses, so that absolute and relative errors agree to all orders, not only to the first.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, ndtri

from trajeval_ros.continuous_time.samples import Belief
from trajeval_ros.geometry import se3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.likelihood.alignment_chart import act
from trajeval_ros.likelihood.relative_density import LOG_2_PI
from trajeval_ros.likelihood.residuals import Mode, Residuals, find_mode, unit_diagonal

# Largest number of poses with second derivatives by differences; above it they change a score by
# less than 1e-5 nats.
_MOST_FOR_FULL = 500
_STEP = 1e-3
# The error of Laplace's approximation is an eighth of a rotation's variance, nats.
MOST_TURN_RAD = 0.3
_DRAWS, _FREEDOM = 4096, 8.0
_LARGE_RESIDUAL_RAD = 2.5


@dataclass(frozen=True, eq=False)
class AbsoluteErrorDensity:
    """The generalised absolute error of an estimate."""

    residuals: Residuals  # groundtruth, estimate and gauge
    mode: Mode  # the most likely alignment
    information: Floats  # (d, d), minus the second derivative of the log density at the mode
    log_likelihood: float  # logarithm of L_AE, eq. (19), nats
    method: str  # method of integration, `laplace` or `importance`
    # Effective share of the draws in importance sampling; None for `laplace`.
    effective_share: float | None = None
    statements: tuple[str, ...] = ()  # remarks about the validity of the number, one sentence each

    @property
    def nll_per_pose(self) -> float:
        """Minus the log likelihood per pose, nats."""
        return -self.log_likelihood / len(self.residuals)

    @property
    def covariance(self) -> Floats:
        """Covariance of the alignment in its chart, (d, d)."""
        scale = 1.0 / np.sqrt(np.diag(self.information))
        scaled = np.linalg.inv(self.information * scale * scale[:, None])
        covariance: Floats = scaled * scale * scale[:, None]
        return covariance

    @property
    def mahalanobis2(self) -> Floats:
        """Squared Mahalanobis distances (M,) of the aligned poses."""
        squared: Floats = np.square(self.mode.slope.whitened).sum(axis=1)
        return squared

    @property
    def dof(self) -> int:
        """Degrees of freedom of their sum, without those of the alignment."""
        return self.residuals.axes * len(self.residuals) - self.residuals.chart.dimension

    @property
    def chi2_per_dof(self) -> float:
        """Their sum per degree of freedom: 1 if errors are as expected from the groundtruth."""
        return float(self.mahalanobis2.sum()) / self.dof

    @property
    def per_axis(self) -> Floats:
        """Mean squared error over variance along every axis of the body, (k,)."""
        squared = np.square(self.residuals.at(self.mode.element))
        ratio = squared / np.einsum("nii->ni", self.residuals.covariances)
        return np.asarray(ratio.mean(axis=0))


def generalised_absolute_error(residuals: Residuals) -> AbsoluteErrorDensity:
    """Return L_AE, eq. (19), by Laplace's approximation or importance sampling.

    Importance sampling is used if the standard deviation of the alignment's rotation exceeds
    0.3 rad.
    """
    mode = find_mode(residuals)
    information = mode.slope.information
    if len(residuals) <= _MOST_FOR_FULL and residuals.chart.dimension:
        information = full_information(residuals, mode)
    error = AbsoluteErrorDensity(
        residuals, mode, information, laplace(mode, information), "laplace"
    )
    sigma_rad = _turn_uncertainty(error)
    if sigma_rad <= MOST_TURN_RAD:
        return dataclasses.replace(error, statements=_statements(error, sigma_rad, None))
    value, share = importance(error)
    return AbsoluteErrorDensity(
        residuals,
        mode,
        information,
        value,
        "importance",
        share,
        _statements(error, sigma_rad, share),
    )


def laplace(mode: Mode, information: Floats) -> float:
    """Return the log integral of a Gaussian with a mode's value and curvature.

    Raises:
        DegenerateGeometryError: The curvature (d, d) is not positive definite.
    """
    if len(information):
        unit_diagonal(information)
    return (
        mode.log_density
        + 0.5 * len(information) * LOG_2_PI
        - 0.5 * float(np.linalg.slogdet(information)[1])
    )


def full_information(residuals: Residuals, mode: Mode) -> Floats:
    """Return minus the second derivatives (d, d) at a mode, by differences of the gradient."""
    size = residuals.chart.dimension
    # The estimate is aligned beforehand, so that all differences have the same rounding errors.
    # Both are centred, because differences of gradients lose the digits of large coordinates.
    centre, belief = residuals.chart.centre, residuals.belief
    residuals = dataclasses.replace(
        residuals,
        belief=Belief(_centred(belief.poses, centre), belief.covariances),
        estimate=_centred(act(mode.element, residuals.estimate), centre),
    )
    steps = _STEP / np.sqrt(np.diag(mode.slope.information))
    information = np.empty((size, size))
    for axis in range(size):
        gradients = []
        for share in (1.0, -1.0, 2.0, -2.0):
            delta = np.zeros((1, size))
            delta[0, axis] = share * steps[axis]
            gradients.append(residuals.slope(residuals.chart.elements(delta)[0]).gradient)
        near, far = gradients[0] - gradients[1], gradients[2] - gradients[3]
        information[axis] = (far - 8.0 * near) / (12.0 * steps[axis])
    symmetric: Floats = 0.5 * (information + information.T)
    return symmetric


def _centred(poses: Floats, centre: Floats) -> Floats:
    """Return poses (M, 4, 4) with positions relative to a centre (3,)."""
    return se3.poses(poses[:, :3, :3], poses[:, :3, 3] - centre)


def importance(error: AbsoluteErrorDensity) -> tuple[float, float]:
    """Return the log integral by importance sampling, and the effective share of the draws.

    Draws are from a Student t distribution about the mode, by a scrambled Sobol sequence with a
    fixed seed.
    """
    from scipy.stats import chi2, qmc

    size = error.residuals.chart.dimension
    uniform = qmc.Sobol(size + 1, seed=0).random(_DRAWS)
    uniform = np.clip(uniform, 1e-12, 1.0 - 1e-12)
    stretch = np.sqrt(_FREEDOM / chi2.ppf(uniform[:, -1], _FREEDOM))
    white = ndtri(uniform[:, :-1]) * stretch[:, None]
    proposal = gammaln((_FREEDOM + size) / 2.0) - gammaln(_FREEDOM / 2.0)
    proposal -= 0.5 * size * np.log(_FREEDOM * np.pi)
    length = np.square(white).sum(axis=1)
    proposal = proposal - 0.5 * (_FREEDOM + size) * np.log1p(length / _FREEDOM)
    values = _log_values(error, white) - proposal
    weights = np.exp(values - values.max())
    share = float(weights.sum() ** 2 / np.square(weights).sum()) / _DRAWS
    return _log_sum(values) - float(np.log(_DRAWS)) + _log_root(error), share


def _log_values(error: AbsoluteErrorDensity, white: Floats) -> Floats:
    """Return the log integrand (K,) at white coordinates (K, d) about the mode."""
    chart = error.residuals.chart
    variances, vectors = np.linalg.eigh(error.information)
    deltas = white @ (vectors / np.sqrt(variances)).T
    values = error.residuals.log_density(chart.elements(deltas) @ error.mode.element)
    values += chart.log_measure(deltas)
    values[~chart.within(deltas)] = -np.inf
    return values


def _log_root(error: AbsoluteErrorDensity) -> float:
    """Return log |d delta / d white|."""
    return -0.5 * float(np.linalg.slogdet(error.information)[1])


def _log_sum(values: Floats) -> float:
    """Return log sum exp of values (K,)."""
    largest = float(values.max())
    return largest + float(np.log(np.exp(values - largest).sum()))


def _turn_uncertainty(error: AbsoluteErrorDensity) -> float:
    """Return the largest standard deviation of the alignment's rotation, rad."""
    columns = error.residuals.chart.turns
    if columns.start == columns.stop:
        return 0.0
    return float(np.sqrt(np.linalg.eigvalsh(error.covariance[columns, columns])[-1]))


def _statements(error: AbsoluteErrorDensity, turn: float, share: float | None) -> tuple[str, ...]:
    """Return remarks about the validity of the likelihood."""
    residuals = error.residuals
    statements = []
    if turn > MOST_TURN_RAD:
        statements.append(
            f"the rotation of the alignment has a standard deviation of {np.degrees(turn):.0f} "
            "deg, so the likelihood averages over very different alignments"
        )
    if share is not None and share < 0.05:
        statements.append(
            "importance sampling of the alignment has an effective sample size of only "
            f"{100.0 * share:.1f} %; the likelihood is unreliable"
        )
    if residuals.oriented:
        largest = np.linalg.norm(residuals.at(error.mode.element)[:, 3:], axis=1).max()
        if largest > _LARGE_RESIDUAL_RAD:
            statements.append(
                f"a pose differs by {np.degrees(largest):.0f} deg from its groundtruth; other "
                "alignments can be equally likely"
            )
    if residuals.gauge is Gauge.SIM3 and residuals.oriented:
        statements.append(
            "with a free scale, likelihoods depend on the reference point of the body; use "
            "positions of the camera"
        )
    return tuple(statements)
