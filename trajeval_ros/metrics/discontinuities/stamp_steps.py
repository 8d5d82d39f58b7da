"""Steps of the clock that writes one side's timestamps, detected in order of arrival."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.statistics import median

# Smallest step, seconds: above the jitter of receive times, below a frame of a camera.
SMALLEST_S = 0.04
# A step is confirmed by messages over this time: longer delays an alarm, shorter takes the
# catching up after a delay for a step.
_CONFIRM_S, _CONFIRM_MESSAGES, _MOST_WAITING = 1.0, 5, 200
_USUAL_OF = 60  # newest steps of the stamps whose median is the usual one
_USUAL_EVERY = 50  # messages between updates of the usual step
_LEADS = 400  # newest differences of stamp and receive time
# A recording is played at a rate: the timestamps' time over the receive times' time, over some
# messages: more than arrive together. Rates near 1 are those of a clock's drift and of delays.
_RATE_OVER, _RATE_OF, _NEAR_ONE = (20, 30, 40), 100, 0.2
_SAME_SIZE = 0.3  # two measurements of one step agree to this fraction

Message: TypeAlias = tuple[float, list[float], float | None]  # stamp, pose, receive time


@dataclass(frozen=True)
class StampStep:
    """A step of a clock: the stamp before it, and its size, seconds."""

    at_s: float
    size_s: float
    is_sure: bool  # receive times did not step


@dataclass
class _Candidate:
    size_s: float
    at_s: float  # the last stamp before it
    highest_s: float  # of the corrected stamps before it
    lead_s: float  # median of stamp minus receive time before it
    highest_lead_s: float
    has_receive_times: bool
    messages: list[Message] = field(default_factory=list)


class StampSteps:
    """Detects and removes the clock steps of one side, at a constant cost per message."""

    def __init__(self) -> None:
        self.shift_s = 0.0  # what corrects the newest stamps
        self._usual_s: float | None = None
        self._steps: deque[float] = deque(maxlen=_USUAL_OF)
        self._leads: deque[float] = deque(maxlen=_LEADS)
        self._highest_lead_s = -math.inf
        self._last: tuple[float, float | None] | None = None
        self._newest: deque[tuple[float, float]] = deque(maxlen=_RATE_OF)  # as read
        self._rate = 1.0  # of a replay
        self._received_s = self._replayed_s = 0.0  # the newest receive time, and at rate 1
        self._highest_s = -math.inf  # corrected stamp
        self._count = 0
        self._candidate: _Candidate | None = None

    def add(self, message: Message) -> tuple[list[Message], StampStep | None]:
        """Take a message; return messages with corrected stamps, and a confirmed step."""
        stamp, pose, received = message
        if received is not None:
            self._newest.append((stamp, received))
            [received] = self._at_rate_one([received])
            message = stamp, pose, received
        if self._last is not None:
            before_s, received_before = self._last
            step_s = stamp - before_s
            arrival_s, is_again = None, False
            if received is not None and received_before is not None:
                arrival_s = received - received_before
                is_again = arrival_s < 0.0
            if is_again:  # simulated time started again
                self._leads.clear()
                self._newest.clear()
                self._highest_lead_s = -math.inf
            if step_s > 0.0:
                self._steps.append(step_s)
            if self._steps and (
                self._count % _USUAL_EVERY == _USUAL_EVERY - 1
                or (self._usual_s is None and len(self._steps) > 8)
            ):
                self._usual_s = _median(self._steps)
                self._rate = _rate_of(self._newest)
            if self._candidate is None and self._usual_s is not None and not is_again:
                self._candidate = self._begun(before_s, step_s, arrival_s, self._usual_s)
        self._last, self._count = (stamp, received), self._count + 1
        if self._candidate is not None:
            return self._waited(self._candidate, message)
        if received is not None:
            self._leads.append(stamp - received)
            self._highest_lead_s = max(self._highest_lead_s, stamp - received)
        return [self._corrected(message)], None

    @property
    def _smallest_s(self) -> float:
        """The smallest step, seconds; a replay enlarges the jitter of receive times."""
        return SMALLEST_S * max(self._rate, 1.0)

    @property
    def regular_count(self) -> int:
        """The number of messages until the usual step is determined again, at least 1."""
        return max(_USUAL_EVERY - 1 - self._count % _USUAL_EVERY, 1)

    def is_regular(self, stamps: Floats, received: Floats | None) -> bool:
        """Return whether no step can begin in messages (N,), seconds, and take them if so.

        The result is that of `add`, message by message, for the most frequent case.
        """
        if self._last is None or self._candidate is not None or self._usual_s is None:
            return False
        if self._count % _USUAL_EVERY == _USUAL_EVERY - 1:
            return False  # the usual step changes
        before_s, received_before = self._last
        steps = np.diff(stamps, prepend=before_s)
        if steps.min() <= 0.0:
            return False
        if received is not None:
            if received_before is None:
                return False
            as_read = zip(stamps.tolist(), received.tolist(), strict=True)
            before = self._received_s, self._replayed_s
            received = np.array(self._at_rate_one(received.tolist()))
            arrivals = np.diff(received, prepend=received_before)
            if np.abs(steps - arrivals).max() > self._smallest_s or arrivals.min() < 0.0:
                self._received_s, self._replayed_s = before
                return False
            self._newest.extend(as_read)
            leads = stamps - received
            self._leads.extend(leads.tolist())
            self._highest_lead_s = max(self._highest_lead_s, float(leads.max()))
        self._steps.extend(steps.tolist())
        self._last = float(stamps[-1]), None if received is None else float(received[-1])
        self._count += len(stamps)
        self._highest_s = max(self._highest_s, float(stamps[-1]) + self.shift_s)
        return True

    def _at_rate_one(self, received: list[float]) -> list[float]:
        """Return receive times as if the messages were not replayed at another rate."""
        times = []
        for time_s in received:
            self._replayed_s += self._rate * (time_s - self._received_s)
            self._received_s = time_s
            times.append(self._replayed_s)
        return times

    def close(self) -> tuple[list[Message], StampStep | None]:
        """Return what waits for a confirmation at the end of the stream."""
        return ([], None) if self._candidate is None else self._decided(self._candidate)

    def _begun(
        self, before_s: float, step_s: float, arrival_s: float | None, usual_s: float
    ) -> _Candidate | None:
        """Return a step that may begin: the stamp is irregular and the arrival regular."""
        size_s = None
        if step_s < -max(2.0 * usual_s, self._smallest_s):
            size_s = step_s - (usual_s if arrival_s is None else arrival_s)
        elif arrival_s is not None:
            more_s = step_s - arrival_s
            is_irregular = abs(step_s - usual_s) > 0.6 * abs(more_s)
            arrives = abs(arrival_s - usual_s) < 0.5 * abs(more_s)
            if abs(more_s) > self._smallest_s and is_irregular and arrives:
                leads = list(self._leads)[-40:]
                changes = [abs(b - a) for a, b in itertools.pairwise(leads)]
                if len(changes) < 8 or abs(more_s) > 6.0 * _median(changes):
                    size_s = more_s
        if size_s is None:
            return None
        lead_s = _median(list(self._leads)[-20:]) if self._leads else math.nan
        highest_s = max(self._highest_s, before_s + self.shift_s)
        is_received = arrival_s is not None
        return _Candidate(size_s, before_s, highest_s, lead_s, self._highest_lead_s, is_received)

    def _waited(
        self, candidate: _Candidate, message: Message
    ) -> tuple[list[Message], StampStep | None]:
        waiting = candidate.messages
        waiting.append(message)
        # After an isolated stamp, the stream continues where it was.
        expected_s = candidate.highest_s + (self._usual_s or 0.0) * len(waiting)
        apart_s = abs(message[0] + self.shift_s - expected_s)
        if len(waiting) > 1 and apart_s < _SAME_SIZE * abs(candidate.size_s):
            self._candidate = None
            kept = waiting if candidate.size_s > 0.0 else waiting[1:]
            return [self._corrected(each) for each in kept], None
        is_long = message[0] - waiting[0][0] >= _CONFIRM_S or len(waiting) >= _MOST_WAITING
        if len(waiting) >= _CONFIRM_MESSAGES and is_long:
            return self._decided(candidate)
        return [], None

    def _decided(self, candidate: _Candidate) -> tuple[list[Message], StampStep | None]:
        self._candidate = None
        size_s, step = candidate.size_s, None
        leads = [stamp - time for stamp, _, time in candidate.messages if time is not None]
        if candidate.has_receive_times and leads:
            lead_s = _median(leads)
            size_s = lead_s - candidate.lead_s
            is_step = abs(size_s - candidate.size_s) < _SAME_SIZE * abs(candidate.size_s) + 0.02
            # Otherwise a delay was caught up.
            is_caught_up = candidate.highest_lead_s > lead_s - 0.5 * candidate.size_s
            is_step &= candidate.size_s < 0.0 or not is_caught_up
        else:
            is_step = size_s < 0.0
        if is_step:
            self.shift_s -= size_s
            self._leads = deque(leads, maxlen=_LEADS)
            self._highest_lead_s = max(leads, default=-math.inf)
            step = StampStep(candidate.at_s, size_s, candidate.has_receive_times)
        return [self._corrected(each) for each in candidate.messages], step

    def _corrected(self, message: Message) -> Message:
        stamp, pose, received = message
        stamp += self.shift_s
        self._highest_s = max(self._highest_s, stamp)
        return stamp, pose, received


def _rate_of(newest: Collection[tuple[float, float]]) -> float:
    """Return the rate of a replay, from pairs of timestamp and receive time, seconds."""
    if len(newest) <= 2 * _RATE_OVER[0]:
        return 1.0
    pairs, rates = np.array(newest), []
    for apart in _RATE_OVER:
        stamps_s, received_s = (pairs[apart:] - pairs[:-apart]).T
        known = (received_s > 0.0) & (stamps_s > 0.0)
        rates += (stamps_s[known] / received_s[known]).tolist()
    rate = _median(rates) if rates else 1.0
    return 1.0 if abs(rate - 1.0) < _NEAR_ONE else rate


def _median(values: Collection[float]) -> float:
    return median(np.array(values))
