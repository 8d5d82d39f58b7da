"""Symmetric matrices of the motion: banded if tracks are short, otherwise dense."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.lib.stride_tricks import as_strided

from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.visual_inertial.visibility import Visibility

# Longest track, relative to the number of keyframes, with which a banded factor is faster.
_BANDED_SHARE = 0.25


class MotionMatrix:
    """A symmetric matrix (wN, wN) of N keyframes with w parameters each, zero at first.

    Its blocks are written through views. This works for both kinds of storage, since element
    (i, j) is at place `begin + i + step * j` in memory: a dense matrix is stored by columns, and
    row j of a banded one has the elements beside the diagonal of column j. Only the lower triangle
    is read.
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
        """The diagonal (wN,), a view."""
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
        """Return A^-1 b for b (wN,), and overwrite the matrix.

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
        """Return the matrix (wN, wN)."""
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
