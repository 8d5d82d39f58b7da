"""The absolute error against groundtruth whose errors are shared by neighbours.

Poses between the same two groundtruth samples err together. Taken as independent they count that
one error many times: the log Bayes factor of two estimates then grows with their rate without
end. The joint covariance of a Markov prior tells how much there is to know.
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
from trajeval_ros.likelihood.mode import unit_diagonal
from trajeval_ros.likelihood.relative_density import LOG_2_PI

_MOST_ITERATIONS = 30
_SMALL_STEP = 1e-8


@dataclass(frozen=True, eq=False)
class CorrelatedGroundtruth:
    """A Markov groundtruth at Q times, with all correlations, and a tolerance.

    Positions err along the world's axes, rotations on the right: the two are apart.

    Attributes:
        poses: (Q, 4, 4), the most likely ones.
        positions: The covariance of positions.
        rotations: That of rotations; None where the groundtruth, or the estimate, has none.
    """

    poses: Floats
    positions: ObservedPosterior
    rotations: ObservedPosterior | None

    @classmethod
    def of(cls, model: MarkovPoses, times: Floats, tolerance: Noise) -> CorrelatedGroundtruth:
        """Ask a model for times (Q,), seconds, within those of its samples."""

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
    """Return log L_AE, nats, by Laplace's approximation under right Haar measure.

    Args:
        groundtruth: At the estimate's times.
        estimate: (Q, 4, 4), in its own frame.
        gauge: What the alignment may change.
        start: An alignment (4, 4) close to the most likely one.

    Raises:
        DegenerateGeometryError: The poses leave a direction of the gauge open.
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
        turns = _turns(groundtruth, moved)
        value += groundtruth.rotations.log_density(turns)
        value -= float(se3.log_determinant(turns).sum())
    return value


def _apart(groundtruth: CorrelatedGroundtruth, moved: Floats) -> Floats:
    difference: Floats = moved[:, :3, 3] - groundtruth.poses[:, :3, 3]
    return difference


def _turns(groundtruth: CorrelatedGroundtruth, moved: Floats) -> Floats:
    return so3.log(se3.transposed(groundtruth.poses[:, :3, :3]) @ moved[:, :3, :3])


def _normal_equations(
    groundtruth: CorrelatedGroundtruth, moved: Floats, chart: Chart
) -> tuple[Floats, Floats]:
    """Return the information (d, d) and gradient (d,) of the log density by an alignment."""
    twists = chart.twists(moved[:, :3, 3])
    by_delta = twists[:, :3] - so3.skew(moved[:, :3, 3]) @ twists[:, 3:]
    parts = [(groundtruth.positions, _apart(groundtruth, moved), by_delta)]
    if groundtruth.rotations is not None:
        turns = _turns(groundtruth, moved)
        into_body = se3.transposed(groundtruth.poses[:, :3, :3])
        carried = so3.inverse_left_jacobian(turns) @ into_body
        parts.append((groundtruth.rotations, turns, carried @ twists[:, 3:]))
    information = np.zeros((chart.dimension, chart.dimension))
    gradient = np.zeros(chart.dimension)
    for covariance, residual, jacobian in parts:
        weighted = covariance.solve(np.concatenate([jacobian, residual[..., None]], axis=2))
        products = np.einsum("qid,qie->de", jacobian, weighted)
        information += products[:, :-1]
        gradient -= products[:, -1]
    return 0.5 * (information + information.T), gradient
