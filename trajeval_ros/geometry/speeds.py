"""How fast a trajectory moves and turns."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory


def speeds(trajectory: Trajectory) -> tuple[Floats, Floats | None]:
    """Return the mean speed and turn rate over each step between consecutive states.

    Args:
        trajectory: N states with stamps, in order, no two at one time.

    Returns:
        (N - 1,) in m/s, and (N - 1,) in rad/s; None for it without rotations.
    """
    steps_s = np.diff(trajectory.stamps) / NANOSECONDS
    linear = np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=1) / steps_s
    quaternions = trajectory.quaternions
    if quaternions is None:
        return linear, None
    turned = lie.angle(lie.multiply(lie.conjugate(quaternions[:-1]), quaternions[1:]))
    return linear, turned / steps_s
