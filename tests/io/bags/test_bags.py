"""Bags of all kinds, compared with plain deserialisation by rosbags."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_bags import TYPES, header, pose, pose_stamped, simple, the_file, transform, write
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation
from strategies import SAME_ROTATION_RAD, make_groundtruth

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.write_bag import ODOMETRY, POSE_STAMPED, write_bag
from trajeval_ros.io.sources import read_trajectory


@pytest.fixture
def trajectory() -> Trajectory:
    truth = make_groundtruth(3)
    random = np.random.default_rng(0)
    factors = random.normal(size=(len(truth), 6, 6))
    return Trajectory(
        truth.stamps,
        truth.positions,
        truth.quaternions,
        velocities=truth.velocities,
        covariances=factors @ np.swapaxes(factors, 1, 2),
        frame="odom",
        child_frame="imu",
    )


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_what_is_written_is_read_again(
    storage: Any, trajectory: Trajectory, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    write_bag(bag, {"/odom": (trajectory, ODOMETRY), "/gt": (trajectory, POSE_STAMPED)}, storage)
    for source in (f"{bag}:/odom", f"{bag}:odom", f"{the_file(bag)}:/odom"):
        read = read_trajectory(source)
        np.testing.assert_array_equal(read.stamps, trajectory.stamps)
        np.testing.assert_array_equal(read.positions, trajectory.positions)
        np.testing.assert_array_equal(read.covariances, trajectory.covariances)
        np.testing.assert_allclose(read.velocities, trajectory.velocities, atol=1e-14)
        assert read.rotations is not None
        assert trajectory.rotations is not None
        apart = (read.rotations * trajectory.rotations.inv()).magnitude()
        assert apart.max() <= SAME_ROTATION_RAD
        assert (read.frame, read.child_frame) == ("odom", "imu")
    poses = read_trajectory(f"{bag}:/gt")
    np.testing.assert_array_equal(poses.positions, trajectory.positions)
    assert poses.velocities is None
    assert poses.covariances is None


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_equal_trajectories_make_equal_bytes(
    storage: Any, trajectory: Trajectory, tmp_path: Path
) -> None:
    contents = []
    for _ in range(2):
        write_bag(tmp_path / "bag", {"/odom": (trajectory, ODOMETRY)}, storage)
        contents.append(
            {file.name: file.read_bytes() for file in sorted((tmp_path / "bag").iterdir())}
        )
        shutil.rmtree(tmp_path / "bag")
    assert contents[0] == contents[1]
    assert not list(tmp_path.iterdir())


def test_a_bag_is_never_overwritten(trajectory: Trajectory, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    with pytest.raises(InputError, match="exists; choose another name"):
        write_bag(tmp_path / "bag", {"/odom": (trajectory, ODOMETRY)})
    with pytest.raises(InputError, match="can't be written as std_msgs/msg/String"):
        write_bag(tmp_path / "other", {"/odom": (trajectory, "std_msgs/msg/String")})


def test_velocity_without_twist_and_covariance_of_zeros_are_unknown(
    trajectory: Trajectory, tmp_path: Path
) -> None:
    bare = Trajectory(trajectory.stamps, trajectory.positions, trajectory.quaternions)
    write_bag(tmp_path / "bag", {"/odom": (bare, ODOMETRY)})
    read = read_trajectory(str(tmp_path / "bag"))
    assert read.velocities is None
    assert read.covariances is None
    assert any(
        "/odom is the only topic with poses" in note for note in read.reading.messages(Level.NOTE)
    )


OTHER_TYPES: dict[str, Callable[[int, float], Any]] = {
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda stamp, x: TYPES[
        "geometry_msgs/msg/PoseWithCovarianceStamped"
    ](
        header(stamp),
        TYPES["geometry_msgs/msg/PoseWithCovariance"](pose(x), np.eye(6).ravel()),
    ),
    "geometry_msgs/msg/TransformStamped": lambda stamp, x: transform(stamp, "map", "base", x),
    "geometry_msgs/msg/PointStamped": lambda stamp, x: TYPES["geometry_msgs/msg/PointStamped"](
        header(stamp), TYPES["geometry_msgs/msg/Point"](x, 2.0, 3.0)
    ),
}


@pytest.mark.parametrize("kind", OTHER_TYPES)
def test_other_types(kind: str, tmp_path: Path) -> None:
    messages = [("/t", kind, row, OTHER_TYPES[kind](10**9 + row, float(row))) for row in range(5)]
    read = read_trajectory(str(write(tmp_path / "bag", messages)))
    assert read.stamps.tolist() == [10**9 + row for row in range(5)]
    np.testing.assert_array_equal(read.positions, [[row, 2.0, 3.0] for row in range(5)])
    assert (read.rotations is None) == kind.endswith("PointStamped")
    assert (read.covariances is not None) == ("Covariance" in kind)


def test_the_last_path_is_the_trajectory(tmp_path: Path) -> None:
    kind = "nav_msgs/msg/Path"
    messages = [
        (
            "/path",
            kind,
            count,
            TYPES[kind](
                header(7), [pose_stamped(10**9 + row, row * count) for row in range(count)]
            ),
        )
        for count in (2, 3, 4)
    ]
    read = read_trajectory(str(write(tmp_path / "bag", messages)))
    assert read.stamps.tolist() == [10**9 + row for row in range(4)]
    assert read.positions[:, 0].tolist() == [0.0, 4.0, 8.0, 12.0]


def test_header_stamps_count_and_not_log_times(tmp_path: Path) -> None:
    read = read_trajectory(str(simple(tmp_path / "bag")))
    assert read.stamps[0] == 10**18


def test_a_change_of_frame_is_noted(tmp_path: Path) -> None:
    messages = [
        ("/pose", POSE_STAMPED, row, pose_stamped(10**9 + row, row, "map" if row < 3 else "odom"))
        for row in range(6)
    ]
    read = read_trajectory(str(write(tmp_path / "bag", messages)))
    assert any(
        "frame_id changes from" in note and "pose 3" in note
        for note in read.reading.messages(Level.NOTE)
    )


def test_ros1(tmp_path: Path) -> None:
    store: Any = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    path = tmp_path / "odometry.bag"
    rotation = Rotation.from_rotvec([0.1, 0.2, 0.3])
    with Ros1Writer(path) as writer:
        connection = writer.add_connection("odom", ODOMETRY, typestore=store)
        for row in range(10):
            body = types["geometry_msgs/msg/Vector3"](1.0, 0.0, float(row))
            message = types[ODOMETRY](
                types["std_msgs/msg/Header"](
                    row, types["builtin_interfaces/msg/Time"](100 + row, 5), "/world"
                ),
                "body",
                types["geometry_msgs/msg/PoseWithCovariance"](
                    types["geometry_msgs/msg/Pose"](
                        types["geometry_msgs/msg/Point"](float(row), 0.0, 0.0),
                        types["geometry_msgs/msg/Quaternion"](*rotation.as_quat()),
                    ),
                    np.eye(6).ravel(),
                ),
                types["geometry_msgs/msg/TwistWithCovariance"](
                    types["geometry_msgs/msg/Twist"](body, body), np.zeros(36)
                ),
            )
            writer.write(connection, row, store.serialize_ros1(message, ODOMETRY))
    for source in (str(path), f"{path}:/odom", f"{path}:odom"):
        read = read_trajectory(source)
        assert read.stamps.tolist() == [(100 + row) * 10**9 + 5 for row in range(10)]
        assert (read.frame, read.child_frame) == ("world", "body")
        expected = rotation.apply([[1.0, 0.0, row] for row in range(10)])
        np.testing.assert_allclose(read.velocities, expected, atol=1e-14)


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("compression", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_compressed_directories(storage: Any, compression: Any, tmp_path: Path) -> None:
    bag = simple(tmp_path / "bag", storage=storage, compression=compression)
    assert len(read_trajectory(str(bag))) == 20


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("metadata", [None, "", "{", "rosbag2_bagfile_information: {}"])
def test_a_directory_without_good_metadata(
    storage: Any, metadata: str | None, tmp_path: Path
) -> None:
    bag = simple(tmp_path / "bag", storage=storage)
    (bag / "metadata.yaml").unlink()
    if metadata is not None:
        (bag / "metadata.yaml").write_text(metadata)
    read = read_trajectory(str(bag))
    assert len(read) == 20
    assert any("metadata.yaml ignored" in note for note in read.reading.messages(Level.NOTE)) == (
        metadata is not None
    )


def test_one_odd_topic_does_not_lose_the_bag(shared_data: Path) -> None:
    source = shared_data / "bags/rosbag2_fixtures/topics_and_services.mcap"
    with pytest.raises(InputError, match="no topic with poses, only"):
        read_trajectory(str(source))


@pytest.mark.parametrize(
    ("source", "count", "length"),
    [
        ("ROS_example.bag:/groundtruth", 12765, 304.207),
        ("ROS_example.bag:ORB-SLAM", 8362, 264.793),
        ("ROS_example.bag:/S-PTAM", 5439, 259.680),
        ("nav2_turtlebot.mcap:/odom", 2639, 34.322),
        ("nav2_turtlebot.mcap:/amcl_pose", 135, 34.450),
    ],
)
def test_real_bags(source: str, count: int, length: float, shared_data: Path) -> None:
    read = read_trajectory(str(shared_data / "bags" / source))
    assert len(read) == count
    assert read.path_length_m == pytest.approx(length, abs=1e-3)


def test_progress_counts_messages(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    bag = simple(tmp_path / "bag", 2500)
    read_trajectory(str(bag), advance=lambda done, total: seen.append((done, total)))
    assert seen == sorted(seen)
    assert seen[-1] == (2500, 2500)
