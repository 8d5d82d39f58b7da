"""Conversion of messages to the states of the live evaluator, with counts and remarks."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from trajeval_ros.formatting.remarks import Level, Remark, note, warning
from trajeval_ros.geometry.arrays import Indices, Stamps
from trajeval_ros.geometry.fix_selection import FRAME
from trajeval_ros.geometry.geodesy import Datum
from trajeval_ros.geometry.outlier_stamps import LONE, NEAR_NS, OutlierStamps, trusted_states
from trajeval_ros.geometry.source_info import FORMAT, DeclaredReset, ReceiveTimes, SourceInfo
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.geometry.valid_poses import add_counts, in_words, valid_mask
from trajeval_ros.io.bags.declared_resets import declared_resets
from trajeval_ros.io.bags.pose_columns import Frames, PoseColumns
from trajeval_ros.io.bags.pose_messages import PATH_TYPE, decode_path, decode_poses
from trajeval_ros.io.bags.usable_poses import UsablePoses, usable_poses
from trajeval_ros.metrics.stream_health import UNKNOWN, StreamMonitor
from trajeval_ros.online.state_buffer import NO_STATES, StateCounts, joined
from trajeval_ros.ros.live_fixes import LiveFixes
from trajeval_ros.ros.timing import Arrivals, ComparedClocks

_MOST_REMARKS, _MOST_RESETS = 20, 100
_STEPS_BACK = "time_steps_back"  # code of a remark
_STALE_AFTER_S, _STALE_PERIODS = 5.0, 3.0
_TROUBLE_AFTER = 10  # consecutive messages without a pose


@dataclass
class StreamStatus(StateCounts):
    """Counts, frames and remarks of a stream in one run; it drops messages without a pose."""

    frame: str = ""  # frame of the poses, from the first message
    child_frame: str = ""  # name of their body
    remarks: list[Remark] = field(default_factory=list)  # also changes during the run
    resets: list[DeclaredReset] = field(default_factory=list)  # the first declared ones
    datum: Datum | None = None  # origin of GNSS fixes; None before the first one
    stream: StreamMonitor = field(default_factory=StreamMonitor)  # rate, gaps and delays

    def note(self, remark: Remark) -> bool:
        """Store a new remark, up to a limit; return whether it was stored."""
        if len(self.remarks) >= _MOST_REMARKS or remark in self.remarks:
            return False
        self.remarks.append(remark)
        return True

    def has(self, code: str) -> bool:
        """Return whether there is a remark with a code."""
        return any(remark.code == code for remark in self.remarks)


class PoseStream:
    """Decodes the messages of one topic."""

    def __init__(
        self, topic: str, *, covariances: bool = False, fixes: LiveFixes | None = None
    ) -> None:
        self._covariances = covariances  # whether to decode those of messages
        self.fixes = fixes or LiveFixes()  # selects GNSS fixes, if the topic carries fixes
        self.status = StreamStatus()
        self.arrivals = Arrivals()  # delay of messages relative to their timestamps
        self.clocks = ComparedClocks()  # of an estimate and the groundtruth
        self.news: list[Remark] = []  # remarks that are not published yet
        self.trouble: Remark | None = None  # why messages currently contain no valid poses
        self.heard_at: float | None = None  # by `time.monotonic`
        self.starts_new_run = False  # whether a step back of time begins a new run
        self.is_receiver = False  # whether `as_received` is called
        self._topic = topic
        self._type = ""
        self._frames: Frames | None = None
        self._previous: int | None = None
        self._trust = OutlierStamps()
        self._newest_stamp = 0  # of the newest usable pose
        # States whose timestamps are under test; states are numbered in order of arrival.
        self._held, self._number = NO_STATES, 0
        self.resets: list[int] = []  # timestamps of declared resets that are not taken yet
        self._counted: PoseColumns | None = None  # the newest pose with a reset counter
        self._in_a_row: dict[str, int] = {}  # unusable messages since the last pose
        self._is_told = False

    def begin_run(self, status: StreamStatus) -> None:
        """Count messages in the status of another run from now on."""
        before, self.status = self.status, status
        status.frame, status.child_frame = before.frame, before.child_frame
        if self._frames is not None:
            _, status.frame, status.child_frame = self._frames
        status.remarks += [remark for remark in before.remarks if remark.code == FORMAT]
        status.datum = self.fixes.datum
        for trust in self._all_trusts:
            trust.isolated = trust.farthest_ns = 0

    def reset(self) -> None:
        """Forget earlier messages: their time, and the origin of fixes."""
        self._trust, self._held = OutlierStamps(), NO_STATES
        self._previous, self.fixes.datum = None, None

    def forget_clocks(self) -> None:
        """Compare clocks from now on; the previous run must be closed."""
        self.arrivals, self.clocks = Arrivals(), ComparedClocks()

    @property
    def _all_trusts(self) -> Iterable[OutlierStamps]:
        return [self._trust]

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
    ) -> tuple[Trajectory, Indices]:
        """Return the states of messages that arrived at times (N,), nanoseconds.

        They have their receive times. The second value are the rows of their messages.
        """
        self._see_type(message_type)
        columns = decode_poses(
            payloads, message_type, covariance=self._covariances, rates=self.is_receiver
        )
        if columns.fix_quality is not None:
            states, rows = self._fix_states(columns, arrived_ns)
            self.status.stream.add(states.stamps, arrivals_of(states))
        else:
            states, rows = self._trusted(*self._states(columns, arrived_ns))
        self.arrivals.see(states.stamps, arrived_ns[rows])
        self._count(states.stamps)
        return states, rows

    def as_received(self, poses: Trajectory) -> Trajectory:
        """Return poses, not of a path, as the as-available accuracy uses them."""
        return poses

    def last_poses(self) -> Trajectory:
        """Return the states whose timestamps are still under test, at the end of the run."""
        states, _ = self._trusted(NO_STATES, NO_STATES.stamps, at_end=True)
        self._count(states.stamps)
        return states

    def path(self, payload: bytes) -> Trajectory:
        """Return all states of a path; `count_new` counts those that are new.

        States with an isolated timestamp are counted with every path that contains them.
        """
        self._see_type(PATH_TYPE)
        columns = decode_path(payload)
        states, _ = self._states(columns, np.full(len(columns.stamps), UNKNOWN))
        rows, trust = trusted_states(states.stamps)
        self._tell_lone(trust)
        return states[rows]

    def count_new(self, new: Trajectory, arrived_ns: int) -> None:
        """Count the new states of a path that arrived at a time, nanoseconds."""
        self.arrivals.see(new.stamps[-1:], np.array([arrived_ns]))
        self.status.stream.add(new.stamps[-1:], np.array([arrived_ns])[: len(new)])
        self._count(new.stamps)

    def _see_type(self, message_type: str) -> None:
        self.heard_at = time.monotonic()
        if message_type != self._type:
            self._type = message_type
            self.status.note(note(FORMAT, f"format: {message_type}"))

    def _usable(self, columns: PoseColumns) -> UsablePoses:
        """Return the poses with a timestamp; count the others and note changes of frames."""
        usable = usable_poses(columns, columns.stamps != 0, self._frames)
        for reason, number in usable.dropped.items():
            self.status.drop(reason, number)
        if columns.frames:
            if self._frames is None:
                _, self.status.frame, self.status.child_frame = columns.frames[0]
            self._frames = columns.frames[-1]
        for one, other in usable.frame_changes:
            before, now = (" of ".join(filter(None, item[:0:-1])) for item in (one, other))
            text = f"{self._topic}: the frame changes from {before} to {now}"
            self._tell("frame_changed", "frame", text)
        return usable

    def _states(self, columns: PoseColumns, arrived_ns: Stamps) -> tuple[Trajectory, Indices]:
        """Return the valid poses, and the rows of their messages; count the others."""
        columns, velocities, dropped, _ = self._usable(columns)
        self._see_resets(columns)
        finite, nonzero = valid_mask(columns.positions, columns.quaternions)
        states = Trajectory.from_columns(
            columns.stamps,
            columns.positions,
            columns.quaternions,
            velocities=velocities,
            covariances=columns.covariances,
            reading=SourceInfo(receive_times=_received(columns, arrived_ns)),
        )
        if states.covariances is not None and not states.covariances.any():
            states = replace(states, covariances=None)  # zeros mean unknown
        for reason, number in states.reading.dropped.items():
            self.status.drop(reason, number)
        stamps = states.stamps
        repeated = np.diff(stamps, prepend=self._newest_stamp) == 0
        self._newest_stamp = int(stamps[-1]) if len(stamps) else self._newest_stamp
        count = int(np.count_nonzero(repeated))
        dropped = add_counts(dropped, states.reading.dropped, {"duplicate_stamp": count})
        self._see_trouble(len(stamps) - count, dropped)
        return states, columns.rows[finite & nonzero]

    def _see_resets(self, columns: PoseColumns) -> None:
        """Store the resets that poses declare, also relative to the pose before them."""
        if columns.flags is None or not len(columns.stamps):
            return
        joined = columns if self._counted is None else self._counted.joined(columns)
        resets = declared_resets(joined)
        self.resets += [item.stamp_ns for item in resets]
        self.status.resets = [*self.status.resets, *resets][:_MOST_RESETS]
        self._counted = columns.rows_of(np.array([len(columns.stamps) - 1]))

    def _fix_states(self, columns: PoseColumns, arrived_ns: Stamps) -> tuple[Trajectory, Indices]:
        """Return the used fixes, in metres, without those that have no timestamp."""
        status = self.status
        antennas = [antenna for _, antenna, _ in columns.frames]
        frames = [(row, FRAME, antenna) for row, antenna, _ in columns.frames]
        usable = self._usable(replace(columns, frames=frames))
        columns = usable.columns
        assert columns.fix_quality is not None
        kept, positions, fixes, dropped = self.fixes.placed(
            columns.stamps, columns.positions, columns.fix_quality
        )
        status.datum = self.fixes.datum
        for reason, number in dropped.items():
            status.drop(reason, number)
        self._see_trouble(len(positions), add_counts(usable.dropped, dropped))
        if (mixed := self.fixes.mixed(antennas)) and status.note(note("frame_changed", mixed)):
            self.news.append(warning("data", f"{self._topic}: {mixed}"))
        columns = columns.rows_of(kept)
        reading = SourceInfo(fixes=fixes, receive_times=_received(columns, arrived_ns))
        return Trajectory(columns.stamps, positions, reading=reading), columns.rows

    def _trusted(
        self, new: Trajectory, rows: Indices, *, at_end: bool = False
    ) -> tuple[Trajectory, Indices]:
        """Return the states whose timestamps are trusted by now, and the rows of their messages.

        States that waited get the row of the first of these messages.
        """
        before, first = self._trust.isolated, self._number
        self._number += len(new)
        numbers, states = np.arange(first, self._number), new
        if len(self._held):
            states = joined(self._held, new)
            rows = np.concatenate([np.zeros(len(self._held), np.int64), rows])
            numbers = np.concatenate([self._trust.waiting[1], numbers])
        _, taken = self._trust.take(new.stamps, numbers[len(states) - len(new) :], at_end=at_end)
        held = self._trust.waiting[1] if self._trust.waiting else taken[:0]
        self._held = states[numbers.searchsorted(held)] if len(held) else NO_STATES
        trusted = numbers.searchsorted(taken)
        states, rows = states[trusted], rows[trusted]
        if len(states):
            self.status.stream.add(states.stamps, arrivals_of(states))
        if self._trust.isolated > before:
            self._tell_lone(self._trust)
            self.status.drop(LONE, self._trust.isolated - before)
        return states, rows

    def _tell_lone(self, trust: OutlierStamps) -> None:
        """Count isolated timestamps, and report them once."""
        if not trust.isolated:
            return
        if not self.status.has(LONE):
            self.news.append(warning("data", f"{self._topic}: {trust.message}"))
        others = [remark for remark in self.status.remarks if remark.code != LONE]
        self.status.remarks = [*others, note(LONE, trust.message)]

    def _see_trouble(self, poses: int, dropped: Mapping[str, int]) -> None:
        """Report once that messages arrive without valid poses.

        `poses` is the number of valid poses among new messages, `dropped` of others by reason.
        """
        self._in_a_row = {} if poses else add_counts(self._in_a_row, dropped)
        if poses:
            self.trouble = None
        elif sum(self._in_a_row.values()) >= _TROUBLE_AFTER:
            why = self.fixes.why_none or ", ".join(map(in_words, self._in_a_row))
            text = f"{self._topic}: no message with a valid pose ({why})"
            self.trouble = Remark(Level.ERROR, "data", text)
            if not self._is_told:
                self._is_told = True
                self.news.append(self.trouble)

    def _count(self, stamps: Stamps) -> None:
        if not len(stamps):
            return
        self.status.count(stamps)
        before, self._previous = self._previous, int(stamps[-1])
        steps = np.diff(stamps if before is None else np.concatenate([[before], stamps]))
        self._tell_step_back(-float(steps.min(initial=0)) / NANOSECONDS)

    def _tell_step_back(self, back_s: float) -> None:
        """Report once that time steps back, because live errors use the newest pairs only."""
        if self.starts_new_run:
            return  # the new run reports it
        if self.status.has(_STEPS_BACK) or back_s < NEAR_NS / NANOSECONDS:
            return
        text = (
            f"{self._topic}: timestamps step back by {back_s:.1f} s, as after a restart of a "
            "clock or bag; older poses are excluded from live values; to start a new run, "
            "call ~/reset or set on_time_jump"
        )
        self._tell(_STEPS_BACK, "restart", text, {"back_s": back_s})

    def _tell(
        self, code: str, event: str, text: str, values: Mapping[str, float] | None = None
    ) -> None:
        """Store a new note, and publish it as a warning with the code of an event."""
        if self.status.note(note(code, text)):
            self.news.append(warning(event, text, values=values))


def arrivals_of(states: Trajectory) -> Stamps:
    """Return the times of arrival of decoded states (N,), nanoseconds; may be `UNKNOWN`."""
    receive_times = states.reading.receive_times
    assert receive_times is not None
    return receive_times.times


def _received(columns: PoseColumns, arrived_ns: Stamps) -> ReceiveTimes:
    return ReceiveTimes(arrived_ns[columns.rows], "node", body_rates=columns.body_rates)
