"""Test whether the motion of the groundtruth contradicts its up axis.

A body that rotates about only one axis, like vehicles, drones and people, rotates about gravity.
With M = mean R_i, weighted by the distance travelled, |M^T u| is 1 for a direction u of the world
that is constant in the body's axes, and 0 for a direction that rotates all around. u is vertical
if the value is near 1 for u, small for the others, and the body moves perpendicular to u. A
straight line has no rotation and no result.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.thinning import every_nth
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.evaluation import Evaluation

# Of |M^T u|: least value for the axis of rotation (18 deg of roll and pitch, rms), and largest
# value for the others (headings over more than half of a circle).
_HELD = 0.95
_TURNED = 0.6
# Largest extent along the axis, as a fraction of the smaller one across it: not a climb.
_FLAT = 0.5
# Between the axis of rotation and the up axis.
_APART_DEG = 45.0
_NEAR_DEG = 20.0  # from an axis of the frame, which the message then names
_FEWEST = 20
_ENOUGH = 20_000  # states


def doubt_of(trajectory: Trajectory) -> str:
    """Return why the up axis is wrong; "" if it is possible, or was given."""
    if trajectory.up.is_given or trajectory.quaternions is None:
        return ""
    axis = vertical_of(trajectory.positions, trajectory.quaternions)
    if axis is None:
        return ""
    apart = float(np.degrees(np.arccos(min(abs(float(axis @ trajectory.up.matrix[2])), 1.0))))
    if apart < _APART_DEG:
        return ""
    nearest = int(np.argmax(np.abs(axis)))
    name = "xyz"[nearest]
    from_it = float(np.degrees(np.arccos(min(abs(float(axis[nearest])), 1.0))))
    if from_it > _NEAR_DEG:
        direction = ", ".join(f"{each:.2f}" for each in axis)
        what = (
            f"the direction ({direction}), which is not an axis; rotate the frame to a "
            "vertical axis"
        )
    else:
        what = f"the {name} axis; set --up=-{name} or --up={name}"
    return (
        f"{trajectory.up} is probably not the vertical axis of the groundtruth's frame: the body "
        f"turns about {what}; to keep it, set --up={trajectory.up.name}"
    )


def vertical_of(positions: Floats, quaternions: Floats) -> Floats | None:
    """Return the axis (3,) of rotation that a body moves perpendicular to, of either sign.

    Args:
        positions: (N, 3), metres.
        quaternions: (N, 4), xyzw, unit.

    Returns:
        None without such an axis: no rotation, several axes, a climb, or a line.
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
    if along[:, 0] @ along[:, 0] > _FLAT**2 * level[0]:
        return None
    vertical: Floats = axes[:, 0]
    return vertical


def require_vertical(groundtruth: Trajectory, gauge: Gauge) -> None:
    """Refuse an alignment about an axis that is not vertical.

    Raises:
        InputError: The gauge is yaw or planar, and the groundtruth rotates about another axis
            than its up axis.
    """
    doubt = doubt_of(groundtruth) if gauge.turns_about_gravity_only else ""
    if doubt:
        raise InputError(f"gauge {gauge.value} needs the vertical axis, but {doubt}")


def without_vertical(evaluation: Evaluation) -> Evaluation:
    """Return an evaluation without yaw and tilt, with a warning, if the up axis is wrong.

    Angles of form `euler` are the numbers of the toolbox, not angles about gravity.
    """
    # With a wrong up axis, such an alignment is refused.
    if evaluation.absolute.yaw_deg is None or evaluation.protocol.gauge.turns_about_gravity_only:
        return evaluation
    doubt = doubt_of(evaluation.groundtruth)
    if not doubt:
        return evaluation
    nothing = {"yaw_deg": None, "tilt_deg": None}
    segments = evaluation.segments
    if segments is not None and evaluation.protocol.re_form != "euler":
        segments = tuple(each.without(*nothing) for each in segments)
    return dataclasses.replace(
        evaluation,
        absolute=dataclasses.replace(
            evaluation.absolute, horizontal_m=None, vertical_m=None, yaw_deg=None, tilt_deg=None
        ),
        ate={**evaluation.ate, **nothing, "horizontal_m": None, "vertical_m": None},
        segments=segments,
        warnings=(
            f"{doubt}; yaw, tilt, horizontal and vertical errors withheld",
            *evaluation.warnings,
        ),
    )
