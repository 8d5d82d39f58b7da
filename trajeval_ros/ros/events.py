"""The topic `~/event`: single events, stored for late subscribers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trajeval_ros.online.notices import Notice
from trajeval_ros.ros.advertise import advertise
from trajeval_ros.ros.status_message import status_message

if TYPE_CHECKING:
    from rclpy.node import Node

_KEPT = 100  # events for late subscribers


class EventTopic:
    """Publishes notices as `diagnostic_msgs/DiagnosticStatus`: text, level, and named values."""

    def __init__(self, node: Node) -> None:
        """Create the publisher."""
        from diagnostic_msgs.msg import DiagnosticStatus

        self._node = node
        self._publisher = advertise(node, DiagnosticStatus, "~/event", _KEPT, latched=True)

    def publish(self, about: str, notice: Notice) -> None:
        """Publish a notice about an estimate or the groundtruth, by its name."""
        values = {
            "time_ns": self._node.get_clock().now().nanoseconds,
            "kind": notice.kind,
            "subject": notice.subject or None,
            **notice.values,
        }
        name = f"{self._node.get_fully_qualified_name()}: {about}"
        self._publisher.publish(status_message(notice.level, name, notice.text, values))
