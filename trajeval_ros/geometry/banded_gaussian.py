"""A Gaussian with a banded information matrix: samples and marginals without its covariance.

Parameters are cut into segments at least as long as the bandwidth, so that a segment is coupled to
its neighbours only. A block elimination from the first to the last segment needs one small
Cholesky factor per segment.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import scipy.linalg
import scipy.sparse
from numpy.typing import NDArray

from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.geometry.arrays import Floats


def bandwidth(matrix: scipy.sparse.csr_matrix) -> int:
    """Return the largest distance of an entry from the diagonal."""
    entries = matrix.tocoo()
    return int(np.abs(entries.row - entries.col).max(initial=0))


class BandedGaussian:
    """The block factors of an information matrix (n, n), positive definite and banded."""

    def __init__(self, information: scipy.sparse.csr_matrix) -> None:
        """Eliminate the segments in order.

        Raises:
            DegenerateGeometryError: The matrix is not positive definite.
        """
        size = information.shape[0]
        links = max(size // max(bandwidth(information), 1), 1)
        cuts = np.linspace(0, size, links + 1).astype(int)
        self._rows = [slice(*bounds) for bounds in itertools.pairwise(cuts)]
        # Per segment: the Cholesky factor D of its Schur complement, and the regression -D^-1 U
        # on the next segment.
        self._factors: list[Floats] = []
        self._regressions: list[Floats] = []
        correction: Floats | float = 0.0
        for rows, after in zip(self._rows, [*self._rows[1:], slice(size, size)], strict=True):
            left = information[rows, rows].toarray() - correction
            coupling = information[rows, after].toarray()
            try:
                factor = scipy.linalg.cholesky(left, lower=True)
            except np.linalg.LinAlgError as error:
                raise DegenerateGeometryError(
                    "the measurements do not determine all directions except position and yaw; "
                    "add landmarks, or keyframes with other viewpoints"
                ) from error
            whitened = scipy.linalg.solve_triangular(factor, coupling, lower=True)
            correction = whitened.T @ whitened
            self._factors.append(factor)
            self._regressions.append(
                -scipy.linalg.solve_triangular(factor, whitened, lower=True, trans="T")
            )

    def sampled(self, normals: Floats) -> Floats:
        """Return a sample (n, ...) of the Gaussian from standard normal numbers (n, ...)."""
        sample = np.empty_like(normals)
        ahead = np.empty((0, *normals.shape[1:]))
        for rows, factor, regression in self._backwards():
            noise = scipy.linalg.solve_triangular(factor, normals[rows], lower=True, trans="T")
            ahead = noise + regression @ ahead
            sample[rows] = ahead
        return sample

    def solved(self, columns: Floats) -> Floats:
        """Return the covariance times columns (n, k)."""
        product = columns.astype(float)
        for rows, after, regression in zip(
            self._rows[:-1], self._rows[1:], self._regressions[:-1], strict=True
        ):
            product[after] += regression.T @ product[rows]
        ahead = np.empty((0, columns.shape[1]))
        for rows, factor, regression in self._backwards():
            ahead = scipy.linalg.cho_solve((factor, True), product[rows]) + regression @ ahead
            product[rows] = ahead
        return product

    def marginals(self, starts: NDArray[np.int64], size: int) -> Floats:
        """Return the blocks (B, size, size) on the covariance's diagonal that start at `starts`.

        A block can extend over two segments.
        """
        blocks = np.empty((len(starts), size, size))
        covariance = np.empty((0, 0))
        for rows, factor, regression in self._backwards():
            cross = regression @ covariance
            own = scipy.linalg.cho_solve((factor, True), np.eye(len(factor)))
            own += cross @ regression.T
            # With the next segment, for blocks that extend over both.
            joint = np.block([[own, cross], [cross.T, covariance]])
            here = np.flatnonzero((starts >= rows.start) & (starts < rows.stop))
            within = (starts[here] - rows.start)[:, None] + np.arange(size)
            blocks[here] = joint[within[:, :, None], within[:, None, :]]
            covariance = own
        return blocks

    def _backwards(self) -> Iterator[tuple[slice, Floats, Floats]]:
        return zip(self._rows[::-1], self._factors[::-1], self._regressions[::-1], strict=True)
