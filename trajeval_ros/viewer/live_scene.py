"""The picture of a live run, drawn incrementally on the thread of a sink."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Level, Remark
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.viewer import appearance, colours, entity_data, scene_entities, text_panel
from trajeval_ros.viewer.appearance import ErrorScale
from trajeval_ros.viewer.blueprint import blueprint
from trajeval_ros.viewer.fix_map import LiveMap, is_on_map
from trajeval_ros.viewer.live_path import LiveRecording
from trajeval_ros.viewer.live_pictures import EstimatePicture, GroundtruthPicture
from trajeval_ros.viewer.named_frames import NamedFrames
from trajeval_ros.viewer.paths import between_origins, bounds_of
from trajeval_ros.viewer.recording_properties import send_of_snapshots
from trajeval_ros.viewer.state_lanes import LiveLanes

if TYPE_CHECKING:
    from trajeval_ros.metrics.availability import AvailableSamples
    from trajeval_ros.online.reports import Snapshot, Update


_WORDS_EVERY_NS = 2 * NANOSECONDS
_GROWN = 1.5  # of the scene, until the axes of poses are drawn larger


class LiveScene:
    """Draws on the present recording; without one it only stores the data."""

    def __init__(
        self, title: str, names: Sequence[str], gauge: Gauge, modality: str | None = None
    ) -> None:
        self._title = one_line(title)
        self._recording = LiveRecording()
        self._gauge, self._modality, self._up = gauge, modality, Z_UP
        self._groundtruth = GroundtruthPicture(self._recording)
        self._lanes, self._frames = LiveLanes(self._recording), NamedFrames()
        self._estimates: dict[str, EstimatePicture] = {}
        for place, name in enumerate(names):
            entities = scene_entities.EstimateEntities(name, place)
            look = appearance.path_of_estimate(entities.colour, len(names))
            self._estimates[name] = EstimatePicture(
                entities, look, self._recording, self._lanes, is_alone=len(names) == 1
            )
        self._scale: ErrorScale | None = None  # None before the first colours
        self._axes_for_m = 0.0  # size of the scene that the axes of poses are drawn for
        self._told: set[tuple[str, ...]] = set()
        self._map = LiveMap(self._recording.log)
        self.blueprint = self._layout()  # the layout

    def begin(self, recording: Any) -> None:
        """Draw on a recording from now on, starting with everything so far."""
        self._recording.stream = recording
        recording.send_recording_name(self._title)
        self._declare()
        self._groundtruth.draw_again()
        if self._map.datum is not None:
            appearance.declare_map(recording, self._entities)
            self._map.draw(is_growing=True)
        self._lanes.draw_again()
        self._frames.send(recording)
        for estimate in self._estimates.values():
            estimate.draw_again()
        self._colour(self._groundtruth.newest, is_growing=True)

    def leave(self) -> None:
        """Stop drawing until another recording begins."""
        self._recording.stream = None

    def finish(self) -> None:
        """Draw all periodic entities for the last time."""
        self._colour(self._groundtruth.newest, is_growing=False)
        for item in self._aligned:
            times, _ = item.memory.columns()
            self._draw_errors(item, int(times[-1]), is_growing=False)
            self._tell(int(times[-1]), is_growing=False)
        self._map.draw(is_growing=False)
        self._send_properties()
        self._frame()

    def groundtruth(
        self, stamps: Stamps, states: Floats, up: UpAxis = Z_UP, frame: str = "", body: str = ""
    ) -> None:
        """Add groundtruth: timestamps (N,), states (N, 10), the up axis and name of its frame.

        `body` is the name of its body's frame.
        """
        usable = np.isfinite(states[:, :3]).all(axis=1)
        stamps, states = stamps[usable], states[usable]
        if not len(stamps):
            return
        if self._groundtruth.origin is None:
            self._groundtruth.begin(int(stamps[0]), states)
            if up != self._up:
                self._up = up
                self._declare()
            self._attach(frame, scene_entities.WORLD, self._groundtruth.origin)
            self._attach(body, scene_entities.GroundtruthEntities.pose)
        self._groundtruth.add(stamps, states)
        if self._groundtruth.size_m > _GROWN * self._axes_for_m:
            self._axes_for_m = self._groundtruth.size_m
            self._recording.send(appearance.declare_axes, self._entities, self._axes_for_m)

    def fixes(self, stamps: Stamps, fixes: Fixes) -> None:
        """Add the GNSS fixes, N > 0, whose states were passed to `groundtruth`."""
        if not is_on_map(fixes, self._up):
            return
        is_first = self._map.datum is None
        if is_first:
            self._recording.send(appearance.declare_map, self._entities)
        self._map.add(stamps, fixes)
        self._lanes.fixes(stamps, fixes.status)
        if is_first:
            self.blueprint = self._layout()
            self._recording.send(lambda recording: recording.send_blueprint(self.blueprint))

    def pairs(
        self,
        name: str,
        stamps: Stamps,
        groundtruth: Floats,
        states: Floats,
        frame: str = "",
        body: str = "",
    ) -> None:
        """Add pairs of an estimate: timestamps (N,), groundtruth (N, 10), estimate (N, 10).

        `frame` and `body` are the names of the frames of its poses and of its body.
        """
        item = self._estimates[name]
        if len(stamps) and self._groundtruth.origin is not None:
            item.add(stamps, groundtruth[:, :3] - self._groundtruth.origin, states)
            self._attach(frame, item.entities.frame, item.origin)
            self._attach(body, item.entities.pose)

    def points(self, name: str, stamp: int, points: Floats) -> None:
        """Add a scan: points (N, 3) in the body of an estimate at a timestamp."""
        self._estimates[name].scans.add(stamp, points)

    def update(self, name: str, update: Update) -> None:
        """Draw the published errors of the newest pair."""
        self._estimates[name].update(update)

    def snapshot(
        self,
        name: str,
        stamp: int,
        snapshot: Snapshot,
        revised_m: float | None,
        available: AvailableSamples | None = None,
    ) -> None:
        """Draw the published state of an evaluation at a timestamp.

        `revised_m`: position ATE of the newest path, metres. `available`: errors, final now.
        """
        item, origin = self._estimates[name], self._groundtruth.origin
        item.errors(stamp, snapshot, revised_m)
        self._lanes.tracking(item.entities.tracking, stamp, snapshot.loss)
        if available is not None:
            item.available(available)
        if snapshot.alignment is not None and item.origin is not None:
            assert origin is not None
            similarity = between_origins(snapshot.alignment.similarity, origin, item.origin)
            item.align(stamp, similarity, self._gauge, self._up)
        if stamp >= item.told_at + _WORDS_EVERY_NS:
            item.told_at = stamp
            if item.similarity is not None:
                if item.has_grown:
                    self._colour(stamp, [item], is_growing=True)
                self._draw_errors(item, stamp)
            self._tell(stamp)

    def uncertainty(self, name: str, stamp: int, position: Floats, covariance: Floats) -> None:
        """Draw a position (3,) of an estimate and its covariance (3, 3), in its own frame."""
        self._estimates[name].uncertainty(stamp, position, covariance)

    def event(self, stamp: int, text: str) -> None:
        """Add a line to the log."""
        self._recording.event(stamp, text)

    def dropped(self, count: int) -> None:
        """Report the number of updates that were not drawn, and end the lines before them."""
        if self._groundtruth.origin is not None:
            words = f"{counted(count, 'update')} not drawn: the machine is too slow"
            self._recording.event(self._groundtruth.newest, words)
            for estimate in self._estimates.values():
                estimate.interrupt()

    def status(self, name: str, stamp: int, remarks: Sequence[Remark]) -> None:
        """Draw the status of an estimate at a time: all remarks about it that hold."""
        self._lanes.status(self._estimates[name].entities.name, stamp, remarks)
        new = [remark for remark in remarks if remark.level > Level.NOTE and remark.code != "jump"]
        for item in new:
            key = name, item.code, item.subject
            if key not in self._told:  # a set as large as the number of kinds of remarks
                self._told.add(key)
                self._recording.event(stamp, f"{name}: {item.text}")

    @property
    def _entities(self) -> list[scene_entities.EstimateEntities]:
        return [estimate.entities for estimate in self._estimates.values()]

    def _declare(self) -> None:
        declare = functools.partial(appearance.declare, is_live=True)
        self._recording.send(declare, self._entities, self._gauge, self._up)

    @property
    def _aligned(self) -> list[EstimatePicture]:
        """The estimates with pairs and an alignment."""
        known = self._estimates.values()
        return [item for item in known if len(item.memory) and item.similarity is not None]

    def _attach(self, frame: str, entity: str, origin: Floats | None = None) -> None:
        name = self._frames.attach(frame, entity, origin)
        if name is not None:
            self._recording.send(self._frames.send, name)

    def _colour(
        self, time: int, which: Sequence[EstimatePicture] = (), *, is_growing: bool
    ) -> None:
        """Colour paths by their errors; all of them if none are named or the scale changes."""
        if not self._aligned:
            return
        errors = np.concatenate([item.position_errors for item in self._aligned])
        present = self._scale.full_m if self._scale is not None and is_growing else None
        full_m = colours.lasting_scale(errors, present)
        if self._scale is None or full_m != self._scale.full_m or not which:
            which = self._aligned
            self._scale = ErrorScale.of(full_m, self._groundtruth.size_m)
            self._recording.log(time, *self._scale.row())
        for item in which:
            item.colour(time, self._scale)

    def _draw_errors(self, item: EstimatePicture, time: int, *, is_growing: bool = True) -> None:
        """Draw errors with the present alignment: lines, and the path on the map."""
        assert self._scale is not None
        item.correspond(time, self._scale)
        assert self._groundtruth.origin is not None
        stamps, _ = item.memory.columns()
        aligned = item.aligned + self._groundtruth.origin
        on_map = item.entities.on_map
        self._map.draw_track(time, on_map, stamps, aligned, is_growing=is_growing)

    def _layout(self, bounds: tuple[Floats, Floats] | None = None) -> Any:
        has_map = self._map.datum is not None
        rotations = [
            estimate.rotations.columns()[1].ravel() for estimate in self._estimates.values()
        ]
        positions = [np.empty(0), *(item.position_errors for item in self._aligned)]
        return blueprint(
            self._entities,
            self._gauge,
            is_live=True,
            has_available=any(estimate.is_available for estimate in self._estimates.values()),
            has_map=has_map,
            bounds=bounds,
            positions_m=np.concatenate(positions),
            rotations_deg=np.concatenate(rotations),
        )

    def _send_properties(self) -> None:
        evaluated = [
            estimate for estimate in self._estimates.values() if estimate.snapshot is not None
        ]
        self._recording.send(
            send_of_snapshots,
            self._title,
            (self._gauge, self._modality),
            [item.snapshot for item in evaluated],
            [item.entities.name for item in evaluated],
        )

    def _frame(self) -> None:
        """Set the view so that a newly opened recording shows the whole run."""
        aligned = [item.aligned for item in self._aligned]
        if len(self._groundtruth.corners):
            seen = self._layout(bounds_of([self._groundtruth.corners, *aligned]))
            self._recording.send(
                lambda recording: recording.send_blueprint(seen, make_active=False)
            )

    def _tell(self, time: int, *, is_growing: bool = True) -> None:
        evaluated = [
            estimate for estimate in self._estimates.values() if estimate.snapshot is not None
        ]
        snapshots = [item.snapshot for item in evaluated if item.snapshot is not None]
        words = text_panel.of_snapshots(
            snapshots,
            [item.entities.name for item in evaluated],
            self._gauge,
            self._scale,
            is_growing=is_growing,
        )
        self._recording.log(time, scene_entities.SUMMARY, entity_data.summary(words))
