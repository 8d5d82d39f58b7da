"""Groundtruth, estimates and scans of a live picture."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps, lengths
from trajeval_ros.geometry.gauge import Gauge, Similarity
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.viewer import appearance, colours, entity_data, scene_entities, text_panel
from trajeval_ros.viewer.appearance import ErrorScale
from trajeval_ros.viewer.entity_data import LineLook
from trajeval_ros.viewer.live_path import NEVER, LivePath, LiveRecording, RowHistory, Thinning
from trajeval_ros.viewer.paths import bounds_of, gaps, origin_for, pieces, size_of
from trajeval_ros.viewer.scene_entities import EstimateEntities, GroundtruthEntities
from trajeval_ros.viewer.state_lanes import TRACKED, LiveLanes

if TYPE_CHECKING:
    from trajeval_ros.metrics.availability import AvailableSamples
    from trajeval_ros.online.live_relative_errors import RelativeEnd
    from trajeval_ros.online.reports import Snapshot, Update

DRAWN_EVERY_NS = NANOSECONDS // 5  # ends of paths, and relative errors of a length
_MOST_WAITING = 60  # 30 s of scans: groundtruth may arrive late
_LARGEST_STEP_NS = NANOSECONDS // 10  # from a scan to the nearest pose
_KEPT_NS = 5 * NANOSECONDS  # poses that a later scan may belong to: a large message arrives late


class GroundtruthPicture:
    """Draws the groundtruth."""

    def __init__(self, recording: LiveRecording) -> None:
        self._recording = recording
        self.newest = NEVER  # the newest timestamp, nanoseconds
        self.origin: Floats | None = None  # origin of all drawn positions, (3,), in its frame
        self.corners: Floats = np.empty((0, 3))  # smallest and largest drawn coordinates, (2, 3)
        self._path = LivePath(GroundtruthEntities.path, recording.log, appearance.GROUNDTRUTH_PATH)
        self._thinning, self._drawn_at = Thinning(), NEVER

    def begin(self, stamp: int, states: Floats) -> None:
        """Set the origin by the first states (N, 10) of the run."""
        self.origin = origin_for(states[:, :3])
        self._recording.begin = stamp
        self.draw_origin()
        start = entity_data.marker(states[0, :3] - self.origin, colours.GROUNDTRUTH)
        self._recording.log(stamp, GroundtruthEntities.start, start)

    def add(self, stamps: Stamps, states: Floats) -> None:
        """Add timestamps (N,), N > 0, and finite states (N, 10)."""
        assert self.origin is not None
        points = states[:, :3] - self.origin
        self.corners = np.stack(bounds_of([np.concatenate([self.corners, points])]))
        for row in self._thinning.pick(stamps).tolist():
            self._path.add(int(stamps[row]), points[row])
        self.newest = int(stamps[-1])
        if self.newest >= self._drawn_at + DRAWN_EVERY_NS:
            self._drawn_at = self.newest
            self._path.draw_to(self.newest, points[-1])
            pose = entity_data.poses(points[-1:], states[-1:, 3:7])
            self._recording.log(self.newest, GroundtruthEntities.pose, pose.row())

    @property
    def size_m(self) -> float:
        """Size of the scene, metres."""
        return size_of((self.corners[0], self.corners[-1])) if len(self.corners) else 1.0

    def draw_again(self) -> None:
        """Draw everything so far on a new recording."""
        self.draw_origin()
        self._path.draw_again()

    def draw_origin(self) -> None:
        """Draw the origin, if there is one."""
        if self.origin is None:
            return
        self._recording.send(entity_data.send_origin, self.origin)
        if self.origin.any():
            words = text_panel.origin_in_words(self.origin)
            self._recording.event(self._recording.begin, words, warn=False)


_COLOURED_WHEN_GROWN_BY = 1.25
_COLOURED_STEPS = 3  # of one piece of a path
_MOST_COLOURED = 4000  # pieces
_MOST_CORRESPONDENCES = 40
_LEAST_JUMP_M = 0.2
# Rotation errors under the first alignment, of a short path, would flatten the plot of a run.
_SETTLING_NS = 2 * NANOSECONDS
_RARE_NS = NANOSECONDS // 4  # between updates: errors between them are drawn, too


class EstimatePicture:
    """Draws one estimate."""

    def __init__(
        self,
        entities: scene_entities.EstimateEntities,
        look: LineLook,
        recording: LiveRecording,
        lanes: LiveLanes,
        *,
        is_alone: bool,
    ) -> None:
        self.entities, self._recording, self._lanes = entities, recording, lanes
        self._path, self._is_alone = LivePath(entities.path, recording.log, look), is_alone
        self._thinning = Thinning()
        self.memory = RowHistory(6)  # positions of groundtruth and estimate of the pairs
        self.rotations = RowHistory(1)  # drawn rotation errors, degrees
        self.scans = LiveScans(entities, recording)  # scans that were measured in its body
        self._errors_at = NEVER  # time of the newest drawn error
        self._settled_at: int | None = None  # time of the first drawn rotation error
        self._between = Thinning()
        self.origin: Floats | None = None  # origin of its drawn positions, (3,), in its frame
        self.similarity: Similarity | None = None  # the newest alignment, of drawn positions
        self.snapshot: Snapshot | None = None  # the newest state of its evaluation
        self.told_at = self._drawn_at = NEVER  # time of its newest text, and of its newest path
        self._coloured, self.is_available = 0, False
        self._is_revised = False  # whether errors of the newest path exist
        self._lengths: dict[str, int] = {}  # time of the newest drawn error by length

    def draw_again(self) -> None:
        """Draw the path on a new recording, and the styles that only some runs need."""
        self._coloured = 0
        if self._is_revised:
            self._recording.send(appearance.declare_revised, self.entities)
        if self.is_available:
            self._recording.send(appearance.declare_available, self.entities)
        for place, length in enumerate(self._lengths):
            self._recording.send(appearance.declare_length, self.entities, length, place)
        self._path.draw_again()
        self.scans.declare()

    def add(self, stamps: Stamps, groundtruth: Floats, states: Floats) -> None:
        """Add pairs.

        Args:
            stamps: Timestamps (N,), N > 0.
            groundtruth: Drawn positions of the groundtruth (N, 3).
            states: States (N, 10).
        """
        if self.origin is None:
            self.origin = origin_for(states[:, :3])
        for row in self._thinning.pick(stamps).tolist():
            time, point = int(stamps[row]), states[row, :3] - self.origin
            gap = self._path.add(time, point)
            if not len(self.memory):
                self._lanes.change(self.entities.tracking, time, TRACKED)
            if gap:
                self._recording.event(time, text_panel.gap_in_words(self.entities.name, gap))
                self._lanes.gap(self.entities.tracking, time, gap)
                self.interrupt()
            self.memory.add(time, np.concatenate([groundtruth[row], point]))
        self.scans.place(stamps, states[:, :7] - np.append(self.origin, np.zeros(4)))
        newest = int(stamps[-1])
        if newest >= self._drawn_at + DRAWN_EVERY_NS:
            self._drawn_at = newest
            point = states[-1, :3] - self.origin
            self._path.draw_to(newest, point)
            pose = entity_data.poses(point[None], states[-1:, 3:7])
            self._recording.log(newest, self.entities.pose, pose.row())

    def update(self, update: Update) -> None:
        """Draw the published errors of the newest pair; after a pause, those before it, too."""
        if update.stamp is None:
            return
        if self._errors_at != NEVER and update.stamp > self._errors_at + _RARE_NS:
            self._draw_between(update)
        self._draw_error(update.stamp, update.position_m, update.rotation_deg)
        for end in update.ends:
            self._end(end)

    def interrupt(self) -> None:
        """End the lines of the plots, because errors are missing."""
        if self._errors_at != NEVER:
            for quantity in (scene_entities.POSITION_ERROR, scene_entities.ROTATION_ERROR):
                self._number(self._errors_at + 1, quantity, math.nan)

    def _draw_between(self, update: Update) -> None:
        assert update.stamp is not None
        for errors in update.errors:
            for row in self._between.pick(errors.stamps).tolist():
                time, degrees = int(errors.stamps[row]), errors.rotation_deg
                if self._errors_at < time < update.stamp:
                    angle = None if degrees is None else float(degrees[row])
                    self._draw_error(time, float(errors.position_m[row]), angle)

    def _draw_error(self, time: int, position_m: float | None, angle: float | None) -> None:
        self._number(time, scene_entities.POSITION_ERROR, position_m)
        self._errors_at = time
        if angle is None:
            return
        if self._settled_at is None:
            self._settled_at = time + _SETTLING_NS
        if self._is_settled(time):
            self.rotations.add(time, np.array([angle]))
            self._number(time, scene_entities.ROTATION_ERROR, angle)

    def _is_settled(self, time: int) -> bool:
        return self._settled_at is not None and time >= self._settled_at

    def errors(self, time: int, snapshot: Snapshot, revised_m: float | None) -> None:
        """Draw the published errors of the window, and of the newest path, metres."""
        self.snapshot = snapshot
        if revised_m is not None and not self._is_revised:
            self._is_revised = True
            self._recording.send(appearance.declare_revised, self.entities)
        rotation_deg = text_panel.rmse_of(snapshot.ate, "rotation_deg")
        for quantity, value in (
            (scene_entities.ATE_POSITION, snapshot.window_position_rmse_m),
            (scene_entities.ATE_ROTATION, rotation_deg if self._is_settled(time) else None),
            (scene_entities.YAW_ERROR, text_panel.rmse_of(snapshot.ate, "yaw_deg")),
            (scene_entities.REVISED_ATE_POSITION, revised_m),
        ):
            self._number(time, quantity, value)

    def available(self, samples: AvailableSamples) -> None:
        """Draw the newest of as-available errors, N > 0."""
        if not self.is_available:
            self.is_available = True
            self._recording.send(appearance.declare_available, self.entities)
        time = int(samples.stamps[-1])
        self._number(time, scene_entities.AVAILABLE_POSITION, float(samples.position_m[-1]))
        self._number(time, scene_entities.POSE_AGE, float(samples.age[-1]) / NANOSECONDS)

    def uncertainty(self, stamp: int, position: Floats, covariance: Floats) -> None:
        """Draw a position (3,) and its covariance (3, 3), in its own frame."""
        if self.origin is not None:
            around = (position - self.origin)[None]
            ellipsoid = entity_data.ellipsoids(around, covariance[None])
            self._recording.log(stamp, self.entities.covariance, ellipsoid.row())

    def align(self, time: int, similarity: Similarity, gauge: Gauge, up: UpAxis) -> None:
        """Move the estimate, and report large movements."""
        before, self.similarity = self.similarity, similarity
        self._recording.log(time, self.entities.frame, entity_data.alignment(similarity))
        level = up.matrix @ similarity.rotation @ up.matrix.T
        yaw = float(Rotation.from_matrix(level).as_euler("ZYX", degrees=True)[0])
        self._number(time, scene_entities.ALIGNMENT_YAW, yaw)
        if gauge.has_scale:
            self._number(time, scene_entities.SCALE, similarity.scale)
        name = self.entities.name
        if before is None:
            self._recording.event(time, f"{name}: aligned for the first time", warn=False)
            return
        _, rows = self.memory.columns()
        moved = similarity.positions(rows[-1:, 3:]) - before.positions(rows[-1:, 3:])
        moved_m = float(np.linalg.norm(moved))
        assert self.snapshot is not None
        if moved_m > max(_LEAST_JUMP_M, self.snapshot.position_rmse_m or 0.0):
            words = f"{name}: the alignment moves the end by {moved_m:.2f} m"
            self._recording.event(time, words, warn=False)

    @property
    def has_grown(self) -> bool:
        """Whether the path has many pairs that are not coloured yet."""
        return len(self.memory) >= _COLOURED_WHEN_GROWN_BY * self._coloured

    @property
    def position_errors(self) -> Floats:
        """The position errors of the run with the present alignment, (N,), metres."""
        _, rows = self.memory.columns()
        return lengths(rows[:, :3] - self.aligned)

    def colour(self, time: int, scale: ErrorScale) -> None:
        """Colour the path by its errors with the present alignment."""
        times, rows = self.memory.columns()
        self._coloured = len(rows)
        most = min(_MOST_COLOURED, -(-len(rows) // _COLOURED_STEPS))
        parts = pieces(len(rows), gaps(times), most)
        path = entity_data.path_by_error(rows[:, 3:], self.position_errors, parts, scale.full_m)
        self._recording.log(time, self.entities.by_error, path.row())
        if self._is_alone:  # the line under the coloured one would show as dashes
            self._path.restart(time)

    def correspond(self, time: int, scale: ErrorScale) -> None:
        """Draw errors as lines, evenly over the run."""
        _, rows = self.memory.columns()
        some = slice(None, None, max(1, len(rows) // _MOST_CORRESPONDENCES))
        joined = entity_data.correspondences(
            rows[some, :3], self.aligned[some], scale.full_m, scale.factor
        )
        self._recording.log(time, self.entities.correspondences, joined.row())

    @property
    def aligned(self) -> Floats:
        """The path under the present alignment, (N, 3), in drawn positions."""
        assert self.similarity is not None
        _, rows = self.memory.columns()
        return self.similarity.positions(rows[:, 3:])

    def _number(self, time: int, quantity: str, value: float | None) -> None:
        self._recording.number(time, self.entities.metric(quantity), value)

    def _end(self, end: RelativeEnd) -> None:
        """Draw the error of a sub-trajectory, with a limited rate per length."""
        if end.length not in self._lengths:
            self._lengths[end.length] = NEVER
            place = len(self._lengths) - 1
            self._recording.send(appearance.declare_length, self.entities, end.length, place)
        if end.stamp >= self._lengths[end.length] + DRAWN_EVERY_NS:
            self._lengths[end.length] = end.stamp
            entity = self.entities.metric(scene_entities.RELATIVE_ERROR, end.length)
            self._recording.number(end.stamp, entity, end.position_m)


class LiveScans:
    """Draws scans at the nearest poses of one estimate, in its frame.

    An alignment that changes moves them with the estimate.
    """

    def __init__(self, entities: EstimateEntities, recording: LiveRecording) -> None:
        self._entities, self._recording = entities, recording
        self._waiting: deque[tuple[int, Floats]] = deque(maxlen=_MOST_WAITING)
        self._last: tuple[Stamps, Floats] = np.empty(0, np.int64), np.empty((0, 7))
        self._is_declared = False

    def add(self, stamp: int, points: Floats) -> None:
        """Add points (N, 3) in the frame of the body at a timestamp, metres."""
        self._waiting.append((stamp, points))

    def place(self, stamps: Stamps, poses: Floats) -> None:
        """Draw the scans until the newest pose; poses (N, 7), xyzw, have timestamps (N,)."""
        stamps = np.concatenate([self._last[0], stamps])
        poses = np.concatenate([self._last[1], poses])
        kept = slice(int(stamps.searchsorted(stamps[-1] - _KEPT_NS)), None)
        self._last = stamps[kept], poses[kept]
        while self._waiting and self._waiting[0][0] <= stamps[-1]:
            stamp, points = self._waiting.popleft()
            nearest = int(np.abs(stamps - stamp).argmin())
            if abs(int(stamps[nearest]) - stamp) <= _LARGEST_STEP_NS:
                self._draw(stamp, lie.rotate(poses[nearest, 3:], points) + poses[nearest, :3])

    def declare(self) -> None:
        """Log the style, if there are scans."""
        if self._is_declared:
            self._recording.send(appearance.declare_points, self._entities)

    def _draw(self, stamp: int, points: Floats) -> None:
        if not self._is_declared:
            self._is_declared = True
            self.declare()
        self._recording.log(stamp, self._entities.points, entity_data.points(points).row())
