"""MCAP files, read by their index: only bytes with requested messages are read.

The summary at the end of a file has the positions of its chunks. The message index of a chunk has
the positions of a channel's messages. If a chunk is not compressed, only these bytes are read. A
file without summary or footer is scanned from its start.
"""

from __future__ import annotations

import functools
import zlib
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.io.bags.blocks import BYTES, ROWS, Block, TopicSelection, all_connections
from trajeval_ros.io.bags.byte_source import ByteSource, DamagedError
from trajeval_ros.io.bags.mcap_chunk_reading import ChunkMessages, read_chunk
from trajeval_ros.io.bags.mcap_chunks import Chunk, block_at, of_channels
from trajeval_ros.io.bags.mcap_contents import END_SIZE, data_end, read_summary, scanned_contents
from trajeval_ros.io.bags.mcap_records import (
    HEAD,
    MESSAGE_HEAD,
    PUBLISH_TIME,
    MessageIndex,
    NoIndexError,
)
from trajeval_ros.io.bags.message_definitions import Connection

# Bytes. glibc returns freed memory to the kernel above a threshold: the largest size freed so far.
# Mapping the pages of every chunk again takes as long as its decompression.
_KEPT = 16 << 20
_DECOMPRESSING, _ASKED = 2, 8  # threads; one more chunk than there are waits
_IN_FLIGHT = 1 << 28  # bytes of the chunks that are in memory at once, unless one has more
Piece = tuple[int, Chunk | MessageIndex]  # first log time; chunk, or messages outside of chunks
S = TypeVar("S")
T = TypeVar("T")


class McapReader:
    """An open MCAP file."""

    def __init__(self, source: ByteSource, *, strict: bool = False) -> None:
        """Read the summary, or walk through the file if it has none that can be used."""
        self.damage: list[str] = []  # what opening it found that can't be read, one sentence each
        self._source = source
        self._strict = strict
        self._known: tuple[int, int] | None = None
        why = ""
        try:
            contents, self._known = read_summary(source)
            self.damage += [f"{source.name}: {item}" for item in contents.damage]
        except DamagedError as error:
            declared = error.declared if isinstance(error, NoIndexError) else None
            contents = scanned_contents(source, declared)
            if contents.damage or not isinstance(error, NoIndexError):
                why = "; ".join([*contents.damage, str(error)])
        if strict and len(contents.messages):
            self._verify_data()
        self._chunks = sorted(contents.chunks, key=lambda chunk: chunk.first)
        self._messages = contents.messages
        if why:
            far = [why]
            if self.span is not None:
                seconds = (self.span[1] - self.span[0]) / NANOSECONDS
                far.append(f"read to {seconds:.1f} s after its first message")
            far.append(f"the last whole record ends at byte {contents.end} of {source.size}")
            self.damage.append(f"{source.name}: {'; '.join(far)}")
        self.connections: list[Connection] = contents.registry.connections(contents.counts, self)
        self._unverified = dict(contents.registry.channels)  # their chunks may name other topics

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
        """Yield the messages of some channels, of all selections in one pass over the chunks."""
        requested = all_connections(selections)
        pieces: list[Piece] = [
            (chunk.first, chunk)
            for chunk in self._chunks
            if (begin is None or chunk.last >= begin or not chunk.indexes)
            and (end is None or chunk.first < end)
            and (self._strict or chunk.may_hold(requested))
        ]
        pieces += [(int(run.log_times[0]), run) for run in self._runs(requested)]
        pieces.sort(key=lambda piece: piece[0])
        lost = {item: Counter[str]() for item in selections}
        partial: Counter[TopicSelection] = Counter()
        for (_, place), contents in zip(pieces, self._loaded(pieces, requested), strict=True):
            concerned = [
                item
                for item in selections
                if not isinstance(place, Chunk) or place.may_hold(item.connections)
            ]
            for selection in concerned:
                # If an index lists none of the messages, the declared count shows losses.
                if contents.damage:
                    lost[selection][contents.damage] += 1
                partial[selection] += contents.is_partial
            if contents.block is not None and len(block := contents.block.within(begin, end)):
                yield block
        for selection in selections:
            selection.damage += [
                f"{self._source.name}: {reason}" + (f", {count} times" if count > 1 else "")
                for reason, count in lost[selection].items()
            ]
            if partial[selection]:
                count = sum(
                    isinstance(place, Chunk) and place.may_hold(selection.connections)
                    for _, place in pieces
                )
                selection.notes.append(
                    f"{partial[selection]} of {count} chunks were read in part and their "
                    "checksums not verified; to verify them, use --strict"
                )

    def _loaded(
        self, pieces: Sequence[Piece], requested: Collection[int]
    ) -> Iterator[ChunkMessages]:
        """Yield the messages of the pieces, by threads if this saves time."""
        threads = _ASKED if self._source.is_far else 0
        compressions = {item.compression for _, item in pieces if isinstance(item, Chunk)}
        if compressions - {""}:
            bytes(_KEPT)
        if "zstd" in compressions:  # lz4 takes less time than its threads would
            threads = max(threads, _DECOMPRESSING)
        load = functools.partial(self._load, requested)
        if threads:
            return _prefetched(load, pieces, _room_of, threads)
        return map(load, pieces)

    def _load(self, requested: Collection[int], piece: Piece) -> ChunkMessages:
        """Return the requested messages of a chunk, or messages outside of chunks."""
        _, place = piece
        if isinstance(place, Chunk):
            channels = self._unverified
            return read_chunk(self._source, place, requested, channels, strict=self._strict)
        try:
            return ChunkMessages(self._loose(place))
        except DamagedError as error:
            return ChunkMessages(None, str(error))

    def _runs(self, requested: Collection[int]) -> Iterator[MessageIndex]:
        """Yield the requested messages outside of chunks, in runs of one block."""
        loose = of_channels(self._messages, requested)
        loose = loose[np.argsort(loose.log_times, kind="stable")]
        groups = np.cumsum(loose.sizes) // BYTES + np.arange(len(loose)) // ROWS
        breaks = np.flatnonzero(np.diff(groups)) + 1
        for rows in np.split(np.arange(len(loose)), breaks):
            if len(rows):
                yield loose[rows]

    def _loose(self, messages: MessageIndex) -> Block:
        """Return messages outside of chunks."""
        begins = messages.offsets + (HEAD + MESSAGE_HEAD - PUBLISH_TIME)
        ends = begins + PUBLISH_TIME + messages.sizes
        order = np.argsort(begins)
        far = np.flatnonzero(begins[order][1:] - ends[order][:-1] > END_SIZE) + 1
        pieces, places, total = [], np.empty(len(messages), dtype=np.int64), 0
        runs = np.split(order, far)
        ranges = [(int(begins[run[0]]), int(ends[run[-1]] - begins[run[0]])) for run in runs]
        for run, data, (first, size) in zip(
            runs, self._source.read_all(ranges), ranges, strict=True
        ):
            if len(data) != size:
                raise DamagedError("messages are truncated")
            places[run] = begins[run] - first + total
            pieces.append(data)
            total += size
        earliest, data = int(messages.log_times.min()), b"".join(pieces)
        return block_at(earliest, messages, data, places + PUBLISH_TIME, messages.sizes)

    def _verify_data(self) -> None:
        """Verify the checksum of a file with messages outside of chunks."""
        checksum, offset = 0, 0
        end, expected = data_end(self._source)
        while expected and offset < end:
            data = self._source.read(offset, min(BYTES, end - offset))
            checksum, offset = zlib.crc32(data, checksum), offset + len(data)
        if checksum != expected:
            self.damage.append(f"{self._source.name}: checksum mismatch")


def _room_of(piece: Piece) -> int:
    """Return the bytes that a piece needs in memory."""
    place = piece[1]
    return place.size if isinstance(place, Chunk) else int(place.sizes.sum())


def _prefetched(
    load: Callable[[S], T], pieces: Iterable[S], room_of: Callable[[S], int], threads: int
) -> Iterator[T]:
    """Yield the loaded pieces in order, while threads load the next ones."""
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
