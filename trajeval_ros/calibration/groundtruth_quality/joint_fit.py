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

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.groundtruth_quality.inertial_steps import (
    InertialSteps,
    turns_about_one_axis,
)
from trajeval_ros.calibration.groundtruth_quality.rig import GRAVITY, LEVER, UNITS, Rig, tangents
from trajeval_ros.calibration.groundtruth_quality.sample_rows import (
    TruthSamples,
    averaged,
    predict,
)
from trajeval_ros.calibration.robust_fit import BLOCKS
from trajeval_ros.calibration.significance import axis_name
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices
from trajeval_ros.geometry.banded_matrices import AT_ONCE, Factor, add_blocks
from trajeval_ros.geometry.inertial import ImuNoise
from trajeval_ros.geometry.se3 import times, transposed

STATES, PARAMETERS = 15, 10
_WALK = np.repeat([2e-5, 1e-3], 3)  # densities: rad/s^2/sqrt(Hz), m/s^3/sqrt(Hz)
_FIRST_BIAS = np.repeat([0.2, 1.0], 3)  # standard deviations: rad/s, m/s^2
_WEAK = np.repeat([1e-6, 1e-9], [9, 6])  # information that keeps unobserved states regular
LEVER_M = 0.5  # standard deviation of the prior per axis
_WIDEST_LEVER_M = 0.05  # directions with a larger standard deviation are fixed
_FIXED = 1e8
_BROKEN = 50.0  # chi2 (9 degrees of freedom) of an interval over which the groundtruth jumps
_LARGEST_STEP = 0.02  # standard deviations, of a fit that has converged
_LEAST_NOISE, _LARGEST_NOISE = np.repeat([2e-5, 1.7e-5], 3), np.repeat([10.0, 1.0], 3)  # m, rad
_REDUNDANCY_AT = (2, 4, 6, 9, 13)  # iterations
_SINGULAR = 1e-10
_ROWS = ((0, 1), (0, 1))  # axes of rows (n, 15, ...) over which products are summed


@dataclass(frozen=True, eq=False)
class Horizon:
    """The time over which a fit trusts the IMU."""

    knot_s: float  # distance of the knots
    noise: ImuNoise
    sigmas: tuple[float, float]  # first standard deviations of a knot's measurement, m and rad
    window_s: float = 0.0  # rotations are averaged over it; then the noise of positions is given
    fixed: tuple[Floats, ...] = ()  # directions of the lever arm (3,) that are not estimated


@dataclass(frozen=True, eq=False)
class HorizonFit:
    """The calibration of one horizon, in the units of `UNITS`."""

    values: Floats  # (10,): rotation vector, lever arm, offset, skew, tilt about y and -x
    sigmas: Floats  # (10,), without the errors that a recording does not reveal
    seconds: Floats  # (Q,), times of the knots since the groundtruth's first pose
    residuals: Floats  # (Q, 2), lengths of position (m) and rotation (rad) residuals
    noise: Floats  # (6,), standard deviations of a knot's measurement, m and rad
    fixed_directions: tuple[Floats, ...]  # of the lever arm (3,), which are not estimated

    @property
    def fixed_axes(self) -> str:
        """The fixed directions as text."""
        return " and ".join(map(axis_name, self.fixed_directions))


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
        self.fixed_directions = list(horizon.fixed)  # of the lever arm, unobservable ones (3,)
        self.sigmas = np.repeat(horizon.sigmas, 3)  # of a knot's measurement, m and rad
        # Noise of the IMU acts at the next knot. If positions are trusted more than the IMU, it
        # contains motion. This delay is an error of the clock, unless rotations determine it.
        self._least_noise = _LEAST_NOISE if samples.has_rotations else self.sigmas
        if turns_about_one_axis(steps.rates.reshape(-1, 3)):
            drift_m = horizon.noise.accelerometer * np.sqrt(horizon.knot_s**3 / 3.0)
            self._least_noise = np.maximum(self._least_noise, np.repeat([drift_m, 0.0], 3))
        bias = np.median(rig.biases[:, :3], axis=0)
        covariances, self._by_biases = steps.uncertainty(bias, horizon.noise)
        self._whiten = np.linalg.inv(np.linalg.cholesky(covariances))
        self._iteration, self._band = 0, np.empty((len(rig.positions), STATES, 2 * STATES))
        self._linearise()

    def solve(self, iterations: int, *, estimate_noise: bool = True) -> None:
        """Iterate until the steps and changes of the noise are small."""
        redundancy = np.ones(2)
        for number in range(iterations):
            self._iteration += 1
            calibration = -self._step_inverse @ self._gradient
            states = -self._by_gradient - self._by_calibration @ calibration
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
        self.fixed_directions += list(directions.T[values > _WIDEST_LEVER_M**2])
        if self.fixed_directions:
            self._linearise()
            self.solve(4, estimate_noise=False)

    def solve_again(self, rig: Rig, free: Booleans) -> None:
        """Solve from another rig with fewer free parameters (10,) and the same noise."""
        self.rig, self.free = rig, free
        self._band = np.empty((len(rig.positions), STATES, 2 * STATES))
        self._linearise()
        self.solve(6, estimate_noise=False)

    def summary(self) -> HorizonFit:
        """Return the calibration with the larger of two variances, and the residuals."""
        variances = np.diag(self.covariance_of_blocks), np.diag(self.covariance_of_model)
        residuals = self.rows.residuals.reshape(-1, 2, 3)
        return HorizonFit(
            self.rig.values() * UNITS,
            np.sqrt(np.maximum(*variances)) * UNITS,
            self.steps.knots[self.rows.knots] - self.samples.seconds[0],
            np.linalg.norm(residuals, axis=2),
            self.sigmas,
            tuple(self.fixed_directions),
        )

    @property
    def covariance_of_blocks(self) -> Floats:
        """Sandwich covariance (10, 10) of the calibration, from the scores of twelve blocks."""
        moved = self._by_calibration
        block = np.arange(len(moved)) * BLOCKS // len(moved)
        scores = np.zeros((BLOCKS, PARAMETERS))
        for knots, before, after, by_rig in self._rows():
            reduced = by_rig[..., :-1] - before @ moved[knots]
            if after is not None:
                reduced -= after @ moved[knots + 1]
            np.add.at(scores, block[knots], times(transposed(reduced), by_rig[..., -1]))
        scores -= scores.mean(axis=0)
        meat = scores.T @ scores * (BLOCKS / (BLOCKS - 1))
        return np.asarray(self.covariance_of_model @ meat @ self.covariance_of_model)

    def pose_covariances(self) -> Floats:
        """Return the covariances (N, 6, 6) of the knots' poses, with that of the calibration.

        Position first (m), about the axes of W, then rotation (rad), about those of I.
        """
        columns = np.r_[6:9, 0:3]
        blocks, _ = self._factor.inverse_blocks()
        after = self._by_calibration[:, columns]
        blocks = blocks[:, columns[:, None], columns]
        return np.asarray(blocks + after @ self.covariance_of_model @ transposed(after))

    def forget(self) -> None:
        """Free the memory of the linearisation, until `solve_again`."""
        del self.motions, self.predicted, self.rows, self._band, self._factor
        del self._by_calibration, self._by_gradient

    def _linearise(self) -> None:
        """Evaluate residuals and Jacobians at the rig, and factorise the normal matrix.

        `motions` are of the intervals, `rows` the measurements of the knots.
        """
        rig, horizon = self.rig, self.horizon
        self.motions = self.steps.motions(rig.biases[:-1])
        self.predicted = predict(self.samples, self.steps, self.motions, rig)
        self.rows = averaged(self.predicted, rig, self.samples)
        if horizon.window_s and self.samples.has_rotations:
            self.rows.average_rotations(rig, round(horizon.window_s / horizon.knot_s))
        self._factorise()

    def _rows(self) -> Iterator[tuple[Indices, Floats, Floats | None, Floats]]:
        """Yield parts of the whitened rows: of the intervals (n, 15), and of the samples (n, 6).

        With the knots (n,), the Jacobians by their states, those by the states of the next knots,
        and those by the calibration, whose last column has the residuals.
        """
        intervals = len(self.steps.durations_s)
        for start in range(0, intervals, AT_ONCE):
            knots = np.arange(start, min(start + AT_ONCE, intervals))
            yield knots, *self._rows_of_intervals(knots)
        for knots, by_state, by_rig in self.rows.weighted(self.sigmas):
            yield knots, by_state, None, by_rig

    def _rows_of_intervals(self, knots: Indices) -> tuple[Floats, Floats, Floats]:
        rig, others, dt = self.rig, knots + 1, self.steps.durations_s[knots, None]
        into, rotated = transposed(rig.rotations[knots]), rig.rotations[others]
        rotations, velocities, positions = (motion[knots, -1] for motion in self.motions)
        rotation = so3.log(transposed(rotations) @ into @ rotated)
        faster = rig.velocities[others] - rig.velocities[knots] - rig.gravity * dt
        start = rig.velocities[knots] * dt + 0.5 * rig.gravity * dt**2
        moved = rig.positions[others] - rig.positions[knots] - start
        faster, moved = times(into, faster), times(into, moved)
        before, after, whiten = np.zeros((3, len(dt), 15, STATES))
        by_rig = np.zeros((len(dt), 15, PARAMETERS + 1))
        back, step, by_biases = (
            so3.inverse_left_jacobian(-rotation),
            dt[..., None],
            self._by_biases,
        )
        after[:, 0:3, 0:3], after[:, 3:6, 3:6], after[:, 6:9, 6:9] = back, into, into
        before[:, 0:3, 0:3] = -back @ transposed(rotated) @ rig.rotations[knots]
        before[:, 3:6, 0:3], before[:, 6:9, 0:3] = so3.skew(faster), so3.skew(moved)
        before[:, 3:6, 3:6], before[:, 6:9, 3:6] = -into, -into * step
        before[:, 6:9, 6:9] = -into
        before[:, :9, 9:15] = -by_biases[knots]
        before[:, 0:3, 9:15] = -back @ transposed(so3.exp(rotation)) @ by_biases[knots, 0:3]
        by_rig[:, 3:6, GRAVITY] = -into @ tangents(rig.gravity) * step
        by_rig[:, 6:9, GRAVITY] = 0.5 * by_rig[:, 3:6, GRAVITY] * step
        residuals = np.concatenate([rotation, faster - velocities, moved - positions], axis=1)
        whiten[:, :9, :9] = self._whiten[knots]
        if self._iteration > 4:  # a jump of the groundtruth must not bend the chain
            squared = np.square(times(whiten[:, :9, :9], residuals)).sum(axis=1)
            weight = np.minimum(1.0, (_BROKEN / np.maximum(squared, 1e-9)) ** 0.25)
            whiten *= weight[:, None, None]
        walk = np.arange(9, 15)
        before[:, walk, walk], after[:, walk, walk] = -1.0, 1.0
        whiten[:, walk, walk] = 1.0 / (_WALK * np.sqrt(dt))
        by_rig[:, :9, -1], by_rig[:, 9:, -1] = residuals, rig.biases[others] - rig.biases[knots]
        return whiten @ before, whiten @ after, whiten @ by_rig

    def _factorise(self) -> None:
        """Assemble the normal equations, factorise them, and eliminate the states."""
        count, band = len(self.rig.positions), self._band  # the storage of the factor before
        band[:] = 0.0
        band[..., 0] = _WEAK
        # In the order of LAPACK; the last column is the gradient.
        border = np.moveaxis(np.zeros((PARAMETERS + 1, count, STATES)), 0, 2)
        corner = np.zeros((PARAMETERS, PARAMETERS + 1))
        for knots, before, after, columns in self._rows():
            touched = slice(int(knots[0]), int(knots[-1]) + 2)
            diagonal, lower = np.zeros((touched.stop - touched.start, STATES, STATES)), None
            diagonal[knots - touched.start] = transposed(before) @ before
            border[knots] += transposed(before) @ columns
            if after is not None:
                diagonal[1:] += transposed(after) @ after
                border[knots + 1] += transposed(after) @ columns
                lower = transposed(after) @ before
            add_blocks(band[touched], diagonal, lower)
            corner += np.tensordot(columns[..., :-1], columns, axes=_ROWS)
        prior = np.eye(3) / LEVER_M**2
        prior += _FIXED * sum(
            np.outer(fixed_direction, fixed_direction) for fixed_direction in self.fixed_directions
        )
        corner[LEVER, LEVER] += prior
        corner[LEVER, -1] += prior @ self.rig.lever
        band[0, 9:, 0] += _FIRST_BIAS**-2.0
        border[0, 9:, -1] += self.rig.biases[0] / _FIRST_BIAS**2
        self._factor = Factor.of_band(band)
        solved = self._factor.solve(border)
        self._by_calibration, self._by_gradient = solved[..., :-1], solved[..., -1]
        width = PARAMETERS + 1
        reduced = corner - (border.reshape(-1, width).T @ solved.reshape(-1, width))[:-1]
        self._gradient = reduced[:, -1]
        free = np.ix_(self.free, self.free)
        information = reduced[:, :-1][free]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-30))
        values, vectors = np.linalg.eigh(information * scale[:, None] * scale)
        vectors = vectors * scale[:, None]
        # An unobservable direction has a large variance and no step, a fixed parameter neither.
        stepped = np.where(values > _SINGULAR, values, np.inf)
        self.covariance_of_model, self._step_inverse = np.zeros((2, PARAMETERS, PARAMETERS))
        self.covariance_of_model[free] = (vectors / np.maximum(values, _SINGULAR)) @ vectors.T
        self._step_inverse[free] = (vectors / stepped) @ vectors.T

    def _redundancy(self) -> Floats:
        """Return the redundancies of the rows of position and of rotation, (2,)."""
        blocks, _ = self._factor.inverse_blocks()
        used = [
            ((by_state @ blocks[knots]) * by_state).sum(axis=2)
            for knots, by_state, _ in self.rows.weighted(self.sigmas)
        ]
        free = np.clip(self.rows.shares - np.concatenate(used), 0.0, 1.0)
        return np.asarray(free.reshape(-1, 2, 3).sum(axis=(0, 2)))

    def _estimate_noise(self, redundancy: Floats) -> float:
        """Scale the standard deviations, and return the largest change of their logarithms."""
        before, rows = self.sigmas, self.rows
        squares = (rows.shares * np.square(rows.residuals / before)).reshape(-1, 2, 3)
        ratio = squares.sum(axis=(0, 2)) / np.maximum(redundancy, 1.0)
        ratio = np.sqrt(np.clip(ratio, 0.09, 9.0))
        if self.horizon.window_s and self.samples.has_rotations:
            ratio[0] = 1.0
        self.sigmas = np.clip(before * np.repeat(ratio, 3), self._least_noise, _LARGEST_NOISE)
        return float(np.abs(np.log(self.sigmas / before)).max())
