"""Errors of every pair as `geometry_msgs/Vector3Stamped`, under `~/NAME/stamped/`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trajeval_ros.io.bags.encode_messages import encode_vector_stamped
from trajeval_ros.online.error_topics import VECTOR_TYPE, VECTORS, vectors_of
from trajeval_ros.online.pair_errors import PairErrors
from trajeval_ros.ros.advertise import advertise
from trajeval_ros.ros.message_types import message_class

if TYPE_CHECKING:
    from rclpy.node import Node

_QUEUE = 1000  # messages; all messages of a tick are published at once


class StampedErrors:
    """Publishers of one estimate; vectors without a subscriber are not computed."""

    def __init__(self, node: Node, name: str) -> None:
        """Create the publishers."""
        kind = message_class(VECTOR_TYPE)
        self._publishers = {
            topic: advertise(node, kind, f"~/{name}/{topic}", _QUEUE) for topic in VECTORS
        }

    def publish(self, errors: PairErrors, frame: str, offset_ns: int, *, knows_up: bool) -> None:
        """Publish the errors of N pairs.

        Args:
            errors: Errors of the pairs.
            frame: Frame of the groundtruth.
            offset_ns: Clock offset in the timestamps of the pairs; it is subtracted in messages.
            knows_up: Whether the up axis is known; without it, yaw and tilt are not published.
        """
        for topic, publisher in self._publishers.items():
            if not publisher.get_subscription_count():
                continue
            stamps, vectors = vectors_of(errors, topic, offset_ns, knows_up=knows_up)
            for message in encode_vector_stamped(stamps, vectors, frame):
                publisher.publish(message.tobytes())
