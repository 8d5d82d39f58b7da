"""Aligned trajectories from above and from the side, with GNSS fixes: Fig. 6 of the tutorial."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.formatting.palette import FIX_STATUS_PLACES
from trajeval_ros.geometry.arrays import Floats, extents
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.premises import Premise
from trajeval_ros.report import canvas
from trajeval_ros.report.definitions import alignment_of
from trajeval_ros.report.line_thinning import thinned
from trajeval_ros.report.plane_panels import PlanePanels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CORRESPONDENCES = 100
_STATUS = {0: "GNSS alone", 1: "satellite-based", 2: "ground-based"}  # sensor_msgs/NavSatStatus
_SIGMAS = 2.4477468306808166  # 95 % in two dimensions
_MOST_ELLIPSES = 300
_DOT_POINTS, _BELOW_GROUNDTRUTH = 3.5, 1.7


def top_view(evaluations: Sequence[Evaluation], names: Sequence[str]) -> Figure:
    """Draw estimates and groundtruth in the horizontal plane."""
    return _view(evaluations, names, (0, 1), "Top view")


def side_view(evaluations: Sequence[Evaluation], names: Sequence[str]) -> Figure:
    """Draw estimates and groundtruth with height over the longer horizontal axis."""
    groundtruth = evaluations[0].groundtruth
    extent = extents(groundtruth.up.to_z_up(groundtruth.positions))
    return _view(evaluations, names, (1 if extent[1] > extent[0] else 0, 2), "Side view")


def _view(
    evaluations: Sequence[Evaluation], names: Sequence[str], plane: tuple[int, int], title: str
) -> Figure:
    """Draw estimates and groundtruth in a plane; axes 0 and 1 are horizontal, 2 is height.

    If the vertical axis is doubted, the title names only the axes.
    """
    first = evaluations[0]
    groundtruth, upward = first.groundtruth, first.groundtruth.up
    is_gap = first.protocol.association.is_gap
    across, up = axis_names(upward, plane)
    if any(Premise.UP_AXIS in evaluation.doubts.reasons for evaluation in evaluations):
        title = "Paths"
    shown_up = up.replace("-", "\N{MINUS SIGN}")
    aligned = [_seen(e.aligned, upward, plane) for e in evaluations]
    whole = _seen(groundtruth, upward, plane)
    panels = PlanePanels(
        [whole, *aligned],
        dict(enumerate(names)),
        f"{title} ({across}, {shown_up})\n{alignment_of(evaluations)}",
    )
    line = thinned(whole, groundtruth.stamps, is_gap)
    for place, (evaluation, path) in enumerate(zip(evaluations, aligned, strict=True)):
        groundtruth_pairs = evaluation.association.groundtruth
        _draw_correspondences(
            panels.of(place),
            _seen(groundtruth_pairs, upward, plane),
            path,
            groundtruth_pairs.travelled,
            "correspondences" if place == 0 else "_",  # one entry of the legend for all
        )
        panels.draw_path(place, thinned(path, evaluation.aligned.stamps, is_gap))
    for axes in panels.panels:
        draw_fixes(axes, groundtruth, whole, plane)
    matched = _seen(first.association.groundtruth, upward, plane)
    return panels.finish(line, matched, (across, up))


def axis_names(upward: UpAxis, plane: tuple[int, int]) -> tuple[str, str]:
    """Return the names of a plane's axes; axes 0 and 1 are horizontal, 2 is height."""
    names = [*("xyz"[axis] for axis in upward.level), upward.name]
    return names[plane[0]], names[plane[1]]


def _seen(trajectory: Trajectory, upward: UpAxis, plane: tuple[int, int]) -> Floats:
    """Return positions in a plane, (N, 2), metres."""
    seen: Floats = upward.to_z_up(trajectory.positions)[:, plane]
    return seen


def _draw_correspondences(
    axes: Axes, groundtruth: Floats, aligned: Floats, along: Floats, label: str
) -> None:
    """Connect a hundred states, evenly spaced along the path, with their groundtruth."""
    from matplotlib.collections import LineCollection

    evenly = np.searchsorted(along, np.linspace(0.0, along[-1], _CORRESPONDENCES))
    rows = np.unique(np.minimum(evenly, len(along) - 1))
    lines = LineCollection(
        list(np.stack([groundtruth[rows], aligned[rows]], axis=1)),
        colors=canvas.soft_ink(),
        alpha=0.6,
        linewidths=0.6,
        zorder=1.5,
        label=label,
    )
    axes.add_collection(lines, autolim=False)


def draw_fixes(axes: Axes, groundtruth: Trajectory, seen: Floats, plane: tuple[int, int]) -> None:
    """Draw the GNSS fixes of a groundtruth; nothing if it has none.

    `groundtruth`: N states, in a frame with z up. `seen`: (N, 2), their coordinates in the plane.
    `plane`: indices of the plane's axes in the frame.
    """
    fixes = groundtruth.reading.fixes
    if fixes is None:
        return
    for status in np.unique(fixes.status).tolist():
        place = FIX_STATUS_PLACES.get(status)
        colour = canvas.soft_ink() if place is None else canvas.line_style(place)[0]
        of_status = fixes.status == status
        axes.plot(
            *seen[of_status].T,
            color=colour,
            linestyle="none",
            marker="o",
            markersize=_DOT_POINTS,
            zorder=_BELOW_GROUNDTRUTH,
            label=f"fixes of status {status} ({_STATUS.get(status, 'unknown')}), 95 %",
        )
        rows = np.flatnonzero(of_status & fixes.known)
        if len(rows) and groundtruth.covariances is not None:
            rows = rows[np.unique(np.linspace(0, len(rows) - 1, _MOST_ELLIPSES).astype(int))]
            covariances = groundtruth.covariances[np.ix_(rows, plane, plane)]
            _draw_ellipses(axes, seen[rows], covariances, colour)


def _draw_ellipses(axes: Axes, centres: Floats, covariances: Floats, colour: object) -> None:
    """Draw 95 % ellipses about centres (N, 2) from covariances (N, 2, 2)."""
    from matplotlib.collections import EllipseCollection

    variances, axes_of = np.linalg.eigh(covariances)
    lengths = 2.0 * _SIGMAS * np.sqrt(np.maximum(variances, 0.0))
    angles = np.degrees(np.arctan2(axes_of[:, 1, 1], axes_of[:, 0, 1]))
    ellipses = EllipseCollection(
        lengths[:, 1],
        lengths[:, 0],
        angles,
        units="xy",
        offsets=centres,
        offset_transform=axes.transData,
        facecolors="none",
        edgecolors=colour,
        linewidths=0.5,
        alpha=0.6,
        zorder=_BELOW_GROUNDTRUTH - 0.1,
        label="_",
    )
    axes.add_collection(ellipses, autolim=False)
