"""Limits of reading sqlite3 files: groups of rows, sizes of pages, counts, and logs."""

from __future__ import annotations

import sqlite3
import struct
import sys
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.io.bags.test_sqlite_rows import bag, create, fill, rows_of
from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags import sqlite_bag
from trajeval_ros.io.bags.blocks import ROWS, TopicSelection, block_of
from trajeval_ros.io.bags.sqlite_bag import SqliteReader

Message = tuple[int, int, bytes]


def read(path: Path, *window: Any, in_order: bool = False) -> tuple[list[Message], list[str]]:
    reader = SqliteReader(path, path.name)
    selection = TopicSelection(frozenset({1, 2}))
    found = rows_of(reader.blocks([selection], *window, in_order=in_order))
    reader.close()
    return found, [*reader.damage, *selection.damage]


@pytest.mark.parametrize("most", [1, 3, 1000])
@pytest.mark.parametrize("size", [1, 20, 10_000])
@given(sizes=st.lists(st.integers(0, 15), max_size=20))
def test_rows_are_fetched_in_groups_of_bounded_size(
    sizes: list[int], most: int, size: int
) -> None:
    rows = [(place, bytes(length)) for place, length in enumerate(sizes)]
    with mock.patch.multiple(sqlite_bag, ROWS=most, _FETCHED=size):
        groups = list(sqlite_bag._groups(rows))
    assert [item for group in groups for item in group] == rows
    for group in groups:
        assert 0 < len(group) <= most
        assert sum(len(payload) for _, payload in group[:-1]) < size
    for group in groups[:-1]:
        assert len(group) == most or sum(len(payload) for _, payload in group) >= size
    assert (sqlite_bag.ROWS, sqlite_bag._FETCHED) == (ROWS, 1 << 18)


def test_windows_and_orders_of_rows(tmp_path: Path) -> None:
    rows = [(1 + row % 3, (7 * row) % 50, bytes([row])) for row in range(60)]
    path = bag(tmp_path / "x.db3", rows)
    wanted = [item for item in rows if item[0] != 3]
    assert read(path) == (wanted, [])
    for begin, end in ((None, 20), (20, None), (13, 27), (14, 14), (0, 50)):
        inside = [
            item
            for item in wanted
            if (begin is None or item[1] >= begin) and (end is None or item[1] < end)
        ]
        assert read(path, begin, end) == (inside, [])
        ordered = sorted(inside, key=lambda item: item[1])
        assert read(path, begin, end, in_order=True) == (ordered, [])
    reader = SqliteReader(path, "x")
    assert reader.span == (0, 49)
    assert [reader.count(topic) for topic in (1, 2, 3, 4)] == [20, 20, 20, 0]
    assert [connection.count for connection in reader.connections] == [-1] * 3
    reader.close()
    empty = SqliteReader(bag(tmp_path / "empty.db3", []), "empty")
    assert empty.span is None
    empty.close()


@pytest.mark.parametrize("count", [0, 1, 2])
def test_messages_of_topics_that_do_not_exist_are_counted(tmp_path: Path, count: int) -> None:
    rows = [(1, 5, b"one"), *[(9, 6, b"lost")] * count, (3, 7, b"other")]
    found, damage = read(bag(tmp_path / "x.db3", rows))
    assert found == [(1, 5, b"one")]
    messages = "1 message" if count == 1 else f"{count} messages"
    assert damage == ([f"x.db3 is damaged: {messages} of unknown topics"] if count else [])


@pytest.mark.parametrize("page_size", [512, 4096, 65536])
@pytest.mark.parametrize("missing", [0, 1])
def test_a_file_that_lacks_bytes_of_its_pages_is_refused(
    tmp_path: Path, page_size: int, missing: int
) -> None:
    path = bag(tmp_path / "x.db3", [(1, row, bytes(300)) for row in range(50)], page_size)
    content = path.read_bytes()
    assert len(content) % page_size == 0
    path.write_bytes(content[: len(content) - missing])
    if not missing:
        assert len(read(path)[0]) == 50
        return
    said = f"x is truncated: it has {len(content) - 1} of {len(content)} bytes"
    with pytest.raises(InputError, match=said):
        SqliteReader(path, "x")
    # Older versions of sqlite do not update the number of pages.
    changed = bytearray(content[:-1])
    changed[92:96] = struct.pack(">I", 77)
    path.write_bytes(bytes(changed))
    said = ""
    try:
        SqliteReader(path, "x").close()
    except (InputError, sqlite3.DatabaseError) as error:  # of sqlite itself, by its version
        said = str(error)
    assert "truncated" not in said


@pytest.mark.parametrize(("page", "frames"), [(512, 3), (4096, 1), (4096, 0)])
def test_pages_of_a_log_that_were_not_used_are_counted(
    tmp_path: Path, page: int, frames: int
) -> None:
    salt, other = b"saltsalt", b"othersal"
    header = struct.pack(">4I", 0x377F0682, 3007000, page, 0) + salt + bytes(8)
    frame = bytes(8) + salt + bytes(8 + page)
    old = bytes(8) + other + bytes(8 + page)
    log = tmp_path / "x.db3-wal"
    index = tmp_path / "x.db3-shm"
    for tail in (b"", frame[:-1], old, old + frame):
        log.write_bytes(header + frame * frames + tail)
        for used in range(frames + 2):
            index.write_bytes(bytes(16) + used.to_bytes(4, sys.byteorder) + bytes(9))
            said = f"{frames - used} of its {frames} pages are unreadable"
            assert sqlite_bag._lost_of_log(log) == (said if used < frames else "")
        index.unlink()
        lost = f"{frames} of its {frames} pages are unreadable"
        assert sqlite_bag._lost_of_log(log) == (lost if frames else "")
    for wrong in (header[:31], b"\1" + header[1:], b""):
        log.write_bytes(wrong + frame * 2 if len(wrong) == 32 else wrong)
        assert sqlite_bag._lost_of_log(log) == "none of its pages is readable"
    log.write_bytes(header[:3] + b"\x83" + header[4:] + frame)
    assert sqlite_bag._lost_of_log(log) == "1 of its 1 pages are unreadable"


def test_rows_that_repeat_end_at_the_size_of_the_file(tmp_path: Path) -> None:
    path = bag(tmp_path / "x.db3", [(1, row, bytes(1000)) for row in range(20)])
    reader = SqliteReader(path, "x")
    selection = TopicSelection(frozenset({1}))
    for size, told in ((20_000, False), (19_999, True)):
        selection.damage.clear()
        reader._size = size
        with mock.patch.object(sqlite_bag, "_FETCHED", 1000):
            found = rows_of(reader.blocks([selection]))
        assert len(found) == (19 if told else 20)
        assert bool(selection.damage) == told
    for size, refused in ((8, False), (7, True)):
        reader._size = size
        rows = [("abcd", 1, "efgh")]
        with mock.patch.object(reader, "_query", return_value=iter(rows)):
            if refused:
                with pytest.raises(sqlite3.DatabaseError, match="its rows overlap"):
                    list(reader._bounded(""))
            else:
                assert list(reader._bounded("")) == rows
    reader.close()


def test_a_query_may_take_64_operations_per_row_that_fits(tmp_path: Path) -> None:
    reader = SqliteReader(bag(tmp_path / "x.db3", []), "x")
    assert (sqlite_bag._MOST_OPERATIONS, sqlite_bag._SMALLEST_ROW) == (64, 8)
    assert sqlite_bag._CHECKED == 1 << 16
    for size, checks in ((0, 16), (8191, 16), (8192, 17), (81_920, 26)):
        reader._size = size
        reader._query("SELECT 1")
        assert [reader._is_over_limit() for _ in range(checks + 1)] == [False] * checks + [True]
    reader.close()


def test_topics_and_definitions_of_a_file(tmp_path: Path) -> None:
    database = create(tmp_path / "x.db3")
    database.execute(
        "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT, encoding TEXT, "
        "encoded_message_definition TEXT, type_description_hash TEXT)"
    )
    database.execute("UPDATE topics SET type='b/msg/C', offered_qos_profiles='qos' WHERE id=2")
    database.execute("UPDATE topics SET type = 'c/msg/D' WHERE id = 3")
    rows = [
        ("a/msg/B", "ros2msg", "int8 x"),
        ("b/msg/C", "ros2idl", "module"),
        ("c/msg/D", "protobuf", "text"),
    ]
    database.executemany("INSERT INTO message_definitions VALUES (NULL, ?, ?, ?, '')", rows)
    fill(database, [])
    database.close()
    reader = SqliteReader(tmp_path / "x.db3", "x")
    assert [
        (
            connection.id,
            connection.topic,
            connection.type,
            connection.language,
            connection.definition,
            connection.encoding,
            connection.qos,
        )
        for connection in reader.connections
    ] == [
        (1, "/1", "a/msg/B", "MSG", "int8 x", "cdr", ""),
        (2, "/2", "b/msg/C", "IDL", "module", "cdr", "qos"),
        (3, "/3", "c/msg/D", "", "", "cdr", ""),
    ]
    reader.close()


def test_messages_larger_than_the_file_end_the_reading(tmp_path: Path) -> None:
    """Pages that refer to one another could be read without end."""
    path = bag(tmp_path / "x.db3", [(1, row, bytes(100)) for row in range(3)])
    reader, selection = SqliteReader(path, "x"), TopicSelection(frozenset({1}))
    size = path.stat().st_size
    taken = []

    def found(*_: Any) -> Any:
        for number, part in enumerate((size // 2, size - size // 2, 1, 1)):
            taken.append(number)
            yield block_of([1], [number], [bytes(part)])

    with mock.patch.object(SqliteReader, "_found", found):
        blocks = list(reader.blocks([selection]))
    reader.close()
    assert [len(block.buffer) for block in blocks] == [size // 2, size - size // 2]
    assert taken == [0, 1, 2]
    assert selection.damage == ["x is damaged: messages overlap, the rest was not read"]
