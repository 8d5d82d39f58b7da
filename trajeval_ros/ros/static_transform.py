"""The constant pose of one frame in another, from `/tf_static`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.io.bags.pose_messages import TRANSFORM_TYPES, decode_transforms
from trajeval_ros.io.bags.transform_tree import Edge, EdgeKey, fixed_transform
from trajeval_ros.ros.message_types import is_installed
from trajeval_ros.ros.subscriptions import TopicInput

if TYPE_CHECKING:
    from rclpy.node import Node

_MOST_EDGES = 10_000


class StaticTransform:
    """Looks up the transform between two frames.

    Attributes:
        source: The source in the notation of the user.
        trouble: Why the transform is not known yet; empty when it is.
    """

    def __init__(self, node: Node, source: str) -> None:
        """Subscribe.

        Args:
            node: The subscribing node.
            source: `/tf_static:BODY.MARKER`.

        Raises:
            SettingsError: The source does not name two frames, or transforms can't be received.
        """
        topic, _, frames = source.partition(":")
        self._body, dot, self._marker = (each.strip("/ ") for each in frames.partition("."))
        if not (self._body and dot and self._marker):
            raise SettingsError(
                f"hand_eye {source!r} has no pair of frames; write body and marker frame as in "
                "/tf_static:base_link.marker"
            )
        if not is_installed(TRANSFORM_TYPES[0]):
            raise SettingsError(
                f"hand_eye {source} needs tf2_msgs; install ros-$ROS_DISTRO-tf2-msgs, or give a "
                "file"
            )
        self.source = source
        self.trouble = f"{source}: no static transform received so far"
        self._input = TopicInput(node, topic, TRANSFORM_TYPES[:1], is_static=True)
        self._edges: dict[EdgeKey, Edge] = {}

    def match(self) -> str:
        """Connect to the present publishers; return a sentence for the log."""
        return self._input.match()

    def leave(self) -> None:
        """Unsubscribe."""
        self._input.leave()

    def take(self) -> HandEye | None:
        """Process new transforms; return the marker's pose in the body, None if not known yet."""
        payloads = self._input.take().payloads
        if not payloads:
            return None
        for key, columns in decode_transforms(payloads)[0].items():
            if key in self._edges or len(self._edges) < _MOST_EDGES:
                edge = Edge.from_columns(columns.stamps, columns.numbers, True)
                if len(edge.stamps):
                    self._edges[key] = edge
        try:
            lever_m, quaternion = fixed_transform(
                self._edges, self._body, self._marker, self.source.partition(":")[0]
            )
        except InputError as error:
            self.trouble = str(error)
            return None
        self.trouble = ""
        return HandEye(quaternion, lever_m, self._body, self._marker)
