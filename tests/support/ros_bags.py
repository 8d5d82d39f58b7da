"""Bags of messages that nobody would record on purpose, and of some that everybody does."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory

STORE = get_typestore(Stores.ROS2_JAZZY)
POSE, ODOM = "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Odometry"
POINT, PATH = "geometry_msgs/msg/PointStamped", "nav_msgs/msg/Path"
TRANSFORMS = "tf2_msgs/msg/TFMessage"

# Topic, type, log time in ns, payload.
Message = tuple[str, str, int, bytes]
# Parent, child, stamp, translation, quaternion xyzw.
Transform = tuple[str, str, int, Sequence[float], Sequence[float]]


def pose_message(
    stamp: int, position: Sequence[float], quaternion: Sequence[float], frame: str = "world"
) -> bytes:
    return _serialised(POSE, _pose_stamped(stamp, position, quaternion, frame))


def point_message(stamp: int, position: Sequence[float], frame: str = "world") -> bytes:
    types = STORE.types
    point = types["geometry_msgs/msg/Point"](*position)
    return _serialised(POINT, types[POINT](_header(stamp, frame), point))


def path_message(
    stamps: Sequence[int],
    positions: Sequence[Sequence[float]],
    quaternions: Sequence[Sequence[float]],
    frame: str = "map",
) -> bytes:
    poses = [
        _pose_stamped(*item, frame) for item in zip(stamps, positions, quaternions, strict=True)
    ]
    return _serialised(PATH, STORE.types[PATH](_header(stamps[-1], frame), poses))


def odometry_message(
    stamp: int,
    position: Sequence[float],
    quaternion: Sequence[float],
    body_velocity: Sequence[float] = (0.0, 0.0, 0.0),
    covariance: Any = None,
    body_rate: Sequence[float] = (0.0, 0.0, 0.0),
) -> bytes:
    types = STORE.types
    Vector3 = types["geometry_msgs/msg/Vector3"]
    nothing = np.zeros(36)
    own = nothing if covariance is None else np.ravel(covariance)
    pose = types["geometry_msgs/msg/PoseWithCovariance"](_pose(position, quaternion), own)
    twist = types["geometry_msgs/msg/Twist"](Vector3(*body_velocity), Vector3(*body_rate))
    twist = types["geometry_msgs/msg/TwistWithCovariance"](twist, nothing)
    return _serialised(ODOM, types[ODOM](_header(stamp, "odom"), "base_link", pose, twist))


def transforms_message(*transforms: Transform) -> bytes:
    types = STORE.types
    stamped = [
        types["geometry_msgs/msg/TransformStamped"](
            _header(stamp, parent),
            child,
            types["geometry_msgs/msg/Transform"](
                types["geometry_msgs/msg/Vector3"](*map(float, translation)),
                types["geometry_msgs/msg/Quaternion"](*map(float, quaternion)),
            ),
        )
        for parent, child, stamp, translation, quaternion in transforms
    ]
    return _serialised(TRANSFORMS, types[TRANSFORMS](stamped))


def _serialised(kind: str, message: Any) -> bytes:
    return bytes(STORE.serialize_cdr(message, kind))


def _pose_stamped(
    stamp: int, position: Sequence[float], quaternion: Sequence[float], frame: str
) -> Any:
    return STORE.types[POSE](_header(stamp, frame), _pose(position, quaternion))


def _pose(position: Sequence[float], quaternion: Sequence[float]) -> Any:
    types = STORE.types
    rotation = types["geometry_msgs/msg/Quaternion"](*map(float, quaternion))
    place = types["geometry_msgs/msg/Point"](*map(float, position))
    return types["geometry_msgs/msg/Pose"](place, rotation)


def _header(stamp: int, frame: str) -> Any:
    types = STORE.types
    time = types["builtin_interfaces/msg/Time"](*divmod(int(stamp), NANOSECONDS))
    return types["std_msgs/msg/Header"](time, frame)


def messages_of(source: Trajectory, topic: str, kind: str, frame: str = "world") -> list[Message]:
    """Return a trajectory as messages, logged at their stamps."""
    assert source.quaternions is not None
    columns = source.stamps.tolist(), source.positions, source.quaternions
    if kind == POINT:
        return [
            (topic, kind, stamp, point_message(stamp, place))
            for stamp, place, _ in zip(*columns, strict=True)
        ]
    if kind == POSE:
        return [
            (topic, kind, stamp, pose_message(stamp, place, rotation, frame))
            for stamp, place, rotation in zip(*columns, strict=True)
        ]
    velocities = np.zeros((len(source), 3))
    if source.velocities is not None and source.rotations is not None:
        velocities = source.rotations.inv().apply(source.velocities)
    covariances: Any = [None] * len(source) if source.covariances is None else source.covariances
    rates, receive_times = np.zeros((len(source), 3)), source.reading.receive_times
    if receive_times is not None and receive_times.body_rates is not None:
        rates = receive_times.body_rates
    return [
        (topic, kind, item[0], odometry_message(*item))
        for item in zip(*columns, velocities, covariances, rates, strict=True)
    ]


def write_messages(path: Path, messages: Sequence[Message]) -> None:
    """Write a bag of messages in any order."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, log_time, payload in sorted(messages, key=lambda message: message[2]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], log_time, payload)
