"""Tests of scale, vertical axes, body axes and lever arms, after time and conventions."""

from __future__ import annotations

import dataclasses
import math
from typing import TypeAlias

import numpy as np

from trajeval_ros.diagnosis.convention_tests import mirror
from trajeval_ros.diagnosis.findings import Examined, Seen, Value
from trajeval_ros.diagnosis.hypotheses import (
    Hypothesis,
    ShortMotions,
    bounded,
    mean_rotation,
)
from trajeval_ros.diagnosis.input_pair import lengths
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.geometry.vertical_axis import nearest_axis
from trajeval_ros.metrics.statistics import median, quantile

Ups: TypeAlias = tuple[UpAxis, UpAxis]  # of groundtruth and estimate

# Of the logarithm of the scale: the least one, and one that no unit has, but a divergence.
_OFF, _DIVERGED = 0.2, math.log(1e4)
# Metres per unit, and largest difference of the logarithm of the scale.
_UNITS = {
    "millimetres": (1e-3, 0.15),
    "centimetres": (1e-2, 0.1),
    "inches": (0.0254, 0.1),
    "feet": (0.3048, 0.1),
}
# The scale of a monocular estimate is often as near to a foot, so this adds to its spread.
_FOOT_OF_GROUNDTRUTH = 0.015
_FAST_M = 200.0  # in a short motion: no body that is localised is as fast
_STEADY_GAIN = 0.8
# Ratios of a plane's thickness and a line's width to the length; rotation about the normal.
_PLANE, _LINE, _ONE_AXIS, _SAME_AXIS = 0.15, 0.2, 0.75, 0.9
_LEAST_TILT_DEG, _AXIS_DEG = 12.0, 5.0
_AGREE, _AGREE_WELL = 0.7, 0.85
# Least rotation of the body, deg: if a rotation of the world fits much worse, and otherwise.
_BODY_DEG, _BODY_OR_WORLD_DEG = 5.0, 25.0
_LEAST_LEVER, _SURE_LEVER, _LEAST_SHARE = 0.02, 0.05, 0.3
_THIRDS = 3
_BY_SCALE = 0.5
# A mistake is constant, and drift is not: largest difference between a third of the run and the
# whole run, as a fraction of the value.
_ALIKE = 0.35


def scale(as_read: Hypothesis, moving: ShortMotions, gauge: Gauge) -> Examined:
    """Compare the distances that both sides move in the same time."""
    name = "scale"
    if as_read.moving <= 0.8:
        return Examined(name, why_not="displacements do not agree")
    found, spread = scale_of(moving)
    true, ours = moving.true_steps, moving.steps @ as_read.turned.T
    gain = _removed(true - ours, true - found * ours)
    off = abs(float(np.log(found)))
    scores = {"scale": found, "spread": spread, "gain": gain}
    values: dict[str, Value] = {"scale": found, "or_feet": "", "or_convert": "", "gauge": "sim3"}
    if off <= _OFF:
        return Examined(name, scores)
    if off > _DIVERGED:
        moved = {"true_m": float(lengths(true).sum()), "moved_m": float(lengths(ours).sum())}
        return Examined(name, scores, (Seen("diverged_at_start", 1.0, {"until": "", **moved}),))
    unit = _unit_of(found, spread, moving)
    if unit is not None and (unit["side"], unit["unit"]) == ("groundtruth", "feet"):
        # A monocular estimate may have this scale, too.
        convert = " (--gauge sim3), or convert feet: trajeval trajectory SOURCE --scale 0.3048"
        values |= {
            "or_feet": ", or with groundtruth in feet", "or_convert": convert, "gauge": ""
        }  # fmt: skip
        unit = None
    # An alignment with scale hides the unit of the estimate, and not of the groundtruth.
    shows = gain > 0.5
    if unit is not None and gauge.has_scale:
        shows = unit["side"] == "groundtruth" and _is_fast(moving.true_steps)
    if unit is not None and shows:
        return Examined(name, scores, (Seen("unit", gain, {**values, **unit}),))
    if gauge.has_scale:
        return Examined(name, scores, why_not="the alignment removes the scale")
    if gain > _STEADY_GAIN and spread < 0.5 * off:
        parts = [scale_of(each)[0] for each in moving.thirds]
        scores["thirds_apart"] = max(abs(float(np.log(each / found))) for each in parts) / off
    if scores.get("thirds_apart", np.inf) < _ALIKE:
        return Examined(name, scores, (Seen("scale", gain, values),))
    return Examined(name, scores)


def _unit_of(scale: float, spread: float, moving: ShortMotions) -> dict[str, Value] | None:
    """Return the unit of one side, from metres per unit of the estimate; None for no unit."""
    for name, (metres, within) in _UNITS.items():
        for side, found in (("estimate", scale), ("groundtruth", 1.0 / scale)):
            if (side, name) == ("groundtruth", "feet"):
                within = min(within, math.hypot(spread, _FOOT_OF_GROUNDTRUTH))
            if abs(float(np.log(found / metres))) > within:
                continue
            # Millimetres of one side are kilometres of the other.
            steps = moving.steps if side == "estimate" else moving.true_steps
            if name == "millimetres" and not _is_fast(steps):
                other = "groundtruth" if side == "estimate" else "estimate"
                return {"side": other, "unit": "kilometres", "factor": "1000"}
            return {"side": side, "unit": name, "factor": f"{metres:g}"}
    return None


def _is_fast(steps: Floats) -> bool:
    size = lengths(steps)
    return median(size[size >= median(size)]) > _FAST_M


def scale_of(moving: ShortMotions) -> tuple[float, float]:
    """Return metres per unit of the estimate, and half the spread of its logarithm."""
    true, ours = lengths(moving.true_steps), lengths(moving.steps)
    large = true > median(true)
    if not large.any():
        return 1.0, np.inf
    ratios = true[large] / np.maximum(ours[large], 1e-12)
    ordered = np.sort(np.log(ratios))
    return median(ratios), (quantile(ordered, 0.8) - quantile(ordered, 0.2)) / 2.0


def vertical(
    as_read: Hypothesis, moving: ShortMotions, turning: ShortMotions, gauge: Gauge, ups: Ups
) -> Examined:
    """Compare the vertical axes, if the alignment does not include roll and pitch.

    Axes of the sides, with the axes `ups`, are named as in their files.
    """
    name = "vertical axes"
    if not gauge.turns_about_gravity_only:
        return Examined(name, why_not="the alignment includes roll and pitch, or no rotation")
    kinds = 1.0 if moving.groundtruth_turned is None else 2.0
    if kinds - as_read.cost <= _AGREE * kinds:
        return Examined(name, why_not="motions do not agree")
    turned = as_read.turned
    tilt_deg = _degrees(turned[2, 2])
    scores = {"tilt_deg": tilt_deg}
    if tilt_deg <= _LEAST_TILT_DEG or kinds - as_read.cost <= _AGREE_WELL * kinds:
        return Examined(name, scores)
    parts = [each.world()[2] for each in moving.thirds]
    apart_deg = max(_degrees(each @ turned[2]) for each in parts)
    limit_deg = max(_AXIS_DEG, apart_deg)
    both = _shared_vertical(turned, turning, limit_deg, ups)
    if both is not None:
        return Examined(name, scores, (both,))
    # The vertical of a side in the frame of the other side: one of its axes, if that is wrong.
    upward = {"estimate": turned[2], "groundtruth": turned[:, 2]}
    found = [
        _up_axis(side, nearest_axis(up), _degrees(np.abs(up).max()), tilt_deg, ups)
        for side, up in upward.items()
        if nearest_axis(up) != "z" and _degrees(np.abs(up).max()) <= limit_deg
    ]
    if not found:
        scores["thirds_apart"] = apart_deg / tilt_deg
        values: dict[str, Value] = {"tilt_deg": tilt_deg}
        seen = (Seen("tilted", 1.0, values),) if scores["thirds_apart"] < _ALIKE else ()
        return Examined(name, scores, seen)
    if nearest_axis(turned[2]) == "-z":  # in a plane, a left-handed path has the same motions
        flipped = dataclasses.replace(as_read, axes=np.diag([1.0, 1.0, -1.0]))
        agreement: Value = 100.0 * (1.0 - as_read.cost / kinds)
        values = {"axes": mirror(flipped, moving), "agreement": agreement, "as_read": agreement}
        rivals = (found[0], Seen("mirrored", 1.0, values))
        tie = Seen("up_axis_or_mirrored", 1.0, found[0].values, rivals)
        return Examined(name, scores, (tie,))
    return Examined(name, scores, (dataclasses.replace(found[0], rivals=tuple(found)),))


def _up_axis(side: str, axis: str, off_deg: float, tilt_deg: float, ups: Ups) -> Seen:
    """Return the finding that an axis of a side's frame is vertical."""
    called = {"-y": ", as in a camera's (x right, y down, z forward)", "-z": ", as in NED"}
    both = [
        _in_file(axis if each == side else "z", up)
        for each, up in zip(("groundtruth", "estimate"), ups, strict=True)
    ]
    own = both[side == "estimate"]
    values: dict[str, Value] = {
        "side": side,
        "axis": own,
        "axes_up": ",".join(both),
        "off_deg": off_deg,
        "tilt_deg": tilt_deg,
        "called": called.get(own, ""),
    }
    return Seen("up_axis", 1.0, values)


def _in_file(axis: str, up: UpAxis) -> str:
    """Return an axis, such as -y, of a frame with an up axis as it is in the file."""
    row = up.applied["xyz".index(axis[-1])]
    return nearest_axis(-row if axis.startswith("-") else row)


def _shared_vertical(
    turned: Floats, turning: ShortMotions, limit_deg: float, ups: Ups
) -> Seen | None:
    """Return the finding that x or y is vertical in both frames, if the body turns about it."""
    if turning.turns is None:
        return None
    about = np.linalg.svd(bounded(turning.turns[0]), full_matrices=False)[2][0]
    for axis in (1, 0):
        if abs(about[axis]) > _SAME_AXIS and _degrees(abs(turned[axis, axis])) < limit_deg:
            return _sideways(axis, turned, ups)
    return None


def _sideways(axis: int, turned: Floats, ups: Ups) -> Seen:
    """Return the finding that an axis is vertical, with the gauge that corrects it, too.

    `turned` (3, 3) is the rotation from the estimate's world to the groundtruth's.
    """
    up, down = (_in_file(each + "xyz"[axis], ups[0]) for each in ("", "-"))
    said = (
        f"{_in_file('z', ups[0])} is not the vertical axis of the groundtruth's frame: the body "
        f"turns about {up.lstrip('-')}; set --up={down} or --up={up}"
    )
    other = _in_file(nearest_axis(-turned[axis]), ups[1])
    by_up, by_gauge = (
        Seen("groundtruth_up_axis", 1.0, {"said": said, "ups": axes, "gauge": gauge})
        for axes, gauge in ((f"{down},{other}", ""), ("", "se3"))
    )
    return dataclasses.replace(by_up, rivals=(by_up, by_gauge))


def groundtruth_plane(
    as_read: Hypothesis, moving: ShortMotions, turning: ShortMotions, gauge: Gauge, ups: Ups
) -> Examined:
    """Test whether the groundtruth moves perpendicular to and rotates about x or y."""
    name = "plane of the groundtruth"
    if not gauge.turns_about_gravity_only or turning.turns is None:
        return Examined(
            name, why_not="the alignment includes roll and pitch, or orientations are missing"
        )
    _, sizes, across = np.linalg.svd(bounded(moving.true_steps), full_matrices=False)
    turns, about = np.linalg.svd(bounded(turning.turns[0]), full_matrices=False)[1:]
    normal = across[2]
    nearest = int(np.argmax(np.abs(normal)))
    scores = {
        "thickness": float(sizes[2] / max(sizes[0], 1e-300)),
        "about_one_axis": float(turns[0] ** 2 / max(float(np.sum(turns**2)), 1e-300)),
        "off_deg": _degrees(abs(normal[nearest])),
        "axes_agree": abs(float(about[0] @ normal)),
    }
    sideways = (
        scores["thickness"] < _PLANE
        and sizes[1] > _LINE * sizes[0]
        and nearest != 2
        and scores["off_deg"] < _LEAST_TILT_DEG
        and scores["about_one_axis"] > _ONE_AXIS
        and scores["axes_agree"] > _SAME_AXIS
    )
    if not sideways:
        return Examined(name, scores)
    return Examined(name, scores, (_sideways(nearest, as_read.turned, ups),))


def body(as_read: Hypothesis, moving: ShortMotions) -> Examined:
    """Test for a constant rotation between the axes of the bodies."""
    name = "body axes"
    if moving.groundtruth_turned is None or moving.estimate_turned is None:
        return Examined(name, why_not="one side has no orientations")
    if as_read.turning <= 0.8 or as_read.cost >= 2.0 * (1.0 - _AGREE):
        return Examined(name, why_not="motions do not agree")
    true, aligned = _aligned(moving, as_read.turned)
    mean, rest = _constant(lie.multiply(lie.conjugate(aligned), true))
    angle = float(np.degrees(lie.angle(mean)))
    # A rotation of the world has the same effect, unless the body rotates.
    worlds = _constant(lie.multiply(true, lie.conjugate(aligned)))[1]
    scores = {"angle_deg": angle, "rest_deg": rest, "rest_of_worlds_deg": worlds}
    limit = _BODY_DEG if worlds > 2.0 * rest else _BODY_OR_WORLD_DEG
    if angle <= limit or rest >= angle / 3.0:
        return Examined(name, scores)
    # Drift rotates the world, so the world of every third is fitted separately.
    apart = []
    for each in moving.thirds:
        true, aligned = _aligned(each, each.world())
        part = mean_rotation(lie.multiply(lie.conjugate(aligned), true))
        apart.append(lie.angle(lie.multiply(lie.conjugate(mean), part)))
    scores["thirds_apart"] = float(np.degrees(max(apart))) / angle
    if scores["thirds_apart"] >= _ALIKE:
        return Examined(name, scores)
    values: dict[str, Value] = {"angle_deg": angle, "rest_deg": rest}
    return Examined(name, scores, (Seen("body", 1.0 - (rest / angle) ** 2, values),))


def lever_arm(as_read: Hypothesis, moving: ShortMotions) -> Examined:
    """Fit d_groundtruth - s W d_estimate = (R_end - R_start) l to all motions and to thirds."""
    name = "lever arm"
    if moving.estimate_turned is None:
        return Examined(name, why_not="one side has no orientations")
    if as_read.turning <= 0.8 or as_read.cost >= 2.0 * (1.0 - _AGREE):
        return Examined(name, why_not="motions do not agree")
    ratio, ours = scale_of(moving)[0], moving.steps @ as_read.turned.T
    found = ratio if abs(np.log(ratio)) > 0.1 else 1.0
    left = moving.true_steps - found * ours
    by_scale = _removed(moving.true_steps - ours, moving.true_steps - ratio * ours)
    # On a circle, a scale error equals a lever arm to the centre.
    if found == 1.0 and by_scale > _BY_SCALE:
        return Examined(name, {"by_scale": by_scale}, why_not="a scale explains the same error")
    swing = as_read.turned @ np.diff(lie.to_matrix(moving.estimate_turned), axis=0)[0]
    size = lengths(left)
    keep = size < 6.0 * median(size) + 1e-9
    lever = np.zeros(3)
    for _ in range(2):  # the second time without outliers of the first fit
        lever = _least_squares(swing[keep], left[keep], 1e-4)
        size = lengths(left - swing @ lever)
        keep = size < 6.0 * median(size) + 1e-9
    rest = left - swing @ lever
    share = _removed(left[keep], rest[keep])
    length = float(np.linalg.norm(lever))
    if length <= _LEAST_LEVER or share <= _LEAST_SHARE:
        return Examined(name, {"lever_m": length, "share": share})
    parts = [each for each in np.array_split(np.flatnonzero(keep), _THIRDS) if len(each) > 10]
    worst = 1.0 - min(_removed(left[each], rest[each]) for each in parts or [np.flatnonzero(keep)])
    levers = [_least_squares(swing[each], left[each], 1e-3) for each in parts]
    apart = max((float(lengths(each - lever)) for each in levers), default=np.inf)
    apart /= max(length, 1e-9)
    scores = {"lever_m": length, "share": share, "worst_third": worst, "apart": apart}
    explains = share > 0.7 and worst < 0.6
    agrees = apart < _ALIKE and length > _SURE_LEVER
    if not (explains or agrees):
        return Examined(name, scores)
    values: dict[str, Value] = {"lever_m": length, "percent": 100.0 * share}
    return Examined(name, scores, (Seen("lever_arm", share, values),))


def _least_squares(swing: Floats, left: Floats, damping: float) -> Floats:
    rows = swing.reshape(-1, 3)
    normal = rows.T @ rows
    if np.linalg.cond(normal) > 1.0 / damping:
        normal = normal + np.eye(3) * max(float(np.trace(normal)), 1e-12) * damping
    return np.asarray(np.linalg.solve(normal, rows.T @ left.ravel()))


def _removed(before: Floats, after: Floats) -> float:
    """Return the fraction of the squared lengths of vectors (N, 3) that is removed."""
    return 1.0 - float(np.sum(after**2)) / max(float(np.sum(before**2)), 1e-300)


def _aligned(moving: ShortMotions, turned: Floats) -> tuple[Floats, Floats]:
    """Return the orientations (N, 4) of both bodies at the starts of N motions, in one world."""
    assert moving.groundtruth_turned is not None
    assert moving.estimate_turned is not None
    aligned = lie.multiply(lie.from_matrix(turned), moving.estimate_turned[0])
    return moving.groundtruth_turned[0], aligned


def _constant(quaternions: Floats) -> tuple[Floats, float]:
    """Return the mean (4,) of N rotations, (N, 4), and the median of their angles to it, deg."""
    mean = mean_rotation(quaternions)
    rest = lie.angle(lie.multiply(lie.conjugate(mean), quaternions))
    return mean, float(np.degrees(median(rest)))


def _degrees(cosine: float) -> float:
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
