"""The evaluation of one estimate in one run: from decoded messages to errors."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trajeval_ros.consistency.s_transformation import unknown_covariances
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.receptions import Receptions
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.geometry.vertical_axis import up_axis_doubt
from trajeval_ros.io.live.state_file import (
    REVISED_SUFFIX,
    StateWriter,
    copy_states,
    file_of_estimate,
)
from trajeval_ros.io.writing import write_whole
from trajeval_ros.metrics.association import AT_GROUNDTRUTH
from trajeval_ros.metrics.stream_health import UNKNOWN
from trajeval_ros.online.alarms import Peaks, Standing
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.jump_detector import Jump, JumpDetector
from trajeval_ros.online.live_availability import LiveAvailability, message_rows
from trajeval_ros.online.live_clock import ClockReport, OnlineClock
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.pairing import PairedStates
from trajeval_ros.online.reports import Snapshot, Update, united
from trajeval_ros.online.state_rows import (
    COVARIANCE,
    POSITION,
    WIDTH,
    Pairs,
    trajectory,
)
from trajeval_ros.online.whole_run import RevisedPath, ThinnedRun
from trajeval_ros.ros.marker_body import MarkerBody
from trajeval_ros.ros.pose_source import PoseSource
from trajeval_ros.ros.poses import StateColumns, StreamStatus
from trajeval_ros.ros.slow_evaluation import SlowEvaluation
from trajeval_ros.ros.timing import Latency


class DecodedMessages(NamedTuple):
    """Messages of one source: some poses, or one path.

    Times (N,) are those of reception by the middleware; for a path, its time of arrival.
    """

    states: StateColumns
    times: Stamps
    is_path: bool = False

    @property
    def stamps(self) -> Stamps:
        """Timestamps for the detection of steps back; a path has only that of its last pose."""
        return self.states.stamps[-1:] if self.is_path else self.states.stamps

    def part(self, rows: slice) -> DecodedMessages:
        """Return some of the messages; a path has one part."""
        if self.is_path:
            return self
        return DecodedMessages(self.states.picked(rows), self.times[rows])


class LiveEstimate:
    """Evaluates one estimate in one run."""

    def __init__(
        self,
        source: PoseSource,
        settings: OnlineSettings,
        folder: Path,
        body: MarkerBody,
        clock: OnlineClock,
        description: Mapping[str, Any],
    ) -> None:
        self.source, self.name = source, source.name
        self.status = StreamStatus()
        self._body, self._description = body, {"name": self.name, **description}
        self.states_file = StateWriter(folder / file_of_estimate(self.name), self._description)
        self.until_ns: int | None = None  # border to the next run, by the groundtruth's clock
        self._newest_path: StateColumns | None = None  # as in its message
        self.evaluator = OnlineEvaluator(settings)
        self.jumps, self._found_jumps = JumpDetector(), list[Jump]()
        self.ends_at_jump = False  # whether the run ends at the first jump
        self.restarted_at: int | None = None  # timestamp of the first pair after that jump
        self.latency, self.thinned = Latency(), ThinnedRun()
        self.revised: RevisedPath | None = None  # the newest path, if the topic carries paths
        self.on_pairs: Callable[[LiveEstimate, Pairs], object] | None = None  # draws them
        self.clock = clock  # estimate of its clock offset; none if the topic carries paths
        self.peaks, self.standing = Peaks(), Standing()  # peaks since the last status
        self.slow = SlowEvaluation()  # hints, and the errors of the newest path
        self._given_up = None if settings.up is None else settings.up[1]
        self._paired_at = 0.0
        self._updates: list[Update] = []
        self._newest: tuple[int, Floats] | None = None  # timestamp and state (1, k) of a message
        self._undigested: list[Pairs] = []
        self.availability: LiveAvailability | None = None  # as-available, if requested
        if settings.available.is_asked_for:
            source.stream.is_receiver = True
            self.availability = LiveAvailability(
                settings.available,
                settings.protocol.association.max_gap_s,
                settings.limits.past_s,
            )

    def continue_after(self, before: LiveEstimate) -> None:
        """Take what the previous run received and did not use, and what it knows."""
        self.jumps, self.clock = before.jumps, before.clock  # the usual step size, and the offset
        self._found_jumps, before._found_jumps = before._found_jumps, []
        self.evaluator.frames = copy(before.evaluator.frames)
        before.until_ns = self.evaluator.continue_after(before.evaluator)
        taken = self.evaluator.buffer.estimate.stamps - before.offset_ns
        copy_states(before.states_file.path, self.states_file, taken)

    def share_groundtruth(self, before: LiveEstimate) -> None:
        """Copy the newest groundtruth states, of the evaluated body, from the previous run."""
        self.evaluator.add_groundtruth(before.evaluator.buffer.groundtruth.trajectory())

    def begin_to_evaluate(self, offset_s: float) -> None:
        """Use a clock offset, seconds, and the marker pose from now on."""
        self.evaluator.set_offset(offset_s)
        hand_eye = self._body.hand_eye
        if hand_eye is not None and not self._body.of_marker:
            self.evaluator.judge_moved_groundtruth(hand_eye)

    @property
    def up(self) -> UpAxis:
        """The up axis of its frame."""
        return self.source.stream.up(self._given_up)

    @property
    def offset_ns(self) -> int:
        """Clock offset that is added to its timestamps, nanoseconds."""
        return self.evaluator.settings.offset_ns

    def see(self, messages: DecodedMessages) -> None:
        """Store messages, and use them for what precedes the evaluation: clock and kind."""
        if not messages.is_path:
            states = messages.states
            self.states_file.append(states.stamps, states.states, states.arrived)
            self.clock.add_estimate(trajectory(states.stamps, states.states))
        elif self.revised is None:
            self.revised = RevisedPath(self.evaluator.settings.protocol.gauge, self.up)
            reason = "paths are revised during the run, so their clock can't be estimated"
            self.clock.report = ClockReport(status="unobservable", reason=reason)

    def take(self, messages: DecodedMessages) -> None:
        """Evaluate messages that `see` has seen, at the next update."""
        poses = messages.states
        rows = self._body.estimated(poses.states)
        if messages.is_path:
            assert self.revised is not None
            new = self.revised.renew(poses.stamps, rows)
            first = poses.picked(new)
            self.states_file.append(first.stamps, first.states)
            self._newest_path = poses
            self.source.stream.count_new(first, int(messages.times[0]))
            newest = poses.picked(poses.stamps.argsort(kind="stable")[-1:])
            self._receive(newest._replace(arrived=messages.times[: len(newest.stamps)]))
            self._add(poses.stamps[new], rows[new])
            return
        if len(poses.stamps):
            self._newest = int(poses.stamps[-1]), poses.states[-1:]
        resets, self.source.stream.resets = self.source.stream.resets, []
        self.jumps.declare(each + self.offset_ns for each in resets)
        if self.availability is not None:
            self._receive(self.source.stream.as_received(poses))
        self.latency.arrive(poses.stamps + self.offset_ns, messages.times)
        self._add(poses.stamps, rows)

    def _add(self, stamps: Stamps, rows: Floats) -> None:
        block = trajectory(stamps, rows, self.up)
        self.evaluator.add_estimate(block, block.reading.dropped)

    def _receive(self, poses: StateColumns) -> None:
        times = poses.arrived
        if self.availability is not None and times is not None:
            poses, times = poses.picked(times != UNKNOWN), times[times != UNKNOWN]
            receptions = Receptions(times, "node", None, poses.body_rates, poses.corrected)
            self.states_file.append_received(message_rows(poses.stamps, poses.states, receptions))
            rows = self._body.estimated(poses.states)
            self.availability.add_estimate(poses.stamps, rows, receptions)

    def evaluate(self, *, at_end: bool = False) -> None:
        """Evaluate the pairs that are possible now, up to a jump that ends the run."""
        if self.restarted_at is not None and not at_end:
            return  # what waits belongs to the next run, which takes it before the end
        pairs = self.evaluator.made(at_end=at_end)
        if self.ends_at_jump and pairs is not None:
            pairs = self._until_jump(pairs)
        self.evaluator.buffer.settle(self.restarted_at)
        if pairs is not None and len(pairs):
            self._paired_at = time.monotonic()
            narrow = pairs.rows.without_covariances()
            self._undigested.append(narrow)
            if self.on_pairs is not None:
                self.on_pairs(self, narrow)
        self._updates.append(self.evaluator.evaluate(pairs, at_end=at_end))

    @property
    def unpaired_s(self) -> float:
        """Time since the newest pair was made, seconds."""
        return time.monotonic() - self._paired_at

    def update(self, *, at_end: bool = False) -> Update:
        """Evaluate the messages that have arrived, and return the new errors."""
        self.evaluate(at_end=at_end)
        updates, self._updates = self._updates, []
        return united(updates)

    def _until_jump(self, pairs: PairedStates) -> PairedStates:
        narrow, detector = pairs.rows.without_covariances(), copy(self.jumps)
        found = detector.update(narrow, self._scale)
        if not found:
            self.jumps = detector
            return pairs
        self.restarted_at = found[0].stamp
        row = int(pairs.stamps.searchsorted(self.restarted_at))
        self._found_jumps = self.jumps.update(narrow.picked(slice(row + 1)), self._scale)
        self.jumps.count = 0  # a run contains no jump
        return pairs.part(slice(row))

    @property
    def _scale(self) -> float:
        alignment = self.evaluator.alignment
        return 1.0 if alignment is None else alignment.similarity.scale

    def snapshot(self) -> Snapshot:
        """Return the state of the evaluation, without what is withheld."""
        stamps, groundtruth, _ = self.thinned.columns()
        if len(stamps):
            up = self.evaluator.frames.groundtruth_up
            self.evaluator.up_axis_doubt = up_axis_doubt(trajectory(stamps, groundtruth, up))
        return self.evaluator.snapshot()

    def digest(self) -> list[Jump]:
        """Add the pairs since the last call to thinned and revision; return their jumps.

        Jumps of an estimate that has lost track are no restarts, and are left out.
        This is separate from `update`, since a few calls per second are enough.
        """
        if self._undigested:
            pairs, self._undigested = Pairs.in_order(self._undigested), []
            if not self.ends_at_jump:
                self._found_jumps += self.jumps.update(pairs, self._scale)
            self.thinned.add(pairs)
            if self.revised is not None:  # by the estimate's own clock
                self.revised.record(pairs._replace(stamps=pairs.stamps - self.offset_ns))
        found, self._found_jumps = self._found_jumps, []
        return found if self.evaluator.tracking.present is None else []

    def renew_slow(self, groundtruth_body: str) -> bool:
        """Run the slow evaluation; return whether the newest path has been evaluated.

        `groundtruth_body` is the name of the groundtruth's body.
        """
        evaluator = self.evaluator
        protocol = evaluator.settings.protocol
        if evaluator.frozen_at is not None:
            protocol = replace(protocol, align_states=evaluator.frozen_at)
        return self.slow.renew(
            self.thinned,
            None if self.why_not_revised else self.revised,
            protocol,
            (evaluator.frames.groundtruth_up, self.up),
            self._body.renamed(groundtruth_body, self.status.child_frame),
            evaluator.tracking.losses,
            of_clocks=self.clock.report.offset_s is None,
        )

    def uncertainty(self) -> tuple[int, Floats, Floats] | None:
        """Return timestamp, position (3,) and its covariance (3, 3) of the newest message.

        They refer to the evaluated body, with the clock offset applied, as in pairs. None without
        a message, or if its covariance is unknown.
        """
        if self._newest is None or self._newest[1].shape[1] == WIDTH:
            return None
        stamp, row = self._newest
        # `unknown_covariances` accepts zeros in the first covariance, so it is passed twice.
        if unknown_covariances(row[:, COVARIANCE].reshape(1, 6, 6).repeat(2, 0)):
            return None
        [moved] = self._body.estimated(row)
        if not np.isfinite(moved[POSITION]).all():
            return None
        return stamp + self.offset_ns, moved[POSITION], moved[COVARIANCE].reshape(6, 6)[:3, :3]

    @property
    def why_not_revised(self) -> str:
        """Why errors do not refer to the newest path; empty if they do, or there is no path."""
        evaluator = self.evaluator
        has_points = evaluator.rule.method == AT_GROUNDTRUTH
        if self.revised is None or not (has_points or evaluator.settings.protocol.lever_m):
            return ""
        return (
            "errors are those of poses as first published: live, a revised path is not compared "
            "with fixes or points, or by a lever arm; evaluate a recording"
        )

    def write_revised(self) -> None:
        """Write the newest path as in its message, if there is one."""
        newest = self._newest_path
        if newest is None or not len(newest.stamps):
            return

        def write(path: Path) -> None:
            path.unlink(missing_ok=True)
            file = StateWriter(path, self._description)
            file.append(newest.stamps, newest.states)
            file.close()

        write_whole(self.states_file.path.with_suffix(REVISED_SUFFIX), write)

    def close(self) -> None:
        """Write everything to disk."""
        self.slow.close()
        try:
            self.write_revised()
        finally:
            self.states_file.close()
