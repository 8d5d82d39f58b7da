"""One estimate of a live picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.similarity import Similarity
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.viewer import appearance, colours, entity_data, scene_entities, text_panel
from trajeval_ros.viewer.entity_data import LineLook
from trajeval_ros.viewer.groundtruth_picture import DRAWN_EVERY_NS
from trajeval_ros.viewer.live_path import LivePath, RowHistory, Thinning
from trajeval_ros.viewer.live_recording import NEVER, LiveRecording
from trajeval_ros.viewer.paths import gaps, origin_for, pieces
from trajeval_ros.viewer.picture_time import PictureTime, StreamTime

if TYPE_CHECKING:
    from trajeval_ros.online.live_relative_errors import RelativeEnd
    from trajeval_ros.online.reports import Snapshot, Update

_COLOURED_WHEN_GROWN_BY = 1.25
_COLOURED_STEPS = 3  # of one piece of a path
_MOST_COLOURED = 4000  # pieces
_MOST_CORRESPONDENCES = 40
_LEAST_JUMP_M = 0.2

Segment = tuple[int, int]  # number of steps back of time before it, and its number in the folder


class EstimatePicture:
    """Draws one estimate, segment by segment.

    Attributes:
        entities: Its entities.
        time: Its times in the picture.
        segment: The present segment.
        memory: Groundtruth and estimate of the segment's pairs, six numbers.
        origin: Origin of its drawn positions, (3,), in its frame; None before the first pair.
        similarity: The segment's newest alignment, of drawn positions.
        snapshot: The newest state of its evaluation.
        told_at: Time of its newest text.
    """

    def __init__(
        self,
        entities: scene_entities.EstimateEntities,
        look: LineLook,
        recording: LiveRecording,
        time: PictureTime,
    ) -> None:
        """Create it without a pose; `look` is of its path."""
        self.entities, self._recording = entities, recording
        self.time = StreamTime(time)
        self.segment: Segment = (0, 1)
        self._path = LivePath(entities.path, recording.log, look)
        self._thinning, self.memory = Thinning(), RowHistory(6)
        self.origin: Floats | None = None
        self.similarity: Similarity | None = None
        self.snapshot: Snapshot | None = None
        self.told_at = self._drawn_at = NEVER
        self._coloured = 0
        self._is_revised = False  # whether errors of the newest path exist
        self._lengths: dict[str, int] = {}  # time of the newest drawn error by length

    def begin_segment(self, segment: Segment, stamp: int) -> None:
        """Draw another path from a timestamp on, with its own alignment and colours."""
        self.segment = segment
        time = self.time.begin_segment(stamp)
        self._path.clear(time)
        self.memory, self.similarity, self._coloured = RowHistory(6), None, 0
        for each in (self.entities.by_error, self.entities.correspondences):
            self._recording.log(time, each, entity_data.lines([]).row())
        words = f"{self.entities.name}: the next segment starts"
        self._recording.event(time, words, warn=False)

    def draw_again(self) -> None:
        """Draw the segment's path on a new recording, and the styles that only some runs need."""
        self._coloured = 0
        if self._is_revised:
            self._recording.send(appearance.declare_revised, self.entities)
        for place, length in enumerate(self._lengths):
            self._recording.send(appearance.declare_length, self.entities, length, place)
        self._path.draw_again()

    def add(self, stamps: Stamps, truth: Floats, states: Floats) -> None:
        """Add pairs.

        Args:
            stamps: Timestamps (N,), N > 0.
            truth: Drawn positions of the groundtruth (N, 3).
            states: States (N, 10).
        """
        times = self.time.at(stamps)
        if self.origin is None:
            self.origin = origin_for(states[:, :3])
        for row in self._thinning.pick(times).tolist():
            time, point = int(times[row]), states[row, :3] - self.origin
            gap = self._path.add(time, point)
            if gap:
                self._recording.event(time, text_panel.gap_in_words(self.entities.name, gap))
            self.memory.add(time, np.concatenate([truth[row], point]))
        newest = int(times[-1])
        if newest >= self._drawn_at + DRAWN_EVERY_NS:
            self._drawn_at = newest
            point = states[-1, :3] - self.origin
            self._path.draw_to(newest, point)
            pose = entity_data.poses(point[None], states[-1:, 3:7])
            self._recording.log(newest, self.entities.pose, pose.row())

    def update(self, update: Update) -> None:
        """Draw the published errors of the newest pair."""
        if update.stamp is None:
            return
        time = update.stamp + self.time.shift_ns
        self._number(time, scene_entities.POSITION_ERROR, update.position_m)
        self._number(time, scene_entities.ROTATION_ERROR, update.rotation_deg)
        for end in update.ends:
            self._end(end)

    def errors(self, time: int, snapshot: Snapshot, revised_m: float | None) -> None:
        """Draw the published errors of the window, and of the newest path, metres."""
        self.snapshot = snapshot
        if revised_m is not None and not self._is_revised:
            self._is_revised = True
            self._recording.send(appearance.declare_revised, self.entities)
        for quantity, value in (
            (scene_entities.ATE_POSITION, snapshot.window_position_rmse_m),
            (scene_entities.ATE_ROTATION, text_panel.rmse_of(snapshot.ate, "rotation_deg")),
            (scene_entities.YAW_ERROR, text_panel.rmse_of(snapshot.ate, "yaw_deg")),
            (scene_entities.REVISED_ATE_POSITION, revised_m),
        ):
            self._number(time, quantity, value)

    def uncertainty(self, stamp: int, position: Floats, covariance: Floats) -> None:
        """Draw a position (3,) and its covariance (3, 3), in its own frame."""
        if self.origin is not None:
            around = (position - self.origin)[None]
            ellipsoid = entity_data.ellipsoids(around, covariance[None])
            self._recording.log(
                stamp + self.time.shift_ns, self.entities.covariance, ellipsoid.row()
            )

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

    def colour(self, time: int) -> float:
        """Colour the segment's path by its errors with the present alignment.

        Returns:
            The error at the end of the colour scale, metres.
        """
        times, rows = self.memory.columns()
        difference = rows[:, :3] - self.aligned
        errors = np.sqrt(np.einsum("ni,ni->n", difference, difference))
        full_m = colours.scale_for(errors)
        self._coloured = len(rows)
        most = min(_MOST_COLOURED, -(-len(rows) // _COLOURED_STEPS))
        parts = pieces(len(rows), gaps(times), most)
        path = entity_data.path_by_error(rows[:, 3:], errors, parts, full_m)
        self._recording.log(time, self.entities.by_error, path.row())
        return full_m

    def correspond(self, time: int, full_m: float) -> None:
        """Connect poses with their groundtruth, evenly over the segment."""
        _, rows = self.memory.columns()
        some = slice(None, None, max(1, len(rows) // _MOST_CORRESPONDENCES))
        joined = entity_data.correspondences(rows[some, :3], self.aligned[some], full_m)
        self._recording.log(time, self.entities.correspondences, joined.row())

    @property
    def aligned(self) -> Floats:
        """The segment's path under the present alignment, (N, 3), in drawn positions."""
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
        time = end.stamp + self.time.shift_ns
        if time >= self._lengths[end.length] + DRAWN_EVERY_NS:
            self._lengths[end.length] = time
            entity = self.entities.metric(scene_entities.RELATIVE_ERROR, end.length)
            self._recording.number(time, entity, end.position_m)
