"""Covariances of the motion, and their transformation between gauges: gauge paper, section VI.

They are (9N, 9N): position, rotation and velocity of all keyframes. The first rotation is in the
coordinates of eq. (9).
"""

from __future__ import annotations

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
from trajeval_ros.papers.solver import GAUGE_INDICES
from trajeval_ros.papers.state import State

# Of the information, scaled to a diagonal of ones, relative to its largest eigenvalue.
_ROUNDING = 1e-13


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
