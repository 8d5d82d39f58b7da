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
_FIRST_UPDATE, _UPDATE_EVERY = 9, 400  # messages until the usual step is determined (again)
_LEADS = 400  # newest differences of stamp and receive time
# A recording is played at a rate: the timestamps' time over the receive times' time, over some
# messages: more than arrive together. Rates near 1 are those of a clock's drift and of delays.
_RATE_OVER, _RATE_OF, _NEAR_ONE = (20, 30, 40), 100, 0.2
_SAME_SIZE = 0.3  # two measurements of one step agree to this fraction

Message: TypeAlias = tuple[float, Floats, float | None]  # stamp, pose (K,), receive time


@dataclass(frozen=True)
class StampStep:
    """A step of a clock: the corrected stamp before it, and its size, seconds."""

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


# Corrected stamps (N,), poses (N, K), and the steps among them.
Corrected: TypeAlias = tuple[Floats, Floats, list[StampStep]]


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
        self._count, self._update_at = 0, _FIRST_UPDATE
        self._candidate: _Candidate | None = None

    def take(self, stamps: Floats, received: Floats | None, poses: Floats) -> Corrected:
        """Take N messages; return those with corrected stamps, and confirmed steps.

        Args:
            stamps: (N,), seconds, in order of arrival.
            received: (N,), receive times, seconds; None if unknown.
            poses: (N, K).
        """
        parts: list[tuple[Floats, Floats]] = []
        steps: list[StampStep] = []
        begin = 0
        while begin < len(stamps):
            if self._count >= self._update_at:
                self._update()
            end = begin + self._update_at - self._count
            times = None if received is None else received[begin:end]
            if self._is_regular(stamps[begin:end], times):
                parts.append((stamps[begin:end] + self.shift_s, poses[begin:end]))
                begin = end
                continue
            messages: list[Message] = []
            end = min(end, begin + _USUAL_OF)
            for row in range(begin, min(end, len(stamps))):
                time_s = None if received is None else float(received[row])
                corrected, step = self._add((float(stamps[row]), poses[row], time_s))
                messages += corrected
                steps += [] if step is None else [step]
            parts += _columns(messages)
            begin = end
        return _joined(parts, steps)

    def close(self) -> Corrected:
        """Return what waits for a confirmation at the end of the stream."""
        messages, step = ([], None) if self._candidate is None else self._decided(self._candidate)
        return _joined(_columns(messages), [] if step is None else [step])

    def _add(self, message: Message) -> tuple[list[Message], StampStep | None]:
        """Take a message; return messages with corrected stamps, and a confirmed step."""
        stamp, pose, received = message
        if received is not None:
            self._newest.append((stamp, received))
            received = float(self._at_rate_one(np.array([received]))[0])
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
            if self._candidate is None and self._usual_s is not None and not is_again:
                self._candidate = self._begun(before_s, step_s, arrival_s, self._usual_s)
        self._last, self._count = (stamp, received), self._count + 1
        if self._candidate is not None:
            return self._waited(self._candidate, message)
        if received is not None:
            self._leads.append(stamp - received)
            self._highest_lead_s = max(self._highest_lead_s, stamp - received)
        return [self._corrected(message)], None

    def _update(self) -> None:
        """Determine the usual step of the stamps, and the rate of a replay."""
        if self._steps:
            self._usual_s, self._rate = _median(self._steps), _rate_of(self._newest)
        self._update_at = self._count + min(self._count, _UPDATE_EVERY)

    @property
    def _smallest_s(self) -> float:
        """The smallest step, seconds; a replay enlarges the jitter of receive times."""
        return SMALLEST_S * max(self._rate, 1.0)

    def _is_regular(self, stamps: Floats, received: Floats | None) -> bool:
        """Return whether no step can begin in messages (N,), seconds, and take them if so.

        The result is that of `_add`, message by message, for the most frequent case.
        """
        if self._last is None or self._candidate is not None or self._usual_s is None:
            return False
        before_s, received_before = self._last
        steps = np.diff(stamps, prepend=before_s)
        if not steps.min() >= 0.0:  # equal timestamps are no step
            return False
        if received is not None:
            if received_before is None:
                return False
            before = self._received_s, self._replayed_s
            times = self._at_rate_one(received)
            arrivals = np.diff(times, prepend=received_before)
            if np.abs(steps - arrivals).max() > self._smallest_s or arrivals.min() < 0.0:
                self._received_s, self._replayed_s = before
                return False
            newest = slice(-_RATE_OF, None)
            self._newest.extend(
                zip(stamps[newest].tolist(), received[newest].tolist(), strict=True)
            )
            leads = stamps - times
            self._leads.extend(leads[-_LEADS:].tolist())
            self._highest_lead_s = max(self._highest_lead_s, float(leads.max()))
            received = times
        self._steps.extend(steps[steps > 0.0][-_USUAL_OF:].tolist())
        self._last = float(stamps[-1]), None if received is None else float(received[-1])
        self._count += len(stamps)
        self._highest_s = max(self._highest_s, float(stamps[-1]) + self.shift_s)
        return True

    def _at_rate_one(self, received: Floats) -> Floats:
        """Return receive times (N,) as if the messages were not replayed at another rate."""
        steps = self._rate * np.diff(received, prepend=self._received_s)
        times = np.cumsum(np.append(self._replayed_s, steps))[1:]
        self._received_s, self._replayed_s = float(received[-1]), float(times[-1])
        return times

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
            return [self._corrected(item) for item in kept], None
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
            at_s = candidate.at_s + self.shift_s
            step = StampStep(at_s, size_s, candidate.has_receive_times)
            self.shift_s -= size_s
            self._leads = deque(leads, maxlen=_LEADS)
            self._highest_lead_s = max(leads, default=-math.inf)
        return [self._corrected(message) for message in candidate.messages], step

    def _corrected(self, message: Message) -> Message:
        stamp, pose, received = message
        stamp += self.shift_s
        self._highest_s = max(self._highest_s, stamp)
        return stamp, pose, received


def _columns(messages: list[Message]) -> list[tuple[Floats, Floats]]:
    if not messages:
        return []
    stamps, poses, _ = zip(*messages, strict=True)
    return [(np.array(stamps), np.array(poses))]


def _joined(parts: list[tuple[Floats, Floats]], steps: list[StampStep]) -> Corrected:
    if not parts:
        return np.empty(0), np.empty((0, 7)), steps
    if len(parts) == 1:
        return *parts[0], steps
    stamps, poses = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return stamps, poses, steps


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
