"""A file in memory, and its chunks, for the readers of bags."""

from __future__ import annotations

from collections.abc import Sequence

from trajeval_ros.io.bags.mcap_chunks import Chunk


class Memory:
    """Bytes as a source; `size` can be another one than that of the content."""

    name, is_far = "memory", False

    def __init__(self, content: bytes, size: int | None = None) -> None:
        self.content = content
        self.size = len(content) if size is None else size

    def read(self, offset: int, size: int) -> bytes:
        return self.content[max(0, offset) : max(0, offset) + max(0, size)]

    def read_all(self, ranges: Sequence[tuple[int, int]]) -> list[bytes]:
        return [self.read(*item) for item in ranges]

    def close(self) -> None:
        """Nothing is open."""


def chunk(length: int, size: int, kind: str = "zstd") -> Chunk:
    """Return a chunk of some length in an MCAP file, and of some size when decompressed."""
    return Chunk(0, length, 0, 0, kind, size)
