"""Covariances about the body's axes and about the world's, one made of the other.

The package's covariances, and those of `geometry_msgs/PoseWithCovariance`, are of p + dp and
Exp(dphi) R: position first, rotation second, both about the world's fixed axes. Two others occur:

* of body twists, T Exp(xi), eq. (1) of the probabilistic paper: both about the body's axes;
* of p + dp and R Exp(dtheta), as OpenVINS publishes: only the rotation is about the body's axes.

All are turned by R, the body's attitude in the world: exact for small perturbations.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse

from trajeval_ros.geometry import se3
from trajeval_ros.geometry.arrays import Floats


def world_from_body_twists(covariances: Floats, rotations: Floats) -> Floats:
    """Return covariances (N, 6, 6) about the world's axes, of those of body twists.

    Args:
        covariances: (N, 6, 6), translation first, of T Exp(xi).
        rotations: (N, 3, 3), body to world.
    """
    turn = np.zeros((*rotations.shape[:-2], 6, 6))
    turn[..., :3, :3] = turn[..., 3:, 3:] = rotations
    return se3.congruent(turn, covariances)


def body_from_world_positions(covariances: Floats, rotations: Floats) -> Floats:
    """Return position covariances (N, 3, 3) about the body's axes, of those about the world's.

    Args:
        covariances: (N, 3, 3).
        rotations: (N, 3, 3), body to world.
    """
    return se3.congruent(se3.transposed(rotations), covariances)


def world_from_body_rotations(covariances: Floats, rotations: Floats) -> Floats:
    """Return covariances (N, 6, 6) about the world's axes, where only rotations are the body's.

    Args:
        covariances: (N, 6, 6), position first, of p + dp and R Exp(dtheta).
        rotations: (N, 3, 3), body to world.
    """
    turned = covariances.copy()
    turned[:, 3:] = rotations @ covariances[:, 3:]
    result: Floats = turned.copy()
    result[:, :, 3:] = turned[:, :, 3:] @ np.swapaxes(rotations, 1, 2)
    return result


def world_from_body_rotations_jointly(
    covariance: Floats | None,
    information: scipy.sparse.csr_matrix | None,
    rotations: Floats,
    block: int,
) -> tuple[Floats | None, scipy.sparse.csr_matrix | None]:
    """Do the same to the joint covariance or information matrix of all N states.

    Args:
        covariance: (N d, N d), or None; one of another shape is returned as it is.
        information: (N d, N d), or None.
        rotations: (N, 3, 3), body to world.
        block: d, with the rotation as the second three.
    """
    blocks = np.tile(np.eye(block), (len(rotations), 1, 1))
    blocks[:, 3:6, 3:6] = rotations
    turn = scipy.sparse.block_diag(blocks, format="csr")
    # Turns are orthogonal, so covariance and information turn alike.
    if covariance is not None and covariance.shape == turn.shape:
        covariance = np.asarray((turn @ (turn @ covariance).T).T)
    if information is not None:
        information = (turn @ information @ turn.T).tocsr()
    return covariance, information
