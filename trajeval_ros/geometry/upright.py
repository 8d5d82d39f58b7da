"""Conversion of trajectories to a frame with z up."""

from __future__ import annotations

import dataclasses

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.similarity import Similarity
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UpAxis


def upright(trajectory: Trajectory) -> Trajectory:
    """Return a trajectory in a frame with z up, with a note if its own axis differs."""
    up = trajectory.up
    if up.name == "z":
        return trajectory
    turn, both = up.matrix, np.kron(np.eye(2), up.matrix)
    quaternions, velocities = trajectory.quaternions, trajectory.velocities
    covariances, matrices = trajectory.covariances, trajectory.matrices
    axes = ", ".join("xyz"[axis] for axis in up.level)
    note = (
        f"vertical axis {up.name} ({up.origin}): evaluated in a frame with the axes {axes}, "
        f"{up.name}"
    )
    return dataclasses.replace(
        trajectory,
        positions=up.turned(trajectory.positions),
        quaternions=None
        if quaternions is None
        else lie.normalized(lie.multiply(lie.from_matrices(turn[None]), quaternions)),
        velocities=None if velocities is None else up.turned(velocities),
        covariances=None if covariances is None else both @ covariances @ both.T,
        matrices=None if matrices is None else turn @ matrices,
        up=UpAxis("z", f"rotated from {up.name}, {up.origin}"),
        notes=(*trajectory.notes, note),
    )


def between_own_axes(similarity: Similarity, groundtruth: UpAxis, estimate: UpAxis) -> Similarity:
    """Return an alignment between converted trajectories as one between their own frames."""
    to, of = groundtruth.matrix, estimate.matrix
    return Similarity(
        to.T @ similarity.rotation @ of, to.T @ similarity.translation, similarity.scale
    )
