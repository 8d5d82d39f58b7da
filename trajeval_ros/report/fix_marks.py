"""GNSS fixes in a plane: dots coloured by status, with ellipses of their covariances."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.formatting.palette import FIX_STATUS_PLACES
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.report import canvas

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_STATUS = {0: "GNSS alone", 1: "satellite-based", 2: "ground-based"}  # sensor_msgs/NavSatStatus
_SIGMAS = 2.4477468306808166  # 95 % in two dimensions
_MOST_ELLIPSES = 300
_DOT_POINTS, _BELOW_TRUTH = 3.5, 1.7


def draw_fixes(axes: Axes, truth: Trajectory, seen: Floats, plane: tuple[int, int]) -> None:
    """Draw the GNSS fixes of a groundtruth; nothing if it has none.

    Args:
        axes: Axes of the plane.
        truth: N states, in a frame with z up.
        seen: (N, 2), their coordinates in the plane.
        plane: Indices of the plane's axes in the frame.
    """
    fixes = truth.fixes
    if fixes is None:
        return
    for status in np.unique(fixes.status).tolist():
        place = FIX_STATUS_PLACES.get(status)
        colour = canvas.soft_ink() if place is None else canvas.line_style(place)[0]
        own = fixes.status == status
        axes.plot(
            *seen[own].T,
            color=colour,
            linestyle="none",
            marker="o",
            markersize=_DOT_POINTS,
            zorder=_BELOW_TRUTH,
            label=f"fixes of status {status} ({_STATUS.get(status, 'unknown')}), 95 %",
        )
        rows = np.flatnonzero(own & fixes.known)
        if len(rows) and truth.covariances is not None:
            rows = rows[np.unique(np.linspace(0, len(rows) - 1, _MOST_ELLIPSES).astype(int))]
            covariances = truth.covariances[np.ix_(rows, plane, plane)]
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
        zorder=_BELOW_TRUTH - 0.1,
        label="_",
    )
    axes.add_collection(ellipses, autolim=False)
