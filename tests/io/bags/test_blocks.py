"""Blocks of messages against plain lists, and ranges of bytes against slices."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from trajeval_ros.io.bags import blocks
from trajeval_ros.io.bags.blocks import (
    BYTES,
    ROWS,
    Block,
    all_connections,
    are_of,
    are_same,
    block_of,
    blocks_of,
    gather,
    in_order,
    merged,
)
from trajeval_ros.io.bags.byte_source import (
    ByteWindow,
    LocalFile,
    counting_fetched_bytes,
    current_counter,
)

Message = tuple[int, int, bytes]  # connection, log time, payload
messages = st.lists(
    st.tuples(st.integers(0, 3), st.integers(-50, 50), st.binary(max_size=12)), max_size=25
)


def listed(block: Block) -> list[Message]:
    """Return the messages of a block; the publish time is the log time and one."""
    assert block.publish_times.tolist() == (block.log_times + 1).tolist()
    assert len(block) == len(block.sizes)
    rows = zip(block.connections, block.log_times, block.payloads(), strict=True)
    return [(int(connection), int(time), bytes(view)) for connection, time, view in rows]


def block(content: list[Message], padding: int = 0) -> Block:
    """Return messages as a block, with other bytes before each."""
    connections, times, payloads = [[item[at] for item in content] for at in range(3)]
    plain = block_of(connections, times, [b"#" * padding + payload for payload in payloads])
    return dataclasses.replace(
        plain,
        begins=plain.begins + padding,
        sizes=plain.sizes - padding,
        publish_times=plain.log_times + 1,
    )


@settings(max_examples=20)
@given(messages, st.integers(0, 30))
def test_a_block_is_a_list_of_messages(content: list[Message], padding: int) -> None:
    found = block(content, padding)
    assert listed(found) == content
    assert found.earliest == min((time for _, time, _ in content), default=0)
    small = found.compact()
    assert listed(small) == content
    assert small.earliest == found.earliest
    used = sum(len(payload) for *_, payload in content)
    assert len(small.buffer) == (used if 2 * used < len(found.buffer) else len(found.buffer))
    by_connection = [(which, listed(part)) for which, part in found.by_connection()]
    assert by_connection == [
        (which, [item for item in content if item[0] == which])
        for which in sorted({item[0] for item in content})
    ]


@given(messages, st.none() | st.integers(-60, 60), st.none() | st.integers(-60, 60))
def test_a_time_window_begins_with_its_begin_and_ends_before_its_end(
    content: list[Message], begin: int | None, end: int | None
) -> None:
    def is_inside(time: int) -> bool:
        return (begin is None or time >= begin) and (end is None or time < end)

    assert listed(block(content).within(begin, end)) == [
        item for item in content if is_inside(item[1])
    ]


@pytest.mark.parametrize("rows", [1, 3, 1000])
@pytest.mark.parametrize("size", [1, 20, 10_000])
@given(content=messages)
def test_messages_are_grouped_in_blocks_of_bounded_size(
    content: list[Message], rows: int, size: int
) -> None:
    with mock.patch.multiple(blocks, ROWS=rows, BYTES=size):
        found = list(blocks_of(content))
        again = list(merged(map(block, [[item] for item in content])))
    assert [item for part in again for item in listed(part)] == content
    groups = [[(c, t, bytes(p)) for c, t, p in _rows(part)] for part in found]
    assert [item for group in groups for item in group] == content
    for group, part in zip(groups, again, strict=True):
        assert len(group) == len(part)
    for group in groups:
        assert 0 < len(group) <= rows
        assert sum(len(payload) for *_, payload in group[:-1]) < size
    for group in groups[:-1]:  # a block is full before the next one begins
        assert len(group) == rows or sum(len(payload) for *_, payload in group) >= size


def _rows(part: Block) -> Iterator[Any]:
    return zip(part.connections.tolist(), part.log_times.tolist(), part.payloads(), strict=True)


def test_the_sizes_of_blocks() -> None:
    assert (ROWS, BYTES, blocks.LARGEST) == (8192, 1 << 20, 1 << 30)
    assert [len(item) for item in blocks_of([(0, 0, b"")] * (ROWS + 1))] == [ROWS, 1]
    half = bytes(BYTES // 2)
    assert [len(item) for item in blocks_of([(0, 0, half)] * 5)] == [2, 2, 1]


@given(st.lists(messages, max_size=5))
def test_messages_come_in_order_of_their_log_times(groups: list[list[Message]]) -> None:
    """Blocks say the earliest time of all later ones; equal times keep their order."""
    floors = [
        min((time for later in groups[place:] for _, time, _ in later), default=100)
        for place in range(len(groups))
    ]
    parts = [
        dataclasses.replace(block(group), earliest=floor)
        for group, floor in zip(groups, floors, strict=True)
    ]
    expected = sorted((item for group in groups for item in group), key=lambda item: item[1])
    assert list(in_order(parts)) == expected


def test_messages_are_handed_on_when_no_earlier_one_can_come() -> None:
    taken = []

    def parts() -> Iterator[Block]:
        for time in range(5):
            taken.append(time)
            yield block([(0, time, b"")])

    stream = in_order(parts())
    assert next(stream)[1] == 0
    assert taken == [0, 1]
    assert next(stream)[1] == 1
    assert taken == [0, 1, 2]


compressed = zstandard.ZstdCompressor().compress


@given(st.lists(st.tuples(st.integers(0, 2), st.binary(max_size=40)), max_size=20))
def test_messages_compressed_one_by_one_are_decompressed(rows: list[tuple[int, bytes]]) -> None:
    """Others are kept, also if they begin like compressed ones."""
    marks = {0: b"", 1: b"\x28\xb5\x2f", 2: b"\x28"}
    stored = [
        compressed(payload) if kind == 0 and payload else marks[kind] + payload.lstrip(b"\xfd")
        for kind, payload in rows
    ]
    plain = [
        payload if kind == 0 and payload else marks[kind] + payload.lstrip(b"\xfd")
        for kind, payload in rows
    ]
    content = [(row % 2, row, item) for row, item in enumerate(stored)]
    source = dataclasses.replace(block(content), earliest=-7)
    found = list(source.decompressed())
    assert [item for part in found for item in listed(part)] == [
        (row % 2, row, item) for row, item in enumerate(plain)
    ]
    assert all(part.earliest == -7 for part in found)


def test_what_can_t_be_decompressed_becomes_empty_and_blocks_stay_small() -> None:
    large = compressed(bytes(BYTES - 1))
    content = [(0, 0, large), (0, 1, b"\x28\xb5\x2f\xfd" + b"no"), (0, 2, b"x"), (0, 3, b"end")]
    found = list(block(content).decompressed())
    assert [listed(part) for part in found] == [
        [(0, 0, bytes(BYTES - 1)), (0, 1, b""), (0, 2, b"x")],
        [(0, 3, b"end")],
    ]
    # At most 500 times the stored bytes, or a block, are accepted of one message.
    bomb = compressed(bytes(BYTES + 1))
    [opened] = block([(0, 0, bomb)]).decompressed()
    assert 500 * len(bomb) < BYTES
    assert opened.sizes.tolist() == [BYTES]


@given(st.binary(min_size=8, max_size=60), st.lists(st.integers(0, 59), max_size=9))
def test_values_are_gathered_from_any_places(content: bytes, places: list[int]) -> None:
    buffer = np.frombuffer(content, dtype=np.uint8)
    for kind in ("<u2", ">i4", "<f8", "u1"):
        dtype = np.dtype(kind)
        usable = [place for place in places if place + dtype.itemsize <= len(content)]
        usable.append(len(content) - dtype.itemsize)  # the last one
        expected = [np.frombuffer(content, dtype, 1, item)[0].tobytes() for item in usable]
        found = gather(buffer, np.array(usable), dtype)
        assert [item.tobytes() for item in found] == expected
        assert gather(buffer, np.array([], dtype=np.int64), dtype).dtype == dtype


def test_ids_of_connections() -> None:
    ids = np.array([3, 1, 3, 2])
    assert are_of(ids, {3}).tolist() == [True, False, True, False]
    assert are_of(ids, {1, 2}).tolist() == [False, True, False, True]
    assert are_of(ids, set()).tolist() == [False] * 4
    selections = [blocks.TopicSelection(frozenset(item)) for item in ({1, 2}, {2, 5})]
    assert all_connections(selections) == {1, 2, 5}
    assert are_same(ids[[0, 2]])
    assert are_same(ids[:1])
    assert not are_same(ids)


@given(
    st.binary(max_size=200),
    st.integers(1, 64),
    st.lists(st.tuples(st.integers(0, 220), st.integers(0, 80), st.integers(0, 260))),
)
def test_a_window_of_a_file_gives_the_slices_of_its_content(
    content: bytes, size: int, wanted: list[tuple[int, int, int]]
) -> None:
    source = mock.Mock()
    source.read = lambda offset, count: content[offset : offset + count]
    window = ByteWindow(source, size)
    assert window.at(0, 1, len(content)) == content[:1]
    for offset, count, more in wanted:
        end = min(offset + more, len(content))
        found = window.at(offset, count, max(end, offset))
        # Bytes that are in memory already may be after the end.
        assert content[offset : min(offset + count, end)] == found[: max(0, end - offset)]
        assert content[offset : offset + count].startswith(found)


def test_a_window_reads_once_what_is_near() -> None:
    content = bytes(range(100))
    reads: list[tuple[int, int]] = []
    source = mock.Mock()

    def read(offset: int, size: int) -> bytes:
        reads.append((offset, size))
        return content[offset : offset + size]

    source.read = read
    window = ByteWindow(source, 16)
    places = [(0, 4), (12, 4), (13, 4), (13, 16), (12, 1), (40, 30), (90, 4)]
    assert [window.at(*place, 100) for place in places] == [
        content[offset : offset + size] for offset, size in places
    ]
    # In the window, at its end, one beyond, at the end, before it, larger, at the file's end.
    assert reads == [(0, 16), (13, 16), (12, 16), (40, 30), (90, 10)]


@given(
    content=st.binary(max_size=60),
    ranges=st.lists(st.tuples(st.integers(0, 80), st.integers(0, 80))),
)
def test_a_file_gives_the_slices_of_its_content(
    tmp_path_factory: pytest.TempPathFactory, content: bytes, ranges: list[tuple[int, int]]
) -> None:
    path: Path = tmp_path_factory.getbasetemp() / "slices"
    path.write_bytes(content)
    source = LocalFile(path)
    assert (source.size, source.name) == (len(content), str(path))
    expected = [content[offset : offset + size] for offset, size in ranges]
    assert [source.read(*item) for item in ranges] == expected
    assert source.read_all(ranges) == expected
    source.close()


def test_a_file_is_read_in_pieces_if_the_system_gives_less(tmp_path: Path) -> None:
    path = tmp_path / "pieces"
    path.write_bytes(bytes(range(100)))
    source = LocalFile(path)
    with mock.patch("os.pread", lambda _, size, at: bytes(range(100))[at : at + min(size, 7)]):
        assert source.read(3, 50) == bytes(range(3, 53))
        assert source.read(95, 50) == bytes(range(95, 100))
    source.close()


def test_bytes_are_counted_by_the_innermost_block() -> None:
    with counting_fetched_bytes() as outer:
        current_counter().add(3)
        with counting_fetched_bytes() as inner:
            current_counter().add(4)
            current_counter().add(1)
        current_counter().add(10)
    assert (outer.total, inner.total) == (13, 5)
    assert current_counter() is not outer
