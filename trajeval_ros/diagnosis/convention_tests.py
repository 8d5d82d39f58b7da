"""Test of conventions: whether another convention fits much better than the one that was read."""

from __future__ import annotations

import numpy as np

from trajeval_ros.diagnosis.clock_tests import SMALL_S
from trajeval_ros.diagnosis.evidence import Examined, Seen, Value
from trajeval_ros.diagnosis.hypotheses import (
    AXES_MIXED,
    BOTH,
    ESTIMATE,
    GROUNDTRUTH,
    INVERSE,
    MIRRORED,
    TRANSPOSED,
    WXYZ,
    WXYZ_TRANSPOSED,
    Hypothesis,
    body_angle,
    mean_rotation,
    mirrored_quaternions,
    shorter_if_inverted,
)
from trajeval_ros.diagnosis.rates import ClockMatch
from trajeval_ros.diagnosis.short_motions import ShortMotions, turned_in_body
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats

NAME = "conventions"
# Of J, per kind of motion: least value as read, largest value and ratio of the other one.
_WRONG, _RIGHT, _RATIO = 0.004, 0.2, 0.4
_TIE, _TIE_SHARE = 0.02, 0.15
_UNLIKE, _UNLIKE_RATES, _LONG_S = 0.5, 0.7, 15.0
# No convention changes the angle of a rotation.
_TURNS_LESS, _TURNS_MORE, _TURNS_ALIKE = 0.6, 1.6, 0.4
_SAME_BODY_DEG, _OTHER_BODY_DEG = 20.0, 50.0
_CHANGE = 0.02  # least decrease of J per change


def conventions(
    hypotheses: list[Hypothesis],
    moving: ShortMotions,
    turning: ShortMotions,
    match: ClockMatch | None,
) -> Examined:
    """Return the convention that the motions have, if it is not the one that was read.

    Args:
        hypotheses: As `fit_hypotheses` returns them.
        moving: Motions of the displacements that they were fitted to.
        turning: Motions of the rotations that they were fitted to.
        match: Match of the rates of motion; None without timestamps.
    """
    as_read, others = hypotheses[0], hypotheses[1:]
    kinds = 1 if turning.truth_turned is None else 2
    other = min(others, key=lambda each: each.cost + _CHANGE * each.changes)
    scores = _scores(hypotheses, kinds)
    if other.cost > _UNLIKE * kinds and as_read.cost > _UNLIKE * kinds:
        if match is not None and _is_of_another_run(match):
            values: dict[str, Value] = {"peak": match.peak, "agreement": _percent(as_read, kinds)}
            return Examined(NAME, scores, (Seen("other_run", 1.0, values),))
        return Examined(NAME, scores, why_not="the motions do not agree with any convention")
    if kinds == 2:
        assert turning.truth_turned is not None
        assert turning.estimate_turned is not None
        ratio = _total_turn(turning.estimate_turned) / _total_turn(turning.truth_turned)
        scores["turn_ratio"] = ratio
        alike = match is None or match.turning >= _TURNS_ALIKE
        if not (_TURNS_LESS < ratio < _TURNS_MORE and alike):
            return Examined(NAME, scores, why_not="the rotations differ too much")
    if as_read.cost <= _WRONG * kinds or other.cost >= _RIGHT * kinds:
        return Examined(NAME, scores)
    if other.cost >= _RATIO * as_read.cost:
        return Examined(NAME, scores)
    within = (1.0 + _TIE_SHARE) * other.cost + _TIE
    rivals = [each for each in others if each.cost < within]
    families = _families(rivals, moving)
    if len(families) > 1:
        families = _told_apart(families, rivals, moving)
    values = {"agreement": _percent(other, kinds), "as_read": _percent(as_read, kinds)}
    explained = 1.0 - other.cost / as_read.cost
    if len(families) > 1:
        names = [_NAMES[each] for each in sorted(families)]
        values["causes"] = " or ".join(names)
        return Examined(NAME, scores, (Seen("convention_tie", explained, values),))
    cause, sides = next(iter(families.items()))
    if cause in (MIRRORED, AXES_MIXED):
        best = min((each for each in rivals if each.cause == cause), key=lambda each: each.cost)
        values["axes"] = _flip(rivals, moving) if cause == MIRRORED else _axes(best)
    else:
        side = next(iter(sides)) if len(sides) == 1 else "one side"
        values |= {"side": side, **_MENDS[cause].get(side, _MENDS[cause][ESTIMATE])}
    return Examined(NAME, scores, (Seen(cause, explained, values),))


_NAMES = {
    WXYZ: "in the order w, x, y, z but read as x, y, z, w",
    TRANSPOSED: "with inverse rotations",
    WXYZ_TRANSPOSED: "in the order w, x, y, z with inverse rotations",
    INVERSE: "inverse (world in body)",
    MIRRORED: "left-handed",
    AXES_MIXED: "in different axes than the rotations",
}
_ORDERS = {ESTIMATE: "xyzw,wxyz", GROUNDTRUTH: "wxyz,xyzw", BOTH: "wxyz"}
_ROTATIONS = {
    ESTIMATE: "estimate-rotations",
    GROUNDTRUTH: "groundtruth-rotations",
    BOTH: "groundtruth-rotations,estimate-rotations",
}
_MENDS: dict[str, dict[str, dict[str, Value]]] = {
    WXYZ: {side: {"order": order} for side, order in _ORDERS.items()},
    TRANSPOSED: {side: {"inverse": what} for side, what in _ROTATIONS.items()},
    WXYZ_TRANSPOSED: {
        side: {"order": _ORDERS[side], "inverse": _ROTATIONS[side]} for side in _ORDERS
    },
    INVERSE: {side: {"inverse": side} for side in (ESTIMATE, GROUNDTRUTH)},
}


def _is_of_another_run(match: ClockMatch) -> bool:
    """Return whether the rates of motion hardly correlate.

    The rates of one run correlate most without an offset, even if the estimate is bad.
    """
    apart = abs(match.offset_s) > SMALL_S
    return apart and match.peak < _UNLIKE_RATES and match.overlap_s > _LONG_S


def _percent(hypothesis: Hypothesis, kinds: int) -> float:
    return 100.0 * (1.0 - hypothesis.cost / kinds)


def _scores(hypotheses: list[Hypothesis], kinds: int) -> dict[str, float]:
    """Return the costs, per kind of motion, by cause and side; of permutations the best."""
    scores: dict[str, float] = {}
    for each in hypotheses:
        name = f"{each.side} {each.cause}".strip()
        scores[name] = min(scores.get(name, np.inf), each.cost / kinds)
    return scores


def _total_turn(quaternions: Floats) -> float:
    angles = np.linalg.norm(turned_in_body(quaternions), axis=1)
    return max(float(np.minimum(angles, 3.0).sum()), 1e-12)


def _families(rivals: list[Hypothesis], moving: ShortMotions) -> dict[str, set[str]]:
    """Return the possible sides by cause."""
    families: dict[str, set[str]] = {}
    for each in rivals:
        families.setdefault(each.cause, set()).add(each.side)
    if {MIRRORED, AXES_MIXED} <= families.keys():
        families.pop(_less_usual(rivals))
    if len(families.get(INVERSE, ())) > 1:
        families[INVERSE] = {shorter_if_inverted(moving)}
    return families


def _less_usual(rivals: list[Hypothesis]) -> str:
    """Return which of mirrored and mixed axes needs more flips, if planar motion fits both.

    Poses that are mirrored as a whole fit if all three axes of the positions are flipped.
    """
    flips = dict.fromkeys((MIRRORED, AXES_MIXED), 3)
    for each in rivals:
        if each.cause in flips:
            flips[each.cause] = min(flips[each.cause], int(np.count_nonzero(each.axes < 0.0)))
            if (each.axes == -np.eye(3)).all():
                return AXES_MIXED
    return AXES_MIXED if flips[MIRRORED] <= flips[AXES_MIXED] else MIRRORED


def _told_apart(
    families: dict[str, set[str]], rivals: list[Hypothesis], moving: ShortMotions
) -> dict[str, set[str]]:
    """Return the causes with equal body axes, or the simplest, if either criterion decides."""
    if moving.truth_turned is None:
        return families
    angles = {
        cause: min(body_angle(each, moving) for each in rivals if each.cause == cause)
        for cause in families
    }
    least = min(angles, key=lambda cause: angles[cause])
    others = [angle for cause, angle in angles.items() if cause != least]
    if angles[least] < _SAME_BODY_DEG and min(others) > _OTHER_BODY_DEG:
        return {least: families[least]}
    fewest = min(each.changes for each in rivals)
    simple = {each.cause for each in rivals if each.changes == fewest} & families.keys()
    rest = [angles[cause] for cause in families if cause not in simple]
    if simple and min(rest, default=np.inf) > _OTHER_BODY_DEG:
        return {cause: families[cause] for cause in families if cause in simple}
    return families


def _flip(rivals: list[Hypothesis], moving: ShortMotions) -> str:
    """Return the option value that corrects a mirrored estimate."""
    mirrored = [each for each in rivals if each.cause == MIRRORED]
    whole = [each for each in mirrored if (each.axes == -np.eye(3)).all()]
    if not whole:  # only positions were flipped
        return _axes(min(mirrored, key=lambda each: each.cost))
    best, flips = whole[0], {}
    for axis in (1, 0, 2):  # the first of equals
        flip = np.eye(3)
        flip[axis, axis] = -1.0
        # Flips differ by rotations, which are part of the rotation of the world.
        world = best.turned @ best.axes @ flip
        turned_deg = float(np.degrees(np.arccos(np.clip(world[2, 2], -1.0, 1.0))))
        if moving.truth_turned is not None and moving.estimate_turned is not None:
            ours = mirrored_quaternions(moving.estimate_turned[0], flip)
            aligned = lie.multiply(lie.from_matrix(world), ours)
            mean = mean_rotation(lie.multiply(lie.conjugate(aligned), moving.truth_turned[0]))
            turned_deg += float(np.degrees(lie.angle(mean)))
        flips[axis] = turned_deg
    axis = min(flips, key=lambda each: round(flips[each] / 10.0))
    return ",".join(("-" if each == axis else "") + "xyz"[each] for each in range(3))


def _axes(hypothesis: Hypothesis) -> str:
    """Return the option value that corrects positions in other axes than the rotations."""
    words = []
    for row in hypothesis.axes:
        axis = int(np.argmax(np.abs(row)))
        words.append(("-" if row[axis] < 0.0 else "") + "xyz"[axis])
    return "positions=" + ",".join(words)
