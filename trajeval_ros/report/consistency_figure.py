"""Errors within their own uncertainty: over time, and as ellipses from above."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.consistency.result import Consistency
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.statistics import round_below
from trajeval_ros.report import canvas

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_WIDTH_IN = 6.4
_ELLIPSES = 24
_SIGMAS = 3.0
# Ellipses are enlarged so that the largest is this share of the flight.
_LARGEST_ELLIPSE = 0.06
_LABELS = ("x [m]", "y [m]", "z [m]", "φx [deg]", "φy [deg]", "φz [deg]")


def write_consistency(
    evaluation: Evaluation, consistency: Consistency, folder: Path, name: str, suffix: str = ""
) -> list[Path]:
    """Write `consistency.png` and `uncertainty_top.png`, where poses have covariances.

    Args:
        evaluation: Of the estimate.
        consistency: Of the same.
        folder: Existing folder; figures of the same names are replaced.
        name: What the figures call the estimate.
        suffix: Added to the files' names, to tell several estimates apart.

    Returns:
        The files that were written.
    """
    if consistency.covariances is None:
        return []
    (short,) = canvas.short_names([name])
    figures = {"consistency": bands_over_time, "uncertainty_top": ellipses_from_above}
    with canvas.house_style():
        return [
            canvas.save(draw(evaluation, consistency, short), folder / f"{file}{suffix}.png")
            for file, draw in figures.items()
        ]


def bands_over_time(evaluation: Evaluation, consistency: Consistency, name: str) -> Figure:
    """Draw the errors of each axis with +-3 sigma, and the NEES of each pose."""
    truth = evaluation.association.groundtruth
    max_gap_s = evaluation.protocol.association.max_gap_s
    units = np.repeat([1.0, 180.0 / np.pi], 3)
    assert consistency.sigmas is not None
    errors, limits = consistency.errors * units, _SIGMAS * consistency.sigmas * units
    figure = canvas.new_figure(_WIDTH_IN, 7.4, layout="constrained")
    figure.suptitle(
        f"{name}: {consistency.verdict}, gauge {consistency.gauge.value}, covariances of "
        f"{consistency.covariance_source} ({consistency.exactness})"
    )
    *panels, lowest = figure.subplots(7, 1, sharex=True)
    columns = np.concatenate([truth.seconds[:, None] - truth.seconds[0], errors, limits], axis=1)
    rows = canvas.thinned(columns, truth.stamps, max_gap_s)
    time = rows[:, 0]
    for axis, (axes, label) in enumerate(zip(panels, _LABELS, strict=True)):
        limit = rows[:, 7 + axis]
        axes.fill_between(time, -limit, limit, color=canvas.tint(canvas.COLOURS[0]), linewidth=0)
        axes.plot(time, rows[:, 1 + axis], color=canvas.COLOURS[1], linewidth=0.9)
        axes.set_ylabel(label)
    _draw_nees(lowest, evaluation, consistency)
    lowest.set_xlabel("time [s]; bands are 3 sigma, errors are estimate less groundtruth")
    return figure


def _draw_nees(lowest: Axes, evaluation: Evaluation, consistency: Consistency) -> None:
    truth = evaluation.association.groundtruth
    nees, per_pose = consistency.pose_nees, consistency.per_pose
    assert nees is not None
    assert per_pose is not None
    gap_s = evaluation.protocol.association.max_gap_s
    for values, label, colour in (
        (nees.rotation, "orientation / 3", canvas.COLOURS[2]),
        (nees.position, "position / 3", canvas.COLOURS[3]),
        (nees.pose, "pose / 6", canvas.COLOURS[0]),
    ):
        columns = np.stack([truth.seconds - truth.seconds[0], values], axis=1)
        across = canvas.thinned(columns, truth.stamps, gap_s).T
        lowest.plot(*across, color=colour, label=label, linewidth=0.9)
    lowest.legend(loc="upper right", fontsize=7, ncols=3)
    highest = float(max(np.nanmax(each) for each in (nees.pose, nees.position, nees.rotation)))
    limit = per_pose.limit_95
    lowest.set_ylim(0.0, 1.25 * max(limit or 0.0, highest))
    lowest.set_ylabel("NEES / dof")
    if limit is None:
        return
    lowest.axhline(limit, color=canvas.COLOURS[1], linestyle="--", linewidth=0.9)
    lowest.annotate(
        "NEES / 6: 95 % of honest runs stay below",
        (0.01, limit),
        xycoords=("axes fraction", "data"),
        xytext=(0, 2),
        textcoords="offset points",
        fontsize=7,
        color="0.35",
    )


def ellipses_from_above(evaluation: Evaluation, consistency: Consistency, name: str) -> Figure:
    """Draw the uncertainty of positions along the aligned estimate, enlarged and said so."""
    from matplotlib.collections import EllipseCollection

    assert consistency.covariances is not None
    truth, aligned = evaluation.association.groundtruth, evaluation.aligned
    max_gap_s = evaluation.protocol.association.max_gap_s
    extent = float(np.ptp(truth.positions[:, :2], axis=0).max())
    along = truth.travelled
    evenly = np.searchsorted(along, np.linspace(0.0, along[-1], _ELLIPSES))
    rows = np.unique(np.minimum(evenly, len(along) - 1))
    values, vectors = np.linalg.eigh(consistency.covariances[rows, :2, :2])
    # Full axes of the ellipses, metres.
    axes_m = 2.0 * _SIGMAS * np.sqrt(np.maximum(values, 0.0))
    largest = max(float(axes_m.max()), 1e-12)
    factor = max(1.0, round_below(_LARGEST_ELLIPSE * extent / largest))
    figure = canvas.new_figure(_WIDTH_IN, 5.0, layout="constrained")
    axes = figure.subplots()
    for trajectory, colour, width, label in (
        (truth, canvas.GROUNDTRUTH_COLOUR, 1.6, "groundtruth"),
        (aligned, canvas.COLOURS[0], 1.0, name),
    ):
        axes.plot(
            *canvas.thinned(trajectory.positions[:, :2], trajectory.stamps, max_gap_s).T,
            color=colour,
            linewidth=width,
            label=label,
        )
    turned = np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))
    axes.add_collection(
        EllipseCollection(
            factor * axes_m[:, 1],
            factor * axes_m[:, 0],
            turned,
            units="xy",
            offsets=aligned.positions[rows, :2],
            offset_transform=axes.transData,
            facecolors="none",
            edgecolors=canvas.COLOURS[1],
            linewidths=0.9,
        )
    )
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    canvas.head(
        axes,
        _WIDTH_IN,
        f"Ellipses of 3 sigma, {factor:g} times enlarged, gauge {consistency.gauge.value} "
        f"({consistency.exactness})",
    )
    return figure
