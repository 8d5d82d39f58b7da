"""Detection of clocks that differ or step, by timestamps of messages that arrive together."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.ros.timing import Arrivals

# A step is reported when it lasts so long, because the clocks of a bag loop step one by one.
_LASTS_S = 1.0
_FEWEST = 3  # messages of a stream with a low rate
_STEP_S = 1.0  # smallest step; delays vary by less
_SAME_S, _SAME_SHARE = 0.5, 0.1  # tolerance of steps that explain one another
_SEARCHED_S = 3.0  # before the step is complete
# An estimator that is slower than its sensor is late by seconds, and catches up at once.
_MOST_LATE_S = 10.0


class ClockStep(NamedTuple):
    """A step of one clock against the other."""

    of_groundtruth: bool  # whether the groundtruth's clock stepped, not the estimate's
    step_s: float  # change of its timestamps, seconds
    stamp: int  # the first timestamp after it, nanoseconds


class ClockSteps:
    """Compares the timestamps of an estimate and of the groundtruth at equal times of arrival.

    The comparison holds at any rate of a replay. A tracking loss, a pause and a delay change no
    clock: their timestamps are continuous, or as late as their messages.
    """

    def __init__(self) -> None:
        # Timestamps of the estimate minus those of the groundtruth, seconds; None before the
        # streams have been received together for a second.
        self._lead_s: float | None = None
        self.found: ClockStep | None = None  # newest step; None if clocks agree as at the start
        self._at_start_s: float | None = None
        self._newest = 0  # newest time of arrival that was compared
        self._leads: deque[tuple[int, float]] = deque()

    @property
    def apart_s(self) -> float | None:
        """The estimate's clock minus the groundtruth's, seconds; None as long as it is unknown.

        Clocks that agreed at the start and did not step still agree: a delay has grown.
        """
        if self._lead_s is None or self._at_start_s is None:
            return None
        return min(self._lead_s, self._at_start_s, key=abs)

    def update(self, groundtruth: Arrivals, estimate: Arrivals) -> None:
        """Compare the messages since the last call."""
        arrived, stamps = estimate.columns
        if not len(arrived) or arrived[-1] < self._newest:  # simulated time started again
            self._newest = 0
            self._leads.clear()
        rows = np.flatnonzero(arrived > self._newest)
        leads_ns, compared = groundtruth.ahead(arrived[rows], stamps[rows])
        rows = rows[compared]
        if not len(rows):
            return
        self._newest = int(arrived[rows[-1]])
        seconds = (leads_ns / NANOSECONDS).tolist()
        self._leads.extend(zip(arrived[rows].tolist(), seconds, strict=True))
        begin = self._newest - round(_LASTS_S * NANOSECONDS)
        while len(self._leads) > _FEWEST and self._leads[1][0] <= begin:
            self._leads.popleft()
        if len(self._leads) >= _FEWEST and self._leads[0][0] <= begin:
            self._judge(groundtruth, estimate)

    def _judge(self, groundtruth: Arrivals, estimate: Arrivals) -> None:
        before = self._lead_s
        leads = np.array([lead for _, lead in self._leads])
        now = float(np.median(leads))
        if before is None or self._at_start_s is None:
            self._lead_s = self._at_start_s = now
            return
        if np.abs(leads - before).min() <= _STEP_S:
            if abs(now - before) <= _STEP_S:
                self._lead_s = now  # clocks drift
            return
        self._lead_s = now
        if abs(now) < abs(before) <= _MOST_LATE_S and now * before > 0.0:
            return
        since = self._leads[0][0] - round(_SEARCHED_S * NANOSECONDS)
        own_s, own_stamp = estimate.step_since(since)
        other_s, other_stamp = groundtruth.step_since(since)
        change_s = now - before
        if abs(own_s - other_s - change_s) > _SAME_S + _SAME_SHARE * abs(change_s):
            return
        if abs(now - self._at_start_s) <= _STEP_S:
            self.found = None
        elif abs(other_s) > abs(own_s):
            self.found = ClockStep(True, -change_s, other_stamp)
        else:
            self.found = ClockStep(False, change_s, own_stamp)
