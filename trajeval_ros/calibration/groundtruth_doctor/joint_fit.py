"""One Gauss-Newton for trajectory, biases and calibration, with a banded matrix and a border.

Residuals of an interval of the IMU, in the axes of knot i (Forster et al., TRO 2017, eq. 45):

    r_R = Log(dR^T R_i^T R_j)    r_v = R_i^T (v_j - v_i - g dt) - dv
    r_p = R_i^T (p_j - p_i - v_i dt - g dt^2 / 2) - dp

and random walks of the biases. With the samples' rows, the normal matrix is block tridiagonal in
the states, bordered by ten columns of the calibration. The noise of the IMU is given: a smooth
groundtruth that was fused with the same IMU has no noise from which it could be estimated. The
noise of the groundtruth is estimated by variance components.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.groundtruth_doctor.inertial_steps import InertialSteps, Motions
from trajeval_ros.calibration.groundtruth_doctor.rig import GRAVITY, LEVER, Rig, tangents
from trajeval_ros.calibration.groundtruth_doctor.sample_rows import (
    Predicted,
    SampleRows,
    TruthSamples,
    averaged,
    predict,
)  # fmt: skip
from trajeval_ros.calibration.robust_fit import BLOCKS
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.banded_matrices import Factor
from trajeval_ros.geometry.preintegration import ImuNoise
from trajeval_ros.geometry.se3 import times, transposed

STATES, PARAMETERS = 15, 10
_WALK = np.repeat([2e-5, 1e-3], 3)  # densities: rad/s^2/sqrt(Hz), m/s^3/sqrt(Hz)
_FIRST_BIAS = np.repeat([0.2, 1.0], 3)  # standard deviations: rad/s, m/s^2
_WEAK = np.repeat([1e-6, 1e-9], [9, 6])  # information that keeps unobserved states regular
_LEVER_M = 0.5  # standard deviation of the prior per axis
_WIDEST_LEVER_M = 0.05  # directions with a larger standard deviation are fixed
_FIXED = 1e8
_BROKEN = 50.0  # chi2 (9 degrees of freedom) of an interval over which the groundtruth jumps
_LARGEST_STEP = 0.02  # standard deviations, of a fit that has converged
_NOISE_RANGE = (np.repeat([2e-5, 1.7e-5], 3), np.repeat([10.0, 1.0], 3))  # m, rad
_REDUNDANCY_AT = (2, 4, 6, 9, 13)  # iterations
_SINGULAR = 1e-10


@dataclass(frozen=True)
class Horizon:
    """The time over which a fit trusts the IMU."""

    knot_s: float  # distance of the knots
    noise: ImuNoise
    sigmas: tuple[float, float]  # first standard deviations of a knot's measurement, m and rad
    window_s: float = 0.0  # rotations are averaged over it
    estimates_position_noise: bool = True


class JointFit:
    """The fit of one horizon; `solve` changes it."""

    def __init__(
        self,
        samples: TruthSamples,
        steps: InertialSteps,
        rig: Rig,
        horizon: Horizon,
        free: Booleans,
    ) -> None:
        """Start at a rig. `free` (10,) has the parameters that are estimated."""
        self.samples, self.steps, self.rig, self.free = samples, steps, rig, free
        self.horizon = horizon
        self.sigmas = np.repeat(horizon.sigmas, 3)
        self.fixed_directions: list[Floats] = []  # of the lever arm, (3,)
        bias = np.median(rig.gyro_biases, axis=0)
        covariances, self._by_biases = steps.uncertainty(bias, horizon.noise)
        self._whiten = np.linalg.inv(np.linalg.cholesky(covariances))
        self._iteration = 0
        self._linearise()

    def solve(self, iterations: int, *, estimate_noise: bool = True) -> None:
        """Iterate until the steps and changes of the noise are small."""
        redundancy = np.ones(6)
        for number in range(iterations):
            self._iteration += 1
            states, calibration = self._step()
            self.rig = self.rig.moved(states, calibration)
            change = 0.0
            if estimate_noise and number >= 2:
                if number in _REDUNDANCY_AT:
                    redundancy = self._redundancy()
                change = self._estimate_noise(redundancy)
            sigmas = np.sqrt(np.diag(self.covariance_of_model))
            is_small = (np.abs(calibration) <= _LARGEST_STEP * np.maximum(sigmas, 1e-12)).all()
            self._linearise()
            if number >= 3 + 3 * estimate_noise and is_small and change < _LARGEST_STEP:
                break

    def fix_unobservable_lever(self) -> None:
        """Fix directions of the lever arm that the motion does not determine, and solve again."""
        values, directions = np.linalg.eigh(self.covariance_of_model[LEVER, LEVER])
        self.fixed_directions = list(directions.T[values > _WIDEST_LEVER_M**2])
        if self.fixed_directions:
            self._linearise()
            self.solve(4, estimate_noise=False)

    def solve_again(self, rig: Rig, free: Booleans) -> None:
        """Solve from another rig with fewer free parameters (10,) and the same noise."""
        self.rig, self.free = rig, free
        self._linearise()
        self.solve(6, estimate_noise=False)

    @property
    def covariance_of_model(self) -> Floats:
        """Inverse of the information of the calibration (10, 10); zero for fixed parameters."""
        return self._inverse

    @property
    def covariance_of_blocks(self) -> Floats:
        """Sandwich covariance (10, 10) of the calibration, from the scores of twelve blocks."""
        after = self._by_calibration
        inertial = self._by_rig - self._before @ after[:-1] - self._after @ after[1:]
        rows = self._rows
        samples = self._sample_by_rig - self._sample_by_state @ after[rows.knots]
        block = np.arange(len(after)) * BLOCKS // len(after)
        scores = np.zeros((BLOCKS, PARAMETERS))
        np.add.at(scores, block[:-1], _scores(inertial, self._residuals))
        np.add.at(scores, block[:-1], -_scores(self._walk @ np.diff(after, axis=0), self._walked))
        np.add.at(scores, block[rows.knots], _scores(samples, self._sample_residuals))
        scores -= scores.mean(axis=0)
        meat = scores.T @ scores * (BLOCKS / (BLOCKS - 1))
        return np.asarray(self._inverse @ meat @ self._inverse)

    def state_covariances(self) -> Floats:
        """Return the covariances (N, 15, 15) of the knots, with the calibration's uncertainty."""
        blocks, _ = self._factor.inverse_blocks()
        after = self._by_calibration
        return np.asarray(blocks + after @ self._inverse @ transposed(after))

    @property
    def predicted(self) -> Predicted:
        """The rig at the samples, and their residuals."""
        return self._predicted

    @property
    def rows(self) -> SampleRows:
        """The measurements of the knots."""
        return self._rows

    @property
    def motions(self) -> Motions:
        """The motion of the intervals."""
        return self._motions

    def _linearise(self) -> None:
        """Evaluate residuals and Jacobians at the rig, and factorise the normal matrix."""
        rig = self.rig
        self._motions = self.steps.motions(rig.gyro_biases[:-1], rig.acceleration_biases[:-1])
        self._predicted = predict(self.samples, self.steps, self._motions, rig)
        self._linearise_imu()
        self._rows = averaged(
            self._predicted, rig, self.samples.middle_s,
            has_rotations=self.samples.rotations is not None,
        )  # fmt: skip
        if self.horizon.window_s:
            self._rows = self._rows.with_mean_rotations(
                rig, max(1, round(self.horizon.window_s / self.horizon.knot_s))
            )
        found = self._rows.weighted(self.sigmas)
        self._sample_residuals, self._sample_by_state, self._sample_by_rig = found
        self._factorise()

    def _linearise_imu(self) -> None:
        """Evaluate the whitened rows of the IMU (N - 1, 9) and of the biases (N - 1, 6)."""
        rig, dt = self.rig, self.steps.durations_s[:, None]
        into = transposed(rig.rotations[:-1])
        rotations, velocities, positions = (each[:, -1] for each in self._motions)
        turn = so3.log(transposed(rotations) @ into @ rig.rotations[1:])
        faster = times(into, np.diff(rig.velocities, axis=0) - rig.gravity * dt)
        start = rig.velocities[:-1] * dt + 0.5 * rig.gravity * dt**2
        moved = times(into, np.diff(rig.positions, axis=0) - start)
        residuals = np.concatenate([turn, faster - velocities, moved - positions], axis=1)
        before, after = np.zeros((2, len(dt), 9, STATES))
        by_rig = np.zeros((len(dt), 9, PARAMETERS))
        back, step = so3.inverse_left_jacobian(-turn), dt[..., None]
        after[:, 0:3, 0:3], after[:, 3:6, 3:6], after[:, 6:9, 6:9] = back, into, into
        before[:, 0:3, 0:3] = -back @ transposed(rig.rotations[1:]) @ rig.rotations[:-1]
        before[:, 3:6, 0:3], before[:, 6:9, 0:3] = so3.skew(faster), so3.skew(moved)
        before[:, 3:6, 3:6], before[:, 6:9, 3:6] = -into, -into * step
        before[:, 6:9, 6:9] = -into
        before[:, :, 9:15] = -self._by_biases
        before[:, 0:3, 9:15] = -back @ transposed(so3.exp(turn)) @ self._by_biases[:, 0:3]
        by_rig[:, 3:6, GRAVITY] = -into @ tangents(rig.gravity) * step
        by_rig[:, 6:9, GRAVITY] = 0.5 * by_rig[:, 3:6, GRAVITY] * step
        whitened = times(self._whiten, residuals)
        weight = np.ones(len(dt))
        if self._iteration > 4:  # a jump of the groundtruth must not bend the chain
            squared = np.square(whitened).sum(axis=1)
            weight = np.minimum(1.0, (_BROKEN / np.maximum(squared, 1e-9)) ** 0.25)
        whiten = self._whiten * weight[:, None, None]
        self._residuals = whitened * weight[:, None]
        self._before, self._after, self._by_rig = whiten @ before, whiten @ after, whiten @ by_rig
        biases = np.concatenate([rig.gyro_biases, rig.acceleration_biases], axis=1)
        deviations = _WALK * np.sqrt(dt)
        self._walked = np.diff(biases, axis=0) / deviations
        self._walk = np.zeros((len(dt), 6, STATES))
        self._walk[:, np.arange(6), np.arange(9, 15)] = 1.0 / deviations

    def _factorise(self) -> None:
        """Assemble the normal equations, factorise them, and eliminate the states."""
        count, rows = len(self.rig.positions), self._rows
        before, after, walk, by_rig = self._before, self._after, self._walk, self._by_rig
        diagonal = np.zeros((count, STATES, STATES))
        border = np.zeros((count, STATES, PARAMETERS + 1))  # the last column is the gradient
        from_rig = np.concatenate([by_rig, self._residuals[..., None]], axis=2)
        of_walk = transposed(walk) @ walk
        diagonal[:-1] += transposed(before) @ before + of_walk
        diagonal[1:] += transposed(after) @ after + of_walk
        lower = transposed(after) @ before - of_walk
        border[:-1] += transposed(before) @ from_rig
        border[1:] += transposed(after) @ from_rig
        change = times(transposed(walk), self._walked)
        border[:-1, :, -1] -= change
        border[1:, :, -1] += change
        by_state = self._sample_by_state
        of_samples = np.concatenate(
            [self._sample_by_rig, self._sample_residuals[..., None]], axis=2
        )
        diagonal[rows.knots] += transposed(by_state) @ by_state
        border[rows.knots] += transposed(by_state) @ of_samples
        corner = np.einsum("nij,nik->jk", from_rig, from_rig)
        corner += np.einsum("nij,nik->jk", of_samples, of_samples)
        prior = np.eye(3) / _LEVER_M**2
        prior += _FIXED * sum(np.outer(each, each) for each in self.fixed_directions)
        corner[LEVER, LEVER] += prior
        corner[LEVER, -1] += prior @ self.rig.lever
        first = np.concatenate([self.rig.gyro_biases[0], self.rig.acceleration_biases[0]])
        diagonal[0, 9:, 9:] += np.diag(_FIRST_BIAS**-2.0)
        border[0, 9:, -1] += first / _FIRST_BIAS**2
        diagonal += np.diag(_WEAK)
        self._factor = Factor.of(diagonal, lower)
        solved = self._factor.solve(border)
        self._by_calibration, self._by_gradient = solved[..., :-1], solved[..., -1]
        reduced = corner[:-1] - np.einsum("nij,nik->jk", border[..., :-1], solved)
        self._gradient = reduced[:, -1]
        self._inverse = np.zeros((PARAMETERS, PARAMETERS))
        free = np.ix_(self.free, self.free)
        information = reduced[:, :-1][free]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-30))
        values, vectors = np.linalg.eigh(information * scale[:, None] * scale)
        vectors = vectors * scale[:, None]
        # An unobservable direction has a large variance and no step.
        self._inverse[free] = (vectors / np.maximum(values, _SINGULAR)) @ vectors.T
        stepped = np.where(values > _SINGULAR, values, np.inf)
        self._step_inverse = np.zeros_like(self._inverse)
        self._step_inverse[free] = (vectors / stepped) @ vectors.T

    def _step(self) -> tuple[Floats, Floats]:
        """Return the Gauss-Newton step of the states (N, 15) and of the calibration (10,)."""
        calibration = -self._step_inverse @ self._gradient
        return -self._by_gradient - self._by_calibration @ calibration, calibration

    def _redundancy(self) -> Floats:
        """Return the redundancies of the three rows of position and of rotation, (6,)."""
        blocks, _ = self._factor.inverse_blocks()
        by_state = self._sample_by_state
        used = ((by_state @ blocks[self._rows.knots]) * by_state).sum(axis=2)
        free = np.clip(self._rows.shares - used, 0.0, 1.0).sum(axis=0)
        return np.repeat([free[:3].sum(), free[3:].sum()], 3)

    def _estimate_noise(self, redundancy: Floats) -> float:
        """Scale the standard deviations, and return the largest change of their logarithms."""
        squares = np.square(self._sample_residuals).sum(axis=0)
        squares = np.repeat([squares[:3].sum(), squares[3:].sum()], 3)
        ratio = np.sqrt(np.clip(squares / np.maximum(redundancy, 1.0), 0.09, 9.0))
        if not self.horizon.estimates_position_noise:
            ratio[:3] = 1.0
        if self.samples.rotations is None:
            ratio[3:] = 1.0
        before = self.sigmas
        self.sigmas = np.clip(before * ratio, *_NOISE_RANGE)
        return float(np.abs(np.log(self.sigmas / before)).max())


def _scores(by_rig: Floats, residuals: Floats) -> Floats:
    scores: Floats = np.einsum("nij,ni->nj", by_rig, residuals)
    return scores
