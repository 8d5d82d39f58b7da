"""What a live run leaves in its folder, evaluated as a recorded one.

`NAME.pairs` holds the pairs of an estimate as they came. `NAME.revised.npz` holds the last message
of an estimate that is a `nav_msgs/Path`: the trajectory as its estimator sees it in the end. Then
the errors are of the revised trajectory, as they are of the recorded topic, and those of each pose
as it was first published stand beside them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.exceptions import InputError, SettingsError, TrajevalError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.gauge import Gauge
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
from trajeval_ros.io.live.pair_file import SUFFIX, RecordedPairs, read_pairs
from trajeval_ros.io.live.run_state import require_run_state
from trajeval_ros.io.npz_file import read_arrays, write_arrays
from trajeval_ros.io.results.result_json import statistics_json
from trajeval_ros.metrics.association import Association, AssociationRule
from trajeval_ros.metrics.coverage import Coverage, CoverageSums, time_without_gaps
from trajeval_ros.metrics.input_summary import InputSummary, fingerprint
from trajeval_ros.metrics.pair_steps import StampedPoses, StepMeter
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.settings import protocol_from
from trajeval_ros.pipeline import FailedRun, Outcome, Request, RunOutcome, run_pairs

REVISED_SUFFIX = ".revised.npz"


@dataclass(frozen=True, eq=False)
class _EvaluatedEstimate:
    """One estimate of a folder: its place among those asked for, its groundtruth and its run."""

    place: int
    groundtruth: InputSummary
    run: RunOutcome


def evaluate_folder(
    folder: Path, request: Request | None = None, align_with: str | None = None
) -> Outcome:
    """Evaluate all estimates of a live run, whether it still goes on or has ended.

    Args:
        folder: The live evaluator's output folder.
        request: What to calibrate and to judge; its protocol is replaced by that of the live run.
        align_with: See `Protocol`; None for what the live run did.

    Raises:
        InputError: There is no pair file, or none can be evaluated.
        SettingsError: The request needs more than pairs.
    """
    request = request or Request()
    paths = sorted(folder.glob(f"*{SUFFIX}"))
    if not paths:
        raise InputError(
            f"{folder} holds no live run: there is no file that ends in {SUFFIX}; name the "
            "evaluator's output folder"
        )
    found: list[_EvaluatedEstimate] = []
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
        found.append(estimate)
    if not found:
        raise InputError("; ".join(each.reason for each in failed))
    found.sort(key=lambda each: each.place)
    runs = tuple(each.run for each in found)
    return Outcome(request, found[0].groundtruth, runs, tuple(failed))


def write_revised(path: Path, stamps: Stamps, positions: Floats, quaternions: Floats) -> None:
    """Write the poses of a path, (N,), (N, 3), (N, 4), to a file."""
    columns = {"stamps": stamps, "positions": positions, "quaternions": quaternions}
    write_arrays(path, columns, compressed=False)


def _evaluate(path: Path, request: Request, align_with: str | None) -> _EvaluatedEstimate:
    """Evaluate one estimate."""
    recorded = read_pairs(path)
    name = path.name.removesuffix(SUFFIX)
    if not len(recorded.stamps):
        raise InputError(f"{name}: no pair of estimate and groundtruth was made")
    try:
        return _evaluate_pairs(path, name, recorded, request, align_with)
    except (KeyError, TypeError, AttributeError, ValueError, ArithmeticError) as error:
        raise InputError(f"{path} isn't as this version writes it: {error!r}") from error


def _evaluate_pairs(
    path: Path, name: str, recorded: RecordedPairs, request: Request, align_with: str | None
) -> _EvaluatedEstimate:
    description, state = recorded.description, recorded.state
    require_run_state(description, state)
    truth, estimate = state["groundtruth"], state["estimate"]
    try:
        protocol = protocol_from("default", **state["settings"])
    except SettingsError as error:  # not the user's: other estimates may have better ones
        raise InputError(f"{path} isn't as this version writes it: {error}") from error
    protocol = dataclasses.replace(protocol, align_with=align_with or protocol.align_with)
    if state["aligned_by"]:  # the states up to the moment when the alignment was frozen
        protocol = dataclasses.replace(protocol, align_states=state["aligned_by"])
    request = dataclasses.replace(request, protocol=protocol)
    ups = [UpAxis(**truth["up"]), UpAxis(**estimate["up"])]
    if request.up is not None:
        if protocol.gauge is Gauge.PLANAR and request.up != tuple(each.name for each in ups):
            raise SettingsError(
                f"a live run of gauge planar keeps what lies in the plane across {ups[0].name}, "
                "and another up axis needs the rest; evaluate a bag"
            )
        ups = [UpAxis(each) for each in request.up]
    pairs, truth_notes, notes = _association(recorded, protocol, ups)
    live, warnings = dict(state["live"]), list(state["warnings"])
    later = len(recorded.stamps) - recorded.pairs_at_state
    if later or recorded.torn:
        warnings.append(
            "the live run ended without its last counts: what was lost and dropped is told as of "
            f"{later} pairs before the end"
        )
    if recorded.torn:
        warnings.append(
            f"{path.name} is damaged, or was cut short: {recorded.torn} bytes at its end can't be "
            "read, with the pairs in them"
        )
    revised = path.with_name(name + REVISED_SUFFIX)
    if revised.exists():
        causal = _run(pairs, request, truth, estimate, name).evaluation
        live["causal_ate"] = {each: statistics_json(of) for each, of in causal.ate.items()}
        pairs, estimate = _revised(pairs, recorded, revised)
    run = _run(pairs, request, truth, estimate, name)
    evaluation = dataclasses.replace(
        run.evaluation, warnings=(*run.evaluation.warnings, *warnings)
    )
    summaries = [
        InputSummary(
            source=description[side],
            name=name,
            poses=counts["poses"],
            duration_s=counts["duration_s"],
            path_length_m=counts.get("path_length_m", 0.0),
            frame=counts["frame"],
            child_frame=counts["child_frame"],
            up=trajectory.up,
            notes=(*counts["notes"], *said, *used.notes),
            fingerprint=fingerprint(trajectory),
        )
        for side, counts, trajectory, said, used in (
            ("groundtruth", truth, pairs.groundtruth, truth_notes, evaluation.groundtruth),
            ("estimate", estimate, pairs.estimate, notes, evaluation.estimate),
        )
    ]
    run = dataclasses.replace(run, estimate=summaries[1], evaluation=evaluation, live=live)
    return _EvaluatedEstimate(description["place"], summaries[0], run)


def _association(
    recorded: RecordedPairs, protocol: Protocol, ups: Sequence[UpAxis]
) -> tuple[Association, tuple[str, ...], tuple[str, ...]]:
    """Return the pairs in order of their stamps, with the counts, and notes about either side."""
    # A stamp that is there twice came again when nobody remembered it, as in a bag played anew.
    usable = np.flatnonzero(_are_states(recorded.groundtruth) & _are_states(recorded.estimate))
    stamps, order = np.unique(recorded.stamps[usable], return_index=True)
    order = usable[order]
    again = len(usable) - len(stamps)
    later = len(recorded.stamps) - recorded.pairs_at_state
    groundtruth, truth_notes = _trajectory(stamps, recorded.groundtruth[order])
    estimate, notes = _trajectory(stamps, recorded.estimate[order])
    rule = protocol.association
    pairs = Association(
        rule=rule,
        groundtruth=dataclasses.replace(groundtruth, up=ups[0]),
        estimate=dataclasses.replace(estimate, up=ups[1]),
        estimate_coverage=len(stamps) / (recorded.state["estimate"]["states"] + later - again),
        coverage=_coverage(groundtruth, recorded, rule),
        dropped=add_counts(
            recorded.state["dropped"],
            {"duplicate_stamp": again, "not_finite": len(recorded.stamps) - len(usable)},
        ),
    )
    return pairs, truth_notes, notes


def _are_states(rows: Floats) -> Booleans:
    """Return which poses (N, 7) or states (N, 10) can be; NaN stands for what isn't known."""
    finite, turned = judge_poses(rows[:, :3], np.nan_to_num(rows[:, 3:7], nan=1.0))
    return finite & turned & ~(np.abs(rows[:, 7:]) > LARGEST).any(axis=1)


def _coverage(groundtruth: Trajectory, recorded: RecordedPairs, rule: AssociationRule) -> Coverage:
    """Return what pairs cover, whose groundtruth's states these are."""
    max_gap_ns = round(rule.max_gap_s * NANOSECONDS)
    pairs = StampedPoses.of(groundtruth, np.arange(len(groundtruth)))
    sums = CoverageSums(rule.max_gap_s)
    waypoints = _usable(recorded.waypoints)
    sums.add(StepMeter(max_gap_ns).measure(waypoints, pairs))
    truth = recorded.state["groundtruth"]
    # Of a run that was killed, the newest counts are older than the newest pairs.
    passed_ns = time_without_gaps(waypoints.stamps, max_gap_ns)
    return sums.coverage(max(truth["time_without_gaps_ns"], passed_ns), max(truth["states"], 1))


def _usable(waypoints: StampedPoses) -> StampedPoses:
    rows = np.flatnonzero(_are_states(waypoints.poses))
    rows = rows[np.argsort(waypoints.stamps[rows], kind="stable")]
    return StampedPoses(waypoints.stamps[rows], waypoints.poses[rows])


def _trajectory(stamps: Stamps, rows: Floats) -> tuple[Trajectory, tuple[str, ...]]:
    """Return states (N, 10) as a trajectory of what was measured, and notes about it."""
    turns, velocities = rows[:, 3:7], rows[:, 7:]
    quaternions, notes = judge_rotations(None if np.isnan(turns).any() else turns)
    return Trajectory(
        stamps,
        rows[:, :3],
        None if quaternions is None else lie.normalized(quaternions),
        None if np.isnan(velocities).any() or not velocities.any() else velocities,
    ), notes


def _read_revised(path: Path) -> Trajectory:
    arrays = read_arrays(path, ("stamps", "positions", "quaternions"))
    kinds = [(name, array.dtype.kind, array.shape) for name, array in arrays.items()]
    count = len(arrays["stamps"]) if arrays.get("stamps", np.zeros(())).ndim else 0
    if not count or kinds != [
        ("stamps", "i", (count,)),
        ("positions", "f", (count, 3)),
        ("quaternions", "f", (count, 4)),
    ]:
        raise InputError(f"{path} holds no stamps, positions and quaternions, each as many")
    if not np.logical_and(*judge_poses(arrays["positions"], arrays["quaternions"])).all():
        raise InputError(f"{path} holds poses that aren't finite")
    return Trajectory(arrays["stamps"], arrays["positions"], lie.normalized(arrays["quaternions"]))


def _revised(
    causal: Association, recorded: RecordedPairs, path: Path
) -> tuple[Association, dict[str, Any]]:
    """Return the pairs with the estimator's last word, and the counts of its poses."""
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
        estimate_coverage=len(rows) / len(stamps),
        coverage=_coverage(groundtruth, recorded, causal.rule),
        dropped=dropped,
    )
    return pairs, {
        **recorded.state["estimate"],
        "poses": len(stamps),
        "duration_s": float(stamps.max() - stamps.min()) / NANOSECONDS,
    }


def _run(
    pairs: Association,
    request: Request,
    truth: dict[str, Any],
    estimate: dict[str, Any],
    name: str,
) -> RunOutcome:
    """Evaluate the pairs; the states that are in none are known by their counts alone."""
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
