"""Whether a groundtruth moves as its up axis implies: bodies rotate about the vertical."""

from __future__ import annotations

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.geodesy import is_earth_centred
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.trajectory_edits import every_nth

# Of |M^T u|: least value for the axis of rotation (18 deg of roll and pitch, rms), and largest
# value for the others (headings over more than half of a circle).
_HELD = 0.95
_TURNED = 0.6
# Largest extent along the axis, as a fraction of the smaller one across it: not a climb.
_CLIMB = 0.5
# Between the axis of rotation and the up axis.
_APART_DEG = 45.0
_NEAR_DEG = 20.0  # from an axis of the frame, which the message then names
_FEWEST = 20
_ENOUGH = 2000  # states


def up_axis_doubt(trajectory: Trajectory, estimate: Trajectory | None = None) -> str:
    """Return why the up axis is wrong; "" if it is possible, or was given.

    `estimate`: the other side, which keeps its up axis in the advice if it rotates about it.
    """
    if trajectory.up.is_given:
        return ""
    if is_earth_centred(trajectory.positions):
        return "the groundtruth is probably in earth-centred coordinates (ECEF), where z is not up"
    if trajectory.quaternions is None:
        return ""
    axis = vertical_axis_of(trajectory.positions, trajectory.quaternions)
    if axis is None:
        return ""
    if _degrees(abs(axis @ trajectory.up.matrix[2])) < _APART_DEG:
        return ""
    name = nearest_axis(axis).lstrip("-")
    if _degrees(np.abs(axis).max()) > _NEAR_DEG:
        direction = ", ".join(f"{item:.2f}" for item in axis)
        what = (
            f"the direction ({direction}), which is not an axis; rotate the frame to a "
            "vertical axis"
        )
    else:
        kept = "" if estimate is None or not _turns_about_up(estimate) else estimate.up.name
        choices = (f"{name},{kept}", f"-{name},{kept}") if kept else (f"-{name}", name)
        what = f"the {name} axis; set --up={choices[0]} or --up={choices[1]}"
    return (
        f"{trajectory.up} is probably not the vertical axis of the groundtruth's frame: the body "
        f"turns about {what}; to keep it, set --up={trajectory.up.name}"
    )


def _turns_about_up(trajectory: Trajectory) -> bool:
    if trajectory.quaternions is None:
        return False
    axis = vertical_axis_of(trajectory.positions, trajectory.quaternions)
    return axis is not None and _degrees(abs(axis @ trajectory.up.matrix[2])) < _NEAR_DEG


def vertical_axis_of(positions: Floats, quaternions: Floats) -> Floats | None:
    """Return the axis (3,) of rotation that a body moves perpendicular to, of either sign.

    A body that rotates about only one axis, like vehicles, drones and people, rotates about
    gravity. With M = mean R_i, weighted by the distance travelled, |M^T u| is 1 for a direction u
    of the world that is constant in the body's axes, and 0 for a direction that rotates all
    around. u is vertical if the value is near 1 for u, small for the others, and the body moves
    perpendicular to u. It is None without such an axis: no rotation, several axes, a climb, or a
    line. The quaternions (N, 4) are xyzw.
    """
    some = every_nth(len(positions), _ENOUGH)
    positions, quaternions = positions[some], quaternions[some]
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    if len(positions) < _FEWEST or not steps.sum() > 0.0:
        return None
    mean = np.einsum("n,nij->ij", steps / steps.sum(), lie.to_matrix(quaternions[1:]))
    axes, held, _ = np.linalg.svd(mean)
    if held[0] < _HELD or held[1] > _TURNED:
        return None
    along = (positions - positions.mean(axis=0)) @ axes
    level = np.linalg.eigvalsh(along[:, 1:].T @ along[:, 1:])
    if along[:, 0] @ along[:, 0] > _CLIMB**2 * level[0]:
        return None
    return np.asarray(axes[:, 0])


def require_up_axis(groundtruth: Trajectory, estimate: Trajectory, gauge: Gauge) -> None:
    """Refuse gauges yaw and planar if the groundtruth rotates about another axis than up."""
    doubt = up_axis_doubt(groundtruth, estimate) if gauge.yaw_only else ""
    if doubt:
        advice = "" if "--up" in doubt else "; use --gauge se3, or a local frame with z up"
        raise InputError(f"gauge {gauge.value} needs the vertical axis, but {doubt}{advice}")


def nearest_axis(direction: Floats) -> str:
    """Return the signed axis, such as -y, that is nearest to a direction (3,)."""
    axis = int(np.argmax(np.abs(direction)))
    return ("-" if direction[axis] < 0.0 else "") + "xyz"[axis]


def _degrees(cosine: float) -> float:
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
