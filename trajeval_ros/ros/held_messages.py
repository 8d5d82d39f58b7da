"""Messages that arrive before the start is decided; they are evaluated later in the same order."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.trajectory import NANOSECONDS

if TYPE_CHECKING:
    from trajeval_ros.ros.live_estimate import LiveEstimate

# The side of messages, and how a segment of an estimate takes them.
HeldCall = tuple[str, Callable[["LiveEstimate"], None]]
# Twice a minute at 1 kHz on both sides; a limit, since timestamps may not advance.
_MOST_STATES = 250_000


class HeldMessages:
    """Stored calls, and the time span of their states.

    Attributes:
        calls: With their sides, in order of arrival.
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
            self._spans.clear()  # groundtruth alone is not enough for a decision
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
