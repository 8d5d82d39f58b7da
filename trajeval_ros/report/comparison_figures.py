"""The figures of a comparison as SVG: box plots, paths and errors over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.formatting import palette
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.report import canvas
from trajeval_ros.report.canvas import common_offset, coordinate_label
from trajeval_ros.report.svg_figure import GROUNDTRUTH, WIDE, Picture, SvgFigure
from trajeval_ros.report.svg_panel import LINE_PX, SvgPanel, text_width

_DASHES = 4  # line styles, for estimates of the same colour
_NARROW = WIDE / 2.0
_LEFT, _RIGHT, _TOP, _BELOW = 58.0, 12.0, 8.0, 38.0
_BOXES_HIGH, _ERRORS_HIGH = 190.0, 130.0
_BETWEEN = 14.0
_FLATTEST, _TALLEST = 0.3, 0.9  # height of a path's panel relative to its width
_MARGIN = 0.04
_MOST_LINES = 3  # in one panel
_MOST_BOXES = 60  # in a row
_SLANT = -30.0
_LONGEST_NAME = 22  # characters, below boxes
_HEADROOM = 1.05
_DOT_PX, _LONE_DOT_PX = 1.7, 3.0  # radius of the dots of trials, and if there is one trial each
_MOST_POINTS = 20  # dots at a box; more hide it


@dataclass(frozen=True)
class Box:
    """A distribution: whiskers, quartiles and median, and the values if they are few.

    A single value is drawn as a dot without a box.
    """

    low: float
    first: float
    median: float
    third: float
    high: float
    points: tuple[float, ...] = ()

    @classmethod
    def of(cls, values: Sequence[float]) -> Box:
        """Return the box of values, with whiskers at the extremes."""
        low, first, median, third, high = np.percentile(values, [0, 25, 50, 75, 100]).tolist()
        points = tuple(values) if len(values) <= _MOST_POINTS else ()
        return cls(low, first, median, third, high, points)


@dataclass(frozen=True)
class BoxPlot:
    """Boxes by algorithm and group."""

    groups: Sequence[str]  # labels below the boxes: sequences or lengths
    # Name and boxes (one per group, or None) of every algorithm.
    series: Sequence[tuple[str, Sequence[Box | None]]]
    axis: str  # label of the groups; "" if it is evident
    label: str  # the quantity with its unit


@dataclass(frozen=True, eq=False)
class PathsPlot:
    """Aligned paths and groundtruth, seen from above."""

    up: UpAxis  # up axis of the groundtruth's frame
    groundtruth: Floats  # (M, 3), metres, height last
    # Name and positions (M, 3) by position of the algorithm, which determines the colour.
    paths: Mapping[int, tuple[str, Floats]]


@dataclass(frozen=True, eq=False)
class ErrorsPlot:
    """Errors of algorithms over time."""

    # Name and errors (M, 3) by position of the algorithm: time (s), position (m), rotation (deg,
    # NaN if withheld).
    series: Mapping[int, tuple[str, Floats]]


def colour_of(place: int) -> str:
    """Return the CSS class of the colour of the estimate at a position in the list."""
    return f"s{place % len(palette.ESTIMATES)}"


def kind_of(place: int) -> str:
    """Return the CSS classes of its lines: colour and dashes."""
    dashes = place // len(palette.ESTIMATES) % _DASHES
    return colour_of(place) + (f" d{dashes}" if dashes else "")


def figure_of(plot: BoxPlot | PathsPlot | ErrorsPlot) -> SvgFigure:
    """Draw the figure of a plot."""
    if isinstance(plot, BoxPlot):
        return box_figure(plot)
    return paths_figure(plot) if isinstance(plot, PathsPlot) else errors_figure(plot)


def box_figure(plot: BoxPlot) -> SvgFigure:
    """Draw one box per algorithm and group, in several rows if necessary."""
    boxes = [box for _, in_groups in plot.series for box in in_groups if box is not None]
    tops = [box.high for box in boxes] + [max(box.points) for box in boxes if box.points]
    highest = _HEADROOM * max([top for top in tops if np.isfinite(top)], default=0.0) or 1.0
    needed = -(-len(plot.groups) * len(plot.series) // _MOST_BOXES)
    in_row = -(-len(plot.groups) // needed)
    pictures = [
        _boxes(plot, range(row, min(row + in_row, len(plot.groups))), in_row, highest)
        for row in range(0, len(plot.groups), in_row)
    ]
    return SvgFigure(_keys(dict(enumerate(name for name, _ in plot.series))), pictures)


def _boxes(plot: BoxPlot, groups: range, in_row: int, highest: float) -> Picture:
    """Draw one row of groups; boxes of all rows have equal widths."""
    wide = WIDE - _LEFT - _RIGHT
    several_rows = len(plot.groups) > in_row
    count = in_row if several_rows else len(groups)
    names = [_shortened(plot.groups[group]) for group in groups]
    slanted = max(map(text_width, names)) + 8.0 > wide / count
    below = 8.0 + LINE_PX
    if slanted:
        below += max(map(text_width, names)) * np.sin(np.radians(-_SLANT))
    limits = (groups.start - 0.6, groups.start + count - 0.4)
    panel = SvgPanel((_LEFT, _TOP), (wide, _BOXES_HIGH), limits, (0.0, highest))
    panel.number_y(plot.label)
    width = 0.8 / len(plot.series)
    counts = [len(box.points) for _, boxes in plot.series for box in boxes if box is not None]
    radius = _LONE_DOT_PX if max(counts) == 1 else _DOT_PX
    for place, (_, boxes) in enumerate(plot.series):
        shift = width * (place - (len(plot.series) - 1) / 2.0)
        for group in groups:
            box = boxes[group]
            if box is not None:
                _draw_box(panel, group + shift, 0.85 * width, box, kind_of(place), radius)
    under = panel.top + panel.high
    for group, name in zip(groups, names, strict=True):
        x = float(panel.x(group))
        if slanted:
            panel.write(name, x + 4.0, under + 14.0, "e", _SLANT)
        else:
            panel.write(name, x, under + 16.0, "m")
    if plot.axis:
        panel.name_x(plot.axis, below + LINE_PX - 6.0)
        below += LINE_PX
    return Picture([panel], (WIDE, under + below), plot.label)


def _draw_box(panel: SvgPanel, x: float, width: float, box: Box, kind: str, radius: float) -> None:
    """Draw a box and its dots; only a dot for a single value."""
    single = len(box.points) == 1
    if not single:
        panel.box(x, width, (box.low, box.first, box.median, box.third, box.high), kind)
    # Next to one another, so that equal trials are visible.
    beside = np.zeros(1) if single else np.linspace(-0.25, 0.25, len(box.points))
    panel.dots(x + width * beside, np.array(box.points), radius, kind)


def paths_figure(plot: PathsPlot) -> SvgFigure:
    """Draw aligned paths and groundtruth: in one panel, or in one panel per path if many."""
    paths = {place: path[:, :2] for place, (_, path) in plot.paths.items()}
    keys = _keys({place: name for place, (name, _) in plot.paths.items()})
    if len(paths) <= _MOST_LINES:
        by_kind = {kind_of(place): path for place, path in paths.items()}
        return SvgFigure([GROUNDTRUTH, *keys], [_map(plot.up, plot.groundtruth, by_kind, WIDE)])
    pictures = [
        _map(plot.up, plot.groundtruth, {colour_of(place): path}, _NARROW, name)
        for (place, path), (_, name) in zip(paths.items(), keys, strict=True)
    ]
    return SvgFigure([GROUNDTRUTH], pictures)


def run_path_svg(place: int, up: UpAxis, groundtruth: Floats, path: Floats) -> str:
    """Draw the path of one run over the groundtruth, from above, for a page.

    `place`: position of its algorithm, which determines the colour. `up`: up axis of the
    groundtruth's frame. `groundtruth`: (M, 3), metres, height last. `path`: (M, 3), aligned,
    likewise.
    """
    return _map(up, groundtruth, {kind_of(place): path[:, :2]}, WIDE).to_html()


def _map(
    up: UpAxis, groundtruth: Floats, paths: dict[str, Floats], figure_wide: float, name: str = ""
) -> Picture:
    """Draw paths (M, 2) by CSS class and the groundtruth in a panel with equal scales."""
    everything = np.concatenate([groundtruth[:, :2], *paths.values()])
    low, high = np.nanmin(everything, axis=0), np.nanmax(everything, axis=0)
    extent = np.maximum(high - low, 1e-3)
    wide = figure_wide - _LEFT - _RIGHT
    shape = float(np.clip(extent[1] / extent[0], _FLATTEST, _TALLEST))
    size = np.array([1.0, shape])
    centre = (low + high) / 2.0
    half = (0.5 + _MARGIN) * float((extent / size).max()) * size
    (x0, y0), (x1, y1) = (centre - half).tolist(), (centre + half).tolist()
    panel = SvgPanel((_LEFT, _TOP), (wide, wide * shape), (x0, x1), (y0, y1))
    offsets = (common_offset(x0, x1), common_offset(y0, y1))
    across, onward = (
        coordinate_label("xyz"[axis], offset)
        for axis, offset in zip(up.level, offsets, strict=True)
    )
    panel.number_x(across, offsets[0])
    panel.number_y(onward, offsets[1])
    panel.line(groundtruth[:, :2], GROUNDTRUTH[0])
    for kind, path in paths.items():
        panel.line(path, kind)
    panel.mark_ends(groundtruth[:, :2])
    area = (figure_wide, _TOP + panel.high + _BELOW)
    return Picture([panel], area, "path from above", name, next(iter(paths)) if name else "")


def errors_figure(plot: ErrorsPlot) -> SvgFigure:
    """Draw errors over time: in one picture, or in one per algorithm if many."""
    errors = {place: each for place, (_, each) in plot.series.items()}
    keys = _keys({place: name for place, (name, _) in plot.series.items()})
    if len(errors) <= _MOST_LINES:
        by_kind = {kind_of(place): each for place, each in errors.items()}
        return SvgFigure(keys, [_errors(by_kind, list(errors.values()), WIDE)])
    pictures = [
        _errors({colour_of(place): each}, list(errors.values()), _NARROW, name)
        for (place, each), (_, name) in zip(errors.items(), keys, strict=True)
    ]
    return SvgFigure([], pictures)


def run_errors_svg(place: int, errors: Floats) -> str:
    """Draw the errors of one run over time, for a page.

    `errors`: (M, 3): time (s), position (m), rotation (deg, NaN where withheld).
    """
    return _errors({kind_of(place): errors}, [errors], WIDE).to_html()


def _errors(
    errors: dict[str, Floats], everything: Sequence[Floats], figure_wide: float, name: str = ""
) -> Picture:
    """Draw errors (M, 3) by CSS class, in axes that fit `everything`."""
    rows = [(1, "position [m]"), (2, "rotation [deg]")]
    if not any(np.isfinite(each[:, 2]).any() for each in everything):
        rows.pop()
    end = max(float(np.nanmax(each[:, 0])) for each in everything) or 1.0
    panels = []
    for row, (column, label) in enumerate(rows):
        top = _TOP + row * (_ERRORS_HIGH + _BETWEEN)
        known = [each[:, column] for each in everything if np.isfinite(each[:, column]).any()]
        highest = _HEADROOM * max(float(np.nanmax(each)) for each in known) or 1.0
        panel = SvgPanel(
            (_LEFT, top), (figure_wide - _LEFT - _RIGHT, _ERRORS_HIGH), (0.0, end), (0.0, highest)
        )
        is_last = row == len(rows) - 1
        panel.number_x("time [s]" if is_last else "", has_numbers=is_last)
        panel.number_y(label)
        for kind, each in errors.items():
            panel.line(each[:, [0, column]], kind, over_time=True)
        panels.append(panel)
    size = (figure_wide, panels[-1].top + _ERRORS_HIGH + _BELOW)
    return Picture(panels, size, "errors over time", name, next(iter(errors)) if name else "")


def _keys(names: Mapping[int, str]) -> list[tuple[str, str]]:
    """Return the keys of a legend of estimates by position."""
    short = canvas.short_names(list(names.values()))
    return [(kind_of(place), name) for place, name in zip(names, short, strict=True)]


def _shortened(name: str) -> str:
    """Return a name that fits below a box; long names are cut at the start."""
    return name if len(name) <= _LONGEST_NAME else f"…{name[1 - _LONGEST_NAME :]}"
