"""What all figures are made with: paper, titles, legends, lines, boxes, and files."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.escaping import latex_text, one_line
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.io.temporary import temporary_folder
from trajeval_ros.io.writing import refused_by_disk
from trajeval_ros.report.figure_style import TEX_SYSTEMS, FigureStyle, house_style
from trajeval_ros.report.ticks import common_offset, coordinate_label

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

Drawing = Callable[[], "Figure"]
Dashes = Literal["-", "--", "-.", ":"]

_LINE_STYLES: tuple[Dashes, ...] = ("-", "--", "-.", ":")
_LONGEST_NAME = 48
# Mean widths of a letter of 8 and of 9 points, and of a legend's handle and space in letters.
_LETTER_IN, _TITLE_LETTER_IN = 0.06, 0.068
_HANDLE_LETTERS = 7
_ROW_IN = 0.165  # of text
_LABELS_IN = 0.65  # beside axes: their label and its ticks'
# More lines than these in one panel can't be told apart; more panels than these are too small.
_MOST_LINES, _MOST_PANELS = 3, 12
_INSIDE = 0.35  # share of its edge's colour in a box


def width_in() -> float:
    """Return the width that figures are to be printed at, inches."""
    import matplotlib

    return float(matplotlib.rcParams["figure.figsize"][0])


def new_figure(height_in: float, title: str = "") -> Figure:
    """Return an empty figure of the style's width, which no pyplot knows of.

    Args:
        height_in: Inches, without a title and a legend.
        title: Of some lines.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in(), height_in), layout="constrained")
    if title:
        add_title(figure, title)
    return figure


def add_title(figure: Figure, title: str) -> None:
    """Give a figure a title, and the room for it."""
    letters = int(width_in() / _TITLE_LETTER_IN)
    lines = [part for line in title.splitlines() for part in textwrap.wrap(line, letters)]
    figure.suptitle("\n".join(lines))
    grow(figure, len(lines))


def titled(draw: Drawing, title: str) -> Figure:
    """Draw a figure and give it a title."""
    figure = draw()
    add_title(figure, title)
    return figure


def grow(figure: Figure, rows: int) -> None:
    """Make room in a figure for so many more lines of text, as of legends."""
    figure.set_figheight(figure.get_figheight() + _ROW_IN * rows)


def is_crowded(count: int) -> bool:
    """Return whether so many lines need a panel each to be told apart."""
    return _MOST_LINES < count <= _MOST_PANELS


def columns_of_panels(count: int, narrowest_in: float) -> int:
    """Return how many of so many panels stand beside each other, each at least so wide.

    Rows are filled evenly: five panels are three and two, not four and one.
    """
    return _evenly(count, max(1, int(width_in() / narrowest_in)))


def _evenly(count: int, most: int) -> int:
    """Return the fewest columns, `most` at most, that take no more rows than `most` columns."""
    rows = -(-count // most)
    return -(-count // rows)


def line_style(place: int) -> tuple[str, Dashes]:
    """Return the colour and the dashes of the estimate at that place in the list."""
    from matplotlib.colors import to_hex

    colours = [to_hex(each) for each in _setting("axes.prop_cycle").by_key()["color"]]
    dashes = _LINE_STYLES[place // len(colours) % len(_LINE_STYLES)]
    return colours[place % len(colours)], dashes


def is_too_wide(labels: Sequence[str]) -> bool:
    """Return whether tick labels side by side would run into each other."""
    return _LETTER_IN * sum(len(each) + 2 for each in labels) > width_in() - _LABELS_IN


def truth_colour() -> Any:
    """Return the colour of the groundtruth."""
    return _setting("lines.color")


def ink() -> Any:
    """Return the colour of what is written and marked."""
    return _setting("text.color")


def soft_ink() -> Any:
    """Return the colour of remarks, and of what is behind."""
    return _setting("axes.edgecolor")


def grid_colour() -> Any:
    """Return the colour of grid lines."""
    return _setting("grid.color")


def paper() -> Any:
    """Return the colour of the ground."""
    return _setting("figure.facecolor")


def tint(colour: str) -> Any:
    """Return the colour as light as a box's inside should be, opaque if the paper is."""
    from matplotlib.colors import to_hex, to_rgb, to_rgba

    if to_rgba(paper())[3] == 0.0:
        return colour, _INSIDE
    share = np.array([[_INSIDE], [1.0 - _INSIDE]])
    return to_hex((share * [to_rgb(colour), to_rgb(paper())]).sum(axis=0).tolist())


def _setting(name: Any) -> Any:
    import matplotlib

    return matplotlib.rcParams[name]


def mark_ends(axes: Axes, path: Floats, *, with_labels: bool = True) -> None:
    """Mark where a path (N, 2 or 3) starts, by a circle, and where it ends, by a square."""
    for row, marker, label in ((0, "o", "start"), (-1, "s", "end")):
        axes.plot(
            *path[row][:, None],
            linestyle="none",
            marker=marker,
            markersize=5,
            markerfacecolor=paper(),
            markeredgecolor=ink(),
            zorder=5,
            label=label if with_labels else "_",
        )


def label_coordinates(axis: Axis, name: str) -> None:
    """Name an axis of metres; what all its large coordinates have in common is subtracted."""
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

    Args:
        axes: Where.
        boxes: Of each its place on the x axis, and five numbers: where the lower whisker ends,
            first quartile, median, third quartile, and where the upper whisker ends.
        width: Of a box.
        colour: Of its lines.
        dashes: Of its edge; whiskers are never dashed.
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
        medianprops={"color": ink(), "linewidth": 1.1},
    )


def short_names(names: Sequence[str]) -> list[str]:
    """Return names that fit in a legend: the end of a long one says more than its beginning."""
    short = []
    for place, name in enumerate(names):
        text = one_line(name) or f"estimate {place + 1}"
        if len(text) > _LONGEST_NAME:
            text = f"…{text[1 - _LONGEST_NAME :]}"
        # matplotlib leaves labels that start with an underscore out of legends.
        short.append(f" {text}" if text.startswith("_") else text)
    return short


def legend_above(axes: Axes) -> int:
    """Put the legend of axes as wide as the figure above them, never over data.

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
    """Put one legend for all axes below them, and make room for it."""
    labels = [wrapped(label, width_in()) for label in labels]
    columns = legend_columns(labels, width_in())
    figure.legend(handles, labels, loc="outside lower center", ncols=columns)
    grow(figure, _legend_rows(labels, columns))


def legend_columns(labels: Sequence[str], room_in: float) -> int:
    """Return in how many columns a legend of that width can be laid out."""
    most = range(len(labels), 1, -1)
    fitting = next((columns for columns in most if _fits(labels, columns, room_in)), 1)
    even = _evenly(len(labels), fitting)
    return even if _fits(labels, even, room_in) else fitting


def _fits(labels: Sequence[str], columns: int, room_in: float) -> bool:
    """Whether a legend of so many columns, which fill one after the other, is narrow enough."""
    widest = [
        max(len(line) for label in column for line in str(label).splitlines() or [""])
        for column in np.array_split(np.array(labels), columns)
    ]
    return _LETTER_IN * sum(letters + _HANDLE_LETTERS for letters in widest) < room_in


def _legend_rows(labels: Sequence[str], columns: int) -> int:
    """Return how many lines of text are above each other in the highest column."""
    lines = [label.count("\n") + 1 for label in labels]
    return max(int(sum(column)) for column in np.array_split(np.array(lines), columns))


def wrapped(label: str, room_in: float) -> str:
    """Return a label in lines that fit into so many inches, a legend's handle beside them."""
    letters = int(room_in / _LETTER_IN) - _HANDLE_LETTERS
    # Spaces at the start keep a name in the legend.
    return label if len(label) <= letters else textwrap.fill(label, letters, drop_whitespace=False)


def say_instead(axes: Axes, sentence: str) -> None:
    """Write in the place of a plot why there is none."""
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


def save(figure: Figure, path: Path, file_format: str) -> Path:
    """Write a figure; the same figure gives the same bytes.

    Args:
        figure: What to write.
        path: The file.
        file_format: `png`, `pdf`, `svg` or `pgf`.

    Raises:
        InputError: LaTeX is needed for it, and can't do it.
    """
    import matplotlib

    title = " ".join(figure.get_suptitle().split())
    metadata: dict[str, dict[str, Any]] = {
        "png": {"Software": None, "Title": title},
        "pdf": {"CreationDate": None, "Creator": None, "Producer": None, "Title": title},
        "svg": {"Date": None, "Creator": None, "Title": title},
    }
    by_latex = file_format == "pgf" or matplotlib.rcParams["text.usetex"]
    with matplotlib.rc_context():
        if by_latex:
            _prepare_for_latex(figure)
        try:
            if file_format == "pgf":
                figure.savefig(path, format=file_format)
            else:
                figure.savefig(path, format=file_format, metadata=metadata[file_format])
        except (RuntimeError, FileNotFoundError, ValueError) as error:
            if not by_latex:
                raise
            said = " ".join(str(error).split())[:200]
            raise InputError(
                f"LaTeX can't typeset a figure: {said}; use format pdf, which needs no LaTeX"
            ) from error
    return path


def save_all(figures: Mapping[str, Drawing], folder: Path, style: FigureStyle) -> list[Path]:
    """Draw figures in a style, one after the other, and write each in all of its formats.

    Args:
        figures: What draws each, by the name of its file without a suffix.
        folder: Existing; files of the same names are replaced.
        style: How.

    Returns:
        The files.

    Raises:
        InputError: They can't be written, or matplotlib is not installed.
    """
    written = []
    with (
        house_style(style),
        refused_by_disk(f"figures in {folder}"),
        temporary_folder("figures", folder) as made,
    ):
        for name, draw in figures.items():
            for each in style.formats:
                figure = draw()
                if not style.has_titles:
                    _hide_title(figure)
                save(figure, made / f"{name}.{each}", each)
                written.append(folder / f"{name}.{each}")
        # Beside PGF are the images in it.
        for file in sorted(made.iterdir()):
            file.replace(folder / file.name)
    return written


def _hide_title(figure: Figure) -> None:
    for text in figure.texts:
        if text.get_text() == figure.get_suptitle():
            grow(figure, -1 - text.get_text().count("\n"))
            text.set_visible(False)
            text.set_in_layout(False)


def _prepare_for_latex(figure: Figure) -> None:
    """Make all text what LaTeX prints as it is."""
    import matplotlib
    from matplotlib.text import Text
    from matplotlib.ticker import FuncFormatter

    systems = [each for each in TEX_SYSTEMS if shutil.which(each)]
    chosen = matplotlib.rcParams["pgf.texsystem"]
    if systems and shutil.which(chosen) is None:
        matplotlib.rcParams["pgf.texsystem"] = systems[0]
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        text.set_text("\n".join(map(latex_text, text.get_text().split("\n"))))
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            named = axis.get_major_formatter()
            if isinstance(named, FuncFormatter):
                axis.set_major_formatter(_escaped(named))


def _escaped(named: Any) -> Any:
    from matplotlib.ticker import FuncFormatter

    return FuncFormatter(lambda value, place: latex_text(named(value, place)))
