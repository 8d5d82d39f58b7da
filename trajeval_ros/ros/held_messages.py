"""What arrives before the clocks are known, to be evaluated later, in the same order."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.trajectory import NANOSECONDS

if TYPE_CHECKING:
    from trajeval_ros.ros.live_estimate import LiveEstimate

# The side that messages are of, and what a segment of an estimate is to do with them.
HeldCall = tuple[str, Callable[["LiveEstimate"], None]]
# A minute at 1 kHz on either side, and as much again; stamps may stand still.
_MOST_STATES = 250_000


class HeldMessages:
    """Calls that wait, and the time that their states span.

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
        """Hold a call that is about states of a side, stamps (N,) with N > 0."""
        self.calls.append((side, call))
        if side == "estimate" and side not in self._spans:
            self._spans.clear()  # groundtruth alone decides nothing, however long it comes
        self._states += len(stamps)
        first, last = int(stamps.min()), int(stamps.max())
        earliest, latest = self._spans.get(side, (first, last))
        self._spans[side] = min(first, earliest), max(last, latest)

    @property
    def span_s(self) -> float:
        """Time that a side's states span since the first estimate, the longer of both, seconds.

        Zero while no estimate waits. Not of both together: their clocks may differ by years. It is
        infinite once more states wait than should.
        """
        if self._states > _MOST_STATES:
            return math.inf
        if "estimate" not in self._spans:
            return 0.0
        return max((last - first for first, last in self._spans.values()), default=0) / NANOSECONDS
