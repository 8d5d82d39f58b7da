"""Trajectories to a rosbag2, without ROS."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.io.temporary import temporary_folder

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

ODOMETRY = "nav_msgs/msg/Odometry"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"


def write_bag(
    path: Path,
    topics: Mapping[str, tuple[Trajectory, str]],
    storage: Literal["mcap", "sqlite3"] = "mcap",
) -> None:
    """Write a bag directory; it appears under its name when it is complete.

    Equal trajectories give equal bytes: log times are the stamps, and messages lie in their order.

    Args:
        path: The directory, which must not exist yet; its parent must.
        topics: Trajectory and message type by topic. The type is `nav_msgs/msg/Odometry` (with
            velocity and covariance, zeros where the trajectory has none) or
            `geometry_msgs/msg/PoseStamped`.
        storage: The file format inside.

    Raises:
        InputError: The path exists, a type is unknown, or a stamp is before 1970 or after 2038.
    """
    if path.exists():
        raise InputError(f"{path} exists already; choose another name or remove it")
    for topic, (trajectory, message_type) in topics.items():
        if message_type not in (ODOMETRY, POSE_STAMPED):
            raise InputError(
                f"{topic} can't be written as {message_type}; use {ODOMETRY} or {POSE_STAMPED}"
            )
        if len(trajectory) and not (
            trajectory.stamps.min() >= 0 and trajectory.stamps.max() < 2**31 * NANOSECONDS
        ):
            raise InputError(f"{topic} has stamps that ROS can't hold: before 1970 or after 2038")
    try:
        with temporary_folder(path.name, path.parent) as folder:
            complete = folder / path.name
            _write(complete, topics, storage)
            complete.rename(path)
    except OSError as error:
        raise InputError(f"{path} can't be written: {error.strerror or error}") from error


def _write(
    path: Path, topics: Mapping[str, tuple[Trajectory, str]], storage: Literal["mcap", "sqlite3"]
) -> None:
    """Write all messages, merged by time."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    plugin = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}[storage]
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections, messages, stamps = [], [], []
        for topic, (trajectory, message_type) in topics.items():
            connections.append(writer.add_connection(topic, message_type, typestore=store))
            ordered = trajectory.in_order()
            messages.append(_messages(store, ordered, message_type))
            stamps.append(ordered.stamps)
        owners = np.repeat(np.arange(len(stamps)), [len(each) for each in stamps])
        times = np.concatenate([*stamps, np.zeros(0, dtype=np.int64)])
        for row in np.argsort(times, kind="stable").tolist():
            owner = owners[row]
            writer.write(connections[owner], int(times[row]), next(messages[owner]))


def _messages(
    store: Typestore, trajectory: Trajectory, message_type: str
) -> Iterator[bytes | memoryview]:
    """Yield the serialised messages of a trajectory, one per state."""
    types = store.types
    Pose = types["geometry_msgs/msg/Pose"]
    Point = types["geometry_msgs/msg/Point"]
    Quaternion = types["geometry_msgs/msg/Quaternion"]
    Vector3 = types["geometry_msgs/msg/Vector3"]
    count = len(trajectory)
    quaternions = trajectory.quaternions
    if quaternions is None:
        quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    velocities = _body_velocities(trajectory)
    covariances = np.zeros((count, 36))
    if trajectory.covariances is not None:
        covariances = trajectory.covariances.reshape(count, 36)
    nothing = np.zeros(36)
    for row in range(count):
        pose: Any = Pose(Point(*trajectory.positions[row]), Quaternion(*quaternions[row]))
        header = _header(types, int(trajectory.stamps[row]), trajectory.frame)
        if message_type == POSE_STAMPED:
            message = types[POSE_STAMPED](header, pose)
        else:
            linear = Vector3(*velocities[row])
            twist = types["geometry_msgs/msg/Twist"](linear, Vector3(0.0, 0.0, 0.0))
            message = types[ODOMETRY](
                header,
                trajectory.child_frame,
                types["geometry_msgs/msg/PoseWithCovariance"](pose, covariances[row]),
                types["geometry_msgs/msg/TwistWithCovariance"](twist, nothing),
            )
        yield store.serialize_cdr(message, message_type)


def _body_velocities(trajectory: Trajectory) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the velocities (N, 3) in the body, as Odometry wants them; zeros if unknown."""
    if trajectory.velocities is None:
        return np.zeros((len(trajectory), 3))
    if trajectory.rotations is None:
        return trajectory.velocities
    return np.asarray(trajectory.rotations.inv().apply(trajectory.velocities))


def _header(types: Mapping[str, Any], stamp: int, frame: str) -> Any:
    """Return a std_msgs/Header."""
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    time = types["builtin_interfaces/msg/Time"](seconds, nanoseconds)
    return types["std_msgs/msg/Header"](time, frame)
