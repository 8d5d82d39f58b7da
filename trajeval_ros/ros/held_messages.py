"""What arrives before the clocks are known, to be evaluated later, in the same order."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.trajectory import NANOSECONDS

# A minute at 1 kHz on either side, and as much again; stamps may stand still.
_MOST_STATES = 250_000


class HeldMessages:
    """Calls that wait, and the time that their states span.

    Attributes:
        calls: In order of arrival.
    """

    def __init__(self) -> None:
        """Begin empty."""
        self.calls: list[Callable[[], None]] = []
        self._spans: dict[str, tuple[int, int]] = {}
        self._states = 0

    def add(self, side: str, stamps: NDArray[np.int64], call: Callable[[], None]) -> None:
        """Hold a call that is about states of a side, stamps (N,) with N > 0."""
        self.calls.append(call)
        self._states += len(stamps)
        first, last = int(stamps.min()), int(stamps.max())
        earliest, latest = self._spans.get(side, (first, last))
        self._spans[side] = min(first, earliest), max(last, latest)

    @property
    def span_s(self) -> float:
        """Time from a side's first state to its last, of the side that has more of it, seconds.

        Not of both together: their clocks may differ by years. It is infinite once more states
        wait than should.
        """
        if self._states > _MOST_STATES:
            return math.inf
        return max((last - first for first, last in self._spans.values()), default=0) / NANOSECONDS
