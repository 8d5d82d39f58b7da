"""A recording of feature tracks and an IMU, with groundtruth and the camera's lens distortion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Floats, Indices, Stamps
from trajeval_ros.geometry.trajectory import Trajectory

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
    """Intrinsics and distortion: the map from the plane at depth 1 to the image."""

    focal_px: Floats  # (2,) horizontal and vertical focal lengths
    centre_px: Floats  # (2,) principal point
    distortion: str  # a name of `DISTORTIONS`
    coefficients: Floats  # (4,) of the distortion

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


# Timestamps that were stored as doubles (seconds) differ by up to 256 ns.
SAME_INSTANT_NS = 1000


@dataclass(frozen=True, eq=False)
class CalibratedCamera:
    """A camera on a body."""

    lens: Lens  # intrinsics and distortion
    width: int  # image width, pixels
    height: int  # image height, pixels
    rotation: Floats  # (3, 3), camera to body
    lever_arm: Floats  # (3,), the camera's centre in the body, metres


@dataclass(frozen=True, eq=False)
class SensorRecording:
    """Measurements of camera and IMU; the IMU's frame is the body's."""

    name: str  # name in outputs
    camera: CalibratedCamera  # intrinsics and extrinsics
    imu_stamps: Stamps  # (S,) nanoseconds, rising
    angular_velocities: Floats  # (S, 3), rad/s, in the body
    accelerations: Floats  # (S, 3), specific force, m/s^2, in the body
    image_stamps: Stamps  # (F,) nanoseconds, rising
    image_of: Indices  # (O,), images of the observations
    track_of: Indices  # (O,), track names of the observations; a track is at most once in an image
    pixels: Floats  # (O, 2), distorted as in the image
    groundtruth: Trajectory  # poses of the body with velocities and, where they are known, biases
    notes: tuple[str, ...]  # sentences that state what the reader joined or inserted


def one_instant_each(stamps: Stamps) -> tuple[Stamps, Indices]:
    """Return distinct instants (F,) of timestamps (O,) in any order, and indices (O,) to them."""
    distinct, place = np.unique(stamps, return_inverse=True)
    begins = np.diff(distinct, prepend=distinct[0] - SAME_INSTANT_NS - 1) > SAME_INSTANT_NS
    return distinct[begins], np.cumsum(begins)[place] - 1


def at_instants(stamps: Stamps, instants: Stamps, what: str) -> Indices:
    """Return the indices (N,) of the timestamps (S,), increasing, at the instants (N,)."""
    after = np.clip(np.searchsorted(stamps, instants), 1, len(stamps) - 1)
    is_before = instants - stamps[after - 1] <= stamps[after] - instants
    nearest = np.where(is_before, after - 1, after)
    away = np.abs(stamps[nearest] - instants)
    if away.max() > SAME_INSTANT_NS:
        worst = int(away.argmax())
        raise InputError(
            f"{int(np.count_nonzero(away > SAME_INSTANT_NS))} of {len(instants)} keyframes have "
            f"no {what}: at {instants[worst]} ns the nearest is {away[worst] / 1e6:.3g} ms "
            f"away; give {what} for every image, within 1 us"
        )
    return nearest
