"""Publishers that need no CPU time while they are idle."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rclpy.node import Node


def advertise(node: Node, kind: Any, topic: str, depth: int = 10, *, latched: bool = False) -> Any:
    """Return a publisher without event handlers.

    rclpy's default handlers report subscribers with an incompatible quality of service. They are
    two entities per publisher in the executor's wait set. With a hundred publishers, they take
    most of its CPU time. The node of such a subscriber reports the incompatibility, too.

    Args:
        node: The publishing node.
        kind: Class of the messages.
        topic: Name of the topic.
        depth: Size of the queue, in messages.
        latched: Whether late subscribers receive the newest messages.
    """
    from rclpy.node import PublisherEventCallbacks  # defined elsewhere in Humble
    from rclpy.qos import DurabilityPolicy, QoSProfile

    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    return node.create_publisher(
        kind,
        topic,
        QoSProfile(depth=depth, durability=durability),
        event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
    )
