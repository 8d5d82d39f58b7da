"""The pipeline from trajectories to an outcome, without access to files.

The command line, comparisons, live runs and Python use it, so that equal requests give equal
numbers. `_evaluated` has the steps in their order.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.consistency.covariance_request import CovarianceRequest
from trajeval_ros.diagnosis.diagnose import diagnose as diagnose_evaluation
from trajeval_ros.diagnosis.diagnose import (
    diagnose_inputs,
    require_conventions,
)
from trajeval_ros.diagnosis.findings import Diagnosis, Finding, Tried
from trajeval_ros.diagnosis.verification import Reevaluate, verified
from trajeval_ros.exceptions import InputError, TrajevalError
from trajeval_ros.formatting.remarks import Remark, warning
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.vertical_axis import up_axis_doubt
from trajeval_ros.metrics.as_available import AsAvailable, as_available
from trajeval_ros.metrics.evaluation import Evaluation, of_same_point, on_plane
from trajeval_ros.metrics.input_summary import InputSummary
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.reception_clock import judged_receptions
from trajeval_ros.metrics.states_table import states_table
from trajeval_ros.metrics.statistics import median
from trajeval_ros.metrics.stream_health import UNKNOWN, StreamHealth, health_of
from trajeval_ros.pipeline.corrections import finding_to_correct
from trajeval_ros.pipeline.evaluation_remarks import remarks_on, require_same_body
from trajeval_ros.pipeline.outcome import Outcome, RunOutcome
from trajeval_ros.pipeline.preparation import (
    Inputs,
    at_discontinuities,
    corrected_and_cut,
    in_world_axes,
    named,
    with_fixes_placed,
)
from trajeval_ros.pipeline.request import Request
from trajeval_ros.pipeline.several_runs import (
    with_bayes_factors,
    with_own_errors,
    with_remarks,
    with_same_estimates_named,
)

_MOST_CORRECTIONS = 4
# Corrections that change the pairs.
_TEMPORAL = {"time_offset", "estimate.clock_rate", "end", "max_gap"}

if TYPE_CHECKING:
    from trajeval_ros.calibration.apply import Calibrated
    from trajeval_ros.consistency.consistency_result import Consistency
    from trajeval_ros.consistency.integrity import Integrity
    from trajeval_ros.likelihood.likelihood_assessment import LikelihoodAssessment
    from trajeval_ros.metrics.association import Association
    from trajeval_ros.metrics.tracking_loss import Loss


def run(
    groundtruth: Trajectory, estimates: Sequence[Trajectory], request: Request | None = None
) -> Outcome:
    """Evaluate the estimates of one groundtruth, as `trajeval_ros.run` does."""
    request = request or Request()
    if not estimates:
        raise InputError("no estimate given; give at least one")
    groundtruth, estimates, request = with_fixes_placed(groundtruth, estimates, request)
    runs: list[RunOutcome] = []
    for estimate in estimates:
        own, said = _testable(request, estimate, estimates)
        with named(estimate):
            given, same_as = Inputs.of(groundtruth, estimate), runs[0].calibrated if runs else None
            found = _evaluated(given, own, same_as)
            if request.correct:
                found = _corrected(found, given, own, same_as)
        runs.append(with_remarks(said, found, len(found.evaluation.remarks)))
    used, inputs = runs[0].evaluation.groundtruth, corrected_and_cut(given, request)
    runs = list(with_bayes_factors(with_same_estimates_named(runs)))
    runs = with_own_errors(runs, request.fixes)
    return Outcome(request, InputSummary.of(inputs.groundtruth, used), tuple(runs))


def _testable(
    request: Request, estimate: Trajectory, estimates: Sequence[Trajectory]
) -> tuple[Request, list[Remark]]:
    """Return the request for one of several estimates, without tests that only others allow."""
    is_possible = estimate.covariances is not None or all(
        each.covariances is None for each in estimates
    )
    if request.covariances.source != "message" or is_possible:
        return request, []
    said = "the consistency test is not possible: the estimate has no covariances"
    own = dataclasses.replace(request, covariances=CovarianceRequest(), integrity=None)
    return own, [warning("no_consistency_test", said)]


def run_alone(
    groundtruth: Trajectory, estimate: Trajectory, request: Request
) -> tuple[InputSummary, RunOutcome]:
    """Evaluate one of several estimates with its own request; return the groundtruth's summary.

    What compares estimates follows: `with_same_estimates_named` and `with_own_errors`.
    """
    groundtruth, [estimate], request = with_fixes_placed(groundtruth, [estimate], request)
    with named(estimate):
        given = Inputs.of(groundtruth, estimate)
        outcome = _evaluated(given, request)
    inputs = corrected_and_cut(given, request)
    return InputSummary.of(inputs.groundtruth, outcome.evaluation.groundtruth), outcome


def evaluate(
    groundtruth: Trajectory, estimate: Trajectory, protocol: Protocol | None = None
) -> Evaluation:
    """Evaluate one estimate, as `trajeval_ros.evaluate` does."""
    request = Request(protocol or Protocol())
    given = Inputs(groundtruth, estimate)
    inputs, _, evaluation = _measured(given, request)
    return _diagnosed(
        evaluation, inputs.groundtruth, inputs.estimate, _reevaluate(given, request)
    )[0]


def diagnose(
    groundtruth: Trajectory,
    estimate: Trajectory,
    request: Request,
    pairs: Association | None = None,
    losses: Sequence[Loss] | None = None,
) -> tuple[Diagnosis, str]:
    """Search for mistakes, and try their corrections.

    The `pairs` of a live run are given, and its `losses` of tracking if they are known.

    Returns:
        The diagnosis, and the reason if nothing can be evaluated, else "".
    """
    given = Inputs(groundtruth, estimate, pairs)
    reevaluate = _reevaluate(given, request)
    try:
        inputs, _, evaluation = _measured(given, request)
    except TrajevalError as error:
        if pairs is not None:
            return Diagnosis(), str(error)
        inputs = corrected_and_cut(given, request)
        found = diagnose_inputs(inputs.groundtruth, inputs.estimate, request.protocol)
        return verified(found, None, reevaluate), str(error)
    sides = inputs.groundtruth, inputs.estimate
    paired = inputs.pairs is not None
    evaluation, diagnosis = diagnose_evaluation(evaluation, *sides, paired=paired, losses=losses)
    return verified(diagnosis, evaluation, reevaluate), ""


def _measured(
    given: Inputs,
    request: Request,
    same_as: Calibrated | None = None,
    *,
    compares: bool = True,
) -> tuple[Inputs, Calibrated | None, Evaluation]:
    """Correct, cut, calibrate, associate, align and compute the errors of one estimate.

    A calibration `compares` errors with those without it.
    """
    inputs, protocol = in_world_axes(corrected_and_cut(given, request), request)
    offset_s = protocol.association.time_offset_s
    inputs = at_discontinuities(inputs, request.discontinuities, offset_s)
    calibrated = _calibrated(inputs, protocol, request, same_as, compares=compares)
    if calibrated is None:
        return inputs, None, inputs.evaluated(protocol)
    evaluation = calibrated.evaluation
    if calibrated.hand_eye is not None:  # a side has another body now
        streams = inputs.streams
        if streams is not None:
            revised = streams[1]
            if calibrated.of_marker:
                revised = calibrated.hand_eye.of_marker(revised, 1.0)
            streams = evaluation.groundtruth, revised
        inputs = Inputs(evaluation.groundtruth, evaluation.estimate, inputs.pairs, streams)
    return inputs, calibrated, evaluation


def _reevaluate(given: Inputs, request: Request, same_as: Calibrated | None = None) -> Reevaluate:
    """Return what evaluates again with corrections, without relative errors."""

    def reevaluate(corrections: Sequence[Mapping[str, str]]) -> Evaluation:
        protocol = dataclasses.replace(request.protocol, lengths=())
        changed, sides = dataclasses.replace(request, protocol=protocol), given
        for correction in corrections:
            changed = changed.corrected(correction)
            if given.pairs is not None and correction.keys() & _TEMPORAL:
                sides = _unpaired(given.pairs)
                changed = _with_gaps_of(given.pairs, changed)
        return _measured(sides, changed, same_as, compares=False)[2]

    return reevaluate


def _unpaired(pairs: Association) -> Inputs:
    """Return the states of pairs with the timestamps of their own clocks."""
    stamps = pairs.estimate.stamps - round(pairs.rule.time_offset_s * NANOSECONDS)
    return Inputs(pairs.groundtruth, dataclasses.replace(pairs.estimate, stamps=stamps))


def _with_gaps_of(pairs: Association, request: Request) -> Request:
    """Return a request that interpolates between thinned pairs."""
    steps = np.diff(pairs.groundtruth.stamps) / NANOSECONDS
    rule = request.protocol.association
    most_s = max(rule.max_gap_s, 3.0 * median(steps) if len(steps) else 0.0)
    rule = dataclasses.replace(rule, max_gap_s=most_s)
    protocol = dataclasses.replace(request.protocol, association=rule)
    return dataclasses.replace(request, protocol=protocol)


def _evaluated(given: Inputs, request: Request, same_as: Calibrated | None = None) -> RunOutcome:
    """Evaluate one estimate: the steps of the pipeline in their order."""
    try:
        inputs, calibrated, evaluation = _measured(given, request, same_as)
    except InputError as error:
        raise _explained(error, given, request) from error
    evaluation, diagnosis = _diagnosed(
        evaluation,
        inputs.groundtruth,
        inputs.estimate,
        _reevaluate(given, request, same_as),
        paired=inputs.pairs is not None,
        hand_eye_calibrated=request.calibration.hand_eye,
    )
    consistency = _consistency(evaluation, calibrated, request)
    available = _available(inputs, evaluation, request)
    if available is not None:
        remarks = (*evaluation.remarks, *available.numbers.remarks)
        evaluation = dataclasses.replace(evaluation, remarks=remarks)
    return RunOutcome(
        InputSummary.of(given.estimate, evaluation.estimate),
        evaluation,
        calibrated,
        consistency,
        _likelihood(evaluation, request),
        by_states=states_table(evaluation, chosen) if (chosen := request.states_table) else (),
        diagnosis=diagnosis,
        integrity=_integrity(given.estimate, evaluation, consistency, request),
        stream=_stream(given.estimate),
        available=available,
    )


def _diagnosed(
    evaluation: Evaluation,
    groundtruth: Trajectory,
    estimate: Trajectory,
    reevaluate: Reevaluate,
    *,
    paired: bool = False,
    hand_eye_calibrated: bool = False,
) -> tuple[Evaluation, Diagnosis]:
    """Return an evaluation with remarks and without meaningless errors, and its diagnosis.

    `reevaluate` evaluates with corrections. An alignment by orientations of another body is
    refused.
    """
    evaluation, diagnosis = diagnose_evaluation(evaluation, groundtruth, estimate, paired=paired)
    if hand_eye_calibrated:
        diagnosis = diagnosis.after_hand_eye_calibration()
    diagnosis = verified(diagnosis, evaluation, reevaluate)
    require_same_body(evaluation, diagnosis)
    remarks = (*remarks_on(evaluation, diagnosis, paired=paired), *evaluation.remarks)
    return dataclasses.replace(evaluation, remarks=remarks), diagnosis


def _explained(error: InputError, given: Inputs, request: Request) -> InputError:
    """Return the error of an evaluation, or the wrong convention that causes a wrong up axis.

    Inverse poses of the groundtruth rotate about no vertical axis.
    """
    inputs = corrected_and_cut(given, request)
    gauge = request.protocol.gauge
    if not gauge.turns_about_gravity_only or not up_axis_doubt(inputs.groundtruth):
        return error
    found = diagnose_inputs(inputs.groundtruth, inputs.estimate, request.protocol)
    causes = [finding for finding in found.findings if finding.cause == "inverse"]
    if not causes or request.calibration.hand_eye:
        return error
    return InputError(f"gauge {gauge.value} is not possible: {causes[0].text}")


def _stream(estimate: Trajectory) -> StreamHealth | None:
    """Return the health of a recorded stream; without arrivals if they can't be compared."""
    receptions = estimate.reading.receptions
    if receptions is None or not len(estimate) or estimate.reading.as_received is not None:
        return None
    _, clock = judged_receptions(estimate.stamps, receptions.times)
    unknown = np.full(len(estimate), UNKNOWN)
    return health_of(estimate.stamps, receptions.times if clock.is_usable else unknown)


def _available(inputs: Inputs, evaluation: Evaluation, request: Request) -> AsAvailable | None:
    """Compute the as-available accuracy; None if not requested."""
    rule, protocol = request.available, evaluation.protocol
    if not rule.is_asked_for:
        return None
    groundtruth, estimate = evaluation.groundtruth, evaluation.estimate
    if inputs.streams is not None:
        groundtruth, estimate = inputs.streams
        estimate = of_same_point(estimate, protocol)
        if protocol.gauge is Gauge.PLANAR:
            groundtruth = on_plane(groundtruth)
    association = evaluation.association.rule
    return as_available(
        groundtruth.in_order(),
        estimate,
        evaluation.alignment.similarity,
        rule,
        association.max_gap_s,
        round(association.time_offset_s * NANOSECONDS),
    )


def _calibrated(
    inputs: Inputs,
    protocol: Protocol,
    request: Request,
    same_as: Calibrated | None,
    *,
    compares: bool,
) -> Calibrated | None:
    """Estimate or apply the clock and the body, and evaluate; None if neither is requested."""
    groundtruth, estimate, pairs = inputs.groundtruth, inputs.estimate, inputs.pairs
    if not request.calibration.anything:
        return None
    if request.calibration.hand_eye:
        require_conventions(groundtruth, estimate, protocol, pairs)
    from trajeval_ros.calibration.apply import evaluate_calibrated

    return evaluate_calibrated(
        groundtruth,
        estimate,
        protocol,
        request.calibration,
        same_as=same_as,
        pairs=pairs,
        compares=compares,
    )


def _consistency(
    evaluation: Evaluation, calibrated: Calibrated | None, request: Request
) -> Consistency | None:
    """Test the covariances; None if there are none."""
    covariances = request.covariances
    if covariances.source == "none":
        return None
    from trajeval_ros.consistency.consistency_assessment import assess_consistency

    if calibrated is not None and calibrated.hand_eye is not None and not calibrated.of_marker:
        covariances = covariances.of_moved_groundtruth(calibrated.hand_eye)
    return assess_consistency(evaluation, covariances.once_turned)


def _likelihood(evaluation: Evaluation, request: Request) -> LikelihoodAssessment | None:
    """Compute the likelihoods; None unless the association is continuous."""
    if not request.is_continuous:
        return None
    from trajeval_ros.likelihood.likelihood_assessment import assess_likelihood

    return assess_likelihood(evaluation)


def _integrity(
    estimate: Trajectory, evaluation: Evaluation, tested: Consistency | None, request: Request
) -> Integrity | None:
    """Compare errors with protection levels; None if not requested."""
    if request.integrity is None or tested is None:
        return None
    from trajeval_ros.consistency.integrity import integrity_of

    alerts = _watchdog_errors(estimate, evaluation, request.watch_factor)
    stamps = evaluation.association.estimate.stamps
    return integrity_of(tested, request.integrity, stamps, alerts)


def _watchdog_errors(
    estimate: Trajectory, evaluation: Evaluation, factor: float | None
) -> list[tuple[int, int]]:
    """Return the time spans of errors of a watchdog, by the clock of the pairs."""
    if factor is None:
        return []
    from trajeval_ros.watchdog.recording import WatchedRun, error_spans

    offset_ns = round(evaluation.association.rule.time_offset_s * NANOSECONDS)
    spans = error_spans(WatchedRun(estimate), factor)
    return [(begin + offset_ns, end + offset_ns) for begin, end in spans]


def _corrected(
    found: RunOutcome, given: Inputs, request: Request, same_as: Calibrated | None
) -> RunOutcome:
    """Evaluate again with the corrections of findings, and keep the errors without them."""
    corrected: list[Finding] = []
    while len(corrected) < _MOST_CORRECTIONS:
        finding = finding_to_correct(found.diagnosis, request.correct, is_first=not corrected)
        if finding is None:
            break
        changed = request.corrected(finding.correction)
        after = _evaluated(given, changed, same_as)
        tried = Tried.of(found.evaluation, after.evaluation)
        is_hidden = finding.tried is not None and bool(finding.tried.then)
        if tried.raises_errors(finding.cause) and not is_hidden:
            if corrected:
                break
            raise InputError(
                f"the errors grow with {finding.option}; correct the first finding, with "
                "--correct suggested"
            )
        corrected.append(dataclasses.replace(finding, tried=tried))
        found, request = after, changed
    return dataclasses.replace(found, corrected=tuple(corrected))
