"""The map: GNSS fixes and aligned estimates by latitude and longitude, recorded and live."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Indices, Stamps
from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.geometry.geodesy import Datum, places_at
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.viewer import appearance, entity_data, scene_entities
from trajeval_ros.viewer.entity_data import EntityData
from trajeval_ros.viewer.live_path import Log, RowHistory
from trajeval_ros.viewer.paths import gaps, spread

MOST_POINTS = 5000  # of a track, and fixes


def is_on_map(fixes: Fixes | None, up: UpAxis) -> bool:
    """Return whether the groundtruth's frame has a known place and orientation on Earth.

    `up` is the up axis of the groundtruth's frame.
    """
    return fixes is not None and up.name == Z_UP.name


def track_lines(stamps: Stamps, aligned: Floats, datum: Datum) -> EntityData:
    """Return aligned positions (N, 3) as lines on the map, without those across gaps."""
    places = places_at(aligned, datum)[:, :2]
    parts = np.split(places, np.flatnonzero(gaps(stamps)) + 1)
    return entity_data.lines_on_map([part for part in parts if len(part) > 1])


def send_map(
    recording: Any,
    evaluations: Sequence[Evaluation],
    estimates: Sequence[scene_entities.EstimateEntities],
) -> None:
    """Log the fixes, coloured by status, and the aligned estimates, for all time."""
    fixes = evaluations[0].groundtruth.reading.fixes
    assert fixes is not None
    assert fixes.datum is not None
    appearance.declare_map(recording, estimates)
    some = spread(len(fixes), MOST_POINTS)
    dots = entity_data.fixes_on_map(fixes.places[some, :2], fixes.status[some])
    recording.log(scene_entities.MAP_FIXES, dots.row(), static=True)
    for evaluation, entities in zip(evaluations, estimates, strict=True):
        estimate = evaluation.estimate
        some = spread(len(estimate), MOST_POINTS)
        aligned = evaluation.alignment.similarity.positions(estimate.positions[some])
        lines = track_lines(estimate.stamps[some], aligned, fixes.datum)
        recording.log(entities.on_map, lines.row(), static=True)


_DRAWN_EVERY_NS = 2 * NANOSECONDS
_MOST_WHILE_GROWING = 500  # points of a drawing
_NEVER = np.iinfo(np.int64).min


class LiveMap:
    """Draws the map of GNSS fixes and aligned estimates.

    A map has no transforms: a new alignment moves a track only if the track is drawn again.
    Therefore a new drawing replaces the previous one, and has a limited number of points.
    """

    def __init__(self, log: Log) -> None:
        self.datum: Datum | None = None  # origin of the frame of the fixes
        self._log = log
        self._history = RowHistory(3)  # latitude, longitude and status
        self._drawn_at = _NEVER

    def add(self, stamps: Stamps, fixes: Fixes) -> None:
        """Add new fixes, N > 0; draw all fixes periodically."""
        self.datum = fixes.datum
        for stamp, place, status in zip(
            stamps.tolist(), fixes.places, fixes.status.tolist(), strict=True
        ):
            self._history.add(stamp, np.array([place[0], place[1], status]))
        if int(stamps[-1]) >= self._drawn_at + _DRAWN_EVERY_NS:
            self.draw(is_growing=True)

    def draw(self, *, is_growing: bool) -> None:
        """Draw the fixes at the timestamp of the newest one."""
        stamps, rows = self._history.columns()
        if not len(stamps):
            return
        self._drawn_at = int(stamps[-1])
        some = rows[_spread(len(rows), is_growing=is_growing)]
        dots = entity_data.fixes_on_map(some[:, :2], some[:, 2].astype(np.int64))
        self._log(self._drawn_at, scene_entities.MAP_FIXES, dots.row())

    def draw_track(
        self, stamp: int, entity: str, stamps: Stamps, aligned: Floats, *, is_growing: bool
    ) -> None:
        """Draw the aligned positions (N, 3) of an estimate at a timestamp."""
        if self.datum is not None:
            some = _spread(len(stamps), is_growing=is_growing)
            lines = track_lines(stamps[some], aligned[some], self.datum)
            self._log(stamp, entity, lines.row())


def _spread(count: int, *, is_growing: bool) -> Indices:
    return spread(count, _MOST_WHILE_GROWING if is_growing else MOST_POINTS)
