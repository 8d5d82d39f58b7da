"""A scan of the records of an MCAP file: of all, or of those outside of the indexed chunks.

Only the headers of records are read. Payloads are skipped. A chunk that is not in the summary is
opened to list its messages. Its message indexes can be incomplete, for example if the recorder was
killed while it wrote them.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from trajeval_ros.formatting.numbers import counted
from trajeval_ros.io.bags.byte_source import ByteSource, ByteWindow
from trajeval_ros.io.bags.damaged_bytes import DamagedError
from trajeval_ros.io.bags.mcap_chunks import Chunk, chunk_at, require_budget, walked, whole
from trajeval_ros.io.bags.mcap_records import (
    CHANNEL,
    CHUNK,
    FOOTER,
    FOOTER_SIZE,
    HEAD,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    SCHEMA,
    MessageIndex,
    MessageIndexBuilder,
    Registry,
    head_of,
)

_WINDOW = 1 << 16  # bytes
_NEAR = HEAD + MESSAGE_HEAD  # bytes read of a record


@dataclass
class Scan:
    """The result of a scan.

    Attributes:
        registry: Schemas and channels.
        chunks: All chunks. The last one can be truncated.
        messages: Messages outside of chunks, with offsets in the file.
        counts: Number of messages by channel, in chunks and outside.
        end: Offset where the scan ended.
        damage: Damage found by the scan, one sentence per place.
    """

    registry: Registry = field(default_factory=Registry)
    chunks: list[Chunk] = field(default_factory=list)
    messages: MessageIndex = field(default_factory=lambda: MessageIndexBuilder().done())
    counts: Counter[int] = field(default_factory=Counter)
    end: int = len(MAGIC)
    damage: list[str] = field(default_factory=list)


class _Walk:
    """A scan in progress."""

    def __init__(self, source: ByteSource, found: Scan) -> None:
        self._source = source
        self._found = found
        self._window = ByteWindow(source, _WINDOW)
        self._growing = MessageIndexBuilder()
        self.opened: list[Chunk] = []  # chunks that are not in the summary

    def through(self, begin: int, end: int) -> None:
        """Scan a part of the file up to the first invalid record."""
        found = self._found
        found.end = begin
        while found.end < end:
            head = self._window.at(found.end, _NEAR, end)
            opcode, length = head_of(head.ljust(HEAD, b"\xff"))
            if opcode == FOOTER and found.end + FOOTER_SIZE + len(MAGIC) == self._source.size:
                return
            if opcode in (0, FOOTER):
                found.damage.append(f"no valid record after byte {found.end}")
                return
            is_cut = found.end + HEAD + length > end
            try:
                self._add(opcode, head, min(HEAD + length, end - found.end), is_cut=is_cut)
            except DamagedError as error:
                found.damage.append(f"{error} at byte {found.end}")
            if is_cut:
                break
            found.end += HEAD + length
        if end < self._source.size and found.end < end:
            found.damage.append(f"records after byte {found.end} are not readable")
        elif end == self._source.size:
            found.damage.append("it is truncated")

    def _add(self, opcode: int, head: bytes, size: int, *, is_cut: bool) -> None:
        """Add the contents of a record. Records of unknown type are skipped."""
        offset = self._found.end
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
            self._found.registry.add(opcode, record[HEAD:])

    def done(self) -> None:
        """Open the chunks without an index, and count all messages."""
        found = self._found
        require_budget(self._source, [*found.chunks, *self.opened])
        found.messages = self._growing.done()
        counts = Counter(found.messages.channels.tolist())
        for chunk in self.opened:
            try:
                messages, is_whole = walked(whole(self._source, chunk), found.registry)
            except DamagedError:
                continue  # reported when it is read
            if is_whole or chunk.is_cut:
                chunk.channels = frozenset(messages.channels.tolist())
            counts.update(messages.channels.tolist())
            if len(messages):
                chunk.first = int(messages.log_times.min())
                chunk.last = int(messages.log_times.max())
        found.chunks += self.opened
        known = np.fromiter(found.registry.channels, np.int64)
        found.messages = found.messages[np.isin(found.messages.channels, known)]
        unknown = sum(count for each, count in counts.items() if each not in known)
        if unknown:
            found.damage.append(f"{counted(unknown, 'message')} of undefined channels")
        found.counts = found.counts or counts


def scan(source: ByteSource) -> Scan:
    """Scan a file up to the first invalid record.

    Raises:
        InputError: Its chunks are compressed more than those of any recording.
    """
    found = Scan()
    walk = _Walk(source, found)
    walk.through(len(MAGIC), source.size)
    walk.done()
    return found


def add_unlisted(source: ByteSource, found: Scan, end: int) -> None:
    """Add messages and chunks that the summary does not list.

    Args:
        source: The file.
        found: The contents of its summary.
        end: Offset of the end of its data.

    Raises:
        InputError: Its chunks are compressed more than those of any recording.
    """
    walk = _Walk(source, found)
    begin = len(MAGIC)
    listed = sorted(found.chunks, key=lambda chunk: chunk.offset)
    nexts = [*(chunk.offset for chunk in listed[1:]), end]
    for chunk, until in zip(listed, nexts, strict=False):
        walk.through(begin, chunk.offset)
        begin = chunk.offset + chunk.length
        if begin < chunk.index_end <= until:
            begin = chunk.index_end
    walk.through(begin, end)
    walk.done()
