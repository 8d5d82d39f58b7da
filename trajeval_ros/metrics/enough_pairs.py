"""How many pairs an absolute error needs, so that the alignment doesn't take most of it out."""

from __future__ import annotations

from trajeval_ros.geometry.gauge import Gauge


def enough_pairs(gauge: Gauge, align_states: int | None) -> int:
    """Return twice the number of pairs that determine the alignment.

    With as many as it needs, an alignment fits whatever errors there are; with twice as many, half
    of them and more are left. The first state alone is aligned by its orientation, too.
    """
    return 2 * (1 if align_states == 1 else gauge.minimum_states)
