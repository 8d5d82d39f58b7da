"""A clip: received messages in an MCAP file, and a JSON file with the reason."""

from __future__ import annotations

import heapq
import itertools
import os
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from trajeval_ros import __version__
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.install_command import install_command
from trajeval_ros.io.bags.definition_texts import definition_text
from trajeval_ros.io.json_file import json_text
from trajeval_ros.io.temporary import temporary_folder
from trajeval_ros.io.writing import refused_by_disk

SCHEMA = "trajeval-clip/1"
MESSAGES, ABOUT = "clip.mcap", "clip.json"
# In rosbag2's format of offered profiles, so that a player latches the same topics.
_LATCHED = "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n"


class ClipTopic(NamedTuple):
    """Messages of one topic, in order of arrival.

    Attributes:
        name: Of the topic.
        type: Of its messages.
        times: Times of reception, nanoseconds since 1970.
        payloads: The serialised messages.
        is_latched: Whether late subscribers get it.
    """

    name: str
    type: str
    times: Sequence[int]
    payloads: Sequence[bytes]
    is_latched: bool = False


def require_clip_libraries() -> None:
    """Raise at the start if clips can't be written, for example with ROS's packages only.

    Raises:
        InputError: A library is missing.
    """
    missing = [each for each in ("mcap", "rosbags") if find_spec(each) is None]
    if missing:
        raise InputError(
            f"black_box needs a library that is not installed ({' and '.join(missing)}): "
            f"{install_command(*missing)}"
        )


def write_clip(path: Path, topics: Sequence[ClipTopic], about: Mapping[str, Any]) -> None:
    """Write a folder with `clip.mcap` and `clip.json`, completely or not at all.

    Args:
        path: The folder; its parent exists.
        topics: The topics. A topic without a definition of its type is left out and named in the
            JSON file.
        about: Contents of the JSON file in addition to the topics.

    Raises:
        InputError: The disk is full.
    """
    texts = {each: definition_text(each) for each in {topic.type for topic in topics}}
    known = [each for each in topics if texts[each.type] is not None]
    listed = {
        each.name: {
            "type": each.type,
            "messages": len(each.times),
            "first_ns": min(each.times),
            "last_ns": max(each.times),
        }
        for each in known
        if each.times
    }
    left_out = [
        f"{each.name} dropped: no installed package defines {each.type}"
        for each in topics
        if texts[each.type] is None
    ]
    text = json_text(
        {"schema": SCHEMA, "version": __version__, **about, "topics": listed,
         "left_out": left_out},
        indent=2,
    )  # fmt: skip
    with refused_by_disk(str(path)), temporary_folder(path.name, path.parent) as folder:
        complete = folder / path.name
        complete.mkdir()
        _write_messages(complete / MESSAGES, known, texts)
        with (complete / ABOUT).open("w", encoding="utf-8") as file:
            file.write(text)
            os.fsync(file.fileno())
        complete.rename(path)


def _write_messages(
    path: Path, topics: Sequence[ClipTopic], texts: Mapping[str, str | None]
) -> None:
    """Write all messages, merged by time of reception."""
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", f"trajeval_ros {__version__}")
        schemas = {
            name: writer.register_schema(name, "ros2msg", (texts[name] or "").encode())
            for name in sorted({each.type for each in topics})
        }
        channels = []
        for each in topics:
            qos = {"offered_qos_profiles": _LATCHED if each.is_latched else ""}
            channels.append(writer.register_channel(each.name, "cdr", schemas[each.type], qos))
        rows = (
            zip(each.times, itertools.repeat(channel), itertools.count(), each.payloads)
            for channel, each in zip(channels, topics, strict=True)
        )
        for time, channel, number, payload in heapq.merge(*rows):
            writer.add_message(channel, time, payload, time, number)
        writer.finish()  # type: ignore[no-untyped-call]
        file.flush()
        os.fsync(file.fileno())
