"""Continuous parameters of a model by one Gauss-Newton, and the odds that they are mistakes.

The parameters are the rotation of the body, the logarithm of the scale, the lever arm, the offset
and the rate of the clock. A parameter is a mistake if a wide distribution explains its value much
better than the spread of healthy estimates: significance alone is no mistake.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trajeval_ros.diagnosis.motion_models import (
    DEGREES_OF_FREEDOM,
    Model,
    ModelScores,
    ReadMotions,
    t_log_likelihood,
)
from trajeval_ros.diagnosis.short_motions import DERIVATIVE_S, PoseEnds
from trajeval_ros.geometry import lie, so3
from trajeval_ros.geometry.arrays import Floats

BODY, SCALE, LEVER, OFFSET, RATE = slice(0, 3), slice(3, 4), slice(4, 7), slice(7, 8), slice(8, 9)
_COUNT = 9
_ITERATIONS, _CONVERGED = 5, 1e-5  # of Gauss-Newton, and the last step in prior deviations
_BLOCKS = 24  # of time, for the covariance: residuals within a block are correlated
_MOST_ROTATION, _MOST_LOG_SCALE = 0.7, 1.0  # of one iteration, rad and logarithm
_MOST_OFFSET_S, _MOST_RATE = 0.5, 0.05  # beyond, the derivatives by the clock are useless
# Of the fit: it keeps directions near zero that the motion does not show, such as the height of
# a vehicle's lever arm. A narrower prior would make all lever arms shorter.
_LEVER_PRIOR_M = 2.0


@dataclass(frozen=True)
class Spread:
    """Standard deviations of a parameter: of healthy estimates, and if it is a mistake."""

    healthy: float
    mistake: float


# Larger healthy spreads miss small mistakes; smaller ones alarm about drift and calibrations.
SPREADS = {
    "body": Spread(math.radians(0.7), 1.0),  # rad
    "scale": Spread(0.045, 1.5),  # of the logarithm
    "lever": Spread(0.03, 0.6),  # m
    "offset": Spread(0.004, 0.3),  # s
    "rate": Spread(3e-5, 5e-3),
    "tilt": Spread(math.radians(0.5), 0.8),  # rad, of a world
}


@dataclass(frozen=True, eq=False)
class Parameters:
    """The fitted parameters of a model."""

    # (9,) rotation vector of the body (rad), logarithm of the scale, lever arm in the estimate's
    # body (m of the groundtruth), offset (s) and rate of the clock.
    values: Floats
    covariance: Floats  # (9, 9)
    body: Floats  # (3, 3) rotation from the estimate's body to the groundtruth's

    def log_odds(self, name: str, rows: slice) -> float:
        """Return the logarithm of the odds that a parameter is a mistake."""
        return log_odds(self.values[rows], self.covariance[rows, rows], SPREADS[name])

    @property
    def scale(self) -> float:
        """Groundtruth metres per unit of the estimate."""
        return float(np.exp(self.values[3]))

    @property
    def offset_s(self) -> float:
        """Time to add to the estimate's timestamps, in the middle of the run."""
        return float(self.values[7])

    @property
    def rate(self) -> float:
        """Rate to correct the estimate's clock by."""
        return float(self.values[8])


def log_odds(values: Floats, covariance: Floats, spread: Spread) -> float:
    """Return log N(v; 0, H^2 + C) - log N(v; 0, h^2 + C), of values (k,) and covariance (k, k)."""
    identity, densities = np.eye(len(values)), []
    for deviation in (spread.mistake, spread.healthy):
        total = covariance + deviation**2 * identity
        _, log_determinant = np.linalg.slogdet(total)
        distance = float(values @ np.linalg.solve(total, values))
        densities.append(-0.5 * float(log_determinant) - 0.5 * distance)
    return densities[0] - densities[1]


def fit_parameters(scores: ModelScores, model: Model) -> Parameters:
    """Fit all parameters of a model at once, with a covariance by blocks of time.

    The residuals are psi_g + dpsi_g/dt o - Y psi and u_g + du_g/dt o - s Y (u + (R - 1) l), with
    the body's rotation Y, the scale s, the lever arm l, and the clock's offset o.
    """
    fit = _GaussNewton(scores, model)
    for _ in range(_ITERATIONS):
        if fit.iterate() < _CONVERGED:
            break
    return fit.result()


class _GaussNewton:
    """State of the iteration; prior deviations are those of mistakes, but of lever arms."""

    def __init__(self, scores: ModelScores, model: Model) -> None:
        self.read: ReadMotions = scores.read(model.hypothesis)
        motions = self.read.motions
        self.weight, self.seconds = scores.weight, motions.seconds
        self.displacements = self.read.displacements(model.axes)
        later, earlier = (
            poses.body_motions()
            for poses in (motions.groundtruth_later, motions.groundtruth_earlier)
        )
        self.rotation_rates, self.displacement_rates = (
            (one - other) / (2.0 * DERIVATIVE_S) for one, other in zip(later, earlier, strict=True)
        )
        self.swing = _swing(motions.estimate)
        self.body, self.scale, self.lever = model.body.copy(), model.scale, np.zeros(3)
        self.offset_s, self.rate = 0.0, 0.0
        spreads = (SPREADS[name].mistake for name in ("body", "scale", "lever", "offset", "rate"))
        self.deviations = np.repeat(list(spreads), (3, 1, 3, 1, 1))
        self.deviations[LEVER] = _LEVER_PRIOR_M / model.scale

    def iterate(self) -> float:
        """Do one step, and return its largest component in prior deviations."""
        residuals, jacobian = self._linearised()
        _, scale = t_log_likelihood(residuals.T, iterations=3)
        nu = DEGREES_OF_FREEDOM
        weights = (nu + 1.0) / (nu + (residuals / scale) ** 2) / scale**2
        weighted = jacobian * weights[:, :, None]
        from_prior = np.concatenate([np.zeros(4), self.lever, [self.offset_s, self.rate]])
        prior = self.deviations**-2
        self.normal = np.einsum("nka,nkb->ab", weighted, jacobian) * self.weight + np.diag(prior)
        self.gradients = np.einsum("nka,nk->na", weighted, residuals) * self.weight
        step = -np.linalg.solve(self.normal, self.gradients.sum(axis=0) + from_prior * prior)
        step[BODY] *= min(1.0, _MOST_ROTATION / (float(np.linalg.norm(step[BODY])) + 1e-12))
        step[3] = np.clip(step[3], -_MOST_LOG_SCALE, _MOST_LOG_SCALE)
        self.body = lie.to_matrix(lie.from_rotation_vector(step[BODY])) @ self.body
        self.scale *= float(np.exp(step[3]))
        self.lever = self.lever + step[LEVER]
        self.offset_s = float(np.clip(self.offset_s + step[7], -_MOST_OFFSET_S, _MOST_OFFSET_S))
        self.rate = float(np.clip(self.rate + step[8], -_MOST_RATE, _MOST_RATE))
        return float(np.abs(step / self.deviations).max())

    def _linearised(self) -> tuple[Floats, Floats]:
        """Return residuals (N, k) and their derivatives (N, k, 9)."""
        rotations, displacements = self.read.groundtruth
        rotation_unit, displacement_unit = (
            unit[:, None] for unit in self.read.of_groundtruth.units
        )
        time = (self.offset_s + self.rate * self.seconds)[:, None]
        predicted = (self.displacements + self.swing @ self.lever) @ self.body.T
        residuals = displacements + self.displacement_rates * time - self.scale * predicted
        jacobian = np.zeros((len(time), 3, _COUNT))
        jacobian[:, :, BODY] = so3.skew(displacements)
        jacobian[:, :, 3] = -displacements
        jacobian[:, :, LEVER] = -self.scale * self.body @ self.swing
        jacobian[:, :, 7] = self.displacement_rates
        jacobian[:, :, 8] = self.displacement_rates * self.seconds[:, None]
        residuals = residuals / displacement_unit
        jacobian /= displacement_unit[:, :, None]
        if not self.read.motions.has_orientations:
            return residuals, jacobian
        of_rotations = rotations + self.rotation_rates * time - self.read.rotations @ self.body.T
        other = np.zeros_like(jacobian)
        other[:, :, BODY] = so3.skew(rotations)
        other[:, :, 7] = self.rotation_rates
        other[:, :, 8] = self.rotation_rates * self.seconds[:, None]
        return (
            np.concatenate([of_rotations / rotation_unit, residuals], axis=1),
            np.concatenate([other / rotation_unit[:, :, None], jacobian], axis=1),
        )

    def result(self) -> Parameters:
        """Return the parameters with the sandwich covariance (White, 1980) of blocks of time."""
        count = len(self.seconds)
        sums = np.zeros((_BLOCKS, _COUNT))
        np.add.at(sums, np.arange(count) * _BLOCKS // count, self.gradients)
        inverse = np.linalg.inv(self.normal)
        covariance = inverse @ (sums.T @ sums) @ inverse * (_BLOCKS / (_BLOCKS - _COUNT))
        # No model of the geometry is exact; those of clocks are.
        covariance[:7, :7] += inverse[:7, :7]
        covariance[LEVER] *= self.scale
        covariance[:, LEVER] *= self.scale
        rotation = lie.rotation_vector(lie.from_matrix(self.body))
        values = np.concatenate(
            [rotation, [np.log(self.scale)], self.scale * self.lever, [self.offset_s, self.rate]]
        )
        return Parameters(values, covariance, self.body)


def _swing(estimate: PoseEnds) -> Floats:
    """Return the rotations of motions minus the identity (N, 3, 3); zeros without orientations."""
    if estimate.quaternions is None:
        return np.zeros((estimate.positions.shape[1], 3, 3))
    start, end = estimate.quaternions
    return lie.to_matrix(lie.multiply(lie.conjugate(start), end)) - np.eye(3)
