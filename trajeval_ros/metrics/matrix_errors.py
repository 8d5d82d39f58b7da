"""Relative errors as the KITTI devkit computes them: with matrices that are not quite rotations.

KITTI's files have few digits. The devkit inverts and multiplies the matrices without correction,
which changes small angles. With 6 digits on KITTI 00, the smallest changes by 9 %, the mean by
0.003 %.
"""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.trajectory import Trajectory


def by_matrices(
    groundtruth: Trajectory, estimate: Trajectory, starts: Indices, ends: Indices, scale: float
) -> tuple[Floats, Floats]:
    """Return the position errors, metres, and rotation errors, degrees, (K,) each.

    With poses T_i of the groundtruth and T'_i of the scaled estimate, the error from s to e is
    (T'_s^-1 T'_e)^-1 T_s^-1 T_e. The position error is the length of its translation, the
    rotation error the arc cosine of (trace - 1) / 2.

    Args:
        groundtruth: N states with matrices or, without them, orientations.
        estimate: N states, likewise.
        starts: (K,) indices of first states.
        ends: (K,) indices of last states.
        scale: Groundtruth metres per unit of the estimate.
    """
    true_turn, true_step = _steps(groundtruth, starts, ends)
    turn, step = _steps(estimate, starts, ends)
    back = np.linalg.inv(turn)
    error = back @ true_turn
    cosine = 0.5 * (np.trace(error, axis1=1, axis2=2) - 1.0)
    difference = np.einsum("nij,nj->ni", back, true_step - scale * step)
    position: Floats = np.sqrt(np.einsum("ni,ni->n", difference, difference))
    return position, np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _steps(trajectory: Trajectory, starts: Indices, ends: Indices) -> tuple[Floats, Floats]:
    """Return rotations (K, 3, 3) and translations (K, 3) from start to end, in start's frame."""
    inverse = np.linalg.inv(_matrices(trajectory, starts))
    moved = trajectory.positions[ends] - trajectory.positions[starts]
    return inverse @ _matrices(trajectory, ends), np.einsum("nij,nj->ni", inverse, moved)


def _matrices(trajectory: Trajectory, rows: Indices) -> Floats:
    if trajectory.matrices is not None:
        return trajectory.matrices[rows]
    assert trajectory.quaternions is not None
    return lie.to_matrix(trajectory.quaternions[rows])
