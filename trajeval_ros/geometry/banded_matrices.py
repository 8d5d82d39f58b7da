"""Block tridiagonal and banded matrices, in O(N).

Relative poses have a block tridiagonal covariance, since consecutive ones share a state
(probabilistic paper, eq. 15). States of a Markov process have such an information matrix. An
estimator's information matrix is banded: in blocks as long as the bandwidth, it is such a matrix.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.linalg.lapack import dtbtrs

from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.geometry.arrays import Floats

AT_ONCE = 1 << 8  # states whose blocks stay in the processor's cache


@dataclass(frozen=True, eq=False)
class Factor:
    """The Cholesky factor L of S A S, with S diagonal and A the matrix: A = S^-1 L L^T S^-1.

    Rows and columns are scaled to a unit diagonal, so that different units (metres and radians,
    positions and accelerations) do not cost precision.
    """

    band: Floats  # (2 d, N d) lower banded storage of L
    scale: Floats  # (N, d), the diagonal of S

    @classmethod
    def of(cls, diagonal: Floats, lower: Floats) -> Factor:
        """Return `of_band` of the blocks (N, d, d) and, below them, (N - 1, d, d)."""
        band = np.zeros((*diagonal.shape[:2], 2 * diagonal.shape[1]))
        add_blocks(band, diagonal, lower)
        return cls.of_band(band)

    @classmethod
    def of_band(cls, band: Floats) -> Factor:
        """Factorise the matrix of `add_blocks` (N, d, 2 d); the factor replaces it.

        Raises:
            numpy.linalg.LinAlgError: It is not positive definite.
        """
        entries, width = band[..., 0], band.shape[2]
        if not (entries > 0.0).all():
            raise np.linalg.LinAlgError("a diagonal entry is not positive")
        scale = 1.0 / np.sqrt(entries)
        columns, scales = band.reshape(-1, width), scale.reshape(-1, 1)
        rows = sliding_window_view(np.pad(scales[:, 0], (0, width - 1)), width)
        for start in range(0, len(columns), width * AT_ONCE):
            part = slice(start, start + width * AT_ONCE)
            columns[part] *= rows[part]
            columns[part] *= scales[part]
        return cls(cholesky_banded(columns.T, lower=True, overwrite_ab=True), scale)

    @property
    def log_diagonal(self) -> Floats:
        """Logarithms of the diagonal of the matrix's factor S^-1 L, (N, d)."""
        logarithms: Floats = np.log(self.band[0]).reshape(self.scale.shape) - np.log(self.scale)
        return logarithms

    @property
    def log_determinant(self) -> float:
        """Logarithm of the matrix's determinant."""
        return 2.0 * float(self.log_diagonal.sum())

    def whitened(self, rows: Floats) -> Floats:
        """Return (S^-1 L)^-1 x for x (N, d): of unit covariance if the covariance of x is A."""
        scaled = (rows * self.scale).reshape(-1, 1)
        return np.asarray(dtbtrs(self.band, scaled, uplo="L")[0]).reshape(rows.shape)

    def solve(self, rows: Floats) -> Floats:
        """Return A^-1 x for x (N, d) or (N, d, k)."""
        scale = self.scale if rows.ndim == 2 else self.scale[..., None]
        flat = (rows * scale).reshape(self.scale.size, -1)
        solved = np.asarray(cho_solve_banded((self.band, True), flat, True, check_finite=False))
        solved = solved.reshape(rows.shape)
        solved *= scale
        return solved

    def inverse_blocks(self) -> tuple[Floats, Floats]:
        """Return the blocks of A^-1 on the diagonal (N, d, d), and right of it (N - 1, d, d).

        The recursion P_k = C_k + G_k^T P_{k+1} G_k runs backwards over the states.
        """
        count, size = self.scale.shape
        blocks, off_diagonal = np.empty((2, count, size, size))
        after = np.zeros((size, size))
        few = max(1, AT_ONCE * 256 // size**2)
        for start in reversed(range(0, count, few)):
            rows = slice(start, start + few)
            diagonal, lower = _blocks(self.band.T.reshape(count, size, -1)[rows])
            inverted = np.linalg.inv(diagonal)
            inverse, gain = np.swapaxes(inverted, 1, 2) @ inverted, lower @ inverted
            for k in reversed(range(len(inverse))):
                across = gain[k].T @ after
                inverse[k] += across @ gain[k]
                after, off_diagonal[start + k] = inverse[k], -across
            blocks[rows] = inverse * self.scale[rows, :, None] * self.scale[rows, None, :]
        off_diagonal[:-1] *= self.scale[:-1, :, None]
        off_diagonal[:-1] *= self.scale[1:, None, :]
        return blocks, off_diagonal[:-1]


def add_blocks(band: Floats, diagonal: Floats, lower: Floats | None = None) -> None:
    """Add blocks (N, d, d) to the columns (N, d, 2 d) of a matrix in lower banded storage.

    It is that of LAPACK: entry i - j of column j is that of row i. `lower` has the blocks below
    (N or N - 1, d, d). Entries of other blocks stay zero.
    """
    size = diagonal.shape[1]
    for column in range(size):
        end = size - column
        band[:, column, :end] += diagonal[:, column:, column]
        if lower is not None:
            band[: len(lower), column, end : end + size] += lower[:, :, column]


def _blocks(columns: Floats) -> tuple[Floats, Floats]:
    """Return the blocks (N, d, d) on and below the diagonal of a banded factor's columns."""
    _, size, _ = columns.shape
    diagonal, lower = np.zeros((2, len(columns), size, size))
    for column in range(size):
        diagonal[:, column:, column] = columns[:, column, : size - column]
        lower[:, :, column] = columns[:, column, size - column : 2 * size - column]
    return diagonal, lower


def bandwidth(matrix: scipy.sparse.csr_matrix) -> int:
    """Return the largest distance of an entry from the diagonal."""
    entries = matrix.tocoo()
    return int(np.abs(entries.row - entries.col).max(initial=0))


class BandedGaussian:
    """A Gaussian with an information matrix (n, n), positive definite and banded."""

    def __init__(self, information: scipy.sparse.csr_matrix) -> None:
        """Factorise the matrix, in blocks as long as the bandwidth; unit entries fill the last."""
        self._size, block = information.shape[0], max(bandwidth(information), 1)
        band = np.zeros((-(-self._size // block), block, 2 * block))
        columns, entries = band.reshape(-1, 2 * block), scipy.sparse.tril(information).tocoo()
        np.add.at(columns, (entries.col, entries.row - entries.col), entries.data)
        columns[self._size :, 0] = 1.0
        try:
            self._factor = Factor.of_band(band)
        except np.linalg.LinAlgError as error:
            raise DegenerateGeometryError(
                "the measurements do not determine all directions except position and yaw; "
                "add landmarks, or keyframes with other viewpoints"
            ) from error

    def sampled(self, normals: Floats) -> Floats:
        """Return a sample (n, ...) of the Gaussian from standard normal numbers (n, ...)."""
        rows, scale = self._filled(normals), self._factor.scale.reshape(-1, 1)
        solved = np.asarray(dtbtrs(self._factor.band, rows, uplo="L", trans="T")[0]) * scale
        return solved[: self._size].reshape(normals.shape)

    def solved(self, columns: Floats) -> Floats:
        """Return the covariance times columns (n, k)."""
        rows = self._filled(columns).reshape(*self._factor.scale.shape, -1)
        return self._factor.solve(rows).reshape(-1, columns.shape[1])[: self._size]

    def marginals(self, starts: NDArray[np.int64], size: int) -> Floats:
        """Return the blocks (B, size, size) on the covariance's diagonal that start at `starts`.

        A block can extend over two blocks of the factor.
        """
        diagonal, off_diagonal = self._factor.inverse_blocks()
        blocks, length = np.empty((len(starts), size, size)), diagonal.shape[1]
        for block, start in zip(blocks, starts.tolist(), strict=True):
            first, at = divmod(start, length)
            joint = diagonal[first]
            if at + size > length:
                across = off_diagonal[first]
                joint = np.block([[joint, across], [across.T, diagonal[first + 1]]])
            block[:] = joint[at : at + size, at : at + size]
        return blocks

    def _filled(self, rows: Floats) -> Floats:
        """Return rows (n, ...) with zeros for the unit entries, in two dimensions."""
        more = self._factor.scale.size - self._size
        return np.pad(rows.reshape(self._size, -1), [(0, more), (0, 0)])
