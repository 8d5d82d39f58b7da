"""Residuals of the IMU between keyframes: eq. (1)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.preintegration import Preintegrated
from trajeval_ros.papers.state import MOTION_WIDTH, State


class InertialErrors(NamedTuple):
    """The N - 1 errors between keyframes, whitened, and their Jacobians.

    Rows are rotation, velocity and position. Columns are those of `State.moved`: position,
    rotation, velocity.
    """

    residuals: Floats  # (N - 1, 9)
    by_before: Floats  # (N - 1, 9, 9), by the earlier keyframe
    by_after: Floats  # (N - 1, 9, 9), by the later one


class _Terms(NamedTuple):
    """Errors (N - 1, 9) before whitening, and intermediate results for their Jacobians."""

    errors: Floats
    turn: Floats
    speed: Floats
    shift: Floats


class InertialMeasurements:
    """The IMU's measurements between keyframes."""

    def __init__(self, preintegrated: Preintegrated, gravity: Floats) -> None:
        """Store the measurements."""
        self.preintegrated, self.gravity = preintegrated, gravity
        self._whiten = np.linalg.inv(np.linalg.cholesky(preintegrated.covariances))

    def residuals(self, state: State) -> Floats:
        """Return the whitened errors (N - 1, 9)."""
        return self._whitened(self._terms(state))

    def linearised(self, state: State) -> InertialErrors:
        """Return the whitened errors with their Jacobians."""
        terms = self._terms(state)
        _, rotation, speed, shift = terms
        into = np.swapaxes(state.rotations[:-1], 1, 2)
        durations = self.preintegrated.durations_s[:, None, None]
        before, after = np.zeros((2, len(rotation), MOTION_WIDTH, MOTION_WIDTH))
        back = so3.inverse_left_jacobian(-rotation)
        after[:, 0:3, 3:6] = back @ np.swapaxes(state.rotations[1:], 1, 2)
        before[:, 0:3, 3:6] = -after[:, 0:3, 3:6]
        before[:, 3:6, 3:6] = into @ so3.skew(speed)
        before[:, 3:6, 6:9], after[:, 3:6, 6:9] = -into, into
        before[:, 6:9, 3:6] = into @ so3.skew(shift)
        before[:, 6:9, 0:3], after[:, 6:9, 0:3] = -into, into
        before[:, 6:9, 6:9] = -into * durations
        # The first rotation is Exp(Dphi) R_ref: d phi = J_l(Dphi) d Dphi.
        before[0, :, 3:6] = before[0, :, 3:6] @ so3.left_jacobian(state.first_turn)
        return InertialErrors(self._whitened(terms), self._whiten @ before, self._whiten @ after)

    def _terms(self, state: State) -> _Terms:
        measured = self.preintegrated
        durations = measured.durations_s[:, None]
        fall = self.gravity * durations
        speed = np.diff(state.velocities, axis=0) - fall
        shift = np.diff(state.positions, axis=0) - (state.velocities[:-1] + fall / 2.0) * durations
        into = np.swapaxes(state.rotations[:-1], 1, 2)
        rotation = so3.log(np.swapaxes(measured.rotations, 1, 2) @ into @ state.rotations[1:])
        errors = np.concatenate(
            [
                rotation,
                np.einsum("nij,nj->ni", into, speed) - measured.velocities,
                np.einsum("nij,nj->ni", into, shift) - measured.positions,
            ],
            axis=1,
        )
        return _Terms(errors, rotation, speed, shift)

    def _whitened(self, terms: _Terms) -> Floats:
        whitened: Floats = np.einsum("nij,nj->ni", self._whiten, terms.errors)
        return whitened
