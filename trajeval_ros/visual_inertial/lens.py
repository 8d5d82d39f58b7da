"""Lens distortion with its derivative, and its inverse by Newton's method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry.arrays import Floats

Distort = Callable[[Floats, Floats], tuple[Floats, Floats]]

_STEPS = 30
_TOLERANCE_PX = 1e-6


def _radial_tangential(coefficients: Floats, plane: Floats) -> tuple[Floats, Floats]:
    k1, k2, p1, p2 = coefficients
    x, y = plane[:, 0], plane[:, 1]
    square = x * x + y * y
    radial = 1.0 + (k1 + k2 * square) * square
    growth = 2.0 * (k1 + 2.0 * k2 * square)
    points = np.stack(
        [
            x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x),
            y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y,
        ],
        axis=1,
    )
    derivative = np.empty((len(plane), 2, 2))
    derivative[:, 0, 0] = radial + growth * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    derivative[:, 0, 1] = derivative[:, 1, 0] = growth * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    derivative[:, 1, 1] = radial + growth * y * y + 6.0 * p1 * y + 2.0 * p2 * x
    return points, derivative


def _equidistant(coefficients: Floats, plane: Floats) -> tuple[Floats, Floats]:
    radius = np.maximum(np.linalg.norm(plane, axis=1), 1e-9)
    angle = np.arctan(radius)
    powers = angle[:, None] ** (2 * np.arange(1, 5))
    bent = angle * (1.0 + powers @ coefficients)
    slope = (1.0 + powers @ (coefficients * [3.0, 5.0, 7.0, 9.0])) / (1.0 + radius**2)
    scale, outwards = bent / radius, plane / radius[:, None]
    derivative = scale[:, None, None] * np.eye(2)
    derivative += (slope - scale)[:, None, None] * outwards[:, :, None] * outwards[:, None, :]
    return scale[:, None] * plane, derivative


# Both have four coefficients: k1, k2, p1, p2 (OpenCV's plumb bob), and k1 to k4 of the polynomial
# in the angle by Kannala and Brandt (OpenCV's fisheye).
DISTORTIONS: dict[str, Distort] = {
    "radial-tangential": _radial_tangential,
    "equidistant": _equidistant,
}


@dataclass(frozen=True, eq=False)
class Lens:
    """Intrinsics and distortion: the map from the plane at depth 1 to the image.

    Attributes:
        focal_px: (2,) horizontal and vertical focal lengths.
        centre_px: (2,) principal point.
        distortion: A name of `DISTORTIONS`.
        coefficients: (4,) of the distortion.
    """

    focal_px: Floats
    centre_px: Floats
    distortion: str
    coefficients: Floats

    def distorted(self, plane: Floats) -> tuple[Floats, Floats]:
        """Return the pixels of points (n, 2) on the plane, and their derivative (n, 2, 2)."""
        points, derivative = DISTORTIONS[self.distortion](self.coefficients, plane)
        return points * self.focal_px + self.centre_px, derivative * self.focal_px[:, None]

    def undistorted(self, pixels: Floats) -> tuple[Floats, Floats]:
        """Return points (n, 2) on the plane, and d pixel / d point (n, 2, 2) there.

        Points are NaN if Newton's method, from the undistorted guess, finds no point with this
        pixel: outside the range in which the model is invertible.
        """
        plane = (pixels - self.centre_px) / self.focal_px
        with np.errstate(all="ignore"):
            for _ in range(_STEPS):
                guess, derivative = self.distorted(plane)
                plane = plane + _solved(derivative, pixels - guess)
            guess, derivative = self.distorted(plane)
            back = np.abs(guess - pixels).max(axis=1) <= _TOLERANCE_PX
            plane[~(back & (np.linalg.det(derivative) > 0.0))] = np.nan
        return plane, derivative


def _solved(matrices: Floats, vectors: Floats) -> Floats:
    """Return the solutions (n, 2); not finite where a matrix is singular."""
    (a, b), (c, d) = matrices.transpose(1, 2, 0)
    x, y = vectors.T
    solution: Floats = np.stack([d * x - b * y, a * y - c * x], axis=1) / (a * d - b * c)[:, None]
    return solution
