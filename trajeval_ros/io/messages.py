"""ROS messages to columns of poses.

This is the one place with a Python loop over messages. It ends in `PoseColumns` and
`Transforms`; whatever decodes faster only has to fill the same columns.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Decode = Callable[[bytes], Any]

TRANSFORM_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
PATH_TYPE = "nav_msgs/msg/Path"


class Pose(NamedTuple):
    """What one message says about one pose; quaternions are xyzw."""

    header: Any
    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float] | None = None
    body_velocity: tuple[float, float, float] | None = None
    covariance: Floats | None = None
    child_frame: str = ""


@dataclass(frozen=True)
class PoseColumns:
    """The poses of a topic.

    Attributes:
        stamps: (N,) int64, nanoseconds, of the headers.
        positions: (N, 3), metres.
        quaternions: (N, 4), xyzw, or None if the type has none.
        body_velocities: (N, 3), m/s, in the body, or None.
        covariances: (N, 6, 6), position first, or None.
        frames: (frame, child frame) as they follow each other, and the first row of each.
        undecodable: Number of messages that can't be decoded.
    """

    stamps: NDArray[np.int64]
    positions: Floats
    quaternions: Floats | None
    body_velocities: Floats | None
    covariances: Floats | None
    frames: list[tuple[int, str, str]]
    undecodable: int


@dataclass
class Transforms:
    """The transforms of one edge: of the child frame in the parent frame, in order of arrival."""

    stamps: array[int] = field(default_factory=lambda: array("q"))
    numbers: array[float] = field(default_factory=lambda: array("d"))  # x y z qx qy qz qw


class Undecodable:
    """Counts the messages that can't be decoded."""

    count = 0


def _odometry(message: Any) -> Pose:
    linear = message.twist.twist.linear
    return Pose(
        message.header,
        _xyz(message.pose.pose.position),
        _xyzw(message.pose.pose.orientation),
        _xyz(linear),
        message.pose.covariance,
        message.child_frame_id,
    )


def _pose_stamped(message: Any) -> Pose:
    return Pose(message.header, _xyz(message.pose.position), _xyzw(message.pose.orientation))


def _pose_with_covariance_stamped(message: Any) -> Pose:
    pose = message.pose.pose
    return Pose(
        message.header,
        _xyz(pose.position),
        _xyzw(pose.orientation),
        covariance=message.pose.covariance,
    )


def _transform_stamped(message: Any) -> Pose:
    return Pose(
        message.header,
        _xyz(message.transform.translation),
        _xyzw(message.transform.rotation),
        child_frame=message.child_frame_id,
    )


def _point_stamped(message: Any) -> Pose:
    return Pose(message.header, _xyz(message.point))


POSES: dict[str, Callable[[Any], Pose]] = {
    "nav_msgs/msg/Odometry": _odometry,
    "geometry_msgs/msg/PoseStamped": _pose_stamped,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _pose_with_covariance_stamped,
    "geometry_msgs/msg/TransformStamped": _transform_stamped,
    "geometry_msgs/msg/PointStamped": _point_stamped,
}
POSE_TYPES = (*POSES, PATH_TYPE)


def _xyz(vector: Any) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _xyzw(quaternion: Any) -> tuple[float, float, float, float]:
    return quaternion.x, quaternion.y, quaternion.z, quaternion.w


def _nanoseconds(header: Any) -> int:
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _decoded(payloads: Iterable[bytes], decode: Decode, failed: Undecodable) -> Iterator[Any]:
    """Yield the messages; the ones that can't be decoded are counted."""
    for payload in payloads:
        try:
            message = decode(payload)
        except Exception:  # of a dozen kinds: what a damaged payload raises is up to chance
            failed.count += 1
            continue
        yield message


def _poses(
    payloads: Iterable[bytes], decode: Decode, message_type: str, failed: Undecodable
) -> Iterator[Pose]:
    """Yield the poses of a topic; of paths the last one, the revised trajectory."""
    if message_type != PATH_TYPE:
        yield from map(POSES[message_type], _decoded(payloads, decode, failed))
        return
    last = None
    for payload in payloads:
        last = payload
    if last is not None:
        for path in _decoded([last], decode, failed):
            yield from map(_pose_stamped, path.poses)


def read_poses(payloads: Iterable[bytes], decode: Decode, message_type: str) -> PoseColumns:
    """Return the poses of the messages of one topic.

    Args:
        payloads: The serialised messages.
        decode: Makes a message of a payload, with the attributes that ROS gives it.
        message_type: One of `POSE_TYPES`.
    """
    failed = Undecodable()
    stamps, positions, quaternions = array("q"), array("d"), array("d")
    velocities, covariances = array("d"), bytearray()
    frames: list[tuple[int, str, str]] = []
    for pose in _poses(payloads, decode, message_type, failed):
        names = pose.header.frame_id.lstrip("/"), pose.child_frame.lstrip("/")
        if not frames or frames[-1][1:] != names:
            frames.append((len(stamps), *names))
        stamps.append(_nanoseconds(pose.header))
        positions.extend(pose.position)
        quaternions.extend(pose.quaternion or ())
        velocities.extend(pose.body_velocity or ())
        if pose.covariance is not None:
            covariances += pose.covariance.tobytes()
    return PoseColumns(
        np.array(stamps, dtype=np.int64),
        np.array(positions).reshape(-1, 3),
        np.array(quaternions).reshape(-1, 4) if quaternions else None,
        np.array(velocities).reshape(-1, 3) if velocities else None,
        np.frombuffer(covariances, dtype=np.float64).reshape(-1, 6, 6) if covariances else None,
        frames,
        failed.count,
    )


def read_transforms(
    payloads: Iterable[bytes], decode: Decode, edges: dict[tuple[str, str], Transforms]
) -> int:
    """Add the transforms of TF messages to their edges (parent, child).

    Returns:
        The number of messages that can't be decoded.
    """
    failed = Undecodable()
    for message in _decoded(payloads, decode, failed):
        for transform in message.transforms:
            pose = _transform_stamped(transform)
            names = pose.header.frame_id.lstrip("/"), pose.child_frame.lstrip("/")
            edge = edges.setdefault(names, Transforms())
            edge.stamps.append(_nanoseconds(pose.header))
            edge.numbers.extend(pose.position)
            edge.numbers.extend(pose.quaternion or ())
    return failed.count
