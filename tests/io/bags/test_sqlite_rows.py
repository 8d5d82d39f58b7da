"""Messages that the reader of sqlite3 files returns, for all layouts of rows and pages."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.io.bags.blocks import Block, TopicSelection
from trajeval_ros.io.bags.sqlite_bag import SqliteReader

Message = tuple[int, int, bytes]  # topic, log time, payload

ROWS = 600
LONG = 5000  # bytes, more than a page
# Of every number of bytes that sqlite stores an integer in, with the neighbours of its ends.
TIMES = sorted(
    {sign * (1 << bits) + more for bits in (0, 7, 15, 23, 31, 47) for sign in (-1, 1)
     for more in (-1, 0, 1)}
    | {-(2**63), 2**63 - 1, 1_700_000_000 * 10**9}
)  # fmt: skip


def create(path: Path, page_size: int = 4096, data: str = "BLOB NOT NULL") -> sqlite3.Connection:
    """Return an empty bag as rosbag2 creates it."""
    database = sqlite3.connect(path)
    database.executescript(
        f"""
        PRAGMA page_size={page_size};
        CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
            serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
        CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
            timestamp INTEGER NOT NULL, data {data});
        CREATE INDEX timestamp_idx ON messages (timestamp ASC);
        """
    )
    names = [(topic, f"/{topic}") for topic in (1, 2, 3)]
    database.executemany("INSERT INTO topics VALUES (?, ?, 'a/msg/B', 'cdr', '')", names)
    database.commit()
    return database


def fill(database: sqlite3.Connection, rows: Iterable[tuple[int, int, bytes]]) -> None:
    database.executemany("INSERT INTO messages VALUES (NULL, ?, ?, ?)", rows)
    database.commit()


def short_messages(seed: int, count: int = ROWS, size: int = 300) -> list[Message]:
    """Return messages of three topics, each shorter than a page."""
    random = np.random.default_rng(seed)
    topics = random.integers(1, 4, count).tolist()
    sizes = random.integers(0, size, count).tolist()
    times = random.choice(np.array(TIMES), count).tolist()
    return list(zip(topics, times, map(random.bytes, sizes), strict=True))


def bag(path: Path, rows: Iterable[Message], page_size: int = 4096) -> Path:
    database = create(path, page_size)
    fill(database, rows)
    database.close()
    return path


def rows_of(blocks: Iterable[Block]) -> list[Message]:
    return [
        (topic, time, bytes(payload))
        for block in blocks
        for topic, time, payload in zip(
            block.connections.tolist(), block.log_times.tolist(), block.payloads(), strict=True
        )
    ]


def read(
    path: Path, topics: Iterable[int], begin: int | None = None
) -> tuple[list[Message], list[Message]]:
    """Return the messages of some topics: by the reader, and by a query."""
    expected = frozenset(topics)
    reader = SqliteReader(path, path.name)
    try:
        blocks = reader.blocks([TopicSelection(expected)], begin)
        whole = rows_of(blocks)
    finally:
        reader.close()
    database = opened(path)
    marks = ",".join("?" * len(expected))
    queried = database.execute(
        f"SELECT topic_id, timestamp, ifnull(CAST(data AS BLOB), x'') FROM messages "
        f"WHERE topic_id IN ({marks}) AND timestamp >= ? ORDER BY id",
        (*expected, -(2**63) if begin is None else begin),
    ).fetchall()
    database.close()
    return whole, queried


def opened(path: Path) -> sqlite3.Connection:
    # Whoever can write would merge a log when it closes the file.
    return sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True)


def root_of(path: Path) -> int:
    """Return the number of the first page of the messages."""
    database = opened(path)
    query = "SELECT rootpage FROM sqlite_master WHERE name = 'messages'"
    root = int(database.execute(query).fetchone()[0])
    database.close()
    return root


@pytest.mark.slow
@given(
    st.integers(0, 2**32),
    st.integers(0, ROWS),
    st.sampled_from([512, 1024, 4096, 65536]),
    st.sets(st.integers(1, 3), min_size=1),
    st.sampled_from([None, *TIMES]),
    st.sampled_from([1, 2, 5]),
)
def test_the_reader_has_the_rows_of_a_query(
    seed: int, count: int, page_size: int, topics: set[int], begin: int | None, every: int
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        database = create(Path(folder) / "x.db3", page_size)
        fill(database, short_messages(seed, count))
        if every > 1:
            database.execute("DELETE FROM messages WHERE id % ? = 1", (every,))
            database.commit()
        database.close()
        whole, queried = read(Path(folder) / "x.db3", topics, begin)
    assert whole == queried


def test_many_levels_of_pages(tmp_path: Path) -> None:
    whole, queried = read(bag(tmp_path / "x.db3", short_messages(0, 20_000, 40), 512), {1, 3})
    assert len(queried) > 10_000
    assert whole == queried


def test_long_messages_among_short_ones(tmp_path: Path) -> None:
    rows = [
        (topic, row, bytes(size)) for row in range(ROWS) for topic, size in ((1, 99), (2, LONG))
    ]
    path = bag(tmp_path / "x.db3", rows)
    for topics in ({1}, {2}, {1, 2}):
        whole, queried = read(path, topics)
        assert whole == queried
        assert len(whole) == ROWS * len(topics)


def test_lengths_around_the_one_that_leaves_the_page(tmp_path: Path) -> None:
    rows = [(1, row, bytes([row % 256]) * (4000 + row)) for row in range(100)]
    whole, queried = read(bag(tmp_path / "x.db3", rows), {1})
    assert whole == queried == rows


@pytest.mark.parametrize(
    "odd",
    [
        "UPDATE messages SET data = 'text' WHERE id = 400",
        "UPDATE messages SET data = NULL WHERE id = 400",
        "UPDATE messages SET id = -5 WHERE id = 400",
        "UPDATE messages SET id = 1 << 60 WHERE id = 400",
    ],
)
def test_odd_rows(odd: str, tmp_path: Path) -> None:
    database = create(tmp_path / "x.db3", data="BLOB")
    fill(database, [(1, row, bytes(3000)) for row in range(2000)])
    database.execute(odd)
    database.commit()
    database.close()
    whole, queried = read(tmp_path / "x.db3", {1})
    assert whole == queried
    assert len(whole) == 2000


def test_rows_deleted_in_the_log_are_not_read(tmp_path: Path) -> None:
    database = create(tmp_path / "x.db3")
    database.execute("PRAGMA journal_mode=WAL")
    fill(database, short_messages(1))
    database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    database.execute("DELETE FROM messages WHERE id < 200")
    database.commit()
    (tmp_path / "copy").mkdir()
    for name in ("x.db3", "x.db3-wal"):
        shutil.copy(tmp_path / name, tmp_path / "copy")
    database.close()
    whole, queried = read(tmp_path / "copy" / "x.db3", {1, 2})
    assert whole == queried
    assert 0 < len(whole) < ROWS


def with_change(path: Path, change: Callable[[np.ndarray], None], page_size: int = 4096) -> Path:
    """Change the pages (P, page size) of a file."""
    pages = np.frombuffer(path.read_bytes(), dtype=np.uint8).reshape(-1, page_size).copy()
    change(pages)
    path.write_bytes(pages.tobytes())
    return path


def leaves(pages: np.ndarray) -> np.ndarray:
    return np.flatnonzero(pages[:, 0] == 13)


def zero_a_page(pages: np.ndarray) -> None:
    pages[leaves(pages)[900]] = 0


def cells_outside(pages: np.ndarray) -> None:
    pages[leaves(pages)[900], 8:10] = 255


def a_longer_record(pages: np.ndarray) -> None:
    page = pages[leaves(pages)[900]]
    page[256 * int(page[8]) + int(page[9])] += 1


def a_longer_header(pages: np.ndarray) -> None:
    page = pages[leaves(pages)[900]]
    page[256 * int(page[8]) + int(page[9]) + 4] += 1  # after the record's size and id


@pytest.mark.parametrize("change", [zero_a_page, cells_outside, a_longer_record, a_longer_header])
def test_rows_around_a_damaged_page_are_read(
    change: Callable[[np.ndarray], None], tmp_path: Path
) -> None:
    rows = [(1, row, bytes([row % 256]) * 1900) for row in range(2000)]
    path = bag(tmp_path / "x.db3", rows)
    with_change(path, change)
    reader = SqliteReader(path, path.name)
    selection = TopicSelection(frozenset({1}))
    whole = rows_of(reader.blocks([selection]))
    reader.close()
    # sqlite does not find every wrong length, and then returns what the record seems to have.
    assert whole[:1790] == rows[:1790]
    assert whole[-190:] == rows[-190:]
    assert len(whole) >= 1990
    assert selection.damage or change in (a_longer_record, a_longer_header)


def test_pages_that_lead_to_themselves(tmp_path: Path) -> None:
    rows = [(1, row, bytes(1900)) for row in range(3000)]
    path = bag(tmp_path / "x.db3", rows)
    pages = np.frombuffer(path.read_bytes(), dtype=np.uint8).reshape(-1, 4096)
    root = root_of(path)

    def lead_to(number: int) -> Callable[[np.ndarray], None]:
        def change(pages: np.ndarray) -> None:
            page = pages[root - 1]
            count = 256 * int(page[3]) + int(page[4])
            begins = page[12 : 12 + 2 * count].view(">u2").astype(int)
            for begin in (8, *begins):
                page[begin : begin + 4] = list(number.to_bytes(4, "big"))

        return change

    content = path.read_bytes()
    leaf = int(leaves(pages)[5]) + 1
    for number in (root, 10**6, 0, 1, leaf):
        path.write_bytes(content)
        with_change(path, lead_to(number))
        reader = SqliteReader(path, path.name)
        selection = TopicSelection(frozenset({1}))
        result = rows_of(reader.blocks([selection]))
        reader.close()
        assert set(result) <= set(rows)
        # sqlite reads the pages of another table, or a page several times, without an error.
        assert selection.damage or number in (1, leaf)


def test_a_damaged_row_number_loses_no_other_row(tmp_path: Path) -> None:
    rows = [(1, row, bytes([row % 256]) * 200) for row in range(6000)]
    path = bag(tmp_path / "x.db3", rows)

    def raise_a_number(pages: np.ndarray) -> None:
        page = pages[leaves(pages)[100]]
        cell = 256 * int(page[8]) + int(page[9])
        page[cell + 2] |= 0x40  # the first byte of the number, after two of the size

    with_change(path, raise_a_number)
    whole, queried = read(path, {1})
    assert whole == queried
    assert sorted(whole) == rows


def read_window(
    path: Path, *window: Any, in_order: bool = False
) -> tuple[list[Message], list[str]]:
    reader = SqliteReader(path, path.name)
    selection = TopicSelection(frozenset({1, 2}))
    result = rows_of(reader.blocks([selection], *window, in_order=in_order))
    reader.close()
    return result, [*reader.damage, *selection.damage]


def test_windows_and_orders_of_rows(tmp_path: Path) -> None:
    rows = [(1 + row % 3, (7 * row) % 50, bytes([row])) for row in range(60)]
    path = bag(tmp_path / "x.db3", rows)
    expected = [item for item in rows if item[0] != 3]
    assert read_window(path) == (expected, [])
    for begin, end in ((None, 20), (20, None), (13, 27), (14, 14), (0, 50)):
        inside = [
            item
            for item in expected
            if (begin is None or item[1] >= begin) and (end is None or item[1] < end)
        ]
        assert read_window(path, begin, end) == (inside, [])
        ordered = sorted(inside, key=lambda item: item[1])
        assert read_window(path, begin, end, in_order=True) == (ordered, [])
    reader = SqliteReader(path, "x")
    assert reader.span == (0, 49)
    assert [reader.count(topic) for topic in (1, 2, 3, 4)] == [20, 20, 20, 0]
    assert [connection.count for connection in reader.connections] == [-1] * 3
    reader.close()
    empty = SqliteReader(bag(tmp_path / "empty.db3", []), "empty")
    assert empty.span is None
    empty.close()
