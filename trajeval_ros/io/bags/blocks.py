"""Messages in blocks: one buffer for many messages, without a Python object per message."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Indices
from trajeval_ros.io.bags.byte_buffers import Buffer, bytes_type, gather

Owner = TypeVar("Owner")

ROWS = 8192  # of a block, at most
BYTES = 1 << 20  # of a block made of single messages, until which more are added
LARGEST = 1 << 30  # bytes that anything compressed may say that it has
_LARGEST_MESSAGE = 1 << 28  # bytes that one message may become
_ZSTD = np.frombuffer(b"\x28\xb5\x2f\xfd", dtype=np.uint8)


def logged_within(log_times: Indices, begin: int | None, end: int | None) -> Booleans:
    """Return which messages (N,) were logged at `begin` or later and before `end`, ns."""
    wanted = np.ones(len(log_times), dtype=bool)
    if begin is not None:
        wanted &= log_times >= begin
    if end is not None:
        wanted &= log_times < end
    return wanted


@dataclass(frozen=True)
class Block:
    """Messages of some connections.

    Attributes:
        earliest: Lower bound of the log times in this block and in all later ones, ns.
        connections: (N,) ids of the connections.
        log_times: (N,) int64, ns.
        buffer: (B,) bytes that contain the messages.
        begins: (N,) offsets of the messages in the buffer.
        sizes: (N,) sizes of the messages, bytes.
    """

    earliest: int
    connections: Indices
    log_times: Indices
    buffer: Buffer
    begins: Indices
    sizes: Indices

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.begins)

    def __getitem__(self, rows: Booleans | Indices | slice) -> Block:
        """Return some of the messages."""
        return replace(
            self,
            connections=self.connections[rows],
            log_times=self.log_times[rows],
            begins=self.begins[rows],
            sizes=self.sizes[rows],
        )

    def within(self, begin: int | None, end: int | None) -> Block:
        """Return the messages logged at `begin` or later and before `end`."""
        if begin is None and end is None:
            return self
        return self[logged_within(self.log_times, begin, end)]

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
                yield replace(plain, earliest=self.earliest)
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
        own = block_of(self.connections, self.log_times, payloads)
        return replace(own, earliest=self.earliest)

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


def merged(
    blocks: Iterable[tuple[Sequence[Owner], Block]],
) -> Iterator[tuple[Sequence[Owner], Block]]:
    """Yield the same messages in fewer blocks, without the bytes between them.

    Args:
        blocks: Blocks with their owners. Only blocks of the same owners are merged. The order of
            an owner's messages does not change.
    """
    waiting: dict[tuple[Owner, ...], _Waiting] = {}
    for several, block in blocks:
        owners = tuple(several)
        for other in [each for each in waiting if each != owners]:
            if any(each in owners for each in other):
                yield other, _concatenated(waiting.pop(other).blocks)
        own = waiting.setdefault(owners, _Waiting())
        own.add(block.compact())
        if own.rows >= ROWS or own.size >= BYTES:
            yield owners, _concatenated(waiting.pop(owners).blocks)
    for owners, own in waiting.items():
        yield owners, _concatenated(own.blocks)


class _Waiting:
    """Blocks that are too small to be decoded yet, with the numbers of messages and bytes."""

    def __init__(self) -> None:
        self.blocks: list[Block] = []
        self.rows = self.size = 0

    def add(self, block: Block) -> None:
        self.blocks.append(block)
        self.rows += len(block)
        self.size += len(block.buffer)


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

    return decompress("zstd", payload, min(most_of(len(payload), BYTES), _LARGEST_MESSAGE))
