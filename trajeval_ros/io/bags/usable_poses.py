"""The check of decoded poses, for bags and for live messages: timestamps, velocities, frames."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from trajeval_ros.formatting.remarks import note
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.valid_poses import add_counts
from trajeval_ros.io.bags.pose_columns import Frames, PoseColumns

WORLD_TWIST = note("world_twist", "twist in the fixed frame: child_frame_id equals frame_id")


class UsablePoses(NamedTuple):
    """Poses with a timestamp."""

    columns: PoseColumns
    velocities: Floats | None  # (N, 3), m/s, in the poses' frame; None if the type has none
    dropped: dict[str, int]  # number of messages without a usable pose, by reason
    # The frames before and after every change; rows as in the messages.
    frame_changes: list[tuple[Frames, Frames]]


def usable_poses(
    columns: PoseColumns, timed: Booleans, before: Frames | None = None
) -> UsablePoses:
    """Return the poses whose timestamp was set, and what was found.

    `timed`: (N,) whether the timestamp was set. `before`: frames before the first pose; None at
    the start of a stream.
    """
    frames = columns.frames if before is None else [before, *columns.frames]
    changes = [(one, other) for one, other in pairwise(frames) if one[1:] != other[1:]]
    columns = columns.picked(timed, "zero_stamp")
    dropped = add_counts({"undecodable": columns.undecodable}, columns.dropped)
    return UsablePoses(columns, _velocities(columns), dropped, changes)


def has_world_twist(columns: PoseColumns) -> bool:
    """Return whether the twist is in the fixed frame: the body has its name, as of VINS-Fusion."""
    frames = columns.frames
    return bool(frames) and all(frame and frame == child for _, frame, child in frames)


def _velocities(columns: PoseColumns) -> Floats | None:
    """Return the velocities (N, 3) in the frame; zero where the quaternion has no length."""
    if columns.velocities is not None:
        return columns.velocities
    if has_world_twist(columns):
        return columns.body_velocities
    body, quaternions = columns.body_velocities, columns.quaternions
    if body is None or quaternions is None:
        return None
    velocities = np.zeros_like(body)
    if not body.any():
        return velocities
    lengths = np.linalg.norm(quaternions, axis=1)
    usable = np.isfinite(lengths) & (lengths > 1e-6)
    if usable.any():
        (velocities[usable],) = lie.by_blocks(_rotated, quaternions[usable], body[usable])
    return velocities


def _rotated(quaternions: Floats, vectors: Floats) -> tuple[Floats]:
    """Return the vectors (N, 3) turned by quaternions (N, 4) of any length."""
    matrices = lie.to_matrix(lie.normalized(quaternions))
    return (np.einsum("nij,nj->ni", matrices, vectors),)
