"""As-available accuracy of a live estimate: all final samples of 0.2 s together.

A sample is final when groundtruth and the newest message have passed it. Messages that arrive
after newer ones are never in use, so nothing changes it afterwards.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.geometry.reading import NOT_READ, Reading
from trajeval_ros.geometry.receptions import Receptions
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.metrics.as_available import AvailabilityRule
from trajeval_ros.metrics.availability import (
    RATE_HZ,
    RECENT,
    STEP_NS,
    AvailableSamples,
    Messages,
    in_use,
    instants,
    sampled,
)
from trajeval_ros.metrics.reception_clock import ReceptionClock, judged_receptions
from trajeval_ros.metrics.statistics import quantile
from trajeval_ros.metrics.stream_health import UNKNOWN
from trajeval_ros.online.state_buffer import NEVER, StateBuffer, usable_rows

_POSE = 7  # columns of a row
_RECENT_SAMPLES = 10 * RATE_HZ
_AT_ONCE_NS = 20 * STEP_NS  # an evaluation has a fixed cost, whatever the number of samples


class LiveAvailability:
    """Computes the as-available errors of one estimate, in bounded memory."""

    def __init__(
        self,
        rule: AvailabilityRule,
        max_gap_s: float,
        max_delay_s: float,
        record_groundtruth: Callable[[Stamps, Floats], object] = lambda *_: None,
        record_estimate: Callable[[Stamps, Stamps, Floats], object] = lambda *_: None,
    ) -> None:
        """Create it without messages; the last two are called with all usable ones."""
        self._rule, self._max_gap_s = rule, max_gap_s
        self._delay_ns = round(min(max_delay_s, 3600.0) * NANOSECONDS)
        self._record_groundtruth, self._record_estimate = record_groundtruth, record_estimate
        # Columns since the last call of `store`.
        self._new_truth: list[tuple[Stamps, Floats]] = []
        self._new_messages: list[tuple[Stamps, Stamps, Floats]] = []
        self._truth, no_stamps = StateBuffer(_POSE), np.empty(0, dtype=np.int64)
        # Timestamps, receptions and poses of the messages that later samples can use.
        self._messages: tuple[Any, ...] = no_stamps, no_stamps, np.empty((0, _POSE))
        self._next = self._seen = NEVER  # next sample; newest groundtruth at the last evaluation
        self._ages_s, self._is_late = np.empty(0), False
        # Of the last update, by topic and as samples; none if it has none.
        self.numbers: dict[str, float] = {}
        self.newest: AvailableSamples | None = None
        # Comparison of the recent receptions with timestamps; None before the first.
        self.clock: ReceptionClock | None = None
        self.missed = 0  # number of spans with ages above the deadline so far
        self.age_p95_s: float | None = None  # 95th percentile of the ages of the newest 10 s

    def add_groundtruth(self, stamps: Stamps, rows: Floats) -> None:
        """Take groundtruth states: timestamps (N,), nanoseconds, and rows (N, 7 or more)."""
        self._new_truth.append((stamps, rows[:, :_POSE]))

    def add_estimate(self, stamps: Stamps, times: Stamps, rows: Floats) -> None:
        """Take messages: timestamps and receptions (N,), nanoseconds, and rows (N, 7 or more).

        Messages with an unknown time of reception are left out.
        """
        self._new_messages.append((stamps, times, rows[:, :_POSE]))

    def store(self) -> None:
        """Record the usable states since the last call, all together because of the cost."""
        if self._new_truth:
            truth = list(map(np.concatenate, zip(*self._new_truth, strict=True)))
            truth = [each[usable_rows(truth[1])[0]] for each in truth]
            self._truth.merge(*truth)
            self._record_groundtruth(*truth)
        if self._new_messages:
            new = list(map(np.concatenate, zip(*self._new_messages, strict=True)))
            usable = usable_rows(new[2])[0] & (new[1] != UNKNOWN)
            new = [each[usable] for each in new]
            self._messages = tuple(map(np.concatenate, zip(self._messages, new, strict=True)))
            self._record_estimate(*new)
        self._new_truth, self._new_messages = [], []

    def update(self, similarity: Similarity | None, offset_ns: int = 0) -> AvailableSamples | None:
        """Return the samples that are final now, under the present alignment; None if none.

        `offset_ns` is added to the estimate's timestamps, not to the receptions.
        """
        self.store()
        self.newest, self.numbers = None, {}
        (stamps, times, rows), last = self._messages, self._truth.newest
        if last < self._seen + _AT_ONCE_NS:
            return None
        self._seen = last
        if similarity is None or not len(stamps):
            self._forget(times >= times.max(initial=0) - self._delay_ns, last - self._delay_ns)
            return None
        _, self.clock = judged_receptions(stamps + offset_ns, times)
        truth = received_states(*self._truth.held)
        reading = Reading(receptions=Receptions(times, "node"))
        estimate = similarity.trajectory(received_states(stamps, rows, reading))
        messages = Messages.of(estimate, times, self._rule.motion, offset_ns)
        known = min(int(times.max()), int(messages.stamps[-1])) - 1
        first = max(self._next, int(truth.stamps[0]))
        final = instants(first, min(last, max(known, last - self._delay_ns)))
        if not len(final):
            return None
        self._next = int(final[-1]) + STEP_NS
        have = final[in_use(messages, final) >= 0]
        samples = sampled(truth, messages, have, self._max_gap_s)
        # Keep what the next sample can use, and the messages before that.
        used = int(in_use(messages, np.array([self._next]))[0])
        kept = times >= messages.times[max(used - RECENT - 1, 0)]
        self._forget(kept, min(int(messages.stamps[max(used, 0)]), self._next))
        if len(samples.stamps) and self.clock.is_usable:
            self._see(samples)
        return self.newest

    def _forget(self, kept: Booleans, begin: int) -> None:
        """Keep some messages (N,), and groundtruth from the state before `begin` on."""
        self._messages = tuple(each[kept] for each in self._messages)
        before = int(self._truth.held[0].searchsorted(begin, side="right")) - 1
        self._truth.drop(max(before, 0))

    def _see(self, samples: AvailableSamples) -> None:
        """Take final samples, N > 0, of messages with usable receptions."""
        self.newest, row, messages = samples, samples.rows[-1], samples.messages
        ages_s = samples.age / NANOSECONDS
        self.numbers = {
            "available/position_error": float(samples.position_m[-1]),
            "available/age": float(ages_s[-1]),
            "available/latency": float(messages.times[row] - messages.stamps[row]) / NANOSECONDS,
        }
        if samples.rotation is not None:
            turned = np.degrees(np.linalg.norm(samples.rotation[:, -1].sum(axis=0)))
            self.numbers["available/rotation_error"] = float(turned)
        late = np.append(self._is_late, ages_s > self._rule.deadline_s)
        self.missed += int(np.count_nonzero(late[1:] & ~late[:-1]))
        self._is_late = bool(late[-1])
        self._ages_s = np.append(self._ages_s, ages_s)[-_RECENT_SAMPLES:]
        self.age_p95_s = quantile(np.sort(self._ages_s), 0.95)

    @property
    def values(self) -> dict[str, Any]:
        """The values for diagnostics, by name and unit."""
        return {
            "pose age p95 [s]": self.age_p95_s,
            "missed deadlines": self.missed,
            "reception clock": None if self.clock is None else self.clock.verdict,
        }


def received_states(
    stamps: Stamps, rows: Floats, reading: Reading = NOT_READ, up: UpAxis = Z_UP
) -> Trajectory:
    """Return the states in rows (N, 7), as received; without orientations if these are NaN."""
    turns = rows[:, 3:]
    quaternions = None if np.isnan(turns).any() else lie.normalized(turns)
    return Trajectory.from_columns(stamps, rows[:, :3], quaternions, reading, up=up)
