"""The source of one side: a topic or transforms, and its decoder."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.formatting.topic_names import part_of_topic
from trajeval_ros.io.bags.pose_messages import (
    FIX_TYPE,
    PATH_TYPE,
    POSE_TYPES,
    TRANSFORM_TYPES,
)
from trajeval_ros.online.notices import OK, WARN, Notice
from trajeval_ros.ros.live_fixes import LiveFixes
from trajeval_ros.ros.message_types import is_installed
from trajeval_ros.ros.poses import PoseStream
from trajeval_ros.ros.subscriptions import ReceivedMessages, TopicInput
from trajeval_ros.ros.transform_stream import TransformStream

if TYPE_CHECKING:
    from rclpy.node import Node

# From times of reception to simulated times.
TimeAt = Callable[[NDArray[np.int64]], NDArray[np.int64]]
_POINT_TYPE = "geometry_msgs/msg/PointStamped"


class Side:
    """The source of the poses of groundtruth or of an estimate.

    Attributes:
        source: The user's text, with topics after remapping.
        name: The same as a part of topic and file names; see `name_apart`.
        stream: Decodes the messages.
    """

    def __init__(self, node: Node, source: str, fixes: LiveFixes | None = None) -> None:
        """Start to search for publishers.

        Args:
            node: Subscribes.
            source: A topic, or TOPIC:PARENT.CHILD of transforms.
            fixes: For groundtruth, which may have positions only but is no path: selects GNSS
                fixes. None for an estimate.

        Raises:
            SettingsError: The source is invalid, or transforms can't be received.
        """
        topic, colon, frames = source.partition(":")
        try:
            self.source = node.resolve_topic_name(topic) + colon + frames
        except Exception as error:  # rclpy's exceptions here have no common base class
            said = " ".join(str(error).split())
            raise SettingsError(f"{topic!r} is not a topic name: {said}") from error
        self.name = part_of_topic(self.source)
        self.stream: PoseStream
        if colon:
            self.stream = self._transforms(frames)
            types = TRANSFORM_TYPES[:1]
            # As for recordings: /tf_static may be common to all robots, /tf may have a namespace.
            static = {
                node.resolve_topic_name(each): TopicInput(node, each, types, is_static=True)
                for each in (f"{topic}_static", "/tf_static")
            }
            self.inputs = [TopicInput(node, topic, types), *static.values()]
        else:
            self.stream = PoseStream(self.source, covariances=fixes is None, fixes=fixes)
            others = (_POINT_TYPE, FIX_TYPE) if fixes is None else (PATH_TYPE,)
            readable = [each for each in POSE_TYPES if each not in others]
            self.inputs = [TopicInput(node, topic, readable)]

    def match(self) -> list[Notice]:
        """Connect to the present publishers; return notices."""
        told = [
            Notice("publishers", OK if said.startswith("subscribed") else WARN, said)
            for said in filter(None, (each.match() for each in self.inputs))
        ]
        if isinstance(self.stream, TransformStream):
            self.stream.tell_trouble()
        news, self.stream.news = self.stream.news, []
        return [*told, *news]

    def take(
        self, time_at: TimeAt | None
    ) -> list[tuple[str, ReceivedMessages, NDArray[np.int64]]]:
        """Return type, messages and their times of arrival, by input.

        Args:
            time_at: Returns simulated time; None for the times of reception.
        """
        found = []
        for each in self.inputs:
            taken = each.take()
            if isinstance(self.stream, TransformStream) and each.is_static:
                self.stream.hold(taken.payloads)
            elif taken.payloads:
                arrived = np.array(taken.received, dtype=np.int64)
                if time_at is not None:
                    arrived = time_at(arrived)
                found.append((each.type, taken, arrived))
        return found

    def leave(self) -> None:
        """Unsubscribe."""
        for each in self.inputs:
            each.leave()

    @property
    def silent_s(self) -> float | None:
        """Time since the last message with poses, seconds; None before the first."""
        heard_at = self.stream.heard_at
        return None if heard_at is None else time.monotonic() - heard_at

    @property
    def lost(self) -> int:
        """Number of published messages that did not arrive."""
        return sum(each.losses.count for each in self.inputs)

    @property
    def loss_is_exact(self) -> bool:
        """Whether all losses could be detected."""
        return all(each.losses.is_exact for each in self.inputs)

    def _transforms(self, frames: str) -> TransformStream:
        parent, dot, child = (each.strip("/ ") for each in frames.partition("."))
        if not (parent and dot and child) or parent == child:
            raise SettingsError(
                f"{self.source!r} has no pair of frames; write it as in /tf:map.base_link"
            )
        if not is_installed(TRANSFORM_TYPES[0]):
            raise SettingsError(
                f"{self.source} needs tf2_msgs; install ros-$ROS_DISTRO-tf2-msgs, or give a "
                "topic with poses"
            )
        return TransformStream(self.source, parent, child)


def name_apart(sides: list[Side], namespace: str) -> None:
    """Name estimates by their topics, without the node's own namespace.

    Args:
        sides: The estimates.
        namespace: Namespace of the node.

    Raises:
        SettingsError: Two estimates have the same name.
    """
    inside = f"{namespace.rstrip('/')}/"
    short = [part_of_topic(each.source.removeprefix(inside)) for each in sides]
    if len(set(short)) == len(sides):
        for each, name in zip(sides, short, strict=True):
            each.name = name
    names: dict[str, str] = {}
    for each in sides:
        if each.name in names:
            raise SettingsError(
                f"estimates {names[each.name]} and {each.source} have the same name {each.name}; "
                "remove one"
            )
        names[each.name] = each.source
