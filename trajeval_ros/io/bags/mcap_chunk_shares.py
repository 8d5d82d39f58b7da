"""One chunk of MCAP for several selections: its bytes are read, decompressed and verified once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from trajeval_ros.io.bags.blocks import Block
from trajeval_ros.io.bags.byte_source import ByteSource
from trajeval_ros.io.bags.mcap_chunks import (
    GAP,
    Chunk,
    block_in,
    index_of,
    index_range,
    measured,
    of_channels,
    partial,
    require_size,
    runs_of,
    walked,
    whole,
)
from trajeval_ros.io.bags.mcap_records import DamagedError, Messages
from trajeval_ros.io.bags.selection import Selection, all_connections

Range = tuple[int, int]  # offset and size, bytes


@dataclass(frozen=True)
class Share:
    """What a selection gets of one piece of a file.

    Attributes:
        selection: Whose it is.
        block: Its messages, or why they can't be read.
        is_partial: Whether the chunk had not to be read whole for it, and was not verified.
    """

    selection: Selection
    block: Block | str
    is_partial: bool = False


def read_chunk(
    source: ByteSource, chunk: Chunk, selections: Sequence[Selection], *, strict: bool
) -> list[Share]:
    """Return what each selection gets of a chunk.

    Each gets what it would get alone: whether a chunk is read in part, and what is lost where it
    is damaged, is decided for each selection by itself.

    Args:
        source: The file.
        chunk: One that may hold messages of all selections.
        selections: Those wanted.
        strict: Whether to read and verify it whole.
    """
    try:
        require_size(chunk)
    except DamagedError as error:
        return [Share(each, str(error)) for each in selections]
    reading = _Reading(source, chunk)
    if chunk.indexes and not strict:
        reading.plan(selections)
    return [reading.share_of(each) for each in selections]


class _Reading:
    """A chunk while it is read."""

    def __init__(self, source: ByteSource, chunk: Chunk) -> None:
        self._source = _HeldBytes(source)
        self._chunk = chunk
        self._indexed: dict[Selection, Messages] = {}
        self._runs: dict[Selection, list[Range]] = {}  # begins and ends, of what is read in part
        self._whole: bytes | DamagedError | None = None
        self._walked: Messages | None = None

    def plan(self, selections: Sequence[Selection]) -> None:
        """Look the selections up in the index, and fetch what all of them need."""
        chunk = self._chunk
        self._source.hold(*index_range(chunk, all_connections(selections)))
        for selection in selections:
            try:
                indexed = index_of(self._source, chunk, selection.connections)
            except DamagedError:  # the chunk itself may be well
                continue
            self._indexed[selection] = indexed
            runs = runs_of(chunk, indexed)
            if runs is not None:
                self._runs[selection] = runs
        if not self._runs:
            return
        if len(self._runs) < len(selections):
            self._source.hold(chunk.offset, chunk.length)
        else:
            base = chunk.data_offset
            runs = _united(run for runs in self._runs.values() for run in runs)
            self._source.hold_all([(base + begin, end - begin) for begin, end in runs])

    def share_of(self, selection: Selection) -> Share:
        """Return what a selection gets."""
        chunk, indexed = self._chunk, self._indexed.get(selection)
        if indexed is not None and selection in self._runs:
            try:
                runs = self._runs[selection]
                return Share(selection, partial(self._source, chunk, indexed, runs), True)
            except DamagedError:
                indexed = None
        try:
            data = self._data()
        except DamagedError as error:
            return Share(selection, str(error))
        if indexed is not None:
            try:
                found = measured(data, indexed, len(data))
                return Share(selection, block_in(data, found, chunk.first))
            except DamagedError:
                pass
        if self._walked is None:
            self._walked = walked(data)
        found = of_channels(self._walked, selection.connections)
        return Share(selection, block_in(data, found, chunk.first))

    def _data(self) -> bytes:
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
    """A source of which some ranges are in memory already."""

    is_far = False  # what is held comes at once

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
