"""The gauge paper's comparison: accuracy, cost and covariance of three ways to handle the gauge.

Every trial has new noise and a new initial state. Errors are those of the paper's section IV-C:
RMSE over the keyframes after alignment of the first keyframe's yaw and position. Covariances of
the motion (section VI) are (9N, 9N): position, rotation and velocity of all keyframes. The first
rotation is in the coordinates of eq. (9).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.linalg

from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.papers.problem import Problem
from trajeval_ros.papers.reduction import (
    ReducedSystem,
    reduce_landmarks,
    require_seen_landmarks,
)
from trajeval_ros.papers.solver import GAUGE_INDICES, GaugeHandling, SolverResult, Trace, solve
from trajeval_ros.papers.state import State

# Of the information, scaled to a diagonal of ones, relative to its largest eigenvalue.
_ROUNDING = 1e-13
Advance = Callable[[], object]

PRIOR_WEIGHT = 1e5
SWEEP_WEIGHTS = (
    0.0, 1.0, 3.0, 7.0, 10.0, 30.0, 50.0, 100.0, 300.0, 500.0, 1e3, 5e3, 1e4, 1e5, 1e6, 1e8,
)  # fmt: skip
PATH_WEIGHTS = (0.0, 10.0, 50.0, 500.0, 1e5, 1e8)
_DRAW, _START = 1, 2


def fixed_covariance(problem: Problem, state: State) -> Floats:
    """Return the covariance of gauge fixation, eq. (10): zero for the fixed parameters."""
    return _fixed(_undamped(problem, state))


def free_covariance(problem: Problem, state: State) -> Floats:
    """Return the motion's block of the pseudo-inverse of the whole Hessian: the free gauge.

    H^+ = P G P with P the projector off the gauge's directions and G any symmetric generalised
    inverse, here that of gauge fixation. This is exact, and needs no tolerance for the rank.

    The result depends on the landmarks and on the units, and is not meaningful by itself: see
    `transform`.
    """
    reduced = _undamped(problem, state)
    fixed = _fixed(reduced)
    motion = len(fixed)
    basis, _ = np.linalg.qr(state.gauge_basis)
    of_motion, of_landmarks = basis[:motion], basis[motion:]
    # G times the basis, block by block, with G = [[F, -F Y], [-Y' F, V^-1 + Y' F Y]], Y = W V^-1.
    # Keyframes and landmarks are the last axis of what `reduced` takes and returns.
    by_keyframe, by_landmark = (problem.keyframes, -1, 4), (problem.landmarks, 3, 4)
    half_landmarks = np.einsum("ijk,kjc->ick", reduced.inverse, of_landmarks.reshape(by_landmark))
    onto = of_motion.reshape(by_keyframe).copy()
    onto[:, :6] -= np.moveaxis(reduced.to_keyframes(half_landmarks), -1, 0)
    image = fixed @ onto.reshape(motion, 4)
    poses = np.moveaxis(image.reshape(by_keyframe)[:, :6], 0, -1)
    image_landmarks = reduced.by_inverse(half_landmarks - reduced.to_landmarks(poses))
    core = basis.T @ np.concatenate([image, np.moveaxis(image_landmarks, -1, 0).reshape(-1, 4)])
    cross = image @ of_motion.T
    covariance: Floats = fixed - cross - cross.T + of_motion @ core @ of_motion.T
    return (covariance + covariance.T) / 2.0


def transform(
    covariance: Floats, state: State, rotation: Floats, position: Floats
) -> tuple[Floats, State]:
    """Transform a covariance (9N, 9N) and its state to the gauge of fixation: eq. (12) to (15).

    The covariance is in any gauge: free, prior, or fixed elsewhere. `rotation` (3, 3) is the
    reference of the first rotation in the gauge of fixation, `position` (3,) the first position.
    """
    # Eq. (13), with the exact twist; the z component of the rotation vector has an error of 3e-5.
    angle = -so3.yaw_of_matrix(state.rotations[0] @ rotation.T)
    turn = so3.exp(angle * np.array([0.0, 0.0, 1.0]))
    moved = state.transformed(turn, position - turn @ state.positions[0])
    moved = moved.referred_to(rotation, position)
    # Appendix A. For the first rotation its J_r^-1 J_r holds only if the reference stays.
    blocks = np.tile(turn, (len(covariance) // 3, 1, 1))
    blocks[1] = (
        so3.inverse_left_jacobian(moved.first_turn) @ turn @ so3.left_jacobian(state.first_turn)
    )
    carried = _congruent(covariance, blocks)
    basis = moved.gauge_basis[: len(covariance)]
    # Q = I - U (V'U)^-1 V', eq. (14), where V' picks the indices that are held.
    coefficients = np.linalg.solve(basis[GAUGE_INDICES], carried[GAUGE_INDICES])
    cross = basis @ coefficients
    held = np.linalg.solve(basis[GAUGE_INDICES], coefficients[:, GAUGE_INDICES].T)
    projected: Floats = carried - cross - cross.T + basis @ held @ basis.T
    return (projected + projected.T) / 2.0, moved


def _congruent(covariance: Floats, blocks: Floats) -> Floats:
    """Return D C D' for a D of blocks (n, 3, 3) on the diagonal."""
    size = len(covariance)
    rows = (blocks @ covariance.reshape(-1, 3, size)).reshape(size, size)
    product: Floats = (blocks @ rows.T.reshape(-1, 3, size)).reshape(size, size)
    return product.T


def _undamped(problem: Problem, state: State) -> ReducedSystem:
    normal = problem.normal_equations(state)
    require_seen_landmarks(normal)
    motion, landmarks = normal.motion_gradient.size, normal.landmark_gradient.shape
    return reduce_landmarks(normal, np.zeros(motion), np.zeros(landmarks))


def _fixed(reduced: ReducedSystem) -> Floats:
    matrix = reduced.matrix.dense()
    size = len(matrix)
    kept = np.setdiff1d(np.arange(size), GAUGE_INDICES)
    information = matrix[np.ix_(kept, kept)]
    # Scaled to a diagonal of ones: rank and factor don't depend on metres, radians and m/s.
    units = 1.0 / np.sqrt(np.diagonal(information))
    scaled = information * units * units[:, None]
    smallest, largest = np.linalg.eigvalsh(scaled)[[0, -1]]
    if not smallest > _ROUNDING * largest:
        raise DegenerateGeometryError(
            "the measurements do not determine all directions except position and yaw; add "
            "landmarks, or keyframes with other viewpoints"
        )
    inverse = scipy.linalg.cho_solve((np.linalg.cholesky(scaled), True), np.eye(len(kept)))
    inverse = (inverse + inverse.T) / 2.0 * units * units[:, None]
    covariance = np.zeros((size, size))
    covariance[np.ix_(kept, kept)] = inverse
    return covariance


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
