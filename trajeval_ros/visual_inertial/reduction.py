"""The Schur complement: landmarks eliminated from the normal equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse

from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.visual_inertial.problem import NormalEquations

# Pivots below this share of a landmark's largest pivot are rounding (one view, or no parallax).
_ROUNDING = 1e-13
# If keyframes see a smaller share of the landmarks, sparse products are faster than dense ones.
_SPARSE_SHARE = 0.15


@dataclass(frozen=True, eq=False)
class ReducedSystem:
    """The normal equations of the motion, and the factors for the landmarks' step.

    Attributes:
        matrix: (wN, wN), H_mm - W V^-1 W^T.
        gradient: (wN,), g_m - W V^-1 g_l.
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
        """Return the landmarks' step V^-1 (-g_l - W^T dm) (3K,) for the motion's step dm (wN,)."""
        keyframes = self.half.shape[0] // 6
        pose_step = motion_step.reshape(keyframes, -1)[:, :6].ravel()
        return self.by_inverse(-self.pull - self.half.T @ pose_step)

    def by_inverse(self, columns: Floats) -> Floats:
        """Return L^-T times columns (3K, ...)."""
        blocks = columns.reshape(len(self.inverse), 3, -1)
        product: Floats = np.swapaxes(self.inverse, 1, 2) @ blocks
        return product.reshape(columns.shape)


def motion_matrix(normal: NormalEquations) -> Floats:
    """Return H_mm (wN, wN), the motion's block of the normal equations."""
    count, width, _ = normal.diagonal.shape
    matrix = np.zeros((count, width, count, width))
    each, next_ = np.arange(count), np.arange(1, count)
    matrix[each, :, each, :] = normal.diagonal
    matrix[each[:-1], :, next_, :] = normal.coupling
    matrix[next_, :, each[:-1], :] = np.swapaxes(normal.coupling, 1, 2)
    return matrix.reshape(width * count, width * count)


def reduce_landmarks(
    normal: NormalEquations, motion_damping: Floats, landmark_damping: Floats
) -> ReducedSystem:
    """Eliminate the landmarks.

    Args:
        normal: The normal equations.
        motion_damping: (wN,) added to the motion's diagonal.
        landmark_damping: (K, 3) added to the landmarks' diagonal.
    """
    count, width, _ = normal.diagonal.shape
    landmarks = len(normal.landmark)
    inverse = inverse_landmark_factors(normal, landmark_damping)
    matrix = motion_matrix(normal)
    by_keyframe = matrix.reshape(count, width, count, width)
    if len(normal.cross) < _SPARSE_SHARE * count * landmarks:
        half = sparse_half(normal, inverse)
        product = half @ half.T
        # Only blocks of keyframes with common landmarks are written; other memory is never
        # touched.
        rows = np.repeat(np.arange(count), np.diff(product.indptr))
        by_keyframe[rows, :6, product.indices, :6] -= product.data
    else:
        by_block = np.zeros((count, landmarks, 6, 3))
        by_block[normal.keyframe_of, normal.landmark_of] = _half_blocks(normal, inverse)
        half = by_block.transpose(0, 2, 1, 3).reshape(6 * count, 3 * landmarks)
        by_keyframe[:, :6, :, :6] -= (half @ half.T).reshape(count, 6, count, 6)
    pull = np.einsum("kij,kj->ki", inverse, normal.landmark_gradient).ravel()
    matrix[np.diag_indices(width * count)] += motion_damping
    gradient = normal.motion_gradient.copy()
    gradient[:, :6] -= (half @ pull).reshape(count, 6)
    return ReducedSystem(matrix, gradient.ravel(), half, inverse, pull)


def sparse_half(normal: NormalEquations, inverse: Floats) -> scipy.sparse.bsr_matrix:
    """Return W L^-T (6N, 3K) in blocks (6, 3), from the landmarks' L^-1 (K, 3, 3)."""
    count, landmarks = len(normal.diagonal), len(normal.landmark)
    # Sorted by keyframe, as required for the rows of a block-sparse matrix.
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
    """Return the landmarks' L^-1 (K, 3, 3) of the damped V = L L^T.

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
            f"{counted(len(open_), 'landmark')} without parallax or with one observation, the "
            f"first is {open_[0]}; remove them"
        )
