"""Bags of ROS 1, by the reader of `rosbags`."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from trajeval_ros.io.bags.blocks import Block, blocks_of
from trajeval_ros.io.bags.selection import TopicSelection, all_connections

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.rosbag1 import Reader


class Ros1Reader:
    """An open bag of ROS 1.

    Attributes:
        connections: Its connections; several may have one topic.
        damage: What opening it found that can't be read, one sentence each.
    """

    def __init__(self, path: Path, name: str) -> None:
        """Open the bag and read its index.

        Args:
            path: The file.
            name: What to call it in a sentence.
        """
        self.damage: list[str] = []
        self._path, self._name = path, name
        self._reader = _opened(path)
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
        selections: Sequence[TopicSelection],
        begin: int | None = None,
        end: int | None = None,
        *,
        in_order: bool = False,  # noqa: ARG002  # they always are
    ) -> Iterator[tuple[Sequence[TopicSelection], Block]]:
        """Yield the messages of some connections, of all selections in one pass."""
        failures: list[Exception] = []
        counts: Counter[int] = Counter()
        messages = self._messages(all_connections(selections), begin, end, failures)
        for block in blocks_of(messages):
            yield selections, block
            counts.update(block.connections.tolist())
        if len(selections) == 1:
            selections[0].damage += map(self._sentence, failures)
        elif failures:  # the damage may be of one of them alone
            for selection in selections:
                alone: list[Exception] = []
                done = sum(counts[each] for each in selection.connections)
                messages = self._messages(selection.connections, begin, end, alone)
                for block in blocks_of(itertools.islice(messages, done, None)):
                    yield [selection], block
                selection.damage += map(self._sentence, alone)

    def _messages(
        self,
        wanted: Collection[int],
        begin: int | None,
        end: int | None,
        failures: list[Exception],
    ) -> Iterator[tuple[int, int, bytes]]:
        """Yield messages until there are no more, or one can't be read, which is a failure."""
        connections = [each for each in self._reader.connections if each.id in wanted]
        try:
            for connection, log_time, payload in self._reader.messages(connections, begin, end):
                yield connection.id, log_time, payload
        except Exception as error:  # of half a dozen kinds: what a damaged chunk raises is chance
            failures.append(error)
            self._reader.close()  # it has closed a chunk that it takes for an open one
            self._reader = _opened(self._path)

    def _sentence(self, error: Exception) -> str:
        said = " ".join(str(error).split()).rstrip(".")[:200]
        return (
            f"{self._name} is damaged ({said or type(error).__name__}); to recover more, try "
            "`rosbag reindex` or `rosbag fix`"
        )


def _opened(path: Path) -> Reader:
    """Return the reader of a bag, which has read its index."""
    from rosbags.rosbag1 import Reader

    reader = Reader(path)
    reader.open()
    return reader
