"""Bytes of a file or of an object in a store, fetched range by range."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, Protocol

GAP = 1 << 16  # bytes between requested ranges that cost less than another read


class DamagedError(Exception):
    """Bytes are not what the format requires; the message describes the difference."""


class FetchedBytes:
    """A thread-safe counter of bytes."""

    def __init__(self) -> None:
        self.total = 0  # bytes of objects, without protocol headers and listings
        self._lock = threading.Lock()

    def add(self, count: int) -> None:
        """Add `count` bytes to the total."""
        with self._lock:
            self.total += count


_COUNTER: ContextVar[FetchedBytes] = ContextVar("fetched_bytes", default=FetchedBytes())  # noqa: B039


def current_counter() -> FetchedBytes:
    """Return the counter of the innermost block of `counting_fetched_bytes`."""
    return _COUNTER.get()


@contextmanager
def counting_fetched_bytes() -> Iterator[FetchedBytes]:
    """Count the bytes of the remote objects that this thread opens in the block."""
    counter = FetchedBytes()
    token = _COUNTER.set(counter)
    try:
        yield counter
    finally:
        _COUNTER.reset(token)


class ByteSource(Protocol):
    """A source of bytes that can be read at any offset."""

    name: str
    size: int
    is_far: bool  # whether several requests should be sent at once, because answers take long

    def read(self, offset: int, size: int) -> bytes:
        """Return `size` bytes from an offset on, fewer at the end."""

    def read_all(self, ranges: Sequence[tuple[int, int]]) -> list[bytes]:
        """Return the bytes of several ranges (offset, size)."""

    def close(self) -> None:
        """Close the source."""


class LocalFile:
    """A file of this machine."""

    is_far = False

    def __init__(self, path: Path) -> None:
        self.name = str(path)
        self._file = path.open("rb", buffering=0)
        self.size = os.fstat(self._file.fileno()).st_size

    def read(self, offset: int, size: int) -> bytes:
        """Return `size` bytes from an offset on, fewer at the end."""
        size = max(0, min(size, self.size - offset))
        pieces = []
        while size > 0 and (piece := os.pread(self._file.fileno(), size, offset)):
            pieces.append(piece)
            offset += len(piece)
            size -= len(piece)
        return pieces[0] if len(pieces) == 1 else b"".join(pieces)

    def read_all(self, ranges: Sequence[tuple[int, int]]) -> list[bytes]:
        """Return the bytes of several ranges (offset, size)."""
        return [self.read(offset, size) for offset, size in ranges]

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class RemoteFile:
    """An object in a store that fsspec supports, such as S3."""

    is_far = True

    def __init__(self, path: Any) -> None:
        self.name = str(path)
        self._files, self._path = path.fs, path.path
        self.size = int(self._files.size(self._path))
        self._fetched = current_counter()  # reads may come from other threads

    def read(self, offset: int, size: int) -> bytes:
        """Return `size` bytes from an offset on, fewer at the end."""
        end = min(offset + size, self.size)
        if end <= offset:
            return b""
        data: bytes = self._files.cat_file(self._path, start=offset, end=end)
        self._fetched.add(len(data))
        return data

    def read_all(self, ranges: Sequence[tuple[int, int]]) -> list[bytes]:
        """Return the bytes of several ranges (offset, size)."""
        starts = [offset for offset, _ in ranges]
        ends = [min(offset + size, self.size) for offset, size in ranges]
        pieces: list[bytes] = self._files.cat_ranges(
            [self._path] * len(ranges), starts, ends, on_error="raise"
        )
        self._fetched.add(sum(map(len, pieces)))
        return pieces

    def close(self) -> None:
        """Nothing is open."""


class ByteWindow:
    """A part of a source in memory, for reading small ranges one after the other."""

    def __init__(self, source: ByteSource, size: int) -> None:
        self._source, self._size = source, size
        self._begin, self._data = 0, b""

    def at(self, offset: int, size: int, end: int) -> bytes:
        """Return `size` bytes of the source from an offset on, none after `end`."""
        place = offset - self._begin
        if not 0 <= place <= len(self._data) - size:
            room = min(max(size, self._size), end - offset)
            self._begin, self._data = offset, self._source.read(offset, room)
            place = 0
        return self._data[place : place + size]


def source_of(path: Any) -> LocalFile | RemoteFile:
    """Return the bytes of a path of this machine, or of universal_pathlib."""
    return LocalFile(path) if isinstance(path, Path) else RemoteFile(path)
