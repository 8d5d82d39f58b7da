"""The picture of a live run, drawn incrementally on the thread of a sink."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.similarity import Similarity
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.viewer import (
    appearance,
    colours,
    entity_data,
    legend,
    scene_entities,
    text_panel,
)
from trajeval_ros.viewer.blueprint import blueprint
from trajeval_ros.viewer.live_map import LiveMap
from trajeval_ros.viewer.live_path import LivePath, RowHistory, Thinning
from trajeval_ros.viewer.map_track import is_on_map
from trajeval_ros.viewer.paths import between_origins, bounds_of, gaps, origin_for, pieces

if TYPE_CHECKING:
    from trajeval_ros.online.live_relative_errors import RelativeEnd
    from trajeval_ros.online.reports import Snapshot, Update


_DRAWN_EVERY_NS = NANOSECONDS // 5  # paths, and relative errors of a length
_WORDS_EVERY_NS = 2 * NANOSECONDS
_COLOURED_WHEN_GROWN_BY = 1.25
_COLOURED_STEPS = 3  # of one piece of a path
_MOST_COLOURED = 4000  # pieces
_MOST_CORRESPONDENCES = 40
_LEAST_JUMP_M = 0.2
_NEVER = np.iinfo(np.int64).min


class LiveEstimatePicture:
    """The state of one estimate's picture."""

    def __init__(self, entities: scene_entities.EstimateEntities, log: Any) -> None:
        """Create it without a pose."""
        self.entities = entities
        self.path = LivePath(entities.path, log)
        self.thinning, self.memory = Thinning(), RowHistory(6)
        self.origin: Floats | None = None
        self.similarity: Similarity | None = None
        self.snapshot: Snapshot | None = None
        self.drawn_at = self.told_at = _NEVER
        self.coloured = 0
        self.is_revised = False  # whether errors of the newest path exist
        self.lengths: dict[str, int] = {}  # timestamp of the newest drawn error by length


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
        self._recording: Any = None
        self._gauge, self._up = gauge, Z_UP
        self._estimates = {
            name: LiveEstimatePicture(scene_entities.EstimateEntities(name, place), self._log)
            for place, name in enumerate(names)
        }
        self._truth = LivePath(scene_entities.GroundtruthEntities.path, self._log)
        self._truth_thinning, self._truth_memory = Thinning(), RowHistory(3)
        self._origin: Floats | None = None
        self._truth_drawn_at = self._begin = _NEVER
        self._full_m: float | None = None
        self._map = LiveMap(self._log)
        self.blueprint = self._layout()

    def begin(self, recording: Any) -> None:
        """Draw on a recording from now on, starting with the data so far."""
        self._recording = recording
        recording.send_recording_name(self._title)
        appearance.declare(recording, self._entities, self._gauge, self._up)
        if self._origin is not None:
            self._draw_origin()
        stamps, points = self._truth_memory.columns()
        self._draw_again(scene_entities.GroundtruthEntities.path.past, stamps, points)
        if self._map.datum is not None:
            appearance.declare_map(recording, self._entities)
            self._map.draw(is_growing=True)
        self._full_m = None  # draws the scale of the legend again, together with the colours
        for each in self._estimates.values():
            each.coloured = 0
            if each.is_revised:
                appearance.declare_revised(recording, each.entities)
            for place, length in enumerate(each.lengths):
                appearance.declare_length(recording, each.entities, length, place)
            stamps, rows = each.memory.columns()
            self._draw_again(each.entities.path.past, stamps, rows[:, 3:])

    def leave(self) -> None:
        """Stop drawing until another recording begins."""
        self._recording = None

    def finish(self) -> None:
        """Draw all periodic entities for the last time."""
        for each in self._estimates.values():
            stamps, _ = each.memory.columns()
            if len(stamps) and each.similarity is not None:
                self._colour(each, int(stamps[-1]))
                self._correspond(each, int(stamps[-1]))
                self._locate(each, int(stamps[-1]), is_growing=False)
                self._tell(int(stamps[-1]), is_growing=False)
        self._map.draw(is_growing=False)
        self._frame()

    def groundtruth(self, stamps: Stamps, states: Floats, up: UpAxis = Z_UP) -> None:
        """Add groundtruth: timestamps (N,), and states (N, 10)."""
        usable = np.isfinite(states[:, :3]).all(axis=1)
        stamps, states = stamps[usable], states[usable]
        if not len(stamps):
            return
        if self._origin is None:
            self._origin = origin_for(states[:, :3])
            self._begin = int(stamps[0])
            self._draw_origin()
            if up != self._up:
                self._up = up
                if self._recording is not None:
                    appearance.declare(self._recording, self._entities, self._gauge, up)
            self._log(
                self._begin,
                scene_entities.GroundtruthEntities.start,
                entity_data.start(self._at(states[0])),
            )
        for row in self._truth_thinning.pick(stamps).tolist():
            point = self._at(states[row])
            self._truth.add(int(stamps[row]), point)
            self._truth_memory.add(int(stamps[row]), point)
        stamp = int(stamps[-1])
        if stamp >= self._truth_drawn_at + _DRAWN_EVERY_NS:
            self._truth_drawn_at = stamp
            point = self._at(states[-1])
            self._truth.draw_to(stamp, point)
            pose = entity_data.poses(point[None], states[-1:, 3:7])
            self._log(stamp, scene_entities.GroundtruthEntities.pose, pose.row())

    def fixes(self, stamps: Stamps, fixes: Fixes) -> None:
        """Add the GNSS fixes, N > 0, whose states were passed to `groundtruth`."""
        if not is_on_map(fixes, self._up):
            return
        is_first = self._map.datum is None
        if is_first and self._recording is not None:
            appearance.declare_map(self._recording, self._entities)
        self._map.add(stamps, fixes)
        if is_first:
            self.blueprint = self._layout()
            if self._recording is not None:
                self._recording.send_blueprint(self.blueprint)

    def pairs(self, name: str, stamps: Stamps, truth: Floats, states: Floats) -> None:
        """Add pairs of an estimate: timestamps (N,), groundtruth and estimate (N, 10)."""
        each = self._estimates[name]
        if not len(stamps) or self._origin is None:
            return
        if each.origin is None:
            each.origin = origin_for(states[:, :3])
        for row in each.thinning.pick(stamps).tolist():
            stamp, point = int(stamps[row]), states[row, :3] - each.origin
            gap = each.path.add(stamp, point)
            if gap:
                self.event(stamp, text_panel.gap_in_words(name, gap))
            each.memory.add(stamp, np.concatenate([truth[row, :3] - self._origin, point]))
        stamp = int(stamps[-1])
        if stamp >= each.drawn_at + _DRAWN_EVERY_NS:
            each.drawn_at = stamp
            point = states[-1, :3] - each.origin
            each.path.draw_to(stamp, point)
            pose = entity_data.poses(point[None], states[-1:, 3:7])
            self._log(stamp, each.entities.pose, pose.row())

    def update(self, name: str, update: Update) -> None:
        """Draw the published errors of the newest pair."""
        each = self._estimates[name]
        if update.stamp is None:
            return
        self._number(update.stamp, each, scene_entities.POSITION_ERROR, update.position_m)
        self._number(update.stamp, each, scene_entities.ROTATION_ERROR, update.rotation_deg)
        for end in update.ends:
            self._end(each, end)

    def snapshot(self, name: str, stamp: int, snapshot: Snapshot, revised_m: float | None) -> None:
        """Draw the published state of an evaluation at a timestamp.

        `revised_m` is the position ATE of the newest path, metres; None without one.
        """
        each = self._estimates[name]
        each.snapshot = snapshot
        if revised_m is not None and not each.is_revised:
            each.is_revised = True
            if self._recording is not None:
                appearance.declare_revised(self._recording, each.entities)
        for quantity, value in (
            (scene_entities.ATE_POSITION, snapshot.window_position_rmse_m),
            (scene_entities.ATE_ROTATION, text_panel.rmse_of(snapshot.ate, "rotation_deg")),
            (scene_entities.YAW_ERROR, text_panel.rmse_of(snapshot.ate, "yaw_deg")),
            (scene_entities.REVISED_ATE_POSITION, revised_m),
        ):
            self._number(stamp, each, quantity, value)
        if snapshot.alignment is not None and each.origin is not None:
            assert self._origin is not None
            similarity = between_origins(snapshot.alignment.similarity, self._origin, each.origin)
            self._align(each, stamp, similarity)
        if stamp >= each.told_at + _WORDS_EVERY_NS:
            each.told_at = stamp
            if each.similarity is not None:
                if len(each.memory) >= _COLOURED_WHEN_GROWN_BY * each.coloured:
                    self._colour(each, stamp)
                self._correspond(each, stamp)
                self._locate(each, stamp)
            self._tell(stamp)

    def uncertainty(self, name: str, stamp: int, position: Floats, covariance: Floats) -> None:
        """Draw a position (3,) of an estimate and its covariance (3, 3), in its own frame."""
        each = self._estimates[name]
        if each.origin is not None:
            around = (position - each.origin)[None]
            ellipsoid = entity_data.ellipsoids(around, covariance[None])
            self._log(stamp, each.entities.covariance, ellipsoid.row())

    def event(self, stamp: int, text: str, *, warn: bool = True) -> None:
        """Add a line to the log."""
        since = "" if self._begin == _NEVER else f"{(stamp - self._begin) / NANOSECONDS:.1f} s: "
        self._log(stamp, scene_entities.EVENTS, entity_data.event(since + text, warn=warn))

    def dropped(self, count: int) -> None:
        """Store the number of updates that were not drawn."""
        stamps, _ = self._truth_memory.columns()
        if len(stamps):
            self.event(int(stamps[-1]), f"{counted(count, 'update')} dropped: drawing is too slow")

    @property
    def _entities(self) -> list[scene_entities.EstimateEntities]:
        return [each.entities for each in self._estimates.values()]

    def _log(self, stamp: int, entity: str, row: Any) -> None:
        if self._recording is not None:
            entity_data.log(self._recording, entity, stamp, row)

    def _number(
        self, stamp: int, each: LiveEstimatePicture, quantity: str, value: float | None
    ) -> None:
        if value is not None:
            self._log(stamp, each.entities.metric(quantity), entity_data.numbers([value]).row())

    def _at(self, state: Floats) -> Floats:
        assert self._origin is not None
        return state[:3] - self._origin

    def _draw_origin(self) -> None:
        assert self._origin is not None
        if self._recording is not None:
            entity_data.send_origin(self._recording, self._origin)
        if self._origin.any():
            self.event(self._begin, text_panel.origin_in_words(self._origin), warn=False)

    def _end(self, each: LiveEstimatePicture, end: RelativeEnd) -> None:
        """Draw the error of a sub-trajectory, with a limited rate per length."""
        if end.length not in each.lengths:
            each.lengths[end.length] = _NEVER
            if self._recording is not None:
                place = len(each.lengths) - 1
                appearance.declare_length(self._recording, each.entities, end.length, place)
        if end.stamp >= each.lengths[end.length] + _DRAWN_EVERY_NS:
            each.lengths[end.length] = end.stamp
            entity = each.entities.metric(scene_entities.RELATIVE_ERROR, end.length)
            self._log(end.stamp, entity, entity_data.numbers([end.position_m]).row())

    def _align(self, each: LiveEstimatePicture, stamp: int, similarity: Similarity) -> None:
        """Move the estimate, and report large movements."""
        before, each.similarity = each.similarity, similarity
        self._log(stamp, each.entities.frame, entity_data.alignment(similarity))
        level = self._up.matrix @ similarity.rotation @ self._up.matrix.T
        yaw = float(Rotation.from_matrix(level).as_euler("ZYX", degrees=True)[0])
        self._number(stamp, each, scene_entities.ALIGNMENT_YAW, yaw)
        if self._gauge.has_scale:
            self._number(stamp, each, scene_entities.SCALE, similarity.scale)
        name = each.entities.name
        if before is None:
            self.event(stamp, f"{name}: aligned for the first time", warn=False)
            return
        _, rows = each.memory.columns()
        moved = similarity.positions(rows[-1:, 3:]) - before.positions(rows[-1:, 3:])
        moved_m = float(np.linalg.norm(moved))
        assert each.snapshot is not None
        if moved_m > max(_LEAST_JUMP_M, each.snapshot.position_rmse_m or 0.0):
            self.event(
                stamp, f"{name}: the alignment moves the end by {moved_m:.2f} m", warn=False
            )

    def _colour(self, each: LiveEstimatePicture, stamp: int) -> None:
        """Colour the whole path by its errors with the present alignment."""
        assert each.similarity is not None
        stamps, rows = each.memory.columns()
        difference = rows[:, :3] - each.similarity.positions(rows[:, 3:])
        errors = np.sqrt(np.einsum("ni,ni->n", difference, difference))
        full_m = colours.scale_for(errors)
        if full_m != self._full_m:
            self._full_m = full_m
            self._log(stamp, *legend.scale(full_m))
        each.coloured = len(rows)
        most = min(_MOST_COLOURED, -(-len(rows) // _COLOURED_STEPS))
        parts = pieces(len(rows), gaps(stamps), most)
        path = entity_data.path_by_error(rows[:, 3:], errors, parts, full_m)
        self._log(stamp, each.entities.by_error, path.row())

    def _correspond(self, each: LiveEstimatePicture, stamp: int) -> None:
        """Connect poses with their groundtruth, evenly over the run."""
        assert each.similarity is not None
        _, rows = each.memory.columns()
        rows = rows[:: max(1, len(rows) // _MOST_CORRESPONDENCES)]
        joined = entity_data.correspondences(
            rows[:, :3], each.similarity.positions(rows[:, 3:]), self._full_m or 1.0
        )
        self._log(stamp, each.entities.correspondences, joined.row())

    def _locate(self, each: LiveEstimatePicture, stamp: int, *, is_growing: bool = True) -> None:
        """Draw the aligned estimate on the map."""
        assert each.similarity is not None
        assert self._origin is not None
        stamps, rows = each.memory.columns()
        aligned = each.similarity.positions(rows[:, 3:]) + self._origin
        on_map = each.entities.on_map
        self._map.draw_track(stamp, on_map, stamps, aligned, is_growing=is_growing)

    def _layout(self, bounds: tuple[Floats, Floats] | None = None) -> Any:
        has_map = self._map.datum is not None
        return blueprint(self._entities, self._gauge, is_live=True, has_map=has_map, bounds=bounds)

    def _frame(self) -> None:
        """Set the view so that a newly opened recording shows the whole run."""
        _, truth = self._truth_memory.columns()
        paths = [truth] if len(truth) else []
        for each in self._estimates.values():
            _, rows = each.memory.columns()
            if len(rows) and each.similarity is not None:
                paths.append(each.similarity.positions(rows[:, 3:]))
        if paths and self._recording is not None:
            seen = self._layout(bounds_of(paths))
            self._recording.send_blueprint(seen, make_active=False)

    def _draw_again(self, entity: str, stamps: Stamps, points: Floats) -> None:
        """Draw a path on a new recording."""
        if len(stamps) > 1:
            cuts = np.flatnonzero(gaps(stamps)) + 1
            strips = [each for each in np.split(points, cuts) if len(each) > 1]
            self._log(int(stamps[-1]), entity, entity_data.lines(strips).row())

    def _tell(self, stamp: int, *, is_growing: bool = True) -> None:
        told = [each for each in self._estimates.values() if each.snapshot is not None]
        snapshots = [each.snapshot for each in told if each.snapshot is not None]
        words = text_panel.of_snapshots(
            snapshots,
            [each.entities.name for each in told],
            self._gauge,
            self._full_m,
            is_growing=is_growing,
        )
        self._log(stamp, scene_entities.SUMMARY, entity_data.summary(words))
