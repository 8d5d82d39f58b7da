"""Projection and field of view of a pinhole camera or a stereo pair."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats


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
