"""Test of conventions: whether another convention fits much better than the one that was read.

No convention changes the lengths of displacements and rotation vectors, so their differences are
the noise that the right convention leaves. Several conventions can fit short motions, for example
in a plane. All of them are returned, and trials on the whole path select one.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from trajeval_ros.diagnosis.clock_tests import SMALL_S, ClockMatch
from trajeval_ros.diagnosis.findings import Examined, Seen, Value
from trajeval_ros.diagnosis.hypotheses import (
    AXES_MIXED,
    INVERSE,
    MIRRORED,
    TRANSPOSED,
    WXYZ,
    WXYZ_TRANSPOSED,
    Hypothesis,
    ShortMotions,
    as_written,
    bounded,
    fit_as_read,
    fit_others,
    improper_permutations,
    mean_rotation,
    moment,
    sizes_apart,
)
from trajeval_ros.diagnosis.input_pair import lengths
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.pose_conventions import mirrored_quaternions
from trajeval_ros.geometry.vertical_axis import nearest_axis

NAME = "conventions"
# Of J, per kind of motion: least value as read, largest value and ratio of the other one.
_WRONG, _RIGHT, _RATIO = 0.004, 0.2, 0.4
_INVERSE_RATIO = 0.25  # of inverse poses that leave more than the noise; a trial decides
# J of the right convention: at most this, plus a multiple of the differences of lengths. Noise
# changes a direction along two axes and a length along one, and drift changes directions only.
_FITS, _TIMES_SIZES = 0.03, 6.0
_TIE, _TIE_SHARE = 0.02, 0.15
_AGREE = 0.3  # of J as read, per kind of motion, that other tests can use
_UNLIKE, _UNLIKE_RATES, _LONG_S = 0.5, 0.7, 15.0
# No convention changes the angle of a rotation.
_TURNS_LESS, _TURNS_MORE, _TURNS_ALIKE = 0.6, 1.6, 0.4
_THIRDS = 3
_TURNS_TOGETHER = 0.6  # least correlation of angular rates that are not noise
_DISAGREE, _TURNING_RAD = 0.15, 0.03  # of J of rotations alone, and mean rotation in a motion
# Radians that were read as degrees are 0.017, and smaller ratios are of a side that never turns.
_MUCH_LESS, _CONSTANT = 0.1, 1e-3
_CHANGE = 0.02  # least decrease of J per change
_MOST_OPTIONS = 3  # to try, per cause and side

# How the rotations are written, as text, with values of the options that correct it.
_NAMES = {
    WXYZ: "in the order w, x, y, z but read as x, y, z, w",
    TRANSPOSED: "inverse",
    WXYZ_TRANSPOSED: "in the order w, x, y, z and inverse",
    INVERSE: "inverse (positions, too)",
    MIRRORED: "left-handed",
    AXES_MIXED: "in different axes than the positions",
}


def conventions(
    as_read: Hypothesis, moving: ShortMotions, turning: ShortMotions, match: ClockMatch | None
) -> Examined:
    """Return the convention that the motions have, if it is not the one that was read."""
    kinds = 1 if turning.turns is None else 2
    others = fit_others(moving, turning) if as_read.cost > _WRONG * kinds else []
    other = _best(others or [as_read])
    scores = _scores([as_read, *others], kinds)
    unlike = other.cost > _UNLIKE * kinds and as_read.cost > _UNLIKE * kinds
    if unlike and match is not None and _is_of_another_run(match):
        values: dict[str, Value] = {"peak": match.peak, "agreement": _percent(as_read, kinds)}
        return Examined(NAME, scores, (Seen("other_run", 1.0, values),))
    limits = [_limit(moving.true_steps, moving.steps)]
    if turning.turns is not None:
        limits.append(_limit(*turning.turns))
        scores["turn_ratio"] = _total_turn(turning.turns[1]) / _total_turn(turning.turns[0])
        # Constant rates do not correlate.
        alike = match is None or not match.turning < _TURNS_ALIKE or _fits(as_read, limits)
        if not (_TURNS_LESS < scores["turn_ratio"] < _TURNS_MORE and alike):
            found = _rotations(as_read, limits, moving, turning, match, scores, alike=False)
            return Examined(NAME, scores, found, "" if found else "the rotations differ too much")
    if not others or (other.cost >= _RATIO * as_read.cost and _fits(as_read, limits)):
        found = _tilts(as_read, turning, scores) if kinds == 2 else ()
        return Examined(NAME, scores, found)
    explains = _explains(other, as_read, limits)
    if kinds == 2 and not (explains and other.cost <= _WRONG * kinds):
        composed = fit_others(moving, turning, composed=True)
        scores["composed"] = _best(composed).cost / kinds
        if not explains or _best(composed).cost < _RATIO * other.cost:
            others, other = composed, _best(composed)
    # What remains if no convention fits, or if no correction helps.
    rest: tuple[Seen, ...] = ()
    if kinds == 2:
        rest = _rotations(as_read, limits, moving, turning, match, scores, alike=True)
    if not _explains(other, as_read, limits):
        agree = rest or as_read.cost < _AGREE * kinds
        why_not = "" if agree else "the motions do not agree with any convention"
        return Examined(NAME, scores, rest, why_not)
    within = (1.0 + _TIE_SHARE) * other.cost + _TIE
    fitting = [each for each in others if each.cost < within and _explains(each, as_read, limits)]
    shared: dict[str, Value] = {
        "agreement": _percent(other, kinds),
        "as_read": _percent(as_read, kinds),
    }
    explained = 1.0 - other.cost / as_read.cost
    seen = _seen(fitting, moving, explained, shared)
    rivals = (*(seen.rivals or (seen,)), *rest)
    return Examined(NAME, scores, (dataclasses.replace(seen, rivals=rivals),))


def _best(hypotheses: list[Hypothesis]) -> Hypothesis:
    return min(hypotheses, key=lambda each: each.cost + _CHANGE * each.changes)


def _explains(hypothesis: Hypothesis, as_read: Hypothesis, limits: list[float]) -> bool:
    """Return whether a hypothesis leaves only the noise, and far less than what was read.

    Only inverse poses have displacements of other lengths. Therefore they may leave more than the
    noise, such as the effect of a clock offset.
    """
    if _fits(hypothesis, limits):
        return hypothesis.cost < _RATIO * as_read.cost
    return hypothesis.cause == INVERSE and hypothesis.cost < _INVERSE_RATIO * as_read.cost


def _limit(one: Floats, other: Floats) -> float:
    return min(_noise(one, other), _RIGHT)


def _noise(one: Floats, other: Floats) -> float:
    return _FITS + _TIMES_SIZES * sizes_apart(one, other)


def _fits(hypothesis: Hypothesis, limits: list[float]) -> bool:
    """Return whether a hypothesis leaves no more than the noise."""
    if hypothesis.cause == INVERSE:  # whose displacements have other lengths
        limits = [_RIGHT, *limits[1:]]
    left = [1.0 - hypothesis.moving, 1.0 - hypothesis.turning]
    return all(each <= limit for each, limit in zip(left, limits, strict=False))


def _rotations(
    as_read: Hypothesis,
    limits: list[float],
    moving: ShortMotions,
    turning: ShortMotions,
    match: ClockMatch | None,
    scores: dict[str, float],
    *,
    alike: bool,
) -> tuple[Seen, ...]:
    """Return the finding about rotations that no convention explains, if positions agree."""
    assert turning.turns is not None
    turned = turning.turns[0] if alike else max(turning.turns, key=_total_turn)
    # The rotations of a body that hardly turns are noise, unless its angular rates correlate.
    turns = _total_turn(turned) >= _TURNING_RAD * len(turning) or (
        match is not None and match.turning > _TURNS_TOGETHER
    )
    scores["positions_alone"] = as_read.moving_alone
    if 1.0 - as_read.moving_alone > limits[0] or not (turns or alike):
        return ()
    # Outliers are in a part of the run, and a mistake is in all of it.
    parts = zip([moving, *moving.thirds], [turning, *turning.thirds], strict=True)
    fits = [fit_as_read(*part) for part in parts if min(map(len, part)) > 0]
    left = [each.cost - (1.0 - each.moving_alone) for each in fits]
    if alike and not (turns and min(left) >= max(_DISAGREE, 2.0 * limits[1])):
        return _tilts(as_read, turning, scores)
    ratio = scores["turn_ratio"]
    how, check = "", "order and signs of Euler angles; a compass heading is clockwise"
    if not alike:
        how = f" (angles {ratio:.3g} times as large)"
        check = "order and unit of Euler angles"
        if not _CONSTANT < ratio < 1.0 / _CONSTANT:
            side = "estimate" if ratio < 1.0 else "groundtruth"
            how, check = f" (those of the {side} are constant)", "columns of the orientations"
        elif ratio < _MUCH_LESS:
            check = "radians were probably read as degrees"
        elif ratio > 1.0 / _MUCH_LESS:
            check = "degrees were probably read as radians"
    return _disagreeing(as_read, 1.0 - left[0], ratio, how, check)


def _disagreeing(
    as_read: Hypothesis, agree: float, ratio: float, how: str, check: str
) -> tuple[Seen, ...]:
    """Return the finding that the rotations agree less than the positions."""
    values: dict[str, Value] = {
        "how": how,
        "check": check,
        "positions": 100.0 * as_read.moving_alone,
        "rotations": 100.0 * max(agree, 0.0),
        "turn_ratio": ratio,
    }
    return (Seen("rotations", 1.0 - max(agree, 0.0), values),)


def _tilts(
    as_read: Hypothesis, turning: ShortMotions, scores: dict[str, float]
) -> tuple[Seen, ...]:
    """Return the finding about roll and pitch, which are small beside the yaw of a vehicle."""
    changes = _changes_of_tilts(as_read.turned, turning)
    parts = [changes, *np.array_split(changes, _THIRDS, axis=1)]
    left = [1.0 - _rotated(moment(*each)) for each in parts]
    scores["tilts"], scores["tilts_apart"] = 1.0 - left[0], sizes_apart(*changes)
    if min(left) < max(_DISAGREE, 2.0 * _noise(*changes)):
        return ()
    check = "order and signs of Euler angles"
    return _disagreeing(as_read, 1.0 - left[0], scores["turn_ratio"], " (roll and pitch)", check)


def _rotated(both: Floats) -> float:
    """Return the largest trace of W^T H over rotations W in the plane, of a moment H (2, 2)."""
    return float(np.hypot(both[0, 0] + both[1, 1], both[1, 0] - both[0, 1]))


def _changes_of_tilts(turned: Floats, turning: ShortMotions) -> Floats:
    """Return the changes (2, N, 2) of the sides' tilts, with limited lengths.

    Tilts are directions of the axis that the body turns about, as seen from the body. Within a
    short motion, they change more by the motion than by drift. Other axes of the body rotate them.
    """
    assert turning.turns is not None
    assert turning.groundtruth_turned is not None
    assert turning.estimate_turned is not None
    turns = bounded(turning.turns[0])
    axis = np.linalg.eigh(turns.T @ turns)[1][:, -1]
    changes = []
    true, ours = turning.groundtruth_turned, turning.estimate_turned
    for quaternions, about in ((true, axis), (ours, axis @ turned)):
        seen = lie.rotate(lie.conjugate(quaternions), about)
        mean = seen.mean(axis=(0, 1))
        across = np.linalg.svd(mean[None])[2][1:]
        across[0] *= np.sign(np.linalg.det([*across, mean]))
        changes.append(bounded((seen[1] - seen[0]) @ across.T))
    return np.stack(changes)


def _seen(
    fitting: list[Hypothesis], moving: ShortMotions, explained: float, shared: dict[str, Value]
) -> Seen:
    """Return the cause, with all options to try, or the tie between several causes."""
    fitting = sorted(fitting, key=lambda each: (each.changes, round(each.cost, 2), each.flips))
    found: list[Seen] = []
    counts: dict[tuple[str, str], int] = {}
    for each in fitting:
        key = each.cause, each.side
        counts[key] = counts.get(key, 0) + 1
        if counts[key] <= _MOST_OPTIONS:
            found += [
                option
                for option in _options(each, moving, explained, shared)
                if option not in found
            ]
    first, causes = found[0], sorted({each.cause for each in found})
    if len(found) == 1:
        return first
    if len(causes) > 1:
        names = " or ".join(_NAMES.get(each, "several of these") for each in causes)
        return Seen("convention_tie", explained, {**shared, "causes": names}, tuple(found))
    sides = {str(each.values["side"]) for each in found}
    values = {**first.values, "side": "one side"} if len(sides) > 1 else first.values
    return Seen(first.cause, explained, values, tuple(found))


def _options(
    hypothesis: Hypothesis, moving: ShortMotions, explained: float, shared: dict[str, Value]
) -> list[Seen]:
    """Return what corrects a hypothesis, to try."""
    cause = hypothesis.cause
    values: dict[str, Value] = {**shared, "side": hypothesis.side}
    if (hypothesis.axes == np.eye(3)).all():
        return [Seen(cause, explained, values)]
    axes = hypothesis.axes
    options = [(AXES_MIXED, "positions=" + _axes(axes))]
    if np.linalg.det(axes) > 0.0:
        options.append((AXES_MIXED, "rotations=" + _axes(axes.T)))
    else:
        options.append((MIRRORED, mirror(hypothesis, moving)))
    if cause in _WRITTEN_AS:
        order, inverse = _WRITTEN_AS[cause]
        values |= {"causes": _NAMES[cause], "order": order, "inverse": inverse}
        options = [("conventions", option) for _, option in options]
    return [Seen(name, explained, {**values, "axes": option}) for name, option in options]


# Values of the options that correct how rotations are written: order, and inverse.
_WRITTEN_AS = {
    WXYZ: ("wxyz", ""),
    TRANSPOSED: ("", "rotations"),
    WXYZ_TRANSPOSED: ("wxyz", "rotations"),
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


def _total_turn(turns: Floats) -> float:
    return max(float(np.minimum(lengths(turns), 3.0).sum()), 1e-12)


def mirror(hypothesis: Hypothesis, moving: ShortMotions) -> str:
    """Return the mirror of whole poses that leaves the least rotation of world and body.

    Mirrors differ by rotations, which are part of the rotation of the world and of the body.
    """
    best, least = np.eye(3), np.inf
    for mirror in improper_permutations():
        world = hypothesis.turned @ hypothesis.axes @ mirror.T
        turned_deg = float(np.degrees(np.arccos(np.clip(world[2, 2], -1.0, 1.0))))
        if moving.groundtruth_turned is not None and moving.estimate_turned is not None:
            true, ours = as_written(
                hypothesis, moving.groundtruth_turned[0], moving.estimate_turned[0]
            )
            aligned = lie.multiply(lie.from_matrix(world), mirrored_quaternions(ours, mirror))
            turned_deg += float(
                np.degrees(lie.angle(mean_rotation(lie.multiply(lie.conjugate(aligned), true))))
            )
        if round(turned_deg / 10.0) < least:
            best, least = mirror, round(turned_deg / 10.0)
    return _axes(best)


def _axes(permutation: Floats) -> str:
    """Return a signed permutation as the value of an option."""
    return ",".join(map(nearest_axis, permutation))
