"""Symmetric positive definite block tridiagonal matrices, in O(N).

Relative poses have such a covariance, since consecutive ones share a state (probabilistic paper,
eq. 15). States of a Markov process have such an information matrix.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.linalg.lapack import dtbtrs

from trajeval_ros.geometry.arrays import Floats

_NEGLIGIBLE = 1e-20


@dataclass(frozen=True, eq=False)
class Factor:
    """The Cholesky factor L of S A S, with S diagonal and A the matrix: A = S^-1 L L^T S^-1.

    Rows and columns are scaled to a unit diagonal, so that different units (metres and radians,
    positions and accelerations) do not cost precision.

    Attributes:
        band: (2 d, N d) lower banded storage of L.
        scale: (N, d), the diagonal of S.
    """

    band: Floats
    scale: Floats

    @classmethod
    def of(cls, diagonal: Floats, lower: Floats) -> Factor:
        """Factorise the matrix of blocks (N, d, d) and, below them, (N - 1, d, d).

        Raises:
            numpy.linalg.LinAlgError: It is not positive definite.
        """
        entries = np.einsum("nii->ni", diagonal)
        if not (entries > 0.0).all():
            raise np.linalg.LinAlgError("a diagonal entry is not positive")
        scale = 1.0 / np.sqrt(entries)
        band = _lower_band(
            diagonal * scale[:, :, None] * scale[:, None, :],
            lower * scale[1:, :, None] * scale[:-1, None, :],
        )
        return cls(cholesky_banded(band, lower=True, overwrite_ab=True), scale)

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
        solved = np.asarray(cho_solve_banded((self.band, True), flat, check_finite=False))
        return solved.reshape(rows.shape) * scale

    def inverse_blocks(self) -> tuple[Floats, Floats]:
        """Return the blocks of A^-1 on the diagonal (N, d, d), and right of it (N - 1, d, d).

        The recursion P_k = C_k + G_k^T P_{k+1} G_k runs backwards over the states. It is
        associative. Doubling the step in every round takes as many rounds as needed until states
        that far apart are uncorrelated.
        """
        count, size = self.scale.shape
        diagonal, lower = _blocks(self.band, count, size)
        inverted = np.linalg.inv(diagonal)
        own = np.swapaxes(inverted, 1, 2) @ inverted
        gain = lower @ inverted[:-1]
        blocks, reach = own.copy(), np.concatenate([gain, np.zeros((1, size, size))])
        step = 1
        while step < count and np.abs(reach[:-step]).max() > _NEGLIGIBLE:
            near = reach[:-step]
            # Both right-hand sides are read before either array changes.
            more = np.swapaxes(near, 1, 2) @ blocks[step:] @ near
            farther = reach[step:] @ near
            blocks[:-step] += more
            reach[:-step] = farther
            reach[-step:] = 0.0
            step *= 2
        beside = -np.swapaxes(gain, 1, 2) @ blocks[1:]
        scale = self.scale
        return (
            blocks * scale[:, :, None] * scale[:, None, :],
            beside * scale[:-1, :, None] * scale[1:, None, :],
        )


def _lower_band(diagonal: Floats, lower: Floats) -> Floats:
    """Return the lower banded storage (2 d, N d): row i - j holds the entries (i, j).

    Columns are contiguous, as LAPACK requires.
    """
    count, size, _ = diagonal.shape
    band = np.zeros((count, size, 2 * size))
    for column in range(size):
        band[:, column, : size - column] = diagonal[:, column:, column]
        band[:-1, column, size - column : 2 * size - column] = lower[:, :, column]
    return band.reshape(count * size, 2 * size).T


def _blocks(band: Floats, count: int, size: int) -> tuple[Floats, Floats]:
    """Return the blocks of a factor in lower banded storage, on and below the diagonal."""
    columns = band.T.reshape(count, size, 2 * size)
    diagonal = np.zeros((count, size, size))
    lower = np.zeros((count - 1, size, size))
    for column in range(size):
        diagonal[:, column:, column] = columns[:, column, : size - column]
        lower[:, :, column] = columns[:-1, column, size - column : 2 * size - column]
    return diagonal, lower
