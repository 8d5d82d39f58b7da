"""Bags as containers: rosbag2 (sqlite3 and MCAP, directory or bare file) and ROS 1.

A bag is untrusted input. The type definition of a topic is parsed only if the topic is requested,
so that one invalid definition does not make the bag unreadable. Every exception of a damaged file
becomes one sentence.
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
from collections.abc import Callable, Iterator, Sequence
from operator import itemgetter
from pathlib import Path

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.install_command import extra_command
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Remark, damaged, note
from trajeval_ros.io.bags import foxglove
from trajeval_ros.io.bags.bag_folder import BagFolder, Metadata
from trajeval_ros.io.bags.blocks import Block, TopicSelection, in_order, merged
from trajeval_ros.io.bags.containers import Container, Topic, TopicReading, open_file
from trajeval_ros.io.bags.message_definitions import Connection
from trajeval_ros.io.checks import nearest
from trajeval_ros.io.writing import temporary_folder

Advance = Callable[[int, int], None]
Key = tuple[int, int]  # which file, and which of its connections

# Programs that repair interrupted recordings, by suffix.
_REPAIRS = {".mcap": "mcap recover", ".bag": "rosbag reindex"}


class Bag:
    """A bag that is open; a context manager."""

    def __init__(
        self, path: Path, advance: Advance | None = None, *, strict: bool = False
    ) -> None:
        """Open the bag.

        `advance`: called with the number of messages read and the number of all. `strict`: whether
        to verify all that is read, and to refuse what is damaged.
        """
        self.path = path  # the file or directory
        self.notes: list[str] = []  # problems that were worked around
        # Unreadable parts, one sentence per part. `messages` adds to it.
        self.damage: list[str] = []
        self._advance = advance
        self._strict = strict
        self._metadata: Metadata | None = None
        self._containers: list[Container] = []
        self._unread: list[Exception] = []
        with contextlib.ExitStack() as self._stack, _one_sentence(path):
            self._open()
            if not self._containers:
                raise self._unread[0]
            if strict and self.damage:
                raise InputError("; ".join(self.damage))
            # Its topics by name; a name with several types is one topic per type.
            self.topics = sorted(self._list_topics(), key=lambda topic: topic.name)
            self._stack = self._stack.pop_all()

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def span(self) -> tuple[int, int]:
        """The first and the last log time of all messages, ns."""
        with _one_sentence(self.path):
            spans = [
                span for container in self._containers if (span := container.span) is not None
            ]
        if not spans:
            raise InputError(f"{self.path} is an empty bag: it has no messages")
        return min(first for first, _ in spans), max(last for _, last in spans)

    def blocks(
        self, readings: Sequence[TopicReading]
    ) -> Iterator[tuple[TopicReading, Key, Block]]:
        """Yield all messages of some topics in blocks of one connection, in one pass over the bag.

        After the last block, every reading lists its damage, such as a number of messages that
        differs from the declared one.
        """
        done = 0
        total = sum(item.topic.declared or 0 for item in readings)
        with _one_sentence(self.path):
            for container in self._containers:
                selections = {
                    TopicSelection(ids): item
                    for item in readings
                    if (ids := item.topic.connections_in(container))
                }
                if not selections:
                    continue
                readings_by: dict[int, list[TopicReading]] = {}
                for selection, reading in selections.items():
                    for item in selection.connections:
                        readings_by.setdefault(item, []).append(reading)
                for block in merged(container.blocks(tuple(selections))):
                    for plain in block.decompressed():
                        for connection, messages in plain.by_connection():
                            for reading in readings_by[connection]:
                                reading.count += len(messages)
                                done += len(messages)
                                yield reading, (id(container), connection), messages
                    if self._advance is not None:
                        self._advance(done, max(done, total))
                for selection, reading in selections.items():
                    reading.damage += selection.damage
                    reading.notes += selection.notes
        if self._advance is not None and not done:
            self._advance(done, max(done, total))
        for reading in readings:
            reading.damage += self._missing([reading.topic], reading.count)

    def remarks(self, readings: Sequence[TopicReading]) -> tuple[Remark, ...]:
        """Return the notes and the damage of readings, and of opening the bag."""
        notes, damage = [*self.notes], [*self.damage]
        for reading in readings:
            notes += reading.notes
            damage += reading.damage
            if self._strict and damage:
                raise InputError("; ".join(dict.fromkeys(damage)))
        noted = [note("bag", item) for item in dict.fromkeys(notes)]
        return (*noted, *(damaged(item) for item in dict.fromkeys(damage)))

    def messages(
        self, topics: Sequence[Topic], begin: int | None = None, end: int | None = None
    ) -> Iterator[tuple[Topic, int, bytes]]:
        """Yield topic, log time in ns and payload of the messages, in order of their log times.

        `begin`: the first requested log time, ns. `end`: the first log time after the requested
        ones, ns.
        """
        done = 0
        selections: list[TopicSelection] = []
        with _one_sentence(self.path):
            streams = []
            for container in self._containers:
                requested = {
                    connection: topic
                    for topic in topics
                    for connection in topic.connections_in(container)
                }
                if requested:
                    selections.append(TopicSelection(frozenset(requested)))
                    streams.append(self._stream(container, selections[-1], requested, begin, end))
            for message in heapq.merge(*streams, key=itemgetter(1)):
                yield message
                done += 1
        if begin is None and end is None:
            damage = [item for selection in selections for item in selection.damage]
            damage += self._missing(topics, done)
            self.damage = list(dict.fromkeys([*self.damage, *damage]))
            notes = [item for selection in selections for item in selection.notes]
            self.notes = list(dict.fromkeys([*self.notes, *notes]))
            if self._strict and self.damage:
                raise InputError("; ".join(self.damage))

    @staticmethod
    def _stream(
        container: Container,
        selection: TopicSelection,
        requested: dict[int, Topic],
        begin: int | None,
        end: int | None,
    ) -> Iterator[tuple[Topic, int, bytes]]:
        """Yield the messages that one file has of the topics, in order."""
        blocks = container.blocks([selection], begin, end, in_order=True)
        plain = itertools.chain.from_iterable(block.decompressed() for block in blocks)
        for connection, log_time, payload in in_order(plain):
            yield requested[connection], log_time, payload

    def _missing(self, topics: Sequence[Topic], done: int) -> list[str]:
        """Return one sentence if fewer or more messages were read than the bag declares."""
        counts = [topic.declared for topic in topics]
        total = sum(count or 0 for count in counts)
        if done == total or None in counts:
            return []
        names = ", ".join(topic.name for topic in topics)
        return [
            f"{self.path} declares {counted(total, 'message')} on {names}, but {done} were read"
        ]

    def find(self, name: str) -> list[Topic]:
        """Return the topics of that name, one per type."""
        matches = [topic for topic in self.topics if topic.name == name]
        if any(topic.lacks_protobuf for topic in matches):
            raise InputError(
                f"{self.path}: {name} is in protobuf, which needs an extra; install it: "
                f"{extra_command(foxglove.EXTRA)}"
            )
        if matches:
            return matches
        names = {topic.name for topic in self.topics}
        raise InputError(f"{self.path} has no topic {name}; it has {nearest(name, names)}")

    def _list_topics(self) -> Iterator[Topic]:
        """Yield the topics of all readers, with the connections of the same name and type."""
        by_name: dict[tuple[str, str], list[Connection]] = {}
        for container in self._containers:
            for connection in container.connections:
                name = "/" + connection.topic.lstrip("/")  # ROS 1 records names without slash, too
                by_name.setdefault((name, connection.type), []).append(connection)
        for (name, message_type), connections in by_name.items():
            counts = [connection.count for connection in connections]
            declared = sum(counts) if min(counts) >= 0 else None
            if self._metadata is not None:
                declared = self._metadata.counts.get((name, message_type), declared)
            yield Topic(name, message_type, declared, tuple(connections))

    def _open(self) -> None:
        """Open the files of the path."""
        if self.path.is_file():
            self._add(self.path)
            return
        folder = BagFolder.of(self.path)
        self._metadata = folder.metadata
        self.notes += folder.notes
        self.damage += folder.damage
        for file in folder.files:
            self._add(file)

    def _add(self, file: Path) -> None:
        """Open a file; one of several that can't be read is damage."""
        folder = self._stack.enter_context(temporary_folder("bag"))
        try:
            container = open_file(file, folder, strict=self._strict)
        except Exception as error:  # of a dozen kinds, see `_one_sentence`
            if self.path.is_file() or isinstance(error, PermissionError):
                raise
            self._unread.append(error)
            reason = str(error) if isinstance(error, InputError) else _sentence(error)
            self.damage.append(f"{file.name} skipped: {reason}")
            return
        self._stack.callback(container.close)
        self._containers.append(container)
        self.damage += container.damage


@contextlib.contextmanager
def _one_sentence(path: Path) -> Iterator[None]:
    """Turn whatever reading a damaged bag raises into one sentence.

    The readers and their libraries raise many types of exceptions for invalid input, including
    TypeError. All of them are caught here, and only here.
    """
    try:
        yield
    except (InputError, PermissionError):
        raise
    except Exception as error:
        tool = _REPAIRS.get(path.suffix, "ros2 bag reindex")
        raise InputError(
            f"{path} can't be read as a bag: {_sentence(error)}; if the recording was "
            f"interrupted, try `{tool}`"
        ) from error


def _sentence(error: Exception) -> str:
    """Return the message of an exception as one line."""
    reason = " ".join(str(error).split()).rstrip(".")
    return (
        reason[:300] if " " in reason else f"it is damaged ({type(error).__name__} {reason[:100]})"
    )
