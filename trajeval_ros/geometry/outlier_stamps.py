"""Detection of isolated timestamps in a stream.

A driver's first message, or one sent while a clock is being set, can be years ahead of all others.
If it were taken as the current time, all later messages would be dropped. Therefore a timestamp
far from the newest trusted one waits for the next:

* If the next one is near it, time has jumped. Both are trusted.
* If the next one is near the newest trusted timestamp, the waiting one is isolated and dropped.
* If the next one is later and far, and so is a third, the stream has a low rate. All are trusted.

The order is the order of arrival, live and in bags, so that both drop the same messages.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Booleans, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS

# Messages that overtake one another differ by less.
NEAR_NS = NANOSECONDS
LONE = "lone_stamp"  # the reason under which dropped states are counted
_OF_A_SLOW_STREAM = 3  # distinct timestamps, all far apart and increasing
_MOST_WAITING = 1000  # states with the same timestamp
_LAST_GAP_NS = 60 * NANOSECONDS  # after a longer gap, the last timestamp of a stream is dropped


class OutlierStamps:
    """Filters the states of a stream by timestamp, at a constant cost."""

    def __init__(self) -> None:
        self.isolated = 0  # number of states dropped so far
        self.farthest_ns = 0  # largest distance of a dropped timestamp from the others
        self._newest: int | None = None
        self.waiting: tuple[NDArray[Any], ...] = ()  # stamps and columns under test; () if none

    def take(
        self, stamps: Stamps, *columns: NDArray[Any], at_end: bool = False
    ) -> tuple[NDArray[Any], ...]:
        """Return the states that are trusted so far, in order of arrival.

        `stamps`: (N,) timestamps of new states, nanoseconds. `columns`: other columns of these
        states, with N rows. `at_end`: no states will follow: decide about waiting states now.

        Returns:
            Stamps and columns of trusted states, which include states that have waited.
        """
        everything: tuple[NDArray[Any], ...] = (stamps, *columns)
        if self.waiting:
            together = zip(self.waiting, everything, strict=True)
            everything = tuple(np.concatenate(columns) for columns in together)
        trusted, waiting = self._judge(everything[0], at_end=at_end)
        self.waiting = tuple(column[waiting] for column in everything) if waiting else ()
        return everything if trusted.all() else tuple(column[trusted] for column in everything)

    def _judge(self, stamps: Stamps, *, at_end: bool) -> tuple[Booleans, list[int]]:
        """Return which undecided states (N,) are trusted, and the rows that keep waiting."""
        trusted = np.zeros(len(stamps), dtype=bool)
        # Rows far from their predecessor. Rows between two of these are near the first of them.
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
                contradicted = [held for held in waiting if stamps[held] > stamp]
                self._drop(stamps[contradicted], stamp)
                waiting = [held for held in waiting if stamps[held] <= stamp] + [row]
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
        for held in waiting:
            late_ns = 1 if self._newest is None else int(stamps[held]) - self._newest
            trusted[held] = 0 < late_ns <= _LAST_GAP_NS
            if not trusted[held]:
                self._drop(stamps[held : held + 1], self._newest or 0)
        return trusted, []

    def _drop(self, stamps: Stamps, stamp: int) -> None:
        """Count isolated states (N,), and their distance from a timestamp that is not isolated."""
        self.isolated += len(stamps)
        off_ns = int(np.abs(stamps - stamp).max(initial=0))
        self.farthest_ns = max(self.farthest_ns, off_ns)

    @property
    def message(self) -> str:
        """The sentence about the dropped states; empty if there are none."""
        if not self.isolated:
            return ""
        far = f"{self.farthest_ns / NANOSECONDS:.4g} s"
        if self.isolated == 1:
            return f"1 pose dropped: its timestamp differs by {far} from its neighbours"
        return (
            f"{self.isolated} poses dropped: their timestamps differ by up to {far} from their "
            "neighbours"
        )


def trusted_states(stamps: Stamps) -> tuple[NDArray[np.int64], OutlierStamps]:
    """Return the trusted rows of a recording with N timestamps, and the filter with its counts."""
    trust = OutlierStamps()
    return trust.take(stamps, np.arange(len(stamps)), at_end=True)[1], trust
