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
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError, reason_of
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Remark, warning
from trajeval_ros.io.json_file import json_text, mapping_in, require_schema

Chunk = tuple[dict[str, Any], NDArray[Any]]
Kinds = Mapping[bytes, np.dtype[Any]]  # types of rows by magic number

_HEAD = struct.Struct("<4sIII")
# Memory for chunks while the disk accepts none; beyond it, chunks are lost.
_MOST_WAITING = 64 * 1024 * 1024
_LONGEST_TEXT = 1 << 24  # bytes; JSON takes up to 20 times of them in memory


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
        if len(self._waiting) + len(body) > _MOST_WAITING or len(header) > _LONGEST_TEXT:
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


@dataclass(frozen=True, eq=False)
class Chunks:
    """The content of a file of chunks, up to its end or to its first damage."""

    description: dict[str, Any]  # the first text; empty if there is none
    newest: dict[str, Any]  # the newest text after it; empty if there is none
    rows: list[NDArray[Any]]  # of all chunks with rows
    described: int  # number of items of `rows` before the newest text
    torn: int  # number of bytes after the last valid chunk
    path: Path

    def rows_of(self, *kinds: np.dtype[Any]) -> list[NDArray[Any]]:
        """Return the rows of some kinds by chunk, in order; the first array is empty."""
        return [np.empty(0, kinds[0]), *(rows for rows in self.rows if rows.dtype in kinds)]

    def remarks(self) -> list[Remark]:
        """Return a warning if the file has damage."""
        torn = f"{self.path.name} is damaged or truncated: the last {counted(self.torn, 'byte')}"
        return [warning("damaged_states", f"{torn} can't be read")] if self.torn else []


def read_chunks(path: Path, kinds: Kinds, schema: str, what: str) -> Chunks:
    """Read a file up to its end or to its first damage; of its texts, only two are kept.

    Raises:
        InputError: It can't be read, is not `what`, or has another schema.
    """
    if path.exists() and not path.is_file():  # reading a pipe would wait for its other end
        raise InputError(f"{path} can't be read: it is not a regular file")
    texts: list[dict[str, Any]] = []
    rows: list[NDArray[Any]] = []
    described = 0
    try:
        with path.open("rb") as file:
            size, place = os.fstat(file.fileno()).st_size, 0
            while (chunk := _next_chunk(file, size - place, kinds)) is not None:
                text, table = chunk
                if text:
                    texts, described = [*texts[:1], text], len(rows)
                if len(table):
                    rows.append(table)
                place = file.tell()
    except OSError as error:
        raise InputError(f"{path} can't be read: {reason_of(error)}") from error
    description, newest = [*texts, {}, {}][:2]
    advice = "evaluate a recording of the run"
    require_schema(path, description.get("format"), schema, what, advice)
    return Chunks(description, newest, rows, described, size - place, path)


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
    if size > min(left - _HEAD.size, _MOST_WAITING) or length > _LONGEST_TEXT:
        return None
    header, table = file.read(length), file.read(count * kind.itemsize)
    if len(header) + len(table) < size or zlib.crc32(table, zlib.crc32(header)) != checksum:
        return None
    text = mapping_in(header) if length else {}
    return None if text is None else (text, np.frombuffer(table, kind))
