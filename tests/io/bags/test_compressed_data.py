"""Compressed data: what is decompressed, its limits, and the readable part of damage."""

from __future__ import annotations

import bz2
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.compression import (
    decompress,
    decompress_file,
)

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
    result = decompress(kind, COMPRESS[kind](content), limit)
    assert bytes(result) == content[:limit]


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


def test_a_file_that_is_not_compressed_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap.zst"
    path.write_bytes(b"no zstd")
    with pytest.raises(InputError, match=r"run\.mcap\.zst can't be decompressed"):
        decompress_file(path, tmp_path)
