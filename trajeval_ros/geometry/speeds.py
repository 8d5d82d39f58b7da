"""Speed and turn rate of a trajectory."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory


def speeds(trajectory: Trajectory) -> tuple[Floats, Floats | None]:
    """Return the mean speed and turn rate of the steps between consecutive states.

    Args:
        trajectory: N states in order of time, with distinct timestamps.

    Returns:
        Speeds (N - 1,), m/s, and turn rates (N - 1,), rad/s, or None without orientations.
    """
    steps_s = np.diff(trajectory.stamps) / NANOSECONDS
    linear = np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=1) / steps_s
    quaternions = trajectory.quaternions
    if quaternions is None:
        return linear, None
    turned = lie.angle(lie.multiply(lie.conjugate(quaternions[:-1]), quaternions[1:]))
    return linear, turned / steps_s
