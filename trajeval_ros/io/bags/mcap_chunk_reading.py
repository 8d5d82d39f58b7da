"""Requested messages of a chunk of MCAP.

Of an uncompressed chunk, only the byte ranges that its message indexes list are read if they are
at most half of it. Every other chunk is read whole and verified.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.io.bags.blocks import LARGEST, Block, gather
from trajeval_ros.io.bags.byte_source import GAP, ByteSource, DamagedError
from trajeval_ros.io.bags.mcap_chunks import (
    RECORD_HEAD,
    Chunk,
    block_at,
    block_in,
    of_channels,
    require_size,
    walked,
    whole,
)
from trajeval_ros.io.bags.mcap_records import (
    CHANNEL,
    HEAD,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    MessageIndex,
    Registry,
    head_of,
    records,
)

if TYPE_CHECKING:
    from mcap.records import Channel

_TAIL = 4096  # bytes read for the last message of a run, whose length is unknown
_WORTHWHILE = 0.5  # of a chunk; above, the whole chunk is read and verified


@dataclass(frozen=True)
class ChunkMessages:
    """The requested messages of a piece of a file."""

    block: Block | None  # the readable messages; None if there is none
    damage: str = ""  # what can't be read; "" if all can
    is_partial: bool = False  # whether a chunk was read in part, without verification


def read_chunk(
    source: ByteSource,
    chunk: Chunk,
    requested: Collection[int],
    channels: dict[int, Channel] | None = None,
    *,
    strict: bool,
) -> ChunkMessages:
    """Return the messages of the requested channels, all read at once.

    `channels`: those of the summary that no chunk has confirmed yet; this chunk's are removed.
    """
    indexed = None
    try:
        require_size(chunk)
        if not strict and not chunk.indexes.keys().isdisjoint(requested):
            try:
                indexed = _index_of(source, chunk, requested)
                if (runs := _runs_of(chunk, indexed)) is not None:
                    return ChunkMessages(_partial(source, chunk, indexed, runs), is_partial=True)
            except DamagedError:
                indexed = None  # the chunk itself can be intact
        data = whole(source, chunk)
    except DamagedError as error:
        return ChunkMessages(None, str(error))
    if indexed is not None:
        with contextlib.suppress(DamagedError):
            index = _measured(data, indexed, len(data))
            damage = _renamed(data, chunk, requested, channels)
            return ChunkMessages(block_in(data, index, chunk.first), damage)
    messages, is_whole = walked(data)
    index = of_channels(messages, requested)
    is_damaged = not is_whole and not chunk.is_cut
    damage = "a chunk has incomplete records" if is_damaged else ""
    damage = damage or _renamed(data, chunk, requested, channels)
    return ChunkMessages(block_in(data, index, chunk.first), damage)


def _renamed(
    data: bytes | memoryview,
    chunk: Chunk,
    requested: Collection[int],
    channels: dict[int, Channel] | None,
) -> str:
    """Return which topics have another name in a chunk than in the summary, "" if none has.

    The search ends when every channel has been seen, in its record or in a message.
    """
    channels = channels or {}
    names = chunk.indexes.keys() & set(requested) & channels.keys()
    registry = Registry(channels={channel: channels.pop(channel) for channel in names})
    for opcode, offset, length in records(data) if names else ():
        if opcode == CHANNEL:
            registry.add(opcode, data[offset : offset + length])
        if opcode in (CHANNEL, MESSAGE):
            names.discard(int.from_bytes(data[offset : offset + 2], "little"))
        if not names:
            break
    return "; ".join(registry.damage)


def _index_of(source: ByteSource, chunk: Chunk, requested: Collection[int]) -> MessageIndex:
    """Return the requested messages of a chunk's message index, with unknown sizes (-1)."""
    places = {channel: at for channel, at in chunk.indexes.items() if channel in requested}
    begin = min(places.values())
    end = max(chunk.index_end, max(places.values()) + HEAD + 6)
    data = source.read(begin, min(end - begin, LARGEST))
    channels, log_times, offsets = [], [], []
    for channel, at in places.items():
        at -= begin
        if at + HEAD + 6 > len(data):
            raise DamagedError("a message index is truncated")
        opcode, length = head_of(data, at)
        owner, size = struct.unpack_from("<HI", data, at + HEAD)
        if opcode != MESSAGE_INDEX or owner != channel or size + 6 != length or size % 16:
            raise DamagedError("a message index is misplaced")
        if at + HEAD + length > len(data):
            raise DamagedError("a message index is truncated")
        entries = np.frombuffer(data, "<i8", size // 8, at + HEAD + 6).reshape(-1, 2)
        channels.append(np.full(len(entries), channel))
        log_times.append(entries[:, 0])
        offsets.append(entries[:, 1])
    index = MessageIndex(
        np.concatenate(channels),
        np.concatenate(log_times),
        np.concatenate(offsets),
        np.full(sum(map(len, offsets)), -1),
    )
    index = index[np.argsort(index.offsets, kind="stable")]
    if len(index) and (index.offsets[0] < 0 or index.offsets[-1] + RECORD_HEAD > chunk.size):
        raise DamagedError("a message index points outside its chunk")
    return index


def _measured(
    data: bytes | memoryview, messages: MessageIndex, limit: int, shift: int = 0
) -> MessageIndex:
    """Return messages, given in order of their offsets, with the sizes of their records.

    The data start at the position `shift` of a chunk with `limit` bytes.
    """
    if not len(messages):
        return messages
    buffer = np.frombuffer(data, dtype=np.uint8)
    head = np.dtype(
        [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("_", "<u4"), ("time", "<i8")]
    )
    heads = gather(buffer, messages.offsets - shift, head)
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
        raise DamagedError("a message is not at its indexed position")
    return MessageIndex(
        messages.channels, messages.log_times, messages.offsets, lengths - MESSAGE_HEAD
    )


def _runs_of(chunk: Chunk, messages: MessageIndex) -> list[tuple[int, int]] | None:
    """Return the byte ranges (begin, end) of a chunk to read; None means the whole chunk."""
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


def _partial(
    source: ByteSource, chunk: Chunk, messages: MessageIndex, runs: list[tuple[int, int]]
) -> Block:
    """Return requested messages of an uncompressed chunk without reading all of it."""
    base = chunk.data_offset
    pieces = source.read_all([(base + begin, end - begin) for begin, end in runs])
    begins, sizes, total = [], [], 0
    for number, (begin, end) in enumerate(runs):
        if len(pieces[number]) != end - begin:
            raise DamagedError("a chunk is truncated")
        inside = messages
        if len(runs) > 1:
            inside = messages[(messages.offsets >= begin) & (messages.offsets < end)]
        index = _measured(pieces[number], inside, chunk.size, begin)
        last = int(index.offsets[-1] + RECORD_HEAD + index.sizes[-1])
        if last > end:
            pieces[number] += source.read(base + end, last - end)
            if len(pieces[number]) != last - begin:
                raise DamagedError("a chunk is truncated")
        begins.append(index.offsets + (RECORD_HEAD - begin + total))
        sizes.append(index.sizes)
        total += len(pieces[number])
    data = b"".join(pieces)
    return block_at(chunk.first, messages, data, np.concatenate(begins), np.concatenate(sizes))
