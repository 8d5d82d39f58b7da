"""The association of a live run, rebuilt from its pair file."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.reading import Reading
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.geometry.valid_poses import LARGEST, NO_STATE, add_counts, judge_poses
from trajeval_ros.io.checks import judge_rotations
from trajeval_ros.io.live.pair_file import RecordedPairs, read_revised
from trajeval_ros.metrics.association import AT_GROUNDTRUTH, Association, AssociationRule
from trajeval_ros.metrics.completeness import Interpolation, completeness
from trajeval_ros.metrics.coverage import (
    Coverage,
    CoverageSums,
    StampedPoses,
    StepMeter,
    time_without_gaps,
)
from trajeval_ros.metrics.lost_tracking import frozen_ns
from trajeval_ros.metrics.protocol import Protocol


def all_groundtruth(pairs: Association, recorded: RecordedPairs) -> Trajectory:
    """Return the groundtruth's states in pairs and the recorded ones between them, in order."""
    others = _usable(recorded.waypoints)
    stamps = np.concatenate([pairs.groundtruth.stamps, others.stamps])
    positions = np.concatenate([pairs.groundtruth.positions, others.poses[:, :3]])
    stamps, first = np.unique(stamps, return_index=True)
    return Trajectory(stamps, positions[first])


def recorded_association(
    recorded: RecordedPairs, protocol: Protocol, ups: Sequence[UpAxis]
) -> Association:
    """Return the pairs in order of time with counts."""
    # A timestamp occurs twice if the bag was played again after its states were dropped.
    usable = np.flatnonzero(_are_states(recorded.groundtruth) & _are_states(recorded.estimate))
    stamps, order = np.unique(recorded.stamps[usable], return_index=True)
    order = usable[order]
    again = len(usable) - len(stamps)
    later = len(recorded.stamps) - recorded.pairs_at_state
    groundtruth = _trajectory(stamps, recorded.groundtruth[order])
    estimate = _trajectory(stamps, recorded.estimate[order])
    if recorded.covariances is not None:
        estimate = dataclasses.replace(estimate, covariances=recorded.covariances[order])
    first = recorded.state["estimate"].get("first_stamp_ns")
    oriented = groundtruth.quaternions is not None
    rule = protocol.association.for_kind("poses" if oriented else "points")
    states = recorded.state["estimate"]["states"] + later - again
    is_sparse = rule.method == AT_GROUNDTRUTH
    return Association(
        rule=rule,
        groundtruth=dataclasses.replace(groundtruth, up=ups[0]),
        estimate=dataclasses.replace(estimate, up=ups[1]),
        estimate_coverage=None if is_sparse else len(stamps) / states,
        coverage=recorded_coverage(groundtruth, estimate, recorded, rule),
        dropped=add_counts(
            recorded.state["dropped"],
            {"duplicate_stamp": again, "not_finite": len(recorded.stamps) - len(usable)},
        ),
        from_the_start=is_sparse or first is None or first == int(stamps[0]),
        interpolation=_interpolation(recorded.state["estimate"].get("interpolation")),
    )


def _interpolation(words: Mapping[str, float] | None) -> Interpolation | None:
    """Return the recorded interpolation of the estimate; None in files of older versions."""
    if words is None:
        return None
    return Interpolation(float(words["step_s"]), float(words["off_m"]))


def _are_states(rows: Floats) -> Booleans:
    """Return which poses (N, 7) or states (N, 10) are valid; NaN means not measured."""
    finite, turned = judge_poses(rows[:, :3], np.nan_to_num(rows[:, 3:7], nan=1.0))
    return finite & turned & ~(np.abs(rows[:, 7:]) > LARGEST).any(axis=1)


def recorded_coverage(
    groundtruth: Trajectory, estimate: Trajectory, recorded: RecordedPairs, rule: AssociationRule
) -> Coverage:
    """Return the coverage of pairs of these states."""
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
    counts = recorded.state["groundtruth"]
    # In a killed run, the newest counts are older than the newest pairs.
    passed_ns = time_without_gaps(waypoints.stamps, max_gap_ns)
    return sums.coverage(
        max(counts["time_without_gaps_ns"], passed_ns),
        max(counts["states"], 1),
        frozen_ns(groundtruth, estimate, rule.max_gap_s),
    )


def _usable(waypoints: StampedPoses) -> StampedPoses:
    """Return the valid waypoints in order of time."""
    rows = np.flatnonzero(_are_states(waypoints.poses))
    rows = rows[np.argsort(waypoints.stamps[rows], kind="stable")]
    return StampedPoses(waypoints.stamps[rows], waypoints.poses[rows])


def _trajectory(stamps: Stamps, rows: Floats) -> Trajectory:
    """Return states (N, 10) as a trajectory without unmeasured quantities."""
    turns, velocities = rows[:, 3:7], rows[:, 7:]
    quaternions, remarks = judge_rotations(None if np.isnan(turns).any() else turns)
    return Trajectory(
        stamps,
        rows[:, :3],
        None if quaternions is None else lie.normalized(quaternions),
        None if np.isnan(velocities).any() or not velocities.any() else velocities,
        reading=Reading(remarks=remarks),
    )


def revised_association(
    causal: Association, recorded: RecordedPairs, path: Path
) -> tuple[Association, dict[str, Any]]:
    """Return the pairs with the finally revised poses, and the counts of these."""
    revised = dataclasses.replace(
        read_revised(path), up=causal.estimate.up, reading=causal.estimate.reading
    )
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
        coverage=recorded_coverage(groundtruth, estimate, recorded, causal.rule),
        dropped=dropped,
    )
    return pairs, {
        **recorded.state["estimate"],
        "poses": len(stamps),
        "duration_s": float(stamps.max() - stamps.min()) / NANOSECONDS,
    }
