"""Residuals of IMU and camera with their Jacobians, and the normal equations: eq. (1).

All residuals are whitened, so the cost is half their squared length. Perturbations are on the
left, in the world, but for the first rotation, eq. (9).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.inertial import GRAVITY, Preintegrated
from trajeval_ros.papers.reprojection_errors import Camera, CameraMeasurements, ReprojectionErrors
from trajeval_ros.papers.state import MOTION_WIDTH, State
from trajeval_ros.papers.visibility import Visibility


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


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """J^T J and J^T r by blocks, for N keyframes, K landmarks and M observations."""

    cost: float  # half the squared length of all residuals
    reprojection_px: float  # mean length of the reprojection errors, pixels
    diagonal: Floats  # (N, 9, 9), each keyframe with itself
    coupling: Floats  # (N - 1, 9, 9), each keyframe (rows) with the next one (columns)
    # (6, 3, M), position and rotation of the observation's keyframe (rows) with its landmark
    # (columns)
    cross: Floats
    landmark: Floats  # (K, 3, 3), each landmark with itself
    motion_gradient: Floats  # (N, 9)
    landmark_gradient: Floats  # (K, 3)
    visibility: Visibility  # keyframes and landmarks of the observations


class Problem:
    """Measurements of N keyframes and K landmarks, to be explained by a `State`."""

    def __init__(
        self,
        camera: Camera,
        camera_in_body: Floats,
        pixels: Floats,
        keyframe_of: Indices,
        landmark_of: Indices,
        landmarks: int,
        preintegrated: Preintegrated,
        *,
        lever_arm: Floats | None = None,
        weights: Floats | None = None,
        gravity: Floats = GRAVITY,
    ) -> None:
        """Store the measurements: pixels (M, r) of K landmarks, and N - 1 intervals of the IMU.

        The observations have keyframes (M,) and landmarks (M,). The camera is at the body's origin
        without a lever arm (3,), metres. The weights (M, r, r) are factors of the reprojection
        errors before their division by the camera's noise, identities by default. Gravity (3,) is
        along the world's z axis, m/s^2. Known biases are already subtracted from the samples.
        """
        if not len(pixels) or not len(preintegrated.durations_s):
            raise InputError(
                f"too few observations ({len(pixels)}) from {len(preintegrated.durations_s) + 1} "
                "keyframes; select more keyframes or more tracks"
            )
        self.camera, self.camera_in_body, self.pixels = camera, camera_in_body, pixels
        self.keyframes, self.landmarks = len(preintegrated.durations_s) + 1, landmarks
        self._between = InertialMeasurements(preintegrated, gravity)
        self.preintegrated = preintegrated
        self.gravity = gravity
        self.visibility = Visibility(keyframe_of, landmark_of, self.keyframes, landmarks)
        self._images = CameraMeasurements(
            camera, camera_in_body, pixels, self.visibility, lever_arm, weights
        )

    def residuals(self, state: State) -> tuple[Floats, Floats]:
        """Return the whitened errors of camera (M, r) and between keyframes (N - 1, 9)."""
        return self._images.residuals(state).T, self._between.residuals(state)

    def cost(self, state: State) -> float:
        """Return half the squared length of all residuals, eq. (1)."""
        parts = self._images.residuals(state), self._between.residuals(state)
        return 0.5 * sum(float(np.vdot(errors, errors)) for errors in parts)

    def visual(self, state: State) -> ReprojectionErrors:
        """Return the reprojection errors with their Jacobians."""
        return self._images.linearised(state)

    def inertial(self, state: State) -> InertialErrors:
        """Return the errors between keyframes with their Jacobians."""
        return self._between.linearised(state)

    def normal_equations(self, state: State) -> NormalEquations:
        """Return J^T J and J^T r, all blocks at once."""
        count = self.keyframes
        visual = self._images.normal_blocks(state)
        first = so3.left_jacobian(state.first_turn)
        at_first = self.visibility.keyframe_of == 0
        rotated = visual.cross[3:, :, at_first]
        visual.cross[3:, :, at_first] = np.einsum("ij,ikm->jkm", first, rotated)
        visual.diagonal[0, 3:] = first.T @ visual.diagonal[0, 3:]
        visual.diagonal[0, :, 3:] = visual.diagonal[0, :, 3:] @ first
        visual.motion_gradient[0, 3:] = first.T @ visual.motion_gradient[0, 3:]

        errors, before, after = self.inertial(state)
        before_t, after_t = np.swapaxes(before, 1, 2), np.swapaxes(after, 1, 2)
        diagonal = np.zeros((count, MOTION_WIDTH, MOTION_WIDTH))
        gradient = np.zeros((count, MOTION_WIDTH))
        diagonal[:, :6, :6] = visual.diagonal
        diagonal[:-1] += before_t @ before
        diagonal[1:] += after_t @ after
        gradient[:, :6] = visual.motion_gradient
        gradient[:-1] += np.einsum("nij,ni->nj", before, errors)
        gradient[1:] += np.einsum("nij,ni->nj", after, errors)
        lengths = visual.lengths
        return NormalEquations(
            cost=0.5 * float(lengths @ lengths + np.vdot(errors, errors)),
            reprojection_px=float(lengths.mean()) * self.camera.noise_px,
            diagonal=diagonal,
            coupling=before_t @ after,
            cross=visual.cross,
            landmark=visual.landmark,
            motion_gradient=gradient,
            landmark_gradient=visual.landmark_gradient,
            visibility=self.visibility,
        )

    def points(self, state: State) -> Floats:
        """Return the observed landmarks (M, 3) in the camera at its keyframe, metres."""
        return self._images.points(state).T
