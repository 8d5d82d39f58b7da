"""The absolute error against groundtruth with correlated errors.

Poses between the same two groundtruth samples share their errors. As independent poses they would
count them several times: the log Bayes factor of two estimates would grow with their rate. The
joint covariance of a Markov prior avoids this.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.continuous_time.continuous_trajectory import MarkovPoses
from trajeval_ros.continuous_time.joint_groundtruth import JointPosterior, ObservedPosterior
from trajeval_ros.continuous_time.samples import Noise
from trajeval_ros.geometry import se3, so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.likelihood.alignment_chart import Chart, act
from trajeval_ros.likelihood.relative_density import LOG_2_PI
from trajeval_ros.likelihood.residuals import unit_diagonal

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
