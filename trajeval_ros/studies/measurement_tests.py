"""Tests of the assumed noise and of the covariance of estimates from measured data.

The noise is tested by residuals: chi-square by group, and correlation along tracks. The total
chi-square does not test the IMU, whose residuals are only a few percent of all. The covariance is
tested by NEES per degree of freedom, against groundtruth, if it is accurate enough, or between
estimates from two halves of the landmarks.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.studies.keyframe_selection import KeyframeSelection
from trajeval_ros.visual_inertial.gauge_covariance import fixed_covariance, transform
from trajeval_ros.visual_inertial.problem import Problem
from trajeval_ros.visual_inertial.solver import GAUGE_INDICES, GaugeHandling, solve
from trajeval_ros.visual_inertial.state import MOTION_WIDTH, State


@dataclass(frozen=True)
class ResidualGroup:
    """Residuals of one kind."""

    name: str  # name of the group
    count: int  # number of residuals
    redundancy: float  # degrees of freedom: the count minus the group's trace of the hat matrix
    chi2: float  # sum of the squared whitened residuals

    @property
    def ratio(self) -> float:
        """chi2 / redundancy; its expectation is 1 if the noise is as assumed."""
        return self.chi2 / self.redundancy


def residual_groups(problem: Problem, state: State) -> list[ResidualGroup]:
    """Return the groups camera, IMU rotation, velocity and position, and biases, at a minimum.

    The biases' group has their changes between keyframes and their prior at the first one.
    """
    visual, _ = problem.residuals(state)
    errors, before, after = problem.inertial(state)
    first_errors, first_weights = problem.first_biases(state)
    count, width = problem.keyframes, problem.width
    covariance = fixed_covariance(problem, state).reshape(count, width, count, width)
    each, next_ = np.arange(count - 1), np.arange(1, count)
    shared = np.concatenate([before, after], axis=2)
    joint = np.block(
        [
            [covariance[each, :, each], covariance[each, :, next_]],
            [covariance[next_, :, each], covariance[next_, :, next_]],
        ]
    )
    used = np.einsum("nij,njk,nik->ni", shared, joint, shared)
    first_used = np.diagonal(covariance[0, 9:, 0, 9:]) * np.square(first_weights)
    # The hat matrix's trace is the number of parameters, without the gauge's four.
    parameters = width * count + 3 * problem.landmarks - 4
    by_camera = visual.size - (parameters - float(used.sum() + first_used.sum()))
    groups = [ResidualGroup("pixels", visual.size, by_camera, float(np.vdot(visual, visual)))]
    for place, name in enumerate(("IMU rotation", "IMU velocity", "IMU position")):
        rows = slice(3 * place, 3 * place + 3)
        of_kind = errors[:, rows]
        redundancy = of_kind.size - float(used[:, rows].sum())
        chi2 = float(np.vdot(of_kind, of_kind))
        groups.append(ResidualGroup(name, of_kind.size, redundancy, chi2))
    if first_errors.size:
        changes = errors[:, 9:]
        number = changes.size + first_errors.size
        redundancy = number - float(used[:, 9:].sum() + first_used.sum())
        chi2 = float(np.vdot(changes, changes) + first_errors @ first_errors)
        groups.append(ResidualGroup("IMU biases", number, redundancy, chi2))
    return groups


def track_correlation(problem: Problem, state: State, lags: Sequence[int]) -> Floats:
    """Return the autocorrelation (lags,) of reprojection errors along tracks, lags in keyframes.

    It is about zero for white errors, and NaN at lags longer than all tracks.
    """
    visual, _ = problem.residuals(state)
    errors = np.zeros((problem.landmarks, problem.keyframes, visual.shape[1]))
    seen = np.zeros(errors.shape[:2], dtype=bool)
    errors[problem.visibility.landmark_of, problem.visibility.keyframe_of] = visual
    seen[problem.visibility.landmark_of, problem.visibility.keyframe_of] = True
    correlations = []
    for lag in lags:
        both = seen[:, :-lag] & seen[:, lag:]
        earlier, later = errors[:, :-lag][both], errors[:, lag:][both]
        lengths = np.linalg.norm(earlier) * np.linalg.norm(later)
        correlations.append(np.vdot(earlier, later) / lengths if len(earlier) else np.nan)
    return np.array(correlations)


_TOLERANCE = 1e-9
_FEWEST_PER_HALF = 20
_LEAST_VARIANCE = 1e-6  # of the scaled covariance, whose diagonal is 1


def groundtruth_nees(
    groundtruth: State, state: State, covariance: Floats, noise: tuple[float, float, float]
) -> float:
    """Return the joint NEES of all poses over its degrees of freedom, 6N - 4.

    State and covariance (wN, wN) are in any gauge. The white noise of the groundtruth has standard
    deviations of position (m), rotation (rad) and velocity (m/s) per axis.
    """
    carried, moved = transform(
        covariance, state, groundtruth.rotations[0], groundtruth.positions[0]
    )
    reference = groundtruth.referred_to(groundtruth.rotations[0], groundtruth.positions[0])
    # Groundtruth's noise N is not in the gauge of fixation; alignment transforms it to Q N Q'.
    motion = moved.motion_places
    carried, basis = carried[np.ix_(motion, motion)], moved.gauge_basis[motion]
    project = np.eye(len(carried))
    project[:, GAUGE_INDICES] -= basis @ np.linalg.inv(basis[GAUGE_INDICES])
    variances = np.tile(np.repeat(np.square(noise), 3), len(groundtruth.positions))
    whole = carried + (project * variances) @ project.T
    return _nees(_difference(moved, reference), whole)


def split_half_nees(
    selection: KeyframeSelection, state: State, splits: int, generator: np.random.Generator
) -> Floats:
    """Return the NEES of the poses of two estimates over its degrees of freedom, (splits,).

    A split divides the landmarks into random halves, with one estimate from either half. Both
    estimates use the IMU. With their covariances P1 and P2 and the IMU's information H, their
    difference has the covariance P1 + P2 - P1 H P2 - P2 H P1. The test can't detect common errors
    (calibration, time, the IMU's noise).
    """
    return np.array([_split_nees(selection, state, generator) for _ in range(splits)])


def _split_nees(
    selection: KeyframeSelection, state: State, generator: np.random.Generator
) -> float:
    first = generator.permutation(selection.landmarks) < selection.landmarks // 2
    if selection.landmarks // 2 < _FEWEST_PER_HALF:
        raise InputError(
            f"{selection.landmarks} landmarks are too few for two halves; at least "
            f"{2 * _FEWEST_PER_HALF} are required"
        )
    estimates, covariances, jacobians = [], [], []
    for chosen in (first, ~first):
        half, left = selection.kept(chosen[selection.landmark_of])
        start = dataclasses.replace(state, landmarks=state.landmarks[left])
        problem = half.problem()
        estimate = solve(
            problem, start, GaugeHandling.FIXATION, function_tolerance=_TOLERANCE
        ).state
        estimates.append(estimate)
        covariances.append(fixed_covariance(problem, estimate))
        jacobians.append(_inertial_jacobian(problem, estimate))
    ours, theirs = covariances
    # Both with their own Jacobian of the IMU: with a common one, rounding makes it indefinite.
    common = (ours @ jacobians[0].T) @ (jacobians[1] @ theirs)
    motion = state.motion_places
    difference = (ours + theirs - common - common.T)[np.ix_(motion, motion)]
    return _nees(_difference(*estimates), difference)


def _inertial_jacobian(problem: Problem, state: State) -> Floats:
    """Return the Jacobian (wN - 9, wN) of the residuals of IMU and biases by the keyframes."""
    _, before, after = problem.inertial(state)
    width = problem.width
    jacobian = np.zeros((len(before), width, problem.keyframes, width))
    intervals = np.arange(len(before))
    jacobian[intervals, :, intervals] = before
    jacobian[intervals, :, intervals + 1] = after
    first = np.zeros((width - MOTION_WIDTH, problem.keyframes, width))
    first[:, 0, MOTION_WIDTH:] = np.diag(problem.first_biases(state)[1])
    return np.concatenate(
        [part.reshape(-1, width * problem.keyframes) for part in (jacobian, first)]
    )


def _difference(state: State, reference: State) -> Floats:
    """Return the perturbation (9N,) of the motion from the reference to the state."""
    turns = so3.log(state.rotations @ np.swapaxes(reference.rotations, 1, 2))
    turns[0] = state.first_turn - reference.first_turn
    parts = (state.positions - reference.positions, turns, state.velocities - reference.velocities)
    return np.concatenate(parts, axis=1).ravel()


def _nees(error: Floats, covariance: Floats) -> float:
    """Return e' C^-1 e / dof of the poses, without the four parameters that the gauge fixes.

    Directions with almost no variance, which the common IMU determines, are left out: rounding is
    as large as their variance.
    """
    poses = np.arange(len(error)).reshape(-1, 9)[:, :6].ravel()
    free = np.setdiff1d(poses, GAUGE_INDICES)
    matrix = covariance[np.ix_(free, free)]
    units = 1.0 / np.sqrt(np.diagonal(matrix))
    variances, directions = np.linalg.eigh(matrix * units * units[:, None])
    squares = np.square(directions.T @ (error[free] * units))
    known = variances > _LEAST_VARIANCE
    return float(np.mean(squares[known] / variances[known]))
