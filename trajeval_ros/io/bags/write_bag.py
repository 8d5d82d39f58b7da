"""Trajectories to a rosbag2, without ROS."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.inertial import InertialReadings
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.io.bags.encode_messages import (
    encode_fixes,
    encode_imu,
    encode_odometry,
    encode_path,
    encode_stamped,
    encode_transforms,
)
from trajeval_ros.io.bags.pose_messages import FIX_TYPE, PATH_TYPE
from trajeval_ros.io.writing import refused_by_disk, temporary_folder

ODOMETRY = "nav_msgs/msg/Odometry"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
IMU = "sensor_msgs/msg/Imu"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
TRANSFORM_TOPIC = "/tf"
Storage = Literal["mcap", "sqlite3"]

# Topic, type, log times and messages.
_Serialised = tuple[str, str, Stamps, Iterable[memoryview]]


def write_bag(
    path: Path,
    topics: Mapping[str, tuple[Trajectory, str]],
    storage: Storage = "mcap",
    transforms: Sequence[Trajectory] = (),
    inertial: Mapping[str, InertialReadings] | None = None,
) -> None:
    """Write a bag directory, which gets its name when it is complete.

    Equal trajectories give equal bytes: messages are in order of their log times, which are the
    receive times of the trajectory, or else the stamps.

    Args:
        path: The directory, which must not exist yet; its parent must.
        topics: Trajectory and message type by topic. The type is `nav_msgs/msg/Odometry` (with
            velocity and covariance, zeros where the trajectory has none),
            `geometry_msgs/msg/PoseStamped`, `nav_msgs/msg/Path` (one message with all poses), or
            of a trajectory with fixes `sensor_msgs/msg/NavSatFix`.
        transforms: Trajectories to write to `/tf`, of their child frames in their frames.
    """
    if path.exists():
        raise InputError(f"{path} exists; choose another name or remove it")
    types = (ODOMETRY, POSE_STAMPED, PATH_TYPE, FIX_TYPE)
    for topic, (item, message_type) in topics.items():
        if message_type not in types or (message_type == FIX_TYPE and item.reading.fixes is None):
            raise InputError(
                f"{topic} can't be written as {message_type}; use {' or '.join(types)}"
            )
    written = {topic: trajectory for topic, (trajectory, _) in topics.items()}
    for topic, item in (
        *written.items(),
        *((TRANSFORM_TOPIC, transform) for transform in transforms),
    ):
        if len(item) and not (item.stamps.min() >= 0 and item.stamps.max() < 2**31 * NANOSECONDS):
            raise InputError(
                f"{topic} has timestamps before 1970 or after 2038, which ROS can't represent"
            )
    try:
        with temporary_folder(path.name, path.parent) as folder:
            complete = folder / path.name
            messages = [*_serialised(topics, transforms), *_serialised_imus(inertial or {})]
            _write(complete, messages, storage)
            complete.rename(path)
    except OSError as error:
        raise InputError(f"{path} can't be written: {error.strerror or error}") from error


def write_mcap(
    path: Path, topics: Mapping[str, tuple[Trajectory, str]], transforms: Sequence[Trajectory] = ()
) -> None:
    """Write one MCAP file with the contents of `write_bag`, completely or not at all."""
    if path.exists():
        raise InputError(f"{path} exists; choose another name or remove it")
    with refused_by_disk(str(path)), temporary_folder(path.name, path.parent) as folder:
        bag = folder / path.stem
        write_bag(bag, topics, "mcap", transforms)
        (bag / f"{path.stem}.mcap").rename(path)


def _write(path: Path, messages: Sequence[_Serialised], storage: Storage) -> None:
    """Write all messages, merged by time."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    plugin = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}[storage]
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        types = {topic: message_type for topic, message_type, *_ in messages}
        connections = {
            topic: writer.add_connection(topic, message_type, typestore=store)
            for topic, message_type in types.items()
        }
        owners = np.repeat(np.arange(len(messages)), [len(stamps) for _, _, stamps, _ in messages])
        times = np.concatenate(
            [*(message[2] for message in messages), np.zeros(0, dtype=np.int64)]
        )
        order = np.argsort(times, kind="stable")
        sources = [(connections[topic], iter(payloads)) for topic, _, _, payloads in messages]
        for owner, time in zip(owners[order].tolist(), times[order].tolist(), strict=True):
            connection, payloads = sources[owner]
            writer.write(connection, time, next(payloads))


def _serialised(
    topics: Mapping[str, tuple[Trajectory, str]], transforms: Sequence[Trajectory]
) -> list[_Serialised]:
    """Return topic, type, times and messages of all trajectories."""
    serialised: list[_Serialised] = []
    for topic, (unordered, message_type) in topics.items():
        trajectory = unordered.in_order()
        logged, frame = trajectory.stamps, trajectory.frame
        if message_type == PATH_TYPE:
            payload = encode_path(logged, trajectory.positions, _poses(trajectory)[:, 3:], frame)
            serialised.append((topic, message_type, logged[-1:], [memoryview(payload)]))
            continue
        receive_times = trajectory.reading.receive_times
        if receive_times is not None:
            order = np.argsort(receive_times.times, kind="stable")
            trajectory, logged = trajectory[order], receive_times.times[order]
        stamps = trajectory.stamps
        if message_type == FIX_TYPE:
            assert trajectory.reading.fixes is not None
            rows = encode_fixes(stamps, trajectory.reading.fixes, trajectory.child_frame)
        elif message_type == POSE_STAMPED:
            rows = encode_stamped(stamps, _poses(trajectory), frame)
        else:
            covariances = trajectory.covariances
            rows = encode_odometry(
                stamps,
                _poses(trajectory),
                np.zeros((1, 36)) if covariances is None else covariances.reshape(-1, 36),
                _body_velocities(trajectory),
                (frame, trajectory.child_frame),
            )
        serialised.append((topic, message_type, logged, map(memoryview, rows)))
    for transform in transforms:
        trajectory = transform.in_order()
        rows = encode_transforms(
            trajectory.stamps, _poses(trajectory), (trajectory.frame, trajectory.child_frame)
        )
        serialised.append((TRANSFORM_TOPIC, TRANSFORMS, trajectory.stamps, map(memoryview, rows)))
    return serialised


def _serialised_imus(inertial: Mapping[str, InertialReadings]) -> list[_Serialised]:
    """Return topic, type, times and messages of IMUs."""
    serialised: list[_Serialised] = []
    for topic, readings in inertial.items():
        assert readings.accelerations is not None
        rows = encode_imu(readings.stamps, readings.rates, readings.accelerations, readings.frame)
        serialised.append((topic, IMU, readings.stamps, map(memoryview, rows)))
    return serialised


def _poses(trajectory: Trajectory) -> Floats:
    """Return positions and quaternions (N, 7), identities if the latter are unknown."""
    return np.hstack([trajectory.positions, trajectory.known_quaternions])


def _body_velocities(trajectory: Trajectory) -> Floats:
    """Return the velocities (N, 3) in the body, as in Odometry; zeros if unknown."""
    if trajectory.velocities is None:
        return np.zeros((len(trajectory), 3))
    if trajectory.rotations is None:
        return trajectory.velocities
    return np.asarray(trajectory.rotations.inv().apply(trajectory.velocities))
