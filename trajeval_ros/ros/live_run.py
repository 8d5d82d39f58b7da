"""A live run: one groundtruth, its estimates, and their output folder, without timers."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.geometry.arrays import Stamps
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.marker import MARKERS_VELOCITIES
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.notices import OK, Notice
from trajeval_ros.online.reports import Update
from trajeval_ros.online.time_steps import TimeSteps
from trajeval_ros.ros.estimate_segments import EstimateSegments
from trajeval_ros.ros.estimate_topic import EstimateTopic
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.marker_body import MarkerBody
from trajeval_ros.ros.poses import StateColumns
from trajeval_ros.ros.recorded_state import recorded_state
from trajeval_ros.ros.run_folders import RunFolders
from trajeval_ros.ros.segmentation import Segmentation
from trajeval_ros.ros.sides import Side, TimeAt
from trajeval_ros.ros.start_decision import StartDecision

_QUIET_S = 0.1
_LAST_MESSAGES_S = 2.0


class LiveRun:
    """Passes the same groundtruth to every estimate, and stores the results on disk.

    Attributes:
        groundtruth: Source of the groundtruth.
        folders: Its output folders.
        news: Notices that are not published yet.
        watch: Receives the states of the groundtruth, and the number of steps back of its time, to
            draw them.
        body: The body that is evaluated.
    """

    def __init__(
        self,
        groundtruth: Side,
        sides: Sequence[Side],
        settings: OnlineSettings,
        words: dict[str, Any],
        folder: Path,
        *,
        find_offset: bool = False,
        body: MarkerBody | None = None,
        segmentation: Segmentation | None = None,
        new_folder: Callable[[], Path] | None = None,
    ) -> None:
        """Create it.

        Args:
            groundtruth: Source of the groundtruth.
            sides: Sources of the estimates.
            settings: Settings of the evaluation.
            words: The same settings, as arguments of `settings.protocol_from`.
            folder: Existing folder for the files.
            find_offset: Estimate the clock offset from the first minute, and apply it if it is
                significant.
            body: The body, if the groundtruth is measured at a marker on it; else None.
            segmentation: When a new segment starts.
            new_folder: Creates the folder for the segment after a step of time.

        Raises:
            InputError: The files can't be made.
        """
        self._segmentation = segmentation or Segmentation()
        resets = self._segmentation.on_time_jump == "reset"
        self.folders = RunFolders(folder, new_folder if resets else None)
        self.groundtruth = groundtruth
        self.words = words
        self._given_up = None if settings.up is None else settings.up[0]
        self.watch: Callable[[StateColumns, int], object] | None = None
        self.body = body or MarkerBody()
        self._start = StartDecision(self.body, find_offset=find_offset)
        self._settings = settings
        self._time = TimeSteps()
        self._troubles: list[str] = []
        self.news: list[Notice] = []
        self._worker = ThreadPoolExecutor(1, "clocks")
        splits = self._segmentation.on_restart == "segment"
        self._tracks = [
            EstimateSegments(
                EstimateTopic(side, groundtruth, place, self.body, self._worker, splits),
                settings,
                folder,
                hold=self.holds,
            )
            for place, side in enumerate(sides)
        ]
        for side in (groundtruth, *sides):
            side.stream.begins_anew = self._segmentation.on_time_jump != "ignore"
        self._gauge_is_default = words["gauge"] is None and words["modality"] is None
        for each in self.estimates:
            each.files.write_state(recorded_state(self, each))

    @property
    def groundtruth_up(self) -> UpAxis:
        """The up axis of the groundtruth's frame."""
        return self.groundtruth.stream.up(self._given_up)

    @property
    def estimates(self) -> list[LiveEstimate]:
        """The newest segments of all estimate topics."""
        return [each.current for each in self._tracks]

    @property
    def _open(self) -> list[LiveEstimate]:
        """All segments that are not closed yet."""
        return [segment for each in self._tracks for segment in each.open]

    def take(self, time_at: TimeAt | None) -> None:
        """Receive the messages that have arrived; `time_at` returns simulated time."""
        stream = self.groundtruth.stream
        for message_type, taken, arrived in self.groundtruth.take(time_at):
            poses = stream.poses(message_type, taken.payloads, arrived)
            if poses.fixes is not None and self._gauge_is_default:
                self._keep_upright()
            for part in self._parts(self._time, poses.stamps):
                for track in self._tracks:
                    self._begin_if_due(track, self._time, track.truth_epoch(self._time))
                self._feed(poses.picked(part))
        for track in self._tracks:
            for message in track.messages(time_at):
                for part in self._parts(track.time, message.stamps):
                    self._begin_if_due(track, track.time, track.own_epoch)
                    track.take(message, part)
        for estimate in self.estimates:
            # Before the start nothing is evaluated, so waiting for the clock estimate is possible.
            estimate.clock.update(waits=self.holds)
        self._decide()

    def update(self) -> Iterator[tuple[LiveEstimate, Update]]:
        """Evaluate the messages that were taken; yield the new errors by estimate."""
        for each in self._tracks:
            before = each.current
            for estimate, update in each.update(self._settings):
                if estimate is not before:
                    self._tell_begun([estimate])
                before = estimate
                yield estimate, update
        self._close_segments()

    def change(self, settings: OnlineSettings, words: dict[str, Any]) -> None:
        """Use other lengths and another window from now on."""
        known = {name: self.words[name] for name in ("time_offset", "gauge")}
        self.words = {**words, **known}
        self._settings = settings.with_gauge(self._settings.protocol.gauge)
        for each in self.estimates:
            each.evaluator.change(settings)

    def write_states(self) -> None:
        """Write the state that `trajeval finish` needs besides pairs."""
        for each in self._open:
            each.files.write_state(recorded_state(self, each))

    def save(self) -> None:
        """Start to write result.json; requires pairs and no running process.

        Raises:
            InputError: The pairs can't be written.
        """
        self.write_states()
        for each in self.estimates:
            each.write_revised()
        self.folders.finisher.save()

    def drain(self, time_at: TimeAt | None) -> None:
        """Receive and evaluate the last messages, including those in transit."""
        until = time.monotonic() + _LAST_MESSAGES_S
        quiet_since = time.monotonic()
        while time.monotonic() < min(until, quiet_since + _QUIET_S):
            before = self._received
            self.take(time_at)
            if self._received > before:
                quiet_since = time.monotonic()
            time.sleep(_QUIET_S / 10)
        self.conclude(time_at)

    def conclude(self, time_at: TimeAt | None) -> None:
        """Evaluate everything that has arrived, including poses that wait for groundtruth."""
        self.take(time_at)
        self._feed(self.groundtruth.stream.last_poses())
        for track in self._tracks:
            track.take_last()
        self._conclude_clocks()
        for _ in self.update():
            pass
        for each in self._open:
            each.update(at_end=True)
            each.digest()

    def close(self) -> list[str]:
        """Write all pairs to disk; return the reasons for missing ones."""
        self.write_states()
        self._worker.shutdown(wait=False, cancel_futures=True)
        troubles = [_trouble(each.close) for each in self._open]
        troubles += [_trouble(close) for close in self.folders.close()]
        return [each for each in [*self._troubles, *troubles] if each]

    @property
    def holds(self) -> bool:
        """Whether messages are only stored, because the start is not decided yet."""
        return self._start.holds

    @property
    def waits_for(self) -> str:
        """What the start of the evaluation waits for; empty after the start."""
        return self._start.waits_for

    @property
    def about_clocks(self) -> str:
        """A sentence about the estimated clock offset; empty if it was not requested."""
        return self._start.about_clocks

    @property
    def has_pairs(self) -> bool:
        """Whether there are pairs in the present folder."""
        return self.folders.has_pairs(self._open)

    def _feed(self, poses: StateColumns) -> None:
        """Pass groundtruth states to all estimates."""
        fed = [
            each for track in self._tracks for each in track.open_at(track.truth_epoch(self._time))
        ]
        if poses.fixes is not None and len(poses.stamps):
            for folder in dict.fromkeys(each.folder for each in fed):
                self.folders.keep_fixes(folder, poses.stamps, poses.fixes)
        for each in fed:
            each.evaluator.frames.groundtruth_up = self.groundtruth_up
            each.add_groundtruth(poses.stamps, poses.states)
        if not len(poses.stamps):
            return
        self._start.see_groundtruth(poses.states)
        if self.body.leaves_out_velocities_of(poses.states, is_truth=True):
            self.groundtruth.stream.status.note(MARKERS_VELOCITIES)
        if self.watch is not None:
            moved = poses._replace(states=self.body.truth(poses.states))
            self.watch(moved, self._time.count)

    def _keep_upright(self) -> None:
        """Set the yaw gauge if none is set, because errors in heights of fixes cause a tilt."""
        self._gauge_is_default = False
        self.words = {**self.words, "gauge": Gauge.YAW.value}
        self._settings = self._settings.with_gauge(Gauge.YAW)
        for each in self._open:
            each.set_gauge(Gauge.YAW)
        said = f"{self.groundtruth.source}: GNSS fixes; the alignment uses gauge yaw"
        self.news.append(Notice("alignment", OK, said))

    def _parts(self, side: TimeSteps, stamps: Stamps) -> Iterator[slice]:
        """Yield the parts of a side's timestamps between steps back, unless these are ignored."""
        if self._segmentation.on_time_jump == "ignore":
            return iter([slice(None)])
        return side.parts(stamps)

    def _begin_if_due(self, track: EstimateSegments, side: TimeSteps, epoch: int) -> None:
        """Start a segment of an estimate if the time of one side has stepped back."""
        if epoch <= track.current.epoch:
            return
        if self.holds:
            self._conclude_clocks()
        folder = self.folders.after_step_back(track.current)
        said = f"time stepped back by {side.back_ns / NANOSECONDS:.1f} s"
        track.begin(epoch, said, self._settings, folder)
        self._tell_begun([track.current])

    def _tell_begun(self, begun: Sequence[LiveEstimate]) -> None:
        for each in begun:
            each.files.write_state(recorded_state(self, each))
            said = f"{each.name}: {each.began_by}; segment {each.segment} starts"
            values: dict[str, float | int | str] = {
                "segment": each.segment,
                "folder": str(each.folder),
            }
            self.news.append(Notice("restart", OK, said, values=values))

    def _close_segments(self) -> None:
        """Close segments that no further message can belong to."""
        for track in self._tracks:
            for each in track.complete(self._time):
                each.update(at_end=True)
                each.digest()
                each.files.write_state(recorded_state(self, each))
                self.folders.see_closed(each)
                self._troubles.append(_trouble(each.close))
        self.folders.leave(self._open)

    def _conclude_clocks(self) -> None:
        """Decide on clocks and body now, because no further messages follow."""
        for each in self.estimates:
            each.clock.update(at_end=True)
        self._decide(at_end=True)

    def _decide(self, *, at_end: bool = False) -> None:
        """Evaluate the stored messages when clock offset and marker pose are decided."""
        offset_s = self._start.look(self.estimates, at_end=at_end)
        if offset_s is None:
            return
        self.words = {**self.words, "time_offset": offset_s}
        for each in self.estimates:
            each.release(offset_s)

    @property
    def _received(self) -> int:
        streams = [self.groundtruth.stream, *(each.stream for each in self.estimates)]
        return sum(each.status.poses for each in streams)


def _trouble(write: Callable[[], object]) -> str:
    """Return why something could not be written; empty if it was written."""
    try:
        write()
    except TrajevalError as error:
        return str(error)
    return ""
