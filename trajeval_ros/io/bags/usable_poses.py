"""The check of decoded poses, for bags and for live messages: timestamps, velocities, frames."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.io.bags.pose_messages import PoseColumns

Frames = tuple[int, str, str]  # first row, frame and child frame


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
    untimed = int(np.count_nonzero(~timed))
    dropped = {"undecodable": columns.undecodable, "zero_stamp": untimed}
    if untimed:  # a mask copies everything
        columns = columns.picked(timed)
    return UsablePoses(columns, _velocities(columns), dropped, changes)


def _velocities(columns: PoseColumns) -> Floats | None:
    """Return the velocities (N, 3) in the frame; zero where the quaternion has no length."""
    body, quaternions = columns.body_velocities, columns.quaternions
    if body is None or quaternions is None:
        return None
    velocities = np.zeros_like(body)
    if not body.any():
        return velocities
    lengths = np.linalg.norm(quaternions, axis=1)
    usable = np.isfinite(lengths) & (lengths > 1e-6)
    if usable.any():
        (velocities[usable],) = lie.by_blocks(_turned, quaternions[usable], body[usable])
    return velocities


def _turned(quaternions: Floats, vectors: Floats) -> tuple[Floats]:
    """Return the vectors (N, 3) turned by quaternions (N, 4) of any length."""
    matrices = lie.to_matrix(lie.normalized(quaternions))
    return (np.einsum("nij,nj->ni", matrices, vectors),)
