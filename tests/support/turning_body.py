"""An exact motion of a body that turns about all axes."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from trajeval_ros.geometry.arrays import Floats


def rotated(times: Floats) -> Rotation:
    """Return the orientations at seconds (N,)."""
    angles = 0.8 * np.sin(np.outer(times, [0.9, 0.7, 1.1]) + [0.0, 1.0, 2.0])
    return Rotation.from_euler("zyx", angles)


def places(times: Floats) -> Floats:
    """Return the positions (N, 3) at seconds (N,), metres."""
    columns: Floats = np.sin(np.outer(times, [0.8, 0.6, 0.5]) + [0.0, 1.0, 2.0])
    return columns * [2.0, 3.0, 1.0]
