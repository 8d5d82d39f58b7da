"""Errors of many estimates in one row per estimate, with equal scales and the others in grey."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.report import canvas

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ROW_IN, _REST_IN = 0.95, 0.5
POSITION, ROTATION = "position [m]", "rotation [deg]"


@dataclass(frozen=True, eq=False)
class ErrorRow:
    """The errors of one estimate.

    Attributes:
        place: Position of the estimate, which determines its colour.
        titles: Title lines above every one of its K errors.
        errors: The K errors over time or distance, (M, 2); None if not available.
    """

    place: int
    titles: tuple[str, ...]
    errors: tuple[Floats | None, ...]


def error_rows(
    rows: Sequence[ErrorRow],
    title: str,
    across: str,
    labels: Sequence[str] = (POSITION, ROTATION),
) -> Figure:
    """Draw the errors of several estimates.

    Args:
        rows: One row per estimate.
        title: Title of the figure.
        across: Label of the x axis.
        labels: Labels of the K errors.
    """
    figure = canvas.new_figure(_ROW_IN * len(rows) + _REST_IN, title)
    grid = figure.subplots(len(rows), len(labels), sharex=True, sharey="col", squeeze=False)
    lines = 1
    for panels, row in zip(grid, rows, strict=True):
        colour, _ = canvas.line_style(row.place)
        for column, (axes, label) in enumerate(zip(panels, labels, strict=True)):
            for other in rows:
                errors = other.errors[column]
                if errors is not None:
                    axes.plot(*errors.T, color=canvas.soft_ink(), alpha=0.3, linewidth=0.4)
            its = row.errors[column]
            if its is not None:
                axes.plot(*its.T, color=colour, linewidth=1.0)
            room_in = canvas.width_in() / (1.1 * len(labels))
            heading = "\n".join(
                canvas.wrapped(line, room_in) for line in row.titles[column].split("\n")
            )
            lines = max(lines, heading.count("\n") + 1)
            axes.set_title(heading, color=colour, loc="left")
            axes.set_ylabel(label)
            axes.set_ylim(bottom=0.0)
    known = [errors for row in rows for errors in row.errors if errors is not None]
    grid[0, 0].set_xlim(0.0, max(1e-9, *(float(np.nanmax(errors[:, 0])) for errors in known)))
    for axes in grid[-1]:
        axes.set_xlabel(across)
    canvas.grow(figure, lines * len(rows))
    return figure
