"""The generalised relative error: eq. (10), (14), (15) and (17) of the probabilistic paper.

Read literally, parts of second order add up along the way: at 1 deg and a thousand poses it is off
by a thousand nats. Residuals about the alignment's mode, taken apart by edge, are not.

The paper transports a perturbation from one pose to the next by Ad(T_{i,i+1}), in eq. (12) to
(14). What moves Exp(-xi_i) past T_{i,i+1} is the adjoint of the inverse step, Ad(T_{i+1,i}); with
the paper's own, the identity (29) of both errors fails.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.continuous_time.samples import Belief
from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.geometry import se3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.block_tridiagonal import Factor

LOG_2_PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, eq=False)
class RelativeErrorDensity:
    """Log densities of M - 1 relative poses, edge by edge.

    Attributes:
        edges: (M - 1,), log p(e_i | e_1 ... e_{i-1}), nats; they add up to eq. (17).
        whitened: (M - 1, 6), each edge's surprise given those before it, of unit variance.
    """

    edges: Floats
    whitened: Floats

    @property
    def log_likelihood(self) -> float:
        """Logarithm of P_RE, eq. (17), nats."""
        return float(self.edges.sum())


def relative_poses(poses: Floats) -> Floats:
    """Return T_i^-1 T_{i+1} (M - 1, 4, 4): eq. (10) of groundtruth, eq. (11) of an estimate."""
    steps: Floats = se3.inverse(poses[:-1]) @ poses[1:]
    return steps


def transports(poses: Floats) -> Floats:
    """Return B_i = Ad(T_{i+1}^-1 T_i), (M - 1, 6, 6), of groundtruth poses (M, 4, 4)."""
    return se3.adjoint(se3.inverse(relative_poses(poses)))


def stepwise(carriers: Floats, perturbations: Floats) -> Floats:
    """Return Q xi, xi_{i+1} - B_i xi_i, (M - 1, 6): eq. (14), the first order of eq. (13).

    Args:
        carriers: B_i, (M - 1, 6, 6), as `transports` has them.
        perturbations: (M, 6), or residuals.
    """
    steps: Floats = perturbations[1:] - se3.times(carriers, perturbations[:-1])
    return steps


def relative_covariance(carriers: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    """Return the blocks of V_r = Q V Q^T, eq. (15).

    Args:
        carriers: B_i, (M - 1, 6, 6), as `transports` has them.
        covariances: (M, 6, 6), of the poses.

    Returns:
        Blocks (M - 1, 6, 6) on its diagonal and (M - 2, 6, 6) below: neighbours share a pose.
    """
    diagonal = se3.congruent(carriers, covariances[:-1]) + covariances[1:]
    return diagonal, -carriers[1:] @ covariances[1:-1]


def decomposed(belief: Belief, differences: Floats) -> RelativeErrorDensity:
    """Return P_RE, eq. (17), of differences (M - 1, 6) of relative poses, edge by edge, in O(M).

    Args:
        belief: M groundtruth poses.
        differences: Q eps(g*): residuals of aligned poses, re-linearised, as `stepwise` has
            them. With e of eq. (16) it is P_RE to the letter.

    Raises:
        DegenerateGeometryError: Covariances that are not positive definite.
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
