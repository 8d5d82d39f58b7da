"""Figures of a comparison as SVG, with the colours of the page, light or dark."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from trajeval_ros.formatting import palette
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.report import canvas
from trajeval_ros.report.comparison_plots import Box, BoxPlot, PathsPlot
from trajeval_ros.report.svg_panel import LINE_PX, SvgPanel, shown, svg_of, text_width
from trajeval_ros.report.ticks import common_offset, coordinate_label

_DASHES = 4  # line styles, for estimates of the same colour
_WIDE, _NARROW = 480.0, 240.0
_LEFT, _RIGHT, _TOP, _BELOW = 58.0, 6.0, 8.0, 38.0
_BOXES_HIGH, _ERRORS_HIGH = 190.0, 130.0
_BETWEEN = 14.0
_FLATTEST, _TALLEST = 0.3, 0.9  # height of a path's panel relative to its width
_MARGIN = 0.04
_MOST_LINES = 3  # in one panel
_MOST_BOXES = 60  # in a row
_SLANT = -30.0
_LONGEST_NAME = 22  # characters, below boxes
_HEADROOM = 1.05


def colour_of(place: int) -> str:
    """Return the CSS class of the colour of the estimate at a position in the list."""
    return f"s{place % len(palette.ESTIMATES)}"


def kind_of(place: int) -> str:
    """Return the CSS classes of its lines: colour and dashes."""
    dashes = place // len(palette.ESTIMATES) % _DASHES
    return colour_of(place) + (f" d{dashes}" if dashes else "")


def box_svg(plot: BoxPlot) -> str:
    """Draw one box per algorithm and group, in several rows if necessary."""
    boxes = [box for _, in_groups in plot.series for box in in_groups if box is not None]
    tops = [box.high for box in boxes] + [max(box.points) for box in boxes if box.points]
    highest = _HEADROOM * max([top for top in tops if np.isfinite(top)], default=0.0) or 1.0
    needed = -(-len(plot.groups) * len(plot.series) // _MOST_BOXES)
    in_row = -(-len(plot.groups) // needed)
    rows = range(0, len(plot.groups), in_row)
    drawn = [_boxes(plot, range(row, min(row + in_row, len(plot.groups))), in_row, highest)
             for row in rows]  # fmt: skip
    names = canvas.short_names([name for name, _ in plot.series])
    return "".join([_legend(enumerate(names)), *drawn])


def _boxes(plot: BoxPlot, groups: range, in_row: int, highest: float) -> str:
    """Draw one row of groups; boxes of all rows have equal widths."""
    wide = _WIDE - _LEFT - _RIGHT
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
    for place, (_, boxes) in enumerate(plot.series):
        shift = width * (place - (len(plot.series) - 1) / 2.0)
        for group in groups:
            box = boxes[group]
            if box is not None:
                _draw_box(panel, group + shift, 0.85 * width, box, kind_of(place))
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
    return svg_of([panel], (_WIDE, under + below), plot.label)


def _draw_box(panel: SvgPanel, x: float, width: float, box: Box, kind: str) -> None:
    """Draw a box and its dots; only a dot for a single value."""
    single = len(box.points) == 1
    if not single:
        panel.box(x, width, (box.low, box.first, box.median, box.third, box.high), kind)
    # Next to one another, so that equal trials are visible.
    beside = np.zeros(1) if single else np.linspace(-0.25, 0.25, len(box.points))
    panel.dots(x + width * beside, np.array(box.points), 3.0 if single else 1.7, kind)


def paths_svg(plot: PathsPlot) -> str:
    """Draw aligned paths and groundtruth: in one panel, or in one panel per path if many."""
    names = dict(
        zip(plot.paths, canvas.short_names([name for name, _ in plot.paths.values()]), strict=True)
    )
    paths = {place: path[:, :2] for place, (_, path) in plot.paths.items()}
    if len(paths) <= _MOST_LINES:
        legend = _legend(names.items(), with_truth=True)
        by_kind = {kind_of(place): path for place, path in paths.items()}
        return legend + _map(plot.up, plot.truth, by_kind, _WIDE)
    small = (
        f'<div><p class="{colour_of(place)} name">{shown(names[place])}</p>'
        f"{_map(plot.up, plot.truth, {colour_of(place): path}, _NARROW)}</div>"
        for place, path in paths.items()
    )
    return f'{_legend([], with_truth=True)}<div class="small">{"".join(small)}</div>'


def run_path_svg(place: int, up: UpAxis, truth: Floats, path: Floats) -> str:
    """Draw the path of one run over the groundtruth, from above.

    Args:
        place: Position of its algorithm, which determines the colour.
        up: Up axis of the groundtruth's frame.
        truth: (M, 3), metres, height last.
        path: (M, 3), aligned, likewise.
    """
    return _map(up, truth, {kind_of(place): path[:, :2]}, _WIDE)


def _map(up: UpAxis, truth: Floats, paths: dict[str, Floats], figure_wide: float) -> str:
    """Draw paths (M, 2) by CSS class and the groundtruth in a panel with equal scales."""
    everything = np.concatenate([truth[:, :2], *paths.values()])
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
    panel.line(truth[:, :2], "truth")
    for kind, path in paths.items():
        panel.line(path, kind)
    panel.mark_ends(truth[:, :2])
    return svg_of([panel], (figure_wide, _TOP + panel.high + _BELOW), "path from above")


def run_errors_svg(place: int, errors: Floats) -> str:
    """Draw the errors of one run over time.

    Args:
        place: Position of its algorithm, which determines the colour.
        errors: (M, 3): time (s), position (m), rotation (deg, NaN where withheld).
    """
    rows = [(1, "position [m]"), (2, "rotation [deg]")]
    if not np.isfinite(errors[:, 2]).any():
        rows.pop()
    end = float(np.nanmax(errors[:, 0])) or 1.0
    panels = []
    for row, (column, label) in enumerate(rows):
        top = _TOP + row * (_ERRORS_HIGH + _BETWEEN)
        highest = _HEADROOM * float(np.nanmax(errors[:, column])) or 1.0
        panel = SvgPanel(
            (_LEFT, top), (_WIDE - _LEFT - _RIGHT, _ERRORS_HIGH), (0.0, end), (0.0, highest)
        )
        is_last = row == len(rows) - 1
        panel.number_x("time [s]" if is_last else "", has_numbers=is_last)
        panel.number_y(label)
        panel.line(errors[:, [0, column]], kind_of(place), over_time=True)
        panels.append(panel)
    bottom = panels[-1].top + _ERRORS_HIGH
    return svg_of(panels, (_WIDE, bottom + _BELOW), "errors over time")


def _legend(names: Iterable[tuple[int, str]], *, with_truth: bool = False) -> str:
    """Return the legend of estimates by position as HTML."""
    keys = ['<span class="key truth">groundtruth</span>'] if with_truth else []
    keys += [f'<span class="key {kind_of(place)}">{shown(name)}</span>' for place, name in names]
    return f'<p class="legend">{" ".join(keys)}</p>'


def _shortened(name: str) -> str:
    """Return a name that fits below a box; long names are cut at the start."""
    return name if len(name) <= _LONGEST_NAME else f"…{name[1 - _LONGEST_NAME :]}"
