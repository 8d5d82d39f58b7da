"""Chunks of rows that are appended to a file as they come: a killed process loses none.

Each chunk is a head, a JSON text and rows, all little-endian. The head holds a magic number, which
tells what the rows are, their number, the length of the text and the CRC-32 of what follows. What
a kill or a full disk left behind of a last chunk is passed over.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError, reason_of
from trajeval_ros.io.json_file import mapping_in

Chunk = tuple[dict[str, Any], NDArray[Any]]

_HEAD = struct.Struct("<4sIII")
# What waits for a disk that takes no more; beyond it, chunks are lost to the file.
_MOST_WAITING = 64 * 1024 * 1024


class ChunkWriter:
    """Appends to a file; a disk that fails is tried again with the next chunk.

    Attributes:
        path: The file.
        trouble: Why the last chunks are not on disk yet; empty if they are.
    """

    def __init__(self, path: Path, magic: bytes, rows: NDArray[Any], text: bytes) -> None:
        """Make the file, which must not exist, with its first chunk.

        Raises:
            InputError: It can't be made.
        """
        self.path, self.trouble = path, ""
        self._waiting = bytearray()
        self._length = 0  # of the whole chunks on disk
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        except OSError as error:
            raise InputError(f"{path} can't be written: {reason_of(error)}") from error
        self.add(magic, rows, text)
        self.write()
        if self.trouble:
            os.close(self._file)
            raise InputError(f"{path} can't be written: {self.trouble}")

    def add(self, magic: bytes, rows: NDArray[Any], text: bytes = b"") -> bool:
        """Let a chunk wait for the disk; returns whether there was room."""
        body = text + rows.tobytes()
        if len(self._waiting) + len(body) > _MOST_WAITING:
            return False
        self._waiting += _HEAD.pack(magic, len(rows), len(text), zlib.crc32(body)) + body
        return True

    def close(self) -> None:
        """Have everything on disk, and end.

        Raises:
            InputError: The disk takes no more.
        """
        self.write()
        try:
            os.fsync(self._file)
        except OSError as error:
            self.trouble = self.trouble or reason_of(error)
        finally:
            os.close(self._file)
        if self.trouble:
            raise InputError(f"{self.path} can't be written completely: {self.trouble}")

    def write(self) -> None:
        """Write what waits, unbuffered: what the kernel has, a kill can't take."""
        try:
            written = os.write(self._file, self._waiting) if self._waiting else 0
            while written < len(self._waiting):
                written += os.write(self._file, memoryview(self._waiting)[written:])
        except OSError as error:
            self.trouble = reason_of(error)
            os.ftruncate(self._file, self._length)
            os.lseek(self._file, self._length, os.SEEK_SET)
            return
        self._length += written
        self._waiting = bytearray()
        self.trouble = ""


def read_chunks(path: Path, kinds: Mapping[bytes, np.dtype[Any]]) -> tuple[list[Chunk], int]:
    """Read a file to its end or to its first damage.

    Args:
        path: The file.
        kinds: The rows of each chunk, by its magic number.

    Returns:
        Text and rows of each chunk, and the number of bytes at the end that are no whole chunk.

    Raises:
        InputError: It can't be read.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} can't be read: {reason_of(error)}") from error
    chunks: list[Chunk] = []
    place = 0
    while (chunk := _chunk(content, place, kinds)) is not None:
        text, rows, place = chunk
        chunks.append((text, rows))
    return chunks, len(content) - place


def _chunk(
    content: bytes, place: int, kinds: Mapping[bytes, np.dtype[Any]]
) -> tuple[dict[str, Any], NDArray[Any], int] | None:
    """Return text, rows and end of the chunk at a place, None if there is no whole one."""
    if place + _HEAD.size > len(content):
        return None
    magic, count, length, checksum = _HEAD.unpack_from(content, place)
    begin = place + _HEAD.size
    if (kind := kinds.get(magic)) is None:
        return None
    end = begin + length + count * kind.itemsize
    if end > len(content) or zlib.crc32(content[begin:end]) != checksum:
        return None
    text = mapping_in(content[begin : begin + length]) if length else {}
    if text is None:
        return None
    return text, np.frombuffer(content, kind, count, begin + length), end
