"""Blocks of states from columns that may have invalid poses, as messages have them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.source_info import ReceiveTimes, SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.metrics.coverage import StampedPoses
from trajeval_ros.online.pairing import PairedStates

Array = NDArray[np.float64]


def states(
    positions: Array, quaternions: Array | None = None, velocities: Array | None = None
) -> Array:
    """Return rows (N, 10): position, quaternion xyzw, velocity; NaN if not measured."""
    rows = np.full((len(positions), 10), np.nan)
    for place, columns in ((0, positions), (3, quaternions), (7, velocities)):
        if columns is not None:
            rows[:, place : place + columns.shape[1]] = columns
    return rows


def trajectory(
    stamps: NDArray[np.int64],
    rows: Array,
    up: UpAxis = Z_UP,
    arrived: NDArray[np.int64] | None = None,
) -> Trajectory:
    """Return rows (N, 10), or (N, 46) with covariances, without what some of them lack."""
    receive_times = None if arrived is None else ReceiveTimes(arrived, "node")
    quaternions, velocities, covariances = rows[:, 3:7], rows[:, 7:10], rows[:, 10:]
    return Trajectory.from_columns(
        stamps,
        rows[:, :3],
        None if np.isnan(quaternions).all() else quaternions,
        velocities=None if np.isnan(velocities).all() else velocities,
        covariances=covariances.reshape(-1, 6, 6) if covariances.any() else None,
        up=up,
        reading=SourceInfo(receive_times=receive_times),
    )


def as_drawn(pairs: PairedStates) -> tuple[NDArray[np.int64], Array, Array]:
    """Return pairs as they are drawn live: timestamps, and poses (N, 7) of both sides."""
    sides = pairs.groundtruth, pairs.estimate
    groundtruth, estimate = (StampedPoses.of(side).poses for side in sides)
    return pairs.stamps, groundtruth, estimate
