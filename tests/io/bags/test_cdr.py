"""Decoding by column, held against rosbags' deserialisation, message by message."""

from __future__ import annotations

import struct
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from trajeval_ros.io.bags.bag import Bag
from trajeval_ros.io.bags.cdr import CdrPlan
from trajeval_ros.io.bags.cdr_columns import Columns
from trajeval_ros.io.bags.containers import Topic
from trajeval_ros.io.bags.encode_messages import encode_path
from trajeval_ros.io.bags.message_definitions import (
    STANDARD,
    UnplannedError,
    fields_of,
    recorded_fields,
    types_in,
)
from trajeval_ros.io.bags.pose_messages import (
    PATH_TYPE,
    POSE_TYPES,
    decode_path,
    decode_poses,
    decode_transforms,
)

STORE = get_typestore(Stores.ROS2_JAZZY)
ROS1_STORE = get_typestore(Stores.ROS1_NOETIC)
TYPES = [
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "geometry_msgs/msg/PointStamped",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/NavSatFix",
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/AccelWithCovarianceStamped",
]
WITH_SEQUENCES = [
    "tf2_msgs/msg/TFMessage",
    "nav_msgs/msg/Path",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/CameraInfo",
    "diagnostic_msgs/msg/DiagnosticArray",
    "visualization_msgs/msg/MarkerArray",
    "geometry_msgs/msg/PolygonStamped",
]
NAMES = ["", "a", "map", "odom", "base_link", "äö", "x" * 17, "地図"]
Random = np.random.Generator


def random_message(store: Any, message_type: str, random: Random) -> Any:
    values = [
        random_value(store, kind, random) for _, kind in store.get_msgdef(message_type).fields
    ]
    return store.types[message_type](*values)


def random_value(store: Any, kind: Any, random: Random, count: int | None = None) -> Any:
    node, content = kind
    if node == Nodetype.NAME:
        return random_message(store, content, random)
    if node == Nodetype.BASE:
        if content[0] == "string":
            return str(random.choice(NAMES))
        value = random_numbers(content[0], 1, random)[0]
        return value.item()
    inner, count = content
    count = count if node == Nodetype.ARRAY else int(random.integers(0, 5))
    if inner[0] == Nodetype.BASE and inner[1][0] != "string":
        return random_numbers(inner[1][0], count, random)
    return [random_value(store, inner, random) for _ in range(count)]


def random_numbers(name: str, count: int, random: Random) -> Any:
    if name.startswith("float"):
        return random.normal(size=count).astype(name)
    if name == "bool":
        return random.integers(0, 2, count).astype(bool)
    return random.integers(0, 100, count).astype(
        {"byte": "uint8", "char": "uint8"}.get(name, name)
    )


def field(message: Any, path: str) -> Any:
    for name in path.split(".") if path else []:
        message = getattr(message, name)
    return message


def assert_holds(columns: Columns, messages: Sequence[Any]) -> None:
    """Check every field of every message."""
    assert len(columns.rows) == len(messages)
    for path, numbers in columns.numbers.items():
        expected = np.array([field(message, path) for message in messages]).reshape(numbers.shape)
        np.testing.assert_array_equal(numbers, expected, err_msg=path)
    for path, texts in columns.texts.items():
        names = [texts.names[code] for code in texts.codes]
        assert names == [field(message, path) for message in messages], path
    for path, sequence in columns.sequences.items():
        lists = [field(message, path) for message in messages]
        rows = np.repeat(np.arange(len(lists)), [len(item) for item in lists])
        np.testing.assert_array_equal(sequence.rows, rows, err_msg=path)
        assert_holds(sequence, [element for item in lists for element in item])


def serialised(store: Any, message: Any, message_type: str, random: Random) -> bytes:
    """Return CDR of either endianness, filled up to four bytes or not, as writers do."""
    cdr = bytes(store.serialize_cdr(message, message_type, little_endian=random.random() < 0.5))
    return cdr + bytes(-len(cdr) % 4 if random.random() < 0.5 else 0)


@pytest.mark.slow
@pytest.mark.parametrize("message_type", TYPES + WITH_SEQUENCES)
def test_every_field_of_random_messages(message_type: str) -> None:
    random = np.random.default_rng(1)
    count = 2000 if message_type in TYPES else 100
    messages = [random_message(STORE, message_type, random) for _ in range(count)]
    payloads = [serialised(STORE, message, message_type, random) for message in messages]
    columns = CdrPlan(fields_of(STORE.fielddefs, message_type)).decode(payloads)
    assert_holds(columns, messages)
    assert columns.numbers or columns.sequences


@pytest.mark.parametrize("message_type", [*TYPES[:5], "nav_msgs/msg/Path", "tf/msg/tfMessage"])
def test_every_field_of_random_messages_of_ros1(message_type: str) -> None:
    store: Any = ROS1_STORE
    if message_type not in store.fielddefs:
        store = get_typestore(Stores.ROS1_NOETIC)
        text = "geometry_msgs/TransformStamped[] transforms"
        store.register(get_types_from_msg(text, message_type))
    random = np.random.default_rng(2)
    messages = [random_message(store, message_type, random) for _ in range(300)]
    payloads = [bytes(store.serialize_ros1(message, message_type)) for message in messages]
    plan = CdrPlan(fields_of(store.fielddefs, message_type), is_ros1=True)
    assert_holds(plan.decode(payloads), messages)
    too_long = plan.decode([item + b"\0" for item in payloads])
    assert not len(too_long.rows)


KINDS = ["bool", "byte", "int8", "uint16", "int32", "int64", "float32", "float64", "string"]


@st.composite
def definitions(draw: st.DrawFn) -> str:
    """Return a definition in ROS's language, of a message with others inside."""

    def fields(inner: Sequence[str]) -> str:
        kinds = draw(st.lists(st.sampled_from([*KINDS, *inner]), min_size=1, max_size=6))
        endings = [draw(st.sampled_from(["", "", "[]", "[3]"])) for _ in kinds]
        return "\n".join(
            f"{kind}{ending} f{number}"
            for number, (kind, ending) in enumerate(zip(kinds, endings, strict=True))
        )

    separator = "\n" + "=" * 80 + "\n"
    parts = [fields(["p/A", "p/B"]), "MSG: p/A\n" + fields(["p/B"]), "MSG: p/B\n" + fields([])]
    return separator.join(parts)


def of_elements(fields: str) -> str:
    """Return a definition of a message with a sequence of messages that have the fields."""
    return f"p/A[] f0\n{'=' * 80}\nMSG: p/A\n{fields}"


@pytest.mark.slow
@example(text=of_elements("int32 f0\nstring f1"), seed=0, ros1=False)
@example(text=of_elements("float64 f0\nfloat32[] f1"), seed=0, ros1=True)
@given(text=definitions(), seed=st.integers(0, 2**32), ros1=st.booleans())
def test_every_field_of_any_layout(text: str, seed: int, ros1: bool) -> None:
    store: Any = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, "p/msg/Top"))
    random = np.random.default_rng(seed)
    messages = [random_message(store, "p/msg/Top", random) for _ in range(20)]
    if ros1:
        payloads = [bytes(store.serialize_ros1(message, "p/msg/Top")) for message in messages]
    else:
        payloads = [serialised(store, message, "p/msg/Top", random) for message in messages]
    assert_holds(
        CdrPlan(fields_of(store.fielddefs, "p/msg/Top"), is_ros1=ros1).decode(payloads), messages
    )


def test_equal_size_is_not_equal_layout() -> None:
    random = np.random.default_rng(3)
    messages = []
    for frame, child in [("odom", "base"), ("map", "basel"), ("odomb", "bas"), ("", "odombase")]:
        message = random_message(STORE, "nav_msgs/msg/Odometry", random)
        message.header.frame_id, message.child_frame_id = frame, child
        messages += [message, random_message(STORE, "nav_msgs/msg/Odometry", random)]
    payloads = [bytes(STORE.serialize_cdr(item, "nav_msgs/msg/Odometry")) for item in messages]
    assert_holds(CdrPlan(STANDARD["nav_msgs/msg/Odometry"]).decode(payloads), messages)


def test_plain_xcdr2_aligns_to_four_bytes() -> None:
    def payload(order: str, kind: bytes, frame: str) -> bytes:
        name = frame.encode() + b"\0"
        head = struct.pack(f"{order}iII", 5, 6, len(name)) + name
        head += bytes(-len(head) % 4)
        return kind + b"\0\0" + head + struct.pack(f"{order}7d", 1, 2, 3, 0, 0, 0, 1)

    frames = ["", "ma", "map", "odom"]
    payloads = [payload("<", b"\0\7", item) for item in frames]
    payloads += [payload(">", b"\0\6", item) for item in frames]
    poses = decode_poses(payloads, "geometry_msgs/msg/PoseStamped")
    assert poses.undecodable == 0
    assert poses.stamps.tolist() == [5_000_000_006] * 8
    assert poses.positions.tolist() == [[1, 2, 3]] * 8
    assert [frame for _, frame, _ in poses.frames] == frames * 2


def test_xcdr2_says_how_long_a_sequence_of_messages_is() -> None:
    pose = struct.pack("<iII4s7d", 5, 6, 4, b"map", 1, 2, 3, 0, 0, 0, 1)
    poses = struct.pack("<I", 2) + pose * 2
    head = struct.pack("<iII4sI", 7, 8, 4, b"map", len(poses))
    path = decode_path(b"\0\7\0\0" + head + poses)
    assert path.undecodable == 0
    assert path.positions.tolist() == [[1, 2, 3]] * 2


def test_only_what_is_wanted_is_decoded() -> None:
    fields = STANDARD["nav_msgs/msg/Odometry"]
    random = np.random.default_rng(4)
    messages = [random_message(STORE, "nav_msgs/msg/Odometry", random) for _ in range(5)]
    payloads = [
        bytes(STORE.serialize_cdr(message, "nav_msgs/msg/Odometry")) for message in messages
    ]
    columns = CdrPlan(fields, ["pose.pose", "twist.twist.linear.y"]).decode(payloads)
    assert columns.numbers.keys() == {"pose.pose", "twist.twist.linear.y"}
    assert columns.numbers["pose.pose"].shape == (5, 7)
    assert not columns.texts
    with pytest.raises(UnplannedError, match=r"no field pose\.velocity"):
        CdrPlan(fields, ["pose.velocity"])
    with pytest.raises(UnplannedError, match=r"no field header\.stamp of a single type"):
        CdrPlan(fields, ["header.stamp"])


# Hostile bytes.


@pytest.mark.parametrize(
    "message_type", [*TYPES[:5], "nav_msgs/msg/Path", "tf2_msgs/msg/TFMessage"]
)
def test_damaged_messages_are_judged_as_rosbags_judges_them(message_type: str) -> None:
    random = np.random.default_rng(5)
    plan = CdrPlan(STANDARD[message_type])
    for _ in range(10):
        payloads = []
        for _ in range(40):
            message = random_message(STORE, message_type, random)
            cdr = bytearray(serialised(STORE, message, message_type, random))
            damage = random.integers(4)
            if damage == 1:
                cdr = cdr[: random.integers(0, len(cdr) + 1)]
            elif damage == 2:
                cdr[random.integers(0, min(len(cdr), 32))] ^= 1 << int(random.integers(8))
            elif damage == 3:
                cdr += bytes(int(random.integers(0, 6)))
            payloads.append(bytes(cdr))
        good, messages = [], []
        for row, payload in enumerate(payloads):
            try:
                messages.append(STORE.deserialize_cdr(payload, message_type))
            except Exception:
                continue
            good.append(row)
        columns = plan.decode(payloads)
        result = columns.rows.tolist()
        assert set(good) <= set(result)
        # Besides, we read XCDR2, and empty strings without terminator.
        more = set(result) - set(good)
        assert all(
            payloads[row][:2] in (b"\0\6", b"\0\7") or b"\0\0\0\0" in payloads[row] for row in more
        )
        assert_holds(plan.decode([payloads[row] for row in good]), messages)


@given(payloads=st.lists(st.binary(max_size=200), max_size=5), kind=st.sampled_from([*STANDARD]))
def test_random_bytes_raise_nothing(payloads: list[bytes], kind: str) -> None:
    for beginning in (b"", b"\0\1\0\0", b"\0\0\0\0", b"\0\7\0\0"):
        given_ = [beginning + item for item in payloads]
        rows = CdrPlan(STANDARD[kind]).decode(given_).rows
        assert len(rows) <= len(payloads)


def test_counts_that_cannot_be_cost_nothing() -> None:
    huge = struct.pack("<I", 2**32 - 1)
    assert decode_transforms([b"\0\1\0\0" + huge, b"\0\1\0\0" + huge + bytes(100)]) == ({}, 2)
    path = decode_path(b"\0\1\0\0" + bytes(8) + struct.pack("<I", 1) + bytes(4) + huge)
    assert (len(path.stamps), path.undecodable) == (0, 1)


# Poses.


def test_standard_types_are_those_of_ros() -> None:
    assert set(POSE_TYPES) - {PATH_TYPE} <= STANDARD.keys()
    for store in (Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY):
        for message_type, fields in STANDARD.items():
            assert fields_of(get_typestore(store).fielddefs, message_type) == fields


def test_live_decoding_imports_no_library() -> None:
    code = (
        "import sys; from trajeval_ros.io.bags.pose_messages import decode_poses, decode_path; "
        "decode_poses([b''], 'nav_msgs/msg/Odometry'); decode_path(b''); "
        "sys.exit('rosbags' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("frame", ["", "map", "odom", "abcdefgh", "ü", "/world"])
@pytest.mark.parametrize("count", [0, 1, 2, 300])
def test_paths_are_encoded_as_ros_does(frame: str, count: int) -> None:
    random = np.random.default_rng(7)
    stamps = 17 * 10**17 + np.sort(random.integers(0, 10**12, count))
    positions, quaternions = random.normal(size=(count, 3)), random.normal(size=(count, 4))
    payload = encode_path(stamps, positions, quaternions, frame)
    message = STORE.deserialize_cdr(payload, PATH_TYPE)
    assert bytes(STORE.serialize_cdr(message, PATH_TYPE)) == payload
    path = decode_path(payload)
    assert path.stamps.tolist() == stamps.tolist()
    np.testing.assert_array_equal(path.positions, positions)
    np.testing.assert_array_equal(path.quaternions, quaternions)
    assert path.frames == ([(0, frame.lstrip("/"), "")] if count else [])


def test_poses_of_a_path_may_be_in_any_frames() -> None:
    random = np.random.default_rng(8)
    message: Any = random_message(STORE, PATH_TYPE, random)
    one = "geometry_msgs/msg/PoseStamped"
    message.poses = [random_message(STORE, one, random) for _ in range(200)]
    for row in range(100):
        message.poses[row].header.frame_id = "map"
    path = decode_path(bytes(STORE.serialize_cdr(message, PATH_TYPE)))
    expected = [
        [pose.pose.position.x, pose.pose.position.y, pose.pose.position.z]
        for pose in message.poses
    ]
    assert path.positions.tolist() == expected


def real_bags(folder: Path) -> list[Path]:
    bags = [path for path in folder.rglob("*") if path.suffix in (".mcap", ".db3", ".bag")]
    assert len(bags) >= 5
    return bags


@pytest.mark.slow
def test_every_field_of_every_message_of_real_bags(shared_data: Path) -> None:
    checked = 0
    for path in real_bags(shared_data / "bags"):
        with Bag(path) as bag:
            for topic in bag.topics:
                plain = deserialiser(topic)
                fields = recorded_fields(topic.connections[0])
                if plain is None or fields is None:
                    continue
                payloads = [payload for _, _, payload in bag.messages([topic])]
                plan = CdrPlan(fields, is_ros1=topic.connections[0].encoding == "ros1")
                assert_holds(plan.decode(payloads), [plain(item) for item in payloads])
                checked += len(payloads)
    assert checked > 30_000


def deserialiser(topic: Topic) -> Callable[[bytes], Any] | None:
    """Return rosbags' way to read the messages of a topic, None if it has none."""
    connection = topic.connections[0]
    store: Any = get_typestore(Stores.EMPTY)
    try:
        store.register(types_in(connection.language, connection.definition, topic.type))
        store.get_msgdef(topic.type)
    except Exception:
        return None
    ros1 = connection.encoding == "ros1"
    read = store.deserialize_ros1 if ros1 else store.deserialize_cdr
    return lambda payload: read(payload, topic.type)
