"""The contents of an MCAP file: by the summary at its end, or by a scan of its records.

A scan goes over all records, or over the records outside of the chunks that the summary lists.
Only the headers of records are read. Payloads are skipped. A chunk that is not in the summary is
opened to list its messages. Its message indexes can be incomplete, for example if the recorder was
killed while it wrote them.
"""

from __future__ import annotations

import io
import zlib
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.io.bags.blocks import LARGEST
from trajeval_ros.io.bags.byte_source import ByteSource, ByteWindow, DamagedError
from trajeval_ros.io.bags.mcap_chunks import Chunk, chunk_at, require_budget, walked, whole
from trajeval_ros.io.bags.mcap_records import (
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    FOOTER_SIZE,
    HEAD,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    SCHEMA,
    STATISTICS,
    Declared,
    MessageIndex,
    MessageIndexBuilder,
    NoIndexError,
    Registry,
    head_of,
    records,
)

if TYPE_CHECKING:
    from mcap.records import Statistics

_DATA_END = bytes([DATA_END]) + (4).to_bytes(8, "little")
END_SIZE = FOOTER_SIZE + len(MAGIC)  # bytes after the summary
_WINDOW = 1 << 16  # bytes
_NEAR = HEAD + MESSAGE_HEAD  # bytes read of a record


@dataclass
class McapContents:
    """The contents of a file."""

    registry: Registry = field(default_factory=Registry)  # schemas and channels
    chunks: list[Chunk] = field(default_factory=list)  # all chunks; the last one can be truncated
    # Messages outside of chunks, with offsets in the file.
    messages: MessageIndex = field(default_factory=lambda: MessageIndexBuilder().done())
    # Number of messages by channel, in chunks and outside, as declared if there are statistics.
    counts: Counter[int] = field(default_factory=Counter)
    end: int = len(MAGIC)  # offset where the scan ended
    # Damage found by the scan, one sentence per place.
    damage: list[str] = field(default_factory=list)


class _Scan:
    """A scan in progress."""

    def __init__(self, source: ByteSource, contents: McapContents) -> None:
        self._source = source
        self._contents = contents
        self._window = ByteWindow(source, _WINDOW)
        self._growing = MessageIndexBuilder()
        self._declared = Declared()  # of the statistics that the scan found
        self.opened: list[Chunk] = []  # chunks that are not in the summary

    def through(self, begin: int, end: int) -> None:
        """Scan a part of the file up to the first invalid record."""
        contents = self._contents
        contents.end = begin
        while contents.end < end:
            head = self._window.at(contents.end, _NEAR, end)
            opcode, length = head_of(head.ljust(HEAD, b"\xff"))
            if opcode == FOOTER and contents.end + FOOTER_SIZE + len(MAGIC) == self._source.size:
                return
            if opcode in (0, FOOTER):
                contents.damage.append(f"no valid record after byte {contents.end}")
                return
            is_cut = contents.end + HEAD + length > end
            try:
                self._add(opcode, head, min(HEAD + length, end - contents.end), is_cut=is_cut)
            except DamagedError as error:
                contents.damage.append(f"{error} at byte {contents.end}")
            if is_cut:
                break
            contents.end += HEAD + length
        if end < self._source.size and contents.end < end:
            contents.damage.append(f"records after byte {contents.end} are not readable")
        elif end == self._source.size:
            contents.damage.append("it is truncated")

    def _add(self, opcode: int, head: bytes, size: int, *, is_cut: bool) -> None:
        """Add the contents of a record. Records of unknown type are skipped."""
        offset = self._contents.end
        if opcode == CHUNK:
            self.opened.append(chunk_at(self._source, offset, size, is_cut=is_cut))
        elif is_cut:
            return
        elif opcode == MESSAGE:
            if size < _NEAR:
                raise DamagedError("a message is too short")
            self._growing.add(head, HEAD, offset, size - HEAD)
        elif opcode in (SCHEMA, CHANNEL):
            record = self._window.at(offset, size, offset + size)
            self._contents.registry.add(opcode, record[HEAD:])
        elif opcode == STATISTICS:
            record = self._window.at(offset, size, offset + size)
            statistics = _parsed_record(opcode, record[HEAD:])
            self._declared = Declared(statistics.channel_message_counts, statistics.message_count)

    def done(self, declared: Declared | None = None) -> None:
        """Open the chunks without an index, and compare all messages with the declared ones."""
        contents, declared = self._contents, declared or self._declared
        require_budget(self._source, [*contents.chunks, *self.opened])
        contents.messages = self._growing.done()
        counts = Counter(contents.messages.channels.tolist())
        for chunk in self.opened:
            try:
                messages, is_whole = walked(whole(self._source, chunk), contents.registry)
            except DamagedError:
                continue  # reported when it is read
            if is_whole or chunk.is_cut:
                chunk.channels = frozenset(messages.channels.tolist())
            counts.update(messages.channels.tolist())
            if len(messages):
                chunk.first = int(messages.log_times.min())
                chunk.last = int(messages.log_times.max())
            elif chunk.is_cut:
                chunk.last = 0  # the file ends before its first message
        contents.chunks += self.opened
        known = np.fromiter(contents.registry.channels, np.int64)
        contents.messages = contents.messages[np.isin(contents.messages.channels, known)]
        unknown = sum(count for item, count in counts.items() if item not in known)
        if unknown:
            contents.damage.append(f"{counted(unknown, 'message')} of undefined channels")
        contents.damage += contents.registry.damage
        lost = declared.chunks - {chunk.offset for chunk in contents.chunks}
        if lost:
            contents.damage.append(f"{counted(len(lost), 'chunk')} of the summary not found")
        total = declared.messages
        if total is not None and not declared.counts and counts.total() < total:
            contents.damage.append(f"{total - counts.total()} of {total} messages not found")
        contents.counts = contents.counts or Counter(declared.counts) or counts


def scanned_contents(source: ByteSource, declared: Declared | None = None) -> McapContents:
    """Scan a file up to the first invalid record.

    `declared`: contents according to the summary; None if it is unreadable.
    """
    contents = McapContents()
    walk = _Scan(source, contents)
    walk.through(len(MAGIC), source.size)
    walk.done(declared)
    return contents


def _add_unlisted(source: ByteSource, contents: McapContents, end: int) -> None:
    """Add messages and chunks that the summary does not list."""
    walk = _Scan(source, contents)
    begin = len(MAGIC)
    listed = sorted(contents.chunks, key=lambda chunk: chunk.offset)
    nexts = [*(chunk.offset for chunk in listed[1:]), end]
    for chunk, until in zip(listed, nexts, strict=False):
        walk.through(begin, chunk.offset)
        begin = chunk.offset + chunk.length
        if begin < chunk.index_end <= until:
            begin = chunk.index_end
    walk.through(begin, end)
    walk.done()


def read_summary(source: ByteSource) -> tuple[McapContents, tuple[int, int] | None]:
    """Return the contents of the summary, and the first and last log time."""
    if source.read(0, len(MAGIC)) != MAGIC:
        raise InputError(f"{source.name} is not MCAP")
    tail = source.read(max(0, source.size - END_SIZE), END_SIZE)
    if len(tail) < END_SIZE or not tail.endswith(MAGIC) or head_of(tail) != (FOOTER, 20):
        raise DamagedError("it has no footer")
    start = int.from_bytes(tail[HEAD : HEAD + 8], "little")
    checksum = int.from_bytes(tail[HEAD + 16 : HEAD + 20], "little")
    end = source.size - END_SIZE
    if not start:
        raise NoIndexError(Declared())
    data_end = source.read(start - HEAD - 4, HEAD)
    if not len(MAGIC) <= start <= end or data_end != _DATA_END or end - start > LARGEST:
        raise DamagedError("the summary is not at the position in the footer")
    data = source.read(start, end - start)
    if checksum and zlib.crc32(tail[: HEAD + 16], zlib.crc32(data)) != checksum:
        raise DamagedError("the summary does not match its checksum")
    contents, span = _parsed(data, source.size)
    _add_unlisted(source, contents, start)
    return contents, span


def _parsed(data: bytes, size: int) -> tuple[McapContents, tuple[int, int] | None]:
    contents = McapContents()
    statistics: Statistics | None = None
    end = 0
    for opcode, offset, length in records(data):
        end = offset + length
        content = data[offset:end]
        if opcode in (SCHEMA, CHANNEL):
            contents.registry.add(opcode, content)
        elif opcode == STATISTICS:
            statistics = _parsed_record(opcode, content)
        elif opcode == CHUNK_INDEX:
            contents.chunks.append(_chunk_of(_parsed_record(opcode, content)))
    if end != len(data):
        raise DamagedError("the summary is damaged")
    if any(chunk.offset + chunk.length > size for chunk in contents.chunks):
        raise DamagedError("the summary lists missing chunks")
    if len({chunk.offset for chunk in contents.chunks}) < len(contents.chunks):
        raise DamagedError("the summary lists a chunk twice")
    offsets = frozenset(chunk.offset for chunk in contents.chunks)
    if statistics is None:
        raise NoIndexError(Declared(chunks=offsets))
    contents.counts.update(statistics.channel_message_counts)
    if contents.counts and contents.counts.total() != statistics.message_count:
        raise DamagedError("the summary is inconsistent")
    channels = contents.registry.channels
    used = {channel for channel, count in contents.counts.items() if count}
    used |= {channel for chunk in contents.chunks for channel in chunk.indexes}
    schemas = {channels[item].schema_id for item in used & channels.keys()} - {0}
    if (
        not used <= channels.keys()
        or not schemas <= contents.registry.schemas.keys()
        or len(contents.chunks) != statistics.chunk_count
        or (statistics.message_count and not (contents.chunks and contents.counts))
    ):
        raise NoIndexError(
            Declared(statistics.channel_message_counts, statistics.message_count, offsets)
        )
    span = statistics.message_start_time, statistics.message_end_time
    return contents, span if statistics.message_count else None


def _parsed_record(opcode: int, content: bytes) -> Any:
    """Return a record of statistics, or of the index of a chunk."""
    from mcap.data_stream import ReadDataStream
    from mcap.records import ChunkIndex, Statistics

    kind = Statistics if opcode == STATISTICS else ChunkIndex
    try:
        return kind.read(ReadDataStream(io.BytesIO(content)))
    except Exception as error:  # of many types, depending on the damage
        raise DamagedError("the summary is damaged") from error


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
