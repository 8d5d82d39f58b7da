"""Which stamps of a stream can be trusted: those that others agree with.

A message of a driver that starts, or of a clock that is being set, may be years ahead of all
others. Taken for the time that has been reached, it would spoil all that follows. So a stamp far
from the newest trusted one waits for what comes next:

* another one near it: time has jumped, and both are trusted;
* one near the newest trusted stamp: it stands alone, and is dropped;
* one that goes on beyond it, and another one: the stream is a slow one, and all are trusted.

The order is that of arrival, live as in a bag, so that both drop the same.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Booleans, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS

# Messages that merely overtake each other step back by less.
NEAR_NS = NANOSECONDS
LONE = "lone_stamp"  # the reason by which such states are counted
_OF_A_SLOW_STREAM = 3  # different stamps, each far beyond the one before
_MOST_WAITING = 1000  # with one and the same stamp
_LAST_GAP_NS = 60 * NANOSECONDS  # behind a longer one, what is last has nobody to agree with it


class StampTrust:
    """Passes on the states of a stream whose stamps are trusted, at a constant cost.

    Attributes:
        lone: Number of states dropped so far.
        farthest_ns: How far the farthest of them was from the others.
    """

    def __init__(self) -> None:
        """Create it before the first state, which waits for the second one."""
        self.lone = self.farthest_ns = 0
        self._newest: int | None = None
        self._waiting: tuple[NDArray[Any], ...] = ()

    def take(
        self, stamps: Stamps, *columns: NDArray[Any], at_end: bool = False
    ) -> tuple[NDArray[Any], ...]:
        """Return the states that are trusted by now, in order of arrival.

        Args:
            stamps: (N,) of states that have arrived, nanoseconds.
            columns: What else there is of them, N rows each.
            at_end: No more will come: what waits is decided now.

        Returns:
            Stamps and columns, of states that have waited, too.
        """
        everything: tuple[NDArray[Any], ...] = (stamps, *columns)
        if self._waiting:
            together = zip(self._waiting, everything, strict=True)
            everything = tuple(np.concatenate(each) for each in together)
        trusted, waiting = self._judge(everything[0], at_end=at_end)
        self._waiting = tuple(each[waiting] for each in everything) if waiting else ()
        return everything if trusted.all() else tuple(each[trusted] for each in everything)

    def _judge(self, stamps: Stamps, *, at_end: bool) -> tuple[Booleans, list[int]]:
        """Return which of the undecided states (N,) are trusted, and the rows of those to wait."""
        trusted = np.zeros(len(stamps), dtype=bool)
        # The rows that are far from those before them; what lies between goes by its first one.
        far = np.flatnonzero(np.abs(np.diff(stamps)) > NEAR_NS) + 1
        waiting: list[int] = []
        row = 0
        while row < len(stamps):
            stamp = int(stamps[row])
            if waiting and 0 < abs(stamp - int(stamps[waiting[-1]])) <= NEAR_NS:
                trusted[waiting] = True
            elif self._newest is not None and abs(stamp - self._newest) <= NEAR_NS:
                self._drop(stamps[waiting], stamp)
            else:
                contradicted = [each for each in waiting if stamps[each] > stamp]
                self._drop(stamps[contradicted], stamp)
                waiting = [each for each in waiting if stamps[each] <= stamp] + [row]
                slow = len(np.unique(stamps[waiting])) >= _OF_A_SLOW_STREAM
                if slow or len(waiting) >= _MOST_WAITING:
                    trusted[waiting] = True
                    self._newest, waiting = stamp, []
                row += 1
                continue
            waiting = []
            end = int(far[place]) if (place := far.searchsorted(row, "right")) < len(far) else None
            trusted[row:end] = True
            row = len(stamps) if end is None else end
            self._newest = int(stamps[row - 1])
        if not at_end:
            return trusted, waiting
        for each in waiting:
            late_ns = 1 if self._newest is None else int(stamps[each]) - self._newest
            trusted[each] = 0 < late_ns <= _LAST_GAP_NS
            if not trusted[each]:
                self._drop(stamps[each : each + 1], self._newest or 0)
        return trusted, []

    def _drop(self, stamps: Stamps, stamp: int) -> None:
        """Count states (N,) that stand alone, besides one that doesn't."""
        self.lone += len(stamps)
        off_ns = int(np.abs(stamps - stamp).max(initial=0))
        self.farthest_ns = max(self.farthest_ns, off_ns)

    @property
    def said(self) -> str:
        """What to tell of the states dropped; empty if there are none."""
        if not self.lone:
            return ""
        far = f"{self.farthest_ns / NANOSECONDS:.4g} s"
        if self.lone == 1:
            return f"1 pose dropped: its timestamp differs by {far} from its neighbours"
        return (
            f"{self.lone} poses dropped: their timestamps differ by up to {far} from their "
            "neighbours"
        )


def trusted_states(stamps: Stamps) -> tuple[NDArray[np.int64], StampTrust]:
    """Return the rows of a whole recording (N,) that are trusted, and what judged them."""
    trust = StampTrust()
    return trust.take(stamps, np.arange(len(stamps)), at_end=True)[1], trust
