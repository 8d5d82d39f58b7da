"""A live run: one groundtruth, its estimates, and the folder that they leave. No timers here."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.diagnosis.warnings import reasons
from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.marker import MARKERS_VELOCITIES
from trajeval_ros.geometry.trajectory import NANOSECONDS, add_counts
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.live.fix_file import FixWriter
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.notices import OK, Notice
from trajeval_ros.online.pairing import Pairing
from trajeval_ros.online.reports import Update
from trajeval_ros.online.state_rows import QUATERNION
from trajeval_ros.online.time_steps import TimeSteps
from trajeval_ros.ros.estimate_segments import EstimateSegments
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.marker_body import MarkerBody
from trajeval_ros.ros.output_folder import Finisher
from trajeval_ros.ros.poses import StateColumns
from trajeval_ros.ros.segmentation import Segmentation
from trajeval_ros.ros.sides import Side, TimeAt

_QUIET_S = 0.1
_LAST_MESSAGES_S = 2.0
_SAME_CLOCK_S = 60.0
_DECISION_S = 60.0


class LiveRun:
    """Feeds every estimate with the same groundtruth, and keeps what is found on disk.

    Attributes:
        groundtruth: Where it comes from.
        finisher: Writes result.json, in a process of its own.
        news: What nobody has been told yet.
        watch: Receives the states of the groundtruth, to draw them.
        body: The body that is evaluated.
        holds: Whether nothing is evaluated yet, since the clocks' offset, or the marker's pose in
            the body, is to be found first.
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
            groundtruth: Where it comes from.
            sides: Where the estimates come from.
            settings: What to do.
            words: The same, as `settings.protocol_from` takes them.
            folder: For the files; it exists.
            find_offset: Estimate the clocks' offset from the first minute, and apply it if it is
                significant.
            body: Where the groundtruth is of a marker on it; None where it is of the body.
            segmentation: When a segment ends, and another one begins.
            new_folder: Makes the folder for what follows a reset by time.

        Raises:
            InputError: The files can't be made.
        """
        self.groundtruth, self.finisher = groundtruth, Finisher(folder)
        self.words = words
        self._given_up = None if settings.up is None else settings.up[0]
        self.watch: Callable[[StateColumns], object] | None = None
        self.body, self._finds_offset = body or MarkerBody(), find_offset
        self.holds, self._about_clocks = find_offset or self.body.is_wanted, ""
        self._is_oriented: bool | None = None  # the groundtruth; None before its first state
        self._settings, self._new_folder = settings, new_folder
        self._segmentation = segmentation or Segmentation()
        self._time = TimeSteps()
        self._leaving: list[Finisher] = []  # folders that still get pairs
        self._closed: list[Finisher] = []
        self._troubles: list[str] = []
        self._has_closed_pairs = False
        self.news: list[Notice] = []
        self._worker = ThreadPoolExecutor(1, "clocks")
        self._tracks = [
            EstimateSegments(
                side,
                self._worker,
                settings,
                folder,
                groundtruth,
                place,
                self.body,
                hold=self.holds,
                splits_at_jumps=self._segmentation.on_restart == "segment",
            )
            for place, side in enumerate(sides)
        ]
        for side in (groundtruth, *sides):
            side.stream.begins_anew = self._segmentation.on_time_jump != "ignore"
        self._fix_writers: dict[Path, FixWriter] = {}
        self._gauge_is_default = words["gauge"] is None and words["modality"] is None
        for each in self.estimates:
            each.write_state(self._state(each))

    @property
    def groundtruth_up(self) -> UpAxis:
        """Which axis points up in the groundtruth's frame."""
        return self.groundtruth.stream.up(self._given_up)

    @property
    def estimates(self) -> list[LiveEstimate]:
        """The newest segment of each estimate topic."""
        return [each.current for each in self._tracks]

    @property
    def _open(self) -> list[LiveEstimate]:
        """All segments that are not closed yet."""
        return [segment for each in self._tracks for segment in each.open]

    def take(self, time_at: TimeAt | None) -> None:
        """Take what has arrived; `time_at` tells simulated time."""
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
            # While nothing is evaluated, nobody has to be kept waiting.
            estimate.clock.update(waits=self.holds)
        self._decide()

    def update(self) -> Iterator[tuple[LiveEstimate, Update]]:
        """Evaluate what has been taken, estimate by estimate."""
        for each in self._tracks:
            before = each.current
            for estimate, update in each.update(self._settings):
                if estimate is not before:
                    self._tell_begun([estimate])
                before = estimate
                yield estimate, update
        self._close_segments()

    def change(self, settings: OnlineSettings, words: dict[str, Any]) -> None:
        """Go on with other lengths and another window."""
        known = {name: self.words[name] for name in ("time_offset", "gauge")}
        self.words = {**words, **known}
        self._settings = settings.with_gauge(self._settings.protocol.gauge)
        for each in self.estimates:
            each.evaluator.change(settings)

    def write_states(self) -> None:
        """Write what `trajeval finish` can't tell from pairs."""
        for each in self._open:
            each.write_state(self._state(each))

    def save(self) -> None:
        """Start to write result.json; there are pairs, and nothing is being written.

        Raises:
            InputError: The disk takes no more.
        """
        self.write_states()
        for each in self.estimates:
            each.write_revised()
        self.finisher.save()

    def drain(self, time_at: TimeAt | None) -> None:
        """Take and evaluate the last messages, those still on their way included."""
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
        """Take and evaluate what has arrived, and what waits for groundtruth that won't come."""
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
        """Have all pairs on disk; returns why some are not."""
        self.write_states()
        self._worker.shutdown(wait=False, cancel_futures=True)
        troubles = [_trouble(each.close) for each in self._open]
        troubles += [_trouble(each.close) for each in self._fix_writers.values()]
        self._closed, self._leaving = [*self._closed, *self._leaving], []
        return [each for each in [*self._troubles, *troubles] if each]

    def missing(self, estimate: LiveEstimate) -> str:
        """Return the source that nothing has come from yet; empty if both have spoken."""
        sides = (self.groundtruth, estimate.side)
        return next((each.source for each in sides if each.silent_s is None), "")

    def groundtruth_dropped(self, estimate: LiveEstimate) -> dict[str, int]:
        """Return the number of groundtruth states that an estimate can't use, by reason."""
        dropped = estimate.dropped_since_begun(self.groundtruth.stream)
        return add_counts(dropped, estimate.evaluator.buffer.groundtruth_intake.dropped)

    def why_no_pair(self) -> str:
        """Return what has come instead of what makes pairs."""
        dropped = [
            self.groundtruth_dropped(self.estimates[0]),
            *(
                add_counts(each.stream.status.dropped, each.evaluator.buffer.dropped)
                for each in self.estimates
            ),
        ]
        sides = [self.groundtruth, *(each.side for each in self.estimates)]
        counts = [
            f"{counted(side.stream.status.poses, 'pose')} on {side.source}"
            + (f" ({reasons(of)})" if of else "")
            for side, of in zip(sides, dropped, strict=True)
        ]
        return "no pairs of estimate and groundtruth, no result: " + ", ".join(counts)

    @property
    def waits_for(self) -> str:
        """What must be known before anything is evaluated; empty once it is."""
        if not self.holds:
            return ""
        clocks = "the clock offset" if self._finds_offset else ""
        marker = f"hand_eye {self.body.source}" if self.body.is_wanted else ""
        return " and ".join(filter(None, (clocks, marker)))

    @property
    def has_pairs(self) -> bool:
        """Whether there is anything to evaluate in the folder of now."""
        here = [each for each in self._open if each.folder == self.finisher.folder]
        return self._has_closed_pairs or any(each.evaluator.pairs for each in here)

    def ended(self) -> list[Finisher]:
        """Return what writes the results of folders that were completed since the last call."""
        closed, self._closed = self._closed, []
        return closed

    def _feed(self, poses: StateColumns) -> None:
        """Give states of the groundtruth to all estimates."""
        fed = [
            each for track in self._tracks for each in track.open_at(track.truth_epoch(self._time))
        ]
        if poses.fixes is not None and len(poses.stamps):
            for folder in dict.fromkeys(each.folder for each in fed):
                self._keep_fixes(folder, poses.stamps, poses.fixes)
        for each in fed:
            each.evaluator.groundtruth_up = self.groundtruth_up
            each.add_groundtruth(poses.stamps, poses.states)
        if not len(poses.stamps):
            return
        if self._is_oriented is None:
            self._is_oriented = not np.isnan(poses.states[0, QUATERNION.start])
        if self.body.leaves_out_velocities_of(poses.states, is_truth=True):
            self.groundtruth.stream.status.note(MARKERS_VELOCITIES)
        if self.watch is not None:
            self.watch(poses._replace(states=self.body.truth(poses.states)))

    def _keep_fixes(self, folder: Path, stamps: Stamps, fixes: Floats) -> None:
        """Have fixes on disk as they were sent: pairs don't tell how good they are."""
        if folder not in self._fix_writers:
            self._fix_writers[folder] = FixWriter(folder)
        self._fix_writers[folder].append(stamps, fixes)

    def _keep_upright(self) -> None:
        """Align by yaw, since nobody chose: the heights of fixes would tilt an estimate."""
        self._gauge_is_default = False
        self.words = {**self.words, "gauge": Gauge.YAW.value}
        self._settings = self._settings.with_gauge(Gauge.YAW)
        for each in self._open:
            each.set_gauge(Gauge.YAW)
        said = f"{self.groundtruth.source}: GNSS fixes; the alignment uses gauge yaw"
        self.news.append(Notice("alignment", OK, said))

    def _parts(self, side: TimeSteps, stamps: Stamps) -> Iterator[slice]:
        """Yield the parts of a side's stamps between steps back that are not to be ignored."""
        if self._segmentation.on_time_jump == "ignore":
            return iter([slice(None)])
        return side.parts(stamps)

    def _begin_if_due(self, track: EstimateSegments, side: TimeSteps, epoch: int) -> None:
        """Start a segment of an estimate if the time of one side has got there first."""
        if epoch <= track.current.epoch:
            return
        if self.holds:
            self._conclude_clocks()
        folder = self.finisher.folder
        if self._segmentation.on_time_jump == "reset" and self._new_folder is not None:
            if track.current.folder == folder:  # the first one that is to leave it
                self._leaving.append(self.finisher)
                self.finisher = Finisher(self._new_folder())
                self._has_closed_pairs = False
            folder = self.finisher.folder
        said = f"time stepped back by {side.back_ns / NANOSECONDS:.1f} s"
        track.begin(epoch, said, self._settings, folder)
        self._tell_begun([track.current])

    def _tell_begun(self, begun: Sequence[LiveEstimate]) -> None:
        for each in begun:
            each.write_state(self._state(each))
            said = f"{each.name}: {each.began_by}; segment {each.segment} starts"
            values: dict[str, float | int | str] = {
                "segment": each.segment,
                "folder": str(each.folder),
            }
            self.news.append(Notice("restart", OK, said, values=values))

    def _close_segments(self) -> None:
        """Close segments that no message can be of any more."""
        for track in self._tracks:
            for each in track.complete(self._time):
                each.update(at_end=True)
                each.digest()
                each.write_state(self._state(each))
                here = each.folder == self.finisher.folder
                self._has_closed_pairs |= here and each.evaluator.pairs > 0
                self._troubles.append(_trouble(each.close))
        left = {each.folder for each in self._open}
        self._closed += [each for each in self._leaving if each.folder not in left]
        self._leaving = [each for each in self._leaving if each.folder in left]

    def _conclude_clocks(self) -> None:
        """Go on by what is known: no more will come that the clocks could be told from."""
        for each in self.estimates:
            each.clock.update(at_end=True)
        self._decide(at_end=True)

    def _decide(self, *, at_end: bool = False) -> None:
        """Go on by one clock and one body for all estimates, once they are known, or a minute on.

        Both are told by the first estimate: estimates with clocks of their own couldn't be
        ranked. A path's clock is never known.
        """
        if not self.holds:
            return
        first, held_s = self.estimates[0], max(each.held_s for each in self.estimates)
        known, is_spent = first.clock.report, at_end or held_s >= _DECISION_S
        is_known = known.is_significant or first.revised is not None or not self._finds_offset
        if self.body.is_wanted:
            is_known &= self.body.look(first.clock.calibration, is_spent=is_spent)
            if self._is_oriented is None and not at_end and held_s < math.inf:
                return
        if not (is_known or is_spent):
            return
        self.holds = False
        offset_s = self._offset_s(first) if self._finds_offset else first.evaluator.offset_s
        if self.body.is_wanted:
            gauge = first.evaluator.settings.protocol.gauge
            self.body.settle(is_oriented=self._is_oriented is not False, has_scale=gauge.has_scale)
        self.words = {**self.words, "time_offset": offset_s}
        for each in self.estimates:
            each.release(offset_s)

    def _offset_s(self, first: LiveEstimate) -> float:
        """Return what the first estimate tells of the clocks, and keep what to say of it."""
        known, name = first.clock.report, first.name
        if not known.is_significant or known.offset_s is None:
            self._about_clocks = f"no time offset applied ({name}: {known.reason})"
            return 0.0
        self._about_clocks = (
            f"time offset of {known.offset_s:.4f} s applied, estimated from the first "
            f"{known.span_s:.0f} s of {name} (+- {known.half_width_95_s:.2g} s, 95 %)"
        )
        return known.offset_s

    @property
    def _received(self) -> int:
        streams = [self.groundtruth.stream, *(each.stream for each in self.estimates)]
        return sum(each.status.poses for each in streams)

    def _state(self, estimate: LiveEstimate) -> dict[str, Any]:
        truth, buffer = self.groundtruth.stream.status, estimate.evaluator.buffer
        intake = buffer.groundtruth_intake
        return {
            "settings": self.words,
            "groundtruth": {
                "poses": intake.poses,
                "states": buffer.groundtruth_count,
                "duration_s": intake.duration_s,
                "path_length_m": buffer.groundtruth_path_m,
                "time_without_gaps_ns": buffer.groundtruth_time,
                "frame": truth.frame,
                "child_frame": truth.child_frame,
                "up": asdict(self.groundtruth_up),
                "dropped": self.groundtruth_dropped(estimate),
                "notes": list(truth.notes),
            },
            "live": {
                "messages_lost": estimate.side.lost,
                "groundtruth_messages_lost": self.groundtruth.lost,
                "losses_are_exact": estimate.side.loss_is_exact and self.groundtruth.loss_is_exact,
                "arrival_offset_s": estimate.stream.arrivals.offset_s,
                "groundtruth_arrival_offset_s": self.groundtruth.stream.arrivals.offset_s,
                "sync_risk_m": sync_risk_m(self.groundtruth, estimate.side, buffer),
                "latency_p95_s": estimate.latency.p95_s,
                "jumps": estimate.jumps.count,
                "segment": estimate.segment,
                "clock": asdict(estimate.clock.report),
            },
            "hand_eye": self.body.state,
            "fixes": self._fix_state,
            "warnings": self._warnings(estimate),
        }

    @property
    def _fix_state(self) -> dict[str, Any] | None:
        """What `trajeval finish` must know of GNSS fixes; None of other groundtruth."""
        fixes = self.groundtruth.stream.fixes
        if fixes.datum is None:
            return None
        datum = fixes.datum.coordinates.tolist()
        return {"datum": datum, "correlation_s": fixes.rule.correlation_s}

    def _warnings(self, estimate: LiveEstimate) -> list[str]:
        warnings = [
            f"{counted(side.lost, 'message')} of {side.source} lost in transport to the live "
            "evaluator"
            for side in (self.groundtruth, estimate.side)
            if side.lost
        ]
        if estimate.began_by:
            warnings.append(
                f"segment {estimate.segment} of {estimate.side.source}: {estimate.began_by}"
            )
        if self._about_clocks:
            warnings.append(self._about_clocks)
        if estimate.why_not_revised:
            warnings.append(estimate.why_not_revised)
        if self.body.said:
            warnings.append(self.body.said)
        if forgotten := estimate.evaluator.buffer.why_forgotten:
            warnings.append(forgotten)
        if estimate.writer.lost:
            warnings.append(
                f"{counted(estimate.writer.lost, 'pair')} missing, since the disk could not be "
                f"written: {estimate.writer.why_lost}"
            )
        return warnings


def sync_risk_m(groundtruth: Side, estimate: Side, buffer: Pairing) -> float | None:
    """Return what the clocks can have done to the position error, metres.

    That is the groundtruth's mean speed times the difference of the two offsets between stamp and
    arrival: as if all of it came from the clocks, nothing from the time that estimating takes.
    None if stamps aren't of the clock that arrivals are of, as in a replay without simulated time.
    """
    one, other = groundtruth.stream.arrivals.offset_s, estimate.stream.arrivals.offset_s
    if one is None or other is None or not buffer.groundtruth_time:
        return None
    if max(abs(one), abs(other)) > _SAME_CLOCK_S:
        return None
    speed = buffer.groundtruth_path_m / (buffer.groundtruth_time / NANOSECONDS)
    return speed * abs(one - other)


def _trouble(write: Callable[[], object]) -> str:
    """Return why something can't be written; empty if it could."""
    try:
        write()
    except TrajevalError as error:
        return str(error)
    return ""
