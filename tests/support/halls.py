"""The surfaces of the hall of examples/lidar_odometry."""

from __future__ import annotations

import numpy as np

from examples.lidar_odometry.world import Hall


def distances(hall: Hall, points: np.ndarray) -> np.ndarray:
    """Return the distances of points (N, 3) to the nearest surface, (N,), metres."""
    below, above = hall.low - points[:, None], points[:, None] - hall.high
    outside = np.linalg.norm(np.maximum(np.maximum(below, above), 0.0), axis=2)
    inside = np.maximum(below, above).max(axis=2)
    return np.abs(np.where(inside > 0.0, outside, inside)).min(axis=1)
