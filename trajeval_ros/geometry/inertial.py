"""Measurements of an IMU or a gyroscope, and the orientations that they give."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps

_IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class InertialReadings:
    """Measurements of an IMU in its own axes."""

    stamps: Stamps  # (N,) int64, nanoseconds, in order of arrival
    rates: Floats  # (N, 3), rad/s, angular velocities
    accelerations: Floats | None  # (N, 3), m/s^2, specific force; None for a gyroscope
    frame: str = ""  # name of the sensor's frame, "" if unknown
    source: str = ""
    undecodable: int = 0  # number of messages that could not be used
    damage: tuple[str, ...] = ()  # unreadable parts of the source, one sentence each

    def __len__(self) -> int:
        return len(self.stamps)


def rotations_by_gyro(seconds: Floats, rates: Floats, first: Floats = _IDENTITY) -> Floats:
    """Return orientations (N, 4) by angular velocities (N, 3), rad/s, from the first one (4,)."""
    steps = 0.5 * (rates[1:] + rates[:-1]) * np.diff(seconds)[:, None]
    rotations = lie.running_products(first, lie.from_rotation_vector(steps))
    return np.concatenate([first[None], rotations])
