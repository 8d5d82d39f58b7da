"""Residuals of camera and IMU with their Jacobians, and the normal equations: eq. (1).

All residuals are whitened, so the cost is half their squared length. Perturbations are on the
left, in the world, but for the first rotation, eq. (9).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.visual_inertial.camera import Camera
from trajeval_ros.visual_inertial.inertial_errors import (
    BiasNoise,
    InertialErrors,
    InertialMeasurements,
)
from trajeval_ros.visual_inertial.preintegration import GRAVITY, Preintegrated
from trajeval_ros.visual_inertial.state import MOTION_WIDTH, State


class ReprojectionErrors(NamedTuple):
    """The M reprojection errors and their Jacobians.

    d r / d landmark is `by_point`, d r / d position its negative, and d r / d rotation is
    `by_point` [d]x with d the `rays`.

    Attributes:
        residuals: (M, r).
        by_point: (M, r, 3).
        rays: (M, 3), from keyframe to landmark, in the world, metres.
    """

    residuals: Floats
    by_point: Floats
    rays: Floats


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """J^T J and J^T r by blocks, for N keyframes, K landmarks and M observations.

    A keyframe has w parameters: 9, or 15 with biases (`State.moved`).

    Attributes:
        cost: Half the squared length of all residuals.
        reprojection_px: Mean length of the reprojection errors, pixels.
        diagonal: (N, w, w), each keyframe with itself.
        coupling: (N - 1, w, w), each keyframe (rows) with the next one (columns).
        cross: (M, 6, 3), position and rotation of the observation's keyframe (rows) with its
            landmark (columns).
        landmark: (K, 3, 3), each landmark with itself.
        motion_gradient: (N, w).
        landmark_gradient: (K, 3).
        keyframe_of: (M,).
        landmark_of: (M,).
    """

    cost: float
    reprojection_px: float
    diagonal: Floats
    coupling: Floats
    cross: Floats
    landmark: Floats
    motion_gradient: Floats
    landmark_gradient: Floats
    keyframe_of: Indices
    landmark_of: Indices


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
        bias_noise: BiasNoise | None = None,
    ) -> None:
        """Store the measurements.

        Args:
            camera: Intrinsics and noise.
            camera_in_body: (3, 3) rotation.
            pixels: (M, r) measured.
            keyframe_of: (M,), keyframes of the observations.
            landmark_of: (M,), landmarks of the observations.
            landmarks: Number of landmarks K.
            preintegrated: N - 1 intervals between keyframes.
            lever_arm: (3,) the camera's centre in the body, metres; None for the body's origin.
            weights: (M, r, r), factors of the reprojection errors before their division by the
                camera's noise; None for identities.
            gravity: (3,) in the world, along z, m/s^2.
            bias_noise: Prior, to estimate biases at all keyframes; None if they are known.

        Raises:
            InputError: No observations, or observations of one keyframe only.
        """
        if not len(pixels) or not len(preintegrated.durations_s):
            raise InputError(
                f"too few observations ({len(pixels)}) from {len(preintegrated.durations_s) + 1} "
                "keyframes; select more keyframes or more tracks"
            )
        self.camera, self.camera_in_body, self.pixels = camera, camera_in_body, pixels
        self.keyframe_of, self.landmark_of = keyframe_of, landmark_of
        self.keyframes, self.landmarks = len(preintegrated.durations_s) + 1, landmarks
        self._between = InertialMeasurements(preintegrated, gravity, bias_noise)
        # Parameters of a keyframe.
        self.width = self._between.width
        self.preintegrated = preintegrated
        self.weights, self.gravity = weights, gravity
        # The lever arm in the camera's axes.
        self._offset = np.zeros(3) if lever_arm is None else camera_in_body.T @ lever_arm
        self.longest_track = _longest_track(keyframe_of, landmark_of, landmarks)
        # Products with these sum over the observations of a keyframe, and of a landmark.
        self._of_keyframe = _indicator(keyframe_of, self.keyframes)
        self._of_landmark = _indicator(landmark_of, landmarks)

    def residuals(self, state: State) -> tuple[Floats, Floats]:
        """Return the whitened errors of camera (M, r) and between keyframes (N - 1, w)."""
        _, points = self._points(state)
        return self._reprojection(points), self._between.residuals(state)

    def first_biases(self, state: State) -> tuple[Floats, Floats]:
        """Return the whitened errors of the first biases and their derivative, (w - 9,)."""
        return self._between.first_bias_errors(state), self._between.first_bias_weights

    def cost(self, state: State) -> float:
        """Return half the squared length of all residuals, eq. (1)."""
        return 0.5 * sum(
            float(np.vdot(errors, errors))
            for errors in (*self.residuals(state), self.first_biases(state)[0])
        )

    def visual(self, state: State) -> ReprojectionErrors:
        """Return the reprojection errors with their Jacobians."""
        rays, points = self._points(state)
        to_camera = np.swapaxes(state.rotations @ self.camera_in_body, 1, 2)
        scale = self.camera.focal_px / self.camera.noise_px / points[:, 2]
        # f [[1/z, 0, -x/z^2], [0, 1/z, -y/z^2]] times the rotation into the camera.
        turned = to_camera[self.keyframe_of]
        slopes = self.camera.slopes(points)[..., None]
        by_camera = scale[:, None, None, None] * (
            turned[:, None, :2] - slopes * turned[:, None, None, 2]
        )
        by_point = by_camera.reshape(len(points), -1, 3)
        if self.weights is not None:
            by_point = self.weights @ by_point
        return ReprojectionErrors(self._reprojection(points), by_point, rays)

    def inertial(self, state: State) -> InertialErrors:
        """Return the errors between keyframes with their Jacobians."""
        return self._between.linearised(state)

    def normal_equations(self, state: State) -> NormalEquations:
        """Return J^T J and J^T r, all blocks at once."""
        count = self.keyframes
        residuals, by_point, rays = self.visual(state)
        # With E = [-I, [d]x], the Jacobian by the keyframe is by_point E: all blocks follow from
        # G = by_point^T by_point, and products with [d]x are cross products.
        square = np.swapaxes(by_point, 1, 2) @ by_point
        pull = np.einsum("mij,mi->mj", by_point, residuals)
        cross = np.empty((len(rays), 6, 3))
        np.negative(square, out=cross[:, :3])
        cross[:, 3:] = -_cross(rays[:, None, :], square).swapaxes(1, 2)
        turning = -_cross(rays[:, None, :], cross[:, 3:])
        summed = (self._of_keyframe @ cross.reshape(-1, 18)).reshape(-1, 6, 3)
        visual_diagonal = np.empty((count, 6, 6))
        visual_diagonal[:, :, :3] = -summed
        visual_diagonal[:, :3, 3:] = -summed[:, 3:].swapaxes(1, 2)
        visual_diagonal[:, 3:, 3:] = (self._of_keyframe @ turning.reshape(-1, 9)).reshape(-1, 3, 3)
        push = np.concatenate([-pull, -_cross(rays, pull)], axis=1)
        visual_gradient = self._of_keyframe @ push

        first = so3.left_jacobian(state.first_turn)
        at_first = self.keyframe_of == 0
        cross[at_first, 3:] = first.T @ cross[at_first, 3:]
        visual_diagonal[0, 3:] = first.T @ visual_diagonal[0, 3:]
        visual_diagonal[0, :, 3:] = visual_diagonal[0, :, 3:] @ first
        visual_gradient[0, 3:] = first.T @ visual_gradient[0, 3:]

        errors, before, after = self.inertial(state)
        before_t, after_t = np.swapaxes(before, 1, 2), np.swapaxes(after, 1, 2)
        first_errors, first_weights = self.first_biases(state)
        diagonal = np.zeros((count, self.width, self.width))
        gradient = np.zeros((count, self.width))
        diagonal[:, :6, :6] = visual_diagonal
        diagonal[:-1] += before_t @ before
        diagonal[1:] += after_t @ after
        gradient[:, :6] = visual_gradient
        gradient[:-1] += np.einsum("nij,ni->nj", before, errors)
        gradient[1:] += np.einsum("nij,ni->nj", after, errors)
        biases = np.arange(MOTION_WIDTH, self.width)
        diagonal[0, biases, biases] += np.square(first_weights)
        gradient[0, biases] += first_weights * first_errors
        lengths = np.sqrt(np.einsum("mi,mi->m", residuals, residuals))
        return NormalEquations(
            cost=0.5
            * float(lengths @ lengths + np.vdot(errors, errors) + first_errors @ first_errors),
            reprojection_px=float(lengths.mean()) * self.camera.noise_px,
            diagonal=diagonal,
            coupling=before_t @ after,
            cross=cross,
            landmark=(self._of_landmark @ square.reshape(-1, 9)).reshape(-1, 3, 3),
            motion_gradient=gradient,
            landmark_gradient=self._of_landmark @ pull,
            keyframe_of=self.keyframe_of,
            landmark_of=self.landmark_of,
        )

    def points(self, state: State) -> Floats:
        """Return the observed landmarks (M, 3) in the camera at its keyframe, metres."""
        return self._points(state)[1]

    def _points(self, state: State) -> tuple[Floats, Floats]:
        """Return the rays from body to landmark in the world, and the landmarks in the camera.

        The derivatives of the landmarks in the camera only depend on the rays, not on the lever
        arm.
        """
        rays = state.landmarks[self.landmark_of] - state.positions[self.keyframe_of]
        cameras = (state.rotations @ self.camera_in_body)[self.keyframe_of]
        return rays, np.einsum("mji,mj->mi", cameras, rays) - self._offset

    def _reprojection(self, points: Floats) -> Floats:
        errors: Floats = (self.camera.pixels(points) - self.pixels) / self.camera.noise_px
        return errors if self.weights is None else np.einsum("mij,mj->mi", self.weights, errors)


def _longest_track(keyframe_of: Indices, landmark_of: Indices, landmarks: int) -> int:
    """Return the largest number of keyframes from a landmark's first to its last; at least 2."""
    first, last = np.full(landmarks, np.iinfo(np.int64).max), np.zeros(landmarks, dtype=np.int64)
    np.minimum.at(first, landmark_of, keyframe_of)
    np.maximum.at(last, landmark_of, keyframe_of)
    return max(int((last - first).max()) + 1, 2)


def _indicator(group_of: Indices, groups: int) -> scipy.sparse.csr_matrix:
    count = len(group_of)
    return scipy.sparse.csr_matrix(
        (np.ones(count), (group_of, np.arange(count))), shape=(groups, count)
    )


def _cross(left: Floats, right: Floats) -> Floats:
    """Return the cross products along the last axis, in a third of numpy's time."""
    a, b, c = left[..., 0], left[..., 1], left[..., 2]
    x, y, z = right[..., 0], right[..., 1], right[..., 2]
    product = np.empty(np.broadcast_shapes(left.shape, right.shape))
    product[..., 0] = b * z - c * y
    product[..., 1] = c * x - a * z
    product[..., 2] = a * y - b * x
    return product
