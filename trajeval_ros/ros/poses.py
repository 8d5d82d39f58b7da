"""From the bytes of messages to the states that the live evaluator takes, and what they tell."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.diagnosis.warnings import reasons
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.bags.pose_messages import PATH_TYPE, PoseColumns, decode_path, decode_poses
from trajeval_ros.online.notices import WARN, Notice
from trajeval_ros.online.state_rows import POSITION, QUATERNION, VELOCITY, states
from trajeval_ros.ros.timing import Arrivals

_MOST_NOTES = 20
_TROUBLE_AFTER = 10  # messages in a row that give no pose
_STEP_BACK_S = 1.0  # messages that merely overtake each other step back by less


class StateColumns(NamedTuple):
    """States of N messages.

    Attributes:
        stamps: (N,) nanoseconds.
        states: (N, 10), the rows of `online.state_rows.states`.
        rows: (N,) which message each is from.
    """

    stamps: Stamps
    states: Floats
    rows: NDArray[np.int64]


@dataclass
class StreamStatus:
    """What a stream has told beside its states.

    Attributes:
        poses: Number of poses, repeated stamps included.
        first: The earliest stamp, nanoseconds; None before the first pose.
        last: The latest one.
        frame: The frame that poses are in, as the first message had it.
        child_frame: The body that they are of.
        dropped: Number of messages that are no poses, by reason.
        notes: Changes on the way, one sentence each.
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
        """Keep a sentence unless it is known, or many are; returns whether it is new."""
        if len(self.notes) >= _MOST_NOTES or sentence in self.notes:
            return False
        self.notes.append(sentence)
        return True

    def drop(self, reason: str, number: int) -> None:
        """Count what is no pose."""
        if number:
            self.dropped[reason] = self.dropped.get(reason, 0) + number


class PoseStream:
    """Decodes the messages of one topic.

    Attributes:
        status: What they have told so far.
        arrivals: How much later than their stamps they come.
        news: What nobody has been told yet.
        trouble: Why messages give no poses at present; empty if they do.
        heard_at: When the last of them came, by `time.monotonic`; None before.
    """

    def __init__(self, topic: str) -> None:
        """Begin, for a topic."""
        self.status = StreamStatus()
        self.arrivals = Arrivals()
        self.news: list[Notice] = []
        self.trouble = ""
        self.heard_at: float | None = None
        self._topic = topic
        self._type = ""
        self._names: tuple[str, str] | None = None
        self._previous: int | None = None
        self._in_a_row = 0
        self._is_told = False

    def up(self, given: str | None) -> UpAxis:
        """Return which axis points up: the one given, or what the name of the frame tells."""
        return UpAxis(given) if given else UpAxis.of_frame(self.status.frame)

    def poses(
        self, message_type: str, payloads: Sequence[bytes], arrived_ns: Stamps
    ) -> StateColumns:
        """Return the states of messages, N of them, that arrived at times (N,), nanoseconds."""
        self._see_type(message_type)
        found = self._states(decode_poses(payloads, message_type))
        self.arrivals.see(found.stamps, arrived_ns[found.rows])
        self._count(found)
        return found

    def path(self, payload: bytes) -> StateColumns:
        """Return all states of a path; which of them are new, `count_new` is told."""
        self._see_type(PATH_TYPE)
        return self._states(decode_path(payload))

    def count_new(self, new: StateColumns, arrived_ns: int) -> None:
        """Count the states that a path, which arrived at a time, is the first to have."""
        self.arrivals.see(new.stamps[-1:], np.array([arrived_ns]))
        self._count(new)

    def _see_type(self, message_type: str) -> None:
        self.heard_at = time.monotonic()
        if message_type != self._type:
            self._type = message_type
            self.status.note(f"format: {message_type}")

    def _states(self, columns: PoseColumns) -> StateColumns:
        """Return what the columns hold, without poses that have no time."""
        status = self.status
        status.drop("undecodable", columns.undecodable)
        for _, frame, child_frame in columns.frames:
            self._see_frames(frame, child_frame)
        stamps, states_ = columns.stamps, states(columns.positions, columns.quaternions)
        if columns.quaternions is not None and columns.body_velocities is not None:
            usable = np.where(np.isfinite(states_[:, QUATERNION]), states_[:, QUATERNION], 0.0)
            states_[:, VELOCITY] = lie.rotate(usable, columns.body_velocities)
        timed = stamps != 0  # a stamp that nobody has set
        untimed = int(np.count_nonzero(~timed))
        status.drop("zero_stamp", untimed)
        self._see_trouble(len(stamps) - untimed, columns.undecodable + untimed)
        return StateColumns(stamps[timed], states_[timed], columns.rows[timed])

    def _see_trouble(self, poses: int, dropped: int) -> None:
        """Tell, once, that messages come and give no poses."""
        self._in_a_row = 0 if poses else self._in_a_row + dropped
        if poses:
            self.trouble = ""
        elif self._in_a_row >= _TROUBLE_AFTER:
            self.trouble = (
                f"{self._topic}: no message gives a pose: {reasons(self.status.dropped)}"
            )
            if not self._is_told:
                self._is_told = True
                self.news.append(Notice("data", WARN, self.trouble))

    def _count(self, found: StateColumns) -> None:
        rows = found.states
        poses = np.isfinite(rows[:, POSITION]).all(axis=1) & ~np.isposinf(rows).any(axis=1)
        if not poses.any():
            return
        status, seen = self.status, found.stamps[poses]
        self._see_step_back(seen)
        status.poses += len(seen)
        earliest, latest = int(seen.min()), int(seen.max())
        status.first = earliest if status.first is None else min(status.first, earliest)
        status.last = latest if status.last is None else max(status.last, latest)

    def _see_step_back(self, stamps: Stamps) -> None:
        """Tell, once, that time doesn't go on: live errors are about the newest pairs alone."""
        before, self._previous = self._previous, int(stamps[-1])
        steps = np.diff(stamps if before is None else np.concatenate([[before], stamps]))
        self._tell_step_back(-float(steps.min(initial=0)) / NANOSECONDS)

    def _tell_step_back(self, back_s: float) -> None:
        if back_s < _STEP_BACK_S or any("stamps step back" in each for each in self.status.notes):
            return
        sentence = (
            f"{self._topic}: stamps step back by {back_s:.1f} s: has its clock, or a bag, begun "
            "anew? What is older than the newest pair is in no live number; ~/reset begins anew"
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
