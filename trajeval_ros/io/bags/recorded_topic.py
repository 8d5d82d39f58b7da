"""Topics of a bag, and the damage found while reading them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from trajeval_ros.io.bags import foxglove
from trajeval_ros.io.bags.containers import Container
from trajeval_ros.io.bags.pose_2d import POSE_2D
from trajeval_ros.io.bags.pose_messages import FIX_TYPE, POSE_TYPES, TRANSFORM_TYPES

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

_ENCODINGS = ("cdr", "ros1")


@dataclass(frozen=True, eq=False)
class Topic:
    """A topic of a bag.

    Attributes:
        name: With a slash before it.
        type: Of its messages.
        declared: The number of messages according to the bag, None if unknown.
        connections: Its connections in the files of the bag.
    """

    name: str
    type: str
    declared: int | None
    connections: tuple[Connection, ...] = field(repr=False, default=())

    @property
    def count(self) -> int:
        """The number of its messages, counted if the bag does not declare it."""
        if self.declared is not None:
            return self.declared
        return sum(each.owner.count(each.id) for each in self.connections)  # type: ignore[attr-defined]

    @property
    def expected(self) -> int:
        """An estimate of the number of messages for reserving memory, without counting them."""
        if self.declared is not None:
            return self.declared
        return sum(each.owner.rows for each in self.connections)  # type: ignore[attr-defined]

    @property
    def holds_poses(self) -> bool:
        """Whether its messages are poses."""
        own = (POSE_2D, foxglove.POSE_TYPE, foxglove.FIX_TYPE)
        return self.type in (*POSE_TYPES, *own) and self._is_readable

    @property
    def holds_fixes(self) -> bool:
        """Whether its messages are GNSS fixes."""
        return self.type in (FIX_TYPE, foxglove.FIX_TYPE)

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
            and all(encoding_of(each) in foxglove.ENCODINGS for each in self.connections)
        )

    def connections_in(self, container: Container) -> frozenset[int]:
        """Return the ids of its connections in one file of the bag."""
        return frozenset(each.id for each in self.connections if each.owner is container)

    @property
    def _is_readable(self) -> bool:
        encodings = [encoding_of(each) for each in self.connections]
        if self.type in foxglove.TYPES:
            return all(foxglove.is_decodable(each) for each in encodings)
        return all(each in _ENCODINGS for each in encodings)


@dataclass(eq=False)
class Reading:
    """A topic that is read, and the damage found.

    Attributes:
        topic: The topic.
        count: Number of messages read so far.
        damage: Unreadable parts, one sentence per part; complete after the last message.
        notes: Other information on the reading.
    """

    topic: Topic
    count: int = 0
    damage: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def encoding_of(connection: Connection) -> str:
    """Return the serialisation of a connection's messages, such as `cdr` or `ros1`."""
    return getattr(connection.ext, "serialization_format", "ros1")
