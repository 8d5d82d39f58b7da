"""The motion's information matrix as a sparse matrix, for runs too long for a dense one."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from trajeval_ros.visual_inertial.problem import NormalEquations, Problem
from trajeval_ros.visual_inertial.reduction import (
    half_blocks,
    inverse_landmark_factors,
    require_seen_landmarks,
)
from trajeval_ros.visual_inertial.state import State


def information_of(problem: Problem, state: State) -> scipy.sparse.csr_matrix:
    """Return H_mm - W V^-1 W^T (wN, wN), undamped.

    Only keyframes that observe a common landmark are coupled. The rank is wN - 4 in any gauge.

    Raises:
        DegenerateGeometryError: A landmark's position is not determined.
    """
    normal = problem.normal_equations(state)
    require_seen_landmarks(normal)
    half = _sparse_half(normal)
    shared = (half @ half.T).tocoo()
    direct = _motion_blocks(normal)
    rows, columns = (
        problem.width * (index // 6) + index % 6 for index in (shared.row, shared.col)
    )
    eliminated = scipy.sparse.coo_matrix((shared.data, (rows, columns)), shape=direct.shape)
    information = (direct - eliminated).tocsr()
    return (information + information.T).tocsr() / 2.0


def _motion_blocks(normal: NormalEquations) -> scipy.sparse.csr_matrix:
    """Return H_mm (wN, wN), the motion's block of the normal equations."""
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
