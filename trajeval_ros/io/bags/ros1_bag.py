"""Bags of ROS 1, by the reader of `rosbags`."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from trajeval_ros.io.bags.blocks import Block, blocks_of

if TYPE_CHECKING:
    from rosbags.interfaces import Connection


class Ros1Reader:
    """An open bag of ROS 1.

    Attributes:
        connections: Its connections; several may have one topic.
        damage: What can't be read, one sentence each; grows while blocks are read.
        notes: What else to know about what was read.
    """

    def __init__(self, path: Path) -> None:
        """Open the bag and read its index."""
        from rosbags.rosbag1 import Reader

        self.damage: list[str] = []
        self.notes: list[str] = []
        self._path = path
        self._reader = Reader(path)
        self._reader.open()
        self.connections: list[Connection] = [
            connection._replace(owner=self) for connection in self._reader.connections
        ]

    @property
    def span(self) -> tuple[int, int] | None:
        """First and last log time of all messages, ns; None if there is none."""
        if not self._reader.message_count:
            return None
        return self._reader.start_time, self._reader.end_time - 1

    def close(self) -> None:
        """Close the bag."""
        self._reader.close()

    def blocks(
        self,
        wanted: Collection[int],
        begin: int | None = None,
        end: int | None = None,
        *,
        in_order: bool = False,  # noqa: ARG002  # they always are
    ) -> Iterator[Block]:
        """Yield the messages of some connections."""
        yield from blocks_of(self._messages(wanted, begin, end))

    def _messages(
        self, wanted: Collection[int], begin: int | None, end: int | None
    ) -> Iterator[tuple[int, int, bytes]]:
        connections = [each for each in self._reader.connections if each.id in wanted]
        try:
            for connection, log_time, payload in self._reader.messages(connections, begin, end):
                yield connection.id, log_time, payload
        except Exception as error:  # of half a dozen kinds: what a damaged chunk raises is chance
            said = " ".join(str(error).split()).rstrip(".")[:200]
            self.damage.append(
                f"{self._path} is damaged ({said or type(error).__name__}); "
                "`rosbag reindex` or `rosbag fix` may save more"
            )
