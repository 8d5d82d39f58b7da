"""Runs of keyframes and of full rate, with losses, and their coverage."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from trajeval_ros import AssociationRule, Trajectory, simulate
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.association import associate
from trajeval_ros.metrics.coverage import Coverage

SECOND = NANOSECONDS


def at_ms(milliseconds: NDArray[np.float64], metres_per_s: float = 1.0) -> Trajectory:
    """Return a run along x that turns about z at a tenth of its speed."""
    seconds = np.asarray(milliseconds) / 1e3
    along = metres_per_s * seconds
    rotation = 0.1 * along / 2.0
    zero = np.zeros(len(seconds))
    return Trajectory(
        stamps=np.round(seconds * 1e9).astype(np.int64),
        positions=np.column_stack([along, zero, zero]),
        quaternions=np.column_stack([zero, zero, np.sin(rotation), np.cos(rotation)]),
    )


def at_rest(trajectory: Trajectory, begin_s: float, end_s: float) -> Trajectory:
    """Return a run that stands still for a time, and goes on from there."""
    seconds = trajectory.seconds
    rows = np.arange(len(seconds))
    inside = (seconds >= begin_s) & (seconds <= end_s)
    first = int(np.flatnonzero(inside)[0])
    rows[inside] = first
    rows[seconds > end_s] = first + np.arange(np.count_nonzero(seconds > end_s))
    assert trajectory.quaternions is not None
    return Trajectory(trajectory.stamps, trajectory.positions[rows], trajectory.quaternions[rows])


def keyframes(
    truth: Trajectory, run: Trajectory, metres: float, degrees: float, seed: int = 0
) -> Trajectory:
    """Return what a keyframe SLAM keeps of a run that it never lost: by motion, limits wander."""
    random = np.random.default_rng(seed)
    inside = (run.stamps >= truth.stamps[0]) & (run.stamps <= truth.stamps[-1])
    run = run[inside]
    rows = truth.stamps.searchsorted(run.stamps).clip(0, len(truth) - 1)
    assert truth.quaternions is not None
    positions, quaternions = truth.positions[rows], truth.quaternions[rows]
    kept, limit = [0], 1.0
    for row in range(1, len(run)):
        moved = np.linalg.norm(positions[row] - positions[kept[-1]]) / metres
        rotated = lie.multiply(lie.conjugate(quaternions[kept[-1]]), quaternions[row])
        if max(moved, np.degrees(lie.angle(rotated)) / degrees) > limit:
            kept.append(row)
            limit = float(np.exp(0.4 * random.normal()))
    return run[np.array(kept)]


@dataclasses.dataclass(frozen=True)
class Flight:
    """Groundtruth at 200 Hz, and an estimate at 20 Hz that is never lost."""

    groundtruth: Trajectory
    estimate: Trajectory


def flown(seed: int, duration_s: float) -> Flight:
    truth = simulate(seed=seed, duration_s=duration_s).groundtruth
    return Flight(truth, truth[3::10])


def without(run: Trajectory, begin_s: float, end_s: float) -> Trajectory:
    seconds = run.stamps / 1e9
    return run[(seconds < begin_s) | (seconds > end_s)]


def coverage_by(truth: Trajectory, run: Trajectory, **rule: float) -> Coverage:
    return associate(truth, run, AssociationRule("linear", **rule)).coverage  # type: ignore[arg-type]
