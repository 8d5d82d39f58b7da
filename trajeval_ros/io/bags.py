"""Bags as containers: rosbag2 (sqlite3 and MCAP, directory or bare file) and ROS 1.

The containers are read by the low-level readers of `rosbags`. A bag is untrusted input: a topic's
type definition is parsed only when that topic is wanted, so that one odd topic doesn't lose the
bag, and whatever a damaged file raises becomes one sentence.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.checks import nearest
from trajeval_ros.io.messages import POSE_TYPES, TRANSFORM_TYPES, Decode

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

Advance = Callable[[int, int], None]

_ADVANCE_EVERY = 1000  # messages
_LARGEST_METADATA = 16 << 20  # bytes; real ones have some kB
_MCAP, _SQLITE, _ROS1, _ZSTD = b"\x89MCAP0\r\n", b"SQLite format 3\0", b"#ROSBAG V", b"(\xb5/\xfd"


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

    def payloads(self, topics: list[Topic]) -> Iterator[bytes]:
        """Yield the serialised messages of some topics, in the order of the bag.

        Raises:
            InputError: The bag is damaged, or its index hides messages.
        """
        total = sum(topic.count for topic in topics)
        done = 0
        with _one_sentence(self.path):
            for reader in self._readers:
                wanted = [
                    connection
                    for topic in topics
                    for connection in topic.connections
                    if connection.owner is reader
                ]
                if not wanted:
                    continue
                for _, _, payload in reader.messages(wanted):
                    yield payload
                    done += 1
                    if self._advance is not None and done % _ADVANCE_EVERY == 0:
                        self._advance(done, total)
        if self._advance is not None:
            self._advance(done, total)
        if done >= total:
            return
        problem = (
            f"{self.path} counts {total} messages on {topics[0].name}, but {done} can be reached; "
            "`mcap recover` or `ros2 bag reindex` mends that"
        )
        if not done:
            raise InputError(problem)
        self.notes.append(problem)

    def decoder(self, topic: Topic) -> Decode:
        """Return what makes a message of a payload, by the definition that the bag holds."""
        from rosbags.rosbag1 import Reader as Ros1Reader
        from rosbags.typesys import Stores, get_typestore

        connection = topic.connections[0]
        is_ros1 = isinstance(connection.owner, Ros1Reader)
        store = get_typestore(Stores.EMPTY)
        try:
            store.register(_definitions(connection))
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
            return [_open_file(self.path)]
        metadata = self.path / "metadata.yaml"
        files = sorted(
            (file for ending in ("*.mcap", "*.db3") for file in self.path.glob(ending)),
            key=lambda file: [int(part) if part.isdigit() else part for part in _split(file.name)],
        )
        for file in files:
            _refuse_unfinished(file)
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
                readers.append(_open_file(file))
                stack.callback(readers[-1].close)
            stack.pop_all()
        return readers


def _open_file(path: Path) -> Any:
    """Return the open reader of a single file, chosen by its first bytes."""
    with path.open("rb") as file:
        beginning = file.read(16)
    if not beginning:
        raise InputError(f"{path} is empty; was the recording stopped before it was written?")
    if beginning.startswith(_ZSTD):
        raise InputError(
            f"{path} is compressed as a whole; name its directory if that has a metadata.yaml, or "
            "decompress it with `zstd -d`"
        )
    if beginning.startswith(_ROS1):
        from rosbags.rosbag1 import Reader as Ros1Reader

        reader: Any = Ros1Reader(path)
    elif beginning.startswith(_SQLITE):
        from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

        _refuse_unfinished(path)
        _refuse_truncated(path)
        reader = Sqlite3Reader(path)
    elif beginning.startswith(_MCAP):
        from rosbags.rosbag2.storage_mcap import McapReader

        reader = McapReader(path)
    else:
        raise InputError(f"{path} is no bag: it begins as neither MCAP, sqlite3 nor ROS 1")
    reader.open()
    return reader


def _refuse_unfinished(path: Path) -> None:
    """Raise InputError if messages wait in a write-ahead log, which readers pass over silently."""
    log = path.with_name(f"{path.name}-wal")
    if log.exists() and log.stat().st_size:
        raise InputError(
            f"{path} was not closed: messages wait in {log.name}; merge them with "
            f"`sqlite3 {path} 'PRAGMA wal_checkpoint(TRUNCATE)'`"
        )


def _refuse_truncated(path: Path) -> None:
    """Raise InputError if sqlite's header counts more pages than the file has.

    What sqlite makes of missing pages depends on which they are: often fewer messages, silently.
    """
    with path.open("rb") as file:
        header = file.read(100).ljust(100, b"\0")
    page_size, pages = int.from_bytes(header[16:18], "big"), int.from_bytes(header[28:32], "big")
    page_size = 65536 if page_size == 1 else page_size
    is_valid = header[24:28] == header[92:96]  # older versions of sqlite don't keep the count
    size = path.stat().st_size
    if is_valid and size < pages * page_size:
        raise InputError(
            f"{path} was cut short: it has {size} of {pages * page_size} bytes; copy it again, or "
            f"save what is left with `sqlite3 {path} .recover`"
        )


def _definitions(connection: Connection) -> Any:
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
