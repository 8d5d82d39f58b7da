"""Errors and their uncertainty: over time, and as ellipses seen from above."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.consistency.consistency_result import Consistency
from trajeval_ros.consistency.integrity import Integrity, PartIntegrity
from trajeval_ros.formatting.numbers import percent
from trajeval_ros.geometry.arrays import extents
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.statistics import round_below
from trajeval_ros.report import canvas
from trajeval_ros.report.line_thinning import thinned
from trajeval_ros.report.plane_panels import PlanePanels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ELLIPSES = 24
_SIGMAS = 3.0
# Ellipses are enlarged until the largest is this share of the trajectory's extent.
_LARGEST_ELLIPSE = 0.06
_LABELS = ("x [m]", "y [m]", "z [m]", "φx [deg]", "φy [deg]", "φz [deg]")
_LABELS_IN = 0.3
_CELLS = 60


def consistency_drawings(
    evaluation: Evaluation, consistency: Consistency, name: str, suffix: str = ""
) -> dict[str, canvas.Drawing]:
    """Return what draws `consistency` and `uncertainty_top`; nothing without covariances."""
    if consistency.covariances is None:
        return {}
    (short,) = canvas.short_names([name])
    drawings = {"consistency": bands_over_time, "uncertainty_top": ellipses_from_above}
    return {
        f"{file}{suffix}": partial(draw, evaluation, consistency, short)
        for file, draw in drawings.items()
    }


def bands_over_time(evaluation: Evaluation, consistency: Consistency, name: str) -> Figure:
    """Draw the errors along every axis with +-3 sigma, and the NEES of every pose."""
    groundtruth = evaluation.association.groundtruth
    is_gap = evaluation.protocol.association.is_gap
    units = np.repeat([1.0, 180.0 / np.pi], 3)
    assert consistency.sigmas is not None
    errors, limits = consistency.errors * units, _SIGMAS * consistency.sigmas * units
    colour, _ = canvas.line_style(0)
    ground, _ = canvas.line_style(1)
    figure = canvas.new_figure(
        7.2,
        f"{name}: {consistency.verdict}, gauge {consistency.gauge.value}, covariances of "
        f"{consistency.covariance_source} ({consistency.exactness})\nbands: 3 sigma; lines: "
        "estimate minus groundtruth",
    )
    *panels, lowest = figure.subplots(7, 1, sharex=True)
    columns = np.concatenate(
        [groundtruth.seconds[:, None] - groundtruth.seconds[0], errors, limits], axis=1
    )
    rows = thinned(columns, groundtruth.stamps, is_gap)
    time = rows[:, 0]
    for axis, (axes, label) in enumerate(zip(panels, _LABELS, strict=True)):
        limit = rows[:, 7 + axis]
        axes.fill_between(time, -limit, limit, color=canvas.tint(ground), linewidth=0)
        axes.plot(time, rows[:, 1 + axis], color=colour, linewidth=0.9)
        axes.set_ylabel(label)
    _draw_nees(lowest, evaluation, consistency)
    lowest.set_xlabel("time [s]")
    figure.align_ylabels()
    return figure


def _draw_nees(lowest: Axes, evaluation: Evaluation, consistency: Consistency) -> None:
    """Draw the NEES of poses, positions and orientations over time."""
    groundtruth = evaluation.association.groundtruth
    nees, per_pose = consistency.pose_nees, consistency.per_pose
    assert nees is not None
    assert per_pose is not None
    is_gap = evaluation.protocol.association.is_gap
    moved, rotation_axes = consistency.axes
    for values, label, place in (
        (nees.rotation, f"orientation / {rotation_axes}", 2),
        (nees.position, f"position / {moved}", 3),
        (nees.pose, f"pose / {moved + rotation_axes}", 0),
    ):
        colour, _ = canvas.line_style(place)
        columns = np.stack([groundtruth.seconds - groundtruth.seconds[0], values], axis=1)
        across = thinned(columns, groundtruth.stamps, is_gap).T
        lowest.plot(*across, color=colour, label=label, linewidth=0.9)
    highest = float(max(map(np.nanmax, (nees.pose, nees.position, nees.rotation))))
    limit = per_pose.limit_95
    lowest.set_ylim(0.0, 1.25 * max(limit or 0.0, highest))
    lowest.set_ylabel("NEES / dof")
    if limit is not None:
        lowest.axhline(
            limit, color=canvas.text_color(), linestyle="--", linewidth=0.9,
            label=f"pose / {moved + rotation_axes}: 95 % of consistent runs stay below",
        )  # fmt: skip
    canvas.legend_above(lowest)


def ellipses_from_above(evaluation: Evaluation, consistency: Consistency, name: str) -> Figure:
    """Draw position uncertainties along the aligned estimate; the title has the enlargement."""
    from matplotlib.collections import EllipseCollection

    assert consistency.covariances is not None
    groundtruth, aligned = evaluation.association.groundtruth, evaluation.aligned
    is_gap = evaluation.protocol.association.is_gap
    extent = float(extents(groundtruth.positions[:, :2]).max())
    along = groundtruth.travelled
    evenly = np.searchsorted(along, np.linspace(0.0, along[-1], _ELLIPSES))
    rows = np.unique(np.minimum(evenly, len(along) - 1))
    values, vectors = np.linalg.eigh(consistency.covariances[rows, :2, :2])
    # Full axes of the ellipses, metres.
    axes_m = 2.0 * _SIGMAS * np.sqrt(np.maximum(values, 0.0))
    largest = max(float(axes_m.max()), 1e-12)
    factor = max(1.0, round_below(_LARGEST_ELLIPSE * extent / largest))
    whole = groundtruth.positions[:, :2]
    panels = PlanePanels(
        [whole, aligned.positions[:, :2]],
        {0: name},
        f"3 sigma ellipses, enlarged {factor:g} times, gauge {consistency.gauge.value} "
        f"({consistency.exactness})",
    )
    axes = panels.of(0)
    panels.draw_path(0, thinned(aligned.positions[:, :2], aligned.stamps, is_gap))
    angles_deg = np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))
    edge, _ = canvas.line_style(1)
    axes.add_collection(
        EllipseCollection(
            factor * axes_m[:, 1],
            factor * axes_m[:, 0],
            angles_deg,
            units="xy",
            offsets=aligned.positions[rows, :2],
            offset_transform=axes.transData,
            facecolors="none",
            edgecolors=edge,
            linewidths=0.9,
        )
    )
    return panels.finish(thinned(whole, groundtruth.stamps, is_gap), whole, ("x", "y"))


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
    axes.plot([low, high], [low, high], color=canvas.text_color(), linewidth=0.8)
    for draw in (axes.axhline, axes.axvline):
        draw(limit, color=canvas.text_color(), linewidth=0.8, linestyle="--")
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
