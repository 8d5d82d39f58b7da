"""The generalised relative error: eq. (10), (14), (15) and (17) of the probabilistic paper.

Taken literally, second-order terms accumulate along the trajectory: at 1 deg and a thousand poses
the error is a thousand nats. Residuals about the alignment's mode, decomposed by edge, avoid this.

In eq. (12) to (14) the paper transports a perturbation from one pose to the next by Ad(T_{i,i+1}).
The matrix that moves Exp(-xi_i) past T_{i,i+1} is the adjoint of the inverse step, Ad(T_{i+1,i}).
With the paper's matrix, identity (29) of both errors does not hold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.continuous_time.samples import Belief
from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.geometry import se3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.banded_matrices import Factor

LOG_2_PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, eq=False)
class RelativeErrorDensity:
    """Log densities of M - 1 relative poses by edge."""

    edges: Floats  # (M - 1,), log p(e_i | e_1 ... e_{i-1}), nats; their sum is eq. (17)
    # (M - 1, 6), innovations of the edges given the previous ones, of unit variance
    whitened: Floats

    @property
    def log_likelihood(self) -> float:
        """Logarithm of P_RE, eq. (17), nats."""
        return float(self.edges.sum())


def relative_poses(poses: Floats) -> Floats:
    """Return T_i^-1 T_{i+1} (M - 1, 4, 4): eq. (10) for groundtruth, eq. (11) for an estimate."""
    steps: Floats = se3.inverse(poses[:-1]) @ poses[1:]
    return steps


def transports(poses: Floats) -> Floats:
    """Return B_i = Ad(T_{i+1}^-1 T_i), (M - 1, 6, 6), for groundtruth poses (M, 4, 4)."""
    return se3.adjoint(se3.inverse(relative_poses(poses)))


def stepwise(carriers: Floats, perturbations: Floats) -> Floats:
    """Return Q xi, xi_{i+1} - B_i xi_i, (M - 1, 6): eq. (14), the first order of eq. (13).

    B_i (M - 1, 6, 6) are from `transports`. xi (M, 6) are perturbations or residuals.
    """
    steps: Floats = perturbations[1:] - se3.times(carriers, perturbations[:-1])
    return steps


def relative_covariance(carriers: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    """Return the blocks of V_r = Q V Q^T, eq. (15), for B_i from `transports`.

    Blocks (M - 1, 6, 6) are on its diagonal and blocks (M - 2, 6, 6) below it.
    """
    diagonal = se3.congruent(carriers, covariances[:-1]) + covariances[1:]
    return diagonal, -carriers[1:] @ covariances[1:-1]


def decomposed(belief: Belief, differences: Floats) -> RelativeErrorDensity:
    """Return P_RE, eq. (17), of differences (M - 1, 6) of relative poses by edge, in O(M).

    The differences are Q eps(g*): residuals of aligned poses, re-linearised, from `stepwise`. With
    e of eq. (16) the result is P_RE to the letter.
    """
    try:
        factor = Factor.of(*relative_covariance(transports(belief.poses), belief.covariances))
    except np.linalg.LinAlgError as error:
        raise DegenerateGeometryError(
            "the covariance of the groundtruth's relative poses is singular; set noise greater "
            "than zero in all six directions"
        ) from error
    whitened = factor.whitened(differences)
    edges = -0.5 * np.sum(whitened**2, axis=1) - factor.log_diagonal.sum(axis=1)
    return RelativeErrorDensity(edges - 3.0 * LOG_2_PI, whitened)
