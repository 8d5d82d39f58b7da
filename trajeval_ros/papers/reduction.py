"""The Schur complement: landmarks eliminated from the normal equations.

The matrix of the motion is banded if tracks are short, otherwise dense. The undamped information
of the motion is sparse, for runs that are too long for a dense one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse
from numpy.lib.stride_tricks import as_strided

from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.papers.problem import NormalEquations, Problem
from trajeval_ros.papers.state import MOTION_WIDTH, State
from trajeval_ros.papers.visibility import Visibility

# Longest track, relative to the number of keyframes, with which a banded factor is faster.
_BANDED_SHARE = 0.25


class MotionMatrix:
    """A symmetric matrix (9N, 9N) of N keyframes with w parameters each, zero at first.

    Its blocks are written through views. This works for both kinds of storage, since element
    (i, j) is at place `begin + i + step * j` in memory: a dense matrix is stored by columns, and
    row j of a banded one has the elements below the diagonal of column j. Only the lower
    triangle is read.
    """

    def __init__(self, visibility: Visibility, width: int) -> None:
        """Reserve memory for the keyframes that are coupled by landmarks or the IMU."""
        keyframes, reach = visibility.keyframes, visibility.longest_track
        self._width, self._size = width, width * keyframes
        self._is_banded = reach <= _BANDED_SHARE * keyframes
        if self._is_banded:
            # A view of a window has its upper triangle, and keyframes without a common landmark.
            widest = max(2, *(window.keyframes for window in visibility.windows))
            self._begin = width * widest - 1
            self._step = 2 * self._begin
            self._storage = np.zeros((self._size, self._step + 1))
            self._band = self._storage[:, self._begin : self._begin + width * reach]
        else:
            self._begin, self._step = 0, self._size
            self._storage = np.zeros((self._size, self._size))

    @property
    def diagonal(self) -> Floats:
        """The diagonal (9N,), a view."""
        return self._view(0, (self._size,), (1 + self._step,))

    def blocks(self, offset: int) -> Floats:
        """Return the blocks `offset` below the diagonal, (N - offset, w, w), a view."""
        width = self._width
        count = self._size // width - offset
        steps = (width * (1 + self._step), 1, self._step)
        return self._view(width * offset, (count, width, width), steps)

    def window(self, first: int, last: int) -> Floats:
        """Return the block of the n keyframes of a window, (n, w, n, w), a view.

        It is symmetric. Columns come first, as in memory.
        """
        count, width = last - first, self._width
        steps = (width * self._step, self._step, width, 1)
        return self._view(width * first * (1 + self._step), (count, width, count, width), steps)

    def hold(self, indices: Indices) -> None:
        """Hold parameters of the first keyframe: their rows and columns become those of I."""
        self._storage[indices] = 0.0
        self.blocks(0)[0, indices] = 0.0
        self.diagonal[indices] = 1.0

    def solved(self, right: Floats) -> Floats:
        """Return A^-1 b for b (9N,), and overwrite the matrix.

        Raises:
            numpy.linalg.LinAlgError: The matrix is not positive definite.
        """
        if self._is_banded:
            solution = scipy.linalg.solveh_banded(
                self._band.T, right, lower=True, check_finite=False
            )
        else:
            factor = scipy.linalg.cho_factor(
                self._storage.T, lower=True, overwrite_a=True, check_finite=False
            )
            solution = scipy.linalg.cho_solve(factor, right, check_finite=False)
        return np.asarray(solution)

    def dense(self) -> Floats:
        """Return the matrix (9N, 9N)."""
        if self._is_banded:
            matrix = np.zeros((self._size, self._size))
            for below, elements in enumerate(self._band.T):
                columns = np.arange(self._size - below)
                matrix[columns + below, columns] = elements[: self._size - below]
        else:
            matrix = np.tril(self._storage.T)
        return matrix + np.tril(matrix, -1).T

    def _view(self, place: int, shape: tuple[int, ...], steps: tuple[int, ...]) -> Floats:
        start = self._storage.ravel()[self._begin + place :]
        strides = tuple(step * start.itemsize for step in steps)
        return as_strided(start, shape, strides)


# Pivots below this share of a landmark's largest pivot are rounding (one view, or no parallax).
_ROUNDING = 1e-13


@dataclass(frozen=True, eq=False)
class ReducedSystem:
    """The normal equations of the motion, and the factors for the landmarks' step."""

    matrix: MotionMatrix  # (9N, 9N), H_mm - W V^-1 W^T
    gradient: Floats  # (N, 9), g_m - W V^-1 g_l
    # (6, 3, M), the blocks of W L^-T with V = L L^T, by observation; rows are position and
    # rotation of its keyframe.
    half: Floats
    inverse: Floats  # (3, 3, K), L^-1
    pull: Floats  # (3, K), L^-1 g_l
    visibility: Visibility  # keyframes and landmarks of the observations

    def landmarks_after(self, motion_step: Floats) -> Floats:
        """Return the landmarks' step V^-1 (-g_l - W^T dm) (3K,) for the motion's step dm (9N,)."""
        pose_steps = motion_step.reshape(self.visibility.keyframes, -1)[:, :6]
        return self.by_inverse(-self.pull - self.to_landmarks(pose_steps.T)).T.ravel()

    def to_keyframes(self, values: Floats) -> Floats:
        """Return W L^-T (6N, 3K) times values (3, ..., K) of landmarks, (6, ..., N)."""
        observed = values.take(self.visibility.landmark_of, axis=-1)
        return self.visibility.by_keyframe(np.einsum("ijm,j...m->i...m", self.half, observed))

    def to_landmarks(self, values: Floats) -> Floats:
        """Return L^-1 W^T (3K, 6N) times values (6, ..., N) of keyframes, (3, ..., K)."""
        observed = values.take(self.visibility.keyframe_of, axis=-1)
        return self.visibility.by_landmark(np.einsum("ijm,i...m->j...m", self.half, observed))

    def by_inverse(self, values: Floats) -> Floats:
        """Return L^-T times values (3, ..., K) of landmarks."""
        product: Floats = np.einsum("jik,j...k->i...k", self.inverse, values)
        return product


def motion_matrix(normal: NormalEquations) -> MotionMatrix:
    """Return H_mm (9N, 9N), the motion's block of the normal equations."""
    matrix = MotionMatrix(normal.visibility, normal.diagonal.shape[1])
    matrix.blocks(0)[:] = normal.diagonal
    matrix.blocks(1)[:] = np.swapaxes(normal.coupling, 1, 2)
    return matrix


def reduce_landmarks(
    normal: NormalEquations, motion_damping: Floats, landmark_damping: Floats
) -> ReducedSystem:
    """Eliminate the landmarks, with damping (9N,) and (K, 3) added to the diagonals.

    Raises:
        numpy.linalg.LinAlgError: The position of a landmark is not determined.
    """
    inverse = inverse_landmark_factors(normal, landmark_damping)
    half = half_blocks(normal, inverse)
    matrix = motion_matrix(normal)
    matrix.diagonal[:] += motion_damping
    for window in normal.visibility.windows:
        dense = window.dense(half)
        product = (dense @ dense.T).reshape(window.keyframes, 6, window.keyframes, 6)
        matrix.window(window.first, window.last)[:, :6, :, :6] -= product
    pull = np.einsum("ijk,kj->ik", inverse, normal.landmark_gradient)
    reduced = ReducedSystem(
        matrix, normal.motion_gradient.copy(), half, inverse, pull, normal.visibility
    )
    reduced.gradient[:, :6] -= reduced.to_keyframes(pull).T
    return reduced


def half_blocks(normal: NormalEquations, inverse: Floats) -> Floats:
    """Return the blocks (6, 3, M) of W L^-T, from the landmarks' L^-1 (3, 3, K)."""
    observed = inverse.take(normal.visibility.landmark_of, axis=-1)
    blocks: Floats = np.einsum("ijm,kjm->ikm", normal.cross, observed)
    return blocks


def inverse_landmark_factors(normal: NormalEquations, damping: Floats | float) -> Floats:
    """Return the landmarks' L^-1 (3, 3, K) of the damped V = L L^T.

    Raises:
        numpy.linalg.LinAlgError: A V is not positive definite.
    """
    blocks = normal.landmark.copy()
    blocks[:, [0, 1, 2], [0, 1, 2]] += damping
    factors = np.linalg.inv(np.linalg.cholesky(blocks))
    return np.ascontiguousarray(factors.transpose(1, 2, 0))


def require_seen_landmarks(normal: NormalEquations) -> None:
    """Raise DegenerateGeometryError if the position of a landmark is not determined."""
    eigenvalues = np.linalg.eigvalsh(normal.landmark)
    open_ = np.flatnonzero(eigenvalues[:, 0] <= _ROUNDING * eigenvalues[:, 2])
    if len(open_):
        raise DegenerateGeometryError(
            f"{counted(len(open_), 'landmark')} without parallax or with one observation, the "
            f"first is {open_[0]}; remove them"
        )


def information_of(problem: Problem, state: State) -> scipy.sparse.csr_matrix:
    """Return H_mm - W V^-1 W^T (9N, 9N), undamped.

    Only keyframes that observe a common landmark are coupled. The rank is 9N - 4 in any gauge.
    """
    normal = problem.normal_equations(state)
    require_seen_landmarks(normal)
    half = _sparse_half(normal)
    shared = (half @ half.T).tocoo()
    direct = _motion_blocks(normal)
    rows, columns = (MOTION_WIDTH * (index // 6) + index % 6 for index in (shared.row, shared.col))
    eliminated = scipy.sparse.coo_matrix((shared.data, (rows, columns)), shape=direct.shape)
    information = (direct - eliminated).tocsr()
    return (information + information.T).tocsr() / 2.0


def _motion_blocks(normal: NormalEquations) -> scipy.sparse.csr_matrix:
    """Return H_mm (9N, 9N), the motion's block of the normal equations."""
    count, width, _ = normal.diagonal.shape
    diagonal = scipy.sparse.bsr_matrix(
        (normal.diagonal, np.arange(count), np.arange(count + 1)),
        shape=(width * count, width * count),
    )
    starts = np.minimum(np.arange(count + 1), count - 1)
    coupling = scipy.sparse.bsr_matrix(
        (normal.coupling, np.arange(1, count), starts), shape=(width * count, width * count)
    )
    return (diagonal + coupling + coupling.T).tocsr()


def _sparse_half(normal: NormalEquations) -> scipy.sparse.bsr_matrix:
    """Return W L^-T (6N, 3K) with V = L L^T, in blocks (6, 3)."""
    visibility = normal.visibility
    # Sorted by keyframe, as required for the rows of a block-sparse matrix.
    order = np.lexsort((visibility.landmark_of, visibility.keyframe_of))
    starts = np.searchsorted(visibility.keyframe_of[order], np.arange(visibility.keyframes + 1))
    blocks = half_blocks(normal, inverse_landmark_factors(normal, 0.0))
    return scipy.sparse.bsr_matrix(
        (np.moveaxis(blocks, -1, 0)[order], visibility.landmark_of[order], starts),
        shape=(6 * visibility.keyframes, 3 * visibility.landmarks),
    )
