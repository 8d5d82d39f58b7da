"""MCAP files of any layout that the format allows, and of some that it doesn't.

The package's own writer knows one layout: chunks with all their indexes, and a summary.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    MessageIndex,
    Schema,
    Statistics,
)

MAGIC = b"\x89MCAP0\r\n"
Row = tuple[int, int, bytes]  # channel, log time, payload


@dataclass
class Part:
    """A part of a file's data: messages in a chunk or outside of any, and bytes behind them.

    Attributes:
        rows: The messages.
        is_chunk: Whether they are in a chunk.
        compression: Of the chunk.
        unindexed: Channels whose index is missing behind the chunk.
        is_listed: Whether the summary names the chunk.
        behind: More records.
        before: Records before the messages in the chunk.
        inside: What follows the messages in the chunk.
        size: What the chunk says of its size; None is the truth.
    """

    rows: Sequence[Row]
    is_chunk: bool = True
    compression: str = ""
    unindexed: frozenset[int] = frozenset()
    is_listed: bool = True
    behind: bytes = b""
    before: bytes = b""
    inside: bytes = b""
    size: int | None = None


@dataclass
class Layout:
    """A file.

    Attributes:
        schemas: Their ids are 1, 2, ...
        channels: Of any ids.
        parts: What its data are.
        has_summary: Whether there is one behind the data.
        repeats: Whether that has the schemas and channels, too.
        has_statistics: Whether that counts messages.
        counts: What it counts of each channel; empty is the truth.
    """

    schemas: Sequence[Schema]
    channels: Sequence[Channel]
    parts: Sequence[Part]
    has_summary: bool = True
    repeats: bool = True
    has_statistics: bool = True
    counts: dict[int, int] = field(default_factory=dict)

    def __bytes__(self) -> bytes:
        """Return the file."""
        file = RecordBuilder()
        file.write(MAGIC)
        Header("ros2", "").write(file)
        self._describe(file)
        indexes = [index for part in self.parts if (index := _add(file, part)) and part.is_listed]
        DataEnd(0).write(file)
        start = file.count if self.has_summary else 0
        if self.has_summary:
            if self.repeats:
                self._describe(file)
            if self.has_statistics:
                self._statistics(len(indexes)).write(file)
            for index in indexes:
                index.write(file)
        data = file.end()
        footer = RecordBuilder()
        Footer(start, 0, 0).write(footer)
        head = footer.end()[:-4]
        checksum = zlib.crc32(data[start:] + head) if start else 0
        return data + head + struct.pack("<I", checksum) + MAGIC

    def _describe(self, file: RecordBuilder) -> None:
        for schema in [*self.schemas, *self.channels]:
            schema.write(file)

    def _statistics(self, chunks: int) -> Statistics:
        rows = [row for part in self.parts for row in part.rows]
        counts = self.counts or dict(Counter(channel for channel, _, _ in rows))
        times = [time for _, time, _ in rows]
        return Statistics(
            attachment_count=0,
            channel_count=len(self.channels),
            channel_message_counts=counts,
            chunk_count=chunks,
            message_count=sum(counts.values()),
            message_end_time=max(times, default=0),
            message_start_time=min(times, default=0),
            metadata_count=0,
            schema_count=len(self.schemas),
        )


def record(opcode: int, content: bytes = b"") -> bytes:
    """Return a record of any opcode."""
    return struct.pack("<BQ", opcode, len(content)) + content


def _add(file: RecordBuilder, part: Part) -> ChunkIndex | None:
    """Add a part to a file; returns the index of its chunk."""
    offsets: dict[int, list[tuple[int, int]]] = {}
    builder = RecordBuilder() if part.is_chunk else file
    builder.write(part.before)
    for number, (channel, time, payload) in enumerate(part.rows):
        offsets.setdefault(channel, []).append((time, builder.count))
        Message(channel, time, payload, time, number).write(builder)
    if not part.is_chunk:
        file.write(part.behind)
        return None
    plain = builder.end() + part.inside
    data = compressed(part.compression, plain)
    times = [time for _, time, _ in part.rows] or [0]
    size = len(plain) if part.size is None else part.size
    begin = file.count
    Chunk(part.compression, data, max(times), min(times), zlib.crc32(plain), size).write(file)
    end = file.count
    places = {}
    for channel, entries in offsets.items():
        if channel not in part.unindexed:
            places[channel] = file.count
            MessageIndex(channel, entries).write(file)
    index = ChunkIndex(
        chunk_length=end - begin,
        chunk_start_offset=begin,
        compression=part.compression,
        compressed_size=len(data),
        message_end_time=max(times),
        message_index_length=file.count - end,
        message_index_offsets=places,
        message_start_time=min(times),
        uncompressed_size=size,
    )
    file.write(part.behind)
    return index


def compressed(kind: str, data: bytes) -> bytes:
    if kind == "zstd":
        return zstandard.ZstdCompressor(level=1).compress(data)
    return bytes(lz4.frame.compress(data)) if kind == "lz4" else data
