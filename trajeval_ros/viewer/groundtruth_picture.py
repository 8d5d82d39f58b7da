"""The groundtruth of a live picture."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.viewer import appearance, entity_data, text_panel
from trajeval_ros.viewer.live_path import LivePath, Thinning
from trajeval_ros.viewer.live_recording import NEVER, LiveRecording
from trajeval_ros.viewer.paths import bounds_of, origin_for
from trajeval_ros.viewer.picture_time import PictureTime, StreamTime
from trajeval_ros.viewer.scene_entities import GroundtruthEntities

DRAWN_EVERY_NS = NANOSECONDS // 5  # ends of paths, and relative errors of a length


class GroundtruthPicture:
    """Draws the groundtruth, loop by loop.

    Attributes:
        time: Its times in the picture.
        epoch: Number of steps back of its time so far.
        origin: Origin of all drawn positions, (3,), in its frame; None before the first state.
        corners: Smallest and largest drawn coordinates of the run, (2, 3); empty before.
    """

    def __init__(self, recording: LiveRecording, time: PictureTime) -> None:
        """Create it without a state."""
        self._recording = recording
        self.time, self.epoch = StreamTime(time), 0
        self.origin: Floats | None = None
        self.corners: Floats = np.empty((0, 3))
        self._path = LivePath(GroundtruthEntities.path, recording.log, appearance.GROUNDTRUTH_PATH)
        self._thinning, self._drawn_at = Thinning(), NEVER

    def begin(self, stamp: int, states: Floats) -> None:
        """Set the origin by the first states (N, 10) of the run."""
        self.origin = origin_for(states[:, :3])
        self._recording.begin = stamp
        self.draw_origin()
        self._draw_start(stamp, states)

    def begin_loop(self, epoch: int, stamp: int, states: Floats) -> None:
        """Start another path at a timestamp, with states (N, 10), as time has stepped back."""
        self.epoch = epoch
        time = self.time.begin_segment(stamp)
        self._path.clear(time)
        self._draw_start(time, states)

    def add(self, stamps: Stamps, states: Floats) -> None:
        """Add timestamps (N,), N > 0, and finite states (N, 10)."""
        assert self.origin is not None
        times, points = self.time.at(stamps), states[:, :3] - self.origin
        self.corners = np.stack(bounds_of([np.concatenate([self.corners, points])]))
        for row in self._thinning.pick(times).tolist():
            self._path.add(int(times[row]), points[row])
        newest = int(times[-1])
        if newest >= self._drawn_at + DRAWN_EVERY_NS:
            self._drawn_at = newest
            self._path.draw_to(newest, points[-1])
            pose = entity_data.poses(points[-1:], states[-1:, 3:7])
            self._recording.log(newest, GroundtruthEntities.pose, pose.row())

    def draw_again(self) -> None:
        """Draw the present loop on a new recording."""
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

    def _draw_start(self, time: int, states: Floats) -> None:
        assert self.origin is not None
        start = entity_data.start(states[0, :3] - self.origin)
        self._recording.log(time, GroundtruthEntities.start, start)
