"""As-available accuracy of a live estimate: all final samples of 0.5 s together.

A sample is final when groundtruth and the newest message have passed it. Messages that arrive
after newer ones are never in use, so nothing changes it afterwards.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.formatting.remarks import Remark
from trajeval_ros.geometry.arrays import Booleans
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.geometry.source_info import ReceiveTimes, SourceInfo
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.metrics.as_available import Availability, AvailabilityRule, usable_messages
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.availability import (
    RATE_HZ,
    RECENT,
    STEP_NS,
    AvailableSamples,
    in_use,
    instants,
    sampled,
)
from trajeval_ros.metrics.statistics import quantile
from trajeval_ros.metrics.stream_health import UNKNOWN
from trajeval_ros.online.state_buffer import NEVER, Tail

# Columns of `state`: position, quaternion xyzw, velocity, angular velocity; NaN if not measured.
MESSAGE = np.dtype([("stamp", "<i8"), ("time", "<i8"), ("corrected", "<i8"), ("state", "<f8", 13)])
_PARTS = slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13)
_VELOCITY = _PARTS[2]
Rows = NDArray[np.void]
_RECENT_SAMPLES = 10 * RATE_HZ
_AT_ONCE_NS = 50 * STEP_NS  # an evaluation has a fixed cost, whatever the number of samples


class LiveAvailability:
    """Computes the as-available errors of one estimate, in bounded memory."""

    def __init__(
        self, rule: AvailabilityRule, association: AssociationRule, max_delay_s: float
    ) -> None:
        """Create it without messages."""
        self._rule, self._association = rule, association
        self._delay_ns = round(min(max_delay_s, 3600.0) * NANOSECONDS)
        self._new_messages: list[Rows] = []  # since the last call of `store`
        self._truth = Tail()
        self._messages = np.empty(0, MESSAGE)  # those that later samples can use
        self._has_moved = False  # whether a message had a velocity
        self._next = NEVER  # next sample
        self._last = self._seen = NEVER  # newest groundtruth, also at the last evaluation
        self._ages_s, self._is_late = np.empty(0), False
        # Of the last update, by topic and as samples; none if it has none.
        self.numbers: dict[str, float] = {}
        self.newest: AvailableSamples | None = None
        # What is known of the messages, such as why there are no errors now.
        self._known = Availability(rule.motion, rule.deadline_s)
        self.missed = 0  # number of spans with ages above the deadline so far
        self.age_p95_s: float | None = None  # 95th percentile of the ages of the newest 10 s

    def add_groundtruth(self, block: Trajectory) -> None:
        """Take groundtruth states."""
        self._last = max(self._last, int(block.stamps.max(initial=NEVER)))
        self._truth.add(block)

    def add_estimate(self, block: Trajectory) -> None:
        """Take messages with their receive times; those with an `UNKNOWN` time are left out."""
        self._new_messages.append(message_rows(block))

    def store(self) -> None:
        """Take the messages since the last call, all together because of the cost."""
        new = np.concatenate([np.empty(0, MESSAGE), *self._new_messages])
        self._new_messages = []
        new = new[new["time"] != UNKNOWN]
        self._messages = np.concatenate([self._messages, new])
        self._has_moved |= bool(np.nan_to_num(new["state"][:, _VELOCITY]).any())

    def update(self, similarity: Similarity | None, offset_ns: int = 0) -> AvailableSamples | None:
        """Return the samples that are final now, under the present alignment; None if none.

        `offset_ns` is added to the estimate's timestamps, not to the receive times.
        """
        self.newest, self.numbers = None, {}
        if self._last < self._seen + _AT_ONCE_NS:
            return None
        self.store()
        times, last, messages = self._messages["time"], self._truth.newest, None
        self._seen = self._last
        if last == NEVER:
            return None  # no usable groundtruth
        if similarity is not None and len(times):
            estimate = received_poses(self._messages)
            self._known, messages = usable_messages(
                estimate, similarity, self._rule, offset_ns, has_moved=self._has_moved
            )
        if messages is None:
            self._forget(times >= times.max(initial=0) - self._delay_ns, last - self._delay_ns)
            return None
        truth = self._truth.trajectory()
        decided = min(int(times.max()), int(messages.stamps[-1])) - 1
        first = max(self._next, int(truth.stamps[0]))
        final = instants(first, min(last, max(decided, last - self._delay_ns)))
        if not len(final):
            return None
        self._next = int(final[-1]) + STEP_NS
        final = final[in_use(messages, final) >= 0]
        samples = sampled(truth, messages, final, self._association)
        # Keep what the next sample can use, and the messages before that.
        used = max(int(in_use(messages, np.array([self._next]))[0]), 0)
        before = np.unique(messages.stamps[: used + 1])[-RECENT - 2 :]
        kept = times >= messages.times[messages.stamps.searchsorted(before[0])]
        self._forget(kept, min(int(messages.stamps[used]), self._next))
        if len(samples.stamps):
            self._see(samples)
        return self.newest

    def _forget(self, kept: Booleans, begin: int) -> None:
        """Keep some messages (N,), and groundtruth from the state before `begin` on."""
        self._messages = self._messages[kept]
        before = int(self._truth.stamps.searchsorted(begin, side="right")) - 1
        self._truth.drop_before(max(before, 0))

    def _see(self, samples: AvailableSamples) -> None:
        """Take final samples, N > 0, of messages with usable receive times."""
        self.newest, row, messages = samples, samples.rows[-1], samples.messages
        ages_s = samples.age / NANOSECONDS
        self.numbers = {
            "available/position_error": float(samples.position_m[-1]),
            "available/age": float(ages_s[-1]),
            "available/latency": float(messages.times[row] - messages.stamps[row]) / NANOSECONDS,
        }
        if samples.rotation is not None:
            rotation_deg = np.degrees(np.linalg.norm(samples.rotation[:, -1].sum(axis=0)))
            self.numbers["available/rotation_error"] = float(rotation_deg)
        late = np.append(self._is_late, ages_s > self._rule.deadline_s)
        self.missed += int(np.count_nonzero(late[1:] & ~late[:-1]))
        self._is_late = bool(late[-1])
        self._ages_s = np.append(self._ages_s, ages_s)[-_RECENT_SAMPLES:]
        self.age_p95_s = quantile(np.sort(self._ages_s), 0.95)

    @property
    def remarks(self) -> list[Remark]:
        """The warning about withheld errors."""
        return self._known.remarks if self._known.why_withheld else []

    @property
    def values(self) -> dict[str, Any]:
        """The values for diagnostics, by name and unit."""
        return {
            "pose age p95 [s]": self.age_p95_s,
            "missed deadlines": self.missed,
            "receive time clock": self._known.clock and self._known.clock.verdict,
        }


def message_rows(block: Trajectory) -> Rows:
    """Return messages with receive times as rows of type `MESSAGE`."""
    receive_times = block.reading.receive_times
    assert receive_times is not None
    messages = np.empty(len(block), MESSAGE)
    messages["stamp"], messages["time"] = block.stamps, receive_times.times
    messages["corrected"] = UNKNOWN if receive_times.corrected is None else receive_times.corrected
    columns = (block.positions, block.quaternions, block.velocities, receive_times.body_rates)
    for part, column in zip(_PARTS, columns, strict=True):
        messages["state"][:, part] = np.nan if column is None else column
    return messages


def received_poses(rows: Rows, up: UpAxis = Z_UP) -> Trajectory:
    """Return the messages in rows of type `MESSAGE`; without velocities if these are NaN."""
    positions, quaternions, velocities, rates = (rows["state"][:, part] for part in _PARTS)
    corrected = None if (rows["corrected"] == UNKNOWN).any() else rows["corrected"]
    receive_times = ReceiveTimes(rows["time"], "node", body_rates=rates, corrected=corrected)
    return Trajectory.from_columns(
        rows["stamp"],
        positions,
        None if np.isnan(quaternions).any() else quaternions,
        velocities=None if np.isnan(velocities).any() else velocities,
        up=up,
        reading=SourceInfo(receive_times=receive_times),
    )
