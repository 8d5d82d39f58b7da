"""The vertical axes of both worlds, if the alignment rotates about gravity only."""

from __future__ import annotations

import math

import numpy as np

from trajeval_ros.diagnosis.findings import Seen
from trajeval_ros.diagnosis.input_pair import InputPair
from trajeval_ros.diagnosis.motion_models import Model, ModelScores, bounded
from trajeval_ros.diagnosis.motion_parameters import SPREADS, log_odds
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.geometry.vertical_axis import nearest_axis, vertical_axis_of
from trajeval_ros.metrics.statistics import median

_PARTS = 8  # of the run, whose spread gives the covariance of a direction
_AXIS_DEG = 5.0  # largest angle to an axis of the frame that is named as the vertical one
_SHARED_AXIS_DEG = 12.0  # the same, if the body rotates about this axis in both frames
_ROTATES_ABOUT = 0.9  # cosine between an axis and the axis of rotation
_NOT_UP = 0.7  # largest cosine between the measured vertical axis and z, if z is not up
_CALLED = {"-y": ", as in a camera's (x right, y down, z forward)", "-z": ", as in NED"}


def world_rotations(scores: ModelScores, model: Model, body: Floats) -> Floats:
    """Return the rotations (N, 4) from the estimate's world to the groundtruth's, by motion.

    `body`: (3, 3), the rotation from the estimate's body to the groundtruth's.
    """
    motions = scores.read(model.hypothesis).motions
    assert motions.groundtruth.quaternions is not None
    assert motions.estimate.quaternions is not None
    body_rotation = lie.from_matrix(body)
    aligned = lie.multiply(body_rotation, lie.conjugate(motions.estimate.quaternions[0]))
    return lie.multiply(motions.groundtruth.quaternions[0], aligned)


def mean_direction(directions: Floats) -> Floats:
    """Return the direction (3,) of the medians of unit vectors (N, 3)."""
    middle = np.array([median(column) for column in directions.T])
    return np.asarray(middle / max(float(np.linalg.norm(middle)), 1e-12))


def vertical_axes(
    scores: ModelScores, model: Model, body: Floats, inputs: InputPair, *, can_mirror: bool
) -> tuple[dict[str, float], list[Seen]]:
    """Compare the vertical axes of both worlds.

    `can_mirror` is whether mirrored poses explain the motions as well. Returns the statistics,
    and the finding, if any.
    """
    worlds = world_rotations(scores, model, body)
    z = np.broadcast_to([0.0, 0.0, 1.0], (len(worlds), 3))
    in_groundtruth = lie.rotate(worlds, z)
    parts = np.array([mean_direction(p) for p in np.array_split(in_groundtruth, _PARTS)])
    up = mean_direction(parts)
    tilt = math.acos(float(np.clip(up[2], -1.0, 1.0)))
    across = parts - np.outer(parts @ up, up)
    # The variance of the mean of two components; parts are correlated, so it counts four times.
    variance = 4.0 * float((across**2).sum(axis=1).mean()) / 2.0 / (_PARTS - 1.0)
    level = up[:2] / max(float(np.linalg.norm(up[:2])), 1e-12) * tilt
    odds = log_odds(level, np.eye(2) * variance, SPREADS["tilt"])
    tilt_deg, sigma_deg = math.degrees(tilt), math.degrees(math.sqrt(variance))
    statistics = {"tilt_deg": tilt_deg, "sigma_deg": sigma_deg, "log_odds": odds}
    matrix = np.array([mean_direction(lie.rotate(worlds, z[:, [2, 0, 1]])),
                       mean_direction(lie.rotate(worlds, z[:, [0, 2, 1]])), up]).T  # fmt: skip
    shared = _vertical_of_both(scores, model, matrix, inputs)
    if shared is not None:
        return statistics, [shared]
    finding = _tilted(matrix, statistics, inputs, can_mirror=can_mirror)
    if finding.cause == "tilted":
        # Errors of orientations, or orientations of other axes, do not rotate the positions.
        level_worlds = lie.multiply(lie.from_matrix(_shortest_rotation(up).T), worlds)
        statistics["log_odds_of_positions"] = scores.log_odds_of_worlds(
            model, worlds, level_worlds
        )
        if statistics["log_odds_of_positions"] <= 0.0:
            return statistics, []
    return statistics, [finding]


def _shortest_rotation(up: Floats) -> Floats:
    """Return the shortest rotation (3, 3) from z to a direction (3,)."""
    axis = np.array([-up[1], up[0], 0.0])
    sine = float(np.linalg.norm(axis))
    angle = math.atan2(sine, float(up[2]))
    return lie.to_matrix(lie.from_rotation_vector(axis / max(sine, 1e-12) * angle))


def _tilted(
    matrix: Floats, statistics: dict[str, float], inputs: InputPair, *, can_mirror: bool
) -> Seen:
    """Return the finding that another axis is vertical in a world, or that it is tilted."""
    limit_deg = max(_AXIS_DEG, statistics["sigma_deg"])
    ups = inputs.groundtruth.up, inputs.estimate.up
    # The vertical axis of a side in the frame of the other one.
    for side, upward in (("estimate", matrix[2]), ("groundtruth", matrix[:, 2])):
        upward = upward / max(float(np.linalg.norm(upward)), 1e-12)
        axis = nearest_axis(upward)
        off_deg = math.degrees(math.acos(min(float(np.abs(upward).max()), 1.0)))
        if axis == "z" or off_deg > limit_deg:
            continue
        both = [
            _in_file(axis if side == name else "z", up)
            for name, up in zip(("groundtruth", "estimate"), ups, strict=True)
        ]
        named = both[side == "estimate"]
        is_tie = axis == "-z" and can_mirror
        return Seen.of(
            "up_axis_or_mirrored" if is_tie else "up_axis",
            side=side,
            axis=named,
            axes_up=",".join(both),
            off_deg=off_deg,
            tilt_deg=statistics["tilt_deg"],
            called=_CALLED.get(named, ""),
        )
    return Seen("tilted", {name: statistics[name] for name in ("tilt_deg", "sigma_deg")})


def _vertical_of_both(
    scores: ModelScores, model: Model, matrix: Floats, inputs: InputPair
) -> Seen | None:
    """Return the finding that the groundtruth's x or y is vertical.

    Either the groundtruth itself shows it, or both sides rotate about the same axis.
    """
    groundtruth = inputs.groundtruth
    if groundtruth.up.is_given:
        return None
    assert groundtruth.quaternions is not None
    vertical = vertical_axis_of(groundtruth.positions, groundtruth.quaternions)
    if vertical is not None:
        vertical = groundtruth.up.turned(vertical)
        row = int(np.abs(vertical).argmax())
        is_axis = abs(vertical[row]) > math.cos(math.radians(20.0))
        return _sideways(row, matrix, inputs) if is_axis and abs(vertical[2]) < _NOT_UP else None
    motions = scores.read(model.hypothesis)
    start = motions.motions.groundtruth.quaternions
    assert start is not None
    rotations = bounded(lie.rotate(start[0], motions.groundtruth[0]))
    about = np.linalg.eigh(rotations.T @ rotations)[1][:, -1]
    for row in (0, 1):
        shares = abs(matrix[row, row]) > math.cos(math.radians(_SHARED_AXIS_DEG))
        if shares and abs(about[row]) > _ROTATES_ABOUT:
            return _sideways(row, matrix, inputs)
    return None


def _sideways(row: int, matrix: Floats, inputs: InputPair) -> Seen:
    """Return the finding that an axis of the groundtruth is vertical, with what corrects it."""
    ups = inputs.groundtruth.up, inputs.estimate.up
    up, down = (_in_file(sign + "xyz"[row], ups[0]) for sign in ("", "-"))
    text = (
        f"{_in_file('z', ups[0])} is not the vertical axis of the groundtruth's frame: the body "
        f"turns about {up.lstrip('-')}; set --up={down} or --up={up}"
    )
    direction = -matrix[row] / max(float(np.linalg.norm(matrix[row])), 1e-12)
    has_axis = float(np.abs(direction).max()) > math.cos(math.radians(_SHARED_AXIS_DEG))
    axes = f"{down},{_in_file(nearest_axis(direction), ups[1])}" if has_axis else ""
    return Seen.of("groundtruth_up_axis", text=text, ups=axes, gauge="" if has_axis else "se3")


def _in_file(axis: str, up: UpAxis) -> str:
    """Return an axis, such as -y, of a frame with an up axis as it is in the file."""
    row = up.applied["xyz".index(axis[-1])]
    return nearest_axis(-row if axis.startswith("-") else row)
