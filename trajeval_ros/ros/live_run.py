"""One live run: a groundtruth, its estimates, and their output folder."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.formatting.remarks import Level, Remark
from trajeval_ros.geometry.arrays import Stamps
from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.live.fix_file import FixWriter
from trajeval_ros.io.live.state_file import GROUNDTRUTH, StateWriter
from trajeval_ros.io.requests.setting import AUTO
from trajeval_ros.metrics.association_rule import AT_GROUNDTRUTH
from trajeval_ros.metrics.discontinuities.events import Event
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_clock import OnlineClock
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.reports import Update
from trajeval_ros.online.state_buffer import NEVER
from trajeval_ros.pipeline.request import Request
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.marker_body import MarkerBody
from trajeval_ros.ros.message_tail import DecodedMessages, MessageTail
from trajeval_ros.ros.output_folder import Finisher
from trajeval_ros.ros.pose_source import PoseSource
from trajeval_ros.ros.poses import StreamStatus
from trajeval_ros.ros.start_decision import StartDecision

# A step of an estimate is decided within 12 s, and the next run begins at the step.
_TAIL_S = 15.0
_LONGEST_TAIL_S = 120.0  # limits memory, whatever delay is allowed
# States before the start is decided, also if timestamps do not advance: two minutes of both sides
# at 1 kHz.
_MOST_HELD = 250_000


@dataclass(frozen=True)
class RunPlan:
    """What the runs of a node have in common."""

    sources: Sequence[PoseSource]  # numbered: 0 is the groundtruth, and 1 the first estimate
    settings: OnlineSettings
    start: StartDecision
    worker: Executor  # estimates the clock offsets
    about: Mapping[str, Any] = field(default_factory=dict)  # the user's label and metadata
    gauge_is_default: bool = False  # then it is yaw for GNSS fixes


class LiveRun:
    """Passes the same groundtruth to every estimate, and stores the results on disk.

    `began_by` is the cause of a run that the user did not start.
    """

    def __init__(self, plan: RunPlan, folder: Path, began_by: str = "") -> None:
        sources, settings, start = plan.sources, plan.settings, plan.start
        self.plan, self.start = plan, start
        self.groundtruth, self.folder, self.began_by = sources[0], folder, began_by
        self.idle = ""  # why messages are dropped; empty while they are evaluated
        self.groundtruth_status = StreamStatus()
        about_groundtruth = {"source": sources[0].source, "name": sources[0].name}
        self.states_file = StateWriter(folder / GROUNDTRUTH, about_groundtruth)
        self.finisher = Finisher(folder)  # writes result.json in another process
        self.on_groundtruth: Callable[[Trajectory], object] | None = None  # draws it
        self.news: list[Remark] = []  # remarks that are not published yet
        self._settings, self._tail = settings, MessageTail()
        self._fixes: FixWriter | None = None
        # Newest timestamp and number of groundtruth poses at the first estimate, if it is held.
        self._held_from: tuple[int, int] | None = None
        self._given_up = None if settings.up is None else settings.up[0]
        self.holds = start.holds  # whether messages are only kept, before the start is decided
        self.estimates = [
            LiveEstimate(
                source,
                settings,
                folder,
                start.body,
                OnlineClock(settings.protocol.gauge, plan.worker),
                {"source": source.source, "place": place},
            )
            for place, source in enumerate(sources[1:])
        ]
        if not start.holds:
            self._begin_to_evaluate(settings.offset_s)

    def following(self, folder: Path, began_by: str) -> LiveRun:
        """Return the run after this one, with the same settings, clock offset and body."""
        return LiveRun(replace(self.plan, settings=self._settings), folder, began_by)

    def status_of(self, source: int) -> StreamStatus:
        """Return the counts, frames and notes of a source's messages in this run."""
        return self.estimates[source - 1].status if source else self.groundtruth_status

    @property
    def body(self) -> MarkerBody:
        """The body that is evaluated."""
        return self.start.body

    @property
    def request(self) -> Request:
        """The settings of the run, for the provenance of its results."""
        settings, body = self._settings, self.body
        finds_body = body.source == AUTO
        return Request(
            settings.protocol,
            CalibrationRequest(
                offset=self.start.finds_offset,
                hand_eye=finds_body,
                known=None if finds_body else body.hand_eye,
            ),
            settings.covariances,
            up=settings.up,
            fixes=self.groundtruth.stream.fixes.rule,
            integrity=settings.integrity,
            available=settings.available,
        )

    @property
    def groundtruth_up(self) -> UpAxis:
        """The up axis of the groundtruth's frame."""
        return self.groundtruth.stream.up(self._given_up)

    @property
    def has_pairs(self) -> bool:
        """Whether there are pairs."""
        return any(estimate.has_pairs for estimate in self.estimates)

    @property
    def pair_count(self) -> int:
        """The number of pairs of all estimates."""
        return sum(estimate.evaluator.pairs for estimate in self.estimates)

    @property
    def restarted(self) -> LiveEstimate | None:
        """The first estimate whose restart ends the run; None if there is none."""
        return next(
            (estimate for estimate in self.estimates if estimate.restarted_at is not None), None
        )

    def end_at_restarts(self, ends: bool) -> None:
        """Set whether the run ends at the first restart of an estimate."""
        for estimate in self.estimates:
            estimate.ends_at_restart = ends

    def take(self, source: int, messages: DecodedMessages) -> None:
        """Store and take messages of a source."""
        if source:
            self.estimates[source - 1].see(messages)
        else:
            self.states_file.append(messages.states)
            self._see_groundtruth(messages.states)
        self._tail.add(source, messages)
        if not self.holds:
            self._pass_on(source, messages)
        elif source and self._held_from is None:
            status = self.groundtruth_status
            self._held_from = NEVER if status.last is None else status.last, status.poses

    def update(self) -> Iterator[tuple[LiveEstimate, Update]]:
        """Evaluate the messages that were taken; yield the new errors by estimate."""
        for estimate in self.estimates:
            yield estimate, estimate.update()
        if self.restarted is None and (self._held_from is None or not self.holds):
            self._tail.forget(min(max(_TAIL_S, self._settings.limits.past_s), _LONGEST_TAIL_S))

    def decide(self, *, at_end: bool = False) -> None:
        """Evaluate the stored messages when clock offset and marker pose are decided."""
        for estimate in self.estimates:
            # Before the start nothing is evaluated, so waiting for the clock estimate is possible.
            estimate.clock.update(at_end=at_end, waits=self.holds)
        if not self.holds:
            return
        offset_s = self.start.look(self.estimates[0], self._held_s, at_end=at_end)
        if offset_s is None:
            return
        self.holds = False
        self._begin_to_evaluate(offset_s)
        self._one_by_one(self._tail, self._pass_on)

    def continue_after(self, before: LiveRun, stepped_back: Sequence[int] = ()) -> None:
        """Take the newest messages of the previous run that it did not use.

        The time of some estimates may have stepped back. They began this run, and need the
        groundtruth since their first message.
        """
        restarts = [
            item.restarted_at for item in before.estimates if item.restarted_at is not None
        ]
        begins = {}
        for place, (new, old) in enumerate(zip(self.estimates, before.estimates, strict=True), 1):
            if place not in stepped_back:
                begins[place] = min(restarts, default=old.evaluator.buffer.unused_from)
                new.continue_after(old, begins[place])
            elif (first := self._tail.first(place)) is not None:
                begins[place] = first + self._settings.offset_ns
        offset_ns = self._settings.offset_ns
        taken = {
            place: begin - offset_ns
            for place, begin in begins.items()
            if place not in stepped_back
        }
        has_points = before.estimates[0].evaluator.rule.method == AT_GROUNDTRUTH
        interpolated = set(taken) if has_points else {0}
        taken[0] = min(begins.values(), default=NEVER)
        self._one_by_one(before._tail.since(taken, interpolated), self.take)

    def begin_with_clock_step(self, source: int, step: Event) -> None:
        """Take the step of one source's clock with which the run began."""
        for estimate in self.estimates[source - 1 : source] if source else self.estimates:
            estimate.stepped = step

    def _begin_to_evaluate(self, offset_s: float) -> None:
        """Evaluate from now on, with a clock offset, seconds, and the marker's pose."""
        self._settings = settings = self._settings.with_offset(offset_s)
        if self.body.hand_eye is not None and not self.body.of_marker:
            covariances = settings.covariances.of_moved_groundtruth(self.body.hand_eye)
            settings = replace(settings, covariances=covariances)
        for estimate in self.estimates:
            estimate.evaluator = OnlineEvaluator(settings)

    @property
    def _held_s(self) -> float:
        """Longest time span of a source since the first estimate, seconds; 0 without one.

        Sources are measured separately, since their clocks may differ by years. Infinite if
        timestamps do not advance, so that memory is bounded.
        """
        if self._held_from is None:
            return 0.0
        statuses, groundtruth = [item.status for item in self.estimates], self.groundtruth_status
        first, count = self._held_from
        if groundtruth.poses - count + sum(status.poses for status in statuses) > _MOST_HELD:
            return math.inf
        since_ns = 0 if first == NEVER or groundtruth.last is None else groundtruth.last - first
        return max([since_ns / NANOSECONDS, *(status.duration_s for status in statuses)])

    def conclude(self) -> None:
        """Evaluate the poses that wait for groundtruth, because no further messages follow."""
        for estimate in self.estimates:
            estimate.update(at_end=True)
            estimate.digest()

    def change(self, settings: OnlineSettings) -> None:
        """Use other lengths and another window from now on."""
        settings = settings.with_gauge(self._settings.protocol.gauge)
        self._settings = settings.with_offset(self._settings.offset_s)
        for estimate in self.estimates:
            estimate.evaluator.change(settings)

    def close(self) -> list[str]:
        """Write all states to disk; return the reasons for missing ones."""
        files: list[Callable[[], object]] = [estimate.close for estimate in self.estimates]
        files.append(self.states_file.close)
        files += [] if self._fixes is None else [self._fixes.close]
        return [trouble for close in files if (trouble := _trouble(close))]

    def _see_groundtruth(self, states: Trajectory) -> None:
        fixes = states.reading.fixes
        if fixes is not None:
            self._keep_upright()
            if len(states):
                self._keep_fixes(states.stamps, fixes)
        for estimate in self.estimates:
            estimate.clock.add_groundtruth(states)
        if not len(states):
            return
        self.start.see_groundtruth(states)
        if self.on_groundtruth is not None:
            self.on_groundtruth(self.body.groundtruth(states))

    def _pass_on(self, source: int, messages: DecodedMessages) -> None:
        if source:
            self.estimates[source - 1].take(messages)
            return
        states = self.body.groundtruth(replace(messages.states, up=self.groundtruth_up))
        for estimate in self.estimates:
            estimate.take_groundtruth(states)

    def _one_by_one(
        self,
        messages: Iterable[tuple[int, DecodedMessages]],
        take: Callable[[int, DecodedMessages], None],
    ) -> None:
        """Evaluate messages as if they arrived now, so that the buffers stay small.

        Groundtruth is kept until the estimates that arrived with it are paired.
        """
        for source, item in messages:
            take(source, item)
            if source:
                self.estimates[source - 1].evaluate()

    def _keep_upright(self) -> None:
        """Set the yaw gauge if none is set, because errors in heights of fixes cause a tilt."""
        if not self.plan.gauge_is_default:
            return
        self.plan = replace(self.plan, gauge_is_default=False)
        self._settings = self._settings.with_gauge(Gauge.YAW)
        for estimate in self.estimates:
            estimate.evaluator.set_gauge(Gauge.YAW)
            estimate.clock = OnlineClock(Gauge.YAW, self.plan.worker)
        text = f"{self.groundtruth.source}: GNSS fixes; the alignment uses gauge yaw"
        self.news.append(Remark(Level.NOTE, "alignment", text))

    def _keep_fixes(self, stamps: Stamps, fixes: Fixes) -> None:
        """Write the original fixes to disk, because states do not contain their quality."""
        self._fixes = self._fixes or FixWriter(self.folder)
        self._fixes.append(stamps, fixes)


def _trouble(write: Callable[[], object]) -> str:
    """Return why something could not be written; empty if it was written."""
    try:
        write()
    except TrajevalError as error:
        return str(error)
    return ""
