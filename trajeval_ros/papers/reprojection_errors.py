"""Residuals of the camera: eq. (1), with a lever arm and a weight per observation.

Observations come last in all arrays, so that every operation runs along contiguous memory.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.papers.state import State
from trajeval_ros.papers.visibility import Visibility


@dataclass(frozen=True)
class Camera:
    """Intrinsics, noise and range. The principal point is the image's centre.

    A pixel is (r,): u and v, followed by u and v of the second camera if it is a stereo pair
    (r = 4). The second camera is translated along the first one's x axis (tutorial, eq. 3).
    """

    focal_px: float  # focal length, pixels
    width: int  # image width, pixels
    height: int  # image height, pixels
    noise_px: float = 1.0  # standard deviation of a measured coordinate, pixels
    nearest_m: float = 0.3  # least depth of visible points
    farthest_m: float = 30.0  # largest depth of visible points
    # Translation of a stereo pair's second camera; None for a single camera.
    baseline_m: float | None = None

    @property
    def centre(self) -> Floats:
        """Principal point (2,), pixels."""
        return np.array([self.width / 2.0, self.height / 2.0])

    def slopes(self, points: Floats) -> Floats:
        """Return x / z and y / z of points (..., 3), (..., c, 2) in the c cameras' frames."""
        centres = np.zeros((1 if self.baseline_m is None else 2, 2))
        centres[1:, 0] = self.baseline_m
        slopes: Floats = (points[..., None, :2] - centres) / points[..., None, 2:]
        return slopes

    def pixels(self, points: Floats) -> Floats:
        """Project points in the camera's frame, (..., 3) to (..., r)."""
        projected = self.focal_px * self.slopes(points) + self.centre
        return projected.reshape(*points.shape[:-1], -1)

    def rays(self, pixels: Floats) -> Floats:
        """Return the points (..., 3) at depth 1, in the camera's frame, of pixels (..., r)."""
        plane = (pixels[..., :2] - self.centre) / self.focal_px
        return np.concatenate([plane, np.ones((*plane.shape[:-1], 1))], axis=-1)

    def in_view(self, points: Floats) -> Booleans:
        """Whether points in the camera's frame (..., 3) are in range and in the image."""
        depth = points[..., 2]
        in_range = (depth > self.nearest_m) & (depth < self.farthest_m)
        # Points out of range are replaced by a point at depth 1, to avoid division by zero.
        slopes = self.slopes(np.where(in_range[..., None], points, 1.0))
        pixels = self.focal_px * slopes + self.centre
        inside = (pixels >= 0.0) & (pixels < [self.width, self.height])
        seen: Booleans = in_range & inside.all(axis=(-2, -1))
        return seen


class ReprojectionErrors(NamedTuple):
    """The M reprojection errors, whitened, and their Jacobians.

    d r / d landmark is `by_point`, d r / d position its negative, and d r / d rotation is
    `by_point` [d]x with d the `rays`.
    """

    residuals: Floats  # (r, M)
    by_point: Floats  # (r, 3, M)
    rays: Floats  # (3, M), from keyframe to landmark, in the world, metres


class VisualBlocks(NamedTuple):
    """J^T J and J^T r of the camera alone, by blocks."""

    lengths: Floats  # (M,), lengths of the whitened errors
    diagonal: Floats  # (N, 6, 6), position and rotation of each keyframe with itself
    # (6, 3, M), position and rotation of the observation's keyframe (rows) with its landmark
    # (columns)
    cross: Floats
    landmark: Floats  # (K, 3, 3), each landmark with itself
    motion_gradient: Floats  # (N, 6)
    landmark_gradient: Floats  # (K, 3)


class _Points(NamedTuple):
    """Landmarks as they are observed."""

    rays: Floats  # (3, M), from the body to the landmark, in the world
    to_camera: Floats  # (3, 3, M), rotation from the world to the camera
    in_camera: Floats  # (3, M), landmark in the camera


class CameraMeasurements:
    """Pixels of M observations."""

    def __init__(
        self,
        camera: Camera,
        camera_in_body: Floats,
        pixels: Floats,
        visibility: Visibility,
        lever_arm: Floats | None,
        weights: Floats | None,
    ) -> None:
        """Store the measurements (M, r), the camera's pose in the body and the weights (M, r, r).

        Without a lever arm, the camera is in the body's origin. Without weights, they are
        identities.
        """
        self._camera, self._camera_in_body, self._visibility = camera, camera_in_body, visibility
        self._pixels = np.ascontiguousarray(pixels.T)
        self._weights = (
            None if weights is None else np.ascontiguousarray(weights.transpose(1, 2, 0))
        )
        # The lever arm in the camera's axes.
        self._offset = np.zeros(3) if lever_arm is None else camera_in_body.T @ lever_arm

    def residuals(self, state: State) -> Floats:
        """Return the whitened errors (r, M)."""
        return self._whitened(self._points(state).in_camera)

    def linearised(self, state: State) -> ReprojectionErrors:
        """Return the whitened errors with their Jacobians."""
        rays, to_camera, points = self._points(state)
        scale = self._camera.focal_px / self._camera.noise_px / points[2]
        # f [[1/z, 0, -x/z^2], [0, 1/z, -y/z^2]] times the rotation into the camera.
        slopes = np.moveaxis(self._camera.slopes(points.T), 0, -1)
        by_camera = scale * (to_camera[:2] - slopes[:, :, None] * to_camera[2])
        by_point = by_camera.reshape(-1, 3, by_camera.shape[-1])
        if self._weights is not None:
            by_point = np.einsum("qrm,rim->qim", self._weights, by_point)
        return ReprojectionErrors(self._whitened(points), by_point, rays)

    def normal_blocks(self, state: State) -> VisualBlocks:
        """Return J^T J and J^T r, with all rotations perturbed on the left."""
        residuals, by_point, rays = self.linearised(state)
        by_keyframe, by_landmark = self._visibility.by_keyframe, self._visibility.by_landmark
        # With E = [-I, [d]x], the Jacobian by the keyframe is by_point E: all blocks follow from
        # G = by_point^T by_point, and products with [d]x are cross products.
        square = np.einsum("rim,rjm->ijm", by_point, by_point)
        pull = np.einsum("rim,rm->im", by_point, residuals)
        cross = np.empty((6, 3, rays.shape[-1]))
        np.negative(square, out=cross[:3])
        _cross(square, rays[:, None], out=cross[3:])
        turning = _cross(cross[3:].swapaxes(0, 1), rays[:, None], out=np.empty_like(square))
        summed = np.moveaxis(by_keyframe(cross), -1, 0)
        diagonal = np.empty((len(summed), 6, 6))
        diagonal[:, :, :3] = -summed
        diagonal[:, :3, 3:] = -summed[:, 3:].swapaxes(1, 2)
        diagonal[:, 3:, 3:] = np.moveaxis(by_keyframe(turning), -1, 0)
        push = np.concatenate([-pull, _cross(pull, rays, out=np.empty_like(pull))])
        return VisualBlocks(
            lengths=np.sqrt(np.einsum("rm,rm->m", residuals, residuals)),
            diagonal=diagonal,
            cross=cross,
            landmark=np.moveaxis(by_landmark(square), -1, 0),
            motion_gradient=by_keyframe(push).T,
            landmark_gradient=by_landmark(pull).T,
        )

    def points(self, state: State) -> Floats:
        """Return the observed landmarks (3, M) in the camera at its keyframe, metres."""
        return self._points(state).in_camera

    def _points(self, state: State) -> _Points:
        # The derivatives of the landmarks in the camera only depend on the rays, not on the lever
        # arm.
        keyframe_of, landmark_of = self._visibility.keyframe_of, self._visibility.landmark_of
        rays = state.landmarks.T.take(landmark_of, axis=-1)
        rays -= state.positions.T.take(keyframe_of, axis=-1)
        cameras = (state.rotations @ self._camera_in_body).transpose(2, 1, 0)
        to_camera = cameras.take(keyframe_of, axis=-1)
        points = np.einsum("ijm,jm->im", to_camera, rays) - self._offset[:, None]
        return _Points(rays, to_camera, points)

    def _whitened(self, points: Floats) -> Floats:
        errors: Floats = (self._camera.pixels(points.T).T - self._pixels) / self._camera.noise_px
        if self._weights is not None:
            errors = np.einsum("qrm,rm->qm", self._weights, errors)
        return errors


def _cross(left: Floats, right: Floats, out: Floats) -> Floats:
    """Return the cross products along the first axis in `out`, in a third of numpy's time."""
    a, b, c = left
    x, y, z = right
    out[0] = b * z - c * y
    out[1] = c * x - a * z
    out[2] = a * y - b * x
    return out
