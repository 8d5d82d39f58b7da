"""Conversion of axes: ROS (x forward, y left, z up), camera (x right, y down, z forward).

Both are defined in REP-103. A trajectory has two sets of axes: of the fixed frame and of the body.
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
# The rows are the camera's axes in ROS axes: the rotation from ROS axes to camera axes.
_TO_OPTICAL: Floats = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
_UP = {"ros": "z", "optical": "-y"}


def with_world_axes(trajectory: Trajectory, axes: str) -> Trajectory:
    """Return the same motion in a fixed frame with the other axes.

    Args:
        trajectory: In a fixed frame with the axes not named by `axes`.
        axes: Axes of the result, one of `AXES`.

    Raises:
        SettingsError: The axes are unknown.
        InputError: The frame has these axes already, according to its up axis.
    """
    require_one_of(axes, AXES, "axes")
    up = trajectory.up
    if up.name == _UP[axes] and up.name != "z":
        raise InputError(f"its fixed frame already has {axes} axes: the vertical axis is {up}")
    turned = Similarity(_turn_to(axes), np.zeros(3)).trajectory(trajectory)
    return dataclasses.replace(turned, up=UpAxis(_UP[axes], f"converted to {axes} axes"))


def with_body_axes(trajectory: Trajectory, axes: str) -> Trajectory:
    """Return the same motion of a body with the other axes.

    Args:
        trajectory: Of a body with the axes not named by `axes`.
        axes: Axes of the result, one of `AXES`.

    Raises:
        SettingsError: The axes are unknown.
        InputError: The trajectory has no orientations.
    """
    require_one_of(axes, AXES, "axes")
    if trajectory.quaternions is None:
        raise InputError("no orientations, which the conversion of body axes needs")
    # Poses with the new axes are T_W_B T_B_new; `of_body` multiplies by the inverse.
    turn = HandEye(lie.from_matrix(_turn_to(axes)), np.zeros(3))
    return turn.of_body(trajectory)


def _turn_to(axes: str) -> Floats:
    return _TO_OPTICAL if axes == "optical" else _TO_OPTICAL.T
