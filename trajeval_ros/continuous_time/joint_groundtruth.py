"""The joint covariance of groundtruth at many times, with the correlations of neighbours.

As independent poses, queries near the same groundtruth sample would count its error several times.
Log Bayes factors would then grow with the estimate's rate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajeval_ros.continuous_time.markov import Process
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.block_tridiagonal import Factor

# Distance from a sample, relative to the median step, below which a query uses the sample's knot.
# The information between knots closer than a thousandth exceeds double precision.
_SAME_SHARE = 0.03


@dataclass(frozen=True, eq=False)
class JointPosterior:
    """A Markov process with additional knots at Q query times.

    Attributes:
        dimension: d, of a query's error.
        blocks: (N, d m, d m), diagonal blocks of the information.
        lower: (N - 1, d m, d m), blocks below the diagonal.
        factor: Factor of the information.
        rows: (Q,), the knots of the queries.
    """

    dimension: int
    blocks: Floats
    lower: Floats
    factor: Factor
    rows: Indices

    @classmethod
    def of(cls, process: Process, times: Floats) -> JointPosterior:
        """Add knots at times (Q,), seconds, within those of the process."""
        own = process.times
        after = np.clip(np.searchsorted(own, times), 1, len(own) - 1)
        nearest = after - (times - own[after - 1] < own[after] - times)
        close = np.abs(times - own[nearest]) < _SAME_SHARE * float(np.median(np.diff(own)))
        asked = np.where(close, own[nearest], times)
        union, place = np.unique(np.concatenate([own, asked]), return_inverse=True)
        samples, rows = place[: len(own)], place[len(own) :]
        states, _ = process.interpolator().at(union)
        measured, information = states.copy(), np.zeros((len(union), process.dimension))
        measured[samples], information[samples] = process.measured, process.information
        columns = process.rates.reshape(len(own), -1).T
        rates = np.empty((len(union), len(columns)))
        for axis, column in enumerate(columns):
            rates[:, axis] = np.interp(union, own, column)
        dense = replace(
            process,
            times=union,
            measured=measured,
            information=information,
            states=states,
            rates=rates.reshape(len(union), *process.rates.shape[1:]),
        ).solved(15, 1e-10)
        blocks, lower, _, _ = dense._normal_equations()
        return cls(process.dimension, blocks, lower, Factor.of(blocks, lower), rows)

    def observed(self, tolerance: Floats) -> ObservedPosterior:
        """Add independent errors with covariances R (Q, d, d)."""
        inverse = np.asarray(np.linalg.inv(tolerance))
        blocks = self.blocks.copy()
        np.add.at(blocks[:, : self.dimension, : self.dimension], self.rows, inverse)
        both = Factor.of(blocks, self.lower)
        determinant = both.log_determinant - self.factor.log_determinant
        determinant += float(np.linalg.slogdet(tolerance)[1].sum())
        return ObservedPosterior(both, self.rows, inverse, determinant)


@dataclass(frozen=True, eq=False)
class ObservedPosterior:
    """The covariance P + R of observations at the queries, by the matrix inversion lemma.

    Attributes:
        factor: Factor of the information including that of the observations.
        rows: (Q,), the knots of the queries.
        inverse: R^-1, (Q, d, d).
        log_determinant: Of P + R.
    """

    factor: Factor
    rows: Indices
    inverse: Floats
    log_determinant: float

    def solve(self, errors: Floats) -> Floats:
        """Return (P + R)^-1 x for x (Q, d, k), in O(Q)."""
        weighted, dimension = self.inverse @ errors, errors.shape[1]
        spread = np.zeros((*self.factor.scale.shape, errors.shape[-1]))
        np.add.at(spread[:, :dimension], self.rows, weighted)
        solved: Floats = weighted - self.inverse @ self.factor.solve(spread)[self.rows, :dimension]
        return solved

    def log_density(self, errors: Floats) -> float:
        """Return log N(errors; 0, P + R) of errors (Q, d)."""
        squared = float(np.vdot(errors, self.solve(errors[..., None])[..., 0]))
        return -0.5 * (squared + self.log_determinant + errors.size * float(np.log(2.0 * np.pi)))
