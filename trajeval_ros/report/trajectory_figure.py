"""The aligned trajectories from above and from the side: Fig. 6 of the tutorial."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.report import canvas
from trajeval_ros.report.definitions import alignment_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CORRESPONDENCES = 100
_LONGEST_SIDE_IN = 5.6
_SHORTEST_SIDES_IN = (4.2, 1.1)
_MARGIN = 0.04


def top_view(evaluations: Sequence[Evaluation], names: Sequence[str]) -> Figure:
    """Draw estimates and groundtruth in the level plane, seen from above."""
    return _view(evaluations, names, (0, 1), "Top view")


def side_view(evaluations: Sequence[Evaluation], names: Sequence[str]) -> Figure:
    """Draw estimates and groundtruth with height, over the longer of the level axes."""
    truth = evaluations[0].groundtruth
    extent = np.ptp(truth.up.turned(truth.positions), axis=0)
    return _view(evaluations, names, (1 if extent[1] > extent[0] else 0, 2), "Side view")


def _view(
    evaluations: Sequence[Evaluation], names: Sequence[str], plane: tuple[int, int], title: str
) -> Figure:
    """Draw two of the groundtruth's level axes and height, which is the third."""
    first = evaluations[0]
    upward = first.groundtruth.up

    def seen(trajectory: Trajectory) -> Floats:
        return upward.turned(trajectory.positions)[:, plane]

    everything = np.concatenate(
        [seen(first.groundtruth), *(seen(each.aligned) for each in evaluations)]
    )
    low, high = everything.min(axis=0), everything.max(axis=0)
    extent = np.maximum(high - low, 1e-3)
    # The figure takes the shape of the flight, so that equal axes leave no empty paper.
    inches = np.maximum(_LONGEST_SIDE_IN * extent / extent.max(), _SHORTEST_SIDES_IN)
    figure = canvas.new_figure(*inches)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    max_gap_s = first.protocol.association.max_gap_s
    truth = first.groundtruth
    axes.plot(
        *canvas.thinned(seen(truth), truth.stamps, max_gap_s).T,
        color=canvas.GROUNDTRUTH_COLOUR,
        linewidth=1.7,
        label="groundtruth",
    )
    for place, (evaluation, name) in enumerate(zip(evaluations, names, strict=True)):
        colour, dashes = canvas.line_style(place)
        aligned = evaluation.aligned
        axes.plot(
            *canvas.thinned(seen(aligned), aligned.stamps, max_gap_s).T,
            color=colour,
            linestyle=dashes,
            linewidth=1.0,
            label=name,
        )
    _draw_correspondences(axes, evaluations, seen)
    start = seen(first.association.groundtruth)[0]
    axes.plot(
        *start[:, None],
        linestyle="none",
        marker="o",
        markersize=6,
        markerfacecolor="white",
        markeredgecolor="black",
        zorder=5,
        label="start",
    )
    centre = (low + high) / 2.0
    half = inches / 2.0 * float(((1.0 + 2.0 * _MARGIN) * extent / inches).max())
    axes.set_xlim(centre[0] - half[0], centre[0] + half[0])
    axes.set_ylim(centre[1] - half[1], centre[1] + half[1])
    axes.set_aspect("equal")
    labels = [*("xyz"[each] for each in upward.level), upward.name]
    across, up = (labels[each] for each in plane)
    axes.set_xlabel(f"{across} [m]")
    axes.set_ylabel(f"{up} [m]")
    canvas.head(axes, inches[0], f"{title} ({across}{up})\n{alignment_of(evaluations)}")
    return figure


def _draw_correspondences(
    axes: Axes, evaluations: Sequence[Evaluation], seen: Callable[[Trajectory], Floats]
) -> None:
    """Join a hundred states of each estimate, evenly along the path, with their groundtruth."""
    from matplotlib.collections import LineCollection

    ends: list[Floats] = []
    for evaluation in evaluations:
        truth, aligned = evaluation.association.groundtruth, evaluation.aligned
        along = truth.travelled
        evenly = np.searchsorted(along, np.linspace(0.0, along[-1], _CORRESPONDENCES))
        rows = np.unique(np.minimum(evenly, len(along) - 1))
        ends.append(np.stack([seen(truth)[rows], seen(aligned)[rows]], axis=1))
    axes.add_collection(
        LineCollection(
            list(np.concatenate(ends)),
            colors="0.55",
            linewidths=0.7,
            zorder=1.5,
            label="correspondences",
        ),
        autolim=False,
    )
