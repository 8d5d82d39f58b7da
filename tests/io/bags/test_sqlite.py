"""Files of rosbag2's sqlite3 storage: damaged, unfinished, old, or with odd rows."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from damaged_bags import COUNT, assert_damaged, assert_whole, payloads, rows_of, sqlite_file
from made_bags import refusal

from trajeval_ros.formatting.remarks import Level
from trajeval_ros.io.bags.write_bag import POSE_STAMPED
from trajeval_ros.io.sources import read_trajectory


def test_garbage_in_the_middle_of_sqlite(tmp_path: Path) -> None:
    path = sqlite_file(tmp_path)
    content = bytearray(path.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 8000] = np.random.default_rng(0).bytes(8000)
    path.write_bytes(content)
    read = assert_damaged(path, "is damaged")
    assert len(read) > 0.8 * COUNT
    assert (np.diff(read.positions[:, 0]) > 0).all()


@pytest.mark.parametrize("size", [0, 100, 4096, 20_000])
def test_the_beginning_of_sqlite_alone(size: int, tmp_path: Path) -> None:
    path = sqlite_file(tmp_path)
    path.write_bytes(path.read_bytes()[:size])
    assert path.name in refusal(path)


def unfinished(folder: Path) -> Path:
    """Write a file whose last messages wait in the log beside it."""
    folder.mkdir()
    path = sqlite_file(folder)
    live = sqlite3.connect(path)
    live.execute("PRAGMA journal_mode=WAL")
    rows = live.execute("SELECT * FROM messages WHERE id > 300 ORDER BY id").fetchall()
    live.execute("DELETE FROM messages WHERE id > 300")
    live.commit()
    live.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    live.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
    live.commit()
    for suffix in ("", "-wal"):
        shutil.copy(f"{path}{suffix}", folder / f"x.db3{suffix}")
    live.close()
    return folder / "x.db3"


def test_messages_that_wait_in_the_log_are_read(tmp_path: Path) -> None:
    assert_whole(unfinished(tmp_path / "x"))


def test_a_log_that_is_damaged_is_told(tmp_path: Path) -> None:
    path = unfinished(tmp_path / "x")
    log = Path(f"{path}-wal")
    content = log.read_bytes()
    middle = len(content) // 2
    flipped = content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
    for damaged in (content[:middle], flipped, content[:20], b"no log", b"\0" + content[1:]):
        for file in tmp_path.glob("x/x.db3-shm"):
            file.unlink()
        log.write_bytes(damaged)
        read = assert_damaged(path, "x.db3-wal: ", "readable", "messages are missing")
        assert rows_of(read) == list(range(300))


@pytest.mark.parametrize("version", [1, 2])
def test_old_files_without_definitions(version: int, tmp_path: Path) -> None:
    database = sqlite3.connect(tmp_path / "old.db3")
    qos = ", offered_qos_profiles TEXT NOT NULL" if version == 2 else ""
    database.execute(
        "CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
        f"serialization_format TEXT NOT NULL{qos})"
    )
    database.execute(
        "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, "
        "timestamp INTEGER NOT NULL, data BLOB NOT NULL)"
    )
    more = ", ''" if version == 2 else ""
    database.execute(f"INSERT INTO topics VALUES (1, '/pose', '{POSE_STAMPED}', 'cdr'{more})")
    database.execute(f"INSERT INTO topics VALUES (2, '/x', 'my_msgs/msg/Custom', 'cdr'{more})")
    rows = ((1, row, payload) for row, payload in enumerate(payloads()))
    database.executemany("INSERT INTO messages VALUES (NULL, ?, ?, ?)", rows)
    database.commit()
    database.close()
    assert_whole(tmp_path / "old.db3")


def changed_by(path: Path, *statements: str) -> Path:
    with sqlite3.connect(path) as database:
        for statement in statements:
            database.execute(statement)
    database.close()
    return path


def test_texts_that_are_stored_as_blobs(tmp_path: Path) -> None:
    path = changed_by(
        sqlite_file(tmp_path),
        "UPDATE topics SET type = CAST(type AS BLOB), name = CAST(name AS BLOB), "
        "serialization_format = CAST(serialization_format AS BLOB)",
        "UPDATE message_definitions SET topic_type = CAST(topic_type AS BLOB), "
        "encoding = CAST(encoding AS BLOB), "
        "encoded_message_definition = CAST(encoded_message_definition AS BLOB)",
    )
    assert_whole(path)


def test_texts_that_are_none(tmp_path: Path) -> None:
    path = changed_by(
        sqlite_file(tmp_path),
        "INSERT INTO topics SELECT 90, CAST(x'FF00' AS TEXT), x'FF', 5, 0.5, '' FROM topics",
        "INSERT INTO message_definitions VALUES (90, 5, x'FF', 0.5, '')",
    )
    assert_whole(path)


def test_rows_that_are_no_messages_are_counted(tmp_path: Path) -> None:
    path = changed_by(
        sqlite_file(tmp_path),
        "UPDATE messages SET data = 'text' WHERE id = 3",
        "UPDATE messages SET data = 5 WHERE id = 5",
        "UPDATE messages SET timestamp = 'never' WHERE id = 7",
        "UPDATE messages SET timestamp = x'FF' WHERE id = 9",
        "UPDATE messages SET timestamp = 1e300 WHERE id = 11",
    )
    read = read_trajectory(str(path))
    # What a bag has at the end of all times comes last, and alone.
    assert sorted(rows_of(read)) == [row for row in range(COUNT) if row not in (2, 4, 10)]
    assert read.reading.dropped == {"undecodable": 2, "lone_stamp": 1}


def test_one_definition_is_missing(tmp_path: Path) -> None:
    path = sqlite_file(tmp_path)
    database = sqlite3.connect(path)
    database.execute("DELETE FROM message_definitions")
    database.execute("INSERT INTO message_definitions VALUES (9, 'a/msg/B', 'x', '', '')")
    database.commit()
    database.close()
    read = read_trajectory(str(path))
    assert rows_of(read) == list(range(COUNT))
    assert not read.reading.messages(Level.ERROR)
