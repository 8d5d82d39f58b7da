"""Compressed data: what is decompressed, its limits, and the readable part of damage."""

from __future__ import annotations

import bz2
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from memory_file import Memory, chunk
from refusals import is_refused

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags import compression
from trajeval_ros.io.bags.blocks import LARGEST
from trajeval_ros.io.bags.byte_source import DamagedError
from trajeval_ros.io.bags.compression import (
    LARGEST_CHUNK,
    LARGEST_RATIO,
    decompress,
    decompress_file,
    most_of,
)
from trajeval_ros.io.bags.mcap_chunks import require_budget, require_size

MIB = 1 << 20
COMPRESS: dict[str, Callable[[bytes], bytes]] = {
    "": lambda data: data,
    "zstd": lambda data: zstandard.ZstdCompressor().compress(data),
    "lz4": lambda data: bytes(lz4.frame.compress(data)),
    "bz2": lambda data: bz2.compress(data, 1),  # blocks of 100 kB
}


@pytest.mark.parametrize("kind", COMPRESS)
@given(content=st.binary(max_size=300), limit=st.integers(0, 310))
def test_what_is_decompressed_ends_at_the_limit(kind: str, content: bytes, limit: int) -> None:
    found = decompress(kind, COMPRESS[kind](content), limit)
    assert bytes(found) == content[:limit]


@pytest.mark.parametrize("kind", [item for item in COMPRESS if item])
def test_the_readable_part_of_damaged_data_is_kept(kind: str) -> None:
    size = 400_000 if kind == "bz2" else 9 * MIB  # several pieces
    content = np.random.default_rng(0).bytes(size)
    stored = COMPRESS[kind](content)
    for limit in (size, size // 2 + 1):
        assert bytes(decompress(kind, stored, limit)) == content[:limit]
    part = bytes(decompress(kind, stored[: len(stored) // 2], size))
    assert content.startswith(part)
    assert len(part) > size // 3
    assert bytes(decompress(kind, b"nothing of this", 100)) == b""


def test_frames_of_zstd_in_a_row_are_read() -> None:
    both = COMPRESS["zstd"](b"one, ") + COMPRESS["zstd"](b"two")
    assert bytes(decompress("zstd", both, 100)) == b"one, two"
    with pytest.raises(ValueError, match="unknown compression 'brotli'"):
        decompress("brotli", b"", 1)


def test_the_accepted_sizes_of_decompressed_data() -> None:
    assert (LARGEST_CHUNK, LARGEST, LARGEST_RATIO) == (64 * MIB, 1024 * MIB, 500)
    assert (compression._LARGEST_FILE, compression._LARGEST_WINDOW) == (1 << 30, 1 << 27)
    assert [most_of(size, 1000) for size in (0, 1, 2, 3)] == [1000, 1000, 1000, 1500]


def test_a_file_is_decompressed_up_to_its_limit(tmp_path: Path) -> None:
    path, folder = tmp_path / "run.db3.zstd", tmp_path / "copies"
    folder.mkdir()
    content = np.random.default_rng(0).bytes(400_000) + bytes(9000)
    path.write_bytes(COMPRESS["zstd"](content))
    size = path.stat().st_size
    assert 500 * size > len(content)
    with mock.patch.multiple(compression, _PIECE=10_000, LARGEST_RATIO=1):
        for limit, is_kept in ((len(content), True), (len(content) - 1, False)):
            with mock.patch.object(compression, "_LARGEST_FILE", limit):
                assert is_refused(decompress_file, path, folder, error=InputError) != is_kept
    copy = decompress_file(path, folder)
    assert copy == folder / "run.db3"
    assert copy.read_bytes() == content
    other = tmp_path / "run.mcap.zst"
    other.write_bytes(path.read_bytes()[: size // 2])
    copy = decompress_file(other, folder)  # what can be read of a damaged file
    assert copy.name == "run.mcap"
    assert content.startswith(copy.read_bytes())
    assert copy.stat().st_size > 100_000
    other.write_bytes(b"no zstd")
    with pytest.raises(InputError, match=r"run\.mcap\.zst can't be decompressed"):
        decompress_file(other, folder)


def test_sizes_of_chunks() -> None:
    """Any chunk may have 64 MiB, larger ones 500 times their bytes, none more than 1 GiB."""
    for length, size, kind, refused in (
        (9, LARGEST_CHUNK, "zstd", False),
        (9, LARGEST_CHUNK + 1, "zstd", True),
        (9, LARGEST_CHUNK + 1, "", False),
        (LARGEST_CHUNK, LARGEST, "lz4", False),
        (LARGEST_CHUNK, LARGEST + 1, "lz4", True),
        (LARGEST, LARGEST, "", False),
        (LARGEST + 1, 9, "", True),
        (MIB, 500 * MIB, "zstd", False),
        (MIB, 500 * MIB + 1, "zstd", True),
    ):
        assert is_refused(require_size, chunk(length, size, kind), error=DamagedError) == refused


def test_the_size_of_all_chunks() -> None:
    source: Any = Memory(b"", 9)
    full = chunk(LARGEST_CHUNK, LARGEST // 2)
    require_budget(source, [full, full, chunk(9, LARGEST, ""), chunk(9, LARGEST)])
    with pytest.raises(InputError, match="a compression ratio above 500"):
        require_budget(source, [full, full, chunk(9, 1)])
    require_budget(Memory(b"", 3 * MIB), [full, full, chunk(9, 1)])  # type: ignore[arg-type]
