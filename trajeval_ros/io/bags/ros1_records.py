"""Records of ROS 1 bags, format 2.0, and the messages in the chunks of a bag."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Booleans, Indices
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.io.bags.blocks import gather, logged_within
from trajeval_ros.io.bags.byte_source import DamagedError

MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = range(2, 8)
ENTRY_SIZE = 12  # bytes of a message in an index: seconds, nanoseconds, offset
_LARGEST_HEADER = 1 << 16  # bytes
_SIZE = struct.Struct("<I")
_LARGEST_CONNECTION = 1 << 24  # bytes; it contains the definition of a type
_MOST_CONNECTIONS = 16  # records of connections before a message; recorders write one

Read = Callable[[int, int], bytes]  # the bytes from an offset on, fewer at the end


@dataclass(frozen=True)
class BagRecord:
    """A record of a bag, or the fields in the data of one."""

    header: bytes  # its fields, serialised
    places: dict[str, slice]  # where the value of a field is in the header, by name
    begin: int  # where its data start
    size: int  # bytes of its data

    @property
    def end(self) -> int:
        """Where the next record starts."""
        return self.begin + self.size

    def text(self, name: str) -> str:
        """Return a field as text, "" if the record does not have it."""
        return self.header[self.places.get(name, slice(0))].decode(errors="replace")

    def number(self, name: str, size: int) -> int:
        """Return a field as an unsigned number of `size` bytes."""
        value = self.header[self.places.get(name, slice(0))]
        if len(value) != size:
            raise DamagedError(f"a record has no field {name!r}")
        return int.from_bytes(value, "little")

    def time(self, name: str) -> int:
        """Return a field as a time in nanoseconds."""
        both = self.number(name, 8)
        return (both & 0xFFFFFFFF) * NANOSECONDS + (both >> 32)


# Records of connections and the fields in their data, by id.
ConnectionRecords = dict[int, tuple[BagRecord, BagRecord]]


def record_at(read: Read, offset: int, kind: int | None = None) -> BagRecord:
    """Return the record at an offset.

    `read`: reads the bytes that the offset counts in. `kind`: what it must be, such as `CHUNK`;
    None for any.
    """
    length = _number(read(offset, 4))
    if length > _LARGEST_HEADER:
        raise DamagedError("a record has an invalid size")
    content = read(offset + 4, length + 4)
    header, size = content[:length], _number(content[length:])
    record = BagRecord(header, _places(header), offset + length + 8, size)
    if kind is not None and record.number("op", 1) != kind:
        raise DamagedError("a record is misplaced")
    return record


def fields_at(read: Read, record: BagRecord) -> BagRecord:
    """Return the fields in the data of a connection's record."""
    if record.size > _LARGEST_CONNECTION:
        raise DamagedError("a connection has an invalid size")
    data = read(record.begin, record.size)
    if len(data) != record.size:
        raise DamagedError("a record is truncated")
    return BagRecord(data, _places(data), record.begin, record.size)


def _places(header: bytes) -> dict[str, slice]:
    places = {}
    begin = 0
    while begin < len(header):
        end = begin + 4 + _number(header[begin : begin + 4])
        equals = header.find(b"=", begin + 4, end)
        if end > len(header) or equals < 0:
            raise DamagedError("a record has an invalid field")
        places[header[begin + 4 : equals].decode(errors="replace")] = slice(equals + 1, end)
        begin = end
    return places


def _number(data: bytes) -> int:
    if len(data) != 4:
        raise DamagedError("a record is truncated")
    return int.from_bytes(data, "little")


@dataclass(frozen=True, eq=False)
class ChunkIndex:
    """Indexed messages of a chunk."""

    connections: Indices  # (N,) their ids
    entries: NDArray[np.uint32]  # (N, 3) uint32: seconds, nanoseconds, and offset in the chunk

    def __len__(self) -> int:
        return len(self.entries)

    def __getitem__(self, rows: Booleans | Indices) -> ChunkIndex:
        return ChunkIndex(self.connections[rows], self.entries[rows])

    def within(self, begin: int | None, end: int | None) -> ChunkIndex:
        """Return the messages logged at `begin` or later and before `end`."""
        if begin is None and end is None:
            return self
        return self[logged_within(self.log_times, begin, end)]

    @property
    def log_times(self) -> Indices:
        """Log times (N,), ns."""
        seconds: Indices = self.entries[:, 0].astype(np.int64)
        return seconds * NANOSECONDS + self.entries[:, 1]

    @property
    def offsets(self) -> Indices:
        """Offsets in the chunk (N,), bytes."""
        return self.entries[:, 2].astype(np.int64)


def messages_in(
    data: bytes | memoryview, connections: ConnectionRecords
) -> tuple[ChunkIndex, int]:
    """Return the messages in a chunk's data, and where the last whole record ends.

    `connections`: those of the chunk are added; the first record of an id is used.
    """

    def read(offset: int, size: int) -> bytes:
        return bytes(data[offset : offset + size])

    ids: list[int] = []
    entries: list[tuple[int, int, int]] = []
    end = 0
    with contextlib.suppress(DamagedError):
        while end < len(data):
            record = record_at(read, end)
            kind = record.number("op", 1)
            if record.end > len(data) or kind not in (MESSAGE, CONNECTION):
                break
            connection = record.number("conn", 4)
            if kind == CONNECTION:
                connections.setdefault(connection, (record, fields_at(read, record)))
            else:
                time = record.number("time", 8)
                ids.append(connection)
                entries.append((time & 0xFFFFFFFF, time >> 32, end))
            end = record.end
    return ChunkIndex(np.array(ids, np.int64), np.array(entries, np.uint32).reshape(-1, 3)), end


def find_messages(
    data: bytes | memoryview, offsets: Indices, index: ChunkIndex
) -> tuple[Indices, Indices, Booleans]:
    """Return where payloads start (N,), their sizes (N,), and which messages are valid (N,).

    A message is valid if its record has the connection and the time of the index. A recorder
    writes the same layout in all records. It is taken from the first one and compared with all at
    once. Only records that differ are parsed one by one. `offsets`: (N,) of the messages in these
    bytes.
    """

    def read(offset: int, size: int) -> bytes:
        return bytes(data[offset : offset + size])

    begins = np.zeros(len(index), dtype=np.int64)
    sizes, valid = begins.copy(), np.zeros(len(index), dtype=bool)
    with contextlib.suppress(DamagedError):
        begins, sizes, valid = _alike(data, _message_at(read, int(offsets[0])), offsets, index)
    for row in np.flatnonzero(~valid).tolist():
        try:
            record = _message_at(read, int(offsets[row]))
            key = record.number("conn", 4), record.time("time")
        except DamagedError:
            continue
        begins[row], sizes[row] = record.begin, record.size
        valid[row] = record.end <= len(data) and key == (
            index.connections[row],
            index.log_times[row],
        )
    return begins, sizes, valid


def _message_at(read: Read, offset: int) -> BagRecord:
    """Return the record of a message; a connection's first message comes after its record."""
    for _ in range(_MOST_CONNECTIONS):
        record = record_at(read, offset)
        kind = record.number("op", 1)
        if kind == MESSAGE:
            return record
        if kind != CONNECTION:
            break
        offset = record.end
    raise DamagedError("a message is not at its indexed position")


def _alike(
    data: bytes | memoryview, model: BagRecord, offsets: Indices, index: ChunkIndex
) -> tuple[Indices, Indices, Booleans]:
    """Return as `find_messages` those whose record has the layout of a model."""
    header = np.frombuffer(_SIZE.pack(len(model.header)) + model.header, dtype=np.uint8)
    model.number("conn", 4), model.number("time", 8)
    kind = np.dtype(
        {
            "names": ["header", "connection", "time", "size"],
            "formats": [("u1", len(header)), "<u4", ("<u4", 2), "<u4"],
            "offsets": [
                0,
                4 + model.places["conn"].start,
                4 + model.places["time"].start,
                len(header),
            ],
            "itemsize": len(header) + 4,
        }
    )
    begins = offsets + kind.itemsize
    sizes, valid = np.zeros_like(begins), begins <= len(data)
    heads = gather(np.frombuffer(data, dtype=np.uint8), offsets[valid], kind)
    expected = np.empty(len(heads), dtype=kind)
    expected["header"] = header
    expected["connection"] = index.connections[valid]
    expected["time"] = index.entries[valid, :2]
    sizes[valid] = heads["size"]
    valid[valid] = (heads["header"] == expected["header"]).all(axis=1)
    return begins, sizes, valid & (begins + sizes <= len(data))
