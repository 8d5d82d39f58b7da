"""Bytes of a file or of an object in a store, fetched range by range."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol


class ByteSource(Protocol):
    """What can be read at any place.

    Attributes:
        name: What to call it in a sentence.
        size: Bytes.
        fetched: Bytes that were read so far.
    """

    name: str
    size: int
    fetched: int

    def read(self, offset: int, size: int) -> bytes:
        """Return the bytes from an offset on, fewer where the end is near."""

    def read_all(self, ranges: Sequence[tuple[int, int]]) -> list[bytes]:
        """Return the bytes of several ranges (offset, size)."""

    def close(self) -> None:
        """Let go of it."""


class LocalFile:
    """A file of this machine."""

    def __init__(self, path: Path) -> None:
        """Open the file."""
        self.name = str(path)
        self.fetched = 0
        self._file = path.open("rb", buffering=0)
        self.size = os.fstat(self._file.fileno()).st_size

    def read(self, offset: int, size: int) -> bytes:
        """Return the bytes from an offset on, fewer where the end is near."""
        size = max(0, min(size, self.size - offset))
        pieces = []
        while size > 0 and (piece := os.pread(self._file.fileno(), size, offset)):
            pieces.append(piece)
            offset += len(piece)
            size -= len(piece)
            self.fetched += len(piece)
        return pieces[0] if len(pieces) == 1 else b"".join(pieces)

    def read_all(self, ranges: Sequence[tuple[int, int]]) -> list[bytes]:
        """Return the bytes of several ranges (offset, size)."""
        return [self.read(offset, size) for offset, size in ranges]

    def close(self) -> None:
        """Close the file."""
        self._file.close()
