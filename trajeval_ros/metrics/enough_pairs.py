"""The least number of pairs that a meaningful absolute error needs."""

from __future__ import annotations

from trajeval_ros.geometry.gauge import Gauge


def enough_pairs(gauge: Gauge, align_states: int | None) -> int:
    """Return twice the number of pairs that determine the alignment.

    With the minimal number, the alignment fits all errors exactly. With twice as many, at least
    half of the errors remain. An alignment by the first state uses its orientation, too.
    """
    return 2 * (1 if align_states == 1 else gauge.minimum_states)
