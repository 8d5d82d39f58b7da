"""Decompression of untrusted data: with a limit, and with the readable part of damaged data."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np

from trajeval_ros.exceptions import InputError

_PIECE = 1 << 20  # bytes
LARGEST_CHUNK = 1 << 26  # bytes that every chunk may have after decompression
_LARGEST_WINDOW = 1 << 27  # bytes, as `zstd --long` writes
_LARGEST_FILE = 1 << 30  # bytes that every file may have after decompression
LARGEST_RATIO = 500  # accepted for larger data


def most_of(size: int, floor: int) -> int:
    """Return the largest accepted size of decompressed data, at least `floor`, bytes."""
    return max(floor, LARGEST_RATIO * size)


def decompress(kind: str, data: bytes | memoryview, limit: int) -> bytes | memoryview:
    """Return the readable part of compressed data, at most `limit` bytes. Callers check the size.

    Raises:
        ValueError: The compression is unknown.
    """
    if kind == "":
        return data[:limit]
    if kind == "zstd":
        return _zstd(data, limit)
    if kind == "lz4":
        return _lz4(data, limit)
    if kind == "bz2":
        return _bz2(data, limit)
    raise ValueError(f"unknown compression {kind[:20]!r}; use zstd, lz4 or none")


def _zstd(data: bytes | memoryview, limit: int) -> memoryview:
    import zstandard

    reader = zstandard.ZstdDecompressor(max_window_size=_LARGEST_WINDOW).stream_reader(
        data, read_across_frames=True
    )
    room, size = _room_of(limit), 0
    with contextlib.suppress(zstandard.ZstdError):
        while size < limit and (count := reader.readinto(room[size : size + 4 * _PIECE])):
            size += count
    return room[:size]


def _lz4(data: bytes | memoryview, limit: int) -> memoryview:
    import lz4.frame

    # LZ4FrameDecompressor copies what it is given, and what is left of it.
    context = lz4.frame.create_decompression_context()
    room, size, rest = _room_of(limit), 0, memoryview(data)
    with contextlib.suppress(RuntimeError, EOFError, MemoryError):
        while size < limit:
            piece, taken, is_end = lz4.frame.decompress_chunk(
                context, rest, max_length=min(limit - size, 4 * _PIECE)
            )
            room[size : size + len(piece)] = piece
            size, rest = size + len(piece), rest[taken:]
            if is_end or not (taken or piece):
                break
    return room[:size]


def _room_of(size: int) -> memoryview:
    """Return writable bytes. The system provides the memory of a page when it is written."""
    return np.empty(size, dtype=np.uint8).data


def _bz2(data: bytes | memoryview, limit: int) -> bytes:
    import bz2

    try:
        return bz2.BZ2Decompressor().decompress(data, max_length=limit)
    except (OSError, EOFError):
        return b""


def decompress_file(path: Path, folder: Path) -> Path:
    """Return the decompressed copy of a file of zstd, made in a folder."""
    import zstandard

    limit = most_of(path.stat().st_size, _LARGEST_FILE)
    copy = folder / path.name.removesuffix(".zstd").removesuffix(".zst")
    reader = zstandard.ZstdDecompressor(max_window_size=_LARGEST_WINDOW)
    with path.open("rb") as file, copy.open("wb") as plain:
        try:
            pieces = reader.stream_reader(file, read_across_frames=True)
            while piece := pieces.read(_PIECE):
                plain.write(piece)
                if plain.tell() > limit:
                    raise InputError(
                        f"{path} has a compression ratio above {LARGEST_RATIO}; if you trust the "
                        "file, decompress it with `zstd -d`"
                    )
        except zstandard.ZstdError as error:
            if not plain.tell():
                raise InputError(f"{path} can't be decompressed: {error}") from error
        except OSError as error:
            raise InputError(
                f"no space in {folder} to decompress {path}: {error.strerror}; set TMPDIR to a "
                "larger disk"
            ) from error
    return copy
