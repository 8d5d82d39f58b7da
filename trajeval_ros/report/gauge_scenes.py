"""Figures 1 and 3 of the gauge paper: an estimate in two gauges, and the scenes, from above."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.report import canvas
from trajeval_ros.visual_inertial.state import State
from trajeval_ros.visual_inertial.study import Covariances

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PANEL_IN, _NARROWEST_IN = 2.4, 1.7
_LARGEST_SHARE = 0.25  # drawn size of the largest ellipse relative to the path's extent
_FACTORS = (1, 2, 3, 5, 8)
_FARTHEST_PERCENTILE = 98.0  # of landmarks; farther ones are omitted to keep the scale


def gauges(covariances: Covariances, state: State, title: str) -> Figure:
    """Draw the ellipses of positions with a free gauge and with gauge fixation: Fig. 1.

    Args:
        covariances: Covariances of the motion.
        state: The keyframes.
        title: Title of the figure.
    """
    ellipses = {
        "free gauge": _ellipses(covariances.free),
        "gauge fixation": _ellipses(covariances.fixed),
    }
    extent_m = float(np.ptp(state.positions[:, :2], axis=0).max())
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
