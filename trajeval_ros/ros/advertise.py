"""Publishers that cost nothing while they are not used."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rclpy.node import Node


def advertise(node: Node, kind: Any, topic: str, depth: int = 10, *, latched: bool = False) -> Any:
    """Return a publisher without handlers of events.

    rclpy's default handlers, which tell of subscribers that want another quality of service, are
    two entities for each publisher that an executor looks at whenever it spins: of a node with a
    hundred publishers the most of what it does. Such a subscriber is told by its own node.

    Args:
        node: Publishes.
        kind: The class of the messages.
        topic: Its name.
        depth: How many messages may wait.
        latched: Whether subscribers that come late get the newest ones.
    """
    from rclpy.node import PublisherEventCallbacks  # its own module has another name in Humble
    from rclpy.qos import DurabilityPolicy, QoSProfile

    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    return node.create_publisher(
        kind,
        topic,
        QoSProfile(depth=depth, durability=durability),
        event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
    )
