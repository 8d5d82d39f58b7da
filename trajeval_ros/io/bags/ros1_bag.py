"""Bags of ROS 1, read by rosbags: the messages of a chunk as a block.

Compressed chunks have limits here, and chunks that the index does not list are reported. A bag
without an index, as after a killed recorder, is refused with the command that repairs it.
"""

from __future__ import annotations

import functools
import re
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

from rosbags.rosbag1.reader import Reader, decompressors

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.io.bags.blocks import (
    LARGEST,
    Block,
    TopicSelection,
    all_connections,
    blocks_of,
)
from trajeval_ros.io.bags.byte_source import DamagedError
from trajeval_ros.io.bags.compression import LARGEST_CHUNK, LARGEST_RATIO, decompress, most_of
from trajeval_ros.io.bags.message_definitions import Connection, full_name

_MAGIC = len(b"#ROSBAG V2.0\n")
_LARGEST_HEADER = 1 << 16  # bytes of the fields of a record
_CHUNK = b"\x04\0\0\0op=\x05"  # field of the records with messages
_INDEX, _ENTRY = b"\x04\0\0\0op=\x04", 12  # of the records of the index; bytes of a message in it
_MOST_MESSAGES = 20_000_000  # the reader needs 150 bytes of memory for each
_SIZE = re.compile(rb"\x09\0\0\0size=(.{4})", re.DOTALL)


class Ros1Reader:
    """An open bag of ROS 1."""

    def __init__(self, path: Path, name: str) -> None:
        """Read the index; `name` is the file's name in messages.

        Raises:
            InputError: It has no index that can be read, or states too large sizes.
        """
        self._name = name
        sizes = _sizes_of_chunks(path)
        self._reader = Reader(path)
        try:
            self._reader.open()
        except Exception as error:  # of several types, depending on the damage
            reason = str(error).rstrip(".")
            if "supported" in reason:
                raise InputError(f"{name} can't be read: {reason}") from error
            is_absent = "not indexed" in reason
            reason = "it has no index" if is_absent else "its index or a header is damaged"
            raise InputError(
                f"{name} can't be read: {reason}; to repair it, use `rosbag reindex {path.name}`"
            ) from error
        self._bound(sizes, path.stat().st_size)
        counts: Counter[int] = Counter()
        for info in self._reader.chunk_infos:
            counts.update(info.connection_counts)
        # Its connections; several may have one topic.
        self.connections = [
            self._connection(connection, counts) for connection in self._reader.connections
        ]
        self._indexes = self._reader.indexes  # entries by connection, in order of their times
        self.damage: list[str] = []  # what opening it found that can't be read
        if unlisted := len(sizes.keys() - self._reader.chunks.keys()):
            self.damage.append(
                f"{name}: its index does not list {counted(unlisted, 'chunk')}; to read all, use "
                f"`rosbag reindex {path.name}`"
            )

    @property
    def span(self) -> tuple[int, int] | None:
        """First and last log time of all messages, ns; None if there is none."""
        infos = [info for info in self._reader.chunk_infos if info.connection_counts]
        if not infos:
            return None
        # The end is after the last message.
        return min(info.start_time for info in infos), max(info.end_time for info in infos) - 1

    def close(self) -> None:
        """Close the file."""
        self._reader.close()

    def blocks(
        self,
        selections: Sequence[TopicSelection],
        begin: int | None = None,
        end: int | None = None,
        *,
        in_order: bool = False,  # noqa: ARG002  # they always are
    ) -> Iterator[Block]:
        """Yield the messages of some connections, of all selections in one pass."""
        lost = {selection: Counter[str]() for selection in selections}
        requested = all_connections(selections)
        anyone = [item for item in self._reader.connections if item.id in requested][:1]
        chunks = self._by_chunk(requested, begin, end)
        for place in sorted(chunks, key=lambda place: chunks[place][0].time):
            # The reader stops at the first damage of what its index lists: a chunk at a time. It
            # takes the connection of a message from the message, so all are listed under one.
            self._reader.indexes = {anyone[0].id: chunks[place]}
            messages: list[tuple[int, int, bytes]] = []
            try:
                for connection, time, payload in self._reader.messages(anyone):
                    if connection.id in requested:
                        messages.append((connection.id, time, payload))
            except Exception as error:  # of several types, depending on the damage
                reason = str(error) if isinstance(error, DamagedError) else "a chunk is damaged"
                read = Counter(number for number, _, _ in messages)
                for selection in selections:
                    listed = self._by_chunk(selection.connections, begin, end).get(place, [])
                    lost[selection][reason] += len(listed)
                    lost[selection][reason] -= sum(read[item] for item in selection.connections)
            yield from blocks_of(messages)
        for selection in selections:
            selection.damage += [
                f"{self._name} is damaged: {reason}, {counted(count, 'message')} lost; to recover "
                "more, try `rosbag fix`"
                for reason, count in lost[selection].items()
                if count
            ]

    def _by_chunk(
        self, connections: Collection[int], begin: int | None, end: int | None
    ) -> dict[int, list[Any]]:
        """Return the entries of some connections in a time window, by chunk, in order of time."""
        chunks: dict[int, list[Any]] = defaultdict(list)
        for connection in connections:
            for entry in self._indexes.get(connection, ()):
                if (begin is None or entry.time >= begin) and (end is None or entry.time < end):
                    chunks[entry.chunk_pos].append(entry)
        for entries in chunks.values():
            entries.sort(key=attrgetter("time"))
        return chunks

    def _bound(self, sizes: dict[int, int], size: int) -> None:
        """Replace the decompression of chunks by one with a limit."""
        names = {decompressor: name for name, decompressor in decompressors.items()}
        total = 0
        for place, chunk in self._reader.chunks.items():
            kind = names[chunk.decompressor]
            if kind != "none":
                total += sizes.get(place, 0)
                limited = functools.partial(_decompressed, kind, sizes.get(place, 0))
                self._reader.chunks[place] = chunk._replace(decompressor=limited)
        if total > most_of(size, LARGEST):
            raise InputError(
                f"{self._name} has a compression ratio above {LARGEST_RATIO}; if you trust the "
                "file, decompress it with `rosbag decompress`"
            )

    def _connection(self, connection: Any, counts: Counter[int]) -> Connection:
        return Connection(
            connection.id,
            connection.topic,
            full_name(connection.msgtype),
            "MSG",
            connection.msgdef.data,
            counts[connection.id],
            "ros1",
            self,
            is_latching=bool(connection.ext.latching),
        )


def _decompressed(kind: str, size: int, data: bytes) -> bytes:
    """Return the data of a compressed chunk, whose size the chunk states."""
    if size > min(most_of(len(data), LARGEST_CHUNK), LARGEST):
        raise DamagedError("a chunk has an invalid size")
    plain = decompress(kind, data, size)
    if len(plain) != size:
        raise DamagedError("a chunk can't be decompressed")
    return bytes(plain)


def _sizes_of_chunks(path: Path) -> dict[int, int]:
    """Return the sizes of all chunks after decompression, by the places of their records.

    Raises:
        InputError: The index has more messages than the memory of a computer.
    """
    sizes = {}
    messages = 0
    with path.open("rb") as file:
        end = file.seek(0, 2)
        place = _MAGIC
        while place + 8 <= end:
            file.seek(place)
            length = int.from_bytes(file.read(4), "little")
            if length > _LARGEST_HEADER:
                break
            header, data = file.read(length), file.read(4)
            if _CHUNK in header and (match := _SIZE.search(header)):
                sizes[place] = int.from_bytes(match[1], "little")
            elif _INDEX in header:
                messages += int.from_bytes(data, "little") // _ENTRY
            place += 8 + length + int.from_bytes(data, "little")
    if messages > _MOST_MESSAGES:
        raise InputError(
            f"{path} has more than {_MOST_MESSAGES} messages; copy the topics of poses with "
            "`rosbag filter`"
        )
    return sizes
