"""The Stanford diagram: errors against protection levels."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.consistency.integrity import Integrity, PartIntegrity
from trajeval_ros.formatting.numbers import percent
from trajeval_ros.report import canvas
from trajeval_ros.report.figure_output import save_all
from trajeval_ros.report.figure_style import PLAIN, FigureStyle

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LABELS_IN = 0.3
_CELLS = 60


def write_stanford(
    integrity: Integrity, folder: Path, name: str, suffix: str = "", style: FigureStyle = PLAIN
) -> None:
    """Write `stanford` to an existing folder.

    Args:
        integrity: Integrity of an estimate.
        folder: The folder.
        name: Name of the estimate in the figure.
        suffix: Suffix of the file name, to distinguish estimates.
        style: Formats and style.
    """
    (short,) = canvas.short_names([name])
    save_all({f"stanford{suffix}": lambda: stanford(integrity, short)}, folder, style)


def stanford(integrity: Integrity, name: str) -> Figure:
    """Draw one panel per part of the pose."""
    count = len(integrity.parts)
    exact = "upper bounds" if integrity.exactness == "bound" else integrity.exactness
    title = f"{name}: integrity at risk {integrity.risk:g}, levels {exact}"
    figure = canvas.new_figure(canvas.width_in() / count + _LABELS_IN, title)
    for axes, part in zip(
        figure.subplots(1, count, squeeze=False)[0], integrity.parts, strict=True
    ):
        _draw(axes, part)
    return figure


def _draw(axes: Axes, part: PartIntegrity) -> None:
    """Draw the density of errors and levels, the alert limit, and the shares of the areas."""
    # The limits leave space for the text of every area.
    limit = part.alert_limit
    positive = np.concatenate([part.errors, part.levels])
    positive = positive[positive > 0.0]
    low = min(float(np.quantile(positive, 0.001)) / 1.5, limit / 30.0)
    high = max(float(positive.max()) * 1.5, 10.0 * limit)
    edges = np.geomspace(low, high, _CELLS)
    counts, _, _ = np.histogram2d(
        np.clip(part.errors, low, high), np.clip(part.levels, low, high), bins=[edges, edges]
    )
    from matplotlib.colors import LogNorm

    axes.pcolormesh(
        edges, edges, np.ma.masked_equal(counts.T, 0), norm=LogNorm(), rasterized=True,
    )  # fmt: skip
    axes.plot([low, high], [low, high], color=canvas.ink(), linewidth=0.8)
    for draw in (axes.axhline, axes.axvline):
        draw(limit, color=canvas.ink(), linewidth=0.8, linestyle="--")
    axes.fill_between(
        [limit, high], low, limit, color=canvas.line_style(0)[0], alpha=0.15, linewidth=0, zorder=0
    )
    beyond, below = float(np.sqrt(limit * high)), 1.2 * low
    places = {
        "hazardous": (beyond, below, "center", "bottom"),
        "misleading": (limit / 1.15, below, "right", "bottom"),
        "nominal": (below, limit / 1.15, "left", "top"),
        "unavailable": (below, high / 1.15, "left", "top"),
        "misleading_unavailable": (high / 1.1, 1.15 * limit, "right", "bottom"),
    }
    for area, (x, y, across, along) in places.items():
        words = ",\n".join(area.split("_"))
        text = f"{words}\n{percent(part.areas[area])}"
        axes.text(x, y, text, ha=across, va=along, fontsize="small")
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
    axes.set_xlim(low, high)
    axes.set_ylim(low, high)
    axes.set_aspect("equal")
    axes.set_xlabel(f"{part.part} error [{part.unit}]")
    axes.set_ylabel(f"protection level [{part.unit}]")
