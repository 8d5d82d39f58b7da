"""The vertical axes of both worlds, if the alignment rotates about gravity only."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from trajeval_ros.diagnosis.findings import Detection, TestResult
from trajeval_ros.diagnosis.hypotheses import ODDS, TIE
from trajeval_ros.diagnosis.input_pair import InputPair
from trajeval_ros.diagnosis.motion_models import Model, ModelScores, bounded
from trajeval_ros.diagnosis.motion_parameters import SPREADS, log_odds
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.geometry.vertical_axis import nearest_axis, vertical_axis_of
from trajeval_ros.metrics.statistics import median

_TEST = "vertical axes"
_PARTS = 8  # of the run, whose spread gives the covariance of a direction
_AXIS_DEG = 5.0  # largest angle to an axis of the frame that is named as the vertical one
_NEAR_AXIS = math.cos(math.radians(20.0))  # the same, of an axis of rotation or of both frames
_CALLED = {"-y": ", as in a camera's (x right, y down, z forward)", "-z": ", as in NED"}


def world_rotations(scores: ModelScores, model: Model, body: Floats) -> Floats:
    """Return the rotations (N, 4) from the estimate's world to the groundtruth's, by motion.

    `body`: (3, 3), the rotation from the estimate's body to the groundtruth's.
    """
    motions = scores.read(model.hypothesis).motions
    assert motions.groundtruth.quaternions is not None
    assert motions.estimate.quaternions is not None
    aligned = lie.multiply(lie.from_matrix(body), lie.conjugate(motions.estimate.quaternions[0]))
    return lie.multiply(motions.groundtruth.quaternions[0], aligned)


def _unit(vector: Floats) -> Floats:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-12))


def mean_direction(directions: Floats) -> Floats:
    """Return the direction (3,) of the medians of unit vectors (N, 3)."""
    return _unit(np.array([median(column) for column in directions.T]))


def vertical_axes(
    scores: ModelScores, model: Model, body: Floats, inputs: InputPair
) -> TestResult:
    """Compare the vertical axes of both worlds, with the body's rotation (3, 3)."""
    worlds = world_rotations(scores, model, body)
    by_axis = [lie.rotate(worlds, np.broadcast_to(axis, (len(worlds), 3))) for axis in np.eye(3)]
    parts = np.array([mean_direction(part) for part in np.array_split(by_axis[2], _PARTS)])
    up = mean_direction(parts)
    tilt = math.acos(float(np.clip(up[2], -1.0, 1.0)))
    across = parts - np.outer(parts @ up, up)
    # The variance of the mean of two components; parts are correlated, so it counts four times.
    variance = 4.0 * float((across**2).sum(axis=1).mean()) / 2.0 / (_PARTS - 1.0)
    odds = log_odds(_unit(up[:2]) * tilt, np.eye(2) * variance, SPREADS["tilt"])
    statistics = {
        "tilt_deg": math.degrees(tilt),
        "sigma_deg": math.degrees(math.sqrt(variance)),
        "log_odds": odds,
    }
    # Rows are the groundtruth's axes in the estimate's world, columns the other way round.
    matrix = np.stack([mean_direction(by_axis[0]), mean_direction(by_axis[1]), up], axis=1)
    shared = _vertical_of_both(scores, model, matrix, inputs)
    if shared is not None:
        return TestResult(_TEST, statistics, (shared,))
    if odds <= ODDS:
        return TestResult(_TEST, statistics)
    finding = _other_axis(scores, model, matrix, statistics, inputs)
    if finding is None:
        # Errors of orientations, or orientations of other axes, do not rotate the positions.
        to_level = _unit(np.array([up[1], -up[0], 0.0])) * tilt
        level = lie.multiply(lie.from_rotation_vector(to_level), worlds)
        by_positions = scores.log_odds_of_worlds(model, worlds, level)
        statistics["log_odds_of_positions"] = by_positions
        if by_positions <= 0.0:
            return TestResult(_TEST, statistics)
        finding = Detection(
            "tilted", {name: statistics[name] for name in ("tilt_deg", "sigma_deg")}
        )
    return TestResult(_TEST, statistics, (finding,))


def _other_axis(
    scores: ModelScores,
    model: Model,
    matrix: Floats,
    statistics: dict[str, float],
    inputs: InputPair,
) -> Detection | None:
    """Return the finding that another axis is vertical in a world; None if it is tilted."""
    ups = {"groundtruth": inputs.groundtruth.up, "estimate": inputs.estimate.up}
    # The vertical axis of a side in the frame of the other one.
    for side, upward in (("estimate", _unit(matrix[2])), ("groundtruth", _unit(matrix[:, 2]))):
        axis = nearest_axis(upward)
        off_deg = math.degrees(math.acos(min(float(np.abs(upward).max()), 1.0)))
        if axis == "z" or off_deg > max(_AXIS_DEG, statistics["sigma_deg"]):
            continue
        both = {name: _in_file(axis if name == side else "z", up) for name, up in ups.items()}
        return Detection.of(
            "up_axis_or_mirrored" if axis == "-z" and _is_mirror(scores, model) else "up_axis",
            side=side,
            axis=both[side],
            axes_up=",".join(both.values()),
            off_deg=off_deg,
            tilt_deg=statistics["tilt_deg"],
            called=_CALLED.get(both[side], ""),
        )
    return None


def _is_mirror(scores: ModelScores, model: Model) -> bool:
    """Return whether the same poses with z flipped explain the motions as well as z down."""
    flipped = replace(model, axes=-np.eye(3), body=model.body @ np.diag([-1.0, -1.0, 1.0]))
    [flipped] = scores.with_likelihoods([flipped])
    return flipped.log_likelihood > model.log_likelihood - TIE


def _vertical_of_both(
    scores: ModelScores, model: Model, matrix: Floats, inputs: InputPair
) -> Detection | None:
    """Return the finding that the groundtruth's x or y is vertical.

    Either the groundtruth itself shows it, or both sides rotate about the same axis.
    """
    groundtruth = inputs.groundtruth
    if groundtruth.up.is_given:
        return None
    assert groundtruth.quaternions is not None
    vertical = vertical_axis_of(groundtruth.positions, groundtruth.quaternions)
    if vertical is not None:
        vertical = np.abs(groundtruth.up.to_z_up(vertical))
        is_axis, row = vertical.max() > _NEAR_AXIS, int(vertical.argmax())
        return _sideways(row, matrix, inputs) if is_axis and row < 2 else None
    read = scores.read(model.hypothesis)
    start = read.motions.groundtruth.quaternions
    assert start is not None
    rotations = bounded(lie.rotate(start[0], read.truth.motions[0]))
    about = np.abs(np.linalg.eigh(rotations.T @ rotations)[1][:, -1])
    for row in (0, 1):
        if abs(matrix[row, row]) > _NEAR_AXIS and about[row] > _NEAR_AXIS:
            return _sideways(row, matrix, inputs)
    return None


def _sideways(row: int, matrix: Floats, inputs: InputPair) -> Detection:
    """Return the finding that an axis of the groundtruth is vertical, with what corrects it."""
    up_of_groundtruth, up_of_estimate = inputs.groundtruth.up, inputs.estimate.up
    up, down = (_in_file(sign + "xyz"[row], up_of_groundtruth) for sign in ("", "-"))
    text = (
        f"{_in_file('z', up_of_groundtruth)} is not the vertical axis of the groundtruth's frame: "
        f"the body turns about {up.lstrip('-')}; set --up={down} or --up={up}"
    )
    direction = -_unit(matrix[row])
    has_axis = float(np.abs(direction).max()) > _NEAR_AXIS
    ups = f"{down},{_in_file(nearest_axis(direction), up_of_estimate)}" if has_axis else ""
    return Detection.of("groundtruth_up_axis", text=text, ups=ups, gauge="" if has_axis else "se3")


def _in_file(axis: str, up: UpAxis) -> str:
    """Return an axis, such as -y, of a frame with an up axis as it is in the file."""
    row = up.applied["xyz".index(axis[-1])]
    return nearest_axis(-row if axis.startswith("-") else row)
