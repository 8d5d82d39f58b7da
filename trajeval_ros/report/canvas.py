"""What all figures share: colours, type sizes, thinned lines, and how they are saved."""

from __future__ import annotations

import functools
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import NANOSECONDS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Dashes = Literal["-", "--", "-.", ":"]

GROUNDTRUTH_COLOUR = "0.2"
# Okabe and Ito's palette, which the colour-blind can tell apart, without the too light yellow.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_LINE_STYLES: tuple[Dashes, ...] = ("-", "--", "-.", ":")

# Fonts with Chinese, Japanese and Korean letters, on Linux, macOS and Windows.
_MORE_LETTERS = (
    "Noto Sans CJK SC", "Noto Sans CJK JP", "WenQuanYi Micro Hei", "Droid Sans Fallback",
    "PingFang SC", "Hiragino Sans", "Microsoft YaHei", "Malgun Gothic",
)  # fmt: skip

MOST_POINTS = 20_000
_LONGEST_NAME = 48
# Mean widths of a letter of 8 and of 9 points, and of a legend's handle and space in letters.
_LETTER_IN, _TITLE_LETTER_IN = 0.058, 0.065
_HANDLE_LETTERS = 7
LEGEND_ROW_IN = 0.165
_DOTS_PER_INCH = 200
_STYLE: dict[Any, Any] = {
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.labelsize": 9,
    "axes.linewidth": 0.6,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 9,
    "figure.titlesize": 9,
    "font.size": 9,
    "grid.color": "0.88",
    "grid.linewidth": 0.5,
    "legend.borderaxespad": 0.2,
    "legend.columnspacing": 1.4,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "lines.linewidth": 1.1,
    "text.parse_math": False,
    "xtick.labelsize": 8,
    "xtick.major.width": 0.6,
    "ytick.labelsize": 8,
    "ytick.major.width": 0.6,
}


@contextmanager
def house_style() -> Iterator[None]:
    """Draw in our style, whatever the user's own matplotlib settings are.

    Raises:
        InputError: matplotlib is not installed.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise InputError(
            "figures need matplotlib, which is not installed: pip install 'trajeval-ros[plot]'"
        ) from error
    with matplotlib.rc_context(), warnings.catch_warnings():
        # A name in letters that no font here has is drawn as boxes; nobody can mend that now.
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        matplotlib.rcParams["font.family"] = _fonts()
        yield


@functools.lru_cache(maxsize=1)
def _fonts() -> list[str]:
    """Return matplotlib's own font, and those that have more letters where they are installed."""
    from matplotlib import font_manager

    installed = set(font_manager.get_font_names())
    return ["DejaVu Sans", *(name for name in _MORE_LETTERS if name in installed)]


def new_figure(width_in: float, height_in: float, layout: str | None = None) -> Figure:
    """Return an empty figure of that size in inches, which no pyplot knows of.

    What stands out of it (titles, legends, labels) is saved nonetheless.
    """
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), layout=layout)  # type: ignore[arg-type]


def save(figure: Figure, path: Path) -> Path:
    """Write a PNG of all that was drawn; the same figure gives the same bytes."""
    figure.savefig(
        path,
        format="png",
        dpi=_DOTS_PER_INCH,
        metadata={"Software": None},
        bbox_inches="tight",
        pad_inches=0.06,
    )
    return path


def line_style(place: int) -> tuple[str, Dashes]:
    """Return the colour and the dashes of the estimate at that place in the list."""
    dashes = _LINE_STYLES[place // len(COLOURS) % len(_LINE_STYLES)]
    return COLOURS[place % len(COLOURS)], dashes


def tint(colour: str) -> str:
    """Return the colour as light as a box's inside should be, opaque."""
    from matplotlib.colors import to_hex, to_rgb

    red, green, blue = (1.0 - 0.35 * (1.0 - part) for part in to_rgb(colour))
    return to_hex((red, green, blue))


def draw_boxes(
    axes: Axes,
    boxes: Sequence[tuple[float, Sequence[float]]],
    width: float,
    *,
    edge: tuple[str, Dashes, float],
    inside: str | tuple[str, float],
    median: tuple[str, float],
) -> None:
    """Draw distributions as boxes with whiskers.

    Args:
        axes: Where.
        boxes: Of each its place on the x axis, and five numbers: where the lower whisker ends,
            first quartile, median, third quartile, and where the upper whisker ends.
        width: Of a box.
        edge: Colour, dashes and width of its lines; whiskers are never dashed.
        inside: Its colour.
        median: Colour and width of the median's line.
    """
    colour, dashes, line_width = edge
    line = {"color": colour, "linewidth": line_width}
    names = ("whislo", "q1", "med", "q3", "whishi")
    axes.bxp(
        [dict(zip(names, numbers, strict=True)) for _, numbers in boxes],
        positions=[place for place, _ in boxes],
        widths=width,
        showfliers=False,
        patch_artist=True,
        manage_ticks=False,
        boxprops={
            "facecolor": inside,
            "edgecolor": colour,
            "linewidth": line_width,
            "linestyle": dashes,
        },
        whiskerprops=line,
        capprops=line,
        medianprops={"color": median[0], "linewidth": median[1]},
    )


def short_names(names: Sequence[str]) -> list[str]:
    """Return names that fit in a legend: the end of a long one says more than its beginning."""
    short = []
    for place, name in enumerate(names):
        text = one_line(name) or f"estimate {place + 1}"
        if len(text) > _LONGEST_NAME:
            text = f"…{text[1 - _LONGEST_NAME :]}"
        # matplotlib leaves labels that begin with an underscore out of legends.
        short.append(f" {text}" if text.startswith("_") else text)
    return short


def head(axes: Axes, width_in: float, title: str = "") -> int:
    """Put the legend above the axes, never over data, and the title above the legend.

    Returns:
        The number of the legend's rows, each `LEGEND_ROW_IN` high.
    """
    handles, labels = axes.get_legend_handles_labels()
    count = len(labels)
    columns = legend_columns(labels, width_in)
    rows = -(-count // columns)
    if count:
        axes.legend(handles, labels, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns)
    if title:
        # The axis labels at the left widen the figure, so the title may be wider than the axes.
        letters = int((width_in + 0.6) / _TITLE_LETTER_IN)
        lines = [textwrap.fill(line, letters) for line in title.splitlines()]
        axes.set_title("\n".join(lines), pad=72.0 * LEGEND_ROW_IN * rows + 9.0)
    return rows


def legend_columns(labels: Sequence[str], width_in: float) -> int:
    """Return in how many columns a legend of that width can be laid out."""
    most = range(len(labels), 1, -1)
    return next((columns for columns in most if _fits(labels, columns, width_in)), 1)


def _fits(labels: Sequence[str], columns: int, width_in: float) -> bool:
    """Whether a legend of so many columns, which fill one after the other, is narrow enough."""
    widest = [max(map(len, column)) for column in np.array_split(np.array(labels), columns)]
    return _LETTER_IN * sum(letters + _HANDLE_LETTERS for letters in widest) < width_in


def say_instead(axes: Axes, sentence: str) -> None:
    """Write in the place of a plot why there is none."""
    axes.grid(visible=False)
    axes.set_xticks([])
    axes.set_yticks([])
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)
    axes.text(
        0.5, 0.5, sentence, transform=axes.transAxes, ha="center", va="center", wrap=True,
        color="0.35", fontsize=9,
    )  # fmt: skip


def thinned(
    columns: Floats, stamps: NDArray[np.int64], max_gap_s: float, most: int = MOST_POINTS
) -> Floats:
    """Return rows (M, K) to draw as a line instead of N rows: few, with nothing lost to the eye.

    Of each of many equal runs of rows, those with the least and largest value of each column are
    kept, so that no peak is lost. A row of NaN breaks the line where time jumps by more than
    the gap and more than five usual steps (keyframes are far apart without being a gap).

    Args:
        columns: (N, K).
        stamps: (N,), nanoseconds, in order.
        max_gap_s: Seconds.
        most: About how many rows are few.
    """
    count, width = columns.shape
    rows = np.arange(count)
    if count > most:
        runs = most // (2 * width)
        size = -(-count // runs)
        padded = np.pad(columns, ((0, size * runs - count), (0, 0)), mode="edge")
        by_run = padded.reshape(runs, size, width)
        extremes = np.stack([by_run.argmin(axis=1), by_run.argmax(axis=1)], axis=2)
        in_all = extremes + (size * np.arange(runs))[:, None, None]
        rows = np.concatenate([[0], in_all.ravel(), [count - 1]])
    steps = np.diff(stamps)
    usual = float(np.median(steps)) if len(steps) else 0.0
    before = np.flatnonzero(steps > max(max_gap_s * NANOSECONDS, 5.0 * usual))
    rows = np.unique(np.minimum(np.concatenate([rows, before, before + 1]), count - 1))
    return np.insert(columns[rows], np.searchsorted(rows, before + 1), np.nan, axis=0)
