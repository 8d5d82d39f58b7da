"""The map of a live run: GNSS fixes and the aligned estimates, as far as they are known."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Indices, Stamps
from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.geometry.geodesy import Datum
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.viewer import entity_data, scene_entities
from trajeval_ros.viewer.live_path import Log, RowHistory
from trajeval_ros.viewer.map_track import MOST_POINTS, track_lines
from trajeval_ros.viewer.paths import spread

_DRAWN_EVERY_NS = 2 * NANOSECONDS
_MOST_WHILE_GROWING = 500  # points of a drawing
_NEVER = np.iinfo(np.int64).min


class LiveMap:
    """Draws the map of GNSS fixes and aligned estimates.

    A map has no transforms: a new alignment moves a track only if the track is drawn again.
    Therefore a new drawing replaces the previous one, and has a limited number of points.

    Attributes:
        datum: Origin of the frame of the fixes; None before the first one.
    """

    def __init__(self, log: Log) -> None:
        """Create it without a fix; `log` draws an archetype at a timestamp."""
        self.datum: Datum | None = None
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
        """Draw an aligned estimate at a timestamp.

        Args:
            stamp: Timestamp of the drawing, ns.
            entity: Entity of the estimate.
            stamps: Timestamps (N,) of the estimate, ns.
            aligned: Aligned positions (N, 3), metres.
            is_growing: Whether the run continues; the number of points is then smaller.
        """
        if self.datum is not None:
            some = _spread(len(stamps), is_growing=is_growing)
            lines = track_lines(stamps[some], aligned[some], self.datum)
            self._log(stamp, entity, lines.row())


def _spread(count: int, *, is_growing: bool) -> Indices:
    return spread(count, _MOST_WHILE_GROWING if is_growing else MOST_POINTS)
