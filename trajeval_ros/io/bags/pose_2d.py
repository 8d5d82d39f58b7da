"""geometry_msgs/Pose2D: poses in a plane, whose messages have no header."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Stamps
from trajeval_ros.io.bags.cdr import CdrPlan
from trajeval_ros.io.bags.cdr_columns import Columns
from trajeval_ros.io.bags.message_definitions import Fields
from trajeval_ros.io.bags.pose_messages import PoseColumns

POSE_2D = "geometry_msgs/msg/Pose2D"
POSE_2D_NOTE = "no timestamps in messages: log times used, height 0"
_FIELDS: Fields = (("x", "f8"), ("y", "f8"), ("theta", "f8"))


def pose_2d_plan(*, is_ros1: bool) -> CdrPlan:
    """Return how messages of the type are decoded."""
    return CdrPlan(_FIELDS, is_ros1=is_ros1)


def poses_2d_of(columns: Columns, log_times: Stamps, undecodable: int) -> PoseColumns:
    """Return decoded columns as poses in the plane z = 0, stamped by their recording.

    Args:
        columns: As decoded by `pose_2d_plan`, N rows.
        log_times: Of all messages that were to be decoded.
        undecodable: Number of messages that weren't.
    """
    x, y, theta = (
        columns.numbers[name].ravel().astype(np.float64) for name in ("x", "y", "theta")
    )
    zeros = np.zeros(len(x))
    return PoseColumns(
        stamps=log_times[columns.rows],
        positions=np.column_stack([x, y, zeros]),
        quaternions=np.column_stack([zeros, zeros, np.sin(theta / 2.0), np.cos(theta / 2.0)]),
        body_velocities=None,
        covariances=None,
        fix_quality=None,
        frames=[(0, "", "")] if len(x) else [],
        rows=columns.rows,
        undecodable=undecodable,
    )
