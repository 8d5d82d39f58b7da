"""Bags of all kinds, compared with plain deserialisation by rosbags, and damaged ones."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation
from strategies import SAME_ROTATION_RAD, make_groundtruth

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.write_bag import ODOMETRY, POSE_STAMPED, write_bag
from trajeval_ros.io.sources import read_trajectory

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES: Any = STORE.types
Make = Callable[..., Path]


def header(stamp: int, frame: str = "map") -> Any:
    time = TYPES["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
    return TYPES["std_msgs/msg/Header"](time, frame)


def pose(x: float = 1.0, w: float = 1.0, yaw: float = 0.5) -> Any:
    return TYPES["geometry_msgs/msg/Pose"](
        TYPES["geometry_msgs/msg/Point"](x, 2.0, 3.0),
        TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, yaw, w),
    )


def pose_stamped(stamp: int, x: float = 1.0, frame: str = "map") -> Any:
    return TYPES[POSE_STAMPED](header(stamp, frame), pose(x))


def write(path: Path, messages: list[tuple[str, str, int, Any]], **options: Any) -> Path:
    """Write (topic, type, log time, message or bytes) to a bag."""
    plugin = options.pop("storage", StoragePlugin.MCAP)
    writer = Writer(path, version=9, storage_plugin=plugin)
    if "compression" in options:
        writer.set_compression(options["compression"], CompressionFormat.ZSTD)
    with writer:
        connections: dict[tuple[str, str], Any] = {}
        for topic, kind, stamp, message in messages:
            if (topic, kind) not in connections:
                connections[topic, kind] = writer.add_connection(topic, kind, typestore=STORE)
            data = message if isinstance(message, bytes) else STORE.serialize_cdr(message, kind)
            writer.write(connections[topic, kind], stamp, data)
    return path


def simple(path: Path, count: int = 20, **options: Any) -> Path:
    return write(
        path,
        [
            ("/pose", POSE_STAMPED, row * 10**8, pose_stamped(10**18 + row * 10**8, float(row)))
            for row in range(count)
        ],
        **options,
    )


def the_file(bag: Path) -> Path:
    return next(file for file in bag.iterdir() if file.suffix in (".mcap", ".db3", ".zstd"))


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
    assert any("/odom is the only topic with poses" in note for note in read.notes)


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


def transform(stamp: int, parent: str, child: str, x: float = 0.0) -> Any:
    return TYPES["geometry_msgs/msg/TransformStamped"](
        header(stamp, parent),
        child,
        TYPES["geometry_msgs/msg/Transform"](
            TYPES["geometry_msgs/msg/Vector3"](x, 2.0, 3.0),
            TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.6, 0.8),
        ),
    )


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
    assert any("frame_id changes from" in note and "pose 3" in note for note in read.notes)


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
    assert any("metadata.yaml ignored" in note for note in read.notes) == (metadata is not None)


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


def plain_messages(path: Path, topic: str) -> Iterator[Any]:
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        wanted = [each for each in reader.connections if each.topic == topic]
        for connection, _, payload in reader.messages(wanted):
            yield reader.deserialize(payload, connection.msgtype)


@pytest.mark.parametrize(
    ("bag", "topic"), [("ROS_example.bag", "S-PTAM"), ("nav2_turtlebot.mcap", "/odom")]
)
def test_columns_equal_plain_deserialisation(bag: str, topic: str, shared_data: Path) -> None:
    path = shared_data / "bags" / bag
    read = read_trajectory(f"{path}:{topic}")
    messages = list(plain_messages(path, topic))
    stamps = [each.header.stamp.sec * 10**9 + each.header.stamp.nanosec for each in messages]
    poses = [each.pose.pose if hasattr(each, "twist") else each.pose for each in messages]
    assert read.stamps.tolist() == stamps
    expected = [[each.position.x, each.position.y, each.position.z] for each in poses]
    np.testing.assert_array_equal(read.positions, expected)
    q = [each.orientation for each in poses]
    rotations = Rotation.from_quat([[each.x, each.y, each.z, each.w] for each in q])
    assert read.rotations is not None
    assert (read.rotations * rotations.inv()).magnitude().max() <= SAME_ROTATION_RAD
    if hasattr(messages[0], "twist"):
        twists = [each.twist.twist.linear for each in messages]
        expected = rotations.apply([[each.x, each.y, each.z] for each in twists])
        np.testing.assert_allclose(read.velocities, expected, atol=1e-15)


# What can't be read, and what is said about it.


def bare_mcap(tmp_path: Path) -> Path:
    return the_file(simple(tmp_path / "bag", 2000))


def bare_db3(tmp_path: Path) -> Path:
    return the_file(simple(tmp_path / "bag", 2000, storage=StoragePlugin.SQLITE3))


def bare_ros1(tmp_path: Path) -> Path:
    store: Any = get_typestore(Stores.ROS1_NOETIC)
    path = tmp_path / "ros1.bag"
    with Ros1Writer(path) as writer:
        connection = writer.add_connection("/pose", POSE_STAMPED, typestore=store)
        types = store.types
        for row in range(2000):
            message = types[POSE_STAMPED](
                types["std_msgs/msg/Header"](
                    row, types["builtin_interfaces/msg/Time"](100 + row, 5), "map"
                ),
                types["geometry_msgs/msg/Pose"](
                    types["geometry_msgs/msg/Point"](float(row), 0.0, 0.0),
                    types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.6, 0.8),
                ),
            )
            writer.write(connection, row, store.serialize_ros1(message, POSE_STAMPED))
    return path


BARE = [bare_mcap, bare_db3, bare_ros1]


@pytest.mark.parametrize("make", BARE)
@pytest.mark.parametrize("share", [0.0, 0.0001, 0.001, 0.3, 0.9, 0.9999])
def test_truncated_bags(make: Make, share: float, tmp_path: Path) -> None:
    path = make(tmp_path)
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])
    said = refusal(path) or "; ".join(read_trajectory(str(path)).damage)
    assert said
    assert "\n" not in said
    assert path.name in said
    with pytest.raises(InputError):
        read_trajectory(str(path), strict=True)


def refusal(path: Path) -> str:
    """Return why the path is refused, "" if it is read."""
    try:
        read_trajectory(str(path))
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("make", BARE)
def test_damaged_bags_never_end_in_a_traceback(make: Make, tmp_path: Path) -> None:
    path = make(tmp_path)
    content = path.read_bytes()
    random = np.random.default_rng(0)
    for _ in range(60):
        damaged = bytearray(content)
        for place in random.integers(0, len(content), random.integers(1, 30)):
            damaged[place] = random.integers(0, 256)
        path.write_bytes(damaged)
        assert "\n" not in refusal(path)


@pytest.mark.parametrize("name", ["x.mcap", "x.db3", "x.bag"])
@pytest.mark.parametrize("content", [b"", b"garbage" * 100, bytes(1000)])
def test_files_that_only_are_called_bags(name: str, content: bytes, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=name):
        read_trajectory(f"{tmp_path / name}")


@pytest.mark.parametrize("beginning", [b"\x89MCAP0\r\n", b"SQLite format 3\0", b"#ROSBAG V2.0\n"])
def test_only_the_magic(beginning: bytes, tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(beginning)
    with pytest.raises(InputError, match=r"can't be read as a bag|it is truncated"):
        read_trajectory(str(tmp_path / "x"))


@pytest.mark.parametrize(
    ("name", "beginning", "tool"),
    [
        ("x.db3", b"SQLite format 3\0", "ros2 bag reindex"),
        ("x.bag", b"#ROSBAG V2.0\n", "rosbag reindex"),
    ],
)
def test_advice_names_the_program_for_the_format(
    name: str, beginning: bytes, tool: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(beginning)
    with pytest.raises(InputError, match=f"try `{tool}`$"):
        read_trajectory(str(tmp_path / name))


def test_a_directory_that_is_no_bag(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a directory without a bag"):
        read_trajectory(str(tmp_path))


def test_messages_in_a_log_are_read(tmp_path: Path) -> None:
    path = bare_db3(tmp_path)
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("DELETE FROM messages WHERE id > 5")
    connection.commit()
    copy = tmp_path / "copy"
    copy.mkdir()
    for suffix in ("", "-wal"):
        shutil.copy(f"{path}{suffix}", copy / f"unfinished.db3{suffix}")
    connection.close()
    read = read_trajectory(str(copy / "unfinished.db3"))
    assert len(read) == 5
    assert not read.damage
    (copy / "unfinished.db3-wal").write_bytes(b"no log")
    assert len(read_trajectory(str(copy / "unfinished.db3"))) == 2000


def test_a_missing_topic_lists_the_nearest_first(tmp_path: Path) -> None:
    messages = [
        (topic, POSE_STAMPED, 1, pose_stamped(10**9)) for topic in ("/vicon", "/odom", "/pose")
    ]
    bag = write(tmp_path / "bag", messages)
    with pytest.raises(InputError, match="has no topic /odmo; it has /odom, "):
        read_trajectory(f"{bag}:/odmo")
    with pytest.raises(
        InputError,
        match=r"several topics with poses; choose one .* of /odom, "
        r"/pose, /vicon",
    ):
        read_trajectory(str(bag))


def test_a_topic_without_poses_says_where_they_are(tmp_path: Path) -> None:
    kind = "std_msgs/msg/String"
    text = TYPES[kind]("hello")
    bag = write(
        tmp_path / "bag",
        [("/text", kind, 1, text), ("/pose", POSE_STAMPED, 1, pose_stamped(10**9))],
    )
    with pytest.raises(InputError, match=f"/text has type {kind}, not poses; poses are on /pose"):
        read_trajectory(f"{bag}:/text")
    only_text = write(tmp_path / "text", [("/text", kind, 1, text)])
    with pytest.raises(InputError, match="has no topic with poses, only std_msgs/msg/String"):
        read_trajectory(str(only_text))


def test_stamps_that_are_no_times(tmp_path: Path) -> None:
    def bag(name: str, stamps: list[int]) -> str:
        messages = [
            ("/p", POSE_STAMPED, row, pose_stamped(t, row)) for row, t in enumerate(stamps)
        ]
        return str(write(tmp_path / name, messages))

    with pytest.raises(InputError, match=r"header\.stamp: all timestamps are zero"):
        read_trajectory(bag("zero", [0, 0, 0]))
    with pytest.raises(InputError, match=r"all timestamps \(3\) are equal"):
        read_trajectory(bag("same", [10**18] * 3))
    some = read_trajectory(bag("some", [0, 10**18, 10**18 + 1, 10**18 + 2]))
    assert some.dropped == {"zero_stamp": 1}
    assert len(read_trajectory(bag("from zero", [0, 10**9, 2 * 10**9]))) == 3
    assert len(read_trajectory(bag("one", [10**18]))) == 1


def test_messages_that_cannot_be_decoded_are_counted(tmp_path: Path) -> None:
    messages: list[tuple[str, str, int, Any]] = [
        ("/p", POSE_STAMPED, row, pose_stamped(10**18 + row, row)) for row in range(5)
    ]
    bag = write(tmp_path / "some", [*messages, ("/p", POSE_STAMPED, 9, b"\0\1\0\0short")])
    assert read_trajectory(str(bag)).dropped == {"undecodable": 1}
    bag = write(tmp_path / "none", [("/p", POSE_STAMPED, 9, b"\0\1\0\0short")])
    with pytest.raises(InputError, match="none of its 1 messages can be decoded"):
        read_trajectory(str(bag))


def test_nan_everywhere(tmp_path: Path) -> None:
    messages = [
        ("/p", POSE_STAMPED, row, pose_stamped(10**18 + row, float("nan"))) for row in range(3)
    ]
    with pytest.raises(InputError, match="no valid pose in 3 messages"):
        read_trajectory(str(write(tmp_path / "bag", messages)))


def test_progress_counts_messages(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    bag = simple(tmp_path / "bag", 2500)
    read_trajectory(str(bag), advance=lambda done, total: seen.append((done, total)))
    assert seen == sorted(seen)
    assert seen[-1] == (2500, 2500)
