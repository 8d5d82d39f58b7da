"""Names, values and corrections of what the models and their parameters show."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from trajeval_ros.diagnosis.clock_match import SMALL_S, ClockMatch
from trajeval_ros.diagnosis.findings import Finding, Seen, Value
from trajeval_ros.diagnosis.hypotheses import (
    AS_READ,
    BOTH,
    GROUNDTRUTH,
    HYPOTHESES,
    MISTAKE,
    PROPER,
    ROTATIONS,
)
from trajeval_ros.diagnosis.input_pair import lengths
from trajeval_ros.diagnosis.motion_models import Model, ModelScores
from trajeval_ros.diagnosis.motion_parameters import BODY, LEVER, SPREADS, Parameters
from trajeval_ros.diagnosis.short_motions import ShortMotions
from trajeval_ros.diagnosis.world_axes import mean_direction, world_rotations
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.vertical_axis import nearest_axis
from trajeval_ros.metrics.statistics import median

ODDS = 12.0  # least logarithm of odds of a statement: alarms against missed mistakes
TIE = 3.0  # largest difference of logarithms between models that the motion can't distinguish
# Rotations of a body within this angle of other axes are stated as these axes.
_EXACT_AXES_DEG = 3.0
_TILTS_APART_DEG = 20.0  # that gravity distinguishes; less is drift
_LEAST_LEVER_M = 0.02  # shorter lever arms have no effect worth a statement
_UNITS = {
    "millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254, "feet": 0.3048, "kilometres": 1e3
}  # fmt: skip
_UNIT_SPREAD = 0.04  # of the logarithm of a scale that is a unit
# The scale of a monocular estimate is often as near to a foot of the groundtruth.
_FOOT_SPREAD, _FOOT_ODDS = 0.01, 2.5
_LEAST_LOG_SCALE, _DIVERGED = 0.2, math.log(1e4)  # a scale error, and one that no unit has
_FAST_M = 200.0  # per motion: no body that is localised is as fast, so the unit is smaller
# Ratios of the sums of rotation angles: of another unit, and of constant orientations.
_OTHER_UNIT, _CONSTANT = 0.1, 1e-3
_LEAP_S = {18: "GPS time without leap seconds", 19: "GPS against TAI", 37: "TAI against UTC"}
_LEAP_WITHIN_S = 0.3
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


def convention(scores: ModelScores, best: Model, models: Sequence[Model], as_read: Model) -> Seen:
    """Return the finding that a model explains the motions better than the one as read."""
    ties = [model for model in models if model.score > best.score - TIE and model.cause != AS_READ]
    by_cause = {best.cause: best}
    for model in sorted(ties, key=lambda model: -model.score):
        by_cause.setdefault(model.cause, model)
    if len(by_cause) > 1:
        rows = [_of_model(scores, model, ties, as_read) for model in by_cause.values()]
        names = map(_written, by_cause.values())
        options = (Finding.of(row).conversion for row in rows)
        return Seen.of(
            "convention_tie",
            agreement=100.0 * max(best.agreement, 0.0),
            as_read=100.0 * max(as_read.agreement, 0.0),
            causes=" or ".join(dict.fromkeys(names)),
            options=", or ".join(dict.fromkeys(option for option in options if option)),
        )
    return _of_model(scores, best, ties, as_read)


def _written(model: Model) -> str:
    """Return how the poses of a model are written."""
    if model.cause == "conventions":
        return f"{_WRITTEN[model.hypothesis.cause]} with other axes of the positions"
    return _WRITTEN[model.cause]


def _of_model(scores: ModelScores, model: Model, ties: Sequence[Model], as_read: Model) -> Seen:
    """Return the finding of a model, with its correction."""
    hypothesis, cause = model.hypothesis, model.cause
    sides = {tie.hypothesis.side for tie in ties if tie.cause == cause and tie.hypothesis.side}
    is_open = len(sides - {BOTH}) > 1 and hypothesis.side != BOTH
    values: dict[str, Value] = {
        "side": "one side" if is_open else hypothesis.side or "one side",
        "agreement": 100.0 * max(model.agreement, 0.0),
        "as_read": 100.0 * max(as_read.agreement, 0.0),
        "order": hypothesis.order,
        "inverse": hypothesis.inverse,
        "causes": _WRITTEN.get(hypothesis.cause, ""),
    }
    if cause == ROTATIONS:
        return rotations(scores, hypothesis.detail)
    if model.changes_axes:
        # Of axes that short motions can't distinguish, gravity selects one.
        similar = [tie for tie in ties if tie.cause == cause and tie.hypothesis is hypothesis]
        options = [option for tie in (model, *similar) for option in _axes_options(scores, tie)]
        values["axes"] = min(options, key=lambda option: round(option[0] / _TILTS_APART_DEG))[1]
    return Seen(cause, values)


def rotations(scores: ModelScores, detail: str = "") -> Seen:
    """Return the finding that positions agree, and rotations do not, or only as in `detail`."""
    read = scores.read(HYPOTHESES[0])
    groundtruth, estimate = (
        max(float(np.minimum(lengths(vectors), math.pi).sum()), 1e-12)
        for vectors in (read.groundtruth[0], read.rotations)
    )
    ratio = estimate / groundtruth
    how, check = "in no convention", "order and signs of Euler angles; a compass is clockwise"
    if detail:
        how = f"only with a correction: {detail}"
    elif not _CONSTANT < ratio < 1.0 / _CONSTANT:
        side = "estimate" if ratio < 1.0 else "groundtruth"
        how, check = f"{how} (those of the {side} are constant)", "columns of the orientations"
    elif ratio < _OTHER_UNIT:
        how += f" (angles {ratio:.3g} times as large)"
        check = "radians were probably read as degrees"
    elif ratio > 1.0 / _OTHER_UNIT:
        how += f" (angles {ratio:.3g} times as large)"
        check = "degrees were probably read as radians"
    is_explained = float(how != "in no convention")
    return Seen.of(ROTATIONS, how=how, check=check, angle_ratio=ratio, is_explained=is_explained)


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

    options = [(tilt_deg(np.array([0.0, 0.0, 1.0])), f"positions={_axes(axes)}")]
    if not model.is_mirrored:  # the rotations may have been converted
        options.append((tilt_deg(axes[:, 2]), f"rotations={_axes(axes.T)}"))
    return options


def mirror_of(scores: ModelScores, model: Model) -> Floats:
    """Return the mirror M (3, 3) of a model with the axes -1: its poses are M p and M R M^T.

    Mirrors differ by rotations of body and world. This one leaves the least rotation of the body
    and tilt of the world.
    """
    of_body = np.einsum("qij,ij->q", PROPER, model.body)  # traces of the remaining rotations
    up = lie.rotate(
        lie.conjugate(world_rotations(scores, model, model.body)),
        np.broadcast_to([0.0, 0.0, 1.0], (len(scores.motions), 3)),
    )
    of_world = PROPER[:, 2] @ mean_direction(up)
    angles = np.arccos(np.clip(np.stack([(of_body - 1.0) / 2.0, of_world]), -1.0, 1.0))
    return np.asarray(-PROPER[int(angles.sum(axis=0).argmin())])


def _axes(permutation: Floats) -> str:
    """Return a signed permutation (3, 3) as the value of an option."""
    return ",".join(map(nearest_axis, permutation))


def unit_or_scale(
    scale: float, variance: float, motions: ShortMotions, gauge: Gauge
) -> list[Seen]:
    """Return the finding that the unit or the scale of a side differs, if any.

    `scale`: groundtruth metres per unit of the estimate, with the variance of its logarithm.
    """
    log = math.log(scale)
    groundtruth, estimate = (
        lengths(poses.positions[1] - poses.positions[0])
        for poses in (motions.groundtruth, motions.estimate)
    )
    if abs(log) > _DIVERGED:
        true_m, moved_m = float(groundtruth.sum()), float(estimate.sum())
        return [Seen.of("diverged_at_start", until="", true_m=true_m, moved_m=moved_m)]
    spread = SPREADS["scale"]
    healthy = _log_density(log, variance + spread.healthy**2)
    any_scale = _log_density(log, variance + spread.mistake**2) + MISTAKE
    fast = {"estimate": _is_fast(estimate), GROUNDTRUTH: _is_fast(groundtruth)}
    densities: dict[tuple[str, str], float] = {}
    for side, sign in (("estimate", 1.0), (GROUNDTRUTH, -1.0)):
        for name, metres in _UNITS.items():
            # Millimetres of a side are kilometres of the other one.
            other = GROUNDTRUTH if side == "estimate" else "estimate"
            impossible = {"millimetres": not fast[side], "kilometres": fast[other]}
            if impossible.get(name, False):
                continue
            is_foot = (name, side) == ("feet", GROUNDTRUTH)
            total = variance + (
                _FOOT_SPREAD**2 if is_foot else _UNIT_SPREAD**2 + spread.healthy**2
            )
            density = _log_density(sign * log - math.log(metres), total)
            densities[name, side] = density + MISTAKE - math.log(len(_UNITS))
    name, side = max(densities, key=lambda key: densities[key])
    values: dict[str, Value] = {"scale": scale, "or_feet": "", "or_convert": "", "gauge": "sim3"}
    is_foot = (name, side) == ("feet", GROUNDTRUTH)
    more_than_scale = any_scale + (_FOOT_ODDS if is_foot else 1.0)
    is_unit = densities[name, side] > max(healthy + ODDS, more_than_scale)
    # An alignment with scale hides the unit of the estimate, and that of a slow groundtruth.
    if gauge.has_scale:
        is_unit = is_unit and side == GROUNDTRUTH and fast[GROUNDTRUTH]
    if is_unit and is_foot:
        convert = " (--gauge sim3), or convert feet: trajeval trajectory SOURCE --scale 0.3048"
        values |= {"or_feet": ", or with groundtruth in feet", "or_convert": convert, "gauge": ""}
        return [Seen("scale", values)]
    if is_unit:
        values |= {"side": side, "unit": name, "factor": f"{_UNITS[name]:g}"}
        return [Seen("unit", values)]
    if gauge.has_scale or abs(log) < _LEAST_LOG_SCALE or any_scale - healthy < ODDS + MISTAKE:
        return []
    return [Seen("scale", values)]


def _is_fast(steps: Floats) -> bool:
    return median(steps[steps >= median(steps)]) > _FAST_M


def _log_density(value: float, variance: float) -> float:
    return -0.5 * math.log(2.0 * math.pi * variance) - 0.5 * value**2 / variance


def body_and_lever(
    scores: ModelScores, parameters: Parameters, model: Model
) -> tuple[dict[str, float], list[Seen]]:
    """Return statistics and findings about the body, with the pose that corrects them.

    The correction is the pose of the groundtruth's body in the estimate's, T_B_M.
    """
    matrix = parameters.body
    if model.is_mirrored and (model.axes == -np.eye(3)).all():
        matrix = matrix @ -mirror_of(scores, model).T  # what the mirror leaves
    rotation = lie.rotation_vector(lie.from_matrix(matrix))
    values = parameters.values.copy()
    values[BODY] = rotation
    remaining = Parameters(values, parameters.covariance, matrix)
    body_odds = remaining.log_odds("body", BODY)
    lever_odds = remaining.log_odds("lever", LEVER)
    lever = values[LEVER]
    lever_m, angle_deg = float(np.linalg.norm(lever)), math.degrees(float(lengths(rotation)))
    sigma_deg = math.degrees(_sigma_of_length(rotation, parameters.covariance[BODY, BODY]))
    sigma_m = _sigma_of_length(lever, parameters.covariance[LEVER, LEVER])
    statistics = {
        "angle_deg": angle_deg,
        "lever_m": lever_m,
        "log_odds_of_body": body_odds,
        "log_odds_of_lever": lever_odds,
    }
    is_rotated = body_odds > ODDS
    has_lever = lever_odds > ODDS and lever_m > _LEAST_LEVER_M
    if not (is_rotated or has_lever):
        return statistics, []
    nearest = PROPER[int(np.einsum("qij,ij->q", PROPER, matrix).argmax())]
    off = float(lie.angle(lie.from_matrix(matrix @ nearest.T)))
    if math.degrees(off) < _EXACT_AXES_DEG:
        matrix = nearest
    pose = _pose(matrix.T if is_rotated else np.eye(3), lever if has_lever else np.zeros(3))
    seen = []
    if is_rotated:
        seen.append(Seen.of("body", angle_deg=angle_deg, rest_deg=sigma_deg, pose=pose))
    if has_lever:
        seen.append(Seen.of("lever_arm", lever_m=lever_m, sigma_m=sigma_m, pose=pose))
    return statistics, seen


def _sigma_of_length(vector: Floats, covariance: Floats) -> float:
    """Return the standard deviation of the length of a vector (3,) with a covariance (3, 3)."""
    along = vector / max(float(np.linalg.norm(vector)), 1e-12)
    return math.sqrt(float(along @ covariance @ along))


def _pose(rotation: Floats, lever_m: Floats) -> str:
    """Return a pose as the value of --hand-eye: x, y, z, qx, qy, qz, qw."""
    numbers = [*lever_m, *lie.from_matrix(rotation)]
    return ",".join(f"{number + 0.0:.5g}" if abs(number) > 1e-6 else "0" for number in numbers)


def clock(
    match: ClockMatch, offset_s: float, ppm: float, growth_s: float, applied_s: float
) -> Seen:
    """Return the finding about an offset, or about a rate if `ppm` is not zero.

    `applied_s` is added to the estimate's timestamps already. The offset of a rate is that at the
    estimate's first pose.
    """
    values: dict[str, Value] = {
        "offset_s": offset_s,
        "offset_ms": 1e3 * offset_s,
        "total_s": applied_s + offset_s,
        "peak": match.peak,
        "as_stamped": match.as_stamped,
        "known_as": "",
        "more": "more " if applied_s else "",
    }
    if ppm:
        values |= {"ppm": ppm, "growth_ms": 1e3 * growth_s}
        return Seen("clock_drift", values)
    if abs(offset_s) < SMALL_S:
        return Seen("small_clock_offset", values)
    whole = round(abs(offset_s))
    leap = _LEAP_S.get(whole, "") if abs(abs(offset_s) - whole) < _LEAP_WITHIN_S else ""
    values["known_as"] = f" ({leap})" if leap else ""
    return Seen("clock_offset", values)
