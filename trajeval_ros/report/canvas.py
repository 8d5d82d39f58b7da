"""Common parts of figures: sizes, colours, titles, legends, labels, boxes and ticks."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.geometry.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

Drawing = Callable[[], "Figure"]
Dashes = Literal["-", "--", "-.", ":"]
_LINE_STYLES: tuple[Dashes, ...] = ("-", "--", "-.", ":")
_LONGEST_NAME = 48
# Mean widths of a character of 8 and of 9 points. Width of a legend's handle and gap, in
# characters.
_LETTER_IN, _TITLE_LETTER_IN = 0.06, 0.068
_HANDLE_LETTERS = 7
_ROW_IN = 0.165  # height of a line of text
_LABELS_IN = 0.65  # width of an axis label and its tick labels
# More lines in one panel cannot be distinguished; more panels are too small.
_MOST_LINES, _MOST_PANELS = 3, 12
_INSIDE = 0.35  # share of the edge's colour in the fill of a box
# Coordinates above these (metres, multiples of the extent) are shown with an offset.
_LARGE_M, _LARGE_EXTENTS = 1000.0, 5.0


def width_in() -> float:
    """Return the printed width of figures, inches."""
    import matplotlib

    return float(matplotlib.rcParams["figure.figsize"][0])


def new_figure(height_in: float, title: str = "") -> Figure:
    """Return an empty figure of the style's width, independent of pyplot."""
    from trajeval_ros.report.shown_figure import Figure

    figure = Figure(figsize=(width_in(), height_in), layout="constrained")
    if title:
        add_title(figure, title)
    return figure


def add_title(figure: Figure, title: str) -> None:
    """Add a title to a figure, and enlarge the figure by its height."""
    letters = int(width_in() / _TITLE_LETTER_IN)
    lines = [part for line in title.splitlines() for part in textwrap.wrap(line, letters)]
    figure.suptitle("\n".join(lines))
    figure.set_label(title)  # unwrapped, for pages
    grow(figure, len(lines))


def grow(figure: Figure, rows: int) -> None:
    """Enlarge a figure by the height of `rows` lines of text."""
    figure.set_figheight(figure.get_figheight() + _ROW_IN * rows)


def is_crowded(count: int) -> bool:
    """Return whether `count` lines need one panel per line."""
    return _MOST_LINES < count <= _MOST_PANELS


def columns_of_panels(count: int, narrowest_in: float) -> int:
    """Return the number of columns for `count` panels of at least the width `narrowest_in`.

    Rows are filled evenly: five panels make rows of three and two, not of four and one.
    """
    return _evenly(count, max(1, int(width_in() / narrowest_in)))


def _evenly(count: int, most: int) -> int:
    """Return the fewest columns, at most `most`, that need no more rows than `most` columns."""
    rows = -(-count // most)
    return -(-count // rows)


def line_style(place: int) -> tuple[str, Dashes]:
    """Return colour and dashes of the estimate at a position in the list."""
    from matplotlib.colors import to_hex

    colours = [to_hex(colour) for colour in _setting("axes.prop_cycle").by_key()["color"]]
    dashes = _LINE_STYLES[place // len(colours) % len(_LINE_STYLES)]
    return colours[place % len(colours)], dashes


def groundtruth_colour() -> Any:
    """Return the colour of the groundtruth."""
    return _setting("lines.color")


def text_color() -> Any:
    """Return the colour of text and marks."""
    return _setting("text.color")


def soft_ink() -> Any:
    """Return the colour of remarks and of background lines."""
    return _setting("axes.edgecolor")


def paper() -> Any:
    """Return the background colour."""
    return _setting("figure.facecolor")


def tint(colour: str) -> Any:
    """Return the fill colour of a box; opaque if the background is."""
    from matplotlib.colors import to_hex, to_rgb, to_rgba

    if to_rgba(paper())[3] == 0.0:
        return colour, _INSIDE
    share = np.array([[_INSIDE], [1.0 - _INSIDE]])
    return to_hex((share * [to_rgb(colour), to_rgb(paper())]).sum(axis=0).tolist())


def _setting(name: Any) -> Any:
    """Return one of matplotlib's settings."""
    import matplotlib

    return matplotlib.rcParams[name]


def mark_ends(axes: Axes, path: Floats) -> None:
    """Mark the start of a path (N, 2) or (N, 3) by a circle and its end by a square."""
    for row, marker, label in ((0, "o", "start"), (-1, "s", "end")):
        axes.plot(
            *path[row][:, None],
            linestyle="none",
            marker=marker,
            markersize=5,
            markerfacecolor=paper(),
            markeredgecolor=text_color(),
            zorder=5,
            label=label,
        )


def label_coordinates(axis: Axis, name: str) -> None:
    """Label an axis in metres; a common offset of large coordinates is subtracted."""
    from matplotlib.ticker import FuncFormatter

    offset = common_offset(*sorted(axis.get_view_interval()))
    if offset != 0.0:
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{round(value - offset, 6):g}"))
    axis.set_label_text(coordinate_label(name, offset))


def draw_boxes(
    axes: Axes,
    boxes: Sequence[tuple[float, Sequence[float]]],
    width: float,
    *,
    colour: str,
    dashes: Dashes = "-",
) -> None:
    """Draw distributions as boxes with whiskers.

    `boxes`: for every box its x coordinate and five numbers: end of the lower whisker, first
    quartile, median, third quartile, end of the upper whisker.
    """
    line = {"color": colour, "linewidth": 0.8}
    names = ("whislo", "q1", "med", "q3", "whishi")
    axes.bxp(
        [dict(zip(names, numbers, strict=True)) for _, numbers in boxes],
        positions=[place for place, _ in boxes],
        widths=width,
        showfliers=False,
        patch_artist=True,
        manage_ticks=False,
        boxprops={
            "facecolor": tint(colour),
            "edgecolor": colour,
            "linewidth": 0.8,
            "linestyle": dashes,
        },
        whiskerprops=line,
        capprops=line,
        medianprops={"color": text_color(), "linewidth": 1.1},
    )


def short_names(names: Sequence[str]) -> list[str]:
    """Return names that fit into a legend; long names are cut at the start."""
    short = []
    for place, name in enumerate(names):
        text = one_line(name) or f"estimate {place + 1}"
        if len(text) > _LONGEST_NAME:
            text = f"…{text[1 - _LONGEST_NAME :]}"
        # matplotlib omits labels that start with an underscore from legends.
        short.append(f" {text}" if text.startswith("_") else text)
    return short


def legend_above(axes: Axes) -> int:
    """Put the legend above axes of the figure's width.

    Returns:
        The number of the legend's rows.
    """
    handles, labels = axes.get_legend_handles_labels()
    if not labels:
        return 0
    room_in = width_in() - _LABELS_IN
    labels = [wrapped(label, room_in) for label in labels]
    columns = legend_columns(labels, room_in)
    axes.legend(handles, labels, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns)
    return _legend_rows(labels, columns)


def legend_below(figure: Figure, handles: Sequence[Any], labels: Sequence[str]) -> None:
    """Put one legend for all axes below them, and enlarge the figure by its height."""
    labels = [wrapped(label, width_in()) for label in labels]
    columns = legend_columns(labels, width_in())
    figure.legend(handles, labels, loc="outside lower center", ncols=columns)
    grow(figure, _legend_rows(labels, columns))


def legend_columns(labels: Sequence[str], room_in: float) -> int:
    """Return the number of columns of a legend that is at most `room_in` wide."""
    most = range(len(labels), 1, -1)
    fitting = next((columns for columns in most if _fits(labels, columns, room_in)), 1)
    even = _evenly(len(labels), fitting)
    return even if _fits(labels, even, room_in) else fitting


def _fits(labels: Sequence[str], columns: int, room_in: float) -> bool:
    """Return whether a legend of some columns, filled column by column, is narrow enough."""
    widest = [
        max(len(line) for label in column for line in str(label).splitlines() or [""])
        for column in np.array_split(np.array(labels), columns)
    ]
    return _LETTER_IN * sum(letters + _HANDLE_LETTERS for letters in widest) < room_in


def _legend_rows(labels: Sequence[str], columns: int) -> int:
    """Return the number of text lines in the highest column of a legend."""
    lines = [label.count("\n") + 1 for label in labels]
    return max(int(sum(column)) for column in np.array_split(np.array(lines), columns))


def wrapped(label: str, room_in: float) -> str:
    """Return a label wrapped to a width in inches, with space for a legend's handle."""
    letters = max(1, int(room_in / _LETTER_IN) - _HANDLE_LETTERS)
    # Names of files and topics have no blanks: they are also wrapped after / and _. Leading blanks
    # are kept: they keep names with an underscore in the legend.
    return "\n".join(re.findall(rf".{{1,{letters}}}(?:(?<=[ /_])|$)|.{{1,{letters}}}", label))


def annotate(axes: Axes, sentence: str) -> None:
    """Write a sentence in place of a plot."""
    axes.grid(visible=False)
    axes.set_xticks([])
    axes.set_yticks([])
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)
    letters = int((width_in() - 0.4) / _LETTER_IN)
    text = axes.text(
        0.5, 0.5, textwrap.fill(sentence, letters), transform=axes.transAxes, ha="center",
        va="center", color=soft_ink(),
    )  # fmt: skip
    text.set_in_layout(False)


def common_offset(low: float, high: float) -> float:
    """Return a round offset of an axis' coordinates if they are large; else 0.0."""
    extent, largest = max(high - low, 1e-6), max(abs(low), abs(high))
    if largest < max(_LARGE_M, _LARGE_EXTENTS * extent):
        return 0.0
    step = 10.0 ** math.ceil(math.log10(extent))
    return math.floor(low / step) * step


def coordinate_label(name: str, offset: float) -> str:
    """Return the label of an axis in metres, with the offset subtracted from its numbers."""
    if offset == 0.0:
        return f"{name} [m]"
    return f"{name} {'−' if offset > 0.0 else '+'} {abs(offset):.10g} [m]"
