"""The Schur complement: landmarks eliminated from the normal equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse

from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.visual_inertial.problem import NormalEquations

# Pivots below this share of a landmark's largest are rounding (seen once, or without parallax).
_ROUNDING = 1e-13
# Where keyframes see a smaller share of the landmarks, sparse products are faster than dense ones.
_SPARSE_SHARE = 0.15


@dataclass(frozen=True, eq=False)
class ReducedSystem:
    """The normal equations of the motion alone, and the way back to the landmarks.

    Attributes:
        matrix: (9N, 9N), H_mm - W V^-1 W^T.
        gradient: (9N,), g_m - W V^-1 g_l.
        half: (6N, 3K), W L^-T with V = L L^T; rows are positions and rotations. Sparse if few
            landmarks are seen from each keyframe.
        inverse: (K, 3, 3), L^-1.
        pull: (3K,), L^-1 g_l.
    """

    matrix: Floats
    gradient: Floats
    half: Floats | scipy.sparse.bsr_matrix
    inverse: Floats
    pull: Floats

    def landmarks_after(self, motion_step: Floats) -> Floats:
        """Return the landmarks' step (3K,), V^-1 (-g_l - W^T dm), that goes with (9N,)."""
        pose_step = motion_step.reshape(-1, 9)[:, :6].ravel()
        return self.by_inverse(-self.pull - self.half.T @ pose_step)

    def by_inverse(self, columns: Floats) -> Floats:
        """Return L^-T times columns (3K, ...)."""
        blocks = columns.reshape(len(self.inverse), 3, -1)
        product: Floats = np.swapaxes(self.inverse, 1, 2) @ blocks
        return product.reshape(columns.shape)


def motion_matrix(normal: NormalEquations) -> Floats:
    """Return H_mm (9N, 9N): what couples keyframes directly."""
    count = len(normal.diagonal)
    matrix = np.zeros((count, 9, count, 9))
    each, next_ = np.arange(count), np.arange(1, count)
    matrix[each, :, each, :] = normal.diagonal
    matrix[each[:-1], :, next_, :] = normal.coupling
    matrix[next_, :, each[:-1], :] = np.swapaxes(normal.coupling, 1, 2)
    return matrix.reshape(9 * count, 9 * count)


def reduce_landmarks(
    normal: NormalEquations, motion_damping: Floats, landmark_damping: Floats
) -> ReducedSystem:
    """Eliminate the landmarks.

    Args:
        normal: The normal equations.
        motion_damping: (9N,) added to the motion's diagonal.
        landmark_damping: (K, 3) added to the landmarks' diagonal.
    """
    count, landmarks = len(normal.diagonal), len(normal.landmark)
    inverse = inverse_landmark_factors(normal, landmark_damping)
    if len(normal.cross) < _SPARSE_SHARE * count * landmarks:
        half = sparse_half(normal, inverse)
        product = (half @ half.T).toarray()
    else:
        by_block = np.zeros((count, landmarks, 6, 3))
        by_block[normal.keyframe_of, normal.landmark_of] = _half_blocks(normal, inverse)
        half = by_block.transpose(0, 2, 1, 3).reshape(6 * count, 3 * landmarks)
        product = half @ half.T
    pull = np.einsum("kij,kj->ki", inverse, normal.landmark_gradient).ravel()
    matrix = motion_matrix(normal)
    poses = matrix.reshape(count, 9, count, 9)[:, :6, :, :6]
    poses -= product.reshape(count, 6, count, 6)
    matrix[np.diag_indices(9 * count)] += motion_damping
    gradient = normal.motion_gradient.copy()
    gradient[:, :6] -= (half @ pull).reshape(count, 6)
    return ReducedSystem(matrix, gradient.ravel(), half, inverse, pull)


def sparse_half(normal: NormalEquations, inverse: Floats) -> scipy.sparse.bsr_matrix:
    """Return W L^-T (6N, 3K) of blocks (6, 3), from L^-1 (K, 3, 3) of each landmark."""
    count, landmarks = len(normal.diagonal), len(normal.landmark)
    # In order of keyframes, as a block-sparse matrix wants its rows.
    order = np.lexsort((normal.landmark_of, normal.keyframe_of))
    starts = np.searchsorted(normal.keyframe_of[order], np.arange(count + 1))
    blocks = _half_blocks(normal, inverse)[order]
    return scipy.sparse.bsr_matrix(
        (blocks, normal.landmark_of[order], starts), shape=(6 * count, 3 * landmarks)
    )


def _half_blocks(normal: NormalEquations, inverse: Floats) -> Floats:
    """Return the blocks (M, 6, 3) of W L^-T, by observation."""
    blocks: Floats = normal.cross @ np.swapaxes(inverse, 1, 2)[normal.landmark_of]
    return blocks


def inverse_landmark_factors(normal: NormalEquations, damping: Floats | float) -> Floats:
    """Return L^-1 (K, 3, 3) of each landmark's damped V = L L^T.

    Raises:
        numpy.linalg.LinAlgError: A V is not positive definite.
    """
    blocks = normal.landmark.copy()
    blocks[:, [0, 1, 2], [0, 1, 2]] += damping
    factors: Floats = np.linalg.inv(np.linalg.cholesky(blocks))
    return factors


def require_seen_landmarks(normal: NormalEquations) -> None:
    """Raise DegenerateGeometryError if the position of a landmark is not determined."""
    eigenvalues = np.linalg.eigvalsh(normal.landmark)
    open_ = np.flatnonzero(eigenvalues[:, 0] <= _ROUNDING * eigenvalues[:, 2])
    if len(open_):
        raise DegenerateGeometryError(
            f"landmark {open_[0]} (of {len(open_)} such) is seen once or without parallax, which "
            "leaves null directions besides the gauge's four; drop it"
        )
