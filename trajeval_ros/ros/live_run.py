"""One live run: a groundtruth, its estimates, and their output folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.formatting.remarks import Level, Remark
from trajeval_ros.geometry.arrays import Stamps
from trajeval_ros.geometry.fix_selection import fixes_of_rows
from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.live.fix_file import FixWriter, read_fix_rows
from trajeval_ros.io.live.state_file import GROUNDTRUTH, StateWriter, copy_states
from trajeval_ros.io.requests.setting import AUTO
from trajeval_ros.metrics.discontinuities.events import Event
from trajeval_ros.online.live_clock import OnlineClock
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.reports import Update
from trajeval_ros.pipeline.request import Request
from trajeval_ros.ros.live_estimate import DecodedMessages, LiveEstimate
from trajeval_ros.ros.marker_body import MarkerBody
from trajeval_ros.ros.output_folder import Finisher
from trajeval_ros.ros.pose_source import PoseSource
from trajeval_ros.ros.poses import StreamStatus
from trajeval_ros.ros.start_decision import HeldMessages, StartDecision


class LiveRun:
    """Passes the same groundtruth to every estimate, and stores the results on disk.

    Sources are numbered: 0 is the groundtruth, and 1 the first estimate.
    `began_by` is the cause of a run that the user did not start. `about` has the user's label and
    metadata. With `gauge_is_default`, the gauge is yaw for GNSS fixes.
    """

    def __init__(
        self,
        sources: Sequence[PoseSource],
        settings: OnlineSettings,
        folder: Path,
        start: StartDecision,
        worker: Executor,
        began_by: str = "",
        about: Mapping[str, Any] | None = None,
        *,
        gauge_is_default: bool = False,
    ) -> None:
        self.groundtruth, self.folder, self.began_by = sources[0], folder, began_by
        self.about = about or {}
        self.idle = ""  # why messages are dropped; empty while they are evaluated
        self.groundtruth_status = StreamStatus()
        self._gauge_is_default = gauge_is_default
        about_groundtruth = {"source": sources[0].source, "name": sources[0].name}
        self.states_file = StateWriter(folder / GROUNDTRUTH, about_groundtruth)
        self.finisher = Finisher(folder)  # writes result.json in another process
        self.on_groundtruth: Callable[[Trajectory], object] | None = None  # draws it
        self.news: list[Remark] = []  # remarks that are not published yet
        # Messages, by source, of the next run: an estimate restarted before them.
        self.unused: list[tuple[int, DecodedMessages]] = []
        self._sources, self._settings, self.start = sources, settings, start
        self._worker = worker
        self._fixes: FixWriter | None = None
        self._given_up = None if settings.up is None else settings.up[0]
        self._held = HeldMessages() if start.holds else None
        self.estimates = [
            LiveEstimate(
                source,
                settings,
                folder,
                start.body,
                OnlineClock(settings.protocol.gauge, worker),
                {"source": source.source, "place": place},
            )
            for place, source in enumerate(sources[1:])
        ]
        if not start.holds:
            for estimate in self.estimates:
                estimate.begin_to_evaluate(settings.offset_s)

    def following(self, folder: Path, began_by: str) -> LiveRun:
        """Return the run after this one, with the same settings, clock offset and body."""
        return LiveRun(
            self._sources,
            self._settings,
            folder,
            self.start,
            self._worker,
            began_by,
            self.about,
            gauge_is_default=self._gauge_is_default,
        )

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
        return self.pair_count > 0

    @property
    def pair_count(self) -> int:
        """The number of pairs of all estimates."""
        return sum(estimate.evaluator.pairs for estimate in self.estimates)

    @property
    def holds(self) -> bool:
        """Whether messages are only stored, because the start is not decided yet."""
        return self._held is not None

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

    def examine(self, *, at_end: bool) -> None:
        """Search the messages that were taken for discontinuities."""
        for estimate in self.estimates:
            estimate.examine(at_end=at_end)

    def take(self, source: int, messages: DecodedMessages) -> None:
        """Store and take messages of a source."""
        if source:
            self.estimates[source - 1].see(messages)
        else:
            self.states_file.append(messages.states)
            self._see_groundtruth(messages.states)
        if self._held is None or self._held.may_pass(source, self.body):
            self._pass_on(source, messages)
        elif len(messages.states):
            self._held.add(source, messages)

    def update(self) -> Iterator[tuple[LiveEstimate, Update]]:
        """Evaluate the messages that were taken; yield the new errors by estimate."""
        for estimate in self.estimates:
            yield estimate, estimate.update()

    def decide(self, *, at_end: bool = False) -> None:
        """Evaluate the stored messages when clock offset and marker pose are decided."""
        for estimate in self.estimates:
            # Before the start nothing is evaluated, so waiting for the clock estimate is possible.
            estimate.clock.update(at_end=at_end, waits=self.holds)
        held_s = 0.0 if self._held is None else self._held.span_s
        offset_s = self.start.look(self.estimates[0], held_s, at_end=at_end)
        if offset_s is None or self._held is None:
            return
        self._settings = self._settings.with_offset(offset_s)
        for estimate in self.estimates:
            estimate.begin_to_evaluate(offset_s)
        held, self._held = self._held.messages, None
        self._one_by_one(held, self._pass_on)

    def continue_after_restart(self, before: LiveRun) -> None:
        """Take what the previous run, which a restart has ended, received and did not use."""
        for new, old in zip(self.estimates, before.estimates, strict=True):
            new.continue_after(old)
        self._describe_groundtruth_of(before)
        unused, before.unused = before.unused, []
        self._one_by_one(unused, self.take)

    def continue_after_silence(self, before: LiveRun, stepped_back: Sequence[int]) -> None:
        """Take the groundtruth of the previous run, since its time has not stepped back."""
        for place, (new, old) in enumerate(zip(self.estimates, before.estimates, strict=True), 1):
            if place in stepped_back:
                new.share_groundtruth(old)
            else:
                new.continue_after(old)
        self._describe_groundtruth_of(before)

    def begin_with_clock_step(self, source: int, step: Event) -> None:
        """Take the step of one source's clock with which the run began."""
        for estimate in self.estimates[source - 1 : source] if source else self.estimates:
            estimate.stepped = step

    def resume(self) -> None:
        """Evaluate messages again after a pause, in which the robot may have moved."""
        self.idle = ""

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
        messages: Sequence[tuple[int, DecodedMessages]],
        take: Callable[[int, DecodedMessages], None],
    ) -> None:
        """Evaluate messages as if they arrived now, so that the buffers stay small.

        Groundtruth is kept until the estimates that arrived with it are paired. Messages after a
        restart are left for the next run.
        """
        for row, (source, item) in enumerate(messages):
            take(source, item)
            if source:
                self.estimates[source - 1].evaluate()
                if self.restarted is not None:
                    self.unused = list(messages[row + 1 :])
                    return

    def _keep_upright(self) -> None:
        """Set the yaw gauge if none is set, because errors in heights of fixes cause a tilt."""
        if not self._gauge_is_default:
            return
        self._gauge_is_default = False
        self._settings = self._settings.with_gauge(Gauge.YAW)
        for estimate in self.estimates:
            estimate.evaluator.set_gauge(Gauge.YAW)
            estimate.clock = OnlineClock(Gauge.YAW, self._worker)
        said = f"{self.groundtruth.source}: GNSS fixes; the alignment uses gauge yaw"
        self.news.append(Remark(Level.NOTE, "alignment", said))

    def _keep_fixes(self, stamps: Stamps, fixes: Fixes) -> None:
        """Write the original fixes to disk, because states do not contain their quality."""
        self._fixes = self._fixes or FixWriter(self.folder)
        self._fixes.append(stamps, fixes)

    def _describe_groundtruth_of(self, before: LiveRun) -> None:
        """Store and draw groundtruth that was taken from the previous run."""
        if self.on_groundtruth is not None:
            known = self.estimates[0].evaluator.buffer.groundtruth
            self.on_groundtruth(known.trajectory(np.arange(len(known))))
        buffers = [estimate.evaluator.buffer for estimate in self.estimates]
        taken = np.concatenate([buffer.groundtruth.stamps for buffer in buffers])
        copy_states(before.states_file.path, self.states_file, taken)
        if before._fixes is not None:
            stamps, rows = read_fix_rows(before.folder)
            kept = np.isin(stamps, taken)
            self._keep_fixes(stamps[kept], fixes_of_rows(rows[kept, :3], rows[kept, 3:]))


def _trouble(write: Callable[[], object]) -> str:
    """Return why something could not be written; empty if it was written."""
    try:
        write()
    except TrajevalError as error:
        return str(error)
    return ""
