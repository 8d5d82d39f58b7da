"""Blocks of messages against plain lists, and ranges of bytes against slices."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from trajeval_ros.io.bags import blocks
from trajeval_ros.io.bags.blocks import (
    Block,
    block_of,
    blocks_of,
    in_order,
    merged,
)
from trajeval_ros.io.bags.byte_source import (
    ByteWindow,
    LocalFile,
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
    result = block(content, padding)
    assert listed(result) == content
    assert result.earliest == min((time for _, time, _ in content), default=0)
    small = result.compact()
    assert listed(small) == content
    assert small.earliest == result.earliest
    used = sum(len(payload) for *_, payload in content)
    assert len(small.buffer) == (used if 2 * used < len(result.buffer) else len(result.buffer))
    by_connection = [(which, listed(part)) for which, part in result.by_connection()]
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
        result = list(blocks_of(content))
        again = list(merged(map(block, [[item] for item in content])))
    assert [item for part in again for item in listed(part)] == content
    groups = [[(c, t, bytes(p)) for c, t, p in _rows(part)] for part in result]
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
    result = list(source.decompressed())
    assert [item for part in result for item in listed(part)] == [
        (row % 2, row, item) for row, item in enumerate(plain)
    ]
    assert all(part.earliest == -7 for part in result)


@given(
    st.binary(max_size=200),
    st.integers(1, 64),
    st.lists(st.tuples(st.integers(0, 220), st.integers(0, 80), st.integers(0, 260))),
)
def test_a_window_of_a_file_gives_the_slices_of_its_content(
    content: bytes, size: int, selected: list[tuple[int, int, int]]
) -> None:
    source = mock.Mock()
    source.read = lambda offset, count: content[offset : offset + count]
    window = ByteWindow(source, size)
    assert window.at(0, 1, len(content)) == content[:1]
    for offset, count, more in selected:
        end = min(offset + more, len(content))
        result = window.at(offset, count, max(end, offset))
        # Bytes that are in memory already may be after the end.
        assert content[offset : min(offset + count, end)] == result[: max(0, end - offset)]
        assert content[offset : offset + count].startswith(result)


def test_a_file_is_read_in_pieces_if_the_system_gives_less(tmp_path: Path) -> None:
    path = tmp_path / "pieces"
    path.write_bytes(bytes(range(100)))
    source = LocalFile(path)
    with mock.patch("os.pread", lambda _, size, at: bytes(range(100))[at : at + min(size, 7)]):
        assert source.read(3, 50) == bytes(range(3, 53))
        assert source.read(95, 50) == bytes(range(95, 100))
    source.close()
