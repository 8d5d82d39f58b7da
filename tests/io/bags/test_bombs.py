"""Small files that would become large ones: bounded before they fill memory or a disk."""

from __future__ import annotations

import sqlite3
import tracemalloc
from pathlib import Path

import pytest
import zstandard
from damaged_bags import (
    COUNT,
    SECOND,
    assert_damaged,
    definition,
    mcap_file,
    payloads,
    rows_of,
    sqlite_file,
)
from mcap.records import Channel, Schema
from mcap.writer import CompressionType
from mcap_layouts import Layout, Part

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.io.bags import compression, mcap_bag
from trajeval_ros.io.bags.write_bag import POSE_STAMPED
from trajeval_ros.io.sources import read_trajectory

MIB = 1 << 20


def test_messages_that_become_much_are_taken_one_by_one(tmp_path: Path) -> None:
    compressor = zstandard.ZstdCompressor()
    zeros = compressor.compress(bytes(64 * MIB))
    poses = [compressor.compress(payload) for payload in payloads(20)]
    path = mcap_file(
        tmp_path / "x.mcap", messages=[*poses, *[zeros] * 16], compression=CompressionType.NONE
    )
    assert path.stat().st_size < MIB
    tracemalloc.start()
    read = read_trajectory(str(path))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(read) == 20
    assert sum(read.reading.dropped.values()) == 16
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
    with pytest.raises(InputError, match="compression ratio above"):
        read_trajectory(str(path))


def with_zeros(path: Path, count: int, size: int, *, has_summary: bool = True) -> Path:
    """Write poses, and chunks of zeros; each of these takes a ten thousandth of its size."""
    poses = [(1, row * SECOND, payload) for row, payload in enumerate(payloads(20))]
    zeros = Part([(2, 5 * SECOND, bytes(size))], compression="zstd")
    layout = Layout(
        [Schema(1, definition(POSE_STAMPED), "ros2msg", POSE_STAMPED)],
        [Channel(1, "/pose", "cdr", {}, 1), Channel(2, "/pose", "cdr", {}, 1)],
        [Part(poses), *[zeros] * count],
        has_summary=has_summary,
    )
    path.write_bytes(bytes(layout))
    return path


@pytest.mark.parametrize("has_summary", [True, False])
def test_a_chunk_that_becomes_much_is_left_out(has_summary: bool, tmp_path: Path) -> None:
    path = with_zeros(tmp_path / "x.mcap", 3, 100 * MIB, has_summary=has_summary)
    assert path.stat().st_size < MIB
    tracemalloc.start()
    read = read_trajectory(str(path))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert rows_of(read) == list(range(20))
    assert "a chunk has a compression ratio above 500" in read.reading.messages(Level.ERROR)[0]
    assert "3 times" in read.reading.messages(Level.ERROR)[0]
    assert peak < 20 * MIB


@pytest.mark.parametrize("has_summary", [True, False])
def test_a_file_of_which_no_chunk_becomes_too_much_but_all_do(
    has_summary: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = with_zeros(tmp_path / "x.mcap", 5, 4 * MIB, has_summary=has_summary)
    assert rows_of(read_trajectory(str(path))) == list(range(20))
    monkeypatch.setattr("trajeval_ros.io.bags.mcap_chunks.LARGEST", 16 * MIB)
    with pytest.raises(InputError, match="compression ratio above 500"):
        read_trajectory(str(path))


def test_what_is_decompressed_ahead_is_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_bag, "_IN_FLIGHT", 16 * MIB)
    path = with_zeros(tmp_path / "x.mcap", 8, 16 * MIB)
    tracemalloc.start()
    read = read_trajectory(str(path))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert rows_of(read) == list(range(20))
    assert peak < 5 * 16 * MIB  # one chunk, in pieces, joined and searched


def test_a_message_that_becomes_much_is_none(tmp_path: Path) -> None:
    zeros = zstandard.ZstdCompressor().compress(bytes(32 * MIB))
    path = mcap_file(
        tmp_path / "x.mcap", messages=[*payloads(20), zeros], compression=CompressionType.NONE
    )
    tracemalloc.start()
    read = read_trajectory(str(path))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert rows_of(read) == list(range(20))
    assert read.reading.dropped == {"undecodable": 1}
    assert peak < 32 * MIB


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
    read = assert_damaged(path, "is damaged", "ignored")
    assert len(read) > 0.8 * COUNT
