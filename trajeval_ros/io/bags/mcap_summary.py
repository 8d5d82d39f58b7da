"""The summary at the end of an MCAP file, and the checksum of the data before it."""

from __future__ import annotations

import io
import zlib
from typing import Any

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.blocks import LARGEST
from trajeval_ros.io.bags.byte_source import ByteSource
from trajeval_ros.io.bags.damaged_bytes import DamagedError
from trajeval_ros.io.bags.mcap_chunks import Chunk
from trajeval_ros.io.bags.mcap_records import (
    CHANNEL,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    FOOTER_SIZE,
    HEAD,
    MAGIC,
    SCHEMA,
    STATISTICS,
    NoIndexError,
    Registry,
    head_of,
    records,
)
from trajeval_ros.io.bags.mcap_scan import Scan, add_unlisted

END_SIZE = FOOTER_SIZE + len(MAGIC)


def read_summary(source: ByteSource) -> tuple[Scan, tuple[int, int] | None]:
    """Return the contents of the summary, and the first and last log time.

    Raises:
        DamagedError: The file has no valid summary with the positions of all messages.
        InputError: The file is not MCAP.
    """
    if source.read(0, len(MAGIC)) != MAGIC:
        raise InputError(f"{source.name} is not MCAP")
    tail = source.read(max(0, source.size - END_SIZE), END_SIZE)
    if len(tail) < END_SIZE or not tail.endswith(MAGIC) or head_of(tail) != (FOOTER, 20):
        raise DamagedError("it has no footer")
    start = int.from_bytes(tail[HEAD : HEAD + 8], "little")
    checksum = int.from_bytes(tail[HEAD + 16 : HEAD + 20], "little")
    end = source.size - END_SIZE
    if not start:
        raise NoIndexError()
    if not len(MAGIC) <= start <= end or end - start > LARGEST:
        raise DamagedError("the summary is not at the position in the footer")
    data = source.read(start, end - start)
    if checksum and zlib.crc32(tail[: HEAD + 16], zlib.crc32(data)) != checksum:
        raise DamagedError("the summary does not match its checksum")
    found, span = _parsed(data, source.size)
    add_unlisted(source, found, start)
    return found, span


def _parsed(data: bytes, size: int) -> tuple[Scan, tuple[int, int] | None]:
    from mcap.data_stream import ReadDataStream
    from mcap.records import ChunkIndex, Statistics

    found = Scan(Registry())
    statistics: Statistics | None = None
    for opcode, offset, length in records(data):
        content = data[offset : offset + length]
        if opcode in (SCHEMA, CHANNEL):
            found.registry.add(opcode, content)
            continue
        try:
            if opcode == STATISTICS:
                statistics = Statistics.read(ReadDataStream(io.BytesIO(content)))
            elif opcode == CHUNK_INDEX:
                found.chunks.append(
                    _chunk_of(ChunkIndex.read(ReadDataStream(io.BytesIO(content))))
                )
        except Exception as error:  # of many types, depending on the damage
            raise DamagedError("the summary is damaged") from error
    if any(chunk.offset + chunk.length > size for chunk in found.chunks):
        raise DamagedError("the summary lists missing chunks")
    if len({chunk.offset for chunk in found.chunks}) < len(found.chunks):
        raise DamagedError("the summary lists a chunk twice")
    if statistics is None:
        raise NoIndexError()
    found.counts.update(statistics.channel_message_counts)
    if found.counts and found.counts.total() != statistics.message_count:
        raise DamagedError("the summary is inconsistent")
    channels = found.registry.channels
    used = {channel for channel, count in found.counts.items() if count}
    used |= {channel for chunk in found.chunks for channel in chunk.indexes}
    schemas = {channels[each].schema_id for each in used & channels.keys()} - {0}
    if (
        not used <= channels.keys()
        or not schemas <= found.registry.schemas.keys()
        or len(found.chunks) != statistics.chunk_count
        or (statistics.message_count and not (found.chunks and found.counts))
    ):
        raise NoIndexError(found.counts)
    span = statistics.message_start_time, statistics.message_end_time
    return found, span if statistics.message_count else None


def _chunk_of(index: Any) -> Chunk:
    return Chunk(
        index.chunk_start_offset,
        index.chunk_length,
        index.message_start_time,
        index.message_end_time,
        index.compression,
        index.uncompressed_size,
        dict(index.message_index_offsets),
        index.chunk_start_offset + index.chunk_length + index.message_index_length,
        frozenset(index.message_index_offsets) or None,
    )


def data_end(source: ByteSource) -> tuple[int, int]:
    """Return the end of the data and their checksum; 0 without checksum."""
    tail = source.read(max(0, source.size - END_SIZE), END_SIZE)
    start = int.from_bytes(tail[HEAD : HEAD + 8], "little")
    end = (start or source.size - END_SIZE) - HEAD - 4
    record = source.read(end, HEAD + 4)
    if len(record) < HEAD + 4 or head_of(record) != (DATA_END, 4):
        return 0, 0
    return end, int.from_bytes(record[HEAD:], "little")
