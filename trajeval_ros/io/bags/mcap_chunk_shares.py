"""One chunk of MCAP for several selections: its bytes are read, decompressed and verified once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from trajeval_ros.io.bags.blocks import Block
from trajeval_ros.io.bags.byte_source import GAP, ByteSource
from trajeval_ros.io.bags.damaged_bytes import DamagedError
from trajeval_ros.io.bags.mcap_chunk_parts import (
    index_of,
    index_range,
    measured,
    partial,
    runs_of,
)
from trajeval_ros.io.bags.mcap_chunks import (
    Chunk,
    block_in,
    of_channels,
    require_size,
    walked,
    whole,
)
from trajeval_ros.io.bags.mcap_records import MessageIndex
from trajeval_ros.io.bags.selection import TopicSelection, all_connections

Range = tuple[int, int]  # offset and size, bytes


@dataclass(frozen=True)
class Share:
    """Messages of some selections from one piece of a file.

    Attributes:
        selections: The selections.
        block: Their messages, or the reason why they can't be read.
        is_partial: Whether the chunk was read in part, without verification.
    """

    selections: Sequence[TopicSelection]
    block: Block | str
    is_partial: bool = False


def read_chunk(
    source: ByteSource, chunk: Chunk, selections: Sequence[TopicSelection], *, strict: bool
) -> list[Share]:
    """Return the messages of all selections in a chunk.

    The result of a selection does not depend on the others. Whether the chunk is read in part, and
    which messages are lost by damage, is determined per selection.

    Args:
        source: The file.
        chunk: One that may hold messages of all selections.
        selections: Those wanted.
        strict: Whether to read and verify it whole.
    """
    try:
        require_size(chunk)
    except DamagedError as error:
        return [Share(selections, str(error))]
    reading = _Reading(source, chunk, is_indexed=bool(chunk.indexes) and not strict)
    if len(selections) > 1 and (share := reading.together(selections)) is not None:
        return [share]
    return [share for each in selections for share in reading.shares_of(each)]


class _Reading:
    """A chunk while it is read."""

    def __init__(self, source: ByteSource, chunk: Chunk, *, is_indexed: bool) -> None:
        self._source = _HeldBytes(source)
        self._chunk = chunk
        self._is_indexed = is_indexed
        self._whole: bytes | memoryview | DamagedError | None = None
        self._walked: tuple[MessageIndex, bool] | None = None

    def together(self, selections: Sequence[TopicSelection]) -> Share | None:
        """Return the messages of all selections, looked up in one pass.

        Returns:
            None if the selections must be read one by one, because only some of them need the
            whole chunk, or because of damage. The bytes in memory are then used again.
        """
        if not self._is_indexed:
            return None
        chunk, wanted = self._chunk, all_connections(selections)
        self._source.hold(*index_range(chunk, wanted))
        try:
            indexed = index_of(self._source, chunk, wanted)
            own = [of_channels(indexed, each.connections) for each in selections]
            runs = [runs_of(chunk, each) for each in own]
            if all(each is not None for each in runs):
                united = _united(run for each in runs if each for run in each)
                base = chunk.data_offset
                self._source.hold_all([(base + begin, end - begin) for begin, end in united])
                block, is_partial = partial(self._source, chunk, indexed, united), True
            elif any(each is not None for each in runs):
                self._source.hold(chunk.offset, chunk.length)
                return None
            else:
                data = self._data()
                block = block_in(data, measured(data, indexed, len(data)), chunk.first)
                is_partial = False
        except DamagedError:
            return None
        return Share(selections, block, is_partial)

    def shares_of(self, selection: TopicSelection) -> Iterator[Share]:
        """Yield the messages of one selection."""
        chunk, indexed = self._chunk, None
        if self._is_indexed and not selection.connections.isdisjoint(chunk.indexes):
            try:
                indexed = index_of(self._source, chunk, selection.connections)
                if (runs := runs_of(chunk, indexed)) is not None:
                    yield Share([selection], partial(self._source, chunk, indexed, runs), True)
                    return
            except DamagedError:
                indexed = None  # the chunk itself can be intact
        try:
            data = self._data()
        except DamagedError as error:
            yield Share([selection], str(error))
            return
        if indexed is not None:
            try:
                found = measured(data, indexed, len(data))
                yield Share([selection], block_in(data, found, chunk.first))
                return
            except DamagedError:
                pass
        if self._walked is None:
            self._walked = walked(data)
        messages, is_whole = self._walked
        found = of_channels(messages, selection.connections)
        yield Share([selection], block_in(data, found, chunk.first))
        if not is_whole and not chunk.is_cut:
            yield Share([selection], "a chunk has incomplete records")

    def _data(self) -> bytes | memoryview:
        """Return the records of the whole chunk, decompressed and verified once."""
        if self._whole is None:
            try:
                self._whole = whole(self._source, self._chunk)
            except DamagedError as error:
                self._whole = error
        if isinstance(self._whole, DamagedError):
            raise self._whole
        return self._whole


class _HeldBytes:
    """A source with some ranges in memory."""

    is_far = False  # bytes in memory have no latency

    def __init__(self, source: ByteSource) -> None:
        self.name, self.size = source.name, source.size
        self._source = source
        self._held: list[tuple[int, bytes]] = []

    def hold(self, offset: int, size: int) -> None:
        """Fetch the bytes from an offset on."""
        self._held.append((offset, self._source.read(offset, size)))

    def hold_all(self, ranges: Sequence[Range]) -> None:
        """Fetch the bytes of several ranges (offset, size)."""
        pieces = self._source.read_all(ranges)
        self._held += [(begin, piece) for (begin, _), piece in zip(ranges, pieces, strict=True)]

    def read(self, offset: int, size: int) -> bytes:
        """Return the bytes from an offset on, fewer where the end is near."""
        end = min(offset + size, self.size)
        for begin, piece in self._held:
            if begin <= offset and end <= begin + len(piece):
                return piece[offset - begin : end - begin]
        return self._source.read(offset, size)

    def read_all(self, ranges: Sequence[Range]) -> list[bytes]:
        """Return the bytes of several ranges (offset, size)."""
        return [self.read(offset, size) for offset, size in ranges]

    def close(self) -> None:
        """Nothing of its own is open."""


def _united(runs: Iterable[Range]) -> list[Range]:
    """Return ranges (begin, end) that cover all runs; small gaps between them are covered, too."""
    united: list[Range] = []
    for begin, end in sorted(runs):
        if united and begin - united[-1][1] <= GAP:
            united[-1] = united[-1][0], max(united[-1][1], end)
        else:
            united.append((begin, end))
    return united
