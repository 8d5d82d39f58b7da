"""As-available accuracy of a live estimate: all final samples of an update together.

A sample is final when groundtruth and the newest message have passed it. Messages that arrive
after newer ones are never in use, so nothing changes it afterwards.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.geometry.reading import Reading
from trajeval_ros.geometry.receptions import Receptions
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
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

_RECENT_SAMPLES = 10 * RATE_HZ


class LiveAvailability:
    """Computes the as-available errors of one estimate, in bounded memory.

    Attributes:
        newest: The samples of the last update; None if there are none.
        clock: The comparison of the recent receptions with timestamps; None before the first.
        missed: Number of spans with ages above the deadline so far.
    """

    def __init__(self, rule: AvailabilityRule, max_gap_s: float, max_delay_s: float) -> None:
        self._rule, self._max_gap_s = rule, max_gap_s
        self._delay = min(max_delay_s, 3600.0)
        self._truth: list[tuple[Stamps, Floats]] = []
        self._messages: list[tuple[Stamps, Stamps, Floats]] = []
        self._next: int | None = None
        self._ages_s: deque[float] = deque(maxlen=_RECENT_SAMPLES)
        self._is_late, self._latency_s = False, 0.0
        self.newest: AvailableSamples | None = None
        self.clock: ReceptionClock | None = None
        self.missed = 0

    def add_groundtruth(self, stamps: Stamps, rows: Floats) -> None:
        """Take groundtruth states: timestamps (N,), nanoseconds, and rows (N, 7)."""
        if len(stamps):
            self._truth.append((stamps, rows[:, :7]))

    def add_estimate(self, stamps: Stamps, times: Stamps, rows: Floats) -> None:
        """Take messages by the groundtruth's clock: timestamps and receptions (N,), rows (N, 7).

        Messages with an unknown time of reception are left out.
        """
        known = times != UNKNOWN
        if known.any():
            self._messages.append((stamps[known], times[known], rows[known, :7]))

    def update(self, similarity: Similarity | None) -> AvailableSamples | None:
        """Return the samples that are final now, under the present alignment; None without one."""
        self.newest = None
        if similarity is None or not self._truth or not self._messages:
            return None
        truth_stamps, truth_rows = _joined(self._truth)
        stamps, times, rows = _joined(self._messages)
        _, self.clock = judged_receptions(stamps, times)
        truth = _states(truth_stamps, truth_rows, Reading()).in_order()
        estimate = _states(stamps, rows, Reading(receptions=Receptions(times, "node")))
        messages = Messages.of(similarity.trajectory(estimate), times, self._rule.motion)
        begin, last = int(truth.stamps[0]), int(truth.stamps[-1])
        first = begin if self._next is None else self._next
        waiting = last - round(self._delay * NANOSECONDS)
        known = min(int(times.max()), int(messages.stamps[-1])) - 1
        final = instants(first, min(last, max(known, waiting)))
        if not len(final):
            return None
        self._next = int(final[-1]) + STEP_NS
        have = final[in_use(messages, final) >= 0]
        samples = sampled(truth, messages, have, self._max_gap_s)
        self._forget(truth, messages, stamps, times, rows)
        if len(samples.stamps) and self.clock.is_usable:
            self.newest = samples
            row = samples.rows[-1]
            latency = messages.times[row] - messages.stamps[row]
            self._latency_s = float(latency) / NANOSECONDS
            self._count(samples)
        return self.newest

    def _forget(
        self, truth: Trajectory, messages: Messages, stamps: Stamps, times: Stamps, rows: Floats
    ) -> None:
        """Keep the messages that the next sample can use, those before them, and groundtruth."""
        assert self._next is not None
        used = int(in_use(messages, np.array([self._next]))[0])
        since = int(messages.times[max(used - RECENT - 1, 0)])
        kept = times >= since
        self._messages = [(stamps[kept], times[kept], rows[kept])]
        oldest = min(int(messages.stamps[max(used, 0)]), self._next)
        row = max(int(truth.stamps.searchsorted(oldest, side="right")) - 1, 0)
        turns = truth.quaternions
        if turns is None:
            turns = np.full((len(truth), 4), np.nan)
        self._truth = [(truth.stamps[row:], np.hstack([truth.positions, turns])[row:])]

    def _count(self, samples: AvailableSamples) -> None:
        ages_s = samples.age / NANOSECONDS
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

    @property
    def numbers(self) -> dict[str, float]:
        """The numbers of the newest sample by topic."""
        if self.newest is None:
            return {}
        position, rotation = self.newest.position, self.newest.rotation
        found = {
            "available/position_error": float(np.linalg.norm(position[:, -1].sum(axis=0))),
            "available/age": float(self.newest.age[-1]) / NANOSECONDS,
            "available/latency": self._latency_s,
        }
        if rotation is not None:
            turned = np.degrees(np.linalg.norm(rotation[:, -1].sum(axis=0)))
            found["available/rotation_error"] = float(turned)
        return found


def _joined(parts: list[Any]) -> Any:
    return tuple(map(np.concatenate, zip(*parts, strict=True)))


def _states(stamps: Stamps, rows: Floats, reading: Reading) -> Trajectory:
    turns = rows[:, 3:]
    quaternions = None if np.isnan(turns).any() else lie.normalized(turns)
    return Trajectory(stamps, rows[:, :3], quaternions, reading=reading)
