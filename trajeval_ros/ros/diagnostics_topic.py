"""The topic `/diagnostics`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from trajeval_ros.ros.advertise import advertise

if TYPE_CHECKING:
    from rclpy.node import Node


class DiagnosticsTopic:
    """Publishes statuses as `diagnostic_msgs/DiagnosticArray`."""

    def __init__(self, node: Node) -> None:
        """Create the publisher."""
        from diagnostic_msgs.msg import DiagnosticArray

        self._node = node
        self._publisher = advertise(node, DiagnosticArray, "/diagnostics")

    def publish(self, statuses: Sequence[Any]) -> None:
        """Publish statuses (`diagnostic_msgs/DiagnosticStatus`) with the present time."""
        from diagnostic_msgs.msg import DiagnosticArray

        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status += statuses
        self._publisher.publish(message)
