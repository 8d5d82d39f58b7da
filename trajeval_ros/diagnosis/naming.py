"""Names, values and corrections of what the models and their parameters show."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from trajeval_ros.diagnosis.findings import Detection, Finding, TestResult, Value
from trajeval_ros.diagnosis.hypotheses import (
    AS_READ,
    BOTH,
    ESTIMATE,
    GROUNDTRUTH,
    HYPOTHESES,
    MISTAKE,
    ODDS,
    PROPER,
    ROTATIONS,
    TIE,
)
from trajeval_ros.diagnosis.input_pair import other_side
from trajeval_ros.diagnosis.motion_models import Model, ModelScores
from trajeval_ros.diagnosis.motion_parameters import BODY, LEVER, SPREADS, Parameters, log_odds
from trajeval_ros.diagnosis.short_motions import ShortMotions
from trajeval_ros.diagnosis.world_axes import mean_direction, world_rotations
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, lengths
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.vertical_axis import nearest_axis
from trajeval_ros.metrics.statistics import median

# Rotations of a body within this angle of other axes are stated as these axes.
_EXACT_AXES_DEG = 3.0
_TILTS_APART_DEG = 20.0  # that gravity distinguishes; less is drift
_UNITS = {
    "millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254, "feet": 0.3048, "kilometres": 1e3
}  # fmt: skip
# The scale of a monocular estimate is often as near to a foot of the groundtruth.
_FOOT, _FOOT_SPREAD, _FOOT_ODDS = (GROUNDTRUTH, "feet"), 0.01, 2.5
_DIVERGED = math.log(1e4)  # a scale that no unit has
_FAST_M = 200.0  # per motion: no body that is localised is as fast, so the unit is smaller
# Ratios of the sums of rotation angles: of another unit, and of constant orientations.
_OTHER_UNIT, _CONSTANT = 0.1, 1e-3
_WRITTEN = {
    "wxyz": "in the order w, x, y, z but read as x, y, z, w",
    "xyzw": "in the order x, y, z, w but read as w, x, y, z",
    "transposed": "inverse",
    "wxyz_transposed": "in the order w, x, y, z and inverse",
    "inverse": "inverse (positions, too)",
    "mirrored": "left-handed",
    "axes_mixed": "in different axes than the positions",
    ROTATIONS: "Euler angles in another order or with other signs",
}


def convention(
    scores: ModelScores, best: Model, models: Sequence[Model], as_read: Model
) -> Detection:
    """Return the finding that a model explains the motions better than the one as read."""
    ties = [model for model in models if model.score > best.score - TIE and model.cause != AS_READ]
    by_cause = {best.cause: best}
    for model in sorted(ties, key=lambda model: -model.score):
        by_cause.setdefault(model.cause, model)
    rows = [_of_model(scores, model, ties, as_read) for model in by_cause.values()]
    if len(rows) == 1:
        return rows[0]
    options = (Finding.of(row).conversion for row in rows)
    agreements = _agreements(best, as_read)
    return Detection.of(
        "convention_tie",
        **agreements,
        causes=" or ".join(dict.fromkeys(map(_written, by_cause.values()))),
        options=", or ".join(dict.fromkeys(option for option in options if option)),
    )


def _agreements(model: Model, as_read: Model) -> dict[str, float]:
    """Return the agreements with a model and as read, percent."""
    pair = {"agreement": model, "as_read": as_read}
    return {name: 100.0 * max(one.agreement, 0.0) for name, one in pair.items()}


def _written(model: Model) -> str:
    """Return how the poses of a model are written."""
    if model.cause == "conventions":
        return f"{_WRITTEN[model.hypothesis.cause]} with other axes of the positions"
    return _WRITTEN[model.cause]


def _of_model(
    scores: ModelScores, model: Model, ties: Sequence[Model], as_read: Model
) -> Detection:
    """Return the finding of a model, with its correction."""
    hypothesis, cause = model.hypothesis, model.cause
    if cause == ROTATIONS:
        return rotations(scores, hypothesis.detail)
    sides = {tie.hypothesis.side for tie in ties if tie.cause == cause and tie.hypothesis.side}
    is_open = len(sides - {BOTH}) > 1 and hypothesis.side != BOTH
    values: dict[str, Value] = {
        **_agreements(model, as_read),
        "side": "one side" if is_open else hypothesis.side or "one side",
        "order": hypothesis.order,
        "inverse": hypothesis.inverse,
        "causes": _WRITTEN.get(hypothesis.cause, ""),
    }
    if model.changes_axes:
        # Of axes that short motions can't distinguish, gravity selects one.
        similar = [tie for tie in ties if tie.cause == cause and tie.hypothesis is hypothesis]
        options = [option for tie in (model, *similar) for option in _axes_options(scores, tie)]
        values["axes"] = min(options, key=lambda option: round(option[0] / _TILTS_APART_DEG))[1]
    return Detection(cause, values)


def rotations(scores: ModelScores, detail: str = "") -> Detection:
    """Return the finding that positions agree, and rotations do not, or only as in `detail`."""
    read = scores.read(HYPOTHESES[0])
    groundtruth, estimate = (
        max(float(np.minimum(lengths(vectors), math.pi).sum()), 1e-12)
        for vectors in (read.truth.motions[0], read.rotations)
    )
    ratio = estimate / groundtruth
    how, check = "in no convention", "order and signs of Euler angles; a compass is clockwise"
    if detail:
        how = f"only with a correction: {detail}"
    elif not _CONSTANT < ratio < 1.0 / _CONSTANT:
        side = ESTIMATE if ratio < 1.0 else GROUNDTRUTH
        how, check = f"{how} (those of the {side} are constant)", "columns of the orientations"
    elif not _OTHER_UNIT <= ratio <= 1.0 / _OTHER_UNIT:
        how += f" (angles {ratio:.3g} times as large)"
        one, other = ("radians", "degrees")[:: 1 if ratio < 1.0 else -1]
        check = f"{one} were probably read as {other}"
    is_explained = float(how != "in no convention")
    return Detection.of(
        ROTATIONS, how=how, check=check, angle_ratio=ratio, is_explained=is_explained
    )


def _axes_options(scores: ModelScores, model: Model) -> list[tuple[float, str]]:
    """Return values of --axes that correct a model, with the tilt that they leave, deg."""
    axes = model.axes
    if (axes == -np.eye(3)).all():
        return [(0.0, _axes(mirror_of(scores, model)))]
    worlds = world_rotations(scores, model, model.body)

    def tilt_deg(up: Floats) -> float:
        """Return the angle between a direction of the estimate's world and up."""
        rotated = mean_direction(lie.rotate(worlds, np.broadcast_to(up, (len(worlds), 3))))
        return math.degrees(math.acos(min(max(float(rotated[2]), -1.0), 1.0)))

    options = [(tilt_deg(np.eye(3)[2]), f"positions={_axes(axes)}")]
    if np.linalg.det(axes) > 0.0:  # the rotations may have been converted
        options.append((tilt_deg(axes[:, 2]), f"rotations={_axes(axes.T)}"))
    return options


def mirror_of(scores: ModelScores, model: Model) -> Floats:
    """Return the mirror M (3, 3) of a model with the axes -1: its poses are M p and M R M^T.

    Mirrors differ by rotations of body and world. This one leaves the least rotation of the body
    and tilt of the world.
    """
    of_body = np.einsum("qij,ij->q", PROPER, model.body)  # traces of the remaining rotations
    worlds = lie.conjugate(world_rotations(scores, model, model.body))
    up = mean_direction(lie.rotate(worlds, np.broadcast_to(np.eye(3)[2], (len(worlds), 3))))
    cosines = np.stack([(of_body - 1.0) / 2.0, PROPER[:, 2] @ up])
    angles = np.arccos(np.clip(cosines, -1.0, 1.0))
    return np.asarray(-PROPER[int(angles.sum(axis=0).argmin())])


def _axes(permutation: Floats) -> str:
    """Return a signed permutation (3, 3) as the value of an option."""
    return ",".join(map(nearest_axis, permutation))


def unit_or_scale(
    scale: float, variance: float, motions: ShortMotions, gauge: Gauge
) -> tuple[Detection, ...]:
    """Return the finding that the unit or the scale of a side differs, if any.

    `scale`: groundtruth metres per unit of the estimate, with the variance of its logarithm.
    """
    log, spread = math.log(scale), SPREADS["scale"]
    sizes = {
        ESTIMATE: lengths(motions.estimate.displacements),
        GROUNDTRUTH: lengths(motions.groundtruth.displacements),
    }
    if abs(log) > _DIVERGED:
        true_m, moved_m = (float(sizes[side].sum()) for side in (GROUNDTRUTH, ESTIMATE))
        return (Detection.of("diverged_at_start", until="", true_m=true_m, moved_m=moved_m),)
    is_fast = {side: median(some[some >= median(some)]) > _FAST_M for side, some in sizes.items()}

    def density(apart: float, deviation: float) -> float:
        """Return the logarithm of the density of a difference of logarithms."""
        total = variance + deviation**2
        return -0.5 * math.log(2.0 * math.pi * total) - 0.5 * apart**2 / total

    units = {
        (side, unit): density(  # with the spreads of units and of estimates
            (log if side == ESTIMATE else -log) - math.log(metres),
            _FOOT_SPREAD if (side, unit) == _FOOT else math.sqrt(2.0) * spread.healthy,
        )
        + MISTAKE
        - math.log(len(_UNITS))
        for side, (unit, metres) in itertools.product(sizes, _UNITS.items())
        # Millimetres of a side are kilometres of the other one.
        if (unit != "millimetres" or is_fast[side])
        and (unit != "kilometres" or not is_fast[other_side(side)])
    }
    side, unit = likeliest = max(units, key=units.__getitem__)
    healthy, any_scale = density(log, spread.healthy), density(log, spread.mistake) + MISTAKE
    more_than_scale = any_scale + (_FOOT_ODDS if likeliest == _FOOT else 1.0)
    is_unit = units[likeliest] > max(healthy + ODDS, more_than_scale)
    # An alignment with scale hides the unit of the estimate, and that of a slow groundtruth.
    if gauge.has_scale:
        is_unit = is_unit and side == GROUNDTRUTH and is_fast[GROUNDTRUTH]
    values: dict[str, Value] = {"scale": scale, "or_feet": "", "or_convert": "", "gauge": "sim3"}
    if is_unit and likeliest == _FOOT:
        convert = " (--gauge sim3), or convert feet: trajeval trajectory SOURCE --scale 0.3048"
        feet = ", or with groundtruth in feet"
        values |= {"or_feet": feet, "or_convert": convert, "gauge": ""}
    elif is_unit:
        factor = f"{_UNITS[unit]:g}"
        return (Detection.of("unit", scale=scale, side=side, unit=unit, factor=factor),)
    elif gauge.has_scale or any_scale - healthy < ODDS + MISTAKE:
        return ()
    return (Detection("scale", values),)


def body_and_lever(scores: ModelScores, parameters: Parameters, model: Model) -> TestResult:
    """Test the rotation of the body and the lever arm, with the pose that corrects them.

    The correction is the pose of the groundtruth's body in the estimate's, T_B_M.
    """
    matrix, covariance = parameters.body, parameters.covariance
    if model.mirrors_poses:
        matrix = matrix @ -mirror_of(scores, model).T  # what the mirror leaves
    rotation, lever = lie.rotation_vector(lie.from_matrix(matrix)), parameters.values[LEVER]
    angle_deg, lever_m = math.degrees(float(lengths(rotation))), float(lengths(lever))
    odds = log_odds(rotation, covariance[BODY, BODY], SPREADS["body"])
    lever_odds = log_odds(lever, covariance[LEVER, LEVER], SPREADS["lever"])
    is_rotated, has_lever = odds > ODDS, lever_odds > ODDS
    nearest = PROPER[int(np.einsum("qij,ij->q", PROPER, matrix).argmax())]
    if math.degrees(float(lie.angle(lie.from_matrix(matrix @ nearest.T)))) < _EXACT_AXES_DEG:
        matrix = nearest
    # x, y, z, qx, qy, qz, qw
    numbers = [*(lever * has_lever), *lie.from_matrix(matrix.T if is_rotated else np.eye(3))]
    pose = ",".join(f"{one + 0.0:.5g}" if abs(one) > 1e-6 else "0" for one in numbers)
    seen = []
    if is_rotated:
        rest_deg = math.degrees(_sigma_of_length(rotation, covariance[BODY, BODY]))
        seen.append(Detection.of("body", angle_deg=angle_deg, rest_deg=rest_deg, pose=pose))
    if has_lever:
        sigma_m = _sigma_of_length(lever, covariance[LEVER, LEVER])
        seen.append(Detection.of("lever_arm", lever_m=lever_m, sigma_m=sigma_m, pose=pose))
    names = "angle_deg", "lever_m", "log_odds_of_body", "log_odds_of_lever"
    statistics = dict(zip(names, (angle_deg, lever_m, odds, lever_odds), strict=True))
    return TestResult("bodies", statistics, tuple(seen))


def _sigma_of_length(vector: Floats, covariance: Floats) -> float:
    """Return the standard deviation of the length of a vector (3,) with a covariance (3, 3)."""
    along = vector / max(float(np.linalg.norm(vector)), 1e-12)
    return math.sqrt(float(along @ covariance @ along))
