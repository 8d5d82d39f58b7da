"""What can't be read from a bag, and what is said about it."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_bags import TYPES, Make, pose_stamped, refusal, simple, the_file, write
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.io.bags.write_bag import POSE_STAMPED
from trajeval_ros.io.sources import read_trajectory


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


@pytest.mark.slow
@pytest.mark.parametrize("make", BARE)
@pytest.mark.parametrize("share", [0.0, 0.0001, 0.001, 0.3, 0.9, 0.9999])
def test_truncated_bags(make: Make, share: float, tmp_path: Path) -> None:
    path = make(tmp_path)
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])
    text = refusal(path) or "; ".join(read_trajectory(str(path)).reading.messages(Level.ERROR))
    assert text
    assert "\n" not in text
    assert path.name in text
    with pytest.raises(InputError):
        read_trajectory(str(path), strict=True)


@pytest.mark.slow
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
    with pytest.raises(InputError, match=r"can't be read|it is truncated"):
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
    with pytest.raises(InputError, match=f"(try|use) `{tool}( x.bag)?`$"):
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
    assert not read.reading.messages(Level.ERROR)
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

    zero = read_trajectory(bag("zero", [0, 0, 0]))
    assert zero.stamps.tolist() == [0, 1, 2]  # the log times
    (remark,) = [item for item in zero.reading.remarks if item.code == "log_times"]
    assert remark.level is Level.WARNING
    with pytest.raises(InputError, match=r"header\.stamp: all timestamps are zero"):
        read_trajectory(bag("one message", [0]))
    with pytest.raises(InputError, match=r"all timestamps \(3\) are equal"):
        read_trajectory(bag("same", [10**18] * 3))
    some = read_trajectory(bag("some", [0, 10**18, 10**18 + 1, 10**18 + 2]))
    assert some.reading.dropped == {"zero_stamp": 1}
    assert len(read_trajectory(bag("from zero", [0, 10**9, 2 * 10**9]))) == 3
    assert len(read_trajectory(bag("one", [10**18]))) == 1


def test_messages_that_cannot_be_decoded_are_counted(tmp_path: Path) -> None:
    messages: list[tuple[str, str, int, Any]] = [
        ("/p", POSE_STAMPED, row, pose_stamped(10**18 + row, row)) for row in range(5)
    ]
    bag = write(tmp_path / "some", [*messages, ("/p", POSE_STAMPED, 9, b"\0\1\0\0short")])
    assert read_trajectory(str(bag)).reading.dropped == {"undecodable": 1}
    bag = write(tmp_path / "none", [("/p", POSE_STAMPED, 9, b"\0\1\0\0short")])
    with pytest.raises(InputError, match="none of its 1 messages can be decoded"):
        read_trajectory(str(bag))


def test_nan_everywhere(tmp_path: Path) -> None:
    messages = [
        ("/p", POSE_STAMPED, row, pose_stamped(10**18 + row, float("nan"))) for row in range(3)
    ]
    with pytest.raises(InputError, match="no valid pose in 3 messages"):
        read_trajectory(str(write(tmp_path / "bag", messages)))
