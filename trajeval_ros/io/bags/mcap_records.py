"""Records of MCAP. Our code reads their framing, for damaged files; mcap parses their contents."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Indices
from trajeval_ros.io.bags.byte_source import DamagedError
from trajeval_ros.io.bags.message_definitions import Connection, full_name

if TYPE_CHECKING:
    from mcap.records import Channel, Schema

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX, STATISTICS, DATA_END = (
    0x02, 0x03, 0x04, 0x05, 0x06, 0x07, 0x08, 0x0B, 0x0F,
)  # fmt: skip
HEAD = 9  # bytes of opcode and length
FOOTER_SIZE = HEAD + 20
MESSAGE_HEAD = 22  # bytes of a message before its payload
PUBLISH_TIME = 8  # bytes of the publish time, the last of these
_MOST_DAMAGE = 10  # sentences
_HEAD = struct.Struct("<BQ")
_LANGUAGES = {"ros2msg": "MSG", "ros1msg": "MSG", "ros2idl": "IDL"}
_MESSAGE = struct.Struct("<HIQ")


@dataclass(frozen=True)
class Declared:
    """Contents that a summary declares."""

    counts: Mapping[int, int] = field(default_factory=dict)  # number of messages by channel
    messages: int | None = None  # number of all messages; None if it is unknown
    chunks: frozenset[int] = frozenset()  # offsets


class NoIndexError(DamagedError):
    """A file has no complete index, which the format allows."""

    def __init__(self, declared: Declared) -> None:
        super().__init__("it has no index")
        self.declared = declared


@dataclass(eq=False)
class MessageIndex:
    """Positions of messages in a chunk or in a file."""

    channels: Indices  # (N,) ids
    log_times: Indices  # (N,) ns
    offsets: Indices  # (N,) of their records
    sizes: Indices  # (N,) bytes of their payloads

    def __getitem__(self, rows: Booleans | Indices | slice) -> MessageIndex:
        return MessageIndex(
            self.channels[rows], self.log_times[rows], self.offsets[rows], self.sizes[rows]
        )

    def __len__(self) -> int:
        return len(self.offsets)


class MessageIndexBuilder:
    """Collects messages one by one into a `MessageIndex`."""

    def __init__(self) -> None:
        self.rows: list[tuple[int, int, int, int]] = []

    def add(self, record: bytes | memoryview, place: int, offset: int, length: int) -> None:
        """Add the message whose content starts at a place of `record`."""
        channel, _, log_time = _MESSAGE.unpack_from(record, place)
        self.rows.append((channel, log_time, offset, length - MESSAGE_HEAD))

    def done(self) -> MessageIndex:
        """Return the messages."""
        columns = np.array(self.rows, dtype=np.uint64).reshape(-1, 4).astype(np.int64).T
        return MessageIndex(*columns)


@dataclass
class Registry:
    """The schemas and channels of a file, by their ids."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    damage: list[str] = field(default_factory=list)  # channels with two topics, a sentence each

    def add(self, opcode: int, content: bytes | memoryview) -> None:
        """Add a schema or channel from its record. The first record of an id is used."""
        from mcap.data_stream import ReadDataStream
        from mcap.records import Channel, Schema

        stream = ReadDataStream(io.BytesIO(content))
        try:
            if opcode == SCHEMA:
                schema = Schema.read(stream)
                self.schemas.setdefault(schema.id, schema)
            elif opcode == CHANNEL:
                channel = Channel.read(stream)
                first = self.channels.setdefault(channel.id, channel)
                if channel.topic != first.topic and len(self.damage) < _MOST_DAMAGE:
                    other = channel.topic[:100]
                    self.damage.append(f"{first.topic} is named {other!r} in another record")
        except Exception as error:  # of many types, depending on the damage
            raise DamagedError("a schema or channel is damaged") from error

    def connections(self, counts: dict[int, int], owner: object) -> list[Connection]:
        """Return the channels as connections, with their declared numbers of messages."""
        return [
            _connection(channel, self.schemas.get(channel.schema_id), counts, owner)
            for channel in self.channels.values()
        ]


def records(data: bytes | memoryview) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, offset and length of the content of all complete records in memory."""
    offset = 0
    while offset + HEAD <= len(data):
        opcode, length = _HEAD.unpack_from(data, offset)
        if not opcode > 0 or offset + HEAD + length > len(data):
            return
        yield opcode, offset + HEAD, length
        offset += HEAD + length


def head_of(data: bytes, place: int = 0) -> tuple[int, int]:
    """Return opcode and length of the record at a place."""
    opcode, length = _HEAD.unpack_from(data, place)
    return opcode, length


def _connection(
    channel: Channel, schema: Schema | None, counts: dict[int, int], owner: object
) -> Connection:
    name, language, text = "", "", ""
    if schema is not None:
        name, language = schema.name, _LANGUAGES.get(schema.encoding, "")
        text = schema.data.decode("utf-8", errors="replace") if language else ""
    return Connection(
        channel.id,
        channel.topic,
        full_name(name),
        language if text.strip() else "",
        text,
        counts.get(channel.id, 0),
        channel.message_encoding,
        owner,
        channel.metadata.get("offered_qos_profiles", ""),
    )
