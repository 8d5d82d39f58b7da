"""The evaluation of one estimate: from messages to errors and a pair file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from trajeval_ros.diagnosis.vertical import doubt_of
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.dropped_counts import add_counts
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.marker import BODYS_VELOCITIES
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.metrics.association import AT_GROUNDTRUTH
from trajeval_ros.online.alarms import Peaks
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.jump_detector import Jump
from trajeval_ros.online.live_clock import ClockReport, OnlineClock
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.notices import Standing
from trajeval_ros.online.reports import Snapshot, Update, united
from trajeval_ros.online.revised import RevisedPath
from trajeval_ros.online.state_rows import Pairs, trajectory
from trajeval_ros.online.trail import Trail
from trajeval_ros.ros.estimate_topic import EstimateTopic
from trajeval_ros.ros.held_messages import HeldCall, HeldMessages
from trajeval_ros.ros.poses import PoseStream, StateColumns
from trajeval_ros.ros.position_uncertainty import position_uncertainty
from trajeval_ros.ros.segment_files import SegmentFiles
from trajeval_ros.ros.segment_jumps import SegmentJumps
from trajeval_ros.ros.slow_evaluation import SlowEvaluation
from trajeval_ros.ros.timing import Latency


class LiveEstimate:
    """Evaluates one estimate topic.

    Attributes:
        side: Source of its messages.
        name: Its name in topics and files.
        segment: Number of the segment in the folder, from 1.
        epoch: Number of steps back of time before this segment.
        began_by: Why a new segment started; empty for the first one.
        files: Its files.
        stream: Decodes its messages.
        evaluator: Its evaluation.
        latency: Time from arrival to publication of its errors.
        jumps: Restarts and corrections of the estimate; the first one may end the segment.
        clock: Estimate of its clock offset; none if the topic carries paths.
        trail: The run, thinned to few poses.
        revised: The newest path, if the topic carries paths.
        watch: Receives all new pairs, to draw them.
        peaks: The largest errors since the last status.
        slow: Hints, and the errors of the newest path.
        standing: Reported conditions that still hold.
        newest: Type and bytes of the newest message; None before the first one and for paths.
        doubt: Why the groundtruth's up axis is probably wrong, at the newest snapshot; empty if it
            is plausible.
    """

    def __init__(
        self,
        topic: EstimateTopic,
        settings: OnlineSettings,
        folder: Path,
        *,
        hold: bool = False,
        after: LiveEstimate | None = None,
        began_by: str = "",
    ) -> None:
        """Create it with an empty pair file.

        Args:
            topic: The topic.
            settings: Settings of the evaluation.
            folder: Folder for its files.
            hold: Whether to store messages until `release` sets the clock offset.
            after: The previous segment of the same topic.
            began_by: As in the attribute.

        Raises:
            InputError: The file can't be made.
        """
        self.side, self.name, self.stream = topic.side, topic.side.name, topic.side.stream
        self._body, self._worker = topic.body, topic.worker
        self.began_by = began_by
        self.folder = folder
        self.segment: int = 1 if after is None or after.folder != folder else after.segment + 1
        self.epoch: int = 0 if after is None else after.epoch
        self._dropped_before = {
            id(each.stream): dict(each.stream.status.dropped)
            for each in (topic.side, topic.groundtruth)
        }
        self._dropped_until: dict[int, dict[str, int]] | None = None
        self.files = SegmentFiles(folder, self.name, self.segment, topic.description)
        if after is not None:  # which closes later
            after._dropped_until = self._dropped_before
        before = None if after is None else after.jumps
        self.jumps: SegmentJumps = SegmentJumps(splits=topic.splits, before=before)
        # The evaluator has no reference to this segment, so a complete segment can be freed.
        self.evaluator = OnlineEvaluator(
            settings,
            record_waypoints=self.files.pairs.append_waypoints,
            buffer=None if before is None else before.following,
        )
        self.latency, self.trail = Latency(), Trail()
        self.revised: RevisedPath | None = None
        self.watch: Callable[[LiveEstimate, Pairs], object] | None = None
        self.clock = OnlineClock(settings.protocol.gauge, self._worker)
        self.peaks, self.standing = Peaks(), Standing()
        self.slow = SlowEvaluation()
        self.doubt = ""
        self._given_up = None if settings.up is None else settings.up[1]
        self._held = HeldMessages() if hold else None
        self._held_for_next: Sequence[HeldCall] = ()
        self._released: list[Update] = []
        self.newest: tuple[str, bytes] | None = None
        self._undigested: list[Pairs] = []
        if after is not None:
            self._follow(after)

    def _follow(self, before: LiveEstimate) -> None:
        """Take over the state that is common to all segments."""
        self.latency, self.peaks, self.standing = before.latency, before.peaks, before.standing
        self.watch = before.watch
        self.evaluator.set_offset(before.evaluator.settings.offset_s)
        self._judge_by_body()
        self.evaluator.frames.groundtruth_up = before.evaluator.frames.groundtruth_up
        self.evaluator.frames.estimate_up = before.evaluator.frames.estimate_up
        self._take_held(before._held_for_next)

    def set_gauge(self, gauge: Gauge) -> None:
        """Set another gauge; call it before the first groundtruth."""
        self.evaluator.set_gauge(gauge)
        self.clock = OnlineClock(gauge, self._worker)

    def add_groundtruth(self, stamps: Stamps, rows: Floats) -> None:
        """Add groundtruth states: timestamps (N,) and rows (N, 10)."""
        self.clock.add_groundtruth(stamps, rows)
        if self._held is not None and not self._held.calls and not self._body.is_wanted:
            # No estimate is stored so far. The evaluator drops old groundtruth itself.
            self.evaluator.add_groundtruth(stamps, rows)
        else:
            self._now_or_later(
                "groundtruth",
                stamps,
                lambda segment: segment.evaluator.add_groundtruth(stamps, self._body.truth(rows)),
            )

    def share_groundtruth(self, other: LiveEstimate) -> None:
        """Copy the newest groundtruth states, of the evaluated body, from another segment."""
        self.evaluator.add_groundtruth(*other.evaluator.buffer.newest_groundtruth)

    @property
    def up(self) -> UpAxis:
        """The up axis of its frame."""
        return self.stream.up(self._given_up)

    @property
    def offset_ns(self) -> int:
        """Clock offset that is added to its timestamps, nanoseconds."""
        return self.evaluator.settings.offset_ns

    @property
    def held_s(self) -> float:
        """Time span of the stored messages, seconds."""
        return 0.0 if self._held is None else self._held.span_s

    def release(self, offset_s: float) -> None:
        """Evaluate the stored messages with a clock offset, seconds, and use it from now on."""
        assert self._held is not None
        self.evaluator.set_offset(offset_s)
        self._judge_by_body()
        if self.revised is not None:
            self.revised.states = self._body.estimated(self.revised.states)
        held, self._held = self._held, None
        self._take_held(held.calls)

    def _judge_by_body(self) -> None:
        """Use the marker pose in the test of covariances."""
        hand_eye = self._body.hand_eye
        if hand_eye is not None and not self._body.of_marker:
            self.evaluator.judge_moved_groundtruth(hand_eye)

    def _take_held(self, calls: Sequence[HeldCall]) -> None:
        """Evaluate stored messages up to a jump; later ones belong to the next segment."""
        for place, (side, call) in enumerate(calls, start=1):
            call(self)
            # One by one, as if messages arrived now, so that the buffers stay small. Groundtruth
            # is kept until the estimates that arrived with it are paired.
            if side == "estimate":
                self._released.append(self._evaluate_new())
                if self.jumps.following is not None:
                    self._held_for_next = calls[place:]
                    return

    def take(self, poses: StateColumns, received: Stamps) -> None:
        """Add states and their times of reception, (N,), nanoseconds since 1970."""
        self.evaluator.frames.estimate_up = self.up
        self.clock.add_estimate(poses.stamps, poses.states)
        self._now_or_later(
            "estimate", poses.stamps, lambda segment: segment._evaluate(poses, received)
        )

    def update(self, *, at_end: bool = False) -> Update:
        """Evaluate the messages that have arrived, write the pairs, and return the new errors."""
        released, self._released = self._released, []
        return united([*released, self._evaluate_new(at_end=at_end)])

    def _evaluate_new(self, *, at_end: bool = False) -> Update:
        """Evaluate the pairs that are possible now, up to a jump that ends the segment."""
        buffer = self.evaluator.buffer
        pairs = self.evaluator.frames.of_same_point(buffer.made(at_end=at_end))
        pairs = self.jumps.before_first(pairs, self._scale, buffer)
        buffer.settle()
        if len(pairs.stamps):
            self._record(pairs)
        return self.evaluator.evaluate(pairs, at_end=at_end)

    @property
    def _scale(self) -> float:
        alignment = self.evaluator.alignment
        return 1.0 if alignment is None else alignment.similarity.scale

    def snapshot(self) -> Snapshot:
        """Return the state of the evaluation, without yaw and tilt if the up axis is doubtful."""
        snapshot = self.evaluator.snapshot()
        stamps, truth, _ = self.trail.columns()
        if len(stamps):
            self.doubt = doubt_of(trajectory(stamps, truth, self.evaluator.frames.groundtruth_up))
        if not self.doubt:
            return snapshot
        return replace(snapshot, ate={**snapshot.ate, "yaw_deg": None, "tilt_deg": None})

    def digest(self) -> list[Jump]:
        """Add the pairs since the last call to trail and revision; return their jumps.

        This is separate from `update`, since a few calls per second are enough.
        """
        if not self._undigested:
            return self.jumps.take()
        pairs, self._undigested = Pairs.in_order(self._undigested), []
        self.jumps.among(pairs, self._scale)
        self.trail.add(pairs)
        if self.revised is not None:  # by the estimate's own clock
            self.revised.record(pairs._replace(stamps=pairs.stamps - self.offset_ns))
        return self.jumps.take()

    def renew_slow(self, truth_body: str) -> bool:
        """Run the slow evaluation; return whether the newest path has been evaluated.

        Args:
            truth_body: Name of the body that the groundtruth is of.
        """
        evaluator = self.evaluator
        protocol = evaluator.settings.protocol
        if evaluator.frozen_at is not None:
            protocol = replace(protocol, align_states=evaluator.frozen_at)
        return self.slow.renew(
            self.trail,
            None if self.why_not_revised else self.revised,
            protocol,
            (evaluator.frames.groundtruth_up, self.up),
            self._body.renamed(truth_body, self.stream.status.child_frame),
            of_clocks=self.clock.report.offset_s is None,
        )

    def uncertainty(self) -> tuple[int, Floats, Floats] | None:
        """Return timestamp, position (3,) and its covariance (3, 3) of the newest message.

        They refer to the evaluated body, with the clock offset applied, as in pairs.

        Returns:
            None if there is no message, or its covariance is unknown.
        """
        told = self.newest and position_uncertainty(*self.newest, self._body)
        if not told:
            return None
        stamp, position, covariance = told
        return stamp + self.offset_ns, position, covariance

    def dropped_since_begun(self, stream: PoseStream) -> dict[str, int]:
        """Return the number of messages without a pose in this segment so far, by reason."""
        until = self._dropped_until
        before = self._dropped_before[id(stream)]
        now = stream.status.dropped if until is None else until[id(stream)]
        return add_counts({each: count - before.get(each, 0) for each, count in now.items()})

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
        """Write the newest path, if there is one.

        Raises:
            InputError: It can't be written.
        """
        if self.revised is not None and not self.why_not_revised:
            self.files.write_path(self.revised, self.offset_ns)

    def _record(self, pairs: Pairs) -> None:
        """Write new pairs to disk before anything else."""
        self.files.pairs.append(*pairs)
        pairs = pairs.without_covariances()
        self._undigested.append(pairs)
        if self.watch is not None:
            self.watch(self, pairs)

    def take_path(self, path: StateColumns, arrived_ns: int) -> None:
        """Add a path: evaluate its new poses, and store the revision of the others."""
        self.evaluator.frames.estimate_up = self.up
        if self.revised is None:
            self.revised = RevisedPath(self.evaluator.settings.protocol.gauge, self.up)
            reason = "paths are revised during the run, so their clock can't be estimated"
            self.clock.report = ClockReport(status="unobservable", reason=reason)
        states = self._body.estimated(path.states)
        new = path.picked(self.revised.renew(path.stamps, states))
        self.stream.count_new(new, arrived_ns)
        self._now_or_later(
            "estimate",
            new.stamps,
            lambda segment: segment.evaluator.add_estimate(
                new.stamps, self._body.estimated(new.states)
            ),
        )

    def close(self) -> None:
        """Write everything to disk.

        Raises:
            InputError: The files can't be written.
        """
        self.slow.close()
        try:
            self.write_revised()
        finally:
            self.files.pairs.close()

    def _evaluate(self, poses: StateColumns, received: Stamps) -> None:
        self.latency.arrive(poses.stamps + self.offset_ns, received)
        left_out = self._body.leaves_out_velocities_of(poses.states, is_truth=False)
        if left_out or self.evaluator.frames.leaves_out_velocities_of(poses.states):
            self.stream.status.note(BODYS_VELOCITIES)
        self.evaluator.add_estimate(poses.stamps, self._body.estimated(poses.states))

    def _now_or_later(
        self, side: str, stamps: Stamps, evaluate: Callable[[LiveEstimate], None]
    ) -> None:
        if self._held is None:
            evaluate(self)
        elif len(stamps):
            self._held.add(side, stamps, evaluate)
