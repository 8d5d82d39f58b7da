"""Limits of reading sqlite3 files: groups of rows, sizes of pages, counts, and logs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.io.bags.test_sqlite_rows import bag, rows_of
from trajeval_ros.io.bags.blocks import TopicSelection
from trajeval_ros.io.bags.sqlite_bag import SqliteReader

Message = tuple[int, int, bytes]


def read(path: Path, *window: Any, in_order: bool = False) -> tuple[list[Message], list[str]]:
    reader = SqliteReader(path, path.name)
    selection = TopicSelection(frozenset({1, 2}))
    found = rows_of(reader.blocks([selection], *window, in_order=in_order))
    reader.close()
    return found, [*reader.damage, *selection.damage]


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
