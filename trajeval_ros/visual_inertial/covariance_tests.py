"""Covariance tests of estimates from measured data, by NEES per degree of freedom.

They compare with groundtruth, if it is accurate enough, or compare estimates from two halves of
the landmarks with one another.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.visual_inertial.gauge_covariance import fixed_covariance, transform
from trajeval_ros.visual_inertial.keyframe_selection import KeyframeSelection
from trajeval_ros.visual_inertial.problem import Problem
from trajeval_ros.visual_inertial.solver import GAUGE_INDICES, GaugeHandling, solve
from trajeval_ros.visual_inertial.state import MOTION_WIDTH, State

_TOLERANCE = 1e-9
_FEWEST_PER_HALF = 20
_LEAST_VARIANCE = 1e-6  # of the scaled covariance, whose diagonal is 1


def groundtruth_nees(
    truth: State, state: State, covariance: Floats, noise: tuple[float, float, float]
) -> float:
    """Return the joint NEES of all poses over its degrees of freedom, 6N - 4.

    Args:
        truth: Groundtruth of the keyframes.
        state: The estimate, in any gauge.
        covariance: (wN, wN) of the estimate, in any gauge.
        noise: Standard deviations of groundtruth: position (m), rotation (rad), velocity (m/s)
            per axis, white.
    """
    carried, moved = transform(covariance, state, truth.rotations[0], truth.positions[0])
    reference = truth.referred_to(truth.rotations[0], truth.positions[0])
    # Groundtruth's noise N is not in the gauge of fixation; alignment transforms it to Q N Q'.
    motion = moved.motion_places
    carried, basis = carried[np.ix_(motion, motion)], moved.gauge_basis[motion]
    project = np.eye(len(carried))
    project[:, GAUGE_INDICES] -= basis @ np.linalg.inv(basis[GAUGE_INDICES])
    variances = np.tile(np.repeat(np.square(noise), 3), len(truth.positions))
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

    Raises:
        InputError: Too few landmarks for halves.
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
