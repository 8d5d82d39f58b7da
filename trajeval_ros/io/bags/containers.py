"""The files of a bag, opened by their first bytes, and the topics in them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags import foxglove
from trajeval_ros.io.bags.blocks import Block, TopicSelection
from trajeval_ros.io.bags.byte_source import LocalFile, RemoteFile, source_of
from trajeval_ros.io.bags.compression import decompress_file
from trajeval_ros.io.bags.mcap_records import MAGIC
from trajeval_ros.io.bags.message_definitions import Connection, Fields, recorded_fields
from trajeval_ros.io.bags.pose_messages import FIX_TYPE, POSE_2D, POSE_TYPES, TRANSFORM_TYPES
from trajeval_ros.io.bags.px4_messages import GPS, PX4_POSE_TYPES

_HEAD = 16  # bytes that identify the format
_SQLITE, _ROS1, _ZSTD = b"SQLite format 3\0", b"#ROSBAG V", b"(\xb5/\xfd"
_ENCODINGS = ("cdr", "ros1")


class Container(Protocol):
    """An open file of a bag."""

    connections: list[Connection]  # topics by connection, with the declared number of messages
    damage: list[str]  # unreadable parts that were found at opening, one sentence per part

    @property
    def span(self) -> tuple[int, int] | None:
        """First and last log time of all messages, ns; None if there is none."""

    def blocks(
        self,
        selections: Sequence[TopicSelection],
        begin: int | None = None,
        end: int | None = None,
        *,
        in_order: bool = False,
    ) -> Iterator[Block]:
        """Yield the messages of some connections, of all selections in one pass over the file.

        After the last block, every selection lists the damage of what was read for it. Damage of a
        piece that may have messages of several selections is listed by all of them. `begin`: the
        first requested log time, ns. `end`: the first log time after the requested ones, ns.
        `in_order`: whether blocks must be in order of their earliest log times.
        """

    def close(self) -> None:
        """Close the file."""


def open_file(path: Path, folder: Path, *, strict: bool = False) -> Container:
    """Return an open file.

    `folder`: where a file that is compressed as a whole is decompressed.
    """
    source, plain = source_of(path), path
    beginning = source.read(0, _HEAD)
    if beginning.startswith(_ZSTD) and isinstance(source, LocalFile):
        source.close()
        plain = decompress_file(path, folder)
        source = LocalFile(plain)
        source.name = str(path)  # not of the copy, which the user has not named
        beginning = source.read(0, _HEAD)
    if beginning.startswith(MAGIC):
        from trajeval_ros.io.bags.mcap_bag import McapReader

        return McapReader(source, strict=strict)
    source.close()
    if isinstance(source, RemoteFile):
        raise InputError(f"{path} is not MCAP; copy it to this machine first")
    if not beginning:
        raise InputError(f"{path} is empty; check that the recording has data")
    if beginning.startswith(_SQLITE):
        from trajeval_ros.io.bags.sqlite_bag import SqliteReader

        return SqliteReader(plain, source.name)
    if beginning.startswith(_ROS1):
        from trajeval_ros.io.bags.ros1_bag import Ros1Reader

        return Ros1Reader(plain, source.name)
    raise InputError(f"{path} is not a bag: neither MCAP, sqlite3 nor ROS 1")


@dataclass(frozen=True, eq=False)
class Topic:
    """A topic of a bag."""

    name: str  # with a slash before it
    type: str
    declared: int | None  # the number of messages according to the bag, None if unknown
    # Its connections in the files of the bag.
    connections: tuple[Connection, ...] = field(repr=False, default=())

    @property
    def count(self) -> int:
        """The number of its messages, counted if the bag does not declare it."""
        if self.declared is not None:
            return self.declared
        return sum(
            connection.owner.count(connection.id) if connection.count < 0 else connection.count
            for connection in self.connections
        )

    @property
    def holds_poses(self) -> bool:
        """Whether its messages are poses."""
        others = (*PX4_POSE_TYPES, POSE_2D, foxglove.POSE_TYPE, foxglove.FIX_TYPE)
        return self.type in (*POSE_TYPES, *others) and self._is_readable

    @property
    def fields(self) -> Fields:
        """The fields of its messages by the bag's definition; () if they can't be decoded."""
        if not self.connections or not self._is_readable or self.type in foxglove.TYPES:
            return ()
        return recorded_fields(self.connections[0]) or ()

    @property
    def holds_fixes(self) -> bool:
        """Whether its messages are GNSS fixes."""
        return self.type in (FIX_TYPE, foxglove.FIX_TYPE, GPS)

    @property
    def holds_transforms(self) -> bool:
        """Whether its messages are TF."""
        types = (*TRANSFORM_TYPES, *foxglove.TRANSFORM_TYPES)
        return self.type in types and self._is_readable

    @property
    def lacks_protobuf(self) -> bool:
        """Whether only the decoder of protobuf is missing."""
        return (
            self.type in foxglove.TYPES
            and not self._is_readable
            and all(connection.encoding in foxglove.ENCODINGS for connection in self.connections)
        )

    def connections_in(self, container: Container) -> frozenset[int]:
        """Return the ids of its connections in one file of the bag."""
        return frozenset(
            connection.id for connection in self.connections if connection.owner is container
        )

    @property
    def _is_readable(self) -> bool:
        encodings = [connection.encoding for connection in self.connections]
        if self.type in foxglove.TYPES:
            return all(foxglove.is_decodable(encoding) for encoding in encodings)
        return all(encoding in _ENCODINGS for encoding in encodings)


@dataclass(eq=False)
class TopicReading:
    """A topic that is read, and the damage found."""

    topic: Topic
    count: int = 0  # number of messages read so far
    # Unreadable parts, one sentence per part; complete after the last message.
    damage: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # other information on the reading
