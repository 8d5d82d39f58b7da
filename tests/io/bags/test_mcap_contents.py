"""Contents of MCAP files: other profiles, topics and definitions, and messages that are none."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from damaged_bags import (
    COUNT,
    SECOND,
    Register,
    assert_whole,
    definition,
    mcap_file,
    payloads,
    rows_of,
)
from made_bags import STORE, TYPES, header, pose, pose_stamped, refusal
from rosbags.typesys import Stores, get_typestore

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.write_bag import POSE_STAMPED
from trajeval_ros.io.sources import read_trajectory


@pytest.mark.parametrize("chunked", [True, False])
def test_log_times_out_of_order_are_sorted(chunked: bool, tmp_path: Path) -> None:
    order = list(range(COUNT))
    random.Random(0).shuffle(order)
    given = payloads()
    path = mcap_file(
        tmp_path / "x.mcap",
        messages=[given[row] for row in order],
        log_times=[row * SECOND for row in order],
        use_chunking=chunked,
    )
    assert_whole(path)


@pytest.mark.parametrize("profile", ["", "ros1", "x"])
def test_any_profile(profile: str, tmp_path: Path) -> None:
    assert_whole(mcap_file(tmp_path / "x.mcap", profile=profile))


def test_ros1_in_mcap(tmp_path: Path) -> None:
    store: Any = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    messages = []
    for row in range(COUNT):
        time = types["builtin_interfaces/msg/Time"](row + 1, 0)
        message = types[POSE_STAMPED](
            types["std_msgs/msg/Header"](row, time, "map"),
            types["geometry_msgs/msg/Pose"](
                types["geometry_msgs/msg/Point"](float(row), 0.0, 0.0),
                types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.6, 0.8),
            ),
        )
        messages.append(bytes(store.serialize_ros1(message, POSE_STAMPED)))
    for text in (definition(POSE_STAMPED, store), b""):
        schema = ("geometry_msgs/PoseStamped", "ros1msg", text)
        path = tmp_path / "x.mcap"
        mcap_file(path, messages=messages, profile="ros1", schema=schema, encoding="ros1")
        assert_whole(path)


OTHERS: list[Register] = [
    lambda w: w.register_channel("/j", "json", w.register_schema("J", "jsonschema", b"{}")),
    lambda w: w.register_channel("/p", "protobuf", w.register_schema("P", "protobuf", b"xx")),
    lambda w: w.register_channel("/f", "flatbuffer", w.register_schema("F", "flatbuffer", b"x")),
    lambda w: w.register_channel("/r", "ros1", w.register_schema("a/B", "ros1msg", b"int8 a")),
    lambda w: w.register_channel("/n", "json", 0),
    lambda w: w.register_channel("/b", "cdr", w.register_schema("a/msg/B", "ros2msg", b"! no")),
    lambda w: w.register_channel("/m", "cdr", w.register_schema("a/msg/B", "ros2msg", b"c/D d")),
    lambda w: w.register_channel("/e", "cdr", w.register_schema("\xff", "ros2msg", b"\xff\xfe")),
]


@pytest.mark.parametrize("others", OTHERS)
def test_odd_topics_beside_the_poses(others: Register, tmp_path: Path) -> None:
    assert_whole(mcap_file(tmp_path / "x.mcap", others=others))


def test_service_events_beside_the_topics(shared_data: Path) -> None:
    folder = shared_data / "bags" / "rosbag2_fixtures"
    bags = [path for path in folder.rglob("*.mcap") if "service" in path.name]
    assert bags
    for bag in bags:
        assert "no topic with poses, only" in refusal(bag)


@pytest.mark.parametrize("text", [b"", b" ", b"this is no definition !", b"int8 a", b"a/B pose"])
def test_a_definition_that_is_no_help(text: bytes, tmp_path: Path) -> None:
    assert_whole(mcap_file(tmp_path / "x.mcap", schema=(POSE_STAMPED, "ros2msg", text)))
    assert_whole(mcap_file(tmp_path / "y.mcap", schema=(POSE_STAMPED, "", text)))


@pytest.mark.parametrize(
    ("beginning", "good"),
    [
        (b"\0\1\0\3", True),
        (b"\0\7\0\0", True),
        (b"\0\2\0\0", False),
        (b"\0\3\0\0", False),
        (b"\0\x0a\0\0", False),
    ],
)
def test_encapsulations(beginning: bytes, good: bool, tmp_path: Path) -> None:
    messages = [beginning + payload[4:] for payload in payloads()]
    path = mcap_file(tmp_path / "x.mcap", messages=messages)
    if good:
        assert_whole(path)
    else:
        with pytest.raises(InputError, match=f"none of its {COUNT} messages can be decoded"):
            read_trajectory(str(path))


def test_payloads_that_are_no_messages_are_counted(tmp_path: Path) -> None:
    good = payloads()
    bad = [b"", b"\0", b"\0\1\0\0", good[0][:40], good[0] + bytes(8)]
    read = read_trajectory(str(mcap_file(tmp_path / "x.mcap", messages=good + bad)))
    assert rows_of(read) == list(range(COUNT))
    assert read.reading.dropped == {"undecodable": len(bad)}


def test_messages_that_are_no_poses_are_counted(tmp_path: Path) -> None:
    given = payloads(100)
    for row, x, w in ((5, np.nan, 0.8), (7, 1.0, np.inf), (9, 1.0, np.nan)):
        message = pose_stamped(SECOND, x)
        message.pose.orientation.w = w
        given[row] = bytes(STORE.serialize_cdr(message, POSE_STAMPED))
    nothing = pose(1.0, w=0.0, yaw=0.0)
    zero = TYPES[POSE_STAMPED](header(SECOND), nothing)
    given[11] = bytes(STORE.serialize_cdr(zero, POSE_STAMPED))
    read = read_trajectory(str(mcap_file(tmp_path / "x.mcap", messages=given)))
    assert len(read) == 96
    assert read.reading.dropped == {"not_finite": 3, "zero_quaternion": 1}
