"""Quality of service that every publisher on a topic can connect to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

# Messages that wait between two looks at a subscription. What comes while so many wait is lost,
# however reliable the connection is: this is 20 s of groundtruth at 1 kHz, and on a machine with
# five busy processes per core a look was up to 4 s late. Memory is taken only for what waits.
DEPTH = 20_000


def matching(publishers: Sequence[Any], *, is_static: bool = False) -> Any:
    """Return the strictest profile that all of the publishers offer.

    A request for more than a publisher offers connects to nothing, without an error: reliable
    only if all are reliable, latched (transient local) only if all are. But what is static was
    mostly published before, so that it is latched if any are.

    Args:
        publishers: What the graph says about the endpoints; at least one.
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
    """Return whether two profiles of `matching` ask for the same."""
    return bool(one.reliability == other.reliability and one.durability == other.durability)
