"""ROS's axes (x forward, y left, z up) and a camera's (x right, y down, z forward): REP-103.

A trajectory has two sets of axes: those of its fixed frame, and those of the body.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from trajeval_ros.exceptions import InputError, require_one_of
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.similarity import Similarity
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UpAxis

AXES = ("ros", "optical")
# Rows are the camera's axes in ROS's: from ROS's axes to the camera's.
_TO_OPTICAL: Floats = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
_UP = {"ros": "z", "optical": "-y"}


def with_world_axes(trajectory: Trajectory, axes: str) -> Trajectory:
    """Return the same motion in a fixed frame whose axes are ROS's, from a camera's, or reversed.

    Args:
        trajectory: In a fixed frame with the other axes.
        axes: One of `AXES`, those wanted.

    Raises:
        SettingsError: There are no such axes.
        InputError: What is known of the frame's up axis says that it has them already.
    """
    require_one_of(axes, AXES, "axes")
    up = trajectory.up
    if up.name == _UP[axes] and up.name != "z":
        raise InputError(f"its fixed frame already has {axes} axes: the vertical axis is {up}")
    turned = Similarity(_turn_to(axes), np.zeros(3)).trajectory(trajectory)
    return dataclasses.replace(turned, up=UpAxis(_UP[axes], f"converted to {axes} axes"))


def with_body_axes(trajectory: Trajectory, axes: str) -> Trajectory:
    """Return the same motion of a body whose axes are ROS's, from a camera's, or reversed.

    Args:
        trajectory: Of a body with the other axes.
        axes: One of `AXES`, those wanted.

    Raises:
        SettingsError: There are no such axes.
        InputError: It has no orientations.
    """
    require_one_of(axes, AXES, "axes")
    if trajectory.quaternions is None:
        raise InputError("no orientations, which the conversion of body axes needs")
    # Poses of the new axes: T_W_B T_B_new, and of_body multiplies by the inverse.
    turn = HandEye(lie.from_matrix(_turn_to(axes)), np.zeros(3))
    return turn.of_body(trajectory)


def _turn_to(axes: str) -> Floats:
    return _TO_OPTICAL if axes == "optical" else _TO_OPTICAL.T
