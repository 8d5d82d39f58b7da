"""ROS messages to columns of poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.formatting.remarks import note
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.io.bags.cdr import CdrPlan, plan_with
from trajeval_ros.io.bags.cdr_columns import Columns, StringColumn
from trajeval_ros.io.bags.message_definitions import STANDARD, Fields
from trajeval_ros.io.bags.pose_columns import PoseColumns
from trajeval_ros.io.bags.px4_messages import ATTITUDE, PX4_POSE_TYPES, Px4Plan, poses_of_px4

FIX_TYPE = "sensor_msgs/msg/NavSatFix"
TRANSFORM_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
PATH_TYPE = "nav_msgs/msg/Path"
POSE_2D = "geometry_msgs/msg/Pose2D"
POSE_2D_TIMES = note("log_times", "no timestamps in messages: log times used, height 0")
_POSE_2D_FIELDS: Fields = (("x", "f8"), ("y", "f8"), ("theta", "f8"))


@dataclass(frozen=True, eq=False)
class TransformColumns:
    """The transforms of one edge, in order of arrival."""

    stamps: NDArray[np.int64]  # (N,) int64, nanoseconds, of the headers
    numbers: Floats  # (N, 7): translation in metres, quaternion xyzw
    rows: NDArray[np.int64]  # (N,) int64, number of the message of a transform


@dataclass(frozen=True)
class _Paths:
    """Paths of the fields of a pose in a type; "" or () without such a field."""

    position: str | tuple[str, ...]
    quaternion: str = ""
    body_velocity: str = ""
    body_rate: str = ""
    covariance: str = ""
    child_frame: str = ""
    fix_quality: tuple[str, ...] = ()

    def requested(self, *, covariance: bool, rates: bool = False) -> list[str]:
        """Return the fields to decode."""
        position = (self.position,) if isinstance(self.position, str) else self.position
        paths = [*position, self.quaternion, self.body_velocity, self.child_frame]
        paths += self.fix_quality
        paths += [self.covariance] if covariance else []
        paths += [self.body_rate] if rates else []
        return [*_HEADER, *(path for path in paths if path)]


_HEADER = ("header.stamp.sec", "header.stamp.nanosec", "header.frame_id")
_PATHS = {
    "nav_msgs/msg/Odometry": _Paths(
        "pose.pose.position",
        "pose.pose.orientation",
        "twist.twist.linear",
        "twist.twist.angular",
        "pose.covariance",
        "child_frame_id",
    ),
    "geometry_msgs/msg/PoseStamped": _Paths("pose.position", "pose.orientation"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _Paths(
        "pose.pose.position", "pose.pose.orientation", covariance="pose.covariance"
    ),
    "geometry_msgs/msg/TransformStamped": _Paths(
        "transform.translation", "transform.rotation", child_frame="child_frame_id"
    ),
    "geometry_msgs/msg/PointStamped": _Paths("point"),
    "sensor_msgs/msg/NavSatFix": _Paths(
        ("latitude", "longitude", "altitude"),
        fix_quality=("status.status", "position_covariance_type", "position_covariance"),
    ),
}
POSE_TYPES = (*_PATHS, PATH_TYPE)
_OF_A_PATH = _PATHS["geometry_msgs/msg/PoseStamped"]
_OF_TRANSFORMS = _PATHS["geometry_msgs/msg/TransformStamped"]


def decode_poses(
    payloads: Sequence[bytes | memoryview],
    message_type: str,
    *,
    covariance: bool = False,
    rates: bool = False,
) -> PoseColumns:
    """Return the poses of messages of ROS 2, by the standard definition of their type.

    `payloads`: the messages in untrusted CDR. Messages that can't be decoded are left out and
    counted. `message_type`: one of `POSE_TYPES` but `nav_msgs/msg/Path`.
    """
    plan = (
        Px4Plan(message_type)
        if message_type in PX4_POSE_TYPES
        else _plan(message_type, covariance=covariance, rates=rates)
    )
    columns = plan.decode(payloads)
    return poses_of(
        columns, message_type, len(payloads) - len(columns.rows), covariance=covariance
    )


def decode_path(payload: bytes | memoryview) -> PoseColumns:
    """Return the poses of a nav_msgs/Path of ROS 2; none, and 1 undecodable, if it is no Path."""
    columns = _plan(PATH_TYPE).decode([payload])
    return poses_of(columns, PATH_TYPE, 1 - len(columns.rows))


def decode_transforms(
    payloads: Sequence[bytes | memoryview],
) -> tuple[dict[tuple[str, str], TransformColumns], int]:
    """Return the transforms of tf2_msgs/TFMessage of ROS 2 by edge (parent, child).

    Returns:
        The edges, and the number of messages that can't be decoded.
    """
    columns = _plan(TRANSFORM_TYPES[0]).decode(payloads)
    return edges_of(columns), len(payloads) - len(columns.rows)


@cache
def _plan(message_type: str, *, covariance: bool = False, rates: bool = False) -> CdrPlan:
    """Return how a standard type of ROS 2 is decoded."""
    return plan_of(STANDARD[message_type], message_type, covariance=covariance, rates=rates)


def plan_of(
    fields: Fields | None,
    message_type: str,
    *,
    covariance: bool = False,
    rates: bool = False,
    is_ros1: bool = False,
) -> CdrPlan:
    """Return how the poses or transforms of a type are decoded.

    `fields`: of the type, as a bag defines it. The standard definition is used if this is None or
    lacks a field of a pose. `message_type`: one of `POSE_TYPES` or `TRANSFORM_TYPES`.
    """
    requested = _requested(message_type, covariance=covariance, rates=rates)
    name = TRANSFORM_TYPES[0] if message_type in TRANSFORM_TYPES else message_type
    return plan_with(fields, name, requested, is_ros1=is_ros1)


def _requested(message_type: str, *, covariance: bool, rates: bool) -> list[str]:
    """Return the requested fields of a type of poses or transforms."""
    if message_type == PATH_TYPE:
        return [f"poses.{path}" for path in _OF_A_PATH.requested(covariance=False)]
    if message_type in TRANSFORM_TYPES:
        return [f"transforms.{path}" for path in _OF_TRANSFORMS.requested(covariance=False)]
    return _PATHS[message_type].requested(covariance=covariance, rates=rates)


def poses_of(
    columns: Columns, message_type: str, undecodable: int, *, covariance: bool = True
) -> PoseColumns:
    """Return decoded columns as poses; for paths, the poses of all of them."""
    if message_type in (*PX4_POSE_TYPES, ATTITUDE):
        return poses_of_px4(columns, message_type, undecodable, covariance=covariance)
    # Foxglove's types have the fields of their counterparts.
    counterpart = _PATHS[FIX_TYPE] if "latitude" in columns.numbers else _OF_A_PATH
    paths = _PATHS.get(message_type, counterpart)
    if message_type == PATH_TYPE:
        inner = columns.sequences["poses"]
        columns = replace(inner, rows=columns.rows[inner.rows])
    numbers = columns.numbers
    covariances = numbers.get(paths.covariance)
    return PoseColumns(
        stamps_of(columns),
        _joined(numbers, paths.position),
        floats_of(numbers[paths.quaternion]) if paths.quaternion else None,
        floats_of(numbers[paths.body_velocity]) if paths.body_velocity else None,
        None if covariances is None else floats_of(covariances).reshape(-1, 6, 6),
        _joined(numbers, paths.fix_quality) if paths.fix_quality else None,
        changes_of(columns.texts["header.frame_id"], columns.texts.get(paths.child_frame)),
        columns.rows,
        undecodable,
        body_rates=floats_of(numbers[paths.body_rate]) if paths.body_rate in numbers else None,
    )


def stamps_of(columns: Columns) -> NDArray[np.int64]:
    """Return the stamps of the headers, (N,), nanoseconds."""
    seconds = columns.numbers["header.stamp.sec"].astype(np.int64)
    stamps: NDArray[np.int64] = seconds * NANOSECONDS + columns.numbers["header.stamp.nanosec"]
    return stamps


def _joined(numbers: Mapping[str, NDArray[Any]], paths: str | tuple[str, ...]) -> Floats:
    """Return the numbers of one field, or of several fields side by side."""
    if isinstance(paths, str):
        return floats_of(numbers[paths])
    return floats_of(np.column_stack([numbers[path] for path in paths]))


def floats_of(column: NDArray[Any]) -> Floats:
    """Return a column as floats of 64 bits."""
    return np.asarray(column, dtype=np.float64)


def changes_of(frames: StringColumn, children: StringColumn | None) -> list[tuple[int, str, str]]:
    """Return first row, frame and child frame at every change of the frames."""
    names = [name.lstrip("/") for name in frames.names]
    child_names = [name.lstrip("/") for name in children.names] if children else [""]
    if not len(frames.codes):
        return []
    if len(names) == len(child_names) == 1:
        return [(0, names[0], child_names[0])]
    child_codes = np.zeros_like(frames.codes) if children is None else children.codes
    both = frames.codes * len(child_names) + child_codes
    firsts = np.flatnonzero(np.concatenate([[True], both[1:] != both[:-1]])).tolist()
    changes: list[tuple[int, str, str]] = []
    for row in firsts:
        pair = names[frames.codes[row]], child_names[child_codes[row]]
        if not changes or changes[-1][1:] != pair:
            changes.append((row, *pair))
    return changes


def edges_of(columns: Columns) -> dict[tuple[str, str], TransformColumns]:
    """Return decoded transforms of TF messages by edge (parent, child)."""
    elements = columns.sequences["transforms"]
    stamps = stamps_of(elements)
    translations = _joined(elements.numbers, _OF_TRANSFORMS.position)
    rotations = elements.numbers[_OF_TRANSFORMS.quaternion]
    numbers = floats_of(np.concatenate([translations, rotations], axis=1))
    rows = columns.rows[elements.rows]
    parents, children = elements.texts["header.frame_id"], elements.texts["child_frame_id"]
    both = parents.codes * len(children.names) + children.codes
    order = np.argsort(both, kind="stable")
    codes, firsts = np.unique(both[order], return_index=True)
    edges: dict[tuple[str, str], TransformColumns] = {}
    for code, of_code in zip(codes.tolist(), np.split(order, firsts)[1:], strict=True):
        parent, child = divmod(code, len(children.names))
        key = parents.names[parent].lstrip("/"), children.names[child].lstrip("/")
        edge = TransformColumns(stamps[of_code], numbers[of_code], rows[of_code])
        edges[key] = _appended(edges[key], edge) if key in edges else edge
    return edges


def _appended(edge: TransformColumns, other: TransformColumns) -> TransformColumns:
    """Return both, in order of arrival."""
    rows = np.concatenate([edge.rows, other.rows])
    order = np.argsort(rows, kind="stable")
    return TransformColumns(
        np.concatenate([edge.stamps, other.stamps])[order],
        np.concatenate([edge.numbers, other.numbers])[order],
        rows[order],
    )


def pose_2d_plan(*, is_ros1: bool) -> CdrPlan:
    """Return how messages of the type are decoded."""
    return CdrPlan(_POSE_2D_FIELDS, is_ros1=is_ros1)


def poses_2d_of(columns: Columns, log_times: Stamps, undecodable: int) -> PoseColumns:
    """Return decoded columns as poses in the plane z = 0, stamped by their recording."""
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
