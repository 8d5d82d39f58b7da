"""Errors of whole poses and of distances: evo's pose relations.

With a position error dp and a rotation error E of angle a, the error of a pose is the 4 x 4 matrix
[E dp; 0 1]. `full` is its Frobenius distance from the identity. `rotation_part` is that of E
alone, the chord 2 sqrt(2) sin(a / 2). Both have no unit: `full` adds squared metres and squared
chords.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.metrics.drift import PERCENT
from trajeval_ros.metrics.statistics import Statistics, statistics_of


def pose_errors(position_m: Floats, rotation_deg: Floats | None) -> dict[str, Statistics | None]:
    """Return statistics of `rotation_part` and `full`; None without rotation errors.

    Args:
        position_m: (N,), length of the position error.
        rotation_deg: (N,), angle of the rotation error.
    """
    if rotation_deg is None:
        return {"rotation_part": None, "full": None}
    chord = np.sqrt(8.0) * np.sin(np.radians(rotation_deg) / 2.0)
    return {
        "rotation_part": statistics_of(chord),
        "full": statistics_of(np.hypot(position_m, chord)),
    }


def distance_errors(
    groundtruth: Floats, estimate: Floats, starts: Indices, ends: Indices, scale: float
) -> dict[str, Statistics | None]:
    """Return statistics of the errors of distances between first and last states.

    `distance_m` is | |p_e - p_s| - |p'_e - p'_s| |. `distance_percent` is relative to the
    groundtruth's distance, without sub-trajectories that end where they start. Neither needs an
    alignment or orientations.

    Args:
        groundtruth: (N, 3) positions, metres.
        estimate: (N, 3) positions, in their own frame.
        starts: (K,) indices of first states.
        ends: (K,) indices of last states.
        scale: Scale of the alignment.
    """
    true = np.linalg.norm(groundtruth[ends] - groundtruth[starts], axis=1)
    error = np.abs(true - scale * np.linalg.norm(estimate[ends] - estimate[starts], axis=1))
    moved = true > 0.0
    return {
        "distance_m": statistics_of(error),
        "distance_percent": statistics_of(PERCENT * error[moved] / true[moved]),
    }
