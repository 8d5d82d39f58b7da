"""Bags as containers: rosbag2 (sqlite3 and MCAP, directory or bare file) and ROS 1.

The containers are read by the low-level readers of `rosbags`. A bag is untrusted input: a topic's
type definition is parsed only when that topic is wanted, so that one odd topic doesn't lose the
bag, and whatever a damaged file raises becomes one sentence.
"""

from __future__ import annotations

import contextlib
import heapq
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.checks import nearest
from trajeval_ros.io.containers import first_and_last, open_file, refuse_unfinished, storages
from trajeval_ros.io.messages import POSE_TYPES, TRANSFORM_TYPES, Decode

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

Advance = Callable[[int, int], None]

_ADVANCE_EVERY = 1000  # messages
_LARGEST_METADATA = 16 << 20  # bytes; real ones have some kB


@dataclass(frozen=True)
class Topic:
    """A topic of a bag: its name, the type of its messages and their number."""

    name: str
    type: str
    count: int
    connections: tuple[Connection, ...] = field(repr=False, default=())

    @property
    def holds_poses(self) -> bool:
        """Whether its messages are poses."""
        return self.type in POSE_TYPES

    @property
    def holds_transforms(self) -> bool:
        """Whether its messages are TF."""
        return self.type in TRANSFORM_TYPES


class Bag:
    """A bag that is open; a context manager.

    Attributes:
        path: The file or directory.
        topics: Its topics by name; a name with several types is one topic per type.
        notes: What had to be worked around.
    """

    def __init__(self, path: Path, advance: Advance | None = None) -> None:
        """Open the bag.

        Raises:
            InputError: It is no bag, or a damaged one.
        """
        self.path = path
        self.notes: list[str] = []
        self._advance = advance
        with _one_sentence(path):
            self._readers = self._open()
            self.topics = sorted(self._list_topics(), key=lambda topic: topic.name)

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        for reader in self._readers:
            reader.close()

    @property
    def span(self) -> tuple[int, int]:
        """The first and the last log time of all messages, ns.

        Raises:
            InputError: There is no message.
        """
        files = [each for reader in self._readers for each in storages(reader)]
        spans = [each for each in map(first_and_last, files) if each[0] <= each[1]]
        if not spans:
            raise InputError(f"{self.path} is an empty bag: it has no messages")
        return min(first for first, _ in spans), max(last for _, last in spans)

    def messages(
        self, topics: Sequence[Topic], begin: int | None = None, end: int | None = None
    ) -> Iterator[tuple[Topic, int, bytes]]:
        """Yield topic, log time in ns and payload of the messages, in order of their log times.

        Args:
            topics: Those wanted.
            begin: The first log time wanted, ns.
            end: The first log time that isn't wanted any more, ns.

        Raises:
            InputError: The bag is damaged, or its index hides all messages.
        """
        done = 0
        with _one_sentence(self.path):
            streams = [self._stream(reader, topics, begin, end) for reader in self._readers]
            for message in heapq.merge(*streams, key=_log_time):
                yield message
                done += 1
        total = sum(topic.count for topic in topics)
        if done >= total or begin is not None or end is not None:
            return
        names = ", ".join(topic.name for topic in topics)
        problem = (
            f"{self.path} counts {total} messages on {names}, but {done} can be reached; "
            "`mcap recover` or `ros2 bag reindex` mends that"
        )
        if not done:
            raise InputError(problem)
        self.notes.append(problem)

    def payloads(self, topics: list[Topic]) -> Iterator[bytes]:
        """Yield the serialised messages of some topics, in order of their log times.

        Raises:
            InputError: The bag is damaged, or its index hides all messages.
        """
        total = sum(topic.count for topic in topics)
        done = 0
        for _, _, payload in self.messages(topics):
            yield payload
            done += 1
            if self._advance is not None and done % _ADVANCE_EVERY == 0:
                self._advance(done, total)
        if self._advance is not None:
            self._advance(done, total)

    def decoder(self, topic: Topic) -> Decode:
        """Return what makes a message of a payload, by the definition that the bag holds."""
        from rosbags.rosbag1 import Reader as Ros1Reader
        from rosbags.typesys import Stores, get_typestore

        connection = topic.connections[0]
        is_ros1 = isinstance(connection.owner, Ros1Reader)
        store = get_typestore(Stores.EMPTY)
        try:
            store.register(definitions(connection))
            store.get_msgdef(topic.type)
        except Exception:  # rosbags raises half a dozen kinds; the usual definition is as good
            store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
        deserialize = store.deserialize_ros1 if is_ros1 else store.deserialize_cdr
        return lambda payload: deserialize(payload, topic.type)

    def find(self, name: str) -> list[Topic]:
        """Return the topics of that name, one per type.

        Raises:
            InputError: There is none.
        """
        found = [topic for topic in self.topics if topic.name == name]
        if found:
            return found
        names = {topic.name for topic in self.topics}
        raise InputError(f"{self.path} has no topic {name}; it has {nearest(name, names)}")

    @staticmethod
    def _stream(
        reader: Any, topics: Sequence[Topic], begin: int | None, end: int | None
    ) -> Iterator[tuple[Topic, int, bytes]]:
        """Yield the messages that one reader has of the topics."""
        owned = [(each, topic) for topic in topics for each in topic.connections]
        wanted = {each.id: (each, topic) for each, topic in owned if each.owner is reader}
        if not wanted:  # asked for no connections, a reader yields all
            return
        connections = [connection for connection, _ in wanted.values()]
        for connection, log_time, payload in reader.messages(connections, begin, end):
            yield wanted[connection.id][1], log_time, payload

    def _list_topics(self) -> Iterator[Topic]:
        """Yield the topics of all readers, with the connections of the same name and type."""
        by_name: dict[tuple[str, str], list[Connection]] = {}
        for reader in self._readers:
            for connection in reader.connections:
                name = "/" + connection.topic.lstrip("/")  # ROS 1 records names without slash, too
                by_name.setdefault((name, connection.msgtype), []).append(connection)
        for (name, message_type), connections in by_name.items():
            count = sum(connection.msgcount for connection in connections)
            yield Topic(name, message_type, count, tuple(connections))

    def _open(self) -> list[Any]:
        """Return the open readers of the path."""
        if self.path.is_file():
            return [open_file(self.path)]
        metadata = self.path / "metadata.yaml"
        files = sorted(
            (file for ending in ("*.mcap", "*.db3") for file in self.path.glob(ending)),
            key=lambda file: [int(part) if part.isdigit() else part for part in _split(file.name)],
        )
        for file in files:
            refuse_unfinished(file)
        if not files and not metadata.exists():
            raise InputError(
                f"{self.path} is a directory without a bag: it holds no metadata.yaml, *.mcap or "
                "*.db3"
            )
        if metadata.exists():
            if metadata.stat().st_size > _LARGEST_METADATA:
                raise InputError(f"{metadata} is larger than {_LARGEST_METADATA} bytes")
            from rosbags.rosbag2 import Reader

            reader = Reader(self.path)
            try:
                reader.open()
            except Exception as error:
                if not files:
                    raise
                self.notes.append(f"{metadata} was not used: {_sentence(error)}")
            else:
                return [reader.storage]
        with contextlib.ExitStack() as stack:
            readers = []
            for file in files:
                readers.append(open_file(file))
                stack.callback(readers[-1].close)
            stack.pop_all()
        return readers


def _log_time(message: tuple[Topic, int, bytes]) -> int:
    return message[1]


def definitions(connection: Connection) -> Any:
    """Return the types that a connection's own definition holds."""
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    text = connection.msgdef.data
    if connection.msgdef.format == MessageDefinitionFormat.MSG:
        return get_types_from_msg(text, connection.msgtype)
    types: Any = {}
    for part in re.split("=" * 80 + r"\nIDL: .*\n", text):
        if part.strip():
            types.update(get_types_from_idl(part))
    return types


def _split(name: str) -> list[str]:
    """Return a name in parts that sort as people count: `bag_2` before `bag_10`."""
    return re.split(r"(\d+)", name)


@contextlib.contextmanager
def _one_sentence(path: Path) -> Iterator[None]:
    """Turn whatever reading a damaged bag raises into one sentence.

    The readers and what they stand on raise a dozen kinds of exceptions for bad input, from their
    own to bare TypeError, so that every kind is caught here, and only here.
    """
    try:
        yield
    except (InputError, PermissionError):
        raise
    except Exception as error:
        raise InputError(
            f"{path} can't be read as a bag: {_sentence(error)}; if its recording was cut short, "
            "`mcap recover`, `ros2 bag reindex` or `rosbag reindex` may save it"
        ) from error


def _sentence(error: Exception) -> str:
    """Return what an exception says, on one line."""
    said = " ".join(str(error).split()).rstrip(".")
    return said[:300] if " " in said else f"it is damaged ({type(error).__name__} {said[:100]})"
