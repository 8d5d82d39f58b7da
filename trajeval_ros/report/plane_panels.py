"""Paths in a plane with equal scales: in one panel, or in one panel per path if many."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.report import canvas

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MARGIN = 0.04
_NARROWEST_IN = 1.7
_FLATTEST, _TALLEST = 0.22, 1.2  # height of a panel relative to its width
_BESIDE_IN, _BELOW_IN, _NAME_IN = 0.6, 0.45, 0.25


class PlanePanels:
    """A figure of paths; the shape of its panels follows from the extent of the data."""

    def __init__(
        self,
        everything: Sequence[Floats],
        names: Mapping[int, str],
        title: str,
        *,
        is_split: bool | None = None,
    ) -> None:
        """Create the figure and its panels.

        `everything`: all points (N, 2) that the panels must show, metres. `is_split`: whether
        every path has its own panel; None to decide by their number.
        """
        self._names = names
        self._split = canvas.is_crowded(len(names)) if is_split is None else is_split
        low = np.min([np.nanmin(points, axis=0) for points in everything], axis=0)
        high = np.max([np.nanmax(points, axis=0) for points in everything], axis=0)
        extent = np.maximum(high - low, 1e-3)
        self._columns = columns = (
            canvas.columns_of_panels(len(names), _NARROWEST_IN) if self._split else 1
        )
        rows = -(-len(names) // columns) if self._split else 1
        self._wide_in = wide_in = (canvas.width_in() - _BESIDE_IN) / columns
        shape = float(np.clip(extent[1] / extent[0], _FLATTEST, _TALLEST))
        high_in = wide_in * shape + (_NAME_IN if self._split else 0.0)
        # If the last row is not full, the row above it has labels, too.
        labelled = 1 if not self._split or len(names) % columns == 0 else 2
        self.figure: Figure = canvas.new_figure(rows * high_in + labelled * _BELOW_IN, title)
        self.figure.set_layout_engine("compressed")
        grid = self.figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        self._all: list[Axes] = list(grid.ravel())
        self._shown = self._all[: len(names)] if self._split else self._all
        for axes in self._all[len(self._shown) :]:
            axes.set_visible(False)
        centre = (low + high) / 2.0
        # In the panels' shape, so that equal scales leave no empty space.
        size = np.array([1.0, shape])
        half = (0.5 + _MARGIN) * float((extent / size).max()) * size
        for axes in self._shown:
            axes.set_xlim(centre[0] - half[0], centre[0] + half[0])
            axes.set_ylim(centre[1] - half[1], centre[1] + half[1])
            axes.set_aspect("equal")

    def of(self, place: int) -> Axes:
        """Return the panel of the path at a position in the list."""
        return self._shown[list(self._names).index(place) if self._split else 0]

    @property
    def panels(self) -> list[Axes]:
        """All visible panels."""
        return self._shown

    def draw_path(self, place: int, path: Floats) -> None:
        """Draw a path (N, 2) in the style of its position."""
        axes, name = self.of(place), self._names[place]
        colour, dashes = canvas.line_style(place)
        if self._split:
            axes.set_title(canvas.wrapped(name, self._wide_in), color=colour)
        axes.plot(
            *path.T, color=colour, linestyle="-" if self._split else dashes, linewidth=1.0,
            label="_" if self._split else name,
        )  # fmt: skip
        axes.plot(*path[-1:].T, color=colour, linestyle="none", marker="s", markersize=3)

    def draw_coloured(self, place: int, pieces: tuple[Floats, Floats], largest: float) -> None:
        """Draw segments (M, 2, 2) coloured by values (M,) from 0 to `largest`."""
        from matplotlib.collections import LineCollection

        axes, (lines, values) = self.of(place), pieces
        axes.set_title(canvas.wrapped(self._names[place], self._wide_in))
        # The outline makes bright colours visible on white.
        outline = LineCollection(
            list(lines), linewidths=2.8, colors=canvas.soft_ink(), capstyle="round", zorder=2.4
        )
        coloured = LineCollection(list(lines), linewidths=2.0, capstyle="round", zorder=2.5)
        coloured.set_array(values)
        coloured.set_clim(0.0, max(largest, 1e-9))
        axes.add_collection(outline, autolim=False)
        axes.add_collection(coloured, autolim=False)

    def add_ramp(self, label: str, *, is_exceeded: bool) -> None:
        """Add the colour bar of coloured paths, with an arrow if values exceed its end."""
        coloured = self._shown[0].collections[-1]
        extend = "max" if is_exceeded else "neither"
        self.figure.colorbar(
            coloured, ax=self._all, label=label, aspect=30, pad=0.02, extend=extend
        )

    def finish(
        self,
        groundtruth: Floats | None,
        between: Floats | None,
        axis_names: tuple[str, str],
        groundtruth_name: str = "groundtruth",
    ) -> Figure:
        """Draw groundtruth and marks in all panels, label the axes, and return the figure."""
        for place, axes in enumerate(self._shown):
            if groundtruth is not None:
                axes.plot(
                    *groundtruth.T, color=canvas.groundtruth_colour(), linewidth=1.6, zorder=1.8,
                    label=groundtruth_name,
                )  # fmt: skip
            if between is not None:
                canvas.mark_ends(axes, between)
            for axis, name in zip((axes.xaxis, axes.yaxis), axis_names, strict=True):
                canvas.label_coordinates(axis, name)
            across = axes.get_xlabel()
            axes.label_outer()
            if place + self._columns >= len(self._shown):  # the lowest panel of its column
                axes.tick_params(labelbottom=True)
                axes.set_xlabel(across)
        handles, labels = self._shown[0].get_legend_handles_labels()
        # The groundtruth comes first.
        order = sorted(range(len(labels)), key=lambda row: labels[row] != groundtruth_name)
        canvas.legend_below(
            self.figure, [handles[row] for row in order], [labels[row] for row in order]
        )
        return self.figure
