"""Warnings about an evaluation, with instructions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.diagnosis.causes import CAUSES
from trajeval_ros.diagnosis.findings import Diagnosis
from trajeval_ros.diagnosis.fix_hints import about_projection
from trajeval_ros.diagnosis.jumps import Steps
from trajeval_ros.diagnosis.rotation_hints import about_freedom, about_poses
from trajeval_ros.diagnosis.unused_settings import about_unused
from trajeval_ros.formatting.numbers import counted, percent
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.dropped_counts import NO_STATE
from trajeval_ros.geometry.travelled import step_lengths
from trajeval_ros.geometry.up_axis import ASSUMED
from trajeval_ros.metrics.named_protocols import PROTOCOLS
from trajeval_ros.metrics.statistics import median

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory
    from trajeval_ros.metrics.association import Association
    from trajeval_ros.metrics.evaluation import Evaluation

LOW_COVERAGE = 0.9
LARGE_TILT_DEG = 10.0
_ENOUGH = 20_000  # states of a sample
# Of steps in time: least spread, least number, and the slope of steps in space over steps in time,
# which is 1 for sensor timestamps and 0 for arrival times.
_JITTER = 0.15
_FEWEST_STEPS = 100
_FOLLOWS = 0.2
_SPARSE_S = 0.12
# Reasons to drop a pose that do not depend on other poses or on the groundtruth.
_UNUSABLE = frozenset(NO_STATE) - {"duplicate_stamp"}
_BY_TIME = {
    "method": "--association",
    "max_time_difference_s": "--max-time-difference",
    "max_gap_s": "--max-gap",
    "time_offset_s": "--time-offset",
}
_REASONS = {
    "no_groundtruth_within_max_time_difference": "beyond the largest time difference to "
    "groundtruth",
    "no_groundtruth_of_this_frame": "in frames without groundtruth",
    "before_groundtruth": "before the groundtruth",
    "after_groundtruth": "after the groundtruth",
    "in_groundtruth_gap": "in a groundtruth gap",
    "before_estimate": "before the estimate",
    "after_estimate": "after the estimate",
    "in_estimate_gap": "in an estimate gap",
    "duplicate_stamp": "with a duplicate timestamp",
    "lone_stamp": "with an isolated timestamp",
    "zero_stamp": "with timestamp zero",
    "zero_quaternion": "with a zero quaternion",
    "undecodable": "that can't be decoded",
}


def reasons(dropped: Mapping[str, int]) -> str:
    """Return counts by reason in words: "3 not finite, 12 before the groundtruth"."""
    return ", ".join(
        f"{count} {_REASONS.get(reason, reason.replace('_', ' '))}"
        for reason, count in dropped.items()
    )


def completeness_in_words(evaluation: Evaluation) -> str:
    """Return the number of states of sparse groundtruth with an estimate, as text."""
    pairs, share = evaluation.association, evaluation.association.groundtruth_coverage
    what = {"gnss": "fixes", "points": "points"}.get(pairs.groundtruth.kind, "groundtruth poses")
    # A live run stores only pairs and their fraction of the states.
    states = round(len(pairs) / share)
    gap = pairs.coverage.longest_gap
    without = "" if gap is None else f", longest gap {gap}"
    return (
        f"{len(pairs)} of {states} {what} ({percent(share)}) along "
        f"{pairs.groundtruth.path_length_m:.1f} m have an estimate{without}"
    )


def warnings_of(evaluation: Evaluation, diagnosis: Diagnosis) -> tuple[str, ...]:
    """Return the warnings about a finished evaluation, the most severe one first.

    Findings of the diagnosis precede all others.
    """
    return (
        *(each.text for each in diagnosis.findings),
        *dict.fromkeys((*evaluation.groundtruth.damage, *evaluation.estimate.damage)),
        *evaluation.groundtruth.conflicts,
        *evaluation.estimate.conflicts,
        *_about_rows(evaluation),
        *_about_alignment(evaluation),
        *([] if _explains_jumps(diagnosis) else _about_jumps(evaluation)),
        *_about_rotations(evaluation),
        *_about_coverage(evaluation),
        *_about_relative_errors(evaluation),
        *_about_inputs(evaluation),
    )


def _about_alignment(evaluation: Evaluation) -> list[str]:
    warnings = [*about_freedom(evaluation), *about_poses(evaluation)]
    protocol, alignment = evaluation.protocol, evaluation.alignment
    if protocol.align_states is not None and alignment.states_used < protocol.align_states:
        warnings.append(
            f"aligned by all {alignment.states_used} pairs, fewer than the requested "
            f"{protocol.align_states}"
        )
    if protocol.ate_form == "tutorial":
        warnings.append(
            "the ATE form tutorial, eq. (23), depends on the choice of the origin; compare only "
            "results with the same form and origin"
        )
    truth_up, estimate_up = evaluation.groundtruth.up, evaluation.estimate.up
    known = ASSUMED not in (truth_up.origin, estimate_up.origin)
    if known and truth_up.name != estimate_up.name and protocol.gauge.minimum_states == 1:
        warnings.append(
            f"the vertical axes differ, groundtruth {truth_up} and estimate {estimate_up}, and "
            f"gauge {protocol.gauge.value} can't align them"
        )
    if protocol.align_states == 1:
        warnings += _about_first_state(evaluation)
    return warnings


def _about_rows(evaluation: Evaluation) -> list[str]:
    """Name the settings of an association by time that poses without timestamps do not have."""
    rule = evaluation.protocol.association
    if evaluation.association.rule.method != "index" or rule.method == "index":
        return []
    of_protocol = PROTOCOLS.get(evaluation.protocol.name, PROTOCOLS["default"]).association
    why = (
        "without timestamps on both sides, poses are paired by row; give timestamps, such as with "
        "--frame-rate"
    )
    return about_unused(rule, of_protocol, _BY_TIME, why)


def _about_first_state(evaluation: Evaluation) -> list[str]:
    """Detect a placeholder of the estimator: a jump after the first pose."""
    pairs = evaluation.association
    truth, other = pairs.groundtruth[:2].quaternions, pairs.estimate[:2].quaternions
    if len(pairs) < 3 or truth is None or other is None:
        return []
    turned = lie.angle(lie.multiply(lie.conjugate(other[0]), other[1]))
    true_turn = lie.angle(lie.multiply(lie.conjugate(truth[0]), truth[1]))
    jump_deg = float(np.degrees(np.abs(turned - true_turn)))
    if jump_deg < LARGE_TILT_DEG:
        return []
    return [
        f"from the first to the second pair the estimate rotates {jump_deg:.0f} deg more than "
        "the groundtruth: the first pose, used for the alignment, is probably a placeholder"
    ]


def _explains_jumps(diagnosis: Diagnosis) -> bool:
    """Return whether a more severe finding explains jumps."""
    graver = (each for each in diagnosis.findings if each.rank >= CAUSES["scale"].rank)
    # An estimate with most poses of the groundtruth may jump at the others.
    return any(each.cause != "identical" for each in graver)


def _about_jumps(evaluation: Evaluation) -> list[str]:
    truth, estimate = evaluation.association.groundtruth, evaluation.association.estimate
    steps = Steps.between(
        truth.positions,
        estimate.positions,
        truth.quaternions,
        estimate.quaternions,
        evaluation.alignment.similarity.scale,
    )
    if not len(steps.true_m):
        return []
    jumps = steps.jumps(median(steps.position_m), median(steps.rotation_deg))
    if not len(jumps):
        return []
    first = jumps[0]
    where = "once" if len(jumps) == 1 else f"at {len(jumps)} places"
    return [
        f"the estimate jumps {where}, first {truth.seconds[first + 1]:.1f} s after the first "
        f"pair, by {steps.position_m[first]:.2f} m and {steps.rotation_deg[first]:.0f} deg "
        "more than the groundtruth: after a restart with a new origin, one alignment can't "
        "fit both parts"
    ]


def _about_rotations(evaluation: Evaluation) -> list[str]:
    warnings = []
    pairs = evaluation.association
    without = [
        who
        for who, side in (("groundtruth", pairs.groundtruth), ("estimate", pairs.estimate))
        if side.quaternions is None
    ]
    if without:
        withheld = "rotation errors"
        if evaluation.segments is None and evaluation.protocol.lengths:
            withheld += " and relative errors"
        warnings.append(f"{withheld} withheld: no orientations in the {' and the '.join(without)}")
    return warnings


def _about_coverage(evaluation: Evaluation) -> list[str]:
    pairs = evaluation.association
    warnings = _about_unusable(pairs)
    if evaluation.score is not None:
        missing = evaluation.score.missing
        if missing:
            warnings.append(f"{counted(missing, 'point')} without an estimate, scored 0")
        return warnings
    if pairs.estimate_coverage is None:
        if pairs.groundtruth_coverage < LOW_COVERAGE:
            warnings.append(
                f"{completeness_in_words(evaluation)} (dropped: {reasons(pairs.dropped)}); "
                "compare only results at the same points"
            )
    elif min(pairs.estimate_coverage, pairs.groundtruth_coverage) < LOW_COVERAGE:
        why, coverage = reasons(pairs.dropped), pairs.coverage
        warnings.append(
            f"the {coverage.of_what} cover {100 * coverage.covered:.0f} % of the groundtruth's "
            f"time and {100 * pairs.estimate_coverage:.0f} % of the estimate's poses"
            + (f" (dropped: {why})" if why else "")
            + (f", {coverage.gap_in_words}" if coverage.longest_gap else "")
            + "; compare only runs with the same coverage"
        )
    return warnings


def _about_unusable(pairs: Association) -> list[str]:
    unusable = {each: count for each, count in pairs.dropped.items() if each in _UNUSABLE}
    count = sum(unusable.values())
    if not count or not pairs.estimate_coverage:
        return []
    share = count / (count + len(pairs) / pairs.estimate_coverage)
    if share <= 1.0 - LOW_COVERAGE:
        return []
    return [
        f"{percent(share)} of the estimate's poses are not usable and were dropped: "
        f"{reasons(unusable)}; correct the output of the estimator"
    ]


def _about_relative_errors(evaluation: Evaluation) -> list[str]:
    empty = [each.length for each in evaluation.segments or () if not each.count]
    path = evaluation.association.groundtruth
    whole = {"m": path.path_length_m, "s": path.duration_s}
    # A long path without a sub-trajectory has its states too far apart.
    sparse = [each.text for each in empty if each.value < 0.5 * whole.get(each.unit, 0.0)]
    short = [each.text for each in empty if each.text not in sparse]
    warnings = []
    if short:
        warnings.append(
            f"no sub-trajectories of {', '.join(short)}: the paired path has "
            f"{path.path_length_m:.1f} m in {path.duration_s:.1f} s"
        )
    if sparse:
        step_s, step_m = median(np.diff(path.seconds)), median(step_lengths(path.positions))
        warnings.append(
            f"no sub-trajectories of {', '.join(sparse)}: pairs are {step_s:.2g} s and "
            f"{step_m:.2g} m apart (median); use longer sub-trajectories"
        )
    return warnings


def about_frames(groundtruth: str, estimate: str) -> list[str]:
    """Return the warning about two bodies with different known names, if they differ."""
    if not groundtruth or not estimate or groundtruth == estimate:
        return []
    return [
        f"the groundtruth is of body {groundtruth!r} and the estimate of {estimate!r}: if the "
        "bodies differ, the errors include their lever arm and rotation"
    ]


def _about_inputs(evaluation: Evaluation) -> list[str]:
    truth, estimate = evaluation.groundtruth, evaluation.estimate
    # `fix_hints` has the warning about antennas.
    is_fix = truth.kind == "gnss"
    warnings = [] if is_fix else about_frames(truth.child_frame, estimate.child_frame)
    paired = evaluation.association.estimate
    for name, side in (("groundtruth", truth), ("estimate", paired)):
        warnings += about_projection(name, side)
        if _stamped_at_arrival(side):
            warnings.append(
                f"the {name}'s timestamps are probably arrival times: they have jitter, its "
                "motion has none; use sensor timestamps, and check for a constant delay with "
                "--time-offset auto"
            )
    if truth.dropped:
        warnings.append(f"groundtruth poses were dropped: {reasons(truth.dropped)}")
    return warnings


def _stamped_at_arrival(side: Trajectory) -> bool:
    """Return whether steps in time vary, and steps in space do not depend on them.

    A body with smooth motion moves twice as far in twice the time. If the distance does not depend
    on the timestamps, they are not the times of the poses.
    """
    some = slice(_ENOUGH)
    step_s, moved = np.diff(side.stamps[some]) / 1e9, np.diff(side.positions[some], axis=0)
    distance = np.linalg.norm(moved, axis=1)
    usual_s = median(step_s) if len(step_s) else 0.0
    # Steps with neighbours on both sides and without lost messages. A body at rest moves by noise.
    whole = (step_s > 0.1 * usual_s) & (step_s < 1.9 * usual_s)
    nearby_s, nearby = (step_s[:-2] + step_s[2:]) / 2.0, (distance[:-2] + distance[2:]) / 2.0
    smooth = np.einsum("ni,ni->n", moved[:-2], moved[2:]) > 0.9 * distance[:-2] * distance[2:]
    counts = smooth & (nearby > 0.0) & whole[:-2] & whole[1:-1] & whole[2:]
    # The distance between sparse keyframes is constant.
    if not side.stamped or usual_s > _SPARSE_S or np.count_nonzero(counts) < _FEWEST_STEPS:
        return False
    longer = step_s[1:-1][counts] / nearby_s[counts] - 1.0
    farther = distance[1:-1][counts] / nearby[counts] - 1.0
    jitter = float(np.sqrt(np.mean(longer**2)))
    follows = float(longer @ farther) / max(float(longer @ longer), 1e-12)
    return jitter > _JITTER and follows < _FOLLOWS
