"""Tests of scale, vertical axes, body axes and lever arms, after time and conventions."""

from __future__ import annotations

import numpy as np

from trajeval_ros.diagnosis.evidence import Examined, Seen, Value
from trajeval_ros.diagnosis.hypotheses import Hypothesis, mean_rotation
from trajeval_ros.diagnosis.motion_track import lengths
from trajeval_ros.diagnosis.short_motions import ShortMotions, bounded, turned_in_world
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.metrics.statistics import median, quantile

_OFF = 0.2  # of the logarithm of the scale
_UNITS = {1e-3: "estimate_mm", 1e3: "truth_mm"}
_UNIT_WITHIN, _STEADY_GAIN = 0.15, 0.8
# Ratios of a plane's thickness and a line's width to the length; rotation about the normal.
_PLANE, _LINE, _ONE_AXIS, _SAME_AXIS = 0.15, 0.2, 0.75, 0.9
_LEAST_TILT_DEG, _NEAR_AXIS_DEG = 12.0, 25.0
_FLAT, _SAME_HEIGHTS = 0.2, 0.5
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
    if gauge.has_scale:
        return Examined(name, why_not="the alignment removes the scale")
    if as_read.moving <= 0.8:
        return Examined(name, why_not="displacements do not agree")
    found, spread = scale_of(moving)
    true, ours = moving.true_steps, moving.steps @ as_read.turned.T
    before = float(np.sum((true - ours) ** 2))
    gain = 1.0 - float(np.sum((true - found * ours) ** 2)) / max(before, 1e-300)
    off = abs(float(np.log(found)))
    scores = {"scale": found, "spread": spread, "gain": gain}
    values: dict[str, Value] = {"scale": found}
    if off <= _OFF:
        return Examined(name, scores)
    for unit, cause in _UNITS.items():
        if abs(float(np.log(found / unit))) < _UNIT_WITHIN and gain > 0.5:
            return Examined(name, scores, (Seen(cause, gain, values),))
    if gain > _STEADY_GAIN and spread < 0.5 * off:
        parts = [scale_of(each)[0] for each in moving.thirds]
        scores["thirds_apart"] = max(abs(float(np.log(each / found))) for each in parts) / off
    if scores.get("thirds_apart", np.inf) < _ALIKE:
        return Examined(name, scores, (Seen("scale", gain, values),))
    return Examined(name, scores)


def scale_of(moving: ShortMotions) -> tuple[float, float]:
    """Return metres per unit of the estimate, and half the spread of its logarithm."""
    true, ours = lengths(moving.true_steps), lengths(moving.steps)
    large = true > median(true)
    if not large.any():
        return 1.0, np.inf
    ratios = true[large] / np.maximum(ours[large], 1e-12)
    ordered = np.sort(np.log(ratios))
    return median(ratios), (quantile(ordered, 0.8) - quantile(ordered, 0.2)) / 2.0


def vertical(as_read: Hypothesis, moving: ShortMotions, gauge: Gauge) -> Examined:
    """Compare the vertical axes, if the alignment does not include roll and pitch."""
    name = "vertical axes"
    if not gauge.turns_about_gravity_only:
        return Examined(name, why_not="the alignment includes roll and pitch, or no rotation")
    kinds = 1.0 if moving.truth_turned is None else 2.0
    if kinds - as_read.cost <= _AGREE * kinds:
        return Examined(name, why_not="motions do not agree")
    turned = as_read.turned
    tilt_deg = _degrees(turned[2, 2])
    scores = {"tilt_deg": tilt_deg}
    if tilt_deg <= _LEAST_TILT_DEG or kinds - as_read.cost <= _AGREE_WELL * kinds:
        return Examined(name, scores)
    # The vertical of a side in the frame of the other side: one of its axes, if that is wrong.
    sides = {"estimate": turned[2], "groundtruth": turned[:, 2]}
    side = max(sides, key=lambda each: round(float(np.abs(sides[each]).max()), 2))
    up = sides[side]
    nearest = int(np.argmax(np.abs(up)))
    axis = ("-" if up[nearest] < 0.0 else "") + "xyz"[nearest]
    off_deg = _degrees(abs(up[nearest]))
    values: dict[str, Value] = {
        "side": side,
        "axis": axis,
        "axes_up": f"z,{axis}" if side == "estimate" else f"{axis},z",
        "off_deg": off_deg,
        "tilt_deg": tilt_deg,
    }
    if axis == "z" or off_deg >= _NEAR_AXIS_DEG:
        parts = [each.world()[2] for each in moving.thirds]
        scores["thirds_apart"] = max(_degrees(each @ turned[2]) for each in parts) / tilt_deg
        seen = (Seen("tilted", 1.0, values),) if scores["thirds_apart"] < _ALIKE else ()
        return Examined(name, scores, seen)
    if axis == "-z":
        extents = np.linalg.svd(bounded(moving.true_steps), compute_uv=False)
        true, ours = moving.true_steps[:, 2], (moving.steps @ turned.T)[:, 2]
        true, ours = true - true.mean(), ours - ours.mean()
        alike = float(true @ ours) / max(float(lengths(np.array([true, ours])).prod()), 1e-30)
        scores["heights_alike"] = alike
        # In a plane, a left-handed path has the same motions as a path with z down.
        if extents[2] < _FLAT * extents[0] and alike < _SAME_HEIGHTS:
            cause = "mirrored" if alike < -_SAME_HEIGHTS else "up_axis_or_mirrored"
            values |= {"axes": "x,y,-z", "agreement": 100.0 * (1.0 - as_read.cost / kinds)}
            values["as_read"] = values["agreement"]
            return Examined(name, scores, (Seen(cause, 1.0, values),))
    called = {"-y": ", as in a camera's (x right, y down, z forward)", "-z": ", as in NED"}
    values["called"] = called.get(axis, "")
    return Examined(name, scores, (Seen("up_axis", 1.0, values),))


def groundtruth_plane(moving: ShortMotions, turning: ShortMotions, gauge: Gauge) -> Examined:
    """Test whether the groundtruth moves perpendicular to and rotates about x or y."""
    name = "plane of the groundtruth"
    if not gauge.turns_about_gravity_only or turning.truth_turned is None:
        return Examined(
            name, why_not="the alignment includes roll and pitch, or orientations are missing"
        )
    _, sizes, across = np.linalg.svd(bounded(moving.true_steps), full_matrices=False)
    turns, about = np.linalg.svd(
        bounded(turned_in_world(turning.truth_turned)), full_matrices=False
    )[1:]
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
    axis = "xyz"[nearest]
    said = (
        "z is not the vertical axis of the groundtruth's frame: the body moves perpendicular to "
        f"{axis} and turns about {axis}; set --up=-{axis} or --up={axis}"
    )
    return Examined(name, scores, (Seen("truth_up_axis", 1.0, {"said": said}),))


def body(as_read: Hypothesis, moving: ShortMotions) -> Examined:
    """Test for a constant rotation between the axes of the bodies."""
    name = "body axes"
    if moving.truth_turned is None or moving.estimate_turned is None:
        return Examined(name, why_not="one side has no orientations")
    if as_read.turning <= 0.8 or as_read.cost >= 2.0 * (1.0 - _AGREE):
        return Examined(name, why_not="motions do not agree")
    mean, rest = _constant(_between_bodies(moving, as_read.turned))
    angle = float(np.degrees(lie.angle(mean)))
    # A rotation of the world has the same effect, unless the body rotates.
    true = moving.truth_turned[0]
    aligned = lie.multiply(lie.from_matrix(as_read.turned), moving.estimate_turned[0])
    worlds = _constant(lie.multiply(true, lie.conjugate(aligned)))[1]
    scores = {"angle_deg": angle, "rest_deg": rest, "rest_of_worlds_deg": worlds}
    limit = _BODY_DEG if worlds > 2.0 * rest else _BODY_OR_WORLD_DEG
    if angle <= limit or rest >= angle / 3.0:
        return Examined(name, scores)
    # Drift rotates the world, so the world of every third is fitted separately.
    parts = [mean_rotation(_between_bodies(each, each.world())) for each in moving.thirds]
    apart = [lie.angle(lie.multiply(lie.conjugate(mean), each)) for each in parts]
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
    found = scale_of(moving)[0]
    found = found if abs(np.log(found)) > 0.1 else 1.0
    left = moving.true_steps - found * moving.steps @ as_read.turned.T
    ours = moving.steps @ as_read.turned.T
    by_scale = 1.0 - _squares(moving.true_steps - scale_of(moving)[0] * ours) / max(
        _squares(moving.true_steps - ours), 1e-300
    )
    # On a circle, a scale error equals a lever arm to the centre.
    if found == 1.0 and by_scale > _BY_SCALE:
        return Examined(name, {"by_scale": by_scale}, why_not="a scale explains the same error")
    start, end = (as_read.turned @ lie.to_matrix(each) for each in moving.estimate_turned)
    swing = end - start
    size = lengths(left)
    keep = size < 6.0 * median(size) + 1e-9
    lever = np.zeros(3)
    for _ in range(2):  # the second time without outliers of the first fit
        lever = _least_squares(swing[keep], left[keep], 1e-4)
        rest = lengths(left - swing @ lever)
        keep = rest < 6.0 * median(rest) + 1e-9
    before, after = left[keep], (left - swing @ lever)[keep]
    share = 1.0 - _squares(after) / max(_squares(before), 1e-300)
    length = float(np.linalg.norm(lever))
    if length <= _LEAST_LEVER or share <= _LEAST_SHARE:
        return Examined(name, {"lever_m": length, "share": share})
    parts = [each for each in np.array_split(np.flatnonzero(keep), _THIRDS) if len(each) > 10]
    worst = max(
        (_squares((left - swing @ lever)[each]) / max(_squares(left[each]), 1e-300))
        for each in parts or [np.flatnonzero(keep)]
    )
    apart = max(
        (
            float(np.linalg.norm(_least_squares(swing[each], left[each], 1e-3) - lever))
            for each in parts
        ),
        default=np.inf,
    ) / max(length, 1e-9)
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
    solved: Floats = np.linalg.solve(normal, rows.T @ left.ravel()).astype(np.float64)
    return solved


def _squares(vectors: Floats) -> float:
    return float(np.sum(vectors**2))


def _between_bodies(moving: ShortMotions, turned: Floats) -> Floats:
    """Return the rotations (N, 4) between the bodies' axes at the starts of N motions.

    Args:
        moving: With orientations of both sides.
        turned: Rotation (3, 3) from the estimate's world to the groundtruth's.
    """
    assert moving.truth_turned is not None
    assert moving.estimate_turned is not None
    aligned = lie.multiply(lie.from_matrix(turned), moving.estimate_turned[0])
    return lie.multiply(lie.conjugate(aligned), moving.truth_turned[0])


def _constant(quaternions: Floats) -> tuple[Floats, float]:
    """Return the mean (4,) of N rotations, (N, 4), and the median of their angles to it, deg."""
    mean = mean_rotation(quaternions)
    rest = lie.angle(lie.multiply(lie.conjugate(mean), quaternions))
    return mean, float(np.degrees(median(rest)))


def _degrees(cosine: float) -> float:
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
