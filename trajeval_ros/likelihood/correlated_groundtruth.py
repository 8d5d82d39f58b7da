"""The joint covariance of groundtruth at many times, and absolute errors against it.

Poses between the same two groundtruth samples share their errors. As independent poses they would
count them several times: the log Bayes factor of two estimates would grow with their rate. The
joint covariance of a Markov prior avoids this.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajeval_ros.continuous_time import white_noise
from trajeval_ros.continuous_time.continuous_trajectory import MarkovPoses
from trajeval_ros.continuous_time.markov import Process
from trajeval_ros.continuous_time.samples import Noise
from trajeval_ros.geometry import se3, so3
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.banded_matrices import Factor
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.likelihood.alignment_chart import Chart, act
from trajeval_ros.likelihood.relative_density import LOG_2_PI
from trajeval_ros.likelihood.residuals import unit_diagonal

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


_MOST_ITERATIONS = 30
_SMALL_STEP = 1e-8


@dataclass(frozen=True, eq=False)
class CorrelatedGroundtruth:
    """A Markov groundtruth at Q times with all correlations and a tolerance.

    Positions are perturbed along the world's axes, rotations on the right, independently.
    """

    poses: Floats  # (Q, 4, 4), the most likely ones
    positions: ObservedPosterior  # covariance of the positions
    # Covariance of the rotations; None without orientations on both sides.
    rotations: ObservedPosterior | None

    @classmethod
    def of(cls, model: MarkovPoses, times: Floats, tolerance: Noise) -> CorrelatedGroundtruth:
        """Evaluate a model at times (Q,), seconds, within those of its samples."""

        def added(sigma: float) -> Floats:
            return np.tile(sigma**2 * np.eye(3), (len(times), 1, 1))

        positions = JointPosterior.of(model.positions.process, times)
        rotations = None
        if model.rotations is not None:
            joint = JointPosterior.of(model.rotations.process, times)
            rotations = joint.observed(added(tolerance.rotation_rad))
        return cls(
            model.at(times).poses, positions.observed(added(tolerance.position_m)), rotations
        )


def joint_log_likelihood(
    groundtruth: CorrelatedGroundtruth, estimate: Floats, gauge: Gauge, start: Floats
) -> float:
    """Return log L_AE, nats, by Laplace's approximation with the right Haar measure.

    The estimate (Q, 4, 4) is in its own frame, at the times of the groundtruth. `start` is an
    alignment (4, 4) near the most likely one.
    """
    chart = Chart(gauge, groundtruth.poses[:, :3, 3].mean(axis=0))
    element = start
    for _ in range(_MOST_ITERATIONS):
        information, gradient = _normal_equations(groundtruth, act(element, estimate), chart)
        if not len(gradient):
            break
        scale = unit_diagonal(information)
        scaled = information * scale * scale[:, None]
        step = scale * np.linalg.solve(scaled, scale * gradient)
        element = chart.elements(step[None])[0] @ element
        if step @ information @ step < _SMALL_STEP**2:
            break
    moved = act(element, estimate)
    information, _ = _normal_equations(groundtruth, moved, chart)
    value = 0.5 * (len(information) * LOG_2_PI - float(np.linalg.slogdet(information)[1]))
    value += groundtruth.positions.log_density(_apart(groundtruth, moved))
    if groundtruth.rotations is not None:
        rotations = _turns(groundtruth, moved)
        value += groundtruth.rotations.log_density(rotations)
        value -= float(se3.log_determinant(rotations).sum())
    return value


def _apart(groundtruth: CorrelatedGroundtruth, moved: Floats) -> Floats:
    """Return the differences of positions (Q, 3), metres."""
    difference: Floats = moved[:, :3, 3] - groundtruth.poses[:, :3, 3]
    return difference


def _turns(groundtruth: CorrelatedGroundtruth, moved: Floats) -> Floats:
    """Return the rotation vectors from groundtruth to aligned poses (Q, 3), rad."""
    return so3.log(se3.transposed(groundtruth.poses[:, :3, :3]) @ moved[:, :3, :3])


def _normal_equations(
    groundtruth: CorrelatedGroundtruth, moved: Floats, chart: Chart
) -> tuple[Floats, Floats]:
    """Return information (d, d) and gradient (d,) of the log density at an alignment."""
    twists = chart.twists(moved[:, :3, 3])
    by_delta = twists[:, :3] - so3.skew(moved[:, :3, 3]) @ twists[:, 3:]
    parts = [(groundtruth.positions, _apart(groundtruth, moved), by_delta)]
    if groundtruth.rotations is not None:
        rotations = _turns(groundtruth, moved)
        into_body = se3.transposed(groundtruth.poses[:, :3, :3])
        carried = so3.inverse_left_jacobian(rotations) @ into_body
        parts.append((groundtruth.rotations, rotations, carried @ twists[:, 3:]))
    information = np.zeros((chart.dimension, chart.dimension))
    gradient = np.zeros(chart.dimension)
    for covariance, residual, jacobian in parts:
        weighted = covariance.solve(np.concatenate([jacobian, residual[..., None]], axis=2))
        products = np.einsum("qid,qie->de", jacobian, weighted)
        information += products[:, :-1]
        gradient -= products[:, -1]
    return 0.5 * (information + information.T), gradient
