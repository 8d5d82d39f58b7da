"""One side of the comparison on the network: a topic, or transforms, and how to read them."""

from __future__ import annotations

import re
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.io.bags.pose_messages import PATH_TYPE, POSE_TYPES, TRANSFORM_TYPES
from trajeval_ros.online.notices import OK, WARN, Notice
from trajeval_ros.ros.message_types import is_installed
from trajeval_ros.ros.poses import PoseStream
from trajeval_ros.ros.subscriptions import ReceivedMessages, TopicInput
from trajeval_ros.ros.transform_stream import TransformStream

if TYPE_CHECKING:
    from rclpy.node import Node

_POINT_TYPE = "geometry_msgs/msg/PointStamped"


class Side:
    """Where the poses of groundtruth or of an estimate come from.

    Attributes:
        source: What the user named, with topics as they are after remapping.
        name: The same, fit for a part of a topic's or a file's name.
        stream: Decodes the messages.
    """

    def __init__(self, node: Node, source: str, *, is_groundtruth: bool) -> None:
        """Begin to look for publishers.

        Args:
            node: Subscribes.
            source: A topic, or TOPIC:PARENT.CHILD of transforms.
            is_groundtruth: Then it may be positions alone, but no path.

        Raises:
            SettingsError: The source is neither, or transforms can't be received.
        """
        topic, colon, frames = source.partition(":")
        try:
            self.source = node.resolve_topic_name(topic) + colon + frames
        except Exception as error:  # of several kinds, without a base of their own
            said = " ".join(str(error).split())
            raise SettingsError(f"{topic!r} is no name of a topic: {said}") from error
        self.name = re.sub(r"\W+", "_", self.source.strip("/"), flags=re.ASCII)
        self.name = f"topic_{self.name}" if self.name[:1].isdigit() else self.name
        self.stream: PoseStream
        if colon:
            self.stream = self._transforms(frames)
            types = TRANSFORM_TYPES[:1]
            # As offline: what is static may be known to all robots, what moves to one of them.
            static = {
                node.resolve_topic_name(each): TopicInput(node, each, types, is_static=True)
                for each in (f"{topic}_static", "/tf_static")
            }
            self.inputs = [TopicInput(node, topic, types), *static.values()]
        else:
            self.stream = PoseStream(self.source)
            other = _POINT_TYPE if not is_groundtruth else PATH_TYPE
            readable = [each for each in POSE_TYPES if each != other]
            self.inputs = [TopicInput(node, topic, readable)]

    def match(self) -> list[Notice]:
        """Connect to the publishers that there are now; returns what to tell."""
        told = [
            Notice("publishers", OK if said.startswith("subscribed") else WARN, said)
            for said in filter(None, (each.match() for each in self.inputs))
        ]
        if isinstance(self.stream, TransformStream):
            self.stream.tell_trouble()
        news, self.stream.news = self.stream.news, []
        return [*told, *news]

    def take(self, now_ns: int | None) -> list[tuple[str, ReceivedMessages, NDArray[np.int64]]]:
        """Return type, messages and their times of arrival, by input.

        Args:
            now_ns: The simulated time; None to use the times when messages were received.
        """
        found = []
        for each in self.inputs:
            taken = each.take()
            if isinstance(self.stream, TransformStream) and each.is_static:
                self.stream.hold(taken.payloads)
            elif taken.payloads:
                arrived = np.array(taken.received, dtype=np.int64)
                if now_ns is not None:
                    arrived[:] = now_ns
                found.append((each.type, taken, arrived))
        return found

    def leave(self) -> None:
        """Subscribe no more."""
        for each in self.inputs:
            each.leave()

    @property
    def silent_s(self) -> float | None:
        """Time since the last message with poses, seconds; None before the first."""
        heard_at = self.stream.heard_at
        return None if heard_at is None else time.monotonic() - heard_at

    @property
    def lost(self) -> int:
        """Messages that were published and never arrived."""
        return sum(each.losses.count for each in self.inputs)

    @property
    def loss_is_exact(self) -> bool:
        """Whether all losses could be seen."""
        return all(each.losses.is_exact for each in self.inputs)

    def _transforms(self, frames: str) -> TransformStream:
        parent, dot, child = (each.strip("/ ") for each in frames.partition("."))
        if not (parent and dot and child) or parent == child:
            raise SettingsError(
                f"{self.source!r} names no two frames; write it as in /tf:map.base_link"
            )
        if not is_installed(TRANSFORM_TYPES[0]):
            raise SettingsError(
                f"{self.source} needs tf2_msgs, which is not installed here; install "
                "ros-$ROS_DISTRO-tf2-msgs, or name a topic with poses"
            )
        return TransformStream(self.source, parent, child)


def told_apart(sides: list[Side]) -> None:
    """Check that no two estimates have the same name.

    Raises:
        SettingsError: Two have.
    """
    names: dict[str, Any] = {}
    for each in sides:
        if each.name in names:
            raise SettingsError(
                f"estimates {names[each.name]} and {each.source} would both be called "
                f"{each.name}; name each topic once"
            )
        names[each.name] = each.source
