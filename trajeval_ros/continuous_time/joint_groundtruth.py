"""The joint covariance of groundtruth at many times, with the correlations of neighbours.

As independent poses, queries near the same groundtruth sample would count its error several times.
Log Bayes factors would then grow with the estimate's rate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajeval_ros.continuous_time import white_noise
from trajeval_ros.continuous_time.markov import Process
from trajeval_ros.geometry import se3
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.banded_matrices import Factor

# Queries share a knot if the variance of the motion between them is below this share of the
# variance over a step of the groundtruth. White noise on the m-th derivative has a variance of
# t^(2 m - 1). The information between two knots is its inverse: much closer knots exceed double
# precision.
_SAME_SHARE = 1e-9


@dataclass(frozen=True, eq=False)
class JointPosterior:
    """A Markov process with additional knots near Q query times.

    The error of a query follows from the state of its knot by the transition of the process.
    """

    blocks: Floats  # (N, d m, d m), diagonal blocks of the information
    lower: Floats  # (N - 1, d m, d m), blocks below the diagonal
    factor: Factor  # factor of the information
    rows: Indices  # (Q,), the knots of the queries
    by_knot: Floats  # (Q, d, d m), derivatives of the queries' errors by those of their knots
    motion: Floats  # (Q, d, d), covariances of the motion between knots and queries

    @classmethod
    def of(cls, process: Process, times: Floats) -> JointPosterior:
        """Add knots for times (Q,), seconds, within those of the process."""
        knots = process.times
        union, place = np.unique(
            np.concatenate([knots, _knots(knots, times, process.order)]), return_inverse=True
        )
        samples, rows = place[: len(knots)], place[len(knots) :]
        states, _ = process.interpolator().at(union)
        measured, information = states.copy(), np.zeros((len(union), process.dimension))
        measured[samples], information[samples] = process.measured, process.information
        columns = process.rates.reshape(len(knots), -1).T
        rates = np.empty((len(union), len(columns)))
        for axis, column in enumerate(columns):
            rates[:, axis] = np.interp(union, knots, column)
        dense = replace(
            process,
            times=union,
            measured=measured,
            information=information,
            states=states,
            rates=rates.reshape(len(union), *process.rates.shape[1:]),
        ).solved()
        blocks, lower, _, _ = dense._normal_equations()
        since = times - union[rows]
        return cls(
            blocks,
            lower,
            Factor.of(blocks, lower),
            rows,
            dense.carried(rows, since),
            white_noise.covariance(process.order, np.abs(since))[:, :1, :1]
            * np.diag(process.density),
        )

    def observed(self, tolerance: Floats) -> ObservedPosterior:
        """Add independent errors with covariances R (Q, d, d)."""
        tolerance = tolerance + self.motion
        inverse = np.asarray(np.linalg.inv(tolerance))
        blocks = self.blocks.copy()
        np.add.at(blocks, self.rows, se3.transposed(self.by_knot) @ inverse @ self.by_knot)
        both = Factor.of(blocks, self.lower)
        determinant = both.log_determinant - self.factor.log_determinant
        determinant += float(np.linalg.slogdet(tolerance)[1].sum())
        return ObservedPosterior(both, self.rows, self.by_knot, inverse, determinant)


def _knots(samples: Floats, times: Floats, order: int) -> Floats:
    """Return times (Q,) of the knots of queries (Q,) between samples (N,).

    The knot is at the query itself. If another query or sample is closer than a cell, the knots of
    both are on a grid of cells between the samples.
    """
    steps = np.diff(samples)
    most = _SAME_SHARE ** (-1.0 / (2 * order - 1))
    cells = np.maximum(np.floor(most * np.minimum(steps / np.median(steps), 1.0)), 1.0)
    begin = np.clip(np.searchsorted(samples, times) - 1, 0, len(steps) - 1)
    start, end, count = samples[begin], samples[begin + 1], cells[begin]
    everything = np.unique(np.concatenate([samples, times]))
    apart = np.concatenate([[np.inf], np.diff(everything), [np.inf]])
    place = np.searchsorted(everything, times)
    is_close = np.minimum(apart[place], apart[place + 1]) < (end - start) / count
    share = np.rint((times - start) / (end - start) * count) / count
    on_grid = np.where(share == 1.0, end, start + share * (end - start))
    knots: Floats = np.where(is_close, on_grid, times)
    return knots


@dataclass(frozen=True, eq=False)
class ObservedPosterior:
    """The covariance P + R of observations at the queries, by the matrix inversion lemma."""

    factor: Factor  # factor of the information including that of the observations
    rows: Indices  # (Q,), the knots of the queries
    by_knot: Floats  # (Q, d, d m), derivatives of the queries' errors by those of their knots
    inverse: Floats  # R^-1, (Q, d, d)
    log_determinant: float  # of P + R

    def solve(self, errors: Floats) -> Floats:
        """Return (P + R)^-1 x for x (Q, d, k), in O(Q)."""
        weighted = self.inverse @ errors
        spread = np.zeros((*self.factor.scale.shape, errors.shape[-1]))
        np.add.at(spread, self.rows, se3.transposed(self.by_knot) @ weighted)
        known = self.by_knot @ self.factor.solve(spread)[self.rows]
        solved: Floats = weighted - self.inverse @ known
        return solved

    def log_density(self, errors: Floats) -> float:
        """Return log N(errors; 0, P + R) of errors (Q, d)."""
        squared = float(np.vdot(errors, self.solve(errors[..., None])[..., 0]))
        return -0.5 * (squared + self.log_determinant + errors.size * float(np.log(2.0 * np.pi)))
