"""Chunks of MCAP: whole and verified, or only the byte ranges that hold wanted messages."""

from __future__ import annotations

import contextlib
import struct
import zlib
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.blocks import LARGEST, Block
from trajeval_ros.io.bags.byte_source import ByteSource
from trajeval_ros.io.bags.compression import LARGEST_RATIO, decompress, most_of
from trajeval_ros.io.bags.mcap_records import (
    CHANNEL,
    CHUNK,
    HEAD,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    SCHEMA,
    DamagedError,
    MessageIndex,
    MessageIndexBuilder,
    Registry,
    head_of,
    records,
)
from trajeval_ros.io.bags.selection import are_of

_TIMES = struct.Struct("<QQQI")  # of a chunk: first and last log time, size, checksum
_LENGTH, _SIZE = struct.Struct("<I"), struct.Struct("<Q")
_RECORD = HEAD + MESSAGE_HEAD
GAP = 1 << 16  # bytes between wanted messages that cost less than another read
_TAIL = 4096  # bytes read for the last message of a run, whose length isn't known before
_LARGE = 1 << 26  # bytes that a chunk may become, however well it is compressed
_WORTHWHILE = 0.5  # of a chunk; what needs more is read whole, and verified


@dataclass
class Chunk:
    """Where a chunk lies, and what is known of it without reading it.

    Attributes:
        offset: Of its record in the file.
        length: Of its record.
        first: Log time of its first message, ns.
        last: Log time of its last one.
        compression: `zstd`, `lz4` or nothing.
        size: Bytes of its records, decompressed.
        indexes: Where in the file the message index of a channel lies, by channel.
        index_end: Where those end.
        channels: Those that it has messages of, as far as they are known; None if they aren't.
        is_cut: Whether the file ends within.
    """

    offset: int
    length: int
    first: int
    last: int
    compression: str
    size: int
    indexes: dict[int, int] = field(default_factory=dict)
    index_end: int = 0
    channels: frozenset[int] | None = None
    is_cut: bool = False

    @property
    def data_offset(self) -> int:
        """Where its records lie in the file."""
        return self.offset + HEAD + _TIMES.size + 4 + len(self.compression.encode()) + 8

    def may_hold(self, channels: Collection[int]) -> bool:
        """Return whether it has messages of any of the channels, as far as is known."""
        return self.channels is None or not self.channels.isdisjoint(channels)


def chunk_at(source: ByteSource, offset: int, length: int, *, is_cut: bool = False) -> Chunk:
    """Return what the record of a chunk says at its beginning.

    Raises:
        DamagedError: It is none.
    """
    head = source.read(offset, HEAD + _TIMES.size + 4 + 64)
    try:
        first, last, size, _ = _TIMES.unpack_from(head, HEAD)
        (count,) = _LENGTH.unpack_from(head, HEAD + _TIMES.size)
        place = HEAD + _TIMES.size + 4
        if count > 32:
            raise DamagedError("a chunk's compression has no name")
        compression = head[place : place + count].decode()
    except (struct.error, UnicodeDecodeError) as error:
        raise DamagedError("a chunk has no beginning") from error
    return Chunk(offset, length, first, last, compression, size, is_cut=is_cut)


def require_size(chunk: Chunk) -> None:
    """Raise DamagedError if a chunk is, or becomes, larger than any that a recorder writes."""
    if chunk.length > LARGEST or chunk.size > LARGEST:
        raise DamagedError("a chunk's size can't be right")
    if chunk.compression and chunk.size > most_of(chunk.length, _LARGE):
        raise DamagedError(
            f"a chunk becomes more than {LARGEST_RATIO} times its size, which none of a recording "
            "does"
        )


def require_budget(source: ByteSource, chunks: Iterable[Chunk]) -> None:
    """Raise InputError if the chunks that may be opened become more than any recording does."""
    total = 0
    for chunk in chunks:
        with contextlib.suppress(DamagedError):
            require_size(chunk)
            total += chunk.size if chunk.compression else 0
    if total > most_of(source.size, LARGEST):
        raise InputError(
            f"{source.name} becomes more than {LARGEST_RATIO} times its size, which no recording "
            "does; if you trust it, decompress it with `mcap decompress`"
        )


def whole(source: ByteSource, chunk: Chunk) -> bytes:
    """Return the records of a chunk; of one that is cut off, as many as there are.

    Raises:
        DamagedError: It can't be decompressed, or isn't what its checksum is of.
    """
    require_size(chunk)
    record = memoryview(source.read(chunk.offset, chunk.length))
    place = chunk.data_offset - chunk.offset
    if len(record) < place:
        raise DamagedError("a chunk is cut off")
    opcode, length = head_of(bytes(record[:HEAD]))
    if opcode != CHUNK or (length + HEAD != chunk.length and not chunk.is_cut):
        raise DamagedError("a chunk isn't where it should be")
    _, _, size, checksum = _TIMES.unpack_from(record, HEAD)
    (stored,) = _SIZE.unpack_from(record, place - 8)
    if size != chunk.size:
        raise DamagedError("a chunk's size can't be right")
    try:
        data = decompress(chunk.compression, record[place : place + stored], size)
    except ValueError as error:
        raise DamagedError(str(error)) from error
    if chunk.is_cut:
        return data
    if len(data) != size:
        raise DamagedError("a chunk can't be decompressed")
    if checksum and zlib.crc32(data) != checksum:
        raise DamagedError("a chunk isn't what its checksum is of")
    return data


def walked(data: bytes, registry: Registry | None = None) -> tuple[MessageIndex, bool]:
    """Return the messages in a chunk's records, and whether these lead to its end.

    Args:
        data: The records.
        registry: To which schemas and channels are added.
    """
    found, end = MessageIndexBuilder(), 0
    for opcode, offset, length in records(data):
        if opcode == MESSAGE:
            if length < MESSAGE_HEAD:
                break
            found.add(data, offset, offset - HEAD, length)
        elif registry is not None and opcode in (SCHEMA, CHANNEL):
            registry.add(opcode, data[offset : offset + length])
        end = offset + length
    return found.done(), end == len(data)


def index_range(chunk: Chunk, wanted: Collection[int]) -> tuple[int, int]:
    """Return offset and size of the part of a file that has the indexes of wanted channels."""
    places = [at for channel, at in chunk.indexes.items() if channel in wanted]
    end = max(chunk.index_end, max(places) + HEAD + 6)
    return min(places), min(end - min(places), LARGEST)


def index_of(source: ByteSource, chunk: Chunk, wanted: Collection[int]) -> MessageIndex:
    """Return the wanted messages by a chunk's message index; their sizes are unknown, -1.

    Raises:
        DamagedError: An index isn't where it should be.
    """
    places = {channel: at for channel, at in chunk.indexes.items() if channel in wanted}
    begin, room = index_range(chunk, wanted)
    data = source.read(begin, room)
    channels, log_times, offsets = [], [], []
    for channel, at in places.items():
        at -= begin
        if at + HEAD + 6 > len(data):
            raise DamagedError("a message index is cut off")
        opcode, length = head_of(data, at)
        own, size = struct.unpack_from("<HI", data, at + HEAD)
        if opcode != MESSAGE_INDEX or own != channel or size + 6 != length or size % 16:
            raise DamagedError("a message index isn't where it should be")
        if at + HEAD + length > len(data):
            raise DamagedError("a message index is cut off")
        entries = np.frombuffer(data, "<i8", size // 8, at + HEAD + 6).reshape(-1, 2)
        channels.append(np.full(len(entries), channel))
        log_times.append(entries[:, 0])
        offsets.append(entries[:, 1])
    found = MessageIndex(
        np.concatenate(channels),
        np.concatenate(log_times),
        np.concatenate(offsets),
        np.full(sum(map(len, offsets)), -1),
    )
    found = found[np.argsort(found.offsets, kind="stable")]
    if len(found) and (found.offsets[0] < 0 or found.offsets[-1] + _RECORD > chunk.size):
        raise DamagedError("a message index points out of its chunk")
    return found


def measured(data: bytes, messages: MessageIndex, limit: int, shift: int = 0) -> MessageIndex:
    """Return messages with their sizes, which the records in memory say.

    Args:
        data: Bytes of a chunk.
        messages: By its index, in order of their offsets.
        limit: Where the chunk ends.
        shift: Where in the chunk the data begin.

    Raises:
        DamagedError: A record isn't a message of that channel and time, or overlaps the next.
    """
    if not len(messages):
        return messages
    buffer = np.frombuffer(data, dtype=np.uint8)
    head = np.dtype(
        [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("_", "<u4"), ("time", "<i8")]
    )
    cells = np.ndarray(len(buffer) - head.itemsize + 1, f"V{head.itemsize}", buffer, 0, (1,))
    heads = cells[messages.offsets - shift].view(head)
    lengths = heads["length"].astype(np.int64)
    ends = messages.offsets + HEAD + lengths
    fits = (lengths >= MESSAGE_HEAD) & (lengths <= LARGEST)
    fits &= ends <= np.append(messages.offsets[1:], limit)
    are_right = (
        (heads["opcode"] == MESSAGE)
        & (heads["channel"] == messages.channels)
        & (heads["time"] == messages.log_times)
    )
    if not (fits & are_right).all():
        raise DamagedError("a message isn't where its index says")
    return MessageIndex(
        messages.channels, messages.log_times, messages.offsets, lengths - MESSAGE_HEAD
    )


def runs_of(chunk: Chunk, messages: MessageIndex) -> list[tuple[int, int]] | None:
    """Return the byte ranges (begin, end) of a chunk worth reading; None means all of it."""
    if chunk.compression or chunk.is_cut or not len(messages):
        return None
    first, last = int(messages.offsets[0]), int(messages.offsets[-1])
    if last - first <= GAP:
        end = min(last + _TAIL, chunk.size)
        return [(first, end)] if end - first <= _WORTHWHILE * chunk.size else None
    breaks = np.flatnonzero(np.diff(messages.offsets) > GAP)
    begins = messages.offsets[np.concatenate([[0], breaks + 1])]
    lasts = messages.offsets[np.concatenate([breaks, [len(messages) - 1]])]
    ends = np.minimum(lasts + _TAIL, chunk.size)
    if (ends - begins).sum() > _WORTHWHILE * chunk.size:
        return None
    return list(zip(begins.tolist(), ends.tolist(), strict=True))


def partial(
    source: ByteSource, chunk: Chunk, messages: MessageIndex, runs: list[tuple[int, int]]
) -> Block:
    """Return wanted messages of an uncompressed chunk without reading all of it.

    Raises:
        DamagedError: A record isn't what the index says.
    """
    base = chunk.data_offset
    pieces = source.read_all([(base + begin, end - begin) for begin, end in runs])
    begins, sizes, total = [], [], 0
    for number, (begin, end) in enumerate(runs):
        if len(pieces[number]) != end - begin:
            raise DamagedError("a chunk is cut off")
        inside = messages
        if len(runs) > 1:
            inside = messages[(messages.offsets >= begin) & (messages.offsets < end)]
        found = measured(pieces[number], inside, chunk.size, begin)
        last = int(found.offsets[-1] + _RECORD + found.sizes[-1])
        if last > end:
            pieces[number] += source.read(base + end, last - end)
            if len(pieces[number]) != last - begin:
                raise DamagedError("a chunk is cut off")
        begins.append(found.offsets + (_RECORD - begin + total))
        sizes.append(found.sizes)
        total += len(pieces[number])
    return Block(
        chunk.first,
        messages.channels,
        messages.log_times,
        np.frombuffer(b"".join(pieces), dtype=np.uint8),
        np.concatenate(begins),
        np.concatenate(sizes),
    )


def block_in(data: bytes, messages: MessageIndex, earliest: int) -> Block:
    """Return messages of a chunk that is in memory."""
    return Block(
        earliest,
        messages.channels,
        messages.log_times,
        np.frombuffer(data, dtype=np.uint8),
        messages.offsets + _RECORD,
        messages.sizes,
    )


def of_channels(messages: MessageIndex, wanted: Collection[int]) -> MessageIndex:
    """Return the messages of some channels."""
    return messages[are_of(messages.channels, wanted)]
