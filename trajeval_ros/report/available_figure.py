"""Errors as evaluated and as available over time, the age of the pose in use, and latencies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.formatting.numbers import significant
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.as_available import AsAvailable
from trajeval_ros.metrics.availability import AvailableSamples
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.report import canvas
from trajeval_ros.report.definitions import alignment_of
from trajeval_ros.report.line_thinning import thinned

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HEIGHT_IN, _DETAIL_S = 3.7, 10.0
_EVALUATED, _AVAILABLE = 2, 0  # places of their colours
_BINS = 30


def as_available_figure(evaluation: Evaluation, availability: AsAvailable) -> Figure:
    """Draw the whole run, 10 s around the largest difference, ages, and latencies."""
    numbers, samples, latency = (
        availability.numbers,
        availability.samples,
        availability.numbers.latency_s,
    )
    assert samples is not None
    assert latency is not None
    name = evaluation.estimate.name or "estimate"
    figure = canvas.new_figure(
        _HEIGHT_IN, f"{name}: error of the newest received pose\n{alignment_of([evaluation])}"
    )
    grid = figure.add_gridspec(2, 2, width_ratios=(2.2, 1.0))
    upper, detail, lower, right = (
        figure.add_subplot(grid[row, column]) for row in (0, 1) for column in (0, 1)
    )
    begin = int(samples.stamps[0])
    is_gap = evaluation.protocol.association.is_gap
    pairs = evaluation.association.groundtruth.stamps
    lines = (
        (pairs, evaluation.absolute.position_m, _EVALUATED, "at timestamps"),
        (samples.stamps, samples.position_m, _AVAILABLE, "as available"),
    )
    seconds = (samples.stamps - begin) / NANOSECONDS
    middle = seconds[samples.moved_m.argmax()]
    for stamps, values, place, label in lines:
        columns = np.stack([(stamps - begin) / NANOSECONDS, values], axis=1)
        colour, _ = canvas.line_style(place)
        words = f"{label}, RMSE {significant(np.sqrt(np.mean(values**2)), 3)} m"
        upper.plot(*thinned(columns, stamps, is_gap).T, color=colour, linewidth=0.9, label=words)
        near = np.abs(columns[:, 0] - middle) <= _DETAIL_S / 2
        detail.plot(*columns[near].T, color=colour, linewidth=0.9)
    upper.set_ylabel("position error [m]")
    detail.set_title("10 s around the largest age error", loc="left")
    _draw_ages(lower, seconds, samples, numbers.deadline_s)
    colour, _ = canvas.line_style(_AVAILABLE)
    latencies_s = (samples.messages.times - samples.messages.stamps) / NANOSECONDS
    right.hist(latencies_s, _BINS, color=canvas.tint(colour), edgecolor=colour, linewidth=0.5)
    for value, dashes in ((latency.median, "-"), (latency.p95, "--")):
        right.axvline(value, color=canvas.text_color(), linestyle=dashes, linewidth=0.9)
    median, p95 = significant(latency.median, 3), significant(latency.p95, 3)
    right.set_title(f"median {median} s, 95 % {p95} s", loc="left")
    right.set_xlabel("latency [s]")
    right.set_ylabel("messages")
    for axes in (upper, detail, lower):
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("time [s]")
    for axes in (upper, lower):
        axes.set_xlim(0.0, float(seconds[-1]))
    canvas.grow(figure, canvas.legend_above(upper))
    return figure


def _draw_ages(axes: Axes, seconds: Floats, samples: AvailableSamples, deadline_s: float) -> None:
    """Draw the age of the pose in use and the deadline; shade dropouts."""
    colour, _ = canvas.line_style(_AVAILABLE)
    age_s = samples.age / NANOSECONDS
    axes.plot(seconds, age_s, color=colour, linewidth=0.7)
    axes.fill_between(
        seconds, 0.0, age_s, where=samples.ages[1] > 0, color=canvas.soft_ink(), alpha=0.5, lw=0
    )
    axes.axhline(deadline_s, color=canvas.text_color(), linewidth=0.8, linestyle=":")
    axes.set_ylabel("age [s]")
    axes.set_title(f"dotted: deadline {deadline_s:g} s; grey: dropouts", loc="left")
