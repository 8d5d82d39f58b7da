"""Axes of figures as SVG: numbers, lines, boxes and dots with the CSS classes of a page.

A comparison can have hundreds of plots. SVG takes a hundredth of matplotlib's time and a tenth of
the size. The classes are in `report/templates/style.css.j2`.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable, Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.report.canvas import tick_labels, tick_places
from trajeval_ros.report.line_thinning import simplified_rows

LETTER_PX, LINE_PX = 6.4, 15.0  # size of text in the style sheet
_TICK_PX, _NAME_PX = 16.0, 15.0
_PER_TICK_PX = (46.0, 30.0)  # least distance of ticks in x and y
_DETAIL_PX = 0.1  # largest distance of a drawn path from the data
_COLUMN_PX = 2.0  # width of a column in which a line over time is drawn by its extremes
_TENTHS = 10.0  # coordinates of lines are integers in tenths of pixels


class SvgPanel:
    """Axes in a figure; sizes are in pixels, y increases downwards."""

    def __init__(
        self,
        corner: tuple[float, float],
        size: tuple[float, float],
        x_limits: tuple[float, float],
        y_limits: tuple[float, float],
    ) -> None:
        self.left, self.top = corner
        self.wide, self.high = size
        self._x_limits, self._y_limits = x_limits, y_limits
        # The area of the axes, from which the script of a page reads the values below the pointer.
        x, y = (" ".join(f"{limit:.9g}" for limit in limits) for limits in (x_limits, y_limits))
        self.parts: list[str] = [
            f'<rect class="a" x="{self.left:g}" y="{self.top:g}" width="{self.wide:g}" '
            f'height="{self.high:g}" data-x="{x}" data-y="{y}"/>'
        ]

    def x(self, values: Floats | float) -> Floats:
        """Return the x coordinates of values."""
        low, high = self._x_limits
        return self.left + (np.asarray(values) - low) * (self.wide / (high - low))

    def y(self, values: Floats | float) -> Floats:
        """Return the y coordinates of values."""
        low, high = self._y_limits
        return self.top + self.high - (np.asarray(values) - low) * (self.high / (high - low))

    def number_x(self, label: str, offset: float = 0.0, *, has_numbers: bool = True) -> None:
        """Draw grid and numbers of the x axis, with an offset subtracted, and its label."""
        low, high = (limit - offset for limit in self._x_limits)
        ticks = tick_places(low, high, max(3, int(self.wide / _PER_TICK_PX[0])))
        places = self.x(np.array(ticks) + offset).tolist()
        self._grid(f"M{place:.1f} {self.top:.1f}v{self.high:.1f}" for place in places)
        bottom = self.top + self.high
        if has_numbers:
            for place, text in zip(places, tick_labels(ticks), strict=True):
                self.write(text, place, bottom + _TICK_PX, "m")
        if label:
            self.name_x(label, _TICK_PX + _NAME_PX)

    def name_x(self, label: str, below: float) -> None:
        """Label the x axis at a distance below the panel."""
        self.write(label, self.left + self.wide / 2.0, self.top + self.high + below, "m")

    def number_y(self, label: str, offset: float = 0.0) -> None:
        """Draw grid, numbers and label of the y axis, as `number_x`."""
        low, high = (limit - offset for limit in self._y_limits)
        ticks = tick_places(low, high, max(3, int(self.high / _PER_TICK_PX[1])))
        places = self.y(np.array(ticks) + offset).tolist()
        self._grid(f"M{self.left:.1f} {place:.1f}h{self.wide:.1f}" for place in places)
        for place, text in zip(places, tick_labels(ticks), strict=True):
            self.write(text, self.left - 5.0, place + 4.0, "e")
        middle = self.top + self.high / 2.0
        self.parts.append(
            f'<text class="m" transform="translate(12 {middle:.1f}) rotate(-90)">{shown(label)}'
            "</text>"
        )

    def write(self, text: str, x: float, y: float, kind: str, slant: float = 0.0) -> None:
        """Write a text; `kind` is m to centre it at the place, e to end it there."""
        if slant:
            place = f'transform="translate({x:.1f} {y:.1f}) rotate({slant:g})"'
        else:
            place = f'x="{x:.1f}" y="{y:.1f}"'
        self.parts.append(f'<text class="{kind}" {place}>{shown(text)}</text>')

    def line(self, points: Floats, kind: str, *, over_time: bool = False) -> None:
        """Draw a line (N, 2), interrupted by rows of NaN, without invisible details.

        `over_time`: whether x never decreases; then only the extremes of every column are drawn.
        """
        at = np.column_stack([self.x(points[:, 0]), self.y(points[:, 1])])
        breaks = np.flatnonzero(~np.isfinite(at).all(axis=1))
        pieces = [piece[np.isfinite(piece).all(axis=1)] for piece in np.split(at, breaks)]
        path = "".join(
            _path(piece[_extremes(piece) if over_time else simplified_rows(piece, _DETAIL_PX)])
            for piece in pieces
            if len(piece)
        )
        if path:
            self.parts.append(f'<path class="c {kind}" transform="scale(.1)" d="{path}"/>')

    def box(self, x: float, width: float, five: Sequence[float], kind: str) -> None:
        """Draw a box with whiskers from five values: low, quartiles and median, high."""
        low, first, middle, third, high = self.y(np.array(five)).tolist()
        left, at, right = self.x(np.array([x - width / 2.0, x, x + width / 2.0])).tolist()
        cap = (right - left) / 4.0
        self.parts.append(
            f'<path class="b {kind}" d="M{left:.1f} {first:.1f}H{right:.1f}V{third:.1f}'
            f"H{left:.1f}Z"
            f"M{at:.1f} {first:.1f}V{low:.1f}M{at:.1f} {third:.1f}V{high:.1f}"
            f"M{at - cap:.1f} {low:.1f}h{2.0 * cap:.1f}M{at - cap:.1f} {high:.1f}h{2.0 * cap:.1f}"
            f'"/><path class="d" d="M{left:.1f} {middle:.1f}H{right:.1f}"/>'
        )

    def dots(self, xs: Floats, ys: Floats, radius: float, kind: str) -> None:
        """Draw dots (N,) of a radius in pixels."""
        for x, y in zip(self.x(xs).tolist(), self.y(ys).tolist(), strict=True):
            self.parts.append(f'<circle class="p {kind}" cx="{x:.1f}" cy="{y:.1f}" r="{radius}"/>')

    def mark_ends(self, path: Floats) -> None:
        """Mark the start of a path (N, 2) by a circle and its end by a square."""
        known = path[np.isfinite(path).all(axis=1)]
        (x0, x1), (y0, y1) = self.x(known[[0, -1], 0]).tolist(), self.y(known[[0, -1], 1]).tolist()
        self.parts.append(
            f'<circle class="o" cx="{x0:.1f}" cy="{y0:.1f}" r="3.5"/>'
            f'<rect class="o" x="{x1 - 3:.1f}" y="{y1 - 3:.1f}" width="6" height="6"/>'
        )

    def _grid(self, lines: Iterable[str]) -> None:
        """Draw grid lines."""
        self.parts.append(f'<path class="g" d="{"".join(lines)}"/>')


def shown(text: str) -> str:
    """Return foreign text on one line, escaped for HTML."""
    return escape(one_line(text))


def text_width(text: str) -> float:
    """Return the approximate width of a text, pixels."""
    return LETTER_PX * sum(2 if unicodedata.east_asian_width(c) in "WF" else 1 for c in text)


def _extremes(at: Floats) -> NDArray[np.intp]:
    """Return the rows of a line (N, 2) with the extremes of y in every column, and the ends."""
    columns = np.floor(at[:, 0] / _COLUMN_PX)
    order = np.lexsort((at[:, 1], columns))
    first = np.flatnonzero(np.diff(columns, prepend=np.nan) != 0.0)
    last = np.append(first[1:], len(at)) - 1
    # Columns increase along the line, so that a column's sorted rows are contiguous.
    return np.unique(np.concatenate([order[first], order[last], [0, len(at) - 1]]))


def _path(at: Floats) -> str:
    """Return a line (N, 2) as SVG path with relative steps, which need few bytes."""
    points = np.rint(at * _TENTHS).astype(np.int64)
    steps = " ".join(map(str, np.diff(points, axis=0).ravel().tolist()))
    x, y = points[0].tolist()
    return f"M{x} {y}l{steps or '0 0'}".replace(" -", "-")
