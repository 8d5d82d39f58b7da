"""The gauge paper's comparison: accuracy, cost and covariance of three ways to handle the gauge.

Every trial has new noise and a new initial state. Errors are those of the paper's section IV-C:
RMSE over the keyframes after alignment of the first keyframe's yaw and position.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.papers.gauge_covariance import (
    fixed_covariance,
    free_covariance,
    transform,
)
from trajeval_ros.papers.problem import Problem
from trajeval_ros.papers.solver import GaugeHandling, SolverResult, Trace, solve
from trajeval_ros.papers.state import State

Advance = Callable[[], object]

PRIOR_WEIGHT = 1e5
SWEEP_WEIGHTS = (
    0.0, 1.0, 3.0, 7.0, 10.0, 30.0, 50.0, 100.0, 300.0, 500.0, 1e3, 5e3, 1e4, 1e5, 1e6, 1e8,
)  # fmt: skip
PATH_WEIGHTS = (0.0, 10.0, 50.0, 500.0, 1e5, 1e8)
_DRAW, _START = 1, 2


class StudiedScene(Protocol):
    """The problem of the trials, simulated or measured."""

    @property
    def groundtruth(self) -> State:
        """Reference of the errors."""

    def measured(self, generator: np.random.Generator) -> Problem:
        """Return the measurements of a trial."""

    def disturbed(self, generator: np.random.Generator) -> State:
        """Return the initial state of a trial."""


@dataclass(frozen=True, eq=False)
class Trials:
    """Results of T trials with one handling of the gauge; all arrays are (T,)."""

    position_m: Floats  # RMSE over the keyframes
    rotation_deg: Floats  # RMSE of the rotation errors' angles
    velocity_mps: Floats  # RMSE
    iterations: Floats  # number of linear solves
    seconds: Floats  # duration of the solve

    @property
    def seconds_per_iteration(self) -> float:
        """Median time per linear solve; the median since other processes disturb the timing."""
        return float(np.median(self.seconds / self.iterations))


@dataclass(frozen=True, eq=False)
class Covariances:
    """The motion's covariances (9N, 9N) of one trial: Fig. 9."""

    free: Floats  # covariance of the free gauge
    transformed: Floats  # `free`, transformed to the gauge of fixation by eq. (12)
    fixed: Floats  # covariance of a separate solve with gauge fixation

    @property
    def difference(self) -> float:
        """Relative difference of the latter two, Frobenius norm."""
        return float(np.linalg.norm(self.transformed - self.fixed) / np.linalg.norm(self.fixed))


def compare_handlings(
    scene: StudiedScene, trials: int, advance: Advance
) -> dict[GaugeHandling, Trials]:
    """Solve the same trials with all handlings of the gauge (Table II and III, Fig. 7)."""
    handlings = list(GaugeHandling)
    rows: dict[GaugeHandling, list[tuple[float, ...]]] = {handling: [] for handling in handlings}
    for trial in range(trials):
        # The first one has cold caches: alternate the order for fair times.
        first = trial % len(handlings)
        for handling in (*handlings[first:], *handlings[:first]):
            rows[handling].append(_trial(scene, trial, handling, PRIOR_WEIGHT)[0])
        advance()
    return {handling: _columns(trials_of) for handling, trials_of in rows.items()}


def sweep(
    scene: StudiedScene, trials: int, advance: Advance, weights: Sequence[float]
) -> list[Trials]:
    """Solve the same trials with all prior weights (Fig. 4 and 5)."""
    outcome = []
    for weight in weights:
        outcome.append(
            _columns(
                [_trial(scene, trial, GaugeHandling.PRIOR, weight)[0] for trial in range(trials)]
            )
        )
        advance()
    return outcome


def paths(scene: StudiedScene, weights: Sequence[float]) -> list[Trace]:
    """Return the traces of the iterations in one trial, by prior weight (Fig. 6)."""
    return [_trial(scene, 0, GaugeHandling.PRIOR, weight)[1].trace for weight in weights]


def covariances(scene: StudiedScene, trial: int, *, is_converged: bool) -> Covariances:
    """Return the covariances of a trial (Fig. 9 and 10).

    If not `is_converged`, it stops like Ceres and the paper's estimator; otherwise it continues to
    the minimum, where eq. (12) is exact.
    """
    problem = scene.measured(np.random.default_rng([_DRAW, trial]))
    start = scene.disturbed(np.random.default_rng([_START, trial]))
    settings = (0.0, 1e-14 if is_converged else 1e-6)
    free, fixed = (
        solve(problem, start, handling, *settings, keep_last_step=is_converged).state
        for handling in (GaugeHandling.FREE, GaugeHandling.FIXATION)
    )
    of_free, of_fixed = free_covariance(problem, free), fixed_covariance(problem, fixed)
    transformed, _ = transform(of_free, free, fixed.reference_rotation, fixed.reference_position)
    return Covariances(of_free, transformed, of_fixed)


def _trial(
    scene: StudiedScene, trial: int, handling: GaugeHandling, weight: float
) -> tuple[tuple[float, ...], SolverResult]:
    problem = scene.measured(np.random.default_rng([_DRAW, trial]))
    start = scene.disturbed(np.random.default_rng([_START, trial]))
    begin = time.perf_counter()
    # Like Ceres, it discards the step that shows convergence: the paper's small differences
    # between gauges are the remaining distances to the minimum.
    solution = solve(problem, start, handling, weight, keep_last_step=False)
    seconds = time.perf_counter() - begin
    return (*_errors(scene.groundtruth, solution.state), solution.iterations, seconds), solution


def _errors(groundtruth: State, state: State) -> tuple[float, float, float]:
    """Return the RMSE of position (m), rotation (deg) and velocity (m/s)."""
    yaw = so3.yaw_of_matrix(groundtruth.rotations[0] @ state.rotations[0].T)
    rotation = so3.exp(yaw * np.array([0.0, 0.0, 1.0]))
    aligned = state.transformed(rotation, groundtruth.positions[0] - rotation @ state.positions[0])
    between = so3.log(aligned.rotations @ np.swapaxes(groundtruth.rotations, 1, 2))
    return (
        _rms(aligned.positions - groundtruth.positions),
        float(np.degrees(_rms(between))),
        _rms(aligned.velocities - groundtruth.velocities),
    )


def _rms(vectors: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(np.square(vectors), axis=1))))


def _columns(rows: list[tuple[float, ...]]) -> Trials:
    return Trials(*np.array(rows).T)
