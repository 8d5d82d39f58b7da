"""Aligned trajectories from above and from the side: Fig. 6 of the tutorial."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.report import canvas
from trajeval_ros.report.definitions import alignment_of
from trajeval_ros.report.fix_marks import draw_fixes
from trajeval_ros.report.line_thinning import thinned
from trajeval_ros.report.plane_panels import PlanePanels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CORRESPONDENCES = 100


def top_view(evaluations: Sequence[Evaluation], names: Sequence[str]) -> Figure:
    """Draw estimates and groundtruth in the horizontal plane."""
    return _view(evaluations, names, (0, 1), "Top view")


def side_view(evaluations: Sequence[Evaluation], names: Sequence[str]) -> Figure:
    """Draw estimates and groundtruth with height over the longer horizontal axis."""
    truth = evaluations[0].groundtruth
    extent = np.ptp(truth.up.turned(truth.positions), axis=0)
    return _view(evaluations, names, (1 if extent[1] > extent[0] else 0, 2), "Side view")


def _view(
    evaluations: Sequence[Evaluation], names: Sequence[str], plane: tuple[int, int], title: str
) -> Figure:
    """Draw estimates and groundtruth in a plane; axes 0 and 1 are horizontal, 2 is height."""
    first = evaluations[0]
    truth, upward = first.groundtruth, first.groundtruth.up
    max_gap_s = first.protocol.association.max_gap_s
    across, up = axis_names(upward, plane)
    aligned = [_seen(e.aligned, upward, plane) for e in evaluations]
    whole = _seen(truth, upward, plane)
    panels = PlanePanels(
        [whole, *aligned],
        dict(enumerate(names)),
        f"{title} ({across}{up})\n{alignment_of(evaluations)}",
    )
    line = thinned(whole, truth.stamps, max_gap_s)
    for place, (evaluation, path) in enumerate(zip(evaluations, aligned, strict=True)):
        truth_pairs = evaluation.association.groundtruth
        _draw_correspondences(
            panels.of(place),
            _seen(truth_pairs, upward, plane),
            path,
            truth_pairs.travelled,
            "correspondences" if place == 0 else "_",  # one entry of the legend for all
        )
        panels.draw_path(place, thinned(path, evaluation.aligned.stamps, max_gap_s))
    for axes in panels.panels:
        draw_fixes(axes, truth, whole, plane)
    matched = _seen(first.association.groundtruth, upward, plane)
    return panels.finish(line, matched, (across, up))


def axis_names(upward: UpAxis, plane: tuple[int, int]) -> tuple[str, str]:
    """Return the names of a plane's axes; axes 0 and 1 are horizontal, 2 is height."""
    names = [*("xyz"[axis] for axis in upward.level), upward.name]
    return names[plane[0]], names[plane[1]]


def _seen(trajectory: Trajectory, upward: UpAxis, plane: tuple[int, int]) -> Floats:
    """Return positions in a plane, (N, 2), metres."""
    seen: Floats = upward.turned(trajectory.positions)[:, plane]
    return seen


def _draw_correspondences(
    axes: Axes, truth: Floats, aligned: Floats, along: Floats, label: str
) -> None:
    """Connect a hundred states, evenly spaced along the path, with their groundtruth."""
    from matplotlib.collections import LineCollection

    evenly = np.searchsorted(along, np.linspace(0.0, along[-1], _CORRESPONDENCES))
    rows = np.unique(np.minimum(evenly, len(along) - 1))
    lines = LineCollection(
        list(np.stack([truth[rows], aligned[rows]], axis=1)),
        colors=canvas.soft_ink(),
        alpha=0.6,
        linewidths=0.6,
        zorder=1.5,
        label=label,
    )
    axes.add_collection(lines, autolim=False)
