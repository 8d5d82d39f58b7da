"""The pipeline from trajectories to an outcome, without access to files.

The command line, comparisons, live runs and Python use it, so that equal requests give equal
numbers:

    correct -> calibrate -> associate, align, measure -> diagnose, warn -> test covariances
    -> assess likelihoods
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

from trajeval_ros.diagnosis.evaluation_diagnosis import diagnose_evaluation, require_conventions
from trajeval_ros.diagnosis.findings import Diagnosis
from trajeval_ros.diagnosis.mending import Mended, changes_by, finding_to_mend
from trajeval_ros.diagnosis.rotation_hints import require_same_body
from trajeval_ros.diagnosis.vertical import require_vertical, without_vertical
from trajeval_ros.diagnosis.warnings import warnings_of
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.upright import upright
from trajeval_ros.metrics import evaluation as measuring
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.input_summary import InputSummary
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.states_table import states_table
from trajeval_ros.pipeline.outcome import Outcome, RunOutcome
from trajeval_ros.pipeline.preparation import (
    cut_to_span,
    named,
    with_fixes_placed,
    with_lengths_of,
    with_up,
)
from trajeval_ros.pipeline.request import Request
from trajeval_ros.pipeline.several_runs import compared_with, with_bayes_factors, with_own_errors

if TYPE_CHECKING:
    from trajeval_ros.calibration.calibrated import Calibrated
    from trajeval_ros.metrics.association import Association
    from trajeval_ros.watchdog.limits import WatchLimits


def run(
    groundtruth: Trajectory, estimates: Sequence[Trajectory], request: Request | None = None
) -> Outcome:
    """Evaluate the estimates of one groundtruth according to a request.

    All estimates use the calibration of the first one, because errors with individual calibrations
    cannot be ranked.

    Args:
        groundtruth: M states.
        estimates: Trajectories in frames of their own, with distinct names.
        request: What to compute; by default ATE and relative errors with the default protocol.

    Raises:
        InputError: There is no estimate, or one cannot be evaluated as requested; the message
            starts with its source or name.

    Example:
        >>> from trajeval_ros import Request, run, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> outcome = run(flight.groundtruth, [flight.estimate, flight.estimate[::2]], Request())
        >>> len(outcome.runs)
        2
    """
    request = request or Request()
    if not estimates:
        raise InputError("no estimate given; give at least one")
    if request.mends.swap and len(estimates) > 1:
        raise SettingsError("--swap needs exactly one estimate; remove the others")
    groundtruth, estimates, request = with_fixes_placed(groundtruth, estimates, request)
    runs: list[RunOutcome] = []
    for estimate in estimates:
        with named(estimate):
            same_as = runs[0].calibrated if runs else None
            found, truth = _from_read(groundtruth, estimate, request, same_as)
            if request.fix:
                found = _mended(found, groundtruth, estimate, request, same_as)
        others = [earlier.estimate for earlier in runs]
        runs.append(compared_with(others, found))
    used = runs[0].evaluation.groundtruth
    runs = with_own_errors(list(with_bayes_factors(runs)), request.fixes)
    return Outcome(request, InputSummary.of(truth, used), tuple(runs))


def run_pairs(
    pairs: Association, groundtruth: Trajectory, estimate: Trajectory, request: Request
) -> RunOutcome:
    """Evaluate the pairs of a live run.

    Args:
        pairs: States paired by the request's association.
        groundtruth: The groundtruth states of the pairs, in place of all groundtruth.
        estimate: The estimated states of the pairs, in place of all of them.
        request: What to compute. Time offsets and likelihoods need more than pairs.

    Raises:
        InputError: The pairs lack data that the request needs.
        SettingsError: The request needs more than pairs.
    """
    if request.calibration.offset:
        raise SettingsError(
            "a live run needs a fixed time offset; set the parameter time_offset, or evaluate a "
            "bag with --time-offset auto"
        )
    if request.is_continuous or request.span_ns is not None or request.time_span is not None:
        raise SettingsError(
            "likelihoods and time spans need the complete groundtruth, and a live run stores "
            "only pairs; evaluate a bag"
        )
    if request.up is not None:
        groundtruth, estimate = with_up(request.up, groundtruth, estimate)
        sides = with_up(request.up, pairs.groundtruth, pairs.estimate)
        pairs = dataclasses.replace(pairs, groundtruth=sides[0], estimate=sides[1])
    return evaluate_one(groundtruth, estimate, request, None, pairs)


def evaluate(
    groundtruth: Trajectory, estimate: Trajectory, protocol: Protocol | None = None
) -> Evaluation:
    """Evaluate one estimate: ATE and relative errors, with warnings.

    Tutorial: alignment by eq. (13) in the protocol's gauge, absolute errors (23) with the RMSE
    (24), relative errors (27) over sub-trajectories (25).

    Args:
        groundtruth: M states; yaw and tilt are about its `up` axis.
        estimate: N states in their own frame. Gauges yaw and planar align its `up` axis with the
            groundtruth's.
        protocol: Association, alignment and errors; None for gauge se3 and lengths of 8 to 40 m.

    Returns:
        Errors in metres and degrees, per pair and as statistics, in the groundtruth's frame. For
        gauges yaw and planar, and association continuous, this frame is converted to z up.

    Raises:
        InputError: A trajectory cannot be evaluated; `NoMatchError` if there is no pair.
        DegenerateGeometryError: Too few states, or no motion, for the gauge's alignment.

    Example:
        >>> from trajeval_ros import Protocol, evaluate, simulate
        >>> flight = simulate(seed=1, duration_s=30.0)
        >>> protocol = Protocol(modality="stereo-inertial", lengths=(8, 16))
        >>> found = evaluate(flight.groundtruth, flight.estimate, protocol)
        >>> 0.0 < found.ate["position_m"].rmse < 1.0
        True
    """
    protocol = protocol or Protocol()
    require_vertical(groundtruth, protocol.gauge)
    if protocol.is_upright:
        groundtruth, estimate = upright(groundtruth), upright(estimate)
    found = measuring.evaluate(groundtruth, estimate, protocol)
    return with_warnings(found, diagnose_evaluation(found, groundtruth, estimate))


def _from_read(
    groundtruth: Trajectory, estimate: Trajectory, request: Request, same_as: Calibrated | None
) -> tuple[RunOutcome, Trajectory]:
    """Apply the request's corrections, axes and time span, and evaluate; return both results."""
    groundtruth, estimate = request.mends.applied(groundtruth, estimate)
    if request.up is not None:
        groundtruth, estimate = with_up(request.up, groundtruth, estimate)
    if request.time_span is not None:
        first_ns = int(groundtruth.stamps.min()) if len(groundtruth) else 0
        with named(groundtruth):
            groundtruth = request.time_span.cut(groundtruth, first_ns)
        offset_ns = round(request.protocol.association.time_offset_s * NANOSECONDS)
        estimate = request.time_span.cut(estimate, first_ns, offset_ns)
    return evaluate_one(groundtruth, estimate, request, same_as), groundtruth


def _mended(
    found: RunOutcome,
    groundtruth: Trajectory,
    estimate: Trajectory,
    request: Request,
    same_as: Calibrated | None,
) -> RunOutcome:
    """Evaluate again with a correction of the finding, and keep the errors before it."""
    from trajeval_ros.calibration.calibrated import Ate

    finding = finding_to_mend(found.diagnosis, request.fix)
    if finding is None:
        return found
    changes = changes_by(
        finding.mend,
        protocol=request.protocol,
        calibration=request.calibration,
        mends=request.mends,
        time_span=request.time_span,
    )
    changed = dataclasses.replace(request, **changes)
    after, _ = _from_read(groundtruth, estimate, changed, same_as)
    mended = Mended(finding, Ate.of(found.evaluation), Ate.of(after.evaluation))
    return dataclasses.replace(after, mended=mended)


def evaluate_one(
    groundtruth: Trajectory,
    estimate: Trajectory,
    request: Request,
    same_as: Calibrated | None,
    pairs: Association | None = None,
) -> RunOutcome:
    """Evaluate one estimate: the steps of the pipeline in their order."""
    protocol, covariances = request.protocol, request.covariances
    used = covariances.about_world(estimate)
    if pairs is not None:
        pairs = dataclasses.replace(pairs, estimate=covariances.about_world(pairs.estimate))
    if request.span_ns is not None:
        used = cut_to_span(used, request.span_ns, protocol)
    if request.lengths_of_groundtruth:
        protocol = with_lengths_of(groundtruth, protocol)
    require_vertical(groundtruth, protocol.gauge)
    if protocol.is_upright:
        groundtruth, used = upright(groundtruth), upright(used)
        if pairs is not None:
            pairs = dataclasses.replace(
                pairs, groundtruth=upright(pairs.groundtruth), estimate=upright(pairs.estimate)
            )

    calibrated, read = None, (groundtruth, used)
    if request.calibration.hand_eye:
        require_conventions(groundtruth, used, protocol, pairs)
    if request.calibration.anything:
        from trajeval_ros.calibration.apply import evaluate_calibrated

        calibrated = evaluate_calibrated(
            groundtruth, used, protocol, request.calibration, same_as=same_as, pairs=pairs
        )
        evaluation = calibrated.evaluation
        if calibrated.hand_eye is not None:  # one side was converted to another body
            read = evaluation.groundtruth, evaluation.estimate
            if not calibrated.of_marker:
                covariances = covariances.of_moved_groundtruth(calibrated.hand_eye)
    elif pairs is not None:
        evaluation = measuring.evaluate_pairs(pairs, groundtruth, used, protocol)
    else:
        evaluation = measuring.evaluate(groundtruth, used, protocol)
    diagnosis = diagnose_evaluation(evaluation, *read, paired=pairs is not None)
    if request.calibration.hand_eye:
        diagnosis = diagnosis.after_hand_eye_calibration()
    evaluation = with_warnings(evaluation, diagnosis)

    consistency = likelihood = integrity = None
    if covariances.source != "none":
        from trajeval_ros.consistency.judge import judge

        consistency = judge(evaluation, covariances.once_turned)
        if request.integrity is not None:
            from trajeval_ros.consistency.integrity import integrity_of

            stamps = evaluation.association.estimate.stamps
            warnings = _watch_errors(estimate, evaluation, request.watch_limits)
            integrity = integrity_of(consistency, request.integrity, stamps, warnings)
    if request.is_continuous:
        from trajeval_ros.likelihood.assessment import assess

        likelihood = assess(evaluation)
    return RunOutcome(
        InputSummary.of(estimate, evaluation.estimate),
        evaluation,
        calibrated,
        consistency,
        likelihood,
        by_states=states_table(evaluation, request.states_table),
        diagnosis=diagnosis,
        integrity=integrity,
    )


def with_warnings(evaluation: Evaluation, diagnosis: Diagnosis) -> Evaluation:
    """Return an evaluation with warnings, without errors that are not meaningful.

    Raises:
        InputError: It is aligned by the orientations of another body.
    """
    require_same_body(evaluation, diagnosis)
    evaluation = without_vertical(evaluation)
    warnings = (*warnings_of(evaluation, diagnosis), *evaluation.warnings)
    return dataclasses.replace(evaluation, warnings=warnings)


def _watch_errors(
    estimate: Trajectory, evaluation: Evaluation, limits: WatchLimits | None
) -> list[tuple[int, int]]:
    """Return the time spans of errors of a watchdog, by the clock of the pairs."""
    if limits is None:
        return []
    from trajeval_ros.watchdog.error_spans import error_spans
    from trajeval_ros.watchdog.recording import WatchedRun

    offset_ns = round(evaluation.association.rule.time_offset_s * NANOSECONDS)
    spans = error_spans(WatchedRun(estimate), limits)
    return [(begin + offset_ns, end + offset_ns) for begin, end in spans]
