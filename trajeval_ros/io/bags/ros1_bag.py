"""Bags of ROS 1, read by their index.

Only chunks with requested messages are read. Of a chunk that is not compressed, only the ranges of
these messages are read. The format has no checksums: the header of every message is compared with
the index instead. A file without a valid index is scanned from its start.
"""

from __future__ import annotations

import contextlib
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Booleans, Indices
from trajeval_ros.io.bags.blocks import LARGEST, Block, TopicSelection, all_connections, are_of
from trajeval_ros.io.bags.byte_source import GAP, ByteSource, ByteWindow, DamagedError, how_far
from trajeval_ros.io.bags.compression import LARGEST_CHUNK, LARGEST_RATIO, decompress, most_of
from trajeval_ros.io.bags.message_definitions import Connection, full_name
from trajeval_ros.io.bags.ros1_records import (
    BAG_HEADER,
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    ENTRY_SIZE,
    INDEX,
    BagRecord,
    ChunkIndex,
    ConnectionRecords,
    fields_at,
    find_messages,
    messages_in,
    record_at,
)

_MAGIC = b"#ROSBAG V2.0\n"
_COMPRESSIONS = ("none", "bz2", "lz4")
_HEADS = 1 << 12  # bytes read at once of records that are looked at


@dataclass(frozen=True)
class _Chunk:
    """A chunk of the file."""

    record: BagRecord
    compression: str  # one of `_COMPRESSIONS`
    size: int  # of its data after decompression, bytes
    index: ChunkIndex  # its messages, in order of their offsets
    first: int  # log time of the first one, ns


class Ros1Reader:
    """An open bag of ROS 1."""

    def __init__(self, source: ByteSource) -> None:
        """Read the index."""
        self.connections: list[Connection] = []  # its connections; several may have one topic
        self.damage: list[str] = []  # what opening it found that can't be read, one sentence each
        # First and last log time of all messages, ns; None if there is none.
        self.span: tuple[int, int] | None = None
        self._source = source
        self._chunks: list[_Chunk] = []
        self._window = ByteWindow(source, _HEADS)
        if source.read(0, len(_MAGIC)) != _MAGIC:
            raise DamagedError("its version is not 2.0")
        self._compressed = 0  # bytes of the compressed chunks after decompression
        head = record_at(self._read, len(_MAGIC), BAG_HEADER)
        if head.text("encryptor"):
            raise DamagedError("it is encrypted")
        try:
            connections, counts = self._indexed(head)
        except DamagedError as error:
            self._chunks, self.damage, self.span, self._compressed = [], [], None, 0
            connections, counts = self._scanned(head.end, str(error))
            if not connections:
                raise
        self._chunks.sort(key=lambda chunk: chunk.first)
        self.connections = [self._connection(*each, counts) for each in connections.values()]

    def close(self) -> None:
        """Close the file."""
        self._source.close()

    def blocks(
        self,
        selections: Sequence[TopicSelection],
        begin: int | None = None,
        end: int | None = None,
        *,
        in_order: bool = False,  # noqa: ARG002  # they always are
    ) -> Iterator[Block]:
        """Yield the messages of some connections, of all selections in one pass."""
        lost = {each: Counter[str]() for each in selections}
        wanted = all_connections(selections)
        for chunk in self._chunks:
            index = chunk.index[are_of(chunk.index.connections, wanted)].within(begin, end)
            if not len(index):
                continue
            block, valid, reason = self._block(chunk, index)
            for selection in selections:
                own = are_of(index.connections, selection.connections)
                if count := int(np.count_nonzero(own & ~valid)):
                    lost[selection][reason] += count
            if valid.any():
                yield block if valid.all() else block[valid]
        for selection in selections:
            selection.damage += [
                f"{self._source.name} is damaged: {reason}, {counted(count, 'message')} lost; to "
                "recover more, try `rosbag reindex` or `rosbag fix`"
                for reason, count in lost[selection].items()
            ]

    def _block(self, chunk: _Chunk, index: ChunkIndex) -> tuple[Block, Booleans, str]:
        """Return messages of a chunk, which of them are valid (N,), and why the others are not."""
        nothing = np.zeros(len(index), dtype=np.int64)
        data: bytes | memoryview = b""
        begins, sizes, valid = nothing, nothing, nothing > 0
        reason = "a message is not at its indexed position"
        try:
            data, offsets = self._data(chunk, index.offsets)
            begins, sizes, valid = find_messages(data, offsets, index)
        except DamagedError as error:
            reason = str(error)
        buffer = np.frombuffer(data, dtype=np.uint8)
        times = index.log_times
        block = Block(chunk.first, index.connections, times, buffer, begins, sizes, times)
        return block, valid, reason

    def _data(self, chunk: _Chunk, offsets: Indices) -> tuple[bytes | memoryview, Indices]:
        """Return bytes of a chunk, and where in them the messages at some offsets are."""
        record = chunk.record
        if chunk.compression == "none":
            every = chunk.index.offsets
            nexts = np.append(every, chunk.size)[np.searchsorted(every, offsets, side="right")]
            breaks = np.flatnonzero(offsets[1:] - nexts[:-1] > GAP) + 1
            begins = offsets[np.append(0, breaks)]
            sizes = nexts[np.append(breaks, len(offsets)) - 1] - begins
            ranges = zip((record.begin + begins).tolist(), sizes.tolist(), strict=True)
            pieces = self._source.read_all(list(ranges))
            if [len(each) for each in pieces] != sizes.tolist():
                raise DamagedError("a chunk is truncated")
            runs = np.searchsorted(breaks, np.arange(len(offsets)), side="right")
            moved = offsets - begins[runs] + (np.cumsum(sizes) - sizes)[runs]
            return pieces[0] if len(pieces) == 1 else b"".join(pieces), moved
        stored = self._source.read(record.begin, record.size)
        data = decompress(chunk.compression, stored, chunk.size)
        if len(data) != chunk.size:
            raise DamagedError("a chunk can't be decompressed")
        return data, offsets

    def _read(self, offset: int, size: int) -> bytes:
        return self._window.at(offset, size, self._source.size)

    def _records(self, offset: int, kind: int, count: int) -> tuple[list[BagRecord], int]:
        """Return records of one kind in a row, and where they end."""
        records = []
        for _ in range(count):
            records.append(record_at(self._read, offset, kind))
            offset = records[-1].end
        return records, offset

    def _indexed(self, head: BagRecord) -> tuple[ConnectionRecords, Counter[int]]:
        """List the chunks of the index; return connections, and their declared messages."""
        offset = head.number("index_pos", 8)
        if not offset:
            raise DamagedError("it has no index")
        records, offset = self._records(offset, CONNECTION, head.number("conn_count", 4))
        infos, _ = self._records(offset, CHUNK_INFO, head.number("chunk_count", 4))
        connections = {n: (each, fields_at(self._read, each)) for n, each in enumerate(records)}
        counts: Counter[int] = Counter()
        places = [each.number("chunk_pos", 8) for each in infos]
        if len(set(places)) < len(places):
            raise DamagedError("its index lists a chunk twice")
        ends = {}  # of the chunks with their indexes, by place
        for info, place in zip(infos, places, strict=True):
            if not (count := info.number("count", 4)):
                ends[place] = record_at(self._read, place, CHUNK).end
                continue
            data = self._read(info.begin, info.size)
            if len(data) != 8 * count:
                raise DamagedError("its index is inconsistent")
            for connection, messages in np.frombuffer(data, "<u4").reshape(-1, 2).tolist():
                counts[connection] += messages
            self._widen(info.time("start_time"), info.time("end_time"))
            try:
                chunk, ends[place] = self._chunk(place, count)
                self._add(chunk)
            except DamagedError as error:
                self._note_damage(error, place)
        if not self.damage and [head.end, *(ends[place] for place in sorted(ends))] != [
            *sorted(ends), head.number("index_pos", 8),
        ]:  # fmt: skip
            raise DamagedError("its index does not list all chunks")
        return connections, counts

    def _scanned(self, offset: int, why: str) -> tuple[ConnectionRecords, Counter[int]]:
        """List the chunks up to the first incomplete record; return connections and messages."""
        connections: ConnectionRecords = {}
        counts: Counter[int] = Counter()
        in_cut = 0
        with contextlib.suppress(DamagedError):
            while offset < self._source.size:
                record = record_at(self._read, offset)
                is_cut = record.end > self._source.size
                if record.number("op", 1) == CHUNK:
                    try:
                        index, is_whole = self._walk(offset, connections)
                        counts.update(index.connections.tolist())
                        in_cut = len(index) if is_cut else 0
                        if not is_whole and not is_cut:
                            raise DamagedError("a chunk has incomplete records")
                    except DamagedError as error:
                        self._note_damage(error, offset)
                if is_cut:
                    break
                offset = record.end
        if unknown := sum(count for each, count in counts.items() if each not in connections):
            lost = f"{counted(unknown, 'message')} of undefined connections"
            self.damage.append(f"{self._source.name}: {lost}")
        far = how_far(offset, self._source.size, in_cut)
        self.damage.insert(0, f"{self._source.name}: {why}; {far}")
        return connections, counts

    def _walk(self, place: int, connections: ConnectionRecords) -> tuple[ChunkIndex, bool]:
        """List a chunk without using its index; return its messages, and whether it is whole."""
        record, compression, size = self._chunk_head(place)
        stored = self._source.read(record.begin, record.size)
        data = decompress("" if compression == "none" else compression, stored, size)
        index, end = messages_in(data, connections)
        if end != size and compression != "none" and record.end <= self._source.size:
            raise DamagedError("a chunk can't be decompressed")  # its records may be wrong
        if len(index):
            times = index.log_times
            self._widen(int(times.min()), int(times.max()))
            self._add(_Chunk(record, compression, end, index, int(times.min())))
        return index, end == size

    def _note_damage(self, error: DamagedError, place: int) -> None:
        self.damage.append(f"{self._source.name}: {error}, in the chunk at byte {place}")

    def _widen(self, begin: int, end: int) -> None:
        first, last = self.span or (begin, end)
        self.span = min(first, begin), max(last, end)

    def _add(self, chunk: _Chunk) -> None:
        self._chunks.append(chunk)
        self._compressed += chunk.size if chunk.compression != "none" else 0
        if self._compressed > most_of(self._source.size, LARGEST):
            raise InputError(
                f"{self._source.name} has a compression ratio above {LARGEST_RATIO}; if you trust "
                "the file, decompress it with `rosbag decompress`"
            )

    def _chunk_head(self, place: int) -> tuple[BagRecord, str, int]:
        """Return the record of a chunk, its compression, and its size after decompression."""
        record = record_at(self._read, place, CHUNK)
        compression, size = record.text("compression"), record.number("size", 4)
        if compression not in _COMPRESSIONS:
            raise DamagedError(f"unknown compression {compression[:20]!r}")
        limit = record.size if compression == "none" else most_of(record.size, LARGEST_CHUNK)
        if size > min(limit, LARGEST):
            raise DamagedError("a chunk has an invalid size")
        return record, compression, size

    def _chunk(self, place: int, connections: int) -> tuple[_Chunk, int]:
        """Return the chunk at a place of the file, and the end of its index, which follows it."""
        record, compression, size = self._chunk_head(place)
        indexes, end = self._records(record.end, INDEX, connections)
        ids, entries = [], []
        for each in indexes:
            data = self._read(each.begin, each.size)
            count = each.number("count", 4)
            if each.number("ver", 4) != 1 or not len(data) == each.size == ENTRY_SIZE * count:
                raise DamagedError("an index is damaged")
            ids.append(np.full(count, each.number("conn", 4)))
            entries.append(np.frombuffer(data, "<u4").reshape(-1, 3))
        index = ChunkIndex(np.concatenate(ids), np.concatenate(entries))
        index = index[np.argsort(index.offsets, kind="stable")]
        if not len(index) or index.offsets[-1] >= size:
            raise DamagedError("an index points outside its chunk")
        return _Chunk(record, compression, size, index, int(index.log_times.min())), end

    def _connection(
        self, record: BagRecord, fields: BagRecord, counts: Counter[int]
    ) -> Connection:
        number = record.number("conn", 4)
        return Connection(
            number,
            re.sub("/+", "/", record.text("topic")),
            full_name(fields.text("type")),
            "MSG",
            fields.text("message_definition"),
            counts[number],
            "ros1",
            self,
            is_latching=fields.text("latching") == "1",
        )
