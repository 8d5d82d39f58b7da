"""Projection of trajectories on a plane of their frame."""

from __future__ import annotations

import dataclasses

import numpy as np

from trajeval_ros.exceptions import require_one_of
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.trajectory import Trajectory

PLANES = {"xy": 2, "xz": 1, "yz": 0}  # and the index of the normal axis


def flattened(trajectory: Trajectory, plane: str) -> Trajectory:
    """Return positions and velocities in a plane, and rotations about its normal.

    A rotation is replaced by its twist about the normal. A rotation by pi about an axis in the
    plane has none and becomes the identity. Covariances are dropped.

    Args:
        trajectory: In any frame.
        plane: One of `PLANES`.

    Raises:
        SettingsError: The plane is unknown.
    """
    require_one_of(plane, PLANES, "plane")
    normal = PLANES[plane]
    flat = np.ones(3)
    flat[normal] = 0.0
    quaternions, velocities = trajectory.quaternions, trajectory.velocities
    if quaternions is not None:
        # The normal takes the place of z.
        places = [*(axis for axis in range(3) if axis != normal), normal, 3]
        turns = np.empty_like(quaternions)
        turns[:, places] = lie.normalized(lie.heading(quaternions[:, places]))
        quaternions = turns
    return dataclasses.replace(
        trajectory,
        positions=trajectory.positions * flat,
        quaternions=quaternions,
        velocities=None if velocities is None else velocities * flat,
        covariances=None,
        matrices=None,
    )
