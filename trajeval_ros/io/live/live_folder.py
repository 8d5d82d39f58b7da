"""Evaluation of the output folder of a live run, with the pipeline for recorded runs.

`NAME.pairs` has the pairs of an estimate. `NAME.revised.npz` has the last message of one of type
`nav_msgs/Path`: the trajectory as finally revised by the estimator. Then the errors are those
of the revised trajectory, as for the recorded topic. The ATE of the poses as first published is
stored as `causal_ate`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.consistency.covariance_request import CovarianceRequest
from trajeval_ros.exceptions import InputError, SettingsError, TrajevalError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Level, Remark, warning
from trajeval_ros.geometry.arrays import Stamps
from trajeval_ros.geometry.fix_selection import FixRule
from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.geodesy import Datum
from trajeval_ros.geometry.reading import DeclaredReset, Reading
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.live.applied_hand_eye import AppliedHandEye
from trajeval_ros.io.live.fix_file import NAME as FIXES
from trajeval_ros.io.live.fix_file import read_fixes
from trajeval_ros.io.live.pair_file import REVISED_SUFFIX, SUFFIX, RecordedPairs, read_pairs
from trajeval_ros.io.live.reception_file import SUFFIX as RECEIVED_SUFFIX
from trajeval_ros.io.live.reception_file import read_received
from trajeval_ros.io.live.recorded_association import (
    all_groundtruth,
    recorded_association,
    revised_association,
)
from trajeval_ros.io.live.run_state import recorded_remarks, require_run_state
from trajeval_ros.io.requests.request_from import protocol_from
from trajeval_ros.io.requests.setting import NONE
from trajeval_ros.io.requests.settings_table import settings_with
from trajeval_ros.io.results.result_json import statistics_json
from trajeval_ros.metrics.as_available import AvailabilityRule
from trajeval_ros.metrics.association import Association
from trajeval_ros.metrics.input_summary import FixSummary, InputSummary
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.pipeline.outcome import FailedRun, Outcome, RunOutcome
from trajeval_ros.pipeline.pipeline import run_live_pairs
from trajeval_ros.pipeline.request import Request
from trajeval_ros.pipeline.several_runs import with_own_errors

Streams = tuple[Trajectory, Trajectory]


@dataclass(frozen=True, eq=False)
class EvaluatedPairFile:
    """The evaluation of one estimate."""

    place: int  # position of the estimate in the configuration, from 0
    groundtruth: InputSummary  # summary of the groundtruth
    run: RunOutcome  # the evaluation
    fixes: FixRule  # rule for the groundtruth's GNSS fixes; without a datum if there are none
    stated: Mapping[str, Any]  # settings of the node by name


def evaluate_pair_file(path: Path, request: Request, align_with: str | None) -> EvaluatedPairFile:
    """Evaluate one pair file with its own protocol; the request has calibration and tests."""
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
) -> EvaluatedPairFile:
    """Evaluate the content of a pair file; values of a wrong type raise various exceptions."""
    description, state = recorded.description, recorded.state
    require_run_state(description, state)
    groundtruth, estimate = state["groundtruth"], state["estimate"]
    request = dataclasses.replace(request, protocol=_protocol_of(path, state, align_with))
    ups = _up_axes(groundtruth, estimate, request)
    pairs = recorded_association(recorded, request.protocol, ups)
    rule = _fix_rule(state.get("fixes"))
    whole = all_groundtruth(pairs, recorded)
    if rule.datum is not None:
        stamps, fixes = read_fixes(path.parent, rule.datum)
        whole = _with_fixes(whole, stamps, fixes)
        groundtruth_of_pairs = _with_fixes(pairs.groundtruth, stamps, fixes)
        pairs = dataclasses.replace(pairs, groundtruth=groundtruth_of_pairs)
    stated = state.get("stated") or {}
    request = _as_available(request, stated)
    received = path.with_name(name + RECEIVED_SUFFIX)
    streams = None
    if request.available.is_asked_for and received.exists():
        streams = read_received(received, ups)
    live = dict(state["live"])
    remarks = recorded_remarks(state["warnings"], Level.WARNING)
    remarks += _about_end(path, recorded)
    asked_live = _covariances_of(state.get("covariances") or {})
    applied = AppliedHandEye.in_state(state, str(path))
    named = groundtruth, estimate
    if applied is not None:
        applied.require_no_other(request, asked_live.rotation_frame)
        named = applied.renamed(groundtruth, estimate)
        judged = applied.judging(request.covariances)
        request = dataclasses.replace(request, covariances=judged)
        asked_live = applied.judging(asked_live)
    revised = path.with_name(name + REVISED_SUFFIX)
    if revised.exists():
        causal = _run(pairs, named, name, None, request).evaluation
        live["causal_ate"] = {name: statistics_json(ate) for name, ate in causal.ate.items()}
        pairs, estimate = revised_association(pairs, recorded, revised)
    evaluated = partial(_run, pairs, named, name, streams)
    run, why_not = _judged(evaluated, request, asked_live)
    if applied is not None:
        run = applied.told(run)
    evaluation = dataclasses.replace(
        run.evaluation, remarks=(*run.evaluation.remarks, *remarks, *why_not)
    )
    path_length_m = (
        whole.path_length_m if pairs.is_at_groundtruth else groundtruth["path_length_m"]
    )
    summaries = [
        dataclasses.replace(
            InputSummary.of(trajectory, used),
            source=description[side],
            name=name,
            poses=counts["poses"],
            duration_s=counts["duration_s"],
            path_length_m=length_m,
            frame=counts["frame"],
            child_frame=counts["child_frame"],
            fixes=None
            if trajectory.reading.fixes is None or whole.reading.fixes is None
            else FixSummary.of(whole.reading.fixes, counts["dropped"]),
            resets=tuple(DeclaredReset(*each) for each in counts.get("resets") or ()),
        )
        for side, counts, trajectory, used, length_m in (
            ("groundtruth", groundtruth, pairs.groundtruth, evaluation.groundtruth, path_length_m),
            ("estimate", estimate, pairs.estimate, evaluation.estimate, 0.0),
        )
    ]
    run = dataclasses.replace(run, estimate=summaries[1], evaluation=evaluation, live=live)
    return EvaluatedPairFile(description["place"], summaries[0], run, rule, stated)


def _protocol_of(path: Path, state: dict[str, Any], align_with: str | None) -> Protocol:
    """Return the protocol of the live run, with its frozen alignment."""
    try:
        protocol = protocol_from("default", **state["settings"])
    except SettingsError as error:  # a damaged file; other estimates can be valid
        raise InputError(f"{path} is damaged or from another version: {error}") from error
    protocol = dataclasses.replace(protocol, align_with=align_with or protocol.align_with)
    if state["aligned_by"]:  # number of states when the alignment was frozen
        protocol = dataclasses.replace(protocol, align_states=state["aligned_by"])
    return protocol


def _up_axes(
    groundtruth: dict[str, Any], estimate: dict[str, Any], request: Request
) -> list[UpAxis]:
    """Return the up axes of both frames, as requested now or, otherwise, of the live run."""
    ups = [UpAxis(**groundtruth["up"]), UpAxis(**estimate["up"])]
    if request.up is None:
        return ups
    if request.protocol.gauge is Gauge.PLANAR and request.up != tuple(up.name for up in ups):
        raise SettingsError(
            "a live run with gauge planar stores only the components perpendicular to "
            f"{ups[0].name}; to use another vertical axis, evaluate a bag"
        )
    return [UpAxis(axis) for axis in request.up]


def _about_end(path: Path, recorded: RecordedPairs) -> Iterator[Remark]:
    """Yield warnings about an end without the last counts, or with a damaged pair."""
    later = len(recorded.stamps) - recorded.pairs_at_state
    if later or recorded.torn:
        yield warning(
            "live_run_stopped",
            "the live run stopped before its last counts were written: counts of lost and "
            f"dropped messages are from {counted(later, 'pair')} before the end",
        )
    if recorded.torn:
        yield warning(
            "damaged_pairs",
            f"{path.name} is damaged or truncated: the last {counted(recorded.torn, 'byte')} "
            "can't be read",
        )


def _fix_rule(words: dict[str, Any] | None) -> FixRule:
    """Return the rule for GNSS fixes; without a datum if the groundtruth is something else."""
    if words is None:
        return FixRule()
    with _in_file():
        return FixRule(datum=Datum(*words["datum"]), correlation_s=words["correlation_s"])


@contextmanager
def _in_file() -> Iterator[None]:
    """Raise a ValueError for wrong values in a damaged file, which are no mistake of the user."""
    try:
        yield
    except SettingsError as error:
        raise ValueError(str(error)) from error


def _with_fixes(groundtruth: Trajectory, stamps: Stamps, fixes: Fixes) -> Trajectory:
    """Return groundtruth with its fixes, looked up by timestamp in sorted stamps (M,)."""
    rows = stamps.searchsorted(groundtruth.stamps).clip(max=len(stamps) - 1)
    if not np.array_equal(stamps[rows], groundtruth.stamps):
        raise ValueError(f"{FIXES} lacks some of the fixes")
    own = fixes[rows]
    return dataclasses.replace(
        groundtruth, reading=Reading(fixes=own), covariances=own.pose_covariances()
    )


def _judged(
    evaluated: Callable[[Request], RunOutcome], request: Request, asked_live: CovarianceRequest
) -> tuple[RunOutcome, list[Remark]]:
    """Evaluate the pairs and test covariances as requested now or, otherwise, in the live run.

    If a test requested in the live run is not possible, the result has a warning instead.
    """
    if request.covariances.source != "none" or asked_live.source == "none":
        return evaluated(request), []
    try:
        return evaluated(dataclasses.replace(request, covariances=asked_live)), []
    except TrajevalError as error:
        said = f"the consistency test is not possible: {error}"
        return evaluated(request), [warning("no_consistency_test", said)]


def _covariances_of(words: dict[str, Any]) -> CovarianceRequest:
    """Return the live run's request for a consistency test; older files have none."""
    noise = words.get("groundtruth_noise")
    with _in_file():
        return CovarianceRequest(
            words.get("source", "none"),
            rotation_frame=words.get("rotation_frame", "world"),
            groundtruth_noise=None if noise is None else (float(noise[0]), float(noise[1])),
        )


def _run(
    pairs: Association,
    named: tuple[dict[str, Any], dict[str, Any]],
    name: str,
    streams: Streams | None,
    request: Request,
) -> RunOutcome:
    """Evaluate the pairs; states without a pair are known as counts only."""
    sides = [
        dataclasses.replace(
            trajectory,
            name=label,
            frame=counts["frame"],
            child_frame=counts["child_frame"],
            reading=dataclasses.replace(
                trajectory.reading,
                dropped=counts["dropped"],
                remarks=(
                    *recorded_remarks(counts["notes"], Level.NOTE),
                    *trajectory.reading.remarks,
                ),
            ),
        )
        for trajectory, label, counts in (
            (pairs.groundtruth, "groundtruth", named[0]),
            (pairs.estimate, name, {**named[1], "dropped": {}}),
        )
    ]
    pairs = dataclasses.replace(pairs, groundtruth=sides[0], estimate=sides[1])
    return run_live_pairs(pairs, sides[0], sides[1], request, streams)


def _as_available(request: Request, stated: Mapping[str, Any]) -> Request:
    """Return the request with the live run's as-available accuracy, unless it has its own."""
    motion = stated.get("as_available", NONE)
    if request.available.is_asked_for or motion == NONE:
        return request
    with _in_file():
        rule = AvailabilityRule(motion, float(stated["deadline"]))
    return dataclasses.replace(request, available=rule)


def evaluate_folder(
    folder: Path, request: Request | None = None, align_with: str | None = None
) -> Outcome:
    """Evaluate all estimates of a live run, which can still be running, with its own protocol.

    The request has calibration and tests. `align_with` replaces the live run's setting.
    """
    # The gauge is the live run's, also if that was its default.
    request = dataclasses.replace(request or Request(), gauge_is_default=False)
    paths = sorted(folder.glob(f"*{SUFFIX}"))
    if not paths:
        raise InputError(
            f"no live run in {folder} (no file *{SUFFIX}); give the output folder of the evaluator"
        )
    evaluated: list[EvaluatedPairFile] = []
    failed: list[FailedRun] = []
    for path in paths:
        try:
            estimate = evaluate_pair_file(path, request, align_with)
        except SettingsError:
            raise
        except TrajevalError as error:
            name = path.name.removesuffix(SUFFIX)
            failed.append(FailedRun(name, str(path), str(error)))
            continue
        evaluated.append(estimate)
    if not evaluated:
        raise InputError("; ".join(failure.reason for failure in failed))
    evaluated.sort(key=lambda estimate: estimate.place)
    # Jumps are attributed to fixes or estimates by comparing the estimates.
    runs = with_own_errors([each.run for each in evaluated], evaluated[0].fixes)
    request = dataclasses.replace(request, protocol=runs[0].evaluation.protocol)
    settings = settings_with(request, evaluated[0].stated)
    return Outcome(request, evaluated[0].groundtruth, tuple(runs), tuple(failed), settings)
