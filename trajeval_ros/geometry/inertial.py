"""Measurements of an IMU or a gyroscope."""

from __future__ import annotations

from dataclasses import dataclass

from trajeval_ros.geometry.arrays import Floats, Stamps


@dataclass(frozen=True, eq=False)
class InertialReadings:
    """Measurements of an IMU in its own axes.

    Attributes:
        stamps: (N,) int64, nanoseconds, in order of arrival.
        rates: (N, 3), rad/s, angular velocities.
        accelerations: (N, 3), m/s^2, specific force; None for a gyroscope.
        frame: Name of the sensor's frame, "" if unknown.
        source: The source, as the user names it.
        undecodable: Number of messages that could not be used.
        damage: Unreadable parts of the source, one sentence each.
    """

    stamps: Stamps
    rates: Floats
    accelerations: Floats | None
    frame: str = ""
    source: str = ""
    undecodable: int = 0
    damage: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Return the number of readings."""
        return len(self.stamps)
