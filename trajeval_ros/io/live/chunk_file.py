"""Files of chunks that are appended one by one; a killed process loses no complete chunk.

A chunk is a header, a JSON text and rows, all little-endian. The header has a magic number, which
determines the type of the rows, their number, the length of the text and the CRC-32 of text and
rows. An incomplete last chunk, after a kill or on a full disk, is ignored.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError, reason_of
from trajeval_ros.io.json_file import json_text, mapping_in, require_schema

Chunk = tuple[dict[str, Any], NDArray[Any]]
Kinds = Mapping[bytes, np.dtype[Any]]  # types of rows by magic number

_HEAD = struct.Struct("<4sIII")
# Memory for chunks while the disk accepts none; beyond it, chunks are lost.
_MOST_WAITING = 64 * 1024 * 1024


class ChunkWriter:
    """Appends chunks to a file; after an error of the disk, the next chunk tries again."""

    def __init__(self, path: Path, kinds: Kinds, description: Mapping[str, Any]) -> None:
        """Create the file with a first chunk of no rows, which has the description."""
        self.path, self._kinds = path, kinds
        self.trouble = ""  # why the last chunks are not on disk yet; empty if they are
        self._waiting = bytearray()
        self._length = 0  # of the whole chunks on disk
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        except OSError as error:
            raise InputError(f"{path} can't be written: {reason_of(error)}") from error
        magic, kind = next(iter(kinds.items()))
        self.add(magic, *(np.empty(0, kind)[name] for name in kind.names or ()), text=description)
        self.write()
        if self.trouble:
            os.close(self._file)
            raise InputError(f"{path} can't be written: {self.trouble}")

    def add(
        self, magic: bytes, *columns: NDArray[Any], text: Mapping[str, Any] | None = None
    ) -> bool:
        """Queue a chunk of N rows for writing; returns whether there was memory for it."""
        rows = np.empty(len(columns[0]), self._kinds[magic])
        for name, column in zip(rows.dtype.names or (), columns, strict=True):
            rows[name] = column
        header = b"" if text is None else json_text(text).encode()
        body = header + rows.tobytes()
        if len(self._waiting) + len(body) > _MOST_WAITING:
            return False
        self._waiting += _HEAD.pack(magic, len(rows), len(header), zlib.crc32(body)) + body
        return True

    def close(self) -> None:
        """Write and synchronise everything, and close the file."""
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
        """Write queued chunks without buffering: written data survives a kill of the process."""
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


def read_tables(path: Path, kinds: Kinds, schema: str, what: str) -> dict[bytes, NDArray[Any]]:
    """Return the rows of every kind; refuses a file with another schema."""
    chunks, _ = read_chunks(path, kinds)
    schema_of_file = chunks[0][0].get("format") if chunks else None
    require_schema(path, schema_of_file, schema, what, "evaluate a recording of the run")
    tables = {}
    for magic, kind in kinds.items():
        parts = [np.empty(0, kind), *(item for _, item in chunks if item.dtype == kind)]
        tables[magic] = np.concatenate(parts).astype(kind.newbyteorder("="))
    return tables


def read_chunks(path: Path, kinds: Kinds) -> tuple[list[Chunk], int]:
    """Read a file up to its end or to its first damage.

    Returns:
        The text and the rows of every chunk, and the number of bytes after the last valid chunk.
    """
    chunks: list[Chunk] = []
    try:
        with path.open("rb") as file:
            size, place = os.fstat(file.fileno()).st_size, 0
            while (chunk := _next_chunk(file, size - place, kinds)) is not None:
                chunks.append(chunk)
                place = file.tell()
    except OSError as error:
        raise InputError(f"{path} can't be read: {reason_of(error)}") from error
    return chunks, size - place


def _next_chunk(file: BinaryIO, left: int, kinds: Kinds) -> Chunk | None:
    """Return the text and the rows of the next chunk; None if there is no valid one.

    `left`: bytes up to the end of the file. No more memory is taken than the largest chunk that
    is written has, whatever a damaged header claims.
    """
    header = file.read(_HEAD.size)
    if len(header) < _HEAD.size:
        return None
    magic, count, length, checksum = _HEAD.unpack(header)
    if (kind := kinds.get(magic)) is None:
        return None
    size = length + count * kind.itemsize
    if size > min(left - _HEAD.size, _MOST_WAITING):
        return None
    body = file.read(size)
    if len(body) < size or zlib.crc32(body) != checksum:
        return None
    text = mapping_in(body[:length]) if length else {}
    return None if text is None else (text, np.frombuffer(body, kind, count, length))
