"""Poses as rows of seven numbers, for the search of discontinuities and for drawing."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import Trajectory

POSITION, QUATERNION = slice(0, 3), slice(3, 7)  # xyzw; NaN if not measured


def rows_of(states: Trajectory) -> Floats:
    """Return positions and quaternions (N, 7)."""
    rows = np.full((len(states), QUATERNION.stop), np.nan)
    rows[:, POSITION] = states.positions
    if states.quaternions is not None:
        rows[:, QUATERNION] = states.quaternions
    return rows
