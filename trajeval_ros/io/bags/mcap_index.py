"""MCAP files read by their index: only what holds wanted messages is fetched.

The summary at the end of a file says where its chunks are, a chunk's message index where in it the
messages of a channel lie. Where the chunk isn't compressed, only those bytes are read. A file
without summary or footer is walked through from its beginning.
"""

from __future__ import annotations

import io
import zlib
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.blocks import BYTES, LARGEST, ROWS, Block
from trajeval_ros.io.bags.byte_source import ByteSource
from trajeval_ros.io.bags.mcap_chunk_shares import Share, read_chunk
from trajeval_ros.io.bags.mcap_chunks import Chunk, of_channels
from trajeval_ros.io.bags.mcap_records import (
    CHANNEL,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    FOOTER_SIZE,
    HEAD,
    MAGIC,
    MESSAGE_HEAD,
    SCHEMA,
    STATISTICS,
    DamagedError,
    MessageIndex,
    NoIndexError,
    Registry,
    head_of,
    records,
)
from trajeval_ros.io.bags.mcap_scan import Scan, add_unlisted, scan
from trajeval_ros.io.bags.selection import TopicSelection, all_connections

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

_END_SIZE = FOOTER_SIZE + len(MAGIC)
# Bytes. glibc gives memory back to the kernel that is larger than what was freed once, and to have
# each page of the next chunk mapped again costs as much as decompressing it.
_KEPT = 16 << 20
_DECOMPRESSING, _ASKED = 2, 8  # threads; one more chunk than there are waits
_IN_FLIGHT = 1 << 28  # bytes of the chunks that are in memory at once, unless one has more
Piece = tuple[
    int, Chunk | MessageIndex, Sequence[TopicSelection]
]  # first log time, what, for whom
S = TypeVar("S")
T = TypeVar("T")


class McapReader:
    """An open MCAP file.

    Attributes:
        connections: Its channels.
        damage: What opening it found that can't be read, one sentence each.
    """

    def __init__(self, source: ByteSource, *, strict: bool = False) -> None:
        """Read the summary, or walk through the file if it has none that can be used.

        Args:
            source: The file.
            strict: Whether to read and verify all chunks whole.
        """
        self.damage: list[str] = []
        self._source = source
        self._strict = strict
        self._known: tuple[int, int] | None = None
        try:
            found, self._known = _summary(source)
            self.damage += [f"{source.name}: {each}" for each in found.damage]
        except DamagedError as error:
            found = scan(source)
            if isinstance(error, NoIndexError) and error.counts:
                found.counts = Counter(error.counts)
            if found.damage or not isinstance(error, NoIndexError):
                self.damage.append(
                    f"{source.name}: {'; '.join([*found.damage, str(error)])}; read record by "
                    f"record as far as byte {found.end} of {source.size}"
                )
        if strict and len(found.messages):
            self._verify_data()
        self._chunks = sorted(found.chunks, key=lambda chunk: chunk.first)
        self._messages = found.messages
        self.connections: list[Connection] = found.registry.connections(found.counts, self)

    @property
    def span(self) -> tuple[int, int] | None:
        """First and last log time of all messages, ns; None if there is none."""
        if self._known is not None:
            return self._known
        times = [(chunk.first, chunk.last) for chunk in self._chunks if chunk.last]
        if len(self._messages):
            log_times = self._messages.log_times
            times.append((int(log_times.min()), int(log_times.max())))
        if not times:
            return None
        return min(first for first, _ in times), max(last for _, last in times)

    def close(self) -> None:
        """Let go of the file."""
        self._source.close()

    def blocks(
        self,
        selections: Sequence[TopicSelection],
        begin: int | None = None,
        end: int | None = None,
        *,
        in_order: bool = False,  # noqa: ARG002  # they always are
    ) -> Iterator[tuple[Sequence[TopicSelection], Block]]:
        """Yield the messages of some channels, of all selections in one pass over the chunks."""
        chunks = [
            chunk
            for chunk in self._chunks
            if (begin is None or chunk.last >= begin or not chunk.indexes)
            and (end is None or chunk.first < end)
        ]
        pieces: list[Piece] = [
            (chunk.first, chunk, some)
            for chunk in chunks
            if (
                some := [
                    each for each in selections if self._strict or chunk.may_hold(each.connections)
                ]
            )
        ]
        wanted = all_connections(selections)
        pieces += [(int(each.log_times[0]), each, selections) for each in self._runs(wanted)]
        pieces.sort(key=lambda piece: piece[0])
        threads = _ASKED if self._source.is_far else 0
        if any(isinstance(each, Chunk) and each.compression for _, each, _ in pieces):
            threads = max(threads, _DECOMPRESSING)
            bytes(_KEPT)
        lost = {each: Counter[str]() for each in selections}
        partial: Counter[TopicSelection] = Counter()
        loaded = (
            _prefetched(self._load, pieces, _room_of, threads)
            if threads
            else map(self._load, pieces)
        )
        for (_, place, own), shares in zip(pieces, loaded, strict=True):
            for share in shares:
                if isinstance(share.block, str):
                    for selection in share.selections:
                        # If an index says that it has none of them, their count tells whether
                        # that's true.
                        if not isinstance(place, Chunk) or place.may_hold(selection.connections):
                            lost[selection][share.block] += 1
                    continue
                if share.is_partial:
                    partial.update(share.selections)
                # For all of them if it is for all that are in the chunk: so blocks are merged.
                owners = selections if len(share.selections) == len(own) else share.selections
                if len(block := share.block.within(begin, end)):
                    yield owners, block
        for selection in selections:
            selection.damage += [
                f"{self._source.name}: {reason}" + (f", {count} times" if count > 1 else "")
                for reason, count in lost[selection].items()
            ]
            if partial[selection]:
                count = sum(
                    isinstance(each, Chunk) and selection in own for _, each, own in pieces
                )
                selection.notes.append(
                    f"{partial[selection]} of {count} chunks were read in part, so that their "
                    "checksums couldn't be verified; --strict reads all of them"
                )

    def _load(self, piece: Piece) -> list[Share]:
        """Return what selections get of a chunk, or of messages outside of chunks."""
        _, place, selections = piece
        if isinstance(place, Chunk):
            return read_chunk(self._source, place, selections, strict=self._strict)
        try:
            return [Share(selections, self._loose(place))]
        except DamagedError as error:
            return [Share(selections, str(error))]

    def _runs(self, wanted: Collection[int]) -> Iterator[MessageIndex]:
        """Yield the wanted messages outside of chunks, in runs that make a block each."""
        loose = of_channels(self._messages, wanted)
        loose = loose[np.argsort(loose.log_times, kind="stable")]
        groups = np.cumsum(loose.sizes) // BYTES + np.arange(len(loose)) // ROWS
        breaks = np.flatnonzero(np.diff(groups)) + 1
        for rows in np.split(np.arange(len(loose)), breaks):
            if len(rows):
                yield loose[rows]

    def _loose(self, messages: MessageIndex) -> Block:
        """Return messages outside of chunks."""
        begins = messages.offsets + (HEAD + MESSAGE_HEAD)
        ends = begins + messages.sizes
        order = np.argsort(begins)
        far = np.flatnonzero(begins[order][1:] - ends[order][:-1] > _END_SIZE) + 1
        pieces, places, total = [], np.empty(len(messages), dtype=np.int64), 0
        runs = np.split(order, far)
        ranges = [(int(begins[run[0]]), int(ends[run[-1]] - begins[run[0]])) for run in runs]
        for run, data, (first, size) in zip(
            runs, self._source.read_all(ranges), ranges, strict=True
        ):
            if len(data) != size:
                raise DamagedError("messages are cut off")
            places[run] = begins[run] - first + total
            pieces.append(data)
            total += size
        return Block(
            int(messages.log_times.min()),
            messages.channels,
            messages.log_times,
            np.frombuffer(b"".join(pieces), dtype=np.uint8),
            places,
            messages.sizes,
        )

    def _verify_data(self) -> None:
        """Hold the bytes of a file with messages outside of chunks against their checksum."""
        checksum, offset = 0, 0
        end, expected = _data_end(self._source)
        while expected and offset < end:
            data = self._source.read(offset, min(BYTES, end - offset))
            checksum, offset = zlib.crc32(data, checksum), offset + len(data)
        if checksum != expected:
            self.damage.append(f"{self._source.name}: it isn't what its checksum is of")


def _summary(source: ByteSource) -> tuple[Scan, tuple[int, int] | None]:
    """Return what the summary says of a file, and the first and last log time.

    Raises:
        DamagedError: It has none that says where all messages are.
        InputError: It is no MCAP at all.
    """
    if source.read(0, len(MAGIC)) != MAGIC:
        raise InputError(f"{source.name} is no MCAP")
    tail = source.read(max(0, source.size - _END_SIZE), _END_SIZE)
    if len(tail) < _END_SIZE or not tail.endswith(MAGIC) or head_of(tail) != (FOOTER, 20):
        raise DamagedError("it has no footer")
    start = int.from_bytes(tail[HEAD : HEAD + 8], "little")
    checksum = int.from_bytes(tail[HEAD + 16 : HEAD + 20], "little")
    end = source.size - _END_SIZE
    if not start:
        raise NoIndexError()
    if not len(MAGIC) <= start <= end or end - start > LARGEST:
        raise DamagedError("the summary isn't where its footer says")
    data = source.read(start, end - start)
    if checksum and zlib.crc32(tail[: HEAD + 16], zlib.crc32(data)) != checksum:
        raise DamagedError("the summary isn't what its checksum is of")
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
        except Exception as error:  # of half a dozen kinds, by what is damaged
            raise DamagedError("the summary is damaged") from error
    if any(chunk.offset + chunk.length > size for chunk in found.chunks):
        raise DamagedError("the summary names chunks that aren't there")
    if len({chunk.offset for chunk in found.chunks}) < len(found.chunks):
        raise DamagedError("the summary names a chunk twice")
    if statistics is None:
        raise NoIndexError()
    found.counts.update(statistics.channel_message_counts)
    if found.counts and found.counts.total() != statistics.message_count:
        raise DamagedError("the summary contradicts itself")
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


def _data_end(source: ByteSource) -> tuple[int, int]:
    """Return where the data end, and their checksum, 0 if there is none."""
    tail = source.read(max(0, source.size - _END_SIZE), _END_SIZE)
    start = int.from_bytes(tail[HEAD : HEAD + 8], "little")
    end = (start or source.size - _END_SIZE) - HEAD - 4
    record = source.read(end, HEAD + 4)
    if len(record) < HEAD + 4 or head_of(record) != (DATA_END, 4):
        return 0, 0
    return end, int.from_bytes(record[HEAD:], "little")


def _room_of(piece: Piece) -> int:
    """Return the bytes that a piece needs in memory."""
    place = piece[1]
    return place.size if isinstance(place, Chunk) else int(place.sizes.sum())


def _prefetched(
    load: Callable[[S], T], pieces: Iterable[S], room_of: Callable[[S], int], threads: int
) -> Iterator[T]:
    """Yield what is loaded, in order, while the next are loaded by other threads."""
    waiting: deque[tuple[int, Future[T]]] = deque()
    in_flight = 0
    with ThreadPoolExecutor(threads) as pool:
        try:
            for piece in pieces:
                room = room_of(piece)
                while waiting and (len(waiting) > threads or in_flight + room > _IN_FLIGHT):
                    done, future = waiting.popleft()
                    yield future.result()
                    in_flight -= done
                waiting.append((room, pool.submit(load, piece)))
                in_flight += room
            while waiting:
                yield waiting.popleft()[1].result()
        finally:
            for _, future in waiting:
                future.cancel()
