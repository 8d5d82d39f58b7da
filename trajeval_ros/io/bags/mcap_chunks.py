"""Chunks of MCAP, whole and verified."""

from __future__ import annotations

import contextlib
import struct
import zlib
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Indices
from trajeval_ros.io.bags.blocks import LARGEST, Block, are_of, gather
from trajeval_ros.io.bags.byte_source import ByteSource, DamagedError
from trajeval_ros.io.bags.compression import LARGEST_CHUNK, LARGEST_RATIO, decompress, most_of
from trajeval_ros.io.bags.mcap_records import (
    CHANNEL,
    CHUNK,
    HEAD,
    MESSAGE,
    MESSAGE_HEAD,
    PUBLISH_TIME,
    SCHEMA,
    MessageIndex,
    MessageIndexBuilder,
    Registry,
    head_of,
    records,
)

_TIMES = struct.Struct("<QQQI")  # of a chunk: first and last log time, size, checksum
_LENGTH, _SIZE = struct.Struct("<I"), struct.Struct("<Q")
RECORD_HEAD = HEAD + MESSAGE_HEAD


@dataclass
class Chunk:
    """The position of a chunk, and its properties in the index."""

    offset: int  # of its record in the file
    length: int
    first: int  # log time of its first message, ns
    last: int  # log time of its last one
    compression: str  # `zstd`, `lz4` or nothing
    size: int  # bytes of its records, decompressed
    # Offset in the file of the message index, by channel.
    indexes: dict[int, int] = field(default_factory=dict)
    index_end: int = 0  # offset of the end of these indexes
    channels: frozenset[int] | None = None  # channels with messages in the chunk; None if unknown
    is_cut: bool = False  # whether the file ends within the chunk

    @property
    def data_offset(self) -> int:
        """Where its records lie in the file."""
        return self.offset + HEAD + _TIMES.size + 4 + len(self.compression.encode()) + 8

    def may_hold(self, channels: Collection[int]) -> bool:
        """Return whether it can have messages of any of the channels."""
        return self.channels is None or not self.channels.isdisjoint(channels)


def chunk_at(source: ByteSource, offset: int, length: int, *, is_cut: bool = False) -> Chunk:
    """Return the chunk that the header of its record describes."""
    head = source.read(offset, HEAD + _TIMES.size + 4 + 64)
    try:
        first, last, size, _ = _TIMES.unpack_from(head, HEAD)
        (count,) = _LENGTH.unpack_from(head, HEAD + _TIMES.size)
        place = HEAD + _TIMES.size + 4
        if count > 32:
            raise DamagedError("a chunk has no compression name")
        compression = head[place : place + count].decode()
    except (struct.error, UnicodeDecodeError) as error:
        raise DamagedError("a chunk has no header") from error
    return Chunk(offset, length, first, last, compression, size, is_cut=is_cut)


def require_size(chunk: Chunk) -> None:
    """Raise DamagedError if a chunk is larger than the chunks of any recorder."""
    if chunk.length > LARGEST or chunk.size > LARGEST:
        raise DamagedError("a chunk has an invalid size")
    if chunk.compression and chunk.size > most_of(chunk.length, LARGEST_CHUNK):
        raise DamagedError(f"a chunk has a compression ratio above {LARGEST_RATIO}")


def require_budget(source: ByteSource, chunks: Iterable[Chunk]) -> None:
    """Raise InputError if the decompressed chunks are larger than any recording."""
    total = 0
    for chunk in chunks:
        with contextlib.suppress(DamagedError):
            require_size(chunk)
            total += chunk.size if chunk.compression else 0
    if total > most_of(source.size, LARGEST):
        raise InputError(
            f"{source.name} has a compression ratio above {LARGEST_RATIO}; if you trust the "
            "file, decompress it with `mcap decompress`"
        )


def whole(source: ByteSource, chunk: Chunk) -> bytes | memoryview:
    """Return the records of a chunk; of a truncated one, its first part."""
    require_size(chunk)
    record = memoryview(source.read(chunk.offset, chunk.length))
    place = chunk.data_offset - chunk.offset
    if len(record) < place:
        raise DamagedError("a chunk is truncated")
    opcode, length = head_of(bytes(record[:HEAD]))
    if opcode != CHUNK or (length + HEAD != chunk.length and not chunk.is_cut):
        raise DamagedError("a chunk is misplaced")
    _, _, size, checksum = _TIMES.unpack_from(record, HEAD)
    (stored,) = _SIZE.unpack_from(record, place - 8)
    if size != chunk.size:
        raise DamagedError("a chunk has an invalid size")
    try:
        data = decompress(chunk.compression, record[place : place + stored], size)
    except ValueError as error:
        raise DamagedError(str(error)) from error
    if chunk.is_cut:
        return data
    if len(data) != size:
        raise DamagedError("a chunk can't be decompressed")
    if checksum and zlib.crc32(data) != checksum:
        raise DamagedError("a chunk does not match its checksum")
    return data


def walked(
    data: bytes | memoryview, registry: Registry | None = None
) -> tuple[MessageIndex, bool]:
    """Return the messages in a chunk's records, and whether all records are complete."""
    messages, end = MessageIndexBuilder(), 0
    for opcode, offset, length in records(data):
        if opcode == MESSAGE:
            if length < MESSAGE_HEAD:
                break
            messages.add(data, offset, offset - HEAD, length)
        elif registry is not None and opcode in (SCHEMA, CHANNEL):
            registry.add(opcode, data[offset : offset + length])
        end = offset + length
    return messages.done(), end == len(data)


def block_in(data: bytes | memoryview, messages: MessageIndex, earliest: int) -> Block:
    """Return messages of a chunk that is in memory."""
    return block_at(earliest, messages, data, messages.offsets + RECORD_HEAD, messages.sizes)


def block_at(
    earliest: int,
    messages: MessageIndex,
    data: bytes | memoryview,
    begins: Indices,
    sizes: Indices,
) -> Block:
    """Return messages whose payloads are at offsets (N,) in data, after their publish times."""
    buffer = np.frombuffer(data, dtype=np.uint8)
    published = gather(buffer, begins - PUBLISH_TIME, np.dtype("<i8"))
    return Block(earliest, messages.channels, messages.log_times, buffer, begins, sizes, published)


def of_channels(messages: MessageIndex, channels: Collection[int]) -> MessageIndex:
    """Return the messages of some channels."""
    return messages[are_of(messages.channels, channels)]
