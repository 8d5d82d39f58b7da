"""Quality of service that is compatible with all publishers of a topic."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

# Queue of a subscription, in messages. If it is full, messages are lost even with reliable
# delivery. It holds 20 s of groundtruth at 1 kHz. On a machine with five busy processes per core,
# the node reads its subscriptions up to 4 s late. Only waiting messages take memory.
DEPTH = 20_000


def matching(publishers: Sequence[Any], *, is_static: bool = False) -> Any:
    """Return the strictest profile that all publishers offer.

    A subscription that requests more than a publisher offers does not connect, and there is no
    error. Therefore it is reliable only if all publishers are, and latched (transient local) only
    if all are. Static transforms are usually published before the subscription, so it is latched
    if any publisher is.

    Args:
        publishers: Endpoints from the ROS graph; at least one.
        is_static: Whether they publish static transforms.
    """
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    offered = [each.qos_profile for each in publishers]
    reliable = all(each.reliability == ReliabilityPolicy.RELIABLE for each in offered)
    enough = any if is_static else all
    latched = enough(each.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in offered)
    return QoSProfile(
        depth=DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def is_same(one: Any, other: Any) -> bool:
    """Return whether two profiles of `matching` are equal."""
    return bool(one.reliability == other.reliability and one.durability == other.durability)
