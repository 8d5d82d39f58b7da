"""Scans of a lidar, drawn where the estimate places them."""

from __future__ import annotations

from collections import deque

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.viewer import appearance, entity_data
from trajeval_ros.viewer.live_path import LiveRecording
from trajeval_ros.viewer.scene_entities import EstimateEntities

_MOST_WAITING = 60  # 30 s of scans: groundtruth may arrive late
_LARGEST_STEP_NS = NANOSECONDS // 10  # from a scan to the nearest pose
_KEPT_NS = 5 * NANOSECONDS  # poses that a later scan may belong to: a large message arrives late


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
