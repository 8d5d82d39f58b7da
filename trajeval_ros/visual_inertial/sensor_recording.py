"""A recording of a camera's feature tracks and an IMU, with groundtruth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Floats, Indices, Stamps
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.visual_inertial.lens import Lens

# Timestamps that were stored as doubles (seconds) differ by up to 256 ns.
SAME_INSTANT_NS = 1000


@dataclass(frozen=True, eq=False)
class CalibratedCamera:
    """A camera on a body.

    Attributes:
        lens: Intrinsics and distortion.
        width: Image width, pixels.
        height: Image height, pixels.
        rotation: (3, 3), camera to body.
        lever_arm: (3,), the camera's centre in the body, metres.
    """

    lens: Lens
    width: int
    height: int
    rotation: Floats
    lever_arm: Floats


@dataclass(frozen=True, eq=False)
class SensorRecording:
    """Measurements of camera and IMU; the IMU's frame is the body's.

    Attributes:
        name: Name in outputs.
        camera: Intrinsics and extrinsics.
        imu_stamps: (S,) nanoseconds, rising.
        angular_velocities: (S, 3), rad/s, in the body.
        accelerations: (S, 3), specific force, m/s^2, in the body.
        image_stamps: (F,) nanoseconds, rising.
        image_of: (O,), images of the observations.
        track_of: (O,), track names of the observations; a track is at most once in an image.
        pixels: (O, 2), distorted as in the image.
        groundtruth: Poses of the body with velocities and, where they are known, biases.
        notes: Sentences that state what the reader joined or inserted.
    """

    name: str
    camera: CalibratedCamera
    imu_stamps: Stamps
    angular_velocities: Floats
    accelerations: Floats
    image_stamps: Stamps
    image_of: Indices
    track_of: Indices
    pixels: Floats
    groundtruth: Trajectory
    notes: tuple[str, ...]


def one_instant_each(stamps: Stamps) -> tuple[Stamps, Indices]:
    """Return distinct instants (F,) of timestamps (O,) in any order, and indices (O,) to them."""
    distinct, place = np.unique(stamps, return_inverse=True)
    begins = np.diff(distinct, prepend=distinct[0] - SAME_INSTANT_NS - 1) > SAME_INSTANT_NS
    return distinct[begins], np.cumsum(begins)[place] - 1


def at_instants(stamps: Stamps, instants: Stamps, what: str) -> Indices:
    """Return the indices (N,) of the timestamps (S,), increasing, at the instants (N,).

    Raises:
        InputError: An instant without a timestamp.
    """
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
