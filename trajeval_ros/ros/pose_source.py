"""The source of the poses of groundtruth or of an estimate: a topic or transforms."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.formatting.escaping import part_of_topic
from trajeval_ros.formatting.remarks import Level, Remark, warning
from trajeval_ros.io.bags.pose_messages import FIX_TYPE, PATH_TYPE, POSE_TYPES, TRANSFORM_TYPES
from trajeval_ros.io.bags.px4_messages import GPS, LOCAL_POSITION, PX4_POSE_TYPES
from trajeval_ros.ros.live_fixes import LiveFixes
from trajeval_ros.ros.message_types import require_installed
from trajeval_ros.ros.poses import PoseStream
from trajeval_ros.ros.subscriptions import ReceivedMessages, TopicInput
from trajeval_ros.ros.transform_stream import TransformStream

if TYPE_CHECKING:
    from rclpy.node import Node

# From receive times to simulated times.
TimeAt = Callable[[NDArray[np.int64]], NDArray[np.int64]]
_POINT_TYPE = "geometry_msgs/msg/PointStamped"


class PoseSource:
    """The source of the poses of groundtruth or of an estimate, over all runs.

    The source is a topic, or TOPIC:PARENT.CHILD of transforms. Groundtruth has rules for GNSS
    `fixes`. It may have positions only, and is no path.
    """

    def __init__(self, node: Node, source: str, fixes: LiveFixes | None = None) -> None:
        topic, colon, frames = source.partition(":")
        try:
            self.source = node.resolve_topic_name(topic) + colon + frames  # after remapping
        except Exception as error:  # rclpy's exceptions here have no common base class
            reason = " ".join(str(error).split())
            raise SettingsError(f"{topic!r} is not a topic name: {reason}") from error
        self.name = part_of_topic(self.source)  # in topics and files; see `name_apart`
        self._waits_since = time.monotonic()
        self.stream: PoseStream  # decodes the messages
        if colon:
            self.stream = self._transforms(frames)
            types = TRANSFORM_TYPES[:1]
            # As for recordings: /tf_static may be common to all robots, /tf may have a namespace.
            static = {
                node.resolve_topic_name(item): TopicInput(node, item, types, is_static=True)
                for item in (f"{topic}_static", "/tf_static")
            }
            self.inputs = [TopicInput(node, topic, types), *static.values()]
        else:
            self.stream = PoseStream(self.source, covariances=fixes is None, fixes=fixes)
            points = (_POINT_TYPE, FIX_TYPE, LOCAL_POSITION, GPS)
            others = points if fixes is None else (PATH_TYPE,)
            readable = [
                pose_type
                for pose_type in (*POSE_TYPES, *PX4_POSE_TYPES)
                if pose_type not in others
            ]
            self.inputs = [TopicInput(node, topic, readable)]

    def match(self) -> list[Remark]:
        """Connect to the present publishers; return remarks."""
        remarks = [about_publishers(text) for item in self.inputs if (text := item.match())]
        topic = self.inputs[0]
        if topic.senders.restarted() and not isinstance(self.stream, TransformStream):
            remarks.append(warning("restart", f"{self.source}: its publisher was restarted"))
        if len(topic.publishers) < 2:
            topic.senders.reset()
        if isinstance(self.stream, TransformStream):
            self.stream.tell_trouble()
        if self.mixed:
            self.stream.status.note(warning("mixed_publishers", self.mixed))
        news, self.stream.news = self.stream.news, []
        return [*remarks, *news]

    def take(
        self, time_at: TimeAt | None
    ) -> list[tuple[str, ReceivedMessages, NDArray[np.int64]]]:
        """Return type, messages and their times of arrival, by input."""
        messages = []
        for item in self.inputs:
            taken = item.take()
            if isinstance(self.stream, TransformStream) and item.is_static:
                self.stream.hold(taken.payloads)
            elif taken.payloads:
                arrived = np.array(taken.received, dtype=np.int64)
                if time_at is not None:
                    arrived = time_at(arrived)
                messages.append((item.type, taken, arrived))
        return messages

    def discard(self) -> None:
        """Drop the messages that have arrived, except static transforms."""
        if any(taken.payloads for _, taken, _ in self.take(None)):
            self.stream.heard_at = time.monotonic()

    @property
    def silent_s(self) -> float | None:
        """Time since the last message with poses, seconds; None before the first."""
        heard_at = self.stream.heard_at
        return None if heard_at is None else time.monotonic() - heard_at

    @property
    def waits_s(self) -> float:
        """Time since this source was created, seconds."""
        return time.monotonic() - self._waits_since

    @property
    def lost(self) -> int:
        """Number of published messages that did not arrive."""
        return sum(item.losses.count for item in self.inputs)

    @property
    def loss_is_exact(self) -> bool:
        """Whether all losses could be detected."""
        return all(item.losses.is_exact for item in self.inputs)

    @property
    def mixed(self) -> str:
        """The sentence about alternating publishers of the topic; empty if there is one.

        Transforms of one topic usually have several publishers.
        """
        topic = self.inputs[0]
        count = len(topic.publishers)
        if isinstance(self.stream, TransformStream) or count < 2 or not topic.are_named:
            return ""
        if not topic.senders.alternate:
            return ""
        return (
            f"{self.source}: messages of {count} publishers are mixed "
            f"({', '.join(topic.publishers)}); publish every trajectory on its own topic"
        )

    def _transforms(self, frames: str) -> TransformStream:
        parent, dot, child = (item.strip("/ ") for item in frames.partition("."))
        if not (parent and dot and child) or parent == child:
            raise SettingsError(
                f"{self.source!r} has no pair of frames; write it as in /tf:map.base_link"
            )
        require_installed(TRANSFORM_TYPES[0], self.source, "give a topic with poses")
        return TransformStream(self.source, parent, child)


def about_publishers(text: str) -> Remark:
    """Return the remark of a sentence of `TopicInput.match`."""
    level = Level.NOTE if text.startswith("subscribed") else Level.WARNING
    return Remark(level, "publishers", text)


def name_apart(sources: list[PoseSource], namespace: str) -> None:
    """Name estimates by their topics, without the node's own namespace."""
    inside = f"{namespace.rstrip('/')}/"
    short = [part_of_topic(source.source.removeprefix(inside)) for source in sources]
    if len(set(short)) == len(sources):
        for source, name in zip(sources, short, strict=True):
            source.name = name
    topics = [source.source for source in sources]
    if repeated := [topic for topic in topics if topics.count(topic) > 1]:
        raise SettingsError(f"{repeated[0]} is given twice as an estimate; remove one")
    names: set[str] = set()
    for source in sources:  # /a/b and /a_b have the same name
        name, number = source.name, 2
        while source.name in names:
            source.name, number = f"{name}_{number}", number + 1
        names.add(source.name)
