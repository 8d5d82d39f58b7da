"""What a live run leaves in its folder, evaluated as a recorded one.

`NAME.pairs` holds the pairs of an estimate as they came. `NAME.revised.npz` holds the last message
of an estimate that is a `nav_msgs/Path`: the trajectory as its estimator sees it in the end. Then
the errors are of the revised trajectory, as they are of the recorded topic, and those of each pose
as it was first published stand beside them.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.exceptions import InputError, TrajevalError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.trajectory import NANOSECONDS, NO_STATE, Trajectory, add_counts
from trajeval_ros.io.checks import judge_rotations
from trajeval_ros.io.live.pair_file import SUFFIX, Floats, RecordedPairs, Stamps, read_pairs
from trajeval_ros.io.results.result_json import Input, Run, fingerprint, result_of, statistics_json
from trajeval_ros.metrics.association import Association, AssociationRule
from trajeval_ros.metrics.coverage import coverage_of
from trajeval_ros.metrics.evaluation import Evaluation, evaluate_pairs
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.settings import protocol_from

REVISED_SUFFIX = ".revised.npz"


@dataclass(frozen=True, eq=False)
class LiveFolder:
    """The runs of a folder.

    Attributes:
        groundtruth: What they were compared with.
        runs: The estimates that could be evaluated.
        failed: The others: name, source and reason.
    """

    groundtruth: Input
    runs: list[Run]
    failed: list[dict[str, str]]

    @property
    def result(self) -> dict[str, Any]:
        """The result, as of recorded runs, with the estimates that failed."""
        return result_of(self.groundtruth, self.runs, self.failed)


@dataclass(frozen=True, eq=False)
class _Found:
    """One estimate of a folder: its place among those asked for, its groundtruth and its run."""

    place: int
    groundtruth: Input
    run: Run


def evaluate_folder(folder: Path) -> LiveFolder:
    """Evaluate all estimates of a live run, going on or over.

    Raises:
        InputError: There is no pair file, or none can be evaluated.
    """
    paths = sorted(folder.glob(f"*{SUFFIX}"))
    if not paths:
        raise InputError(
            f"{folder} holds no live run: there is no file that ends in {SUFFIX}; name the "
            "evaluator's output folder"
        )
    found: list[_Found] = []
    failed: list[dict[str, str]] = []
    for path in paths:
        try:
            estimate = _evaluate(path)
        except TrajevalError as error:
            name = path.name.removesuffix(SUFFIX)
            failed.append({"name": name, "source": str(path), "reason": str(error)})
            continue
        found.append(estimate)
    if not found:
        raise InputError("; ".join(each["reason"] for each in failed))
    found.sort(key=lambda each: each.place)
    return LiveFolder(found[0].groundtruth, [each.run for each in found], failed)


def write_revised(path: Path, stamps: Stamps, positions: Floats, quaternions: Floats) -> None:
    """Write the poses of a path, (N,), (N, 3), (N, 4), to a file."""
    with path.open("wb") as file:
        np.savez(file, stamps=stamps, positions=positions, quaternions=quaternions)


def _evaluate(path: Path) -> _Found:
    """Evaluate one estimate."""
    recorded = read_pairs(path)
    name = path.name.removesuffix(SUFFIX)
    if not len(recorded.stamps):
        raise InputError(f"{name}: no pair of estimate and groundtruth was made")
    try:
        return _evaluate_pairs(path, name, recorded)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise InputError(f"{path} isn't as this version writes it: {error!r}") from error


def _evaluate_pairs(path: Path, name: str, recorded: RecordedPairs) -> _Found:
    description, state = recorded.description, recorded.state
    truth, estimate = state["groundtruth"], state["estimate"]
    protocol = protocol_from("default", **state["settings"])
    if state["aligned_by"]:  # the states up to the moment when the alignment was frozen
        protocol = dataclasses.replace(protocol, align_states=state["aligned_by"])
    pairs, truth_notes, notes = _association(recorded, protocol)
    live, warnings = dict(state["live"]), list(state["warnings"])
    later = len(recorded.stamps) - recorded.pairs_at_state
    if later or recorded.torn:
        warnings.append(
            "the live run ended without its last counts: what was lost and dropped is told as of "
            f"{later} pairs before the end"
        )
    revised = path.with_name(name + REVISED_SUFFIX)
    if revised.exists():
        causal = _evaluation(pairs, protocol, truth, estimate, name)
        live["causal_ate"] = {each: statistics_json(of) for each, of in causal.ate.items()}
        pairs, estimate = _revised(pairs, truth, estimate, revised)
    evaluation = _evaluation(pairs, protocol, truth, estimate, name)
    evaluation = dataclasses.replace(evaluation, warnings=(*evaluation.warnings, *warnings))
    sides = (
        Input(
            source=description[side],
            name=name,
            poses=counts["poses"],
            duration_s=counts["duration_s"],
            path_length_m=counts.get("path_length_m", 0.0),
            frame=counts["frame"],
            child_frame=counts["child_frame"],
            notes=(*counts["notes"], *said),
            fingerprint=fingerprint(trajectory),
        )
        for side, counts, trajectory, said in (
            ("groundtruth", truth, pairs.groundtruth, truth_notes),
            ("estimate", estimate, pairs.estimate, notes),
        )
    )
    return _Found(description["place"], next(sides), Run(next(sides), evaluation, live))


def _association(
    recorded: RecordedPairs, protocol: Protocol
) -> tuple[Association, tuple[str, ...], tuple[str, ...]]:
    """Return the pairs in order of their stamps, with the counts, and notes about either side."""
    # A stamp that is there twice came again when nobody remembered it, as in a bag played anew.
    stamps, order = np.unique(recorded.stamps, return_index=True)
    again = len(recorded.stamps) - len(stamps)
    later = len(recorded.stamps) - recorded.pairs_at_state
    truth = recorded.state["groundtruth"]
    groundtruth, truth_notes = _trajectory(stamps, recorded.groundtruth[order])
    estimate, notes = _trajectory(stamps, recorded.estimate[order])
    rule = protocol.association
    pairs = Association(
        rule=rule,
        groundtruth=groundtruth,
        estimate=estimate,
        estimate_coverage=len(stamps) / (recorded.state["estimate"]["states"] + later - again),
        groundtruth_coverage=_groundtruth_coverage(stamps, truth, rule),
        dropped=add_counts(recorded.state["dropped"], {"duplicate_stamp": again}),
    )
    return pairs, truth_notes, notes


def _groundtruth_coverage(stamps: Stamps, truth: dict[str, Any], rule: AssociationRule) -> float:
    return coverage_of(
        stamps, truth["time_without_gaps_ns"], max(truth["states"], 1), rule.max_gap_s
    )


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


def _revised(
    causal: Association, truth: dict[str, Any], counts: dict[str, Any], path: Path
) -> tuple[Association, dict[str, Any]]:
    """Return the pairs with the estimator's last word, and the counts of its poses."""
    try:
        with np.load(path, allow_pickle=False) as file:
            quaternions = lie.normalized(file["quaternions"])
            revised = Trajectory(file["stamps"], file["positions"], quaternions)
    except (OSError, KeyError, ValueError) as error:
        raise InputError(f"{path} can't be read: {error}") from error
    stamps = revised.stamps
    rows, places = np.intersect1d(causal.estimate.stamps, stamps, return_indices=True)[1:]
    estimate = revised[places]
    unpaired = len(stamps) - len(rows)
    dropped = causal.dropped
    if sum(count for reason, count in dropped.items() if reason not in NO_STATE) != unpaired:
        dropped = add_counts(
            {reason: count for reason, count in dropped.items() if reason in NO_STATE},
            {"without_pair_when_first_published": unpaired},
        )
    pairs = dataclasses.replace(
        causal,
        groundtruth=causal.groundtruth[rows],
        estimate=estimate,
        estimate_coverage=len(rows) / len(stamps),
        groundtruth_coverage=_groundtruth_coverage(estimate.stamps, truth, causal.rule),
        dropped=dropped,
    )
    return pairs, {
        **counts,
        "poses": len(stamps),
        "duration_s": float(stamps.max() - stamps.min()) / NANOSECONDS,
    }


def _evaluation(
    pairs: Association,
    protocol: Protocol,
    truth: dict[str, Any],
    estimate: dict[str, Any],
    name: str,
) -> Evaluation:
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
    return evaluate_pairs(pairs, sides[0], sides[1], protocol)
