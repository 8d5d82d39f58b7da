"""Decompression of untrusted data: with a limit, and with the readable part of damaged data."""

from __future__ import annotations

from pathlib import Path

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

    Args:
        kind: `zstd`, `lz4`, `bz2` or nothing.
        data: Compressed data, which can be truncated.
        limit: Bytes.

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


def _zstd(data: bytes | memoryview, limit: int) -> bytes:
    import zstandard

    reader = zstandard.ZstdDecompressor(max_window_size=_LARGEST_WINDOW).stream_reader(
        data, read_across_frames=True
    )
    pieces: list[bytes] = []
    left = limit
    try:
        while left and (piece := reader.read(min(left, 4 * _PIECE))):
            pieces.append(piece)
            left -= len(piece)
    except zstandard.ZstdError:
        pass
    return pieces[0] if len(pieces) == 1 else b"".join(pieces)


def _lz4(data: bytes | memoryview, limit: int) -> bytes:
    import lz4.frame

    # LZ4FrameDecompressor copies what it is given, and what is left of it.
    context = lz4.frame.create_decompression_context()
    pieces: list[bytes] = []
    left, rest = limit, memoryview(data)
    try:
        while left:
            piece, taken, is_end = lz4.frame.decompress_chunk(
                context, rest, max_length=min(left, 4 * _PIECE)
            )
            pieces.append(piece)
            left, rest = left - len(piece), rest[taken:]
            if is_end or not (taken or piece):
                break
    except (RuntimeError, EOFError, MemoryError):
        pass
    return pieces[0] if len(pieces) == 1 else b"".join(pieces)


def _bz2(data: bytes | memoryview, limit: int) -> bytes:
    import bz2

    try:
        return bz2.BZ2Decompressor().decompress(data, max_length=limit)
    except (OSError, EOFError):
        return b""


def decompress_file(path: Path, folder: Path) -> Path:
    """Return the decompressed copy of a file of zstd, made in a folder.

    Raises:
        InputError: Nothing of it can be decompressed, the disk is full, or the compression ratio
            is larger than that of any recording.
    """
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
