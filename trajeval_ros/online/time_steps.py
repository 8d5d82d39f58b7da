"""Steps back in time, as when a bag is played in a loop."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from trajeval_ros.geometry.arrays import Stamps
from trajeval_ros.geometry.stamp_trust import NEAR_NS


class TimeSteps:
    """Counts steps of a stream's time back by more than one second.

    Attributes:
        count: Number of steps back so far.
        back_ns: Size of the last one, nanoseconds.
    """

    def __init__(self) -> None:
        """Create it before the first state."""
        self.count = self.back_ns = 0
        self._newest: int | None = None

    def parts(self, stamps: Stamps) -> Iterator[slice]:
        """Yield the parts of states (N,) between steps back; `count` is valid for the part.

        Args:
            stamps: Trusted timestamps, nanoseconds, in order of arrival.
        """
        if not len(stamps):
            return
        before = stamps[:1] if self._newest is None else np.array([self._newest])
        steps = np.diff(np.concatenate([before, stamps]))
        self._newest = int(stamps[-1])
        begin = 0
        for row in np.flatnonzero(steps < -NEAR_NS).tolist():
            if row > begin:
                yield slice(begin, row)
            self.count, self.back_ns, begin = self.count + 1, -int(steps[row]), row
        yield slice(begin, len(stamps))
