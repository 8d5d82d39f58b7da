"""Conversion of axes: ROS (x forward, y left, z up), camera (x right, y down, z forward), z up.

REP-103 defines the first two. A trajectory has two sets of axes: of the fixed frame and of the
body.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from trajeval_ros.exceptions import InputError, require_one_of
from trajeval_ros.formatting.remarks import note
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import ROTATED_FROM, UpAxis

AXES = ("ros", "optical")
# The rows are the camera's axes in ROS axes: the rotation from ROS axes to camera axes.
_TO_OPTICAL: Floats = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
_UP = {"ros": "z", "optical": "-y"}


def with_world_axes(trajectory: Trajectory, axes: str) -> Trajectory:
    """Return the same motion in a fixed frame with the other axes.

    `trajectory`: in a fixed frame with the axes not named by `axes`.
    """
    require_one_of(axes, AXES, "axes")
    up = trajectory.up
    if up.name == _UP[axes] and up.name != "z":
        raise InputError(f"its fixed frame already has {axes} axes: the vertical axis is {up}")
    rotated = Similarity(_turn_to(axes), np.zeros(3)).trajectory(trajectory)
    return dataclasses.replace(rotated, up=UpAxis(_UP[axes], f"converted to {axes} axes"))


def with_body_axes(trajectory: Trajectory, axes: str) -> Trajectory:
    """Return the same motion of a body with the other axes.

    `trajectory`: of a body with the axes not named by `axes`.
    """
    require_one_of(axes, AXES, "axes")
    if trajectory.quaternions is None:
        raise InputError("no orientations, which the conversion of body axes needs")
    # Poses with the new axes are T_W_B T_B_new; `of_body` multiplies by the inverse.
    rotation = HandEye(lie.from_matrix(_turn_to(axes)), np.zeros(3))
    return rotation.of_body(trajectory)


def _turn_to(axes: str) -> Floats:
    return _TO_OPTICAL if axes == "optical" else _TO_OPTICAL.T


def upright(trajectory: Trajectory) -> Trajectory:
    """Return a trajectory in a frame with z up, with a remark if its own axis differs."""
    up = trajectory.up
    if up.name == "z":
        return trajectory
    rotation, both = up.matrix, np.kron(np.eye(2), up.matrix)
    quaternions, velocities = trajectory.quaternions, trajectory.velocities
    covariances, reading = trajectory.covariances, trajectory.reading
    if reading.matrices is not None:
        reading = dataclasses.replace(reading, matrices=rotation @ reading.matrices)
    axes = ", ".join("xyz"[axis] for axis in up.level)
    sentence = (
        f"vertical axis {up.name} ({up.origin}): evaluated in a frame with the axes {axes}, "
        f"{up.name}"
    )
    return dataclasses.replace(
        trajectory,
        positions=up.to_z_up(trajectory.positions),
        quaternions=None
        if quaternions is None
        else lie.normalized(lie.multiply(lie.from_matrices(rotation[None]), quaternions)),
        velocities=None if velocities is None else up.to_z_up(velocities),
        covariances=None if covariances is None else both @ covariances @ both.T,
        up=UpAxis("z", f"{ROTATED_FROM}{up.name}, {up.origin}"),
        reading=reading.remarked(note("z_up", sentence)),
    )


def between_own_axes(similarity: Similarity, groundtruth: UpAxis, estimate: UpAxis) -> Similarity:
    """Return an alignment between converted trajectories as one between their own frames."""
    to, of = groundtruth.matrix, estimate.matrix
    return Similarity(
        to.T @ similarity.rotation @ of, to.T @ similarity.translation, similarity.scale
    )
