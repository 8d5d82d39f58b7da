"""Trajectories of GNSS fixes for tests: an antenna on a drifting flight."""

from __future__ import annotations

import numpy as np
from ros_bags import Message

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.fix_selection import trajectory_of_rows
from trajeval_ros.geometry.geodesy import Datum, places_at
from trajeval_ros.geometry.source_info import SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.encode_messages import encode_fixes
from trajeval_ros.io.bags.pose_messages import FIX_TYPE

DATUM = Datum(47.4, 8.5, 430.0)


def quality(count: int, status: int = 2, kind: int = 2, sigma_m: float = 0.02) -> Floats:
    """Return status, type and covariance of N fixes, twice as bad upwards."""
    rows = np.zeros((count, 11))
    rows[:, 0], rows[:, 1] = status, kind
    rows[:, [2, 6]], rows[:, 10] = sigma_m**2, 4.0 * sigma_m**2
    return rows


def places_of(positions: Floats) -> Floats:
    """Return the places of positions."""
    return places_at(positions, DATUM)


def fixes_of(
    stamps: Stamps, positions: Floats, rows: Floats | None = None, **attributes: object
) -> Trajectory:
    """Return the trajectory of fixes at the given positions."""
    rows = quality(len(stamps)) if rows is None else rows
    attributes = {"child_frame": "gps", "name": "fix", **attributes}
    places = places_of(positions)
    return trajectory_of_rows("run:/fix", stamps, places, rows, SourceInfo(), **attributes)


def fix_messages(fixes: Trajectory, topic: str, antenna: str = "gps") -> list[Message]:
    """Return fixes as sensor_msgs/NavSatFix, logged at their stamps."""
    assert fixes.reading.fixes is not None
    payloads = encode_fixes(fixes.stamps, fixes.reading.fixes, antenna)
    return [
        (topic, FIX_TYPE, int(stamp), bytes(payload))
        for stamp, payload in zip(fixes.stamps, payloads, strict=True)
    ]


def later(messages: list[Message], late_s: float) -> list[Message]:
    """Return messages that arrive so much later."""
    return [(*message[:2], message[2] + round(late_s * 1e9), message[3]) for message in messages]
