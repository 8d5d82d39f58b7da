"""What of a bag is played again: no ROS needed."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.io.bags.bag import Bag
from trajeval_ros.io.bags.playback import Playback, allowed_name

STORE = get_typestore(Stores.ROS2_JAZZY)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
POINT = "geometry_msgs/msg/PointStamped"
POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
SECOND = 10**9
BEGIN = 1_700_000_000 * SECOND


def point(x: float, store: Any = STORE) -> Any:
    types = store.types
    time = types["builtin_interfaces/msg/Time"](1, 2)
    header = types["std_msgs/msg/Header"]
    stamped = header(7, time, "map") if store is ROS1 else header(time, "map")
    return types[POINT](stamped, types["geometry_msgs/msg/Point"](x, 2.0, 3.0))


def write(path: Path, *messages: tuple[str, float], qos: Sequence[Qos] = ()) -> Path:
    """Write points (topic, second after the beginning), whose x is their second."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict[str, Any] = {}
        for topic, second in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic, POINT, typestore=STORE, offered_qos_profiles=qos
                )
            data = STORE.serialize_cdr(point(second), POINT)
            writer.write(connections[topic], BEGIN + round(second * SECOND), data)
    return path


def write_ros1(path: Path, messages: Sequence[tuple[str, str, Any]]) -> Path:
    """Write (topic, type, message or bytes) to a bag of ROS 1, one per second."""
    with Ros1Writer(path) as writer:
        connections: dict[str, Any] = {}
        for second, (topic, kind, message) in enumerate(messages):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ROS1)
            data = message if isinstance(message, bytes) else ROS1.serialize_ros1(message, kind)
            writer.write(connections[topic], BEGIN + second * SECOND, data)
    return path


def seconds(playback: Playback) -> list[tuple[str, float]]:
    """Return names and seconds of what is played; the payload must be that of the second."""
    result = []
    for time, channel, payload in playback.messages():
        message: Any = STORE.deserialize_cdr(payload, channel.type)
        result.append((channel.name, (time - BEGIN) / SECOND))
        assert message.point.x == result[-1][1]
    return result


def everything(kind: str) -> bool:
    return bool(kind)


def test_topics_are_merged_by_log_time(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", ("/a", 0), ("/b", 0.5), ("/b", 0.7), ("/a", 1), ("/b", 2))
    with Bag(bag) as opened:
        playback = Playback(opened, everything)
        assert seconds(playback) == [("/a", 0), ("/b", 0.5), ("/b", 0.7), ("/a", 1), ("/b", 2)]
        assert playback.notes == []
        assert playback.duration_s == 2.0
        assert seconds(Playback(opened, everything, ["b"])) == [
            ("/b", 0.5),
            ("/b", 0.7),
            ("/b", 2),
        ]


def test_files_of_a_bag_without_metadata_are_merged(tmp_path: Path) -> None:
    both = tmp_path / "both"
    both.mkdir()
    for name, times in (("a", (0, 2, 4)), ("b", (1, 3))):
        bag = write(tmp_path / name, *(("/a", time) for time in times))
        (bag / f"{name}.mcap").rename(both / f"{name}.mcap")
    with Bag(both) as opened:
        assert [time for _, time in seconds(Playback(opened, everything))] == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("start", "end", "expected"),
    [
        (0.0, None, [0, 1, 2, 3]),
        (1.0, 2.0, [1, 2]),
        (0.5, 99.0, [1, 2, 3]),
        (3.0, None, [3]),
        (0.0, 0.5, [0]),
    ],
)
def test_a_window_has_both_of_its_ends(
    start: float, end: float | None, expected: list[int], tmp_path: Path
) -> None:
    bag = write(tmp_path / "bag", *(("/a", second) for second in range(4)))
    with Bag(bag) as opened:
        playback = Playback(opened, everything, start_s=start, end_s=end)
        assert [time for _, time in seconds(playback)] == expected
        assert playback.begin_ns == BEGIN + round(start * SECOND)


@pytest.mark.parametrize(
    ("window", "complaint"),
    [
        ((3.5, None), "--start 3.5 is after the end of the bag, which lasts 3.000 s"),
        ((-1.0, None), "must be at least 0 s"),
        ((float("nan"), None), "must be at least 0 s"),
        ((2.0, 2.0), "--end 2 must be after --start 2"),
        ((0.0, float("nan")), "must be after"),
    ],
)
def test_windows_that_hold_nothing_are_refused(
    window: tuple[float, float | None], complaint: str, tmp_path: Path
) -> None:
    bag = write(tmp_path / "bag", *(("/a", second) for second in range(4)))
    with Bag(bag) as opened, pytest.raises(SettingsError, match=complaint):
        Playback(opened, everything, start_s=window[0], end_s=window[1])


def test_what_cannot_be_published_is_noted_or_refused(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", ("/a", 0), ("/clock", 1))
    with Bag(bag) as opened:
        playback = Playback(opened, everything)
        assert [channel.name for channel in playback.channels] == ["/a"]
        assert playback.notes == [
            "/clock not played: /clock is generated; to play the recorded one, use --no-clock"
        ]
        both = Playback(opened, everything, with_clock=False)
        assert [channel.name for channel in both.channels] == ["/a", "/clock"]
        with pytest.raises(InputError, match=r"no playable topic: .* install the ROS pac"):
            Playback(opened, lambda kind: False)
        with pytest.raises(
            InputError, match=r"/a can't be played: .*PointStamped is not installed"
        ):
            Playback(opened, lambda kind: False, ["/a"])
        with pytest.raises(InputError, match="has no topic /c; it has /clock, /a"):
            Playback(opened, everything, ["/a", "/c"])


def test_an_empty_bag_is_refused(tmp_path: Path) -> None:
    with Bag(write(tmp_path / "bag")) as opened, pytest.raises(InputError, match="empty bag"):
        Playback(opened, everything)


def test_ros1_is_encoded_anew_under_names_that_ros2_allows(tmp_path: Path) -> None:
    broken = ROS1.serialize_ros1(point(1.0, ROS1), POINT)[:-3]
    bag = write_ros1(
        tmp_path / "a.bag",
        [
            ("ORB-SLAM", POINT, point(0.0, ROS1)),
            ("/ORB_SLAM", POINT, bytes(broken)),
            ("/ORB_SLAM", POINT, point(2.0, ROS1)),
            ("/range", "sensor_msgs/msg/Range", _range()),
        ],
    )
    with Bag(bag) as opened:
        playback = Playback(opened, everything)
        assert seconds(playback) == [("/ORB_SLAM", 0.0), ("/ORB_SLAM_2", 2.0)]
        assert playback.damaged == 1
        assert playback.notes == [
            "/range not played: sensor_msgs/msg/Range has different fields in ROS 1 and ROS 2",
            "/ORB-SLAM is published as /ORB_SLAM, a valid ROS 2 name",
            "/ORB_SLAM is published as /ORB_SLAM_2, a valid ROS 2 name",
        ]


def _range() -> Any:
    types = ROS1.types
    header = types["std_msgs/msg/Header"](1, types["builtin_interfaces/msg/Time"](1, 2), "map")
    return types["sensor_msgs/msg/Range"](header, 0, 0.1, 0.1, 2.0, 1.0)


def test_recorded_transforms_of_ros1_are_ros2s(shared_data: Path) -> None:
    with Bag(shared_data / "bags" / "tf_example.bag") as opened:
        playback = Playback(opened, everything)
        assert [(item.name, item.is_latched) for item in playback.channels] == [
            ("/tf", False),
            ("/tf_static", True),
        ]
        for _, channel, payload in playback.messages():
            message: Any = STORE.deserialize_cdr(payload, TRANSFORMS)
            assert channel.type == TRANSFORMS
            assert message.transforms


@pytest.mark.parametrize("durability", [QosDurability.TRANSIENT_LOCAL, QosDurability.VOLATILE])
def test_late_subscribers_get_what_was_recorded_for_them(
    durability: QosDurability, tmp_path: Path
) -> None:
    never = QosTime(0, 0)
    offered = Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, durability, never, never,
        QosLiveliness.AUTOMATIC, never, False,
    )  # fmt: skip
    bag = write(tmp_path / "bag", ("/map", 0), ("/tf_static", 0), qos=[offered])
    with Bag(bag) as opened:
        map_, static = Playback(opened, everything).channels
        assert map_.is_latched == (durability == QosDurability.TRANSIENT_LOCAL)
        assert static.is_latched


@pytest.mark.parametrize(
    ("name", "allowed"),
    [
        ("/vio/odometry", "/vio/odometry"),
        ("/ORB-SLAM", "/ORB_SLAM"),
        ("/cam0 (left)/pose", "/cam0_left_/pose"),
        ("//a//b/", "/a/b"),
        ("/3d/map", "/_3d/map"),
        ("/größe", "/gr_e"),
        ("/", "/unnamed"),
    ],
)
def test_names_are_made_what_ros2_allows(name: str, allowed: str) -> None:
    assert allowed_name(name) == allowed
    assert allowed_name(name, {allowed}) == f"{allowed}_2"
    assert allowed_name(name, {allowed, f"{allowed}_2"}) == f"{allowed}_3"


@given(st.text(max_size=20))
def test_every_name_is_made_allowed_and_then_kept(name: str) -> None:
    made = allowed_name(name)
    assert allowed_name(made) == made
    for token in made.removeprefix("/").split("/"):
        assert token.isascii()
        assert token.isidentifier()


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ([], "ROS 2 is required"),
        (["--rate", "-1"], "--rate -1 is out of range"),
        (["--rate", "inf"], "--rate inf is out of range"),
        (["--wait-for-subscribers", "nan"], "is out of range"),
        (["--rat", "2"], "no such option"),
    ],
)
def test_without_ros_a_mistake_is_one_sentence(
    arguments: list[str],
    complaint: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    bag = write(tmp_path / "bag", ("/a", 0))
    assert main(["replay", str(bag), *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert complaint in captured.err


def test_what_is_no_bag_is_refused_before_ros_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    bag = write(tmp_path / "bag", ("/a", 0))
    text = tmp_path / "poses.txt"
    text.write_text("1 2 3 4 0 0 0 1\n")
    for source, complaint in (
        (f"{bag}:/a", "give the topic as --topic /a"),
        (text, "is not a bag"),
        (tmp_path / "bga", "did you mean"),
    ):
        assert main(["replay", str(source)]) == 2
        assert complaint in capsys.readouterr().err


def test_the_replay_waits_for_readers_of_poses_only(tmp_path: Path) -> None:
    types = STORE.types
    pose = types["geometry_msgs/msg/Pose"](
        types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0),
        types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
    )
    stamped = types[POSE](point(0.0).header, pose)
    empty = types[TRANSFORMS]([])
    path = tmp_path / "bag"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, kind, message in (
            ("/vio", POSE, stamped),
            ("/tf", TRANSFORMS, empty),
            (
                "/imu",
                "sensor_msgs/msg/Temperature",
                types["sensor_msgs/msg/Temperature"](stamped.header, 1.0, 0.0),
            ),
        ):
            connection = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connection, BEGIN, STORE.serialize_cdr(message, kind))
    with Bag(path) as bag:
        for chosen, awaited in ((), "/vio"), (("/tf", "/imu"), "/tf"), (("/imu",), "/imu"):
            played = Playback(bag, lambda _: True, chosen)
            assert [item.name for item in played.awaited] == [awaited]
