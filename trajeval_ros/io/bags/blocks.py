"""Messages in blocks: one buffer for many messages, without a Python object per message.

Values are gathered from any positions of a buffer at once.
"""

from __future__ import annotations

import functools
import heapq
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Booleans, Indices, at_rows
from trajeval_ros.io.bags.message_definitions import LARGEST_MESSAGE

Buffer = NDArray[np.uint8]
ROWS = 8192  # of a block, at most
BYTES = 1 << 20  # of a block made of single messages, until which more are added
LARGEST = 1 << 30  # bytes that anything compressed may say that it has
_ZSTD = np.frombuffer(b"\x28\xb5\x2f\xfd", dtype=np.uint8)


def gather(buffer: Buffer, places: Indices, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the values (N,) at the places (N,), which need no alignment.

    `buffer`: (B,) bytes. `places`: where the values start; all of them end within the buffer.
    """
    if not len(places):
        return np.zeros(0, dtype=dtype)
    # Cells of a value's size from every byte on: they overlap, only the requested ones are copied.
    size = dtype.itemsize
    cells: NDArray[Any] = np.ndarray(len(buffer) - size + 1, bytes_type(size), buffer, 0, (1,))
    values: NDArray[Any] = cells[places].view(dtype)
    return values


@functools.lru_cache(maxsize=256)
def bytes_type(size: int) -> np.dtype[np.void]:
    """Return the type of `size` bytes."""
    return np.dtype(f"V{size}")


def are_same(values: NDArray[Any]) -> bool:
    """Return whether all values (N,) have the same bytes; N is at least 1."""
    content = values.tobytes()
    return content == content[: values.itemsize] * len(values)


_COLUMNS = "connections", "log_times", "begins", "sizes", "publish_times"


@dataclass(frozen=True, eq=False)
class Block:
    """Messages of some connections."""

    earliest: int  # lower bound of the log times in this block and in all later ones, ns
    connections: Indices  # (N,) ids of the connections
    log_times: Indices  # (N,) int64, ns
    buffer: Buffer  # (B,) bytes that contain the messages
    begins: Indices  # (N,) offsets of the messages in the buffer
    sizes: Indices  # (N,) sizes of the messages, bytes
    # (N,) int64, ns, by the clock of the publisher; the log times if the format has none.
    publish_times: Indices

    def __len__(self) -> int:
        return len(self.begins)

    def __getitem__(self, rows: Booleans | Indices | slice) -> Block:
        return at_rows(self, _COLUMNS, rows)

    def within(self, begin: int | None, end: int | None) -> Block:
        """Return the messages logged at `begin` or later and before `end`, ns."""
        if begin is None and end is None:
            return self
        is_within = np.ones(len(self), dtype=bool)
        if begin is not None:
            is_within &= self.log_times >= begin
        if end is not None:
            is_within &= self.log_times < end
        return self[is_within]

    def decompressed(self) -> Iterator[Block]:
        """Yield the messages, decompressed if the recorder compressed them one by one.

        The first bytes of zstd occur in no serialisation, so that no metadata is needed. Data that
        can't be decompressed become an empty message, which no decoder accepts. The result is
        several blocks of bounded size.
        """
        long = np.flatnonzero(self.sizes >= len(_ZSTD))
        maybe = long[self.buffer[self.begins[long]] == _ZSTD[0]]
        if not len(maybe):
            yield self
            return
        heads = self.buffer[self.begins[maybe][:, None] + np.arange(len(_ZSTD))]
        compressed = set(maybe[(heads == _ZSTD).all(axis=1)].tolist())
        payloads: list[bytes | memoryview] = []
        begin = size = 0
        for row, payload in enumerate(self.payloads()):
            payloads.append(_decompressed(bytes(payload)) if row in compressed else payload)
            size += len(payloads[-1])
            if size >= BYTES or row + 1 == len(self):
                rows = slice(begin, row + 1)
                plain = block_of(self.connections[rows], self.log_times[rows], payloads)
                published = self.publish_times[rows]
                yield replace(plain, earliest=self.earliest, publish_times=published)
                payloads, begin, size = [], row + 1, 0

    def by_connection(self) -> Iterator[tuple[int, Block]]:
        """Yield the messages by connection."""
        if len(self) and (self.connections == self.connections[0]).all():
            yield int(self.connections[0]), self
            return
        for connection in sorted(set(self.connections.tolist())):  # unique imports numpy.ma
            yield connection, self[self.connections == connection]

    def compact(self) -> Block:
        """Return the same messages in a smaller buffer if they are less than half of this one."""
        if 2 * int(self.sizes.sum()) >= len(self.buffer):
            return self
        size = int(self.sizes[0]) if len(self) else 0
        if size and (self.sizes == size).all():
            buffer = gather(self.buffer, self.begins, bytes_type(size)).view(np.uint8)
            return replace(self, buffer=buffer, begins=np.arange(len(self)) * size)
        payloads = list(self.payloads())
        block = block_of(self.connections, self.log_times, payloads)
        return replace(block, earliest=self.earliest, publish_times=self.publish_times)

    def payloads(self) -> Iterator[memoryview]:
        """Yield the serialised messages."""
        whole = memoryview(self.buffer.data)
        for begin, size in zip(self.begins.tolist(), self.sizes.tolist(), strict=True):
            yield whole[begin : begin + size]


def block_of(
    connections: Sequence[int] | Indices,
    log_times: Sequence[int] | Indices,
    payloads: Sequence[bytes | memoryview],
) -> Block:
    """Return single messages as a block."""
    sizes = np.fromiter(map(len, payloads), np.int64, len(payloads))
    times = np.asarray(log_times, dtype=np.int64)
    return Block(
        int(times.min()) if len(times) else 0,
        np.asarray(connections, dtype=np.int64),
        times,
        np.frombuffer(b"".join(payloads), dtype=np.uint8),
        np.cumsum(sizes) - sizes,
        sizes,
        times,
    )


def blocks_of(messages: Iterable[tuple[int, int, bytes]]) -> Iterator[Block]:
    """Yield single messages (connection, log time, payload) in blocks of bounded size."""
    connections: list[int] = []
    log_times: list[int] = []
    payloads: list[bytes] = []
    size = 0
    for connection, log_time, payload in messages:
        connections.append(connection)
        log_times.append(log_time)
        payloads.append(payload)
        size += len(payload)
        if size >= BYTES or len(payloads) == ROWS:
            yield block_of(connections, log_times, payloads)
            connections, log_times, payloads, size = [], [], [], 0
    if payloads:
        yield block_of(connections, log_times, payloads)


def merged(blocks: Iterable[Block]) -> Iterator[Block]:
    """Yield the same messages in fewer blocks, without the bytes between them."""
    waiting: list[Block] = []
    rows = size = 0
    for block in blocks:
        waiting.append(block.compact())
        rows += len(block)
        size += len(waiting[-1].buffer)
        if rows >= ROWS or size >= BYTES:
            yield _concatenated(waiting)
            waiting, rows, size = [], 0, 0
    if waiting:
        yield _concatenated(waiting)


def _concatenated(blocks: Sequence[Block]) -> Block:
    if len(blocks) == 1:
        return blocks[0]
    buffers = [block.buffer for block in blocks]
    befores = np.cumsum([0, *map(len, buffers)]).tolist()
    return Block(
        blocks[0].earliest,
        np.concatenate([block.connections for block in blocks]),
        np.concatenate([block.log_times for block in blocks]),
        np.concatenate(buffers),
        np.concatenate(
            [block.begins + before for block, before in zip(blocks, befores, strict=False)]
        ),
        np.concatenate([block.sizes for block in blocks]),
        np.concatenate([block.publish_times for block in blocks]),
    )


def in_order(blocks: Iterable[Block]) -> Iterator[tuple[int, int, bytes]]:
    """Yield connection, log time and payload of all messages, in order of their log times."""
    waiting: list[tuple[int, int, int, bytes]] = []
    count = 0
    for block in blocks:
        while waiting and waiting[0][0] <= block.earliest:
            log_time, _, connection, payload = heapq.heappop(waiting)
            yield connection, log_time, payload
        rows = zip(
            block.log_times.tolist(), block.connections.tolist(), block.payloads(), strict=True
        )
        for log_time, connection, view in rows:
            heapq.heappush(waiting, (log_time, count, connection, bytes(view)))
            count += 1
    while waiting:
        log_time, _, connection, payload = heapq.heappop(waiting)
        yield connection, log_time, payload


def _decompressed(payload: bytes) -> bytes | memoryview:
    from trajeval_ros.io.bags.compression import decompress, most_of

    return decompress("zstd", payload, min(most_of(len(payload), BYTES), LARGEST_MESSAGE))


@dataclass(eq=False)
class TopicSelection:
    """Some connections of a file, and the damage found while reading them."""

    connections: frozenset[int]  # their ids
    damage: list[str] = field(default_factory=list)  # unreadable parts, one sentence per part
    notes: list[str] = field(default_factory=list)  # other information on the reading


def all_connections(selections: Sequence[TopicSelection]) -> frozenset[int]:
    """Return the ids of the connections of all selections."""
    return frozenset().union(*(selection.connections for selection in selections))


def are_of(ids: Indices, requested: Collection[int]) -> Booleans:
    """Return which of the ids (N,) are of some connections."""
    if len(requested) == 1:  # takes a tenth of the time of isin
        return np.asarray(ids == next(iter(requested)))
    return np.isin(ids, list(requested))
