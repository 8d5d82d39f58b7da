"""Residuals of the IMU between keyframes, and of the biases if they are estimated: eq. (1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.preintegration import Preintegrated
from trajeval_ros.visual_inertial.state import MOTION_WIDTH, State


@dataclass(frozen=True)
class BiasNoise:
    """Prior of an IMU's biases."""

    gyroscope: float  # standard deviation at the first keyframe, rad/s
    accelerometer: float  # the same, m/s^2
    gyroscope_walk: float  # density of the random walk, rad/s^2/sqrt(Hz)
    accelerometer_walk: float  # the same, m/s^3/sqrt(Hz)

    @property
    def at_first(self) -> Floats:
        """Standard deviations (6,) at the first keyframe."""
        return np.repeat([self.gyroscope, self.accelerometer], 3)

    def between(self, durations_s: Floats) -> Floats:
        """Return the standard deviations (I, 6) of the changes over intervals (I,)."""
        walk = np.repeat([self.gyroscope_walk, self.accelerometer_walk], 3)
        return walk * np.sqrt(durations_s)[:, None]


class InertialErrors(NamedTuple):
    """The N - 1 errors between keyframes, whitened, and their Jacobians.

    Rows are rotation, velocity, position and the b = 6 changes of the biases; b is 0 where biases
    are known. Columns are those of `State.moved`: position, rotation, velocity, biases.
    """

    residuals: Floats  # (N - 1, 9 + b)
    by_before: Floats  # (N - 1, 9 + b, 9 + b), by the earlier keyframe
    by_after: Floats  # (N - 1, 9 + b, 9 + b), by the later one


class _Terms(NamedTuple):
    """Errors (N - 1, 9 + b) before whitening, and intermediate results for their Jacobians."""

    errors: Floats
    turn: Floats
    speed: Floats
    shift: Floats
    bias_turn: Floats


class InertialMeasurements:
    """The IMU's measurements between keyframes, and the prior of its biases."""

    def __init__(
        self, preintegrated: Preintegrated, gravity: Floats, bias_noise: BiasNoise | None
    ) -> None:
        """Store the measurements; without `bias_noise`, known biases are already subtracted."""
        self.preintegrated, self.gravity = preintegrated, gravity
        biases = 0 if bias_noise is None else 6
        self.width = MOTION_WIDTH + biases
        self._by_biases = preintegrated.by_biases[:, :, :biases]
        intervals = len(preintegrated.durations_s)
        self._whiten = np.zeros((intervals, self.width, self.width))
        self._whiten[:, :MOTION_WIDTH, :MOTION_WIDTH] = np.linalg.inv(
            np.linalg.cholesky(preintegrated.covariances)
        )
        # 1 / standard deviation of the first biases (b,).
        self.first_bias_weights = np.zeros(0)
        if bias_noise is not None:
            self.first_bias_weights = 1.0 / bias_noise.at_first
            places = np.arange(MOTION_WIDTH, self.width)
            self._whiten[:, places, places] = 1.0 / bias_noise.between(preintegrated.durations_s)

    def residuals(self, state: State) -> Floats:
        """Return the whitened errors (N - 1, 9 + b)."""
        return self._whitened(self._terms(state))

    def first_bias_errors(self, state: State) -> Floats:
        """Return the whitened first biases (b,)."""
        errors: Floats = self.first_bias_weights * state.biases[0]
        return errors

    def linearised(self, state: State) -> InertialErrors:
        """Return the whitened errors with their Jacobians."""
        terms = self._terms(state)
        _, turn, speed, shift, bias_turn = terms
        into = np.swapaxes(state.rotations[:-1], 1, 2)
        durations = self.preintegrated.durations_s[:, None, None]
        before, after = np.zeros((2, len(turn), self.width, self.width))
        back = so3.inverse_left_jacobian(-turn)
        after[:, 0:3, 3:6] = back @ np.swapaxes(state.rotations[1:], 1, 2)
        before[:, 0:3, 3:6] = -after[:, 0:3, 3:6]
        before[:, 3:6, 3:6] = into @ so3.skew(speed)
        before[:, 3:6, 6:9], after[:, 3:6, 6:9] = -into, into
        before[:, 6:9, 3:6] = into @ so3.skew(shift)
        before[:, 6:9, 0:3], after[:, 6:9, 0:3] = -into, into
        before[:, 6:9, 6:9] = -into * durations
        # The first rotation is Exp(Dphi) R_ref: d phi = J_l(Dphi) d Dphi.
        before[0, :, 3:6] = before[0, :, 3:6] @ so3.left_jacobian(state.first_turn)
        if self.width > MOTION_WIDTH:
            # turn = log(Exp(-a) R^T R_i^T R_j) with a = J b.
            before[:, 0:3, 9:] = (
                -so3.inverse_left_jacobian(turn)
                @ so3.left_jacobian(-bias_turn)
                @ self._by_biases[:, 0:3]
            )
            before[:, 3:9, 9:] = -self._by_biases[:, 3:9]
            changes = np.arange(MOTION_WIDTH, self.width)
            before[:, changes, changes], after[:, changes, changes] = -1.0, 1.0
        return InertialErrors(self._whitened(terms), self._whiten @ before, self._whiten @ after)

    def _terms(self, state: State) -> _Terms:
        measured = self.preintegrated
        durations = measured.durations_s[:, None]
        by_biases = np.einsum("nij,nj->ni", self._by_biases, state.biases[:-1])
        fall = self.gravity * durations
        speed = np.diff(state.velocities, axis=0) - fall
        shift = np.diff(state.positions, axis=0) - (state.velocities[:-1] + fall / 2.0) * durations
        into = np.swapaxes(state.rotations[:-1], 1, 2)
        turned = measured.rotations
        if self.width > MOTION_WIDTH:
            turned = turned @ so3.exp(by_biases[:, 0:3])
        turn = so3.log(np.swapaxes(turned, 1, 2) @ into @ state.rotations[1:])
        errors = np.concatenate(
            [
                turn,
                np.einsum("nij,nj->ni", into, speed) - measured.velocities - by_biases[:, 3:6],
                np.einsum("nij,nj->ni", into, shift) - measured.positions - by_biases[:, 6:9],
                np.diff(state.biases, axis=0),
            ],
            axis=1,
        )
        return _Terms(errors, turn, speed, shift, by_biases[:, 0:3])

    def _whitened(self, terms: _Terms) -> Floats:
        whitened: Floats = np.einsum("nij,nj->ni", self._whiten, terms.errors)
        return whitened
