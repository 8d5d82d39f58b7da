"""Figures 4 to 7 and 9 to 11 of the gauge paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.formatting.escaping import one_line
from trajeval_ros.formatting.numbers import one_digit
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.report import canvas
from trajeval_ros.visual_inertial.solver import GaugeHandling, Trace
from trajeval_ros.visual_inertial.study import Covariances, Trials

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
                places + (shift - 1) * width,
                heights,
                width,
                color=colour,
                label=handling.value,
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
