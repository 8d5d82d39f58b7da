"""Figures of a comparison as SVG for a page: they take the page's colours, light or dark."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.report import canvas

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Colours that stand for those of the page; no figure has these shades otherwise.
_INK, _GRID, _TRUTH = "#010101", "#020202", "#030303"
_PAGE_COLOURS = {
    _INK: "currentColor",
    _GRID: "var(--grid)",
    _TRUTH: "var(--truth)",
    **{colour.lower(): f"var(--s{place})" for place, colour in enumerate(canvas.COLOURS)},
}
_WIDTH_IN = 4.6
_RUN_SIZE_IN = (4.4, 2.8)
_LEFT, _BOTTOM, _TOP = 0.16, 0.16, 0.98  # margins, in shares of such a figure
_INSIDE = 0.3  # opacity of a box's inside


@dataclass(frozen=True)
class Box:
    """A distribution: whiskers, quartiles and median, and the points themselves if few."""

    low: float
    first: float
    median: float
    third: float
    high: float
    points: tuple[float, ...] = ()

    @classmethod
    def of(cls, values: Sequence[float]) -> Box:
        """Return the box of a few values, with whiskers at the least and the largest."""
        low, first, median, third, high = np.percentile(values, [0, 25, 50, 75, 100]).tolist()
        return cls(low, first, median, third, high, tuple(values))


def box_plot(
    name: str,
    groups: Sequence[str],
    series: Sequence[tuple[str, Sequence[Box | None]]],
    axis: str,
    label: str,
) -> str:
    """Draw a box for each algorithm in each group.

    Args:
        name: Of the figure, unlike any other's on the page.
        groups: What stands below the boxes: sequences or lengths.
        series: Name and boxes, group by group, of each algorithm.
        axis: What the groups are; "" if their names say it.
        label: What is measured, with its unit.
    """
    with _page_style(name):
        figure = canvas.new_figure(_WIDTH_IN, 2.3)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        width = 0.8 / len(series)
        legend = canvas.short_names([algorithm for algorithm, _ in series])
        for place, (_, boxes) in enumerate(series):
            colour, _ = canvas.line_style(place)
            shift = width * (place - (len(series) - 1) / 2.0)
            _draw_boxes(axes, boxes, shift, 0.85 * width, colour)
            axes.plot([], [], color=colour, linewidth=5.0, alpha=0.7, label=legend[place])
        axes.set_xticks(range(len(groups)), [one_line(each) for each in groups])
        axes.set_xlim(-0.6, len(groups) - 0.4)
        axes.set_ylim(bottom=0.0)
        axes.grid(visible=False, axis="x")
        axes.tick_params(axis="x", length=0)
        axes.set_xlabel(axis)
        axes.set_ylabel(label)
        canvas.head(axes, _WIDTH_IN)
        return _svg(figure, label)


def _draw_boxes(
    axes: Axes, boxes: Sequence[Box | None], shift: float, width: float, colour: str
) -> None:
    known = [(group, box) for group, box in enumerate(boxes) if box is not None]
    canvas.draw_boxes(
        axes,
        [
            (group + shift, (box.low, box.first, box.median, box.third, box.high))
            for group, box in known
        ],
        width,
        edge=(colour, "-", 1.0),
        inside=_faint(colour),
        median=(_INK, 1.4),
    )
    # Side by side, so that equal trials are seen as several.
    places = [group + shift + width * _beside(len(box.points)) for group, box in known]
    points = [box.points for _, box in known]
    if any(points):
        axes.plot(
            np.concatenate(places), np.concatenate(points),
            linestyle="none", marker="o", markersize=2.5, color=colour, zorder=3,
        )  # fmt: skip


def _beside(count: int) -> Floats:
    """Return places (count,) within a box as wide as 1, the middle if there is but one."""
    return np.linspace(-0.25, 0.25, count) if count != 1 else np.zeros(1)


def overlay(
    name: str, up: UpAxis, truth: Floats, paths: Sequence[tuple[str, Floats] | None]
) -> str:
    """Draw aligned paths over the groundtruth, from above.

    Args:
        name: Of the figure, unlike any other's on the page.
        up: Which axis of the groundtruth's frame points up.
        truth: (M, 3), with height last.
        paths: Name and positions (M, 3) by place of the algorithm, which decides the colour.
    """
    with _page_style(name):
        figure = canvas.new_figure(_WIDTH_IN, 3.2)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        _draw_paths(axes, up, truth, paths)
        canvas.head(axes, _WIDTH_IN)
        return _svg(figure, "trajectories from above")


def run_path(name: str, place: int, up: UpAxis, truth: Floats, path: Floats) -> str:
    """Draw the path of one run, from above.

    There may be hundreds of them, so margins are fixed instead of measured, and ticks few.

    Args:
        name: Of the run, unlike any other's on the page.
        place: Of its algorithm.
        up: Which axis of the groundtruth's frame points up.
        truth: (M, 3), with height last.
        path: (M, 3), aligned, likewise.
    """
    with _page_style(name):
        figure = canvas.new_figure(*_RUN_SIZE_IN)
        axes = figure.add_axes((_LEFT, _BOTTOM, 1.0 - _LEFT, _TOP - _BOTTOM))
        _draw_paths(axes, up, truth, [None] * place + [("estimate", path)])
        axes.locator_params(nbins=5)
        return _svg(figure, "path from above", tight=False)


def run_errors(name: str, place: int, errors: Floats) -> str:
    """Draw the errors of one run over time, likewise.

    Args:
        name: Of the run, unlike any other's on the page.
        place: Of its algorithm.
        errors: (M, 3): time (s), position (m), rotation (deg, NaN where withheld).
    """
    colour, _ = canvas.line_style(place)
    with _page_style(name):
        figure = canvas.new_figure(*_RUN_SIZE_IN)
        shown = [(1, "position [m]"), (2, "rotation [deg]")]
        if not np.isfinite(errors[:, 2]).any():
            shown.pop()
        height = (_TOP - _BOTTOM) / len(shown)
        for row, (column, label) in enumerate(shown):
            bottom = _TOP - (row + 1) * height
            panel = figure.add_axes((_LEFT, bottom, 1.0 - _LEFT, 0.86 * height))
            panel.plot(errors[:, 0], errors[:, column], color=colour, linewidth=1.0)
            panel.set_ylim(bottom=0.0)
            panel.set_ylabel(label)
            panel.locator_params(nbins=5)
            panel.tick_params(labelbottom=row == len(shown) - 1)
        panel.set_xlabel("time [s]")
        return _svg(figure, "errors over time", tight=False)


def _draw_paths(
    axes: Axes, up: UpAxis, truth: Floats, paths: Sequence[tuple[str, Floats] | None]
) -> None:
    axes.plot(truth[:, 0], truth[:, 1], color=_TRUTH, linewidth=1.8, label="groundtruth")
    legend = canvas.short_names([path[0] if path else "" for path in paths])
    for place, path in enumerate(paths):
        if path is not None:
            _, positions = path
            colour, dashes = canvas.line_style(place)
            axes.plot(
                positions[:, 0], positions[:, 1],
                color=colour, linestyle=dashes, linewidth=1.1, label=legend[place],
            )  # fmt: skip
    axes.set_aspect("equal", adjustable="datalim")
    across, onward = ("xyz"[each] for each in up.level)
    axes.set_xlabel(f"{across} [m]")
    axes.set_ylabel(f"{onward} [m]")


@contextmanager
def _page_style(name: str) -> Iterator[None]:
    import matplotlib

    with canvas.house_style():
        settings: dict[Any, Any] = {
            **dict.fromkeys(("text.color", "axes.labelcolor", "xtick.color", "ytick.color"), _INK),
            "axes.edgecolor": _INK,
            "axes.facecolor": "none",
            "figure.facecolor": "none",
            "grid.color": _GRID,
            "legend.labelcolor": _INK,
            "svg.fonttype": "none",
            # Definitions are named by this: those of a figure that is folded away draw nothing.
            "svg.hashsalt": name,
        }
        matplotlib.rcParams.update(settings)
        yield


def _svg(figure: Figure, label: str, *, tight: bool = True) -> str:
    """Return a figure as an element of a page; the same figure gives the same text."""
    stream = io.StringIO()
    figure.savefig(
        stream, format="svg", bbox_inches="tight" if tight else None, pad_inches=0.04,
        metadata={"Date": None, "Creator": None},
    )  # fmt: skip
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", text, flags=re.DOTALL)
    # Coordinates need no more digits. What stands between tags is text to be read.
    text = re.sub(r"<[^>]+>", lambda tag: re.sub(r"(\d\.\d\d)\d+", r"\1", tag[0]), text)
    # Else each of many figures brings the same ids of its parts, which nothing refers to.
    text = re.sub(r' id="[a-zA-Z0-9]*_[0-9]+"', "", text)
    for colour, of_page in _PAGE_COLOURS.items():
        text = text.replace(colour, of_page)
    size = re.search(r'viewBox="0 0 ([\d.]+) ', text)
    assert size is not None
    head = f'<svg role="img" aria-label="{label}" style="max-width: {1.4 * float(size[1]):.0f}pt" '
    text = re.sub(r'(<svg [^>]*?) width="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg [^>]*?) height="[^"]*"', r"\1", text, count=1)
    return text.replace("<svg ", head, 1).strip()


def _faint(colour: str) -> tuple[str, float]:
    return colour, _INSIDE
