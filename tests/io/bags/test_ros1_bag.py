"""Bags of ROS 1: the messages of rosbags' reader, and what is damaged or too large."""

from __future__ import annotations

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
        first, second = (writer.add_connection(item, POSE, typestore=STORE) for item in "ab")
        images = writer.add_connection("c", "sensor_msgs/msg/Image", typestore=STORE)
        for row in range(COUNT):
            writer.write(first, row * SECOND, pose(row))
            writer.write(second, row * SECOND + 1, pose(row))
            if image and row % 10 == 0:
                writer.write(images, row * SECOND + 2, image)
    return path


def messages_of(path: Path, *window: int) -> list[tuple[str, int, bytes]]:
    with Bag(path) as opened:
        return [(item.name, *rest) for item, *rest in opened.messages(opened.topics, *window)]


def expected_of(path: Path, *window: int) -> list[tuple[str, int, bytes]]:
    with Reader(path) as reader:
        return [
            (f"/{item.topic.lstrip('/')}", time, bytes(data))
            for item, time, data in reader.messages((), *window)
        ]


def damaged(path: Path, place: int, content: bytes) -> Path:
    changed = bytearray(path.read_bytes())
    changed[place : place + len(content)] = content
    path.write_bytes(changed)
    return path


def lost_of(path: Path, *words: str) -> Trajectory:
    """Read a topic; check that its damage is told, and that it is refused strictly."""
    read = read_trajectory(f"{path}:/a")
    text = "; ".join(read.reading.messages(Level.ERROR))
    for word in (*words, f"declares {COUNT} messages on /a, but {len(read)} were read"):
        assert word in text
    with pytest.raises(InputError):
        read_trajectory(f"{path}:/a", strict=True)
    assert (np.diff(read.positions[:, 0]) > 0).all()
    return read


@pytest.mark.parametrize("image", [b"", bytes(100), bytes(200_000)])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_messages_equal_those_of_rosbags(compression: Any, image: bytes, tmp_path: Path) -> None:
    path = bag(tmp_path / "x.bag", compression, image)
    for window in ((), (100 * SECOND, 200 * SECOND + 1)):
        assert messages_of(path, *window) == expected_of(path, *window)
    with Bag(path) as opened, Reader(path) as reader:
        assert opened.span == (reader.start_time, reader.end_time - 1)
        counts = {f"/{connection.topic}": connection.msgcount for connection in reader.connections}
        assert {topic.name: topic.declared for topic in opened.topics} == counts


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ROS_example.bag", "tf_example.bag"])
def test_messages_of_real_bags_equal_those_of_rosbags(name: str, shared_data: Path) -> None:
    path = shared_data / "bags" / name
    assert sorted(messages_of(path)) == sorted(expected_of(path))


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
    read = lost_of(path, "a chunk is damaged", "messages lost", "rosbag fix")
    assert 0.9 * COUNT < len(read) < COUNT


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_damaged_chunk_loses_its_messages_only(compression: Any, tmp_path: Path) -> None:
    path = bag(tmp_path / "x.bag", compression)
    with Reader(path) as reader:
        chunk = list(reader.chunks.values())[3]
    damaged(path, chunk.datapos, bytes(chunk.datasize))
    reason = "decompressed" if compression else "a chunk is damaged"
    read = lost_of(path, reason, "messages lost", "rosbag fix")
    assert 0.5 * COUNT < len(read) < COUNT


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
    with pytest.raises(InputError, match="version 102 is not supported"):
        read_trajectory(f"{path}:/a")


@pytest.mark.parametrize("size", [0, 1, 2**31, 2**32 - 1])
@pytest.mark.parametrize("compression", COMPRESSIONS[1:])
def test_a_size_that_no_compressed_chunk_has(compression: Any, size: int, tmp_path: Path) -> None:
    path = bag(tmp_path / "x.bag", compression)
    field = b"size="
    place = path.read_bytes().find(field, CHUNK) + len(field)
    damaged(path, place, size.to_bytes(4, "little"))
    if size > 1:
        with pytest.raises(InputError, match="compression ratio above"):
            read_trajectory(f"{path}:/a")
    else:
        lost_of(path, "messages lost")


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("part", [0.3, 0.8])
def test_a_bag_without_its_index_is_refused_with_what_repairs_it(
    part: float, compression: Any, tmp_path: Path
) -> None:
    """A cut file, and one whose recorder was killed: the index is written at the end."""
    path = bag(tmp_path / "x.bag", compression)
    content = path.read_bytes()
    killed = content.find(b"index_pos=") + len(b"index_pos=")
    for changed in (
        content[: round(part * len(content))],
        content[:killed] + bytes(8) + content[killed + 8 :],
    ):
        path.write_bytes(changed)
        with pytest.raises(InputError, match=r"can't be read: it.* use `rosbag reindex x\.bag`"):
            read_trajectory(f"{path}:/a")


def test_chunks_that_the_index_omits_are_reported(tmp_path: Path) -> None:
    path = bag(tmp_path / "x.bag")
    content = path.read_bytes()
    with Reader(path) as reader:
        count, last = len(reader.chunks), reader.chunk_infos[-1]
    field = b"chunk_count="
    before, after = (field + struct.pack("<I", number) for number in (count, count - 1))
    header = content.replace(before, after)
    path.write_bytes(header)
    trajectory = read_trajectory(f"{path}:/a")
    assert 0 < COUNT - len(trajectory) <= max(last.connection_counts.values())
    assert "does not list 1 chunk" in " ".join(trajectory.reading.messages(Level.ERROR))
    with pytest.raises(InputError, match="does not list 1 chunk"):
        read_trajectory(f"{path}:/a", strict=True)


def test_an_index_has_a_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = bag(tmp_path / "x.bag")
    monkeypatch.setattr("trajeval_ros.io.bags.ros1_bag._MOST_MESSAGES", 2 * COUNT)
    assert len(read_trajectory(f"{path}:/a")) == COUNT
    monkeypatch.setattr("trajeval_ros.io.bags.ros1_bag._MOST_MESSAGES", 2 * COUNT - 1)
    with pytest.raises(InputError, match=r"has more than 1199 messages; .*`rosbag filter`"):
        read_trajectory(f"{path}:/a")
