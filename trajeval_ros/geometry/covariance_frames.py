"""Conversion of covariances between the axes of the body and of the world.

The package's covariances and those of `geometry_msgs/PoseWithCovariance` are of p + dp and
Exp(dphi) R: position first, rotation second, both about the world's fixed axes. Two other
conventions occur:

* body twists, T Exp(xi), eq. (1) of the probabilistic paper: both about the body's axes;
* p + dp and R Exp(dtheta), as OpenVINS publishes: only the rotation is about the body's axes.

The conversion is a rotation by the body's attitude R, exact for small perturbations.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse

from trajeval_ros.geometry import se3
from trajeval_ros.geometry.arrays import Floats


def world_from_body_twists(covariances: Floats, rotations: Floats) -> Floats:
    """Return covariances (N, 6, 6) about the world's axes from those of body twists T Exp(xi).

    Rotations (N, 3, 3) are from body to world.
    """
    rotation = np.zeros((*rotations.shape[:-2], 6, 6))
    rotation[..., :3, :3] = rotation[..., 3:, 3:] = rotations
    return se3.congruent(rotation, covariances)


def body_from_world_positions(covariances: Floats, rotations: Floats) -> Floats:
    """Return position covariances (N, 3, 3) about the body's axes from those about the world's.

    Rotations (N, 3, 3) are from body to world.
    """
    return se3.congruent(se3.transposed(rotations), covariances)


def world_from_body_rotations(covariances: Floats, rotations: Floats) -> Floats:
    """Return covariances (N, 6, 6) of p + dp and R Exp(dtheta) about the world's axes.

    Only the rotation is converted; rotations (N, 3, 3) are from body to world.
    """
    rotated = covariances.copy()
    rotated[:, 3:] = rotations @ covariances[:, 3:]
    result: Floats = rotated.copy()
    result[:, :, 3:] = rotated[:, :, 3:] @ np.swapaxes(rotations, 1, 2)
    return result


def world_from_body_rotations_jointly(
    covariance: Floats | None,
    information: scipy.sparse.csr_matrix | None,
    rotations: Floats,
    block: int,
) -> tuple[Floats | None, scipy.sparse.csr_matrix | None]:
    """Convert the joint covariance or information matrix of all N states likewise.

    `covariance`: (N d, N d), or None; a matrix of another shape is returned unchanged.
    `information`: (N d, N d), or None. `rotations`: (N, 3, 3), body to world. `block`: d, the
    parameters of a state; numbers 3 to 5 are the rotation.
    """
    blocks = np.tile(np.eye(block), (len(rotations), 1, 1))
    blocks[:, 3:6, 3:6] = rotations
    rotation = scipy.sparse.block_diag(blocks, format="csr")
    # The conversion is orthogonal, so that both matrices transform alike.
    if covariance is not None and covariance.shape == rotation.shape:
        covariance = np.asarray((rotation @ (rotation @ covariance).T).T)
    if information is not None:
        information = (rotation @ information @ rotation.T).tocsr()
    return covariance, information
