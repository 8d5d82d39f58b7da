"""The files of a bag, opened by their first bytes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.blocks import Block
from trajeval_ros.io.bags.byte_source import LocalFile, RemoteFile, source_of
from trajeval_ros.io.bags.compression import decompress_file
from trajeval_ros.io.bags.mcap_records import MAGIC
from trajeval_ros.io.bags.selection import TopicSelection

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

_HEAD = 16  # bytes that identify the format
_SQLITE, _ROS1, _ZSTD = b"SQLite format 3\0", b"#ROSBAG V", b"(\xb5/\xfd"


class Container(Protocol):
    """An open file of a bag.

    Attributes:
        connections: Topics by connection, with the declared number of messages.
        damage: Unreadable parts that were found at opening, one sentence per part.
    """

    connections: list[Connection]
    damage: list[str]

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
    ) -> Iterator[tuple[Sequence[TopicSelection], Block]]:
        """Yield the messages of some connections, of all selections in one pass over the file.

        A block is yielded with the selections that have messages in it. After the last block,
        every selection lists its damage.

        Args:
            selections: The requested connections.
            begin: The first log time wanted, ns.
            end: The first log time after the requested ones, ns.
            in_order: Whether blocks must be in order of their earliest log times.
        """

    def close(self) -> None:
        """Close the file."""


def open_file(path: Path, folder: Path, *, strict: bool = False) -> Container:
    """Return an open file.

    Args:
        path: The file.
        folder: Where a file that is compressed as a whole is decompressed.
        strict: Whether to verify all that is read.

    Raises:
        InputError: It is no bag.
    """
    source, plain = source_of(path), path
    beginning = source.read(0, _HEAD)
    if beginning.startswith(_ZSTD) and isinstance(source, LocalFile):
        source.close()
        plain = decompress_file(path, folder)
        source = LocalFile(plain)
        source.name = str(path)  # the user knows nothing of a copy
        beginning = source.read(0, _HEAD)
    if beginning.startswith(MAGIC):
        from trajeval_ros.io.bags.mcap_index import McapReader

        return McapReader(source, strict=strict)
    if beginning.startswith(_ROS1) and isinstance(source, LocalFile):
        from trajeval_ros.io.bags.ros1_bag import Ros1Reader

        return Ros1Reader(source)
    source.close()
    if isinstance(source, RemoteFile):
        raise InputError(f"{path} is not MCAP; copy it to this machine first")
    if not beginning:
        raise InputError(f"{path} is empty; check that the recording has data")
    if beginning.startswith(_SQLITE):
        from trajeval_ros.io.bags.sqlite_bag import SqliteReader

        return SqliteReader(plain, source.name)
    raise InputError(f"{path} is not a bag: neither MCAP, sqlite3 nor ROS 1")
