"""Small files that would become large ones: bounded before they fill memory or a disk."""

from __future__ import annotations

import sqlite3
import tracemalloc
from pathlib import Path

import pytest
import zstandard
from mcap.writer import CompressionType
from test_io_damage import COUNT, assert_damaged, mcap_file, payloads, sqlite_file

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags import compression
from trajeval_ros.io.sources import read_trajectory

MIB = 1 << 20


def test_messages_that_become_much_are_taken_one_by_one(tmp_path: Path) -> None:
    compressor = zstandard.ZstdCompressor()
    zeros = compressor.compress(bytes(64 * MIB))
    poses = [compressor.compress(each) for each in payloads(20)]
    path = mcap_file(
        tmp_path / "x.mcap", messages=[*poses, *[zeros] * 16], compression=CompressionType.NONE
    )
    assert path.stat().st_size < MIB
    tracemalloc.start()
    read = read_trajectory(str(path))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(read) == 20
    assert sum(read.dropped.values()) == 16
    assert peak < 4 * 64 * MIB  # of 1 GiB in all


def test_a_file_that_becomes_a_thousand_times_its_size_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compression, "_LARGEST_FILE", 64 * MIB)
    path = tmp_path / "x.db3.zstd"
    with (
        path.open("wb") as file,
        zstandard.ZstdCompressor(level=1).stream_writer(file) as writer,
    ):
        writer.write(sqlite_file(tmp_path).read_bytes())
        writer.write(bytes(128 * MIB))
    assert path.stat().st_size < MIB // 4
    with pytest.raises(InputError, match="times its size, which no recording does"):
        read_trajectory(str(path))


def test_a_leap_of_ids_in_a_damaged_file_ends(tmp_path: Path) -> None:
    path = sqlite_file(tmp_path)
    with sqlite3.connect(path) as database:
        database.execute(
            "INSERT INTO messages SELECT 1 << 50, topic_id, timestamp, data FROM messages "
            "WHERE id = 5"
        )
    database.close()
    content = bytearray(path.read_bytes())
    middle = len(content) // 2 // 4096 * 4096
    content[middle : middle + 4096] = b"\xff" * 4096
    path.write_bytes(content)
    read = assert_damaged(path, "is damaged", "were not looked for")
    assert len(read) > 0.8 * COUNT
