"""Messages that arrive before the start of the evaluation; they are evaluated later, in order."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.trajectory import NANOSECONDS

if TYPE_CHECKING:
    from trajeval_ros.ros.live_estimate import LiveEstimate

# The side of messages, and a function that passes them to a segment of an estimate.
HeldCall = tuple[str, Callable[["LiveEstimate"], None]]
# Limit of memory, in case timestamps do not advance: two minutes of both sides at 1 kHz.
_MOST_STATES = 250_000


class HeldMessages:
    """Stored calls, and the time span of their states.

    Attributes:
        calls: Stored calls with their sides, in order of arrival.
    """

    def __init__(self) -> None:
        """Create it empty."""
        self.calls: list[HeldCall] = []
        self._spans: dict[str, tuple[int, int]] = {}
        self._states = 0

    def add(
        self, side: str, stamps: NDArray[np.int64], call: Callable[[LiveEstimate], None]
    ) -> None:
        """Store a call for states of a side, timestamps (N,) with N > 0."""
        self.calls.append((side, call))
        if side == "estimate" and side not in self._spans:
            self._spans.clear()  # the span counts from the first estimate
        self._states += len(stamps)
        first, last = int(stamps.min()), int(stamps.max())
        earliest, latest = self._spans.get(side, (first, last))
        self._spans[side] = min(first, earliest), max(last, latest)

    @property
    def span_s(self) -> float:
        """Time span of a side's states since the first estimate, the longer of both, seconds.

        Zero without an estimate. Sides are measured separately, since their clocks may differ by
        years. Infinite if more states are stored than the limit.
        """
        if self._states > _MOST_STATES:
            return math.inf
        if "estimate" not in self._spans:
            return 0.0
        return max((last - first for first, last in self._spans.values()), default=0) / NANOSECONDS
