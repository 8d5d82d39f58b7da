"""A recording of errors as another program reads it: by the schemas that are in the file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.records import Channel, Schema
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from trajeval_ros.geometry.trajectory import NANOSECONDS


@dataclass
class Recorded:
    """The messages of a topic.

    Attributes:
        type: Their type.
        times: When each was logged, nanoseconds.
        payloads: As they are in the file.
        messages: Decoded.
    """

    type: str
    times: list[int]
    payloads: list[bytes]
    messages: list[Any]

    @property
    def stamps(self) -> list[int]:
        return [
            message.header.stamp.sec * NANOSECONDS + message.header.stamp.nanosec
            for message in self.messages
        ]

    @property
    def vectors(self) -> np.ndarray[Any, Any]:
        return np.array([[m.vector.x, m.vector.y, m.vector.z] for m in self.messages])

    @property
    def numbers(self) -> np.ndarray[Any, Any]:
        return np.array([message.data for message in self.messages])


def read_recording(path: Path) -> dict[str, Recorded]:
    """Return what is on each topic; topics without a message have none."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        stores = {number: _store(schema) for number, schema in summary.schemas.items()}
        topics: dict[str, Recorded] = {}
        for channel in summary.channels.values():
            assert channel.message_encoding == "cdr"
            kind = summary.schemas[channel.schema_id].name
            topics[channel.topic] = Recorded(kind, [], [], [])
        for schema, channel, message in reader.iter_messages():
            assert isinstance(channel, Channel)
            assert schema is not None
            topic = topics[channel.topic]
            topic.times.append(message.log_time)
            topic.payloads.append(message.data)
            store = stores[schema.id]
            topic.messages.append(store.deserialize_cdr(message.data, schema.name))
    return topics


def _store(schema: Schema) -> Typestore:
    assert schema.encoding == "ros2msg"
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema.data.decode(), schema.name))
    return store
