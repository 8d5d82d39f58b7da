"""Whether a groundtruth moves as if the axis that is taken for up were not.

A body that turns about one axis only, as vehicles, drones and people on the whole do, turns about
gravity: nothing else holds one direction of the world in its place as seen from the body. With
M = mean R_i, weighted by the distance travelled, |M^T u| is 1 for a direction u of the world that
the body always sees at one place, and 0 for one that goes all around it. Where it is near 1 for
the best u, small for the others, and the body moves across u, then u is vertical. On a straight
line nothing turns, and nothing is said.
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

# Of |M^T u|: at least so much for the axis of all turns (18 deg of roll and pitch, rms), at most
# so much for the others (headings over a good half of a circle).
_HELD = 0.95
_TURNED = 0.6
# Extent along the axis, as a share of the smaller of the two across it: it is no climb.
_FLAT = 0.5
# Between the axis of all turns and the one that is taken for up.
_APART_DEG = 45.0
_NEAR_DEG = 20.0  # of an axis of the frame, which then is the one to name
_FEWEST = 20
_ENOUGH = 20_000  # states


def doubt_of(trajectory: Trajectory) -> str:
    """Return why the axis that is taken for up can't be; empty if it can, or was given."""
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
    """Return the axis (3,) that a body turns about and moves across, of either sign.

    Args:
        positions: (N, 3), metres.
        quaternions: (N, 4), xyzw, unit.

    Returns:
        None where the motion shows none: no turns, turns about several axes, a climb, a line.
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
    """Refuse to align about an axis that can't be up.

    Raises:
        InputError: The gauge is yaw or planar, and the groundtruth moves about another axis than
            the one that is taken for up.
    """
    doubt = doubt_of(groundtruth) if gauge.turns_about_gravity_only else ""
    if doubt:
        raise InputError(f"gauge {gauge.value} needs the vertical axis, but {doubt}")


def without_vertical(evaluation: Evaluation) -> Evaluation:
    """Return an evaluation without yaw and tilt, and a warning, where they have no meaning.

    Those of form `euler` are no angles about gravity, but what the toolbox prints.
    """
    # Such an alignment is refused where there is a doubt.
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
