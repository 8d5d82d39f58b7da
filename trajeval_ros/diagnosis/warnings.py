"""Warnings about an evaluation, with instructions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.consistency.yaw_information import YawInformation
from trajeval_ros.diagnosis.causes import CAUSES
from trajeval_ros.diagnosis.discontinuities import about_small_discontinuities, has_clock_step
from trajeval_ros.diagnosis.findings import Diagnosis
from trajeval_ros.diagnosis.input_tests import stamped_at_arrival
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted, percent, whole_percent
from trajeval_ros.formatting.remarks import Level, Remark, warning
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.fix_selection import FixRule
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.travelled import StepDifferences, step_lengths
from trajeval_ros.geometry.up_axis import ASSUMED
from trajeval_ros.geometry.valid_poses import MOST_UNUSABLE, NO_STATE, reasons
from trajeval_ros.metrics.absolute_errors import AbsoluteErrors
from trajeval_ros.metrics.moments import Moments
from trajeval_ros.metrics.named_protocols import PROTOCOLS
from trajeval_ros.metrics.premises import Doubts, Premise
from trajeval_ros.metrics.statistics import median
from trajeval_ros.metrics.tracking_loss import DIVERGED

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory
    from trajeval_ros.metrics.association import Association
    from trajeval_ros.metrics.evaluation import Evaluation

LOW_COVERAGE = 0.9
LARGE_TILT_DEG = 10.0
_WHOLE = 0.95  # of the time from the first to the last pair
_BACK = 0.1  # of the differences of steps, that of two steps together if poses alternate
# Of a UTM zone; northings below are within 9 deg of the equator.
_EASTING_M, _NORTHING_M = (1e5, 1e6), (1e6, 1e7)
# Largest factor on the position ATE by orientations in the alignment, without a warning.
_WORSE = 1.25
# Reasons to drop a pose that do not depend on other poses or on the groundtruth.
_BY_TIME = {
    "method": "--association",
    "max_time_difference_s": "--max-time-difference",
    "max_gap_s": "--max-gap",
    "time_offset_s": "--time-offset",
}


def completeness_in_words(evaluation: Evaluation) -> str:
    """Return the number of states of sparse groundtruth with an estimate, as text."""
    pairs, share = evaluation.association, evaluation.association.groundtruth_coverage
    what = {"gnss": "fixes", "points": "points"}.get(pairs.groundtruth.kind, "groundtruth poses")
    # A live run stores only pairs and their fraction of the states.
    states = round(len(pairs) / share)
    gap = pairs.coverage.longest_gap
    without = "" if gap is None else f", longest gap {gap}"
    return (
        f"{len(pairs)} of {states} {what} ({whole_percent(share)}) along "
        f"{pairs.groundtruth.path_length_m:.1f} m have an estimate{without}"
    )


def remarks_on(evaluation: Evaluation, diagnosis: Diagnosis) -> tuple[Remark, ...]:
    """Return the remarks on a finished evaluation, the most severe one first.

    Findings of the diagnosis precede all others.
    """
    sides = evaluation.groundtruth, evaluation.estimate
    read = list(dict.fromkeys(remark for side in sides for remark in side.reading.remarks))
    return (
        *(each.remark for each in diagnosis.findings),
        *(each for each in read if each.level is Level.ERROR),
        *(each for each in read if each.level is Level.WARNING),
        *_about_rows(evaluation),
        *_about_up_axis(evaluation),
        *([] if _is_lost(diagnosis) else _about_freedom(evaluation)),
        *_about_alignment(evaluation),
        *about_small_discontinuities(evaluation, diagnosis),
        *([] if _explains_jumps(diagnosis) else _about_mixed_publishers(evaluation)),
        *_about_rotations(evaluation),
        *_about_coverage(evaluation),
        *_about_relative_errors(evaluation),
        *_about_yaw_information(evaluation),
        *_about_inputs(evaluation),
    )


def _about_alignment(evaluation: Evaluation) -> Iterator[Remark]:
    yield from _about_poses(evaluation)
    protocol, alignment = evaluation.protocol, evaluation.alignment
    if protocol.align_states is not None and alignment.states_used < protocol.align_states:
        yield warning(
            "few_states_aligned",
            f"aligned by all {alignment.states_used} pairs, fewer than the requested "
            f"{protocol.align_states}",
        )
    if protocol.ate_form == "tutorial":
        yield warning(
            "origin_dependent_ate",
            "the ATE form tutorial, eq. (23), depends on the choice of the origin; compare only "
            "results with the same form and origin",
        )
    groundtruth_up, estimate_up = evaluation.groundtruth.up, evaluation.estimate.up
    known = ASSUMED not in (groundtruth_up.origin, estimate_up.origin)
    if known and groundtruth_up.name != estimate_up.name and protocol.gauge.minimum_states == 1:
        yield warning(
            "up_axes_differ",
            f"the vertical axes differ, groundtruth {groundtruth_up} and estimate {estimate_up}, "
            f"and gauge {protocol.gauge.value} can't align them",
        )
    if protocol.align_states == 1:
        yield from _about_first_state(evaluation)


def _about_rows(evaluation: Evaluation) -> Iterator[Remark]:
    """Name a side that has no timestamps, and settings of an association by time."""
    rule = evaluation.protocol.association
    if evaluation.association.rule.method != "index" or rule.method == "index":
        return
    sides = {
        "groundtruth": evaluation.groundtruth.reading,
        "estimate": evaluation.estimate.reading,
    }
    without = [name for name, reading in sides.items() if not reading.stamped]
    if len(without) == 1 and not any(each.numbered for each in sides.values()):
        yield warning(
            "paired_by_row",
            f"poses are paired by row, because the {without[0]} has no timestamps; give "
            "them, such as with --frame-rate or, in Python, with seconds=",
        )
    of_protocol = PROTOCOLS.get(evaluation.protocol.name, PROTOCOLS["default"]).association
    why = (
        "without timestamps on both sides, poses are paired by row; give timestamps, such as with "
        "--frame-rate"
    )
    yield from _about_unused(rule, of_protocol, _BY_TIME, why)


def _about_first_state(evaluation: Evaluation) -> Iterator[Remark]:
    """Detect a placeholder of the estimator: a jump after the first pose."""
    pairs = evaluation.association
    groundtruth, other = pairs.groundtruth[:2].quaternions, pairs.estimate[:2].quaternions
    if len(pairs) < 3 or groundtruth is None or other is None:
        return
    turned = lie.angle(lie.multiply(lie.conjugate(other[0]), other[1]))
    true_turn = lie.angle(lie.multiply(lie.conjugate(groundtruth[0]), groundtruth[1]))
    jump_deg = float(np.degrees(np.abs(turned - true_turn)))
    if jump_deg < LARGE_TILT_DEG:
        return
    yield warning(
        "placeholder_pose",
        f"from the first to the second pair the estimate rotates {jump_deg:.0f} deg more than "
        "the groundtruth: the first pose, used for the alignment, is probably a placeholder",
    )


def _explains_jumps(diagnosis: Diagnosis) -> bool:
    """Return whether a more severe finding explains jumps."""
    graver = (each for each in diagnosis.findings if each.rank >= CAUSES["scale"].rank)
    # An estimate with most poses of the groundtruth may jump at the others.
    return any(each.cause != "identical" for each in graver)


def _is_lost(diagnosis: Diagnosis) -> bool:
    """Return whether the estimate diverged, which the alignment can't fit."""
    return any(each.cause.startswith(DIVERGED) for each in diagnosis.findings)


def _about_mixed_publishers(evaluation: Evaluation) -> Iterator[Remark]:
    groundtruth, estimate = evaluation.association.groundtruth, evaluation.association.estimate
    scale = evaluation.alignment.similarity.scale
    true, own = groundtruth.positions, estimate.positions
    turned = groundtruth.quaternions, estimate.quaternions
    steps = StepDifferences.between(true, own, *turned, scale)
    if not len(steps.true_m):
        return
    back_m, second = median(steps.position_m), (true[::2], own[::2], None, None, scale)
    if back_m > median(steps.true_m) and (
        median(StepDifferences.between(*second).position_m) < _BACK * back_m
    ):
        yield warning(
            "mixed_publishers",
            f"every other pose of the estimate is {back_m:.2g} m away, and the next one is back: "
            "messages of two publishers are probably mixed; evaluate one of them",
        )


def _about_rotations(evaluation: Evaluation) -> Iterator[Remark]:
    pairs = evaluation.association
    without = pairs.without_orientations
    if without:
        withheld = "rotation errors"
        if evaluation.relative is None and evaluation.protocol.lengths:
            withheld += " and relative errors"
        yield warning(
            "no_orientations",
            f"{withheld} withheld: {without}",
        )
    if pairs.has_headings_only and not evaluation.withheld:
        yield warning(
            "two_dimensional_headings",
            "the orientations of the estimate are 2-D headings: rotation errors include the tilt "
            "of the groundtruth, and tilt errors are withheld; compare yaw errors",
        )


def _about_coverage(evaluation: Evaluation) -> Iterator[Remark]:
    pairs = evaluation.association
    yield from _about_unusable(pairs)
    if evaluation.score is not None:
        missing = evaluation.score.missing
        if missing:
            yield warning(
                "points_missed", f"{counted(missing, 'point')} without an estimate, scored 0"
            )
        return
    if pairs.estimate_coverage is None:
        if pairs.groundtruth_coverage < LOW_COVERAGE:
            yield warning(
                "low_coverage",
                f"{completeness_in_words(evaluation)} (dropped: {reasons(pairs.dropped)}); "
                "compare only results at the same points",
            )
    elif min(pairs.estimate_coverage, pairs.groundtruth_coverage) < LOW_COVERAGE:
        why, coverage = reasons(pairs.dropped), pairs.coverage
        # Without a loss between the first and the last pair, the groundtruth is only longer.
        lost = coverage.covered < _WHOLE * coverage.span or pairs.estimate_coverage < LOW_COVERAGE
        yield Remark(
            Level.WARNING if lost else Level.NOTE,
            "low_coverage",
            f"the pairs cover {whole_percent(coverage.covered)} of the groundtruth's "
            f"time and {whole_percent(pairs.estimate_coverage)} of the estimate's poses"
            + (f" (dropped: {why})" if why else "")
            + (f", {coverage.gap_in_words}" if coverage.longest_gap else "")
            + _across_gaps(pairs)
            + "; compare only runs with the same coverage",
        )


def _across_gaps(pairs: Association) -> str:
    """Return what to do if most poses are in groundtruth gaps, as text."""
    if pairs.dropped.get("in_groundtruth_gap", 0) <= len(pairs):
        return ""
    return (
        "; most poses are in groundtruth gaps: if the groundtruth is slow, use --association "
        "groundtruth-stamps or a larger --max-gap"
    )


def _about_unusable(pairs: Association) -> Iterator[Remark]:
    unusable = {each: count for each, count in pairs.dropped.items() if each in NO_STATE}
    count = sum(unusable.values())
    if not count or not pairs.estimate_coverage:
        return
    share = count / (count + len(pairs) / pairs.estimate_coverage)
    if share <= MOST_UNUSABLE:
        return
    yield warning(
        "unusable_poses",
        f"{percent(share)} of the estimate's poses are not usable and were dropped: "
        f"{reasons(unusable)}; correct the output of the estimator",
    )


def _about_relative_errors(evaluation: Evaluation) -> Iterator[Remark]:
    empty = [each.length for each in evaluation.relative or () if not each.count]
    path = evaluation.association.groundtruth
    whole = {"m": path.path_length_m, "s": path.duration_s}
    # A long path without a sub-trajectory has its states too far apart.
    sparse = [each.text for each in empty if each.value < 0.5 * whole.get(each.unit, 0.0)]
    short = [each.text for each in empty if each.text not in sparse]
    timed = path.reading.stamped
    if short:
        yield warning(
            "no_sub_trajectories",
            f"no sub-trajectories of {', '.join(short)}: the paired path has "
            f"{path.path_length_m:.1f} m" + (f" in {path.duration_s:.1f} s" if timed else ""),
        )
    if sparse:
        step_s, step_m = median(np.diff(path.seconds)), median(step_lengths(path.positions))
        yield warning(
            "no_sub_trajectories",
            f"no sub-trajectories of {', '.join(sparse)}: pairs are "
            + (f"{step_s:.2g} s and " if timed else "")
            + f"{step_m:.2g} m apart (median); use longer sub-trajectories",
        )


def _about_yaw_information(evaluation: Evaluation) -> Iterator[Remark]:
    """Yield the warning about covariances that claim to know yaw, of inertial estimators."""
    estimate, rule = evaluation.association.estimate, evaluation.association.rule
    if estimate.covariances is None or evaluation.protocol.gauge is not Gauge.YAW:
        return
    if rule.method == "index":
        return
    tested, order = YawInformation(), np.argsort(estimate.stamps, kind="stable")
    covariances = estimate.covariances[order, 3:, 3:]
    tested.add(estimate.stamps[order], covariances, estimate.up.matrix[2])
    if tested.remark is not None:
        yield tested.remark


def about_frames(groundtruth: str, estimate: str) -> Iterator[Remark]:
    """Yield the warning about two bodies with different known names, if they differ."""
    if not groundtruth or not estimate or groundtruth == estimate:
        return
    yield warning(
        "bodies_differ",
        f"the groundtruth is of body {groundtruth!r} and the estimate of {estimate!r}: if the "
        "bodies differ, the errors include their lever arm and rotation",
    )


def _about_inputs(evaluation: Evaluation) -> Iterator[Remark]:
    groundtruth, estimate = evaluation.groundtruth, evaluation.estimate
    # `fix_hints` has the warning about antennas.
    is_fix = groundtruth.kind == "gnss"
    if not is_fix:
        # Of VINS-Fusion, the body has the name of the fixed frame, which names no body.
        bodies = (
            each.child_frame != each.frame and each.child_frame for each in (groundtruth, estimate)
        )
        yield from about_frames(*(body or "" for body in bodies))
    paired = evaluation.association.estimate
    for name, side in (("groundtruth", groundtruth), ("estimate", paired)):
        yield from _about_projection(name, side)
        if not has_clock_step(evaluation) and stamped_at_arrival(side):
            yield warning(
                "arrival_times",
                f"the {name}'s timestamps are probably arrival times: they have jitter, its "
                "motion has none; use sensor timestamps, and check for a constant delay with "
                "--time-offset auto",
            )
    dropped = groundtruth.reading.dropped
    if dropped:
        yield warning("groundtruth_dropped", f"groundtruth poses were dropped: {reasons(dropped)}")


def about_lever_arm(evaluation: Evaluation) -> Iterator[Remark]:
    """Warn that the groundtruth may be of another point of the body than the estimate."""
    kind, protocol = evaluation.groundtruth.kind, evaluation.protocol
    can_rotate = kind == "gnss" or evaluation.estimate.quaternions is not None
    if kind != "poses" and can_rotate and protocol.lever_m is None:
        point = "the antenna" if kind == "gnss" else "a point, such as a prism"
        yield warning(
            "lever_arm_not_given",
            f"the groundtruth is the position of {point}, so rotations of the body add an error "
            "of up to its distance from the estimate's body frame; give the lever arm with "
            "--lever-arm X,Y,Z (metres, in that frame)",
        )


def about_unused_rule(rule: FixRule) -> Iterator[Remark]:
    """Yield the warning about settings of fixes for groundtruth that has none."""
    options = {
        "datum": "--datum",
        "min_status": "--min-fix-status",
        "max_sigma_m": "--max-fix-sigma",
        "correlation_s": "--fix-correlation",
    }
    why = "the groundtruth has no GNSS fixes; remove the option, or give the fixes as groundtruth"
    yield from _about_unused(rule, FixRule(), options, why)


def _about_projection(name: str, side: Trajectory) -> Iterator[Remark]:
    """Yield a warning if a side's positions are those of a UTM zone, which is no rigid frame."""
    columns = [np.abs(column) for column in side.up.turned(side.positions)[:, :2].T]
    low, high = ([reduced(column) for column in columns] for reduced in (np.min, np.max))
    east, north = np.argsort(low)  # either may come first
    is_zone = all(
        least <= low[axis] and high[axis] <= most
        for axis, (least, most) in ((east, _EASTING_M), (north, _NORTHING_M))
    )
    if not is_zone:
        return
    yield warning(
        "utm_coordinates",
        f"the {name} is probably in UTM coordinates (easting {low[east]:.0f} m, northing "
        f"{low[north]:.0f} m): lengths are up to 0.4 m per km too short or long, and grid north "
        "is up to 2 deg off; use latitude and longitude, or gauge sim3 to fit the scale",
    )


def _about_up_axis(evaluation: Evaluation) -> Iterator[Remark]:
    """Yield the warning about errors that rely on a doubtful up axis, if any."""
    doubt = evaluation.doubts.reasons.get(Premise.UP_AXIS)
    if doubt is None:
        return
    metrics = Doubts({Premise.UP_AXIS: doubt}).withheld(AbsoluteErrors)
    *names, last = (metric.partition("_")[0] for metric in metrics)
    yield warning("up_axis_doubted", f"{doubt}; {', '.join(names)} and {last} errors withheld")


def _about_freedom(evaluation: Evaluation) -> Iterator[Remark]:
    """Yield the warning about rotation errors that the alignment causes, if any."""
    freedom, withheld = evaluation.alignment.freedom, evaluation.withheld
    if freedom is None or not _is_turned(evaluation):
        return
    why = withheld or freedom.undetermined or freedom.misleading
    if not why:
        return
    advice = (
        ("align by the first state, or use a gauge with fewer degrees of freedom")
        if withheld
        else ""
    )
    if freedom.disagrees:
        advice = "check for a marker frame (--hand-eye auto) and for different axes"
    elif freedom.orientations is not None and evaluation.protocol.align_with == "positions":
        advice = "include them with --align-with poses" + (f"; or {advice}" if advice else "")
    names = "rotation and velocity errors"
    if evaluation.relative is None and evaluation.protocol.lengths:
        names = "rotation, velocity and relative errors"
    start = f"{names} are withheld: " if withheld else ""
    yield warning(
        "rotation_undetermined", start + "; ".join(part for part in (why, advice) if part)
    )


def _about_poses(evaluation: Evaluation) -> Iterator[Remark]:
    """Yield the warning about orientations that contradict the positions, if any."""
    alignment, pairs = evaluation.alignment, evaluation.association
    if alignment.by_positions is None:
        return
    moments = Moments.of_pairs(pairs.groundtruth.positions, pairs.estimate.positions)
    before, after = moments.rmse(alignment.by_positions), moments.rmse(alignment.similarity)
    if after <= _WORSE * before:
        return
    yield warning(
        "orientations_disagree",
        f"the alignment with orientations increases the position ATE from {before:.4g} m to "
        f"{after:.4g} m: positions and orientations disagree; check for a marker frame "
        "(--hand-eye auto)",
    )


def require_same_body(evaluation: Evaluation, diagnosis: Diagnosis) -> None:
    """Refuse an alignment by the orientations of another body."""
    found = diagnosis.named("body")
    if evaluation.protocol.align_with == "poses" and found is not None:
        raise InputError(
            "the groundtruth is probably of another body frame, rotated by "
            f"{found.evidence['angle_deg']:.0f} deg, so its orientations can't be used for the "
            "alignment; give --hand-eye auto or FILE, or use --align-with positions"
        )


def _is_turned(evaluation: Evaluation) -> bool:
    """Return whether any error depends on the rotation of the alignment."""
    groundtruth, estimate = evaluation.association.groundtruth, evaluation.association.estimate
    oriented = groundtruth.quaternions is not None and estimate.quaternions is not None
    return oriented or (groundtruth.velocities is not None and estimate.velocities is not None)


def _about_unused(
    given: object, default: object, options: Mapping[str, str], why: str
) -> Iterator[Remark]:
    """Yield the warning about settings that differ from the default without an effect."""
    unused = [
        option
        for name, option in options.items()
        if getattr(given, name) != getattr(default, name)
    ]
    if unused:
        yield warning("unused_settings", f"no effect of {', '.join(unused)}: {why}")
