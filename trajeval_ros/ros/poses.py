"""Conversion of messages to the states of the live evaluator, with counts and notes."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.diagnosis.warnings import reasons
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.dropped_counts import count_up
from trajeval_ros.geometry.fix_selection import FRAME
from trajeval_ros.geometry.stamp_trust import LONE, NEAR_NS, StampTrust, trusted_states
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.bags.pose_messages import PATH_TYPE, PoseColumns, decode_path, decode_poses
from trajeval_ros.online.notices import WARN, Notice
from trajeval_ros.online.state_rows import POSITION, QUATERNION, VELOCITY, WIDTH, as_wide, states
from trajeval_ros.ros.live_fixes import LiveFixes
from trajeval_ros.ros.timing import Arrivals

_MOST_NOTES = 20
_STALE_AFTER_S, _STALE_PERIODS = 5.0, 3.0
_TROUBLE_AFTER = 10  # consecutive messages without a pose


class StateColumns(NamedTuple):
    """States of N messages.

    Attributes:
        stamps: (N,) nanoseconds.
        states: (N, 10) or (N, 46), in the columns of `online.state_rows`.
        rows: (N,), index of the message.
        fixes: (N, 14), place and quality of GNSS fixes as in their messages; None for others.
    """

    stamps: Stamps
    states: Floats
    rows: NDArray[np.int64]
    fixes: Floats | None = None

    def picked(self, rows: NDArray[Any] | slice) -> StateColumns:
        """Return the states of a mask, of indices, or of a slice."""
        fixes = None if self.fixes is None else self.fixes[rows]
        return StateColumns(self.stamps[rows], self.states[rows], self.rows[rows], fixes)

    def joined(self, other: StateColumns) -> StateColumns:
        """Return these states followed by others."""
        return StateColumns(
            np.concatenate([self.stamps, other.stamps]),
            np.concatenate([self.states, other.states]),
            np.concatenate([self.rows, other.rows]),
        )


@dataclass
class StreamStatus:
    """Counts, frames and notes of a stream.

    Attributes:
        poses: Number of poses, including repeated timestamps.
        first: The earliest timestamp, nanoseconds; None before the first pose.
        last: The latest timestamp, nanoseconds; None before the first pose.
        frame: Frame of the poses, from the first message.
        child_frame: Name of their body.
        dropped: Number of messages without a valid pose, by reason.
        notes: Changes during the run, as sentences.
    """

    poses: int = 0
    first: int | None = None
    last: int | None = None
    frame: str = ""
    child_frame: str = ""
    dropped: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    @property
    def duration_s(self) -> float:
        """Time from the earliest to the latest stamp, seconds."""
        if self.first is None or self.last is None:
            return 0.0
        return (self.last - self.first) / NANOSECONDS

    def note(self, sentence: str) -> bool:
        """Store a new sentence, up to a limit; return whether it was stored."""
        if len(self.notes) >= _MOST_NOTES or sentence in self.notes:
            return False
        self.notes.append(sentence)
        return True

    def drop(self, reason: str, number: int) -> None:
        """Count messages without a valid pose."""
        count_up(self.dropped, reason, number)


class PoseStream:
    """Decodes the messages of one topic.

    Attributes:
        status: Counts, frames and notes so far.
        arrivals: Delay of messages relative to their timestamps.
        news: Notices that are not published yet.
        trouble: Why messages currently contain no valid poses; empty if they do.
        fixes: Selects GNSS fixes, if the topic carries fixes.
        begins_anew: Whether time may step back to a new start, as in a bag played in a loop.
        heard_at: Time of the last message, by `time.monotonic`; None before the first.
    """

    def __init__(
        self, topic: str, *, covariances: bool = False, fixes: LiveFixes | None = None
    ) -> None:
        """Create it for a topic.

        Args:
            topic: Name of the topic.
            covariances: Whether to decode the covariances of messages that have one.
            fixes: Selects GNSS fixes; None for topics without fixes.
        """
        self._covariances = covariances
        self.fixes = fixes or LiveFixes()
        self.status = StreamStatus()
        self.arrivals = Arrivals()
        self.news: list[Notice] = []
        self.trouble = ""
        self.heard_at: float | None = None
        self.begins_anew = False
        self._topic = topic
        self._type = ""
        self._names: tuple[str, str] | None = None
        self._previous: int | None = None
        self._trust = StampTrust()
        self._batch, self._width = 0, WIDTH
        self._lone_note = ""
        self._in_a_row = 0
        self._is_told = False

    @property
    def patience_s(self) -> float:
        """Time without a message after which silence is reported, in proportion to the period."""
        status = self.status
        period_s = status.duration_s / (status.poses - 1) if status.poses > 1 else 0.0
        return max(_STALE_AFTER_S, _STALE_PERIODS * period_s)

    def up(self, given: str | None) -> UpAxis:
        """Return the up axis: the given one, or the one that follows from the frame's name."""
        return UpAxis(given) if given else UpAxis.of_frame(self.status.frame)

    def poses(
        self, message_type: str, payloads: Sequence[bytes], arrived_ns: Stamps
    ) -> StateColumns:
        """Return the states of messages, N of them, that arrived at times (N,), nanoseconds."""
        self._see_type(message_type)
        columns = decode_poses(payloads, message_type, covariance=self._covariances)
        if columns.fix_quality is not None:
            found = self._fix_states(columns, columns.fix_quality)
        else:
            found = self._trusted(self._states(columns))
        self.arrivals.see(found.stamps, arrived_ns[found.rows])
        self._count(found)
        return found

    def last_poses(self) -> StateColumns:
        """Return the states whose timestamps are still under test, at the end of the run."""
        none = np.empty(0, dtype=np.int64)
        found = self._trusted(StateColumns(none, np.empty((0, WIDTH)), none), at_end=True)
        self._count(found)
        return found

    def path(self, payload: bytes) -> StateColumns:
        """Return all states of a path; `count_new` counts those that are new.

        States with an isolated timestamp are counted with every path that contains them.
        """
        self._see_type(PATH_TYPE)
        found = self._states(decode_path(payload))
        poses = np.flatnonzero(_are_poses(found.states))
        rows, trust = trusted_states(found.stamps[poses])
        self._tell_lone(trust)
        return found.picked(poses[rows]) if trust.lone else found

    def count_new(self, new: StateColumns, arrived_ns: int) -> None:
        """Count the new states of a path that arrived at a time, nanoseconds."""
        self.arrivals.see(new.stamps[-1:], np.array([arrived_ns]))
        self._count(new)

    def _see_type(self, message_type: str) -> None:
        self.heard_at = time.monotonic()
        if message_type != self._type:
            self._type = message_type
            self.status.note(f"format: {message_type}")

    def _states(self, columns: PoseColumns) -> StateColumns:
        """Return the states in the columns, without poses that have no timestamp."""
        status = self.status
        status.drop("undecodable", columns.undecodable)
        for _, frame, child_frame in columns.frames:
            self._see_frames(frame, child_frame)
        stamps, states_ = columns.stamps, states(columns.positions, columns.quaternions)
        if columns.quaternions is not None and columns.body_velocities is not None:
            usable = np.where(np.isfinite(states_[:, QUATERNION]), states_[:, QUATERNION], 0.0)
            states_[:, VELOCITY] = lie.rotate(usable, columns.body_velocities)
        if columns.covariances is not None:
            states_ = np.hstack([states_, columns.covariances.reshape(-1, 36)])
        timed = stamps != 0  # a timestamp that was not set
        untimed = int(np.count_nonzero(~timed))
        status.drop("zero_stamp", untimed)
        self._see_trouble(len(stamps) - untimed, columns.undecodable + untimed)
        return StateColumns(stamps[timed], states_[timed], columns.rows[timed])

    def _fix_states(self, columns: PoseColumns, quality: Floats) -> StateColumns:
        """Return the used fixes, in metres, without those that have no timestamp."""
        status = self.status
        timed = columns.stamps != 0
        status.drop("undecodable", columns.undecodable)
        status.drop("zero_stamp", int(np.count_nonzero(~timed)))
        stamps, rows = columns.stamps[timed], columns.rows[timed]
        places, quality = columns.positions[timed], quality[timed]
        kept, positions, dropped = self.fixes.placed(stamps, places, quality)
        for reason, count in dropped.items():
            status.drop(reason, count)
        antennas = [antenna for _, antenna, _ in columns.frames]
        for antenna in antennas:
            self._see_frames(FRAME, antenna)
        self._see_trouble(len(positions), columns.undecodable + len(columns.stamps))
        if (mixed := self.fixes.mixed(antennas)) and status.note(mixed):
            self.news.append(Notice("data", WARN, f"{self._topic}: {mixed}"))
        as_sent = np.hstack([places, quality])[kept]
        return StateColumns(stamps[kept], states(positions), rows[kept], as_sent)

    def _trusted(self, found: StateColumns, *, at_end: bool = False) -> StateColumns:
        """Return the states whose timestamps are trusted by now, and all invalid poses.

        States that waited get the row of the first of these messages.
        """
        poses, before = _are_poses(found.states), self._trust.lone
        self._batch += 1
        self._width = max(self._width, found.states.shape[1])  # types may change on the way
        found = found._replace(states=as_wide(found.states, self._width))
        batches = np.full(len(found.stamps), self._batch)
        picked, batches = found.picked(poses), batches[poses]
        stamps, states_, rows, batches = self._trust.take(
            picked.stamps, picked.states, picked.rows, batches, at_end=at_end
        )
        rows = np.where(batches == self._batch, rows, 0)
        if self._trust.lone > before:
            self._tell_lone(self._trust)
            self.status.drop(LONE, self._trust.lone - before)
        trusted = StateColumns(stamps, states_, rows)
        return trusted if poses.all() else trusted.joined(found.picked(~poses))

    def _tell_lone(self, trust: StampTrust) -> None:
        """Count isolated timestamps, and report them once."""
        if not trust.lone:
            return
        if not self._lone_note:
            self.news.append(Notice("data", WARN, f"{self._topic}: {trust.said}"))
        notes = [each for each in self.status.notes if each != self._lone_note]
        self._lone_note = trust.said
        self.status.notes = [*notes, trust.said]

    def _see_trouble(self, poses: int, dropped: int) -> None:
        """Report once that messages arrive without valid poses."""
        self._in_a_row = 0 if poses else self._in_a_row + dropped
        if poses:
            self.trouble = ""
        elif self._in_a_row >= _TROUBLE_AFTER:
            why = self.fixes.why_none or reasons(self.status.dropped)
            self.trouble = f"{self._topic}: no message with a valid pose: {why}"
            if not self._is_told:
                self._is_told = True
                self.news.append(Notice("data", WARN, self.trouble))

    def _count(self, found: StateColumns) -> None:
        poses = _are_poses(found.states)
        if not poses.any():
            return
        status, seen = self.status, found.stamps[poses]
        self._see_step_back(seen)
        status.poses += len(seen)
        earliest, latest = int(seen.min()), int(seen.max())
        status.first = earliest if status.first is None else min(status.first, earliest)
        status.last = latest if status.last is None else max(status.last, latest)

    def _see_step_back(self, stamps: Stamps) -> None:
        """Report once that time steps back, because live errors use the newest pairs only."""
        before, self._previous = self._previous, int(stamps[-1])
        steps = np.diff(stamps if before is None else np.concatenate([[before], stamps]))
        self._tell_step_back(-float(steps.min(initial=0)) / NANOSECONDS)

    def _tell_step_back(self, back_s: float) -> None:
        if self.begins_anew:
            return  # the new segment reports it
        told = any("timestamps step back" in each for each in self.status.notes)
        if told or back_s < NEAR_NS / NANOSECONDS:
            return
        sentence = (
            f"{self._topic}: timestamps step back by {back_s:.1f} s, as after a restart of a "
            "clock or bag; older poses are excluded from live values; to start a new run, "
            "call ~/reset or set on_time_jump"
        )
        if self.status.note(sentence):
            self.news.append(Notice("restart", WARN, sentence, values={"back_s": back_s}))

    def _see_frames(self, frame: str, child_frame: str) -> None:
        names = frame, child_frame
        if self._names is None:
            self.status.frame, self.status.child_frame = names
        elif names != self._names:
            before = " of ".join(filter(None, reversed(self._names)))
            now = " of ".join(filter(None, reversed(names)))
            sentence = f"{self._topic}: the frame changes from {before} to {now}"
            if self.status.note(sentence):
                self.news.append(Notice("frame", WARN, sentence))
        self._names = names


def _are_poses(rows: Floats) -> Booleans:
    """Return which states (N, 10) are finite, with a valid quaternion or without one."""
    rows = rows[:, :WIDTH]
    finite = np.isfinite(rows[:, POSITION]).all(axis=1)
    return np.logical_and(finite, ~np.isposinf(rows).any(axis=1))
