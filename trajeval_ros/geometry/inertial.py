"""Measurements of an IMU or a gyroscope."""

from __future__ import annotations

from dataclasses import dataclass

from trajeval_ros.geometry.arrays import Floats, Stamps


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
