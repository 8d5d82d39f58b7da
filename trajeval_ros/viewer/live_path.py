"""A path that grows while it is drawn, with few rows in the viewer and few bytes in the file."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.online.state_buffer import Tail
from trajeval_ros.viewer import entity_data, scene_entities
from trajeval_ros.viewer.entity_data import LineLook
from trajeval_ros.viewer.paths import is_gap
from trajeval_ros.viewer.scene_entities import PathEntities

Log = Callable[[int, str, Any], None]

DRAWN_EVERY_NS = 100_000_000  # poses closer in time are dropped
_PIECE = 300  # poses of a complete piece
_ROWS_OF_LEVEL = 4
_HEAD = 24  # poses that are sent again with every new one
_MOST_ROWS = 100_000  # of a history
_NEVER = np.iinfo(np.int64).min


class Thinning:
    """Selects poses at a limited rate, one per 0.1 s."""

    def __init__(self) -> None:
        self._last = _NEVER

    def pick(self, stamps: Stamps) -> NDArray[np.int64]:
        """Return the indices of the new timestamps (N,) to draw; older ones are dropped."""
        slots = stamps // DRAWN_EVERY_NS
        newest = np.maximum.accumulate(np.concatenate([[self._last], slots]))
        if len(slots):
            self._last = int(newest[-1])
        return np.flatnonzero(slots > newest[:-1])


class LivePath:
    """Draws one path, pose by pose.

    Only the latest row of every entity is visible. `recent` is the piece that grows, and `newest`
    its end. Both are sent again as they grow, `newest` often and `recent` rarely. Complete pieces
    are `past`, on levels like the digits of a number: four rows of one level become one row of the
    next level. Every pose is therefore sent about twice per level, and few rows have the path.
    """

    def __init__(self, entities: PathEntities, log: Log, look: LineLook) -> None:
        self._entities, self._log, self._look = entities, log, look
        self._past: list[list[list[Floats]]] = [[] for _ in entities.levels]
        self._piece: list[Floats] = []
        self._stamp = _NEVER
        self._usual_ns = 0.0

    def add(self, stamp: int, point: Floats) -> int:
        """Add a position (3,); return the step since the previous one, ns, if a gap, else 0."""
        gap = 0
        step = stamp - self._stamp if self._piece else 0
        if self._usual_ns and is_gap(step, self._usual_ns):
            gap = step
            self._end_piece()
            self._piece = []
            self._usual_ns *= 2.0  # adapts if the rate of the stream drops
        elif step:
            self._usual_ns += (step - self._usual_ns) * (0.1 if self._usual_ns else 1.0)
        self._piece.append(point)
        self._stamp = stamp
        if len(self._piece) > _PIECE:
            self._end_piece()
            self._piece = [point]
        elif len(self._piece) % _HEAD == 1 and len(self._piece) > 1:
            self._draw(stamp, self._entities.recent, [np.array(self._piece)])
        return gap

    def draw_to(self, stamp: int, point: Floats) -> None:
        """Draw the path up to a position (3,), which need not have been added."""
        if self._piece:
            begin = (len(self._piece) - 1) // _HEAD * _HEAD
            head = np.array([*self._piece[begin:], point])
            self._draw(stamp, self._entities.newest, [head])

    def draw_again(self) -> None:
        """Draw the path on a new recording."""
        for level, rows in enumerate(self._past):
            if rows:
                self._draw_level(level)
        if len(self._piece) > 1:
            self._draw(self._stamp, self._entities.recent, [np.array(self._piece)])

    def restart(self, stamp: int) -> None:
        """Draw only what is added from a timestamp on; another entity has the path so far."""
        for level, rows in enumerate(self._past):
            if rows:
                rows.clear()
                self._draw(stamp, self._entities.levels[level], [])
        for entity in (self._entities.recent, self._entities.newest):
            self._draw(stamp, entity, [])
        self._piece = self._piece[-1:]

    def _end_piece(self) -> None:
        if len(self._piece) > 1:
            self._keep([np.array(self._piece)])
            self._draw(self._stamp, self._entities.recent, [])
            self._draw(self._stamp, self._entities.newest, [])

    def _keep(self, strips: list[Floats]) -> None:
        """Add strips to the past; the last level drops every second pose when it is full."""
        last = len(self._past) - 1
        for level, rows in enumerate(self._past):
            rows.append(strips)
            is_full = len(rows) == _ROWS_OF_LEVEL
            if is_full:
                strips = [strip for row in rows for strip in row]
                rows.clear()
            if is_full and level == last:
                rows.append([_halved(item) for item in strips])
            self._draw_level(level)
            if not is_full:
                return

    def _draw_level(self, level: int) -> None:
        strips = [strip for row in self._past[level] for strip in row]
        row = entity_data.lines(strips, self._look).row()
        self._log(self._stamp, self._entities.levels[level], row)

    def _draw(self, stamp: int, entity: str, strips: list[Floats]) -> None:
        self._log(stamp, entity, entity_data.lines(strips).row())


def _halved(strip: Floats) -> Floats:
    """Return every second position of a strip (N, 3), with its ends."""
    return np.concatenate([strip[:-1:2], strip[-1:]])


class RowHistory:
    """Rows of a whole run by timestamp; beyond a limit every second row is dropped."""

    def __init__(self, width: int) -> None:
        self._every, self._seen = 1, 0
        self._held, self._width = Tail(), width

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self._held)

    def add(self, stamp: int, row: Floats) -> None:
        """Add a row."""
        self._seen += 1
        if self._seen % self._every:
            return
        if len(self) == _MOST_ROWS:
            stamps, rows = self.columns()
            self._held = Tail()
            self._held.add_columns(stamps[::2], row=rows[::2])
            self._every *= 2
        self._held.add_columns(np.array([stamp]), row=row[None])

    def columns(self) -> tuple[Stamps, Floats]:
        """Return views of stamps (N,) and rows."""
        if not len(self._held):
            return self._held.stamps, np.empty((0, self._width))
        return self._held.stamps, self._held.column("row")


NEVER = int(np.iinfo(np.int64).min)  # before all timestamps


class LiveRecording:
    """Draws on a recording; without one, nothing is drawn."""

    def __init__(self) -> None:
        self.stream: Any = None  # the recording; None without one
        self.begin = NEVER  # first time of the picture, nanoseconds

    def send(self, draw: Callable[..., None], *values: object) -> None:
        """Call a function that draws values on a recording."""
        if self.stream is not None:
            draw(self.stream, *values)

    def log(self, stamp: int, entity: str, row: Any) -> None:
        """Log one row at a time of the picture."""
        self.send(entity_data.log, entity, stamp, row)

    def number(self, stamp: int, entity: str, value: float | None) -> None:
        """Log a value of a series, if there is one."""
        if value is not None:
            self.log(stamp, entity, entity_data.numbers([value]).row())

    def event(self, stamp: int, text: str, *, warn: bool = True) -> None:
        """Log a line of text, with the time since the start."""
        since = "" if self.begin == NEVER else f"{(stamp - self.begin) / NANOSECONDS:.1f} s: "
        self.log(stamp, scene_entities.EVENTS, entity_data.event(since + text, warn=warn))
