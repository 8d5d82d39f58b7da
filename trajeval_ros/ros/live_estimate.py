"""The evaluation of one estimate in one run: from decoded messages to errors."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from trajeval_ros.consistency.s_transformation import unknown_covariances
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.source_info import ReceiveTimes, SourceInfo
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.geometry.vertical_axis import up_axis_doubt
from trajeval_ros.io.live.state_file import (
    REVISED_SUFFIX,
    StateWriter,
    file_of_estimate,
)
from trajeval_ros.io.writing import write_whole
from trajeval_ros.metrics.association_rule import AT_GROUNDTRUTH
from trajeval_ros.metrics.coverage import StampedPoses
from trajeval_ros.metrics.discontinuities.events import (
    DECLARED,
    ESTIMATE,
    GROUNDTRUTH,
    PARTING,
    RESTART,
    Event,
)
from trajeval_ros.metrics.stream_health import UNKNOWN
from trajeval_ros.online.alarms import ActiveAlarms, MaxSinceLast
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_availability import LiveAvailability
from trajeval_ros.online.live_clock import ClockReport, OnlineClock
from trajeval_ros.online.live_discontinuities import LiveDiscontinuities
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.pairing import PairedStates
from trajeval_ros.online.reports import Snapshot, Update, united
from trajeval_ros.online.state_buffer import NEVER
from trajeval_ros.online.whole_run import RevisedPath, ThinnedRun
from trajeval_ros.ros.marker_body import MarkerBody
from trajeval_ros.ros.message_tail import DecodedMessages
from trajeval_ros.ros.pose_source import PoseSource
from trajeval_ros.ros.poses import StreamStatus, arrivals_of
from trajeval_ros.ros.slow_evaluation import SlowEvaluation
from trajeval_ros.ros.timing import Latency

_MOST_RESETS = 100  # newest declared resets
_FOLLOWS_NS = NANOSECONDS  # both clocks of a computer step together; messages wait in queues


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
        self._newest_path: Trajectory | None = None  # as in its message
        self.evaluator = OnlineEvaluator(settings)
        self.discontinuities = LiveDiscontinuities()
        # The newest receive time by side, also when a step of a clock was first noticed.
        self._newest_received: dict[str, int] = {}
        self._suspected: Event | None = None
        self._suspected_at: dict[str, int] = {}
        self._begin_ns = NEVER  # earlier states belong to the previous run
        self.stepped: Event | None = None  # the step of a clock with which the run began
        self.ends_at_restart = False  # whether the run ends where the estimate restarts
        self.restarted_at: int | None = None  # timestamp of the first pair of the next run
        self._news: list[Event] = []  # events that are not published yet
        self._restarts: list[int] = []  # timestamps of first pairs after restarts
        self._has_fixes = False  # whose noise hides steps, as in a recording
        self._declared: deque[int] = deque(maxlen=_MOST_RESETS)  # those of declared resets
        self.latency, self.thinned = Latency(), ThinnedRun()
        self.revised: RevisedPath | None = None  # the newest path, if the topic carries paths
        self.on_pairs: Callable[[LiveEstimate, PairedStates], object] | None = None  # draws them
        self.clock = clock  # estimate of its clock offset; none if the topic carries paths
        self.peaks, self.standing = MaxSinceLast(), ActiveAlarms()  # peaks since the last status
        self.slow = SlowEvaluation()  # hints, and the errors of the newest path
        self._given_up = None if settings.up is None else settings.up[1]
        self._paired_at = 0.0
        self._first_pair: int | None = None  # its timestamp
        self._updates: list[Update] = []
        self.newest = Update()  # the newest one with pairs
        self.newest_snapshot: Snapshot | None = None
        self._newest: Trajectory | None = None  # the states of the newest messages
        self._undigested: list[PairedStates] = []
        self.availability: LiveAvailability | None = None  # as-available, if requested
        if settings.available.is_asked_for:
            source.stream.is_receiver = True
            self.availability = LiveAvailability(
                settings.available,
                settings.protocol.association,
                settings.limits.past_s,
            )

    def continue_after(self, before: LiveEstimate, begin_ns: int) -> None:
        """Continue with the states of the previous run from a timestamp on, nanoseconds."""
        self._begin_ns = before.until_ns = begin_ns
        self.clock = before.clock
        self._news = [event for event in before.digest() if event.end_ns <= begin_ns]

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
            self.states_file.append(messages.states)
            self.clock.add_estimate(messages.states)
        elif self.revised is None:
            self.revised = RevisedPath(self.evaluator.settings.protocol.gauge)
            reason = "paths are revised during the run, so their clock can't be estimated"
            self.clock.report = ClockReport(status="unobservable", reason=reason)

    def take(self, messages: DecodedMessages) -> None:
        """Evaluate messages that `see` has seen, at the next update."""
        decoded = replace(messages.states, up=self.up)
        states = self._body.estimated(decoded)
        if messages.is_path:
            assert self.revised is not None
            new = self.revised.renew(states)
            first = decoded[new]
            self.states_file.append(first)
            self._newest_path = decoded
            self.source.stream.count_new(first, int(messages.times[0]))
            newest = decoded[decoded.stamps.argsort(kind="stable")[-1:]]
            receive_times = ReceiveTimes(messages.times[: len(newest)], "node")
            self._receive(replace(newest, reading=SourceInfo(receive_times=receive_times)))
            self._add(states[new], None)
            return
        if len(decoded):
            self._newest = decoded
        for stamp in messages.resets:
            if stamp + self.offset_ns > self._begin_ns:
                self._declare(stamp + self.offset_ns)
        if self.availability is not None:
            self._receive(self.source.stream.as_received(decoded))
        self.latency.arrive(decoded.stamps + self.offset_ns, messages.times)
        self._add(states, arrivals_of(states))

    def take_groundtruth(self, states: Trajectory) -> None:
        """Take groundtruth states of the evaluated body."""
        self.evaluator.add_groundtruth(states)
        self._search(GROUNDTRUTH, StampedPoses.of(states), arrivals_of(states))
        self._has_fixes |= states.reading.fixes is not None
        if self.availability is not None:
            self.availability.add_groundtruth(states)

    def _add(self, states: Trajectory, arrived: Stamps | None) -> None:
        stamps, poses = StampedPoses.of(states)
        self._search(ESTIMATE, StampedPoses(stamps + self.offset_ns, poses), arrived)
        self.evaluator.add_estimate(states)

    def _search(self, side: str, states: StampedPoses, arrived: Stamps | None) -> None:
        """Search states (N,) of this run for discontinuities."""
        if arrived is not None and len(arrived):
            self._newest_received[side] = max(
                self._newest_received.get(side, NEVER), int(arrived.max())
            )
        if self._begin_ns > NEVER:
            rows = states.stamps >= self._begin_ns
            states = StampedPoses(states.stamps[rows], states.poses[rows])
            arrived = None if arrived is None else arrived[rows]
        self.discontinuities.add(side, states, arrived)

    def _receive(self, states: Trajectory) -> None:
        if self.availability is not None:
            known = states[arrivals_of(states) != UNKNOWN]
            self.states_file.append_received(known)
            self.availability.add_estimate(self._body.estimated(known))

    def evaluate(self, *, at_end: bool = False) -> None:
        """Evaluate the pairs that are possible now, until a restart is found that ends the run."""
        if self.restarted_at is not None or self.until_ns is not None:
            return  # the next run takes the messages since then
        pairs = self.evaluator.made(at_end=at_end)
        if pairs is not None:
            self._paired_at = time.monotonic()
            if self._first_pair is None:
                self._first_pair = int(pairs.stamps[0])
            self._undigested.append(pairs.without_covariances())
            if self.on_pairs is not None:
                self.on_pairs(self, pairs)
        self._updates.append(self.evaluator.evaluate(pairs, at_end=at_end))
        if self.ends_at_restart and not at_end:
            self._look_for_restart()

    @property
    def has_pairs(self) -> bool:
        """Whether there are pairs of this run."""
        first, until = self._first_pair, self.until_ns
        return first is not None and (until is None or first < until)

    @property
    def unpaired_s(self) -> float:
        """Time since the newest pair was made, seconds."""
        return time.monotonic() - self._paired_at

    def update(self, *, at_end: bool = False) -> Update:
        """Evaluate the messages that have arrived, and return the new errors."""
        self.evaluate(at_end=at_end)
        updates, self._updates = self._updates, []
        update = united(updates)
        self.newest = self.newest if update.stamp is None else update
        return update

    def examine(self, *, at_end: bool = False) -> None:
        """Search the states since the last call for discontinuities.

        `at_end`: no states will follow.
        """
        events = [
            event
            for event in self.discontinuities.examine(at_end=at_end)
            if not any(event.t_ns < stamp <= event.end_ns for stamp in self._declared)
        ]
        if self._has_fixes:
            self.discontinuities.events.clear()
        else:
            self._news += events
        if self.suspected_step is not self._suspected:
            self._suspected, self._suspected_at = self.suspected_step, dict(self._newest_received)
        self._restarts += [
            event.end_ns
            for event in events
            if event.kind in PARTING and event.side != GROUNDTRUTH and event.is_large
        ]

    @property
    def suspected_step(self) -> Event | None:
        """The newest step of one clock, which the other clock may follow."""
        return self.discontinuities.clock_step() or self.stepped

    @property
    def clock_step(self) -> Event | None:
        """The newest step of one clock that the other one did not follow within a second.

        None if the clocks agree as at the start. If both step, one is noticed first.
        """
        step = self.suspected_step
        waits = step is not self.stepped and any(
            self._newest_received[side] < received + _FOLLOWS_NS
            for side, received in self._suspected_at.items()
        )
        return None if waits else step

    def _declare(self, stamp: int) -> None:
        """Take a reset that the estimator declares, by the timestamp of the first pose after."""
        self._declared.append(stamp)
        self._restarts.append(stamp)
        self._news.append(Event(RESTART, ESTIMATE, stamp, stamp, certainty=DECLARED))

    def _look_for_restart(self) -> None:
        """End the run at the first restart, when no earlier one can be found any more."""
        self.examine()
        newest = self.evaluator.buffer.newest
        settled = self.discontinuities.settled_until(newest) + 1
        self.restarted_at = min((at for at in self._restarts if at <= settled), default=None)

    def snapshot(self) -> Snapshot:
        """Return the state of the evaluation, without what is withheld."""
        if len(self.thinned):
            self.evaluator.up_axis_doubt = up_axis_doubt(self.thinned.pairs().groundtruth)
        self.newest_snapshot = self.evaluator.snapshot()
        return self.newest_snapshot

    def digest(self) -> list[Event]:
        """Add the pairs since the last call to thinned and revision; return new events.

        Events of an estimate that has lost track are left out. This is separate from `update`,
        since a few calls per second are enough.
        """
        undigested, self._undigested = self._undigested, []
        for pairs in undigested:
            self.thinned.add(pairs)
            if self.revised is not None:
                self.revised.record(pairs, self.offset_ns)
        self.examine()
        news, self._news = self._news, []
        if self.evaluator.losses.present is None:
            return news
        return [event for event in news if event.side != ESTIMATE]

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
            self._body.renamed(groundtruth_body, self.status.child_frame),
            evaluator.losses.events,
            of_clocks=self.clock.report.offset_s is None,
        )

    def uncertainty(self) -> tuple[int, Floats, Floats] | None:
        """Return timestamp, position (3,) and its covariance (3, 3) of the newest message.

        They refer to the evaluated body, with the clock offset applied, as in pairs. None without
        a message, or if its covariance is unknown.
        """
        newest = None if self._newest is None else self._newest[-1:]
        if newest is None or newest.covariances is None:
            return None
        # `unknown_covariances` accepts zeros in the first covariance, so it is passed twice.
        if unknown_covariances(newest.covariances.repeat(2, 0)):
            return None
        moved = self._body.estimated(newest)
        if not len(moved) or moved.covariances is None:
            return None
        stamp = int(moved.stamps[0]) + self.offset_ns
        return stamp, moved.positions[0], moved.covariances[0, :3, :3]

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
        if newest is None or not len(newest):
            return

        def write(path: Path) -> None:
            path.unlink(missing_ok=True)
            file = StateWriter(path, self._description)
            file.append(newest)
            file.close()

        write_whole(self.states_file.path.with_suffix(REVISED_SUFFIX), write)

    def close(self) -> None:
        """Write everything to disk."""
        self.slow.close()
        try:
            self.write_revised()
        finally:
            self.states_file.close()
