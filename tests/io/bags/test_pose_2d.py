"""Messages without a header: poses in a plane are read, arrays of poses are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ros_bags import STORE, write_messages
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.sources import each_topic, read_trajectory

POSE_2D, ARRAY = "geometry_msgs/msg/Pose2D", "geometry_msgs/msg/PoseArray"
TIMES = [1_700_000_000_000_000_001, 1_700_000_000_100_000_000, 1_700_000_000_200_000_000]
PLACES = np.array([[1.5, 2.5, 0.25], [2.5, 2.5, -9.5], [3.5, 1.25, 3.0]])


def check(read: Trajectory) -> None:
    assert read.stamps.tolist() == TIMES
    np.testing.assert_array_equal(read.positions, np.column_stack([PLACES[:, :2], np.zeros(3)]))
    assert read.rotations is not None
    expected = Rotation.from_rotvec([[0.0, 0.0, theta] for theta in PLACES[:, 2]])
    assert (read.rotations * expected.inv()).magnitude().max() < 1e-14
    assert any("log times used" in note for note in read.reading.messages(Level.NOTE))


def test_a_pose_in_a_plane_has_the_time_of_its_recording(tmp_path: Path) -> None:
    kind = STORE.types[POSE_2D]
    messages = [
        ("/pose2d", POSE_2D, time, bytes(STORE.serialize_cdr(kind(*map(float, row)), POSE_2D)))
        for time, row in zip(TIMES, PLACES, strict=True)
    ]
    messages.append(("/pose2d", POSE_2D, TIMES[-1] + 1, b"\0\1\0\0short"))
    write_messages(tmp_path / "bag", messages)
    read = read_trajectory(tmp_path / "bag")
    check(read)
    assert read.reading.dropped["undecodable"] == 1


def test_of_ros_1(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    with Ros1Writer(tmp_path / "run.bag") as writer:
        connection = writer.add_connection("/pose2d", POSE_2D, typestore=store)
        for time, row in zip(TIMES, PLACES, strict=True):
            message = store.types[POSE_2D](*map(float, row))
            writer.write(connection, time, bytes(store.serialize_ros1(message, POSE_2D)))
    check(read_trajectory(tmp_path / "run.bag"))


def test_an_array_of_poses_is_no_trajectory(tmp_path: Path) -> None:
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](5, 0), "map")
    payload = bytes(STORE.serialize_cdr(types[ARRAY](header, []), ARRAY))
    write_messages(tmp_path / "bag", [("/particles", ARRAY, TIMES[0], payload)])
    bag = str(tmp_path / "bag")
    with pytest.raises(InputError, match=r"is not one pose; give .*:/particles\.poses\[0\]"):
        read_trajectory(f"{bag}:/particles")
    with pytest.raises(InputError):
        read_trajectory(bag)
    assert each_topic(bag) == [bag]
