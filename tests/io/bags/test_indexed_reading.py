"""Parts of MCAP files: only what an index lists is read, and damage costs no other message."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from damaged_bags import definition, payloads
from hypothesis import given, settings
from hypothesis import strategies as st
from made_bags import simple, the_file
from mcap.records import Channel, Schema
from mcap_layouts import Layout, Part
from memory_file import Memory

from tests.io.bags.test_sqlite_rows import rows_of
from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags import mcap_bag
from trajeval_ros.io.bags.bag import Bag
from trajeval_ros.io.bags.blocks import TopicSelection
from trajeval_ros.io.bags.byte_source import GAP
from trajeval_ros.io.bags.foxglove import FIX_TYPE, FoxglovePlan
from trajeval_ros.io.bags.mcap_bag import McapReader
from trajeval_ros.io.bags.mcap_chunk_reading import read_chunk
from trajeval_ros.io.bags.mcap_contents import read_summary
from trajeval_ros.io.bags.write_bag import POSE_STAMPED
from trajeval_ros.io.sources import read_trajectory

Message = tuple[int, int, bytes]
POSE, IMAGE, OTHER = 1, 2, 3
CHANNELS = [Channel(item, f"/{item}", "x", {}, 0) for item in (POSE, IMAGE, OTHER)]


class Counting(Memory):
    """Bytes as a source that counts what is read."""

    def __init__(self, content: bytes) -> None:
        super().__init__(content)
        self.taken = 0

    def read(self, offset: int, size: int) -> bytes:
        result = super().read(offset, size)
        self.taken += len(result)
        return result


def sparse(count: int = 12, image: int = 60_000, pose: int = 30) -> list[Message]:
    """Return poses of growing sizes, each before an image."""
    rows = []
    for row in range(count):
        rows.append((POSE, 10 * row, bytes([row]) * (pose + 7 * row)))
        rows.append((IMAGE, 10 * row + 1, bytes(image)))
    return rows


@pytest.mark.parametrize("image", [20_000, 60_000, 100_000])
@pytest.mark.parametrize("pose", [30, 5000, 9000])
def test_only_what_the_index_lists_is_read_of_a_chunk(image: int, pose: int) -> None:
    rows = sparse(image=image, pose=pose)
    content = bytes(Layout([], CHANNELS, [Part(rows)]))
    [chunk] = read_summary(Counting(content))[0].chunks  # type: ignore[arg-type]
    source: Any = Counting(content)
    result = read_chunk(source, chunk, {POSE}, strict=False)
    assert rows_of([result.block]) == [row for row in rows if row[0] == POSE]
    assert result.damage == ""
    # Messages nearer than 64 KiB are read with what is between them.
    is_sparse = image + pose + 62 > GAP
    assert result.is_partial == is_sparse
    assert (source.taken < 0.5 * chunk.size) == is_sparse
    whole = read_chunk(source, chunk, {POSE}, strict=True)
    assert not whole.is_partial
    assert rows_of([whole.block]) == rows_of([result.block])
    both = read_chunk(source, chunk, {POSE, IMAGE}, strict=False)
    assert rows_of([both.block]) == rows


@pytest.mark.parametrize("field", ["opcode", "length", "channel", "size", "time", "offset"])
@pytest.mark.parametrize("channel", [POSE, OTHER])
def test_a_damaged_index_costs_bytes_and_no_message(field: str, channel: int) -> None:
    rows = [*sparse(), (OTHER, 500, b"end")]
    content = bytes(Layout([], CHANNELS, [Part(rows)]))
    [chunk] = read_summary(Counting(content))[0].chunks  # type: ignore[arg-type]
    place = chunk.indexes[channel]
    offsets = {"opcode": 0, "length": 1, "channel": 9, "size": 11, "time": 15, "offset": 23}
    for change in (1, 255):
        changed = bytearray(content)
        at = place + offsets[field]
        changed[at] = (changed[at] + change) % 256
        expected = {POSE, OTHER}
        result = read_chunk(Counting(bytes(changed)), chunk, expected, strict=False)  # type: ignore[arg-type]
        assert not result.is_partial
        assert result.damage == ""
        assert result.block is not None
        assert rows_of([result.block]) == [row for row in rows if row[0] in expected]
    cut = content[: place + 10]
    assert result.block is not None
    short = read_chunk(Counting(cut), chunk, {channel}, strict=False)  # type: ignore[arg-type]
    assert short.block is not None
    assert rows_of([short.block]) == [row for row in rows if row[0] == channel]


def test_a_damaged_message_of_a_part_is_found_by_its_head() -> None:
    rows = sparse(image=100_000)
    content = bytes(Layout([], CHANNELS, [Part(rows)]))
    [chunk] = read_summary(Counting(content))[0].chunks  # type: ignore[arg-type]
    place = content.index(bytes([3]) * 40) - 31
    for at, is_found in ((0, True), (4, True), (9, True), (15, True), (11, False), (35, False)):
        changed = bytearray(content)
        changed[place + at] ^= 1
        result = read_chunk(Counting(bytes(changed)), chunk, {POSE}, strict=False)  # type: ignore[arg-type]
        # The sequence number and the payload are verified by the checksum of the whole chunk only.
        assert result.is_partial == (not is_found)
        assert ("checksum" in result.damage) == is_found
    for end in (place + 20, place + 60):
        cut = read_chunk(Counting(content[:end]), chunk, {POSE}, strict=False)  # type: ignore[arg-type]
        assert cut.block is None
        assert cut.damage


@settings(max_examples=20)
@given(
    st.lists(
        st.lists(st.tuples(st.sampled_from([POSE, IMAGE, OTHER]), st.integers(0, 60)), max_size=6),
        min_size=1,
        max_size=5,
    ),
    st.sampled_from(["", "zstd", "lz4"]),
    st.booleans(),
    st.tuples(st.none() | st.integers(0, 60), st.none() | st.integers(0, 60)),
    st.sampled_from([1, 40, 10**6]),
)
def test_messages_of_any_window_are_read_in_order_of_the_pieces(
    groups: Any, compression: str, has_chunks: bool, window: Any, most: int
) -> None:
    """Whether they are in chunks or not, and whatever is decompressed ahead."""
    parts = [
        Part(
            [(channel, time, bytes([time]) * (time % 7)) for channel, time in group],
            is_chunk=has_chunks and place != 1,
            compression=compression,
        )
        for place, group in enumerate(groups)
    ]
    source: Any = Memory(bytes(Layout([], CHANNELS, parts)))
    reader = McapReader(source)
    selections = [TopicSelection(frozenset({POSE})), TopicSelection(frozenset({OTHER}))]
    with mock.patch.object(mcap_bag, "_IN_FLIGHT", most):
        blocks = list(reader.blocks(selections, *window))
    begin, end = window
    expected = [
        row
        for part in parts
        for row in part.rows
        if row[0] != IMAGE and (begin is None or row[1] >= begin) and (end is None or row[1] < end)
    ]
    assert sorted(rows_of(blocks)) == sorted(expected)
    earliest = [block.earliest for block in blocks]
    assert earliest == sorted(earliest)
    assert all(block.earliest <= block.log_times.min() for block in blocks)
    assert [selection.damage for selection in selections] == [[], []]
    times = [time for part in parts for _, time, _ in part.rows]
    assert reader.span == ((min(times), max(times)) if times else None)


def test_the_checksum_of_messages_outside_of_chunks_is_verified_if_strict(tmp_path: Path) -> None:
    rows = [(POSE, row, payload) for row, payload in enumerate(payloads(20))]
    content = bytearray(
        bytes(
            Layout(
                [Schema(1, definition(POSE_STAMPED), "ros2msg", POSE_STAMPED)],
                [Channel(POSE, "/pose", "cdr", {}, 1)],
                [Part(rows, is_chunk=False)],
            )
        )
    )
    place = content.index(struct.pack("<BQ", 0x0F, 4))

    path = tmp_path / "x.mcap"
    right = zlib.crc32(bytes(content[:place]))
    for checksum, refused in ((0, False), (right, False), (right ^ 1, True)):
        content[place + 9 : place + 13] = struct.pack("<I", checksum)
        path.write_bytes(bytes(content))
        assert len(read_trajectory(path)) == 20
        if refused:
            with pytest.raises(InputError, match="checksum mismatch"):
                read_trajectory(path, strict=True)
        else:
            assert len(read_trajectory(path, strict=True)) == 20


def test_strict_reading_of_messages_refuses_damage_only(tmp_path: Path) -> None:
    bag = simple(tmp_path / "bag")
    file = the_file(bag)
    for strict in (False, True):
        with Bag(bag, strict=strict) as opened:
            count = len(list(opened.messages(opened.topics)))
            assert count > 0
            assert opened.damage == []
    with Bag(file) as opened:
        [topic, *_] = opened.topics
        assert topic.declared is not None
        more = [type(topic)(topic.name, topic.type, topic.declared + 1, topic.connections)]
        assert len(list(opened.messages(more))) == topic.declared
        assert f"but {topic.declared} were read" in opened.damage[0]
        empty = type(topic)("/empty", topic.type, 0, ())
        assert opened._missing([topic, empty], topic.declared) == []
        unknown = type(topic)("/unknown", topic.type, None, ())
        assert opened._missing([topic, unknown], 0) == []
        opened.damage.clear()
        # Of a part of the bag, the number is not known.
        assert list(opened.messages(more, 10**18, 10**18 + 1)) == []
        assert opened.damage == []
    with Bag(file, strict=True) as opened, pytest.raises(InputError, match="were read"):
        list(opened.messages(more))


def test_a_fix_of_foxglove_without_covariance_has_zeros() -> None:
    message: dict[str, Any] = {
        "timestamp": {"sec": 3, "nsec": 4},
        "frame_id": "gps",
        "latitude": 47.5,
        "longitude": 8.25,
        "altitude": 400,
        "position_covariance": [],
        "position_covariance_type": 0,
    }
    plan = FoxglovePlan(FIX_TYPE, "json")
    full = {**message, "position_covariance": [*range(9)], "position_covariance_type": 3}
    short = {**message, "position_covariance": [1.0] * 8}
    result = plan.decode([json.dumps(item).encode() for item in (message, short, full)])
    assert result.rows.tolist() == [0, 2]
    np.testing.assert_array_equal(result.numbers["position_covariance"], [[0] * 9, range(9)])
    assert result.numbers["position_covariance_type"].tolist() == [0, 3]
    assert result.numbers["altitude"].tolist() == [400, 400]
    assert result.numbers["header.stamp.nanosec"].tolist() == [4, 4]
    for sec, nsec, is_time in (
        (-(2**31), 0, True),
        (-(2**31) - 1, 0, False),
        (2**32 - 1, 2**32 - 1, True),
        (2**32, 0, False),
        (0, 2**32, False),
        (0, -1, False),
        (1.0, 0, False),
        (True, 0, False),
    ):
        stamped = {**message, "timestamp": {"sec": sec, "nsec": nsec}}
        assert len(plan.decode([json.dumps(stamped).encode()]).rows) == is_time
    for wrong in ({"frame_id": 3}, {"latitude": "47"}, {"latitude": None}, {"altitude": True}):
        assert not len(plan.decode([json.dumps({**message, **wrong}).encode()]).rows)
