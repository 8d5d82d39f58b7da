"""Bags of ROS 1: the messages that rosbags' own reader gives, from less of the file."""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.bag import Bag
from trajeval_ros.io.bags.blocks import TopicSelection
from trajeval_ros.io.bags.byte_source import DamagedError, LocalFile
from trajeval_ros.io.bags.ros1_bag import Ros1Reader
from trajeval_ros.io.bags.ros1_records import _message_at as message_at
from trajeval_ros.io.bags.ros1_records import record_at
from trajeval_ros.io.sources import read_trajectory

POSE = "geometry_msgs/msg/PoseStamped"
STORE: Any = get_typestore(Stores.ROS1_NOETIC)
COUNT, CHUNK = 600, 10_000  # messages of a topic, bytes of a chunk
COMPRESSIONS = [None, Writer.CompressionFormat.BZ2, Writer.CompressionFormat.LZ4]
SECOND = 10**9
RECORD_HEAD = 4 + 38 + 4  # bytes before a payload: length of the header, header, size


def pose(row: int) -> bytes:
    return struct.pack("<4I3s7d", row, row + 1, 0, 3, b"map", row, 0, 0, 0, 0, 0.6, 0.8)


def bag(path: Path, compression: Any = None, image: bytes = b"", chunk_size: int = CHUNK) -> Path:
    """Write two topics of poses, whose x is their number, and images at every tenth of them."""
    writer = Writer(path)
    writer.chunk_threshold = chunk_size
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        first, second = (writer.add_connection(each, POSE, typestore=STORE) for each in "ab")
        images = writer.add_connection("c", "sensor_msgs/msg/Image", typestore=STORE)
        for row in range(COUNT):
            writer.write(first, row * SECOND, pose(row))
            writer.write(second, row * SECOND + 1, pose(row))
            if image and row % 10 == 0:
                writer.write(images, row * SECOND + 2, image)
    return path


def messages_of(path: Path, *window: int) -> list[tuple[str, int, bytes]]:
    with Bag(path) as opened:
        return [(each.name, *rest) for each, *rest in opened.messages(opened.topics, *window)]


def expected_of(path: Path, *window: int) -> list[tuple[str, int, bytes]]:
    with Reader(path) as reader:
        return [
            (f"/{each.topic.lstrip('/')}", time, bytes(data))
            for each, time, data in reader.messages((), *window)
        ]


def damaged(path: Path, place: int, content: bytes) -> Path:
    changed = bytearray(path.read_bytes())
    changed[place : place + len(content)] = content
    path.write_bytes(changed)
    return path


def lost_of(path: Path, *words: str) -> Trajectory:
    """Read a topic; check that its damage is told, and that it is refused strictly."""
    read = read_trajectory(f"{path}:/a")
    said = "; ".join(read.reading.said(Level.ERROR))
    for word in (*words, f"declares {COUNT} messages on /a, but {len(read)} were read"):
        assert word in said
    with pytest.raises(InputError):
        read_trajectory(f"{path}:/a", strict=True)
    assert (np.diff(read.positions[:, 0]) > 0).all()
    return read


def read_without_index(path: Path, why: str) -> None:
    """Check that a whole bag is read by a scan, and refused strictly, for a reason."""
    read = read_trajectory(f"{path}:/a")
    assert read.positions[:, 0].tolist() == list(range(COUNT))
    assert any(why in each for each in read.reading.said(Level.ERROR))
    with pytest.raises(InputError, match=why):
        read_trajectory(f"{path}:/a", strict=True)


@pytest.mark.parametrize("image", [b"", bytes(100), bytes(200_000)])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_messages_equal_those_of_rosbags(compression: Any, image: bytes, tmp_path: Path) -> None:
    path = bag(tmp_path / "x.bag", compression, image)
    for window in ((), (100 * SECOND, 200 * SECOND + 1)):
        assert messages_of(path, *window) == expected_of(path, *window)
    with Bag(path) as opened, Reader(path) as reader:
        assert opened.span == (reader.start_time, reader.end_time - 1)
        counts = {f"/{each.topic}": each.msgcount for each in reader.connections}
        assert {each.name: each.declared for each in opened.topics} == counts


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ROS_example.bag", "tf_example.bag"])
def test_messages_of_real_bags_equal_those_of_rosbags(name: str, shared_data: Path) -> None:
    path = shared_data / "bags" / name
    assert sorted(messages_of(path)) == sorted(expected_of(path))


class Counting(LocalFile):
    """A file that counts the bytes that are read of it, and how often."""

    count = times = 0

    def read(self, offset: int, size: int) -> bytes:
        data = super().read(offset, size)
        self.count += len(data)
        self.times += 1
        return data


def test_images_among_the_poses_are_not_read(tmp_path: Path) -> None:
    path = bag(tmp_path / "x.bag", image=bytes(200_000))
    source = Counting(path)
    reader = Ros1Reader(source)
    (topic,) = (each.id for each in reader.connections if each.topic == "a")
    blocks = list(reader.blocks([TopicSelection(frozenset([topic]))]))
    assert sum(len(block) for block in blocks) == COUNT
    assert source.count < 0.1 * path.stat().st_size


def test_poses_between_images_of_one_chunk_are_read_alone(tmp_path: Path) -> None:
    path = bag(tmp_path / "x.bag", image=bytes(200_000), chunk_size=10_000_000)
    source = Counting(path)
    reader = Ros1Reader(source)
    (topic,) = (each.id for each in reader.connections if each.topic == "a")
    payloads = [
        bytes(block.buffer[begin : begin + size])
        for block in reader.blocks([TopicSelection(frozenset([topic]))])
        for begin, size in zip(block.begins.tolist(), block.sizes.tolist(), strict=True)
    ]
    assert payloads == [pose(row) for row in range(COUNT)]
    assert source.count < 0.1 * path.stat().st_size
    assert COUNT / 10 <= source.times < COUNT / 10 + 20  # one for all poses between two images


def test_messages_of_one_layout_are_not_parsed_one_by_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, parsed = bag(tmp_path / "x.bag"), []
    monkeypatch.setattr(
        "trajeval_ros.io.bags.ros1_records._message_at",
        lambda *given: parsed.append(given) or message_at(*given),
    )
    read = read_trajectory(f"{path}:/a", strict=True)
    assert read.positions[:, 0].tolist() == list(range(COUNT))
    with Reader(path) as reader:
        assert len(parsed) == len(reader.chunks)


def first_entry_of(path: Path) -> int:
    """Return where the index of the first chunk has the offset of the first message on /a."""
    with Reader(path) as reader:
        chunk = next(iter(reader.chunks.values()))
    begin = chunk.datapos + chunk.datasize
    (size,) = struct.unpack("<I", path.read_bytes()[begin : begin + 4])
    return begin + 4 + size + 4 + 8


def test_an_index_that_points_at_connections_before_a_message(tmp_path: Path) -> None:
    """As rosbag writes it for the first message of a connection."""
    path = bag(tmp_path / "x.bag")
    damaged(path, first_entry_of(path), bytes(4))
    read = read_trajectory(f"{path}:/a", strict=True)
    assert read.positions[:, 0].tolist() == list(range(COUNT))


def test_an_index_that_points_at_the_end_of_a_chunk(tmp_path: Path) -> None:
    path = bag(tmp_path / "x.bag")
    with Reader(path) as reader:
        size = next(iter(reader.chunks.values())).datasize
    damaged(path, first_entry_of(path), struct.pack("<I", size - 3))
    assert len(lost_of(path, "not at its indexed position, 1 message lost")) == COUNT - 1


def test_an_index_of_another_version_is_not_read(tmp_path: Path) -> None:
    path = bag(tmp_path / "x.bag")
    with Reader(path) as reader:
        chunk = next(iter(reader.chunks.values()))
    version = b"ver="
    place = path.read_bytes().find(version, chunk.datapos + chunk.datasize) + len(version)
    damaged(path, place, b"\2")
    lost_of(path, "an index is damaged, in the chunk at byte")


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        (b"count=", b"\1", "its index is inconsistent"),
        (b"count=", b"\3", "its index is inconsistent"),
        (b"chunk_pos=", None, "its index lists a chunk twice"),
    ],
)
def test_a_list_of_chunks_that_contradicts_itself(
    field: bytes, value: bytes | None, said: str, tmp_path: Path
) -> None:
    path = bag(tmp_path / "x.bag")
    content = path.read_bytes()
    place = content.rfind(field) + len(field)
    if value is None:  # the last chunk is at the place of the one before it
        other = content.rfind(field, 0, place - len(field)) + len(field)
        value = content[other : other + 8]
    damaged(path, place, value)
    read_without_index(path, said)


def test_fields_of_a_record() -> None:
    field = struct.pack("<I4sI", 8, b"abc=", 7)
    head = struct.pack("<I", len(field)) + field + bytes(4)
    record = record_at(lambda offset, size: head[offset : offset + size], 0)
    assert (record.number("abc", 4), record.begin, record.end) == (7, len(head), len(head))
    assert record.text("nothing") == ""
    for name, size in (("abc", 1), ("nothing", 1), ("nothing", 4)):
        with pytest.raises(DamagedError, match=f"has no field '{name}'"):
            record.number(name, size)
    without = head.replace(b"=", b"_")
    with pytest.raises(DamagedError, match="an invalid field"):
        record_at(lambda offset, size: without[offset : offset + size], 0)


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_damaged_chunk_loses_its_messages_only(compression: Any, tmp_path: Path) -> None:
    path = bag(tmp_path / "x.bag", compression)
    with Reader(path) as reader:
        chunk = list(reader.chunks.values())[3]
    damaged(path, chunk.datapos, bytes(chunk.datasize))
    reason = "decompressed" if compression else "not at its indexed position"
    read = lost_of(path, reason, "messages lost", "rosbag reindex")
    assert 0.5 * COUNT < len(read) < COUNT


@pytest.mark.slow
def test_a_damaged_message_is_the_only_one_lost(tmp_path: Path) -> None:
    path = bag(tmp_path / "x.bag")
    header = path.read_bytes().find(pose(105))
    for place in range(header - RECORD_HEAD, header - 4):
        content = path.read_bytes()
        damaged(path, place, bytes([content[place] ^ 0x55]))
        assert COUNT - len(lost_of(path, "not at its indexed position, 1 message lost")) == 1
        other = read_trajectory(f"{path}:/b")
        assert len(other) == COUNT
        assert not other.reading.said(Level.ERROR)
        path.write_bytes(content)


def test_fields_in_another_order_are_read(tmp_path: Path) -> None:
    path = bag(tmp_path / "x.bag")
    content = path.read_bytes()
    record = content.find(pose(105)) - RECORD_HEAD + 4
    length = int.from_bytes(content[record - 4 : record], "little")
    size = int.from_bytes(content[record : record + 4], "little")
    first, rest = content[record : record + 4 + size], content[record + 4 + size : record + length]
    damaged(path, record, rest + first)
    read = read_trajectory(f"{path}:/a", strict=True)
    assert read.positions[:, 0].tolist() == list(range(COUNT))


def test_a_damaged_index_loses_its_chunk_only(tmp_path: Path) -> None:
    path = bag(tmp_path / "x.bag")
    with Reader(path) as reader:
        chunk = list(reader.chunks.values())[3]
    damaged(path, chunk.datapos + chunk.datasize, b"\xff" * 4)
    assert len(lost_of(path, "a record has an invalid size, in the chunk at byte")) > 0.5 * COUNT


@pytest.mark.parametrize("size", [0, 1, 2**31, 2**32 - 1])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_size_that_no_chunk_has(compression: Any, size: int, tmp_path: Path) -> None:
    path = bag(tmp_path / "x.bag", compression)
    field = b"size="
    place = path.read_bytes().find(field, CHUNK) + len(field)
    damaged(path, place, size.to_bytes(4, "little"))
    lost_of(path, "in the chunk at byte")


def test_more_than_any_recording_decompresses_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = bag(tmp_path / "x.bag", Writer.CompressionFormat.LZ4)
    monkeypatch.setattr("trajeval_ros.io.bags.ros1_bag.LARGEST", CHUNK * 3)
    monkeypatch.setattr("trajeval_ros.io.bags.compression.LARGEST_RATIO", 1)
    with pytest.raises(InputError, match="rosbag decompress"):
        read_trajectory(f"{path}:/a")


def test_a_bag_of_another_version(tmp_path: Path) -> None:
    path = damaged(bag(tmp_path / "x.bag"), 0, b"#ROSBAG V1.2")
    with pytest.raises(InputError, match=r"its version is not 2\.0"):
        read_trajectory(f"{path}:/a")


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        (b"index_pos=", b"index_pos=" + bytes(8), "it has no index"),
        (b"index_pos=", b"index_pos=" + b"\xff" * 8, "a record is truncated"),
        (b"index_pos=", b"index_pox=", "a record has no field 'index_pos'"),
        (b"index_pos=", b"index_pos=\x0d" + bytes(7), "a record is misplaced"),
    ],
)
def test_a_bag_without_a_valid_index(
    before: bytes, after: bytes, said: str, tmp_path: Path
) -> None:
    path = bag(tmp_path / "x.bag")
    damaged(path, path.read_bytes().find(before), after)
    read_without_index(path, said)


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_truncated_bag_gives_the_messages_before_its_end(
    compression: Any, tmp_path: Path
) -> None:
    path = bag(tmp_path / "x.bag", compression)
    whole, expected = path.read_bytes(), expected_of(path)
    in_chunk = whole.find(b"op=\x05", len(whole) // 2) + CHUNK // 2
    for end in (in_chunk, round(0.8 * len(whole)), len(whole) - 100):
        path.write_bytes(whole[:end])
        read = messages_of(path)
        assert read == expected[: len(read)]
        assert len(read) > (end / len(whole) - 0.2) * len(expected)
        with Bag(path) as opened:
            [said] = opened.damage
        assert f"of {path.stat().st_size}" in said
        if compression is None and end == in_chunk:
            assert re.search(r"plus \d+ messages of the cut chunk", said)
        with pytest.raises(InputError, match="read record by record"):
            read_trajectory(f"{path}:/a", strict=True)


def test_a_flipped_byte_of_a_truncated_bag_loses_a_part_of_its_chunk(tmp_path: Path) -> None:
    path = bag(tmp_path / "x.bag")
    whole, expected = path.read_bytes()[: 5 * CHUNK], set(expected_of(path))
    path.write_bytes(whole)
    best = len(messages_of(path))
    for place in range(2 * CHUNK, 2 * CHUNK + 300, 19):
        path.write_bytes(whole)
        damaged(path, place, bytes([whole[place] ^ 0x81]))
        read = messages_of(path)
        assert best - CHUNK // 100 <= len(read) <= best
        # The format has no checksums: at most the flipped message differs.
        assert len(set(read) - expected) <= 1


def test_chunks_that_the_index_omits_are_read_and_reported(tmp_path: Path) -> None:
    path = bag(tmp_path / "x.bag")
    content = path.read_bytes()
    read = lambda offset, size: content[offset : offset + size]  # noqa: E731
    head = record_at(read, 13)
    last = record_at(read, head.number("index_pos", 8))
    while last.end < len(content):
        begin, last = last.end, record_at(read, last.end)
    count = struct.pack("<I", head.number("chunk_count", 4))
    fewer = struct.pack("<I", head.number("chunk_count", 4) - 1)
    path.write_bytes(content[:begin].replace(b"chunk_count=" + count, b"chunk_count=" + fewer))
    trajectory = read_trajectory(f"{path}:/a")
    assert len(trajectory) == COUNT
    assert "does not list all chunks" in " ".join(trajectory.reading.said(Level.ERROR))
    with pytest.raises(InputError, match="does not list all chunks"):
        read_trajectory(f"{path}:/a", strict=True)
