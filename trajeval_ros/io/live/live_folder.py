"""Evaluation of the output folder of a live run, with the pipeline for recorded runs.

`NAME.pairs` has the pairs of an estimate, `NAME.2.pairs` those of its second segment, after a
restart or a step back in time. A segment is evaluated as a run of its own.

`NAME.revised.npz` has the last message of an estimate of type `nav_msgs/Path`: the trajectory as
finally revised by the estimator. Then the errors are those of the revised trajectory, as for the
recorded topic. The ATE of the poses as first published is stored as `causal_ate`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.consistency.covariance_request import CovarianceRequest
from trajeval_ros.exceptions import InputError, SettingsError, TrajevalError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Stamps
from trajeval_ros.geometry.fix_selection import FixRule
from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.geodesy import Datum
from trajeval_ros.geometry.trajectory import (
    Trajectory,
)
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.live.applied_hand_eye import AppliedHandEye
from trajeval_ros.io.live.fix_file import NAME as FIXES
from trajeval_ros.io.live.fix_file import read_fixes
from trajeval_ros.io.live.pair_file import SUFFIX, RecordedPairs, read_pairs
from trajeval_ros.io.live.recorded_association import (
    all_groundtruth,
    recorded_association,
    revised_association,
)
from trajeval_ros.io.live.revised_file import REVISED_SUFFIX
from trajeval_ros.io.live.run_state import require_run_state
from trajeval_ros.io.results.result_json import statistics_json
from trajeval_ros.metrics.association import Association
from trajeval_ros.metrics.input_summary import FixSummary, InputSummary, fingerprint
from trajeval_ros.metrics.settings import protocol_from
from trajeval_ros.pipeline.outcome import FailedRun, Outcome, RunOutcome
from trajeval_ros.pipeline.pipeline import run_pairs
from trajeval_ros.pipeline.request import Request
from trajeval_ros.pipeline.several_runs import with_own_errors


@dataclass(frozen=True, eq=False)
class _EvaluatedEstimate:
    """The evaluation of one segment of an estimate.

    `place` is its position in the configuration, `fixes` the rule for the groundtruth's fixes.
    """

    place: int
    segment: int
    groundtruth: InputSummary
    run: RunOutcome
    fixes: FixRule


def evaluate_folder(
    folder: Path, request: Request | None = None, align_with: str | None = None
) -> Outcome:
    """Evaluate all estimates of a live run, which can still be running.

    Args:
        folder: The live evaluator's output folder.
        request: Calibration and tests; its protocol is replaced by that of the live run.
        align_with: See `Protocol`; None for the live run's setting.

    Raises:
        InputError: There is no pair file, or none can be evaluated.
        SettingsError: The request needs data that pairs do not have.
    """
    # The gauge is the live run's, also if that was its default.
    request = dataclasses.replace(request or Request(), gauge_is_default=False)
    paths = sorted(folder.glob(f"*{SUFFIX}"))
    if not paths:
        raise InputError(
            f"no live run in {folder} (no file *{SUFFIX}); give the output folder of the evaluator"
        )
    evaluated: list[_EvaluatedEstimate] = []
    failed: list[FailedRun] = []
    for path in paths:
        try:
            estimate = _evaluate(path, request, align_with)
        except SettingsError:
            raise
        except TrajevalError as error:
            name = path.name.removesuffix(SUFFIX)
            failed.append(FailedRun(name, str(path), str(error)))
            continue
        evaluated.append(estimate)
    if not evaluated:
        raise InputError("; ".join(failure.reason for failure in failed))
    evaluated.sort(key=lambda estimate: (estimate.place, estimate.segment))
    runs = tuple(_with_own_errors(evaluated))
    return Outcome(request, evaluated[0].groundtruth, runs, tuple(failed))


def _with_own_errors(evaluated: Sequence[_EvaluatedEstimate]) -> Iterator[RunOutcome]:
    """Yield the runs, with own errors if the groundtruth is GNSS fixes.

    Jumps are attributed to fixes or estimates by comparing the estimates of one segment.
    """
    completed: dict[int, RunOutcome] = {}
    for segment in {estimate.segment for estimate in evaluated}:
        rows = [row for row, estimate in enumerate(evaluated) if estimate.segment == segment]
        runs = with_own_errors([evaluated[row].run for row in rows], evaluated[rows[0]].fixes)
        completed.update(zip(rows, runs, strict=True))
    for row in range(len(evaluated)):
        yield completed[row]


def _evaluate(path: Path, request: Request, align_with: str | None) -> _EvaluatedEstimate:
    """Evaluate one pair file."""
    recorded = read_pairs(path)
    name = path.name.removesuffix(SUFFIX)
    if not len(recorded.stamps):
        raise InputError(f"{name}: no pairs of estimate and groundtruth")
    try:
        return _evaluate_pairs(path, name, recorded, request, align_with)
    except (KeyError, TypeError, AttributeError, ValueError, ArithmeticError) as error:
        raise InputError(f"{path} is damaged or from another version: {error!r}") from error


def _evaluate_pairs(
    path: Path, name: str, recorded: RecordedPairs, request: Request, align_with: str | None
) -> _EvaluatedEstimate:
    """Evaluate the content of a pair file; values of a wrong type raise various exceptions."""
    description, state = recorded.description, recorded.state
    require_run_state(description, state)
    truth, estimate = state["groundtruth"], state["estimate"]
    try:
        protocol = protocol_from("default", **state["settings"])
    except SettingsError as error:  # a damaged file; other estimates can be valid
        raise InputError(f"{path} is damaged or from another version: {error}") from error
    protocol = dataclasses.replace(protocol, align_with=align_with or protocol.align_with)
    if state["aligned_by"]:  # number of states when the alignment was frozen
        protocol = dataclasses.replace(protocol, align_states=state["aligned_by"])
    request = dataclasses.replace(request, protocol=protocol)
    ups = [UpAxis(**truth["up"]), UpAxis(**estimate["up"])]
    if request.up is not None:
        if protocol.gauge is Gauge.PLANAR and request.up != tuple(up.name for up in ups):
            raise SettingsError(
                "a live run with gauge planar stores only the components perpendicular to "
                f"{ups[0].name}; to use another vertical axis, evaluate a bag"
            )
        ups = [UpAxis(axis) for axis in request.up]
    pairs, truth_notes, notes = recorded_association(recorded, protocol, ups)
    rule = _fix_rule(state.get("fixes"))
    whole = all_groundtruth(pairs, recorded)
    if rule.datum is not None:
        stamps, fixes = read_fixes(path.parent, rule.datum)
        whole, truth_notes = _with_fixes(whole, stamps, fixes), ()
        truth_of_pairs = _with_fixes(pairs.groundtruth, stamps, fixes)
        pairs = dataclasses.replace(pairs, groundtruth=truth_of_pairs)
    live, warnings = dict(state["live"]), list(state["warnings"])
    later = len(recorded.stamps) - recorded.pairs_at_state
    if later or recorded.torn:
        warnings.append(
            "the live run stopped before its last counts were written: counts of lost and "
            f"dropped messages are from {counted(later, 'pair')} before the end"
        )
    if recorded.torn:
        warnings.append(
            f"{path.name} is damaged or truncated: the last {counted(recorded.torn, 'byte')} "
            "can't be read"
        )
    asked_live = _covariances_of(state.get("covariances") or {})
    applied = AppliedHandEye.in_state(state, str(path))
    named = truth, estimate
    if applied is not None:
        applied.require_no_other(request, asked_live.rotation_frame)
        named = applied.renamed(truth, estimate)
        judged = applied.judging(request.covariances)
        request = dataclasses.replace(request, covariances=judged)
        asked_live = applied.judging(asked_live)
    revised = path.with_name(name + REVISED_SUFFIX)
    if revised.exists():
        causal = _run(pairs, request, *named, name).evaluation
        live["causal_ate"] = {name: statistics_json(ate) for name, ate in causal.ate.items()}
        pairs, estimate = revised_association(pairs, recorded, revised)
    run, why_not = _judged(pairs, request, *named, name, asked_live)
    if applied is not None:
        run = applied.told(run)
    evaluation = dataclasses.replace(
        run.evaluation, warnings=(*run.evaluation.warnings, *warnings, *why_not)
    )
    summaries = [
        InputSummary(
            source=description[side],
            name=name,
            poses=counts["poses"],
            duration_s=counts["duration_s"],
            path_length_m=length_m,
            frame=counts["frame"],
            child_frame=counts["child_frame"],
            up=trajectory.up,
            kind=trajectory.kind,
            fixes=None
            if trajectory.fixes is None or whole.fixes is None
            else FixSummary.of(whole.fixes, counts["dropped"]),
            notes=(*counts["notes"], *said, *used.notes),
            fingerprint=fingerprint(trajectory),
        )
        for side, counts, trajectory, said, used, length_m in (
            (
                "groundtruth",
                truth,
                pairs.groundtruth,
                truth_notes,
                evaluation.groundtruth,
                whole.path_length_m if pairs.is_at_groundtruth else truth["path_length_m"],
            ),
            ("estimate", estimate, pairs.estimate, notes, evaluation.estimate, 0.0),
        )
    ]
    run = dataclasses.replace(run, estimate=summaries[1], evaluation=evaluation, live=live)
    place, segment = description["place"], description.get("segment", 1)
    return _EvaluatedEstimate(place, segment, summaries[0], run, rule)


def _fix_rule(words: dict[str, Any] | None) -> FixRule:
    """Return the rule for GNSS fixes; without a datum if the groundtruth is something else."""
    if words is None:
        return FixRule()
    try:
        return FixRule(datum=Datum(*words["datum"]), correlation_s=words["correlation_s"])
    except SettingsError as error:  # a damaged file, no mistake of the user
        raise ValueError(str(error)) from error


def _with_fixes(truth: Trajectory, stamps: Stamps, fixes: Fixes) -> Trajectory:
    """Return groundtruth with its fixes, looked up by timestamp in sorted stamps (M,)."""
    rows = stamps.searchsorted(truth.stamps).clip(max=len(stamps) - 1)
    if not np.array_equal(stamps[rows], truth.stamps):
        raise ValueError(f"{FIXES} lacks some of the fixes")
    own = fixes[rows]
    return dataclasses.replace(truth, fixes=own, covariances=own.pose_covariances())


def _judged(
    pairs: Association,
    request: Request,
    truth: dict[str, Any],
    estimate: dict[str, Any],
    name: str,
    asked_live: CovarianceRequest,
) -> tuple[RunOutcome, list[str]]:
    """Evaluate the pairs and test covariances as requested now or, otherwise, in the live run.

    If a test requested in the live run is not possible, the result has a warning instead.
    """
    if request.covariances.source != "none" or asked_live.source == "none":
        return _run(pairs, request, truth, estimate, name), []
    try:
        asked = dataclasses.replace(request, covariances=asked_live)
        return _run(pairs, asked, truth, estimate, name), []
    except TrajevalError as error:
        run = _run(pairs, request, truth, estimate, name)
        return run, [f"the consistency test is not possible: {error}"]


def _covariances_of(words: dict[str, Any]) -> CovarianceRequest:
    """Return the live run's request for a consistency test; older files have none."""
    noise = words.get("groundtruth_noise")
    try:
        return CovarianceRequest(
            words.get("source", "none"),
            rotation_frame=words.get("rotation_frame", "world"),
            groundtruth_noise=None if noise is None else (float(noise[0]), float(noise[1])),
        )
    except SettingsError as error:  # a damaged file, no mistake of the user
        raise ValueError(str(error)) from error


def _run(
    pairs: Association,
    request: Request,
    truth: dict[str, Any],
    estimate: dict[str, Any],
    name: str,
) -> RunOutcome:
    """Evaluate the pairs; states without a pair are known as counts only."""
    sides = [
        dataclasses.replace(
            trajectory,
            name=label,
            frame=counts["frame"],
            child_frame=counts["child_frame"],
            dropped=counts["dropped"],
        )
        for trajectory, label, counts in (
            (pairs.groundtruth, "groundtruth", truth),
            (pairs.estimate, name, {**estimate, "dropped": {}}),
        )
    ]
    pairs = dataclasses.replace(pairs, groundtruth=sides[0], estimate=sides[1])
    return run_pairs(pairs, sides[0], sides[1], request)
