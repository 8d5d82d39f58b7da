"""A walk through all records of an MCAP file, for one whose index is missing or can't be trusted.

Only the heads of records are read, and what stands beside them; payloads are passed over.
"""

from __future__ import annotations

import struct
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from trajeval_ros.geometry.arrays import Booleans
from trajeval_ros.io.bags.byte_source import ByteSource
from trajeval_ros.io.bags.mcap_chunks import Chunk, chunk_at, walked, whole
from trajeval_ros.io.bags.mcap_records import (
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    HEAD,
    LAST_KNOWN,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    SCHEMA,
    DamagedError,
    MessageIndex,
    MessageIndexBuilder,
    Registry,
    head_of,
)

_WINDOW = 1 << 16  # bytes
_NEAR = HEAD + MESSAGE_HEAD  # bytes of a record that are looked at
_PRIVATE = 0x80  # opcodes from here on are anybody's own


@dataclass
class Scan:
    """What a walk found.

    Attributes:
        registry: Schemas and channels.
        chunks: All chunks; the last may be cut off.
        messages: Those outside of chunks; offsets are of the file.
        counts: Number of messages by channel, those in chunks included.
        end: Where the walk ended.
        damage: Why it ended before the end of the data, "" if it didn't; and what else is wrong.
    """

    registry: Registry = field(default_factory=Registry)
    chunks: list[Chunk] = field(default_factory=list)
    messages: MessageIndex = field(default_factory=lambda: MessageIndexBuilder().done())
    counts: Counter[int] = field(default_factory=Counter)
    end: int = len(MAGIC)
    damage: list[str] = field(default_factory=list)


class _Window:
    """A part of the file that is in memory, moved on as the walk goes."""

    def __init__(self, source: ByteSource) -> None:
        self._source = source
        self._begin, self._data = 0, b""

    def at(self, offset: int, size: int) -> bytes:
        """Return bytes of the file, fewer where it ends."""
        place = offset - self._begin
        if not 0 <= place <= len(self._data) - size:
            self._begin, self._data = offset, self._source.read(offset, max(size, _WINDOW))
            place = 0
        return self._data[place : place + size]


def scan(source: ByteSource) -> Scan:
    """Walk through a file, as far as its records can be followed."""
    found, window, growing = Scan(), _Window(source), MessageIndexBuilder()
    while True:
        head = window.at(found.end, _NEAR)
        if len(head) < HEAD:
            found.damage.append("it was cut short")
            break
        opcode, length = head_of(head)
        if opcode in (DATA_END, FOOTER):
            break
        if not 0 < opcode <= LAST_KNOWN and opcode < _PRIVATE:
            found.damage.append(f"what follows byte {found.end} is no record")
            break
        end = found.end + HEAD + length
        is_cut = end > source.size
        try:
            if opcode == CHUNK:
                _add_chunk(source, found, length if not is_cut else source.size, is_cut=is_cut)
            elif not is_cut:
                _add_record(window, found, growing, opcode, length)
        except DamagedError as error:
            found.damage.append(f"{error} at byte {found.end}")
        if is_cut:
            found.damage.append("it was cut short")
            found.end = source.size if opcode == CHUNK else found.end
            break
        found.end = end
    found.messages = growing.done()
    found.counts.update(found.messages.channels.tolist())
    _look_into_chunks(source, found)
    found.messages = found.messages[_known(found.messages, found.registry)]
    return found


def _add_chunk(source: ByteSource, found: Scan, length: int, *, is_cut: bool) -> None:
    size = source.size - found.end if is_cut else HEAD + length
    found.chunks.append(chunk_at(source, found.end, size, is_cut=is_cut))


def _add_record(
    window: _Window, found: Scan, growing: MessageIndexBuilder, opcode: int, length: int
) -> None:
    offset = found.end
    if opcode == MESSAGE:
        if length < MESSAGE_HEAD:
            raise DamagedError("a message is too short")
        growing.add(window.at(offset, _NEAR), HEAD, offset, length)
    elif opcode in (SCHEMA, CHANNEL):
        found.registry.add(opcode, window.at(offset, HEAD + length)[HEAD:])
    elif opcode == MESSAGE_INDEX and found.chunks and length >= 6:
        channel, size = struct.unpack_from("<HI", window.at(offset, HEAD + 6), HEAD)
        found.chunks[-1].indexes[channel] = offset
        found.chunks[-1].index_end = offset + HEAD + length
        found.counts[channel] += size // 16


def _look_into_chunks(source: ByteSource, found: Scan) -> None:
    """Read the chunks that have channels nobody has described, or no index."""
    for chunk in found.chunks:
        if chunk.indexes and chunk.indexes.keys() <= found.registry.channels.keys():
            continue
        try:
            messages = walked(whole(source, chunk), found.registry)
        except DamagedError:
            continue  # is counted when it is read
        if not chunk.indexes:
            found.counts.update(messages.channels.tolist())
            if len(messages):
                chunk.first = int(messages.log_times.min())
                chunk.last = int(messages.log_times.max())


def _known(messages: MessageIndex, registry: Registry) -> Booleans:
    return np.isin(messages.channels, np.fromiter(registry.channels, np.int64))
