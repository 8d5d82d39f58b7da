"""Evaluation of the output folder of a live run, with the pipeline for recorded runs.

`NAME.pairs` has the pairs of an estimate, `NAME.2.pairs` those of its second segment, after a
restart or a step back in time. A segment is evaluated as a run of its own.

`NAME.revised.npz` has the last message of an estimate of type `nav_msgs/Path`: the trajectory as
finally revised by the estimator. Then the errors are those of the revised trajectory, as for the
recorded topic. The ATE of the poses as first published is stored as `causal_ate`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.consistency.covariance_request import CovarianceRequest
from trajeval_ros.exceptions import InputError, SettingsError, TrajevalError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.fixes import Fixes, FixRule
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.geodesy import Datum
from trajeval_ros.geometry.trajectory import (
    LARGEST,
    NANOSECONDS,
    NO_STATE,
    Trajectory,
    add_counts,
    judge_poses,
)
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.checks import judge_rotations
from trajeval_ros.io.live.applied_hand_eye import AppliedHandEye
from trajeval_ros.io.live.fix_file import NAME as FIXES
from trajeval_ros.io.live.fix_file import read_fixes
from trajeval_ros.io.live.pair_file import SUFFIX, RecordedPairs, read_pairs
from trajeval_ros.io.live.run_state import require_run_state
from trajeval_ros.io.npz_file import read_arrays, write_arrays
from trajeval_ros.io.results.result_json import statistics_json
from trajeval_ros.metrics.association import AT_GROUNDTRUTH, Association, AssociationRule
from trajeval_ros.metrics.completeness import completeness
from trajeval_ros.metrics.coverage import Coverage, CoverageSums, time_without_gaps
from trajeval_ros.metrics.input_summary import FixSummary, InputSummary, fingerprint
from trajeval_ros.metrics.interpolation import Interpolation
from trajeval_ros.metrics.pair_steps import StampedPoses, StepMeter
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.settings import protocol_from
from trajeval_ros.pipeline.outcome import FailedRun, Outcome, RunOutcome
from trajeval_ros.pipeline.pipeline import run_pairs
from trajeval_ros.pipeline.request import Request
from trajeval_ros.pipeline.several_runs import with_own_errors

REVISED_SUFFIX = ".revised.npz"


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


def write_revised(path: Path, stamps: Stamps, positions: Floats, quaternions: Floats) -> None:
    """Write the poses of a path, stamps (N,), positions (N, 3), quaternions (N, 4), to a file."""
    columns = {"stamps": stamps, "positions": positions, "quaternions": quaternions}
    write_arrays(path, columns, compressed=False)


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
    pairs, truth_notes, notes = _association(recorded, protocol, ups)
    rule = _fix_rule(state.get("fixes"))
    whole = _all_groundtruth(pairs, recorded)
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
        pairs, estimate = _revised(pairs, recorded, revised)
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


def _all_groundtruth(pairs: Association, recorded: RecordedPairs) -> Trajectory:
    """Return the groundtruth's states in pairs and the recorded ones between them, in order."""
    others = _usable(recorded.waypoints)
    stamps = np.concatenate([pairs.groundtruth.stamps, others.stamps])
    positions = np.concatenate([pairs.groundtruth.positions, others.poses[:, :3]])
    stamps, first = np.unique(stamps, return_index=True)
    return Trajectory(stamps, positions[first])


def _with_fixes(truth: Trajectory, stamps: Stamps, fixes: Fixes) -> Trajectory:
    """Return groundtruth with its fixes, looked up by timestamp in sorted stamps (M,)."""
    rows = stamps.searchsorted(truth.stamps).clip(max=len(stamps) - 1)
    if not np.array_equal(stamps[rows], truth.stamps):
        raise ValueError(f"{FIXES} lacks some of the fixes")
    own = fixes[rows]
    return dataclasses.replace(truth, fixes=own, covariances=own.pose_covariances())


def _association(
    recorded: RecordedPairs, protocol: Protocol, ups: Sequence[UpAxis]
) -> tuple[Association, tuple[str, ...], tuple[str, ...]]:
    """Return the pairs in order of time with counts, and notes about groundtruth and estimate."""
    # A timestamp occurs twice if the bag was played again after its states were dropped.
    usable = np.flatnonzero(_are_states(recorded.groundtruth) & _are_states(recorded.estimate))
    stamps, order = np.unique(recorded.stamps[usable], return_index=True)
    order = usable[order]
    again = len(usable) - len(stamps)
    later = len(recorded.stamps) - recorded.pairs_at_state
    groundtruth, truth_notes = _trajectory(stamps, recorded.groundtruth[order])
    estimate, notes = _trajectory(stamps, recorded.estimate[order])
    if recorded.covariances is not None:
        estimate = dataclasses.replace(estimate, covariances=recorded.covariances[order])
    first = recorded.state["estimate"].get("first_stamp_ns")
    oriented = groundtruth.quaternions is not None
    rule = protocol.association.for_kind("poses" if oriented else "points")
    states = recorded.state["estimate"]["states"] + later - again
    is_sparse = rule.method == AT_GROUNDTRUTH
    pairs = Association(
        rule=rule,
        groundtruth=dataclasses.replace(groundtruth, up=ups[0]),
        estimate=dataclasses.replace(estimate, up=ups[1]),
        estimate_coverage=None if is_sparse else len(stamps) / states,
        coverage=_coverage(groundtruth, recorded, rule),
        dropped=add_counts(
            recorded.state["dropped"],
            {"duplicate_stamp": again, "not_finite": len(recorded.stamps) - len(usable)},
        ),
        from_the_start=is_sparse or first is None or first == int(stamps[0]),
        interpolation=_interpolation(recorded.state["estimate"].get("interpolation")),
    )
    return pairs, truth_notes, notes


def _interpolation(words: Mapping[str, float] | None) -> Interpolation | None:
    """Return what a state says of the estimate's states; older ones say nothing."""
    if words is None:
        return None
    return Interpolation(float(words["step_s"]), float(words["off_m"]))


def _are_states(rows: Floats) -> Booleans:
    """Return which poses (N, 7) or states (N, 10) are valid; NaN means not measured."""
    finite, turned = judge_poses(rows[:, :3], np.nan_to_num(rows[:, 3:7], nan=1.0))
    return finite & turned & ~(np.abs(rows[:, 7:]) > LARGEST).any(axis=1)


def _coverage(groundtruth: Trajectory, recorded: RecordedPairs, rule: AssociationRule) -> Coverage:
    """Return the coverage of pairs with these groundtruth states."""
    if rule.method == AT_GROUNDTRUTH:
        missing = _usable(recorded.waypoints)
        stamps = np.concatenate([groundtruth.stamps, missing.stamps])
        positions = np.concatenate([groundtruth.positions, missing.poses[:, :3]])
        order = np.argsort(stamps, kind="stable")
        paired = np.flatnonzero(order < len(groundtruth))
        return completeness(Trajectory(stamps[order], positions[order]), paired)
    max_gap_ns = round(rule.max_gap_s * NANOSECONDS)
    pairs = StampedPoses.of(groundtruth, np.arange(len(groundtruth)))
    sums = CoverageSums(rule.max_gap_s)
    waypoints = _usable(recorded.waypoints)
    sums.add(StepMeter(max_gap_ns).measure(waypoints, pairs))
    truth = recorded.state["groundtruth"]
    # In a killed run, the newest counts are older than the newest pairs.
    passed_ns = time_without_gaps(waypoints.stamps, max_gap_ns)
    return sums.coverage(max(truth["time_without_gaps_ns"], passed_ns), max(truth["states"], 1))


def _usable(waypoints: StampedPoses) -> StampedPoses:
    """Return the valid waypoints in order of time."""
    rows = np.flatnonzero(_are_states(waypoints.poses))
    rows = rows[np.argsort(waypoints.stamps[rows], kind="stable")]
    return StampedPoses(waypoints.stamps[rows], waypoints.poses[rows])


def _trajectory(stamps: Stamps, rows: Floats) -> tuple[Trajectory, tuple[str, ...]]:
    """Return states (N, 10) as a trajectory without unmeasured quantities, and notes about it."""
    turns, velocities = rows[:, 3:7], rows[:, 7:]
    quaternions, notes = judge_rotations(None if np.isnan(turns).any() else turns)
    return Trajectory(
        stamps,
        rows[:, :3],
        None if quaternions is None else lie.normalized(quaternions),
        None if np.isnan(velocities).any() or not velocities.any() else velocities,
    ), notes


def _read_revised(path: Path) -> Trajectory:
    """Return the trajectory in a file of `write_revised`."""
    arrays = read_arrays(path, ("stamps", "positions", "quaternions"))
    kinds = [(name, array.dtype.kind, array.shape) for name, array in arrays.items()]
    count = len(arrays["stamps"]) if arrays.get("stamps", np.zeros(())).ndim else 0
    if not count or kinds != [
        ("stamps", "i", (count,)),
        ("positions", "f", (count, 3)),
        ("quaternions", "f", (count, 4)),
    ]:
        raise InputError(
            f"{path} must have equal numbers of timestamps, positions and quaternions"
        )
    if not np.logical_and(*judge_poses(arrays["positions"], arrays["quaternions"])).all():
        raise InputError(f"{path} has poses that are not finite")
    return Trajectory(arrays["stamps"], arrays["positions"], lie.normalized(arrays["quaternions"]))


def _revised(
    causal: Association, recorded: RecordedPairs, path: Path
) -> tuple[Association, dict[str, Any]]:
    """Return the pairs with the finally revised poses, and the counts of these."""
    revised = dataclasses.replace(_read_revised(path), up=causal.estimate.up)
    stamps = revised.stamps
    rows, places = np.intersect1d(causal.estimate.stamps, stamps, return_indices=True)[1:]
    groundtruth, estimate = causal.groundtruth[rows], revised[places]
    unpaired = len(stamps) - len(rows)
    dropped = causal.dropped
    if sum(count for reason, count in dropped.items() if reason not in NO_STATE) != unpaired:
        dropped = add_counts(
            {reason: count for reason, count in dropped.items() if reason in NO_STATE},
            {"without_pair_when_first_published": unpaired},
        )
    pairs = dataclasses.replace(
        causal,
        groundtruth=groundtruth,
        estimate=estimate,
        estimate_coverage=causal.estimate_coverage and len(rows) / len(stamps),
        coverage=_coverage(groundtruth, recorded, causal.rule),
        dropped=dropped,
    )
    return pairs, {
        **recorded.state["estimate"],
        "poses": len(stamps),
        "duration_s": float(stamps.max() - stamps.min()) / NANOSECONDS,
    }


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
