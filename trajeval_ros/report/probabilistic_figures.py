"""Uncertainty of the groundtruth between samples, and likelihoods over time: Fig. 3."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.covariance_frames import world_from_body_twists
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.report import canvas
from trajeval_ros.report.line_thinning import thinned

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from trajeval_ros.likelihood.likelihood_assessment import LikelihoodAssessment


_SIGMAS = 2.0
# Time around the longest gap; over minutes the bands are too narrow to see.
_SHOWN_S = 20.0
_QUERIES = 2000
_LABELS = ("x [m]", "y [m]", "z [m]")


def probabilistic_drawings(
    assessments: Sequence[LikelihoodAssessment], names: Sequence[str]
) -> dict[str, canvas.Drawing]:
    """Return what draws `groundtruth_uncertainty`, `mahalanobis` and `likelihood_by_edge`."""
    legend = canvas.short_names(names)
    drawings: dict[str, canvas.Drawing] = {
        "groundtruth_uncertainty": partial(groundtruth_between_samples, assessments[0]),
        "mahalanobis": partial(mahalanobis_over_time, assessments, legend),
    }
    if any(assessment.edges is not None for assessment in assessments):
        drawings["likelihood_by_edge"] = partial(likelihood_by_edge, assessments, legend)
    return drawings


def groundtruth_between_samples(assessment: LikelihoodAssessment) -> Figure:
    """Draw positions with +-2 sigma around the longest gap between samples."""
    continuous = assessment.continuous
    samples = continuous.samples
    longest = int(np.argmax(np.diff(samples.times)))
    middle = 0.5 * float(samples.times[longest] + samples.times[longest + 1])
    begin = max(samples.times[0], middle - 0.5 * _SHOWN_S)
    end = min(samples.times[-1], middle + 0.5 * _SHOWN_S)
    times = np.linspace(begin, end, _QUERIES)
    belief = continuous.poses.at(times)
    covariances = world_from_body_twists(belief.covariances, belief.poses[:, :3, :3])
    sigmas = np.sqrt(np.einsum("nii->ni", covariances)[:, :3])
    shown = (samples.times >= begin) & (samples.times <= end)
    figure = canvas.new_figure(
        4.6,
        f"Groundtruth, model {continuous.model}: mean, ±{_SIGMAS:g} sigma, and samples about the "
        "longest gap",
    )
    colour, _ = canvas.line_style(1)
    panels = figure.subplots(3, 1, sharex=True)
    for axis, (axes, label) in enumerate(zip(panels, _LABELS, strict=True)):
        mean, reach = belief.poses[:, axis, 3], _SIGMAS * sigmas[:, axis]
        axes.fill_between(times, mean - reach, mean + reach, color=canvas.tint(colour), lw=0)
        axes.plot(times, mean, color=colour)
        axes.plot(
            samples.times[shown],
            samples.poses[shown, axis, 3],
            linestyle="none",
            marker=".",
            markersize=3,
            color=canvas.groundtruth_colour(),
        )
        axes.set_ylabel(label)
    panels[-1].set_xlabel("time since the first groundtruth sample [s]")
    figure.align_ylabels()
    return figure


def mahalanobis_over_time(
    assessments: Sequence[LikelihoodAssessment], names: Sequence[str]
) -> Figure:
    """Draw the squared Mahalanobis distance of every aligned pose per degree of freedom."""
    figure = canvas.new_figure(2.7, "1: error as expected from the groundtruth's uncertainty")
    axes = figure.subplots()
    origin = assessments[0].continuous.samples.origin
    for place, (assessment, name) in enumerate(zip(assessments, names, strict=True)):
        values = assessment.error.mahalanobis2 / assessment.error.residuals.axes
        label = f"{name}, chi2/dof {assessment.error.chi2_per_dof:.3g}"
        _draw_over_time(axes, place, assessment.stamps, values, origin, label)
    axes.axhline(1.0, color=canvas.text_color(), linewidth=0.8, linestyle="--")
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_ylabel("squared Mahalanobis / dof")
    axes.set_xlabel("time since the first groundtruth sample [s]")
    canvas.grow(figure, canvas.legend_above(axes))
    return figure


def _draw_over_time(
    axes: Axes, place: int, stamps: Stamps, values: Floats, origin: int, label: str
) -> None:
    """Draw values (N,) of an estimate, by its place, over the time since an origin, ns."""
    colour, dashes = canvas.line_style(place)
    columns = np.stack([(stamps - origin) / NANOSECONDS, values], axis=1)
    rows = thinned(columns, stamps, lambda steps: steps < 0)
    axes.plot(*rows.T, color=colour, linestyle=dashes, linewidth=0.9, label=label)


def likelihood_by_edge(
    assessments: Sequence[LikelihoodAssessment], names: Sequence[str]
) -> Figure:
    """Draw minus the log density of every edge, given the previous edges, over time."""
    figure = canvas.new_figure(2.7, "Likelihood by edge, given all previous edges")
    axes = figure.subplots()
    origin = assessments[0].continuous.samples.origin
    for place, (assessment, name) in enumerate(zip(assessments, names, strict=True)):
        if assessment.edges is None:
            continue
        values = -assessment.edges.edges
        _draw_over_time(axes, place, assessment.stamps[1:], values, origin, name)
    axes.set_yscale("symlog", linthresh=10.0)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_ylabel("-log likelihood of edge [nats]")
    axes.set_xlabel("time since the first groundtruth sample [s]")
    canvas.grow(figure, canvas.legend_above(axes))
    return figure
