"""Figures 1, 3 to 7 and 9 to 11 of the gauge paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.formatting.numbers import one_digit
from trajeval_ros.geometry.arrays import Floats, extents
from trajeval_ros.papers.gauge_trials import Covariances, Trials
from trajeval_ros.papers.solver import GaugeHandling, Trace
from trajeval_ros.papers.state import State
from trajeval_ros.report import canvas

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_FLOOR = 1e-7  # the paper's epsilon; smaller values are white


def prior_weight(weights: Sequence[float], outcome: Sequence[Trials], title: str) -> Figure:
    """Draw errors, iterations and time over the weight of the prior: Fig. 4 and 5."""
    panels = {
        "p [m]": [trials.position_m.mean() for trials in outcome],
        "φ [deg]": [trials.rotation_deg.mean() for trials in outcome],
        "v [m/s]": [trials.velocity_mps.mean() for trials in outcome],
        "iterations": [trials.iterations.mean() for trials in outcome],
        "time [ms]": [1e3 * np.median(trials.seconds) for trials in outcome],
    }
    figure = canvas.new_figure(6.0, title)
    colour, _ = canvas.line_style(0)
    all_axes = figure.subplots(len(panels), 1, sharex=True)
    for axes, (label, values) in zip(all_axes, panels.items(), strict=True):
        axes.plot(weights, values, color=colour, marker="o", markersize=3)
        axes.set_ylabel(label)
        axes.ticklabel_format(axis="y", useOffset=False)
        # Errors differ in the last digits; automatic limits would magnify these.
        middle = float(np.median(values))
        if label not in ("iterations", "time [ms]"):
            low, high = min(values), max(values)
            margin = max(0.02 * middle, high - low)
            axes.set_ylim(middle - 1.5 * margin, middle + 1.5 * margin)
        else:
            axes.set_ylim(0.0, 1.15 * max(values))
    axes = all_axes[-1]
    axes.set_xscale("symlog", linthresh=1.0, linscale=0.5)
    axes.set_xticks([0.0, *(10.0**power for power in range(9))])
    axes.set_xlim(-0.1, 2.0 * max(weights))
    axes.xaxis.set_major_formatter(lambda weight, _: one_digit(weight))
    axes.set_xlabel("prior weight (0: free gauge, infinity: gauge fixation)")
    return figure


def prior_paths(weights: Sequence[float], traces: Sequence[Trace], title: str) -> Figure:
    """Draw reprojection error and the prior's error over the iterations: the data of Fig. 6.

    The paper draws one over the other, so that all iterations of a weak prior after the second are
    on one vertical line. Here every weight has a column with equal scales, and the other weights
    in grey.
    """
    panels = {
        "reprojection_px": "reprojection\nerror [px]",
        "position_m": "prior's error,\nposition [m]",
        "yaw_deg": "prior's error,\nyaw [deg]",
    }
    figure = canvas.new_figure(4.2, title)
    grid = figure.subplots(len(panels), len(weights), sharex=True, sharey="row")
    for row, (metric, label) in zip(grid, panels.items(), strict=True):
        for place, (axes, trace) in enumerate(zip(row, traces, strict=True)):
            for other in traces:
                axes.plot(getattr(other, metric), color=canvas.soft_ink(), alpha=0.4, lw=0.5)
            colour, _ = canvas.line_style(0)
            axes.plot(getattr(trace, metric), color=colour, marker="o", markersize=2.5)
            if metric == "reprojection_px":
                axes.set_yscale("log")
                axes.set_title(f"w = {one_digit(weights[place])}")
            else:
                axes.set_ylim(bottom=0.0)
        row[0].set_ylabel(label)
    grid[0, 0].yaxis.set_major_formatter(_plainly)
    grid[0, 0].yaxis.set_minor_formatter("")
    grid[0, 0].xaxis.get_major_locator().set_params(integer=True)
    figure.supxlabel("accepted iterations", fontsize="medium")
    figure.align_ylabels()
    return figure


def cost(outcome: Mapping[str, Mapping[GaugeHandling, Trials]], title: str) -> Figure:
    """Draw iterations, time, and time per iteration relative to fixation: Fig. 7 and 11."""
    figure = canvas.new_figure(5.0, title)
    panels = figure.subplots(3, 1, sharex=True)
    places = np.arange(len(outcome))
    width = 0.26
    for shift, handling in enumerate(GaugeHandling):
        trials = [result[handling] for result in outcome.values()]
        fixed = [result[GaugeHandling.FIXATION] for result in outcome.values()]
        values = (
            [result.iterations.mean() for result in trials],
            [1e3 * np.median(result.seconds) for result in trials],
            [
                result.seconds_per_iteration / of_fixed.seconds_per_iteration
                for result, of_fixed in zip(trials, fixed, strict=True)
            ],
        )
        colour, _ = canvas.line_style(shift)
        for axes, heights in zip(panels, values, strict=True):
            # Times of simulated and measured scenes differ by a factor of ten: points on a
            # logarithmic scale, since bars need a zero.
            if axes is panels[1]:
                axes.plot(
                    places + (shift - 1) * width,
                    heights,
                    color=colour,
                    marker="o",
                    linestyle="none",
                )
                continue
            axes.bar(
                places + (shift - 1) * width, heights, width, color=colour, label=handling.value
            )
    panels[1].set_yscale("log")
    panels[1].yaxis.get_major_locator().set_params(subs=(1.0, 2.0, 5.0))
    panels[1].yaxis.get_minor_locator().set_params(subs=())
    panels[1].yaxis.set_major_formatter(_plainly)
    for axes, label in zip(
        panels, ("iterations", "time [ms]", "time per iteration\n/ gauge fixation"), strict=True
    ):
        axes.set_ylabel(label)
        axes.grid(visible=False, axis="x")
    panels[-1].set_xticks(places, [one_line(name) for name in outcome], rotation=20, ha="right")
    canvas.legend_below(figure, *panels[0].get_legend_handles_labels())
    figure.align_ylabels()
    return figure


def covariance_matrices(covariances: Covariances, title: str) -> Figure:
    """Draw the covariances of free gauge, transformed and fixed: Fig. 9 and 10."""
    percent = 100.0 * covariances.difference
    figure = canvas.new_figure(
        0.27 * canvas.width_in() + 0.7,
        f"{one_line(title)}: difference of transformed and fixed {percent:.2g} % (Frobenius norm)",
    )
    panels = figure.subplots(1, 3)
    named = (
        ("free gauge", covariances.free),
        ("free gauge, transformed", covariances.transformed),
        ("gauge fixation", covariances.fixed),
    )
    images = [_by_kind(matrix) for _, matrix in named]
    largest = max(float(image.max()) for image in images)
    for axes, (label, _), image in zip(panels, named, images, strict=True):
        drawn = axes.imshow(image, vmin=np.log10(_FLOOR), vmax=largest, interpolation="nearest")
        _mark_kinds(axes, len(image))
        axes.set_title(canvas.wrapped(label, canvas.width_in() / 3.0))
    figure.colorbar(drawn, ax=list(panels), shrink=0.7, label="log10 |covariance|")
    return figure


def _plainly(value: float, _: object = None) -> str:
    """Return a tick label as plain text; the default style renders no mathematics."""
    return f"{value:g}"


def _by_kind(matrix: Floats) -> Floats:
    """Return log10 of the entries in the paper's order: all positions, rotations, velocities."""
    order = np.arange(len(matrix)).reshape(-1, 3, 3).transpose(1, 0, 2).ravel()
    logarithm: Floats = np.log10(np.abs(matrix[np.ix_(order, order)]) + _FLOOR)
    return logarithm


def _mark_kinds(axes: Axes, size: int) -> None:
    """Label the blocks of positions, rotations and velocities in a matrix."""
    third = size / 3.0
    middles = [third * (place + 0.5) - 0.5 for place in range(3)]
    axes.set_xticks(middles, ["p", "φ", "v"])
    axes.set_yticks(middles, ["p", "φ", "v"])
    axes.grid(visible=False)
    for place in (1, 2):
        axes.axhline(place * third - 0.5, color=canvas.paper(), linewidth=0.5)
        axes.axvline(place * third - 0.5, color=canvas.paper(), linewidth=0.5)


_PANEL_IN, _NARROWEST_IN = 2.4, 1.7
_LARGEST_SHARE = 0.25  # drawn size of the largest ellipse relative to the path's extent
_FACTORS = (1, 2, 3, 5, 8)
_FARTHEST_PERCENTILE = 98.0  # of landmarks; farther ones are omitted to keep the scale


def gauges(covariances: Covariances, state: State, title: str) -> Figure:
    """Draw the ellipses of positions with a free gauge and with gauge fixation: Fig. 1."""
    ellipses = {
        "free gauge": _ellipses(covariances.free),
        "gauge fixation": _ellipses(covariances.fixed),
    }
    extent_m = float(extents(state.positions[:, :2]).max())
    largest_m = max(float(np.abs(outline).max()) for outline in ellipses.values())
    factor = _readable(_LARGEST_SHARE * extent_m / largest_m)
    shape = float(np.ptp(state.positions[:, 1])) / max(extent_m, 1e-9)
    figure = canvas.new_figure(
        0.5 * canvas.width_in() * min(shape + 2.5 * _LARGEST_SHARE, 1.2) + 0.4,
        f"{title}: position, {factor:g} σ, from above",
    )
    colour, _ = canvas.line_style(1)
    mark, _ = canvas.line_style(0)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, (name, outlines) in zip(panels, ellipses.items(), strict=True):
        axes.plot(*state.positions[:, :2].T, color=canvas.soft_ink(), marker="o", markersize=2.5)
        for centre, outline in zip(state.positions[:, :2], outlines, strict=True):
            axes.plot(*(centre[:, None] + factor * outline), color=colour, alpha=0.6)
        axes.plot(*state.positions[0, :2], color=mark, marker="s", markersize=5)
        axes.set_title(name)
        # Equal scales, because the ellipses are compared.
        _from_above(axes, "box")
    return figure


def scenes(states: Mapping[str, State]) -> Figure:
    """Draw keyframes and landmarks of the configurations: Fig. 3."""
    columns = canvas.columns_of_panels(min(3, len(states)), _NARROWEST_IN)
    rows = -(-len(states) // columns)
    figure = canvas.new_figure(rows * _PANEL_IN)
    colour, _ = canvas.line_style(1)
    mark, _ = canvas.line_style(0)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, (name, state) in zip(panels, states.items(), strict=False):
        middle = state.positions[:, :2].mean(axis=0)
        away = np.linalg.norm(state.landmarks[:, :2] - middle, axis=1)
        near = state.landmarks[away <= np.percentile(away, _FARTHEST_PERCENTILE)]
        axes.scatter(*near[:, :2].T, s=3, color=canvas.soft_ink(), alpha=0.5, linewidths=0)
        axes.plot(*state.positions[:, :2].T, color=colour, marker="o", markersize=2)
        axes.plot(*state.positions[0, :2], color=mark, marker="s", markersize=4)
        axes.set_title(name)
        _from_above(axes, "datalim")
    for axes in panels[len(states) :]:
        axes.set_visible(False)
    return figure


def _from_above(axes: Axes, adjustable: Literal["box", "datalim"]) -> None:
    """Set equal scales and label the axes x and y."""
    axes.set_aspect("equal", adjustable=adjustable)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def _ellipses(covariance: Floats) -> Floats:
    """Return the outlines (N, 2, points) of one standard deviation in x and y, metres."""
    count = len(covariance) // 9
    keyframes = np.arange(count)
    blocks = covariance.reshape(count, 9, count, 9)[keyframes, :2, keyframes, :2]
    variances, axes = np.linalg.eigh(blocks)
    roots = axes * np.sqrt(np.maximum(variances, 0.0))[:, None, :]
    angles = np.linspace(0.0, 2.0 * np.pi, 65)
    outlines: Floats = roots @ np.stack([np.cos(angles), np.sin(angles)])
    return outlines


def _readable(factor: float) -> float:
    """Return the largest 1, 2, 3, 5 or 8 times a power of ten that is at most `factor`."""
    power = 10.0 ** np.floor(np.log10(factor))
    return float(max(step for step in _FACTORS if step * power <= factor) * power)
