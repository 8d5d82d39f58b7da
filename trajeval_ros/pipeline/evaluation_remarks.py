"""Remarks on an evaluation, with instructions: its findings, its alignment and its errors."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.diagnosis.causes import CAUSES
from trajeval_ros.diagnosis.discontinuities import about_small_discontinuities
from trajeval_ros.diagnosis.findings import Diagnosis
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level, Remark, note, warning
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.travelled import step_lengths
from trajeval_ros.geometry.up_axis import ASSUMED
from trajeval_ros.metrics.absolute_errors import AbsoluteErrors
from trajeval_ros.metrics.discontinuities.events import DIVERGED
from trajeval_ros.metrics.moments import Moments
from trajeval_ros.metrics.premises import Doubts, Premise
from trajeval_ros.metrics.statistics import median
from trajeval_ros.pipeline.input_remarks import about_coverage, about_inputs, about_rows

if TYPE_CHECKING:
    from trajeval_ros.metrics.evaluation import Evaluation

SCALE_DRIFT = "scale_drift"  # the code of a remark that the result lines state
LARGE_TILT_DEG = 10.0
_BACK = 0.1  # of the differences of steps, that of two steps together if poses alternate
# Largest factor on the position ATE by orientations in the alignment, without a warning.
_WORSE = 1.25


def remarks_on(
    evaluation: Evaluation, diagnosis: Diagnosis, *, paired: bool = False
) -> tuple[Remark, ...]:
    """Return the remarks on a finished evaluation, the most severe one first.

    Findings of the diagnosis precede all others. Small discontinuities are not stated if only the
    pairs are known: interpolated poses do not show which side has a gap.
    """
    sides = evaluation.groundtruth, evaluation.estimate
    read = list(dict.fromkeys(remark for side in sides for remark in side.reading.remarks))
    return (
        *(finding.remark for finding in diagnosis.findings),
        *(item for item in read if item.level is Level.ERROR),
        *(item for item in read if item.level is Level.WARNING),
        *about_rows(evaluation),
        *_about_up_axis(evaluation),
        *([] if _is_lost(diagnosis) else _about_freedom(evaluation)),
        *_about_alignment(evaluation),
        *([] if paired else about_small_discontinuities(evaluation, diagnosis)),
        *([] if _explains_jumps(diagnosis) else _about_mixed_publishers(evaluation)),
        *_about_rotations(evaluation),
        *about_coverage(evaluation),
        *_about_relative_errors(evaluation),
        *_about_yaw_information(evaluation),
        *about_inputs(evaluation),
        *_about_scale(evaluation),
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


def _about_first_state(evaluation: Evaluation) -> Iterator[Remark]:
    """Detect a placeholder of the estimator: a jump after the first pose."""
    pairs = evaluation.association
    groundtruth, other = pairs.groundtruth[:2].quaternions, pairs.estimate[:2].quaternions
    if len(pairs) < 3 or groundtruth is None or other is None:
        return
    angle = lie.angle(lie.multiply(lie.conjugate(other[0]), other[1]))
    true_turn = lie.angle(lie.multiply(lie.conjugate(groundtruth[0]), groundtruth[1]))
    jump_deg = float(np.degrees(np.abs(angle - true_turn)))
    if jump_deg < LARGE_TILT_DEG:
        return
    yield warning(
        "placeholder_pose",
        f"from the first to the second pair the estimate rotates {jump_deg:.0f} deg more than "
        "the groundtruth: the first pose, used for the alignment, is probably a placeholder",
    )


def _explains_jumps(diagnosis: Diagnosis) -> bool:
    """Return whether a more severe finding explains jumps."""
    graver = (finding for finding in diagnosis.findings if finding.rank >= CAUSES["scale"].rank)
    # An estimate with most poses of the groundtruth may jump at the others.
    return any(item.cause != "identical" for item in graver)


def _is_lost(diagnosis: Diagnosis) -> bool:
    """Return whether the estimate diverged, which the alignment can't fit."""
    return any(finding.cause.startswith(DIVERGED) for finding in diagnosis.findings)


def _about_mixed_publishers(evaluation: Evaluation) -> Iterator[Remark]:
    groundtruth, estimate = evaluation.association.groundtruth, evaluation.association.estimate
    scale = evaluation.alignment.similarity.scale
    reference, estimated = groundtruth.positions, estimate.positions
    if len(reference) < 2:
        return

    def apart_m(every: int) -> float:
        lengths = step_lengths(reference[::every]), step_lengths(estimated[::every])
        return median(np.abs(lengths[0] - scale * lengths[1]))

    back_m = apart_m(1)
    if back_m > median(step_lengths(reference)) and apart_m(2) < _BACK * back_m:
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


def _about_relative_errors(evaluation: Evaluation) -> Iterator[Remark]:
    empty = [item.length for item in evaluation.relative or () if not item.count]
    path = evaluation.association.groundtruth
    whole = {"m": path.path_length_m, "s": path.duration_s}
    # A long path without a sub-trajectory has its states too far apart.
    sparse = [item.text for item in empty if item.value < 0.5 * whole.get(item.unit, 0.0)]
    short = [item.text for item in empty if item.text not in sparse]
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
    from trajeval_ros.consistency.yaw_information import YawInformation

    tested, order = YawInformation(), np.argsort(estimate.stamps, kind="stable")
    covariances = estimate.covariances[order, 3:, 3:]
    tested.add(estimate.stamps[order], covariances, estimate.up.matrix[2])
    if tested.remark is not None:
        yield tested.remark


def _about_scale(evaluation: Evaluation) -> Iterator[Remark]:
    """Yield the note about a scale that drifts, if it does."""
    scale = evaluation.scale_along_run
    if scale is not None and scale.is_drifting:
        yield note(
            SCALE_DRIFT,
            f"the scale drifts by {scale.drift_text} % per 100 m, from {scale.ratios[0]:.3f} to "
            f"{scale.ratios[-1]:.3f} times that of the alignment",
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
    body = diagnosis.named("body")
    if evaluation.protocol.align_with == "poses" and body is not None:
        raise InputError(
            "the groundtruth is probably of another body frame, rotated by "
            f"{body.evidence['angle_deg']:.0f} deg, so its orientations can't be used for the "
            "alignment; give --hand-eye auto or FILE, or use --align-with positions"
        )


def _is_turned(evaluation: Evaluation) -> bool:
    """Return whether any error depends on the rotation of the alignment."""
    groundtruth, estimate = evaluation.association.groundtruth, evaluation.association.estimate
    oriented = groundtruth.quaternions is not None and estimate.quaternions is not None
    return oriented or (groundtruth.velocities is not None and estimate.velocities is not None)
