"""The picture of a live run, drawn incrementally on the thread of a sink."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.viewer import appearance, entity_data, legend, scene_entities, text_panel
from trajeval_ros.viewer.blueprint import blueprint
from trajeval_ros.viewer.estimate_picture import EstimatePicture, Segment
from trajeval_ros.viewer.groundtruth_picture import GroundtruthPicture
from trajeval_ros.viewer.live_map import LiveMap
from trajeval_ros.viewer.live_recording import LiveRecording
from trajeval_ros.viewer.map_track import is_on_map
from trajeval_ros.viewer.paths import between_origins, bounds_of
from trajeval_ros.viewer.picture_time import PictureTime

if TYPE_CHECKING:
    from trajeval_ros.online.reports import Snapshot, Update


_WORDS_EVERY_NS = 2 * NANOSECONDS


class LiveScene:
    """Draws on the present recording; without one it only stores the data.

    Attributes:
        blueprint: The layout.
    """

    def __init__(self, title: str, names: Sequence[str], gauge: Gauge) -> None:
        """Create it.

        Args:
            title: Title of the run.
            names: Names of the estimates.
            gauge: Gauge of the alignments.
        """
        self._title = one_line(title)
        self._recording, self._time = LiveRecording(), PictureTime()
        self._told_shift_ns = 0
        self._gauge, self._up = gauge, Z_UP
        self._truth = GroundtruthPicture(self._recording, self._time)
        self._estimates: dict[str, EstimatePicture] = {}
        for place, name in enumerate(names):
            entities = scene_entities.EstimateEntities(name, place)
            look = appearance.path_of_estimate(entities.colour, len(names))
            self._estimates[name] = EstimatePicture(entities, look, self._recording, self._time)
        self._full_m: float | None = None
        self._map = LiveMap(self._recording.log)
        self.blueprint = self._layout()

    def begin(self, recording: Any) -> None:
        """Draw on a recording from now on, starting with the present loop or segment."""
        self._recording.stream = recording
        recording.send_recording_name(self._title)
        self._declare()
        self._truth.draw_again()
        if self._map.datum is not None:
            appearance.declare_map(recording, self._entities)
            self._map.draw(is_growing=True)
        self._full_m = None  # draws the scale of the legend again, together with the colours
        for each in self._estimates.values():
            each.draw_again()

    def leave(self) -> None:
        """Stop drawing until another recording begins."""
        self._recording.stream = None

    def finish(self) -> None:
        """Draw all periodic entities for the last time."""
        for each in self._estimates.values():
            times, _ = each.memory.columns()
            if len(times) and each.similarity is not None:
                self._draw_errors(each, int(times[-1]), is_growing=False)
                self._tell(int(times[-1]), is_growing=False)
        self._map.draw(is_growing=False)
        self._frame()

    def groundtruth(
        self, stamps: Stamps, states: Floats, up: UpAxis = Z_UP, epoch: int = 0
    ) -> None:
        """Add groundtruth.

        Args:
            stamps: Timestamps (N,).
            states: States (N, 10).
            up: Up axis of its frame.
            epoch: Number of steps back of its time so far.
        """
        usable = np.isfinite(states[:, :3]).all(axis=1)
        stamps, states = stamps[usable], states[usable]
        if not len(stamps):
            return
        if self._truth.origin is None:
            self._truth.begin(int(stamps[0]), states)
            if up != self._up:
                self._up = up
                self._declare()
        if epoch > self._truth.epoch:
            self._truth.begin_loop(epoch, int(stamps[0]), states)
            self._tell_shift()
        self._truth.add(stamps, states)

    def fixes(self, stamps: Stamps, fixes: Fixes) -> None:
        """Add the GNSS fixes, N > 0, whose states were passed to `groundtruth`."""
        if not is_on_map(fixes, self._up):
            return
        is_first = self._map.datum is None
        if is_first:
            self._recording.send(appearance.declare_map, self._entities)
        self._map.add(stamps + self._truth.time.shift_ns, fixes)
        if is_first:
            self.blueprint = self._layout()
            self._recording.send(lambda recording: recording.send_blueprint(self.blueprint))

    def pairs(
        self,
        name: str,
        stamps: Stamps,
        truth: Floats,
        states: Floats,
        segment: Segment = (0, 1),
    ) -> None:
        """Add pairs of an estimate.

        Args:
            name: Name of the estimate.
            stamps: Timestamps (N,).
            truth: Groundtruth (N, 10).
            states: Estimate (N, 10).
            segment: The segment of the pairs. Pairs of earlier segments are not drawn.
        """
        each, origin = self._estimates[name], self._truth.origin
        if not len(stamps) or origin is None or segment < each.segment:
            return
        if segment > each.segment:
            each.begin_segment(segment, int(stamps[0]))
            self._tell_shift()
        each.add(stamps, truth[:, :3] - origin, states)

    def update(self, name: str, update: Update) -> None:
        """Draw the published errors of the newest pair."""
        self._estimates[name].update(update)

    def snapshot(self, name: str, stamp: int, snapshot: Snapshot, revised_m: float | None) -> None:
        """Draw the published state of an evaluation at a timestamp.

        `revised_m` is the position ATE of the newest path, metres; None without one.
        """
        each, origin = self._estimates[name], self._truth.origin
        time = stamp + each.time.shift_ns
        each.errors(time, snapshot, revised_m)
        if snapshot.alignment is not None and each.origin is not None:
            assert origin is not None
            similarity = between_origins(snapshot.alignment.similarity, origin, each.origin)
            each.align(time, similarity, self._gauge, self._up)
        if time >= each.told_at + _WORDS_EVERY_NS:
            each.told_at = time
            if each.similarity is not None:
                self._draw_errors(each, time)
            self._tell(time)

    def uncertainty(self, name: str, stamp: int, position: Floats, covariance: Floats) -> None:
        """Draw a position (3,) of an estimate and its covariance (3, 3), in its own frame."""
        self._estimates[name].uncertainty(stamp, position, covariance)

    def event(self, name: str, stamp: int, text: str) -> None:
        """Add a line to the log, at a timestamp of an estimate."""
        self._recording.event(stamp + self._estimates[name].time.shift_ns, text)

    def dropped(self, count: int) -> None:
        """Store the number of updates that were not drawn."""
        if self._truth.origin is not None:
            words = f"{counted(count, 'update')} dropped: drawing is too slow"
            self._recording.event(self._time.newest, words)

    @property
    def _entities(self) -> list[scene_entities.EstimateEntities]:
        return [each.entities for each in self._estimates.values()]

    def _declare(self) -> None:
        declare = functools.partial(appearance.declare, is_live=True)
        self._recording.send(declare, self._entities, self._gauge, self._up)

    def _tell_shift(self) -> None:
        """State how times of the picture differ from timestamps, if this has changed."""
        if self._time.shift_ns == self._told_shift_ns:
            return
        self._told_shift_ns = self._time.shift_ns
        shift_s = self._told_shift_ns // NANOSECONDS
        words = f"time stepped back: the picture's times are now timestamps + {shift_s} s"
        self._recording.event(self._time.newest, words, warn=False)

    def _draw_errors(self, each: EstimatePicture, time: int, *, is_growing: bool = True) -> None:
        """Draw all errors of a segment with its alignment: colours, correspondences and map."""
        if each.has_grown or not is_growing:
            full_m = each.colour(time)
            if full_m != self._full_m:
                self._full_m = full_m
                self._recording.log(time, *legend.scale(full_m))
        each.correspond(time, self._full_m or 1.0)
        assert self._truth.origin is not None
        stamps, _ = each.memory.columns()
        aligned = each.aligned + self._truth.origin
        on_map = each.entities.on_map
        self._map.draw_track(time, on_map, stamps, aligned, is_growing=is_growing)

    def _layout(self, bounds: tuple[Floats, Floats] | None = None) -> Any:
        has_map = self._map.datum is not None
        return blueprint(self._entities, self._gauge, is_live=True, has_map=has_map, bounds=bounds)

    def _frame(self) -> None:
        """Set the view so that a newly opened recording shows the whole run."""
        aligned = [
            each.aligned
            for each in self._estimates.values()
            if len(each.memory) and each.similarity is not None
        ]
        if len(self._truth.corners):
            seen = self._layout(bounds_of([self._truth.corners, *aligned]))
            self._recording.send(
                lambda recording: recording.send_blueprint(seen, make_active=False)
            )

    def _tell(self, time: int, *, is_growing: bool = True) -> None:
        told = [each for each in self._estimates.values() if each.snapshot is not None]
        snapshots = [each.snapshot for each in told if each.snapshot is not None]
        words = text_panel.of_snapshots(
            snapshots,
            [each.entities.name for each in told],
            self._gauge,
            self._full_m,
            is_growing=is_growing,
        )
        self._recording.log(time, scene_entities.SUMMARY, entity_data.summary(words))
