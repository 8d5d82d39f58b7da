"""Messages read from sqlite's pages are those of sqlite's own queries."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.io.bags.blocks import Block
from trajeval_ros.io.bags.byte_source import LocalFile
from trajeval_ros.io.bags.selection import TopicSelection
from trajeval_ros.io.bags.sqlite_bag import SqliteReader
from trajeval_ros.io.bags.sqlite_pages import MessagePages

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


@dataclass
class Read:
    """What a file has of some topics: by the reader, by pages alone, and by a query."""

    whole: list[Message]
    paged: list[Message]
    queried: list[Message]


def read(path: Path, topics: Iterable[int], begin: int | None = None) -> Read:
    wanted = frozenset(topics)
    reader = SqliteReader(path, path.name)
    try:
        blocks = reader.blocks([TopicSelection(wanted)], begin)
        whole = rows_of(block for _, block in blocks)
    finally:
        reader.close()
    paged = pages_of(path, root_of(path), wanted)
    database = opened(path)
    marks = ",".join("?" * len(wanted))
    queried = database.execute(
        f"SELECT topic_id, timestamp, CAST(data AS BLOB) FROM messages "
        f"WHERE topic_id IN ({marks}) AND timestamp >= ? ORDER BY id",
        (*wanted, -(2**63) if begin is None else begin),
    ).fetchall()
    database.close()
    return Read(whole, paged, queried)


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


def pages_of(path: Path, root: int, wanted: frozenset[int]) -> list[Message]:
    file = LocalFile(path)
    try:
        return rows_of(block for _, block in MessagePages(file, root).blocks(wanted))
    finally:
        file.close()


def assert_prefix(found: Read) -> None:
    assert found.whole == found.queried
    assert found.paged == found.queried[: len(found.paged)]


@given(
    st.integers(0, 2**32),
    st.integers(0, ROWS),
    st.sampled_from([512, 1024, 4096, 65536]),
    st.sets(st.integers(1, 3), min_size=1),
    st.sampled_from([None, *TIMES]),
    st.sampled_from([1, 2, 5]),
)
def test_pages_have_the_rows_of_a_query(
    seed: int, count: int, page_size: int, topics: set[int], begin: int | None, every: int
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        database = create(Path(folder) / "x.db3", page_size)
        fill(database, short_messages(seed, count))
        if every > 1:
            database.execute("DELETE FROM messages WHERE id % ? = 1", (every,))
            database.commit()
        database.close()
        found = read(Path(folder) / "x.db3", topics, begin)
    assert found.whole == found.queried
    if begin is None:
        assert found.paged == found.queried


def test_many_levels_of_pages(tmp_path: Path) -> None:
    found = read(bag(tmp_path / "x.db3", short_messages(0, 20_000, 40), 512), {1, 3})
    assert len(found.queried) > 10_000
    assert found.whole == found.paged == found.queried


def test_long_messages_of_other_topics_are_passed_over(tmp_path: Path) -> None:
    rows = [
        (topic, row, bytes(size)) for row in range(ROWS) for topic, size in ((1, 99), (2, LONG))
    ]
    path = bag(tmp_path / "x.db3", rows)
    found = read(path, {1})
    assert found.whole == found.paged == found.queried
    assert len(found.paged) == ROWS
    for topics in ({2}, {1, 2}):
        found = read(path, topics)
        assert_prefix(found)
        assert found.paged == []


def test_lengths_around_the_one_that_leaves_the_page(tmp_path: Path) -> None:
    rows = [(1, row, bytes([row % 256]) * (4000 + row)) for row in range(100)]
    found = read(bag(tmp_path / "x.db3", rows), {1})
    assert found.whole == found.queried
    for row in rows:  # each alone, so that all that stay in a page are read from it
        path = tmp_path / f"{row[1]}.db3"
        alone = read(bag(path, [row]), {1})
        # Its header has 6 bytes, topic and time one each, or none for 0 and 1.
        record = 6 + len(row[2]) + (row[1] > 1)
        assert len(alone.paged) == (record <= 4096 - 35)
        assert alone.whole == [row]
        path.unlink()


@pytest.mark.parametrize(
    "odd",
    [
        "UPDATE messages SET data = 'text' WHERE id = 400",
        "UPDATE messages SET data = NULL WHERE id = 400",
        "UPDATE messages SET id = -5 WHERE id = 400",
        "UPDATE messages SET id = 1 << 60 WHERE id = 400",
    ],
)
def test_odd_rows_are_left_to_sqlite(odd: str, tmp_path: Path) -> None:
    database = create(tmp_path / "x.db3", data="BLOB")
    fill(database, [(1, row, bytes(3000)) for row in range(2000)])
    database.execute(odd)
    database.commit()
    database.close()
    found = read(tmp_path / "x.db3", {1})
    if "NULL" in odd:
        found.queried = [(topic, time, payload or b"") for topic, time, payload in found.queried]
    assert_prefix(found)
    assert len(found.paged) < 2000


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
    found = read(tmp_path / "copy" / "x.db3", {1, 2})
    assert found.whole == found.queried
    assert len(found.paged) > len(found.whole)  # the pages still have them


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
def test_damaged_pages_end_the_messages(
    change: Callable[[np.ndarray], None], tmp_path: Path
) -> None:
    rows = [(1, row, bytes([row % 256]) * 1900) for row in range(2000)]
    path = bag(tmp_path / "x.db3", rows)
    root = root_of(path)
    with_change(path, change)
    reader = SqliteReader(path, path.name)
    selection = TopicSelection(frozenset({1}))
    whole = rows_of(block for _, block in reader.blocks([selection]))
    reader.close()
    paged = pages_of(path, root, selection.connections)
    assert 0 < len(paged) < len(whole)
    # sqlite does not find every wrong length, and then returns what the record seems to have.
    assert whole[: len(paged)] == rows[: len(paged)]
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

    for number in (root, 10**6, 0, 1):
        with_change(path, lead_to(number))
        assert pages_of(path, root, frozenset({1})) == []
    leaf = int(leaves(pages)[5]) + 1
    with_change(path, lead_to(leaf))
    assert pages_of(path, root, frozenset({1})) == []


class FailingDisk(LocalFile):
    """A file whose second half can't be read."""

    def read(self, offset: int, size: int) -> bytes:
        if offset + size > self.size // 2:
            raise OSError("Input/output error")
        return super().read(offset, size)


def test_a_disk_that_fails_leaves_the_rest_to_sqlite(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = bag(tmp_path / "x.db3", [(1, row, bytes(1900)) for row in range(3000)])
    monkeypatch.setattr("trajeval_ros.io.bags.sqlite_bag.LocalFile", FailingDisk)
    found = read(path, {1})
    assert found.whole == found.queried
