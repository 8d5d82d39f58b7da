"""Continuous parameters of a model by one Gauss-Newton, and the odds that they are mistakes.

The parameters are the rotation of the body, the logarithm of the scale, the lever arm, the offset
and the rate of the clock. A parameter is a mistake if a wide distribution explains its value much
better than the spread of healthy estimates: significance alone is no mistake.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from trajeval_ros.diagnosis.motion_models import (
    DEGREES_OF_FREEDOM,
    Model,
    ModelScores,
    t_log_likelihood,
)
from trajeval_ros.diagnosis.short_motions import DERIVATIVE_S
from trajeval_ros.geometry import lie, so3
from trajeval_ros.geometry.arrays import Floats

_ITERATIONS, _CONVERGED = 5, 1e-5  # of Gauss-Newton, and the last step in prior deviations
_BLOCKS = 24  # of time, for the covariance: residuals within a block are correlated
# Of the fit: it keeps directions near zero that the motion does not show, such as the height of
# a vehicle's lever arm. A narrower prior would make all lever arms shorter.
_LEVER_PRIOR_M = 2.0


@dataclass(frozen=True)
class Spread:
    """Standard deviations of a parameter: of healthy estimates, and if it is a mistake."""

    healthy: float
    mistake: float
    size: int = 1  # number of components


# Larger healthy spreads miss small mistakes; smaller ones alarm about drift and calibrations.
SPREADS = {
    "body": Spread(math.radians(0.7), 1.0, 3),  # rad
    "scale": Spread(0.045, 1.5),  # of the logarithm
    "lever": Spread(0.03, 0.6, 3),  # m
    "offset": Spread(0.004, 0.3),  # s
    "rate": Spread(3e-5, 5e-3),
    "tilt": Spread(math.radians(0.5), 0.8, 2),  # rad, of a world; not fitted with the others
}
# Columns of the fitted parameters, in their order.
BODY, SCALE, LEVER, OFFSET, RATE, _ = (
    slice(end - spread.size, end)
    for end, spread in zip(
        itertools.accumulate(spread.size for spread in SPREADS.values()),
        SPREADS.values(),
        strict=True,
    )
)


def log_odds(values: Floats, covariance: Floats, spread: Spread) -> float:
    """Return log N(v; 0, H^2 + C) - log N(v; 0, h^2 + C), of values (k,) and covariance (k, k)."""
    densities = []
    for deviation in (spread.mistake, spread.healthy):
        total = covariance + deviation**2 * np.eye(len(values))
        distance = float(values @ np.linalg.solve(total, values))
        densities.append(-0.5 * float(np.linalg.slogdet(total)[1]) - 0.5 * distance)
    return densities[0] - densities[1]


@dataclass(frozen=True, eq=False)
class Parameters:
    """The fitted parameters of a model."""

    # (9,) rotation vector of the body (rad), logarithm of the scale, lever arm in the estimate's
    # body (m of the groundtruth), offset (s) in the middle of the run, and rate of the clock.
    values: Floats
    covariance: Floats  # (9, 9)
    body: Floats  # (3, 3) rotation from the estimate's body to the groundtruth's

    @property
    def scale(self) -> float:
        """Groundtruth metres per unit of the estimate."""
        return float(np.exp(self.values[SCALE].item()))

    @property
    def offset_s(self) -> float:
        """Time to add to the estimate's timestamps, in the middle of the run."""
        return self.values[OFFSET].item()

    @property
    def rate(self) -> float:
        """Rate to correct the estimate's clock by."""
        return self.values[RATE].item()


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
        self.read = scores.read(model.hypothesis)
        motions = self.read.motions
        self.weight, self.seconds = scores.weight, motions.seconds
        self.displacements = self.read.displacements(model.axes)
        _, *around = (ends.body_motions() for ends in motions.around)
        self.rates = [
            (later - earlier) / (2.0 * DERIVATIVE_S)
            for later, earlier in zip(*around, strict=True)
        ]
        # Rotations of motions minus the identity, by which a lever arm moves.
        self.swing = np.zeros((len(motions), 3, 3))
        if motions.estimate.quaternions is not None:
            start, end = motions.estimate.quaternions
            self.swing = lie.to_matrix(lie.multiply(lie.conjugate(start), end)) - np.eye(3)
        self.body, self.scale = model.body.copy(), model.scale
        self.rest = np.zeros(5)  # lever arm, offset and rate
        self.deviations = np.array(
            [*[SPREADS["body"].mistake] * 3, SPREADS["scale"].mistake]
            + [*[_LEVER_PRIOR_M / model.scale] * 3]
            + [SPREADS["offset"].mistake, SPREADS["rate"].mistake]
        )

    def iterate(self) -> float:
        """Do one step, and return its largest component in prior deviations."""
        residuals, jacobian = self._linearised()
        _, scale = t_log_likelihood(residuals.T, iterations=3)
        nu = DEGREES_OF_FREEDOM
        weights = (nu + 1.0) / (nu + (residuals / scale) ** 2) / scale**2
        weighted = jacobian * weights[:, :, None]
        prior = self.deviations**-2
        self.normal = np.einsum("nka,nkb->ab", weighted, jacobian) * self.weight + np.diag(prior)
        self.gradients = np.einsum("nka,nk->na", weighted, residuals) * self.weight
        from_prior = np.concatenate([np.zeros(4), self.rest]) * prior
        step = -np.linalg.solve(self.normal, self.gradients.sum(axis=0) + from_prior)
        step = np.clip(step, -self.deviations, self.deviations)  # beyond, derivatives are useless
        self.body = lie.to_matrix(lie.from_rotation_vector(step[BODY])) @ self.body
        self.scale *= float(np.exp(step[SCALE].item()))
        self.rest = self.rest + step[LEVER.start :]
        return float(np.abs(step / self.deviations).max())

    def _linearised(self) -> tuple[Floats, Floats]:
        """Return residuals (N, k) and their derivatives (N, k, 9)."""
        rotations, displacements = self.read.truth.motions
        seconds, (*lever, offset_s, rate) = self.seconds[:, None], self.rest
        time = offset_s + rate * seconds
        predicted = (self.displacements + self.swing @ np.array(lever)) @ self.body.T
        of_displacements = np.zeros((len(time), 3, len(self.deviations)))
        of_displacements[:, :, SCALE] = -displacements[:, :, None]
        of_displacements[:, :, LEVER] = -self.scale * self.body @ self.swing
        kinds = [(displacements, self.scale * predicted, of_displacements)]
        if self.read.motions.has_orientations:
            rotated = self.read.rotations @ self.body.T
            kinds.insert(0, (rotations, rotated, np.zeros_like(of_displacements)))
        rows, derivatives = [], []
        for kind in range(-len(kinds), 0):  # of the pairs of rotations and displacements
            (motion, estimated, jacobian), by_time = kinds[kind], self.rates[kind]
            unit = self.read.truth.units[kind][:, None]
            jacobian[:, :, BODY] = so3.skew(motion)
            by_rate = by_time * seconds
            jacobian[:, :, OFFSET], jacobian[:, :, RATE] = by_time[:, :, None], by_rate[:, :, None]
            rows.append((motion + by_time * time - estimated) / unit)
            derivatives.append(jacobian / unit[:, :, None])
        return np.concatenate(rows, axis=1), np.concatenate(derivatives, axis=1)

    def result(self) -> Parameters:
        """Return the parameters with the sandwich covariance (White, 1980) of blocks of time."""
        count, width = len(self.seconds), len(self.deviations)
        sums = np.zeros((_BLOCKS, width))
        np.add.at(sums, np.arange(count) * _BLOCKS // count, self.gradients)
        inverse = np.linalg.inv(self.normal)
        covariance = inverse @ (sums.T @ sums) @ inverse * (_BLOCKS / (_BLOCKS - width))
        # No model of the geometry is exact; those of clocks are.
        geometry = slice(LEVER.stop)
        covariance[geometry, geometry] += inverse[geometry, geometry]
        covariance[LEVER] *= self.scale
        covariance[:, LEVER] *= self.scale
        rotation = lie.rotation_vector(lie.from_matrix(self.body))
        values = np.concatenate([rotation, [np.log(self.scale)], self.rest])
        values[LEVER] *= self.scale
        return Parameters(values, covariance, self.body)
