"""As-available accuracy of a live estimate: all final samples of 0.2 s together.

A sample is final when groundtruth and the newest message have passed it. Messages that arrive
after newer ones are never in use, so nothing changes it afterwards.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
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
from trajeval_ros.metrics.stream_health import UNKNOWN
from trajeval_ros.online.state_buffer import NEVER, usable_rows

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
        self._truth: list[tuple[Stamps, Floats]] = []
        self._messages: list[tuple[Stamps, Stamps, Floats]] = []
        self._next: int | None = None
        self._seen = NEVER  # groundtruth's newest timestamp at the last evaluation
        self._ages_s: deque[float] = deque(maxlen=_RECENT_SAMPLES)
        self._is_late = False
        # Of the last update, by topic and as samples; none if it has none.
        self.numbers: dict[str, float] = {}
        self.newest: AvailableSamples | None = None
        # Comparison of the recent receptions with timestamps; None before the first.
        self.clock: ReceptionClock | None = None
        self.missed = 0  # number of spans with ages above the deadline so far

    def add_groundtruth(self, stamps: Stamps, rows: Floats) -> None:
        """Take groundtruth states: timestamps (N,), nanoseconds, and rows (N, 7 or more)."""
        usable, _ = usable_rows(rows)
        if usable.any():
            self._truth.append((stamps[usable], rows[usable, :7]))
            self._record_groundtruth(*self._truth[-1])

    def add_estimate(
        self, stamps: Stamps, times: Stamps, rows: Floats, offset_ns: int = 0
    ) -> None:
        """Take messages: timestamps and receptions (N,), nanoseconds, and rows (N, 7 or more).

        `offset_ns` is added to the timestamps, not to the receptions. Messages with an unknown
        time of reception are left out.
        """
        usable = usable_rows(rows)[0] & (times != UNKNOWN)
        if usable.any():
            stamps, times, rows = stamps[usable], times[usable], rows[usable, :7]
            self._messages.append((stamps + offset_ns, times, rows))
            self._record_estimate(stamps, times, rows)

    def update(self, similarity: Similarity | None) -> AvailableSamples | None:
        """Return the samples that are final now, under the present alignment; None if none."""
        self.newest, self.numbers = None, {}
        if similarity is None or not self._truth or not self._messages:
            return None
        last = max(int(stamps.max()) for stamps, _ in self._truth)
        if last < self._seen + _AT_ONCE_NS:
            return None
        self._seen = last
        truth_stamps, truth_rows = _joined(self._truth)
        stamps, times, rows = _joined(self._messages)
        _, self.clock = judged_receptions(stamps, times)
        truth = received_states(truth_stamps, truth_rows).in_order()
        reading = Reading(receptions=Receptions(times, "node"))
        estimate = similarity.trajectory(received_states(stamps, rows, reading))
        messages = Messages.of(estimate, times, self._rule.motion)
        known = min(int(times.max()), int(messages.stamps[-1])) - 1
        first = int(truth.stamps[0]) if self._next is None else self._next
        final = instants(first, min(last, max(known, last - self._delay_ns)))
        if not len(final):
            return None
        self._next = int(final[-1]) + STEP_NS
        have = final[in_use(messages, final) >= 0]
        samples = sampled(truth, messages, have, self._max_gap_s)
        # Keep what the next sample can use, and the messages and the state before that.
        used = int(in_use(messages, np.array([self._next]))[0])
        kept = times >= int(messages.times[max(used - RECENT - 1, 0)])
        self._messages = [(stamps[kept], times[kept], rows[kept])]
        oldest = min(int(messages.stamps[max(used, 0)]), self._next)
        row = max(int(truth.stamps.searchsorted(oldest, side="right")) - 1, 0)
        kept = truth_stamps >= truth.stamps[row]
        self._truth = [(truth_stamps[kept], truth_rows[kept])]
        if len(samples.stamps) and self.clock.is_usable:
            self._see(samples, messages)
        return self.newest

    def _see(self, samples: AvailableSamples, messages: Messages) -> None:
        """Take final samples, N > 0, of messages with usable receptions."""
        self.newest, row = samples, samples.rows[-1]
        ages_s = samples.age / NANOSECONDS
        self.numbers = {
            "available/position_error": float(samples.position_m[-1]),
            "available/age": float(ages_s[-1]),
            "available/latency": float(messages.times[row] - messages.stamps[row]) / NANOSECONDS,
        }
        if samples.rotation is not None:
            turned = np.degrees(np.linalg.norm(samples.rotation[:, -1].sum(axis=0)))
            self.numbers["available/rotation_error"] = float(turned)
        late = np.concatenate([[self._is_late], ages_s > self._rule.deadline_s])
        self.missed += int(np.count_nonzero(late[1:] & ~late[:-1]))
        self._is_late = bool(late[-1])
        self._ages_s.extend(ages_s.tolist())

    @property
    def age_p95_s(self) -> float | None:
        """The 95th percentile of the ages of the newest 10 s, seconds."""
        return float(np.percentile(list(self._ages_s), 95)) if self._ages_s else None

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


def _joined(parts: list[Any]) -> Any:
    return tuple(map(np.concatenate, zip(*parts, strict=True)))
