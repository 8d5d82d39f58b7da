"""The S-transformation: a joint covariance in the gauge of the evaluator's alignment.

An alignment by the group G with tangent U fulfils conditions with gradients V. To first order, the
errors of the aligned states are e = Q (T d - n). Here Q = I - U (V'U)^-1 V', d are the estimator's
errors in any gauge within G, T is the rotation by the alignment, and n are the groundtruth's
errors. Therefore Cov(e) = Q (T Sigma T' + Sigma_gt) Q': eq. (12) and (14) of the gauge paper for
any alignment.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse

from trajeval_ros.exceptions import DegenerateGeometryError, InputError
from trajeval_ros.geometry import lie, so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import (
    POSE_DOF,
    Gauge,
    first_state_normals,
    least_squares_normals,
    orbit_basis,
)
from trajeval_ros.geometry.similarity import Similarity
from trajeval_ros.geometry.trajectory import Trajectory

# Condition number of the scaled V'U above which the states do not determine the alignment.
_WORST_CONDITION = 1e8


@dataclass(frozen=True, eq=False)
class STransformation:
    """Transforms perturbations of N aligned poses to the alignment's gauge.

    Attributes:
        gauge: Gauge of the alignment.
        orbit: U (N, 6, k), derivatives of the aligned states by the gauge.
        normals: V (N, 6, k), gradients of the conditions of the alignment.
    """

    gauge: Gauge
    orbit: Floats
    normals: Floats

    @classmethod
    def of_alignment(
        cls,
        gauge: Gauge,
        align_states: int | None,
        groundtruth: Trajectory,
        aligned: Trajectory,
    ) -> STransformation:
        """Return the transformation for an alignment of `pair_alignment`.

        Args:
            gauge: Gauge of the alignment.
            align_states: Number of first states, 1 for eq. (19) and (20); None for all.
            groundtruth: N states.
            aligned: N states, paired and aligned with them.

        Raises:
            InputError: States without orientations.
            SettingsError: The gauge has no transformation of covariances.
            DegenerateGeometryError: The states do not determine the alignment.
        """
        _require_orientations(groundtruth, aligned)
        weights = np.zeros(len(aligned))
        weights[:align_states] = 1.0 / len(weights[:align_states])
        # Rotations about the centre of the aligned states span the same space together with the
        # translations, and avoid cancellation at large coordinates.
        centred = aligned.positions - weights @ aligned.positions
        orbit = orbit_basis(gauge, centred)
        if align_states == 1 and gauge is not Gauge.NONE:
            turn = _turns_between(groundtruth[:1], aligned[:1])[0]
            normals = first_state_normals(gauge, len(aligned), turn)
        else:
            normals = least_squares_normals(
                gauge, groundtruth.positions, aligned.positions, weights
            )
        transformation = cls(gauge, orbit, normals)
        transformation._require_transversal()
        return transformation

    @property
    def coefficients(self) -> Floats:
        """X = (V'U)^-1 V' (k, 6N): coordinates of a perturbation along the gauge."""
        orbit, normals = self._flat()
        return np.asarray(np.linalg.solve(normals.T @ orbit, normals.T))

    def covariance(self, covariance: Floats) -> Floats:
        """Return Q C Q' for a covariance (6N, 6N) of perturbations of the aligned states."""
        orbit, _ = self._flat()
        coefficients = self.coefficients
        image = coefficients @ covariance
        cross = orbit @ image
        projected: Floats = covariance - cross - cross.T
        projected = projected + orbit @ (image @ coefficients.T) @ orbit.T
        symmetric: Floats = (projected + projected.T) / 2.0
        return symmetric

    @property
    def pull(self) -> Floats:
        """The coefficients by state, (N, k, 6)."""
        count, _, open_ = self.orbit.shape
        return self.coefficients.reshape(open_, count, POSE_DOF).swapaxes(0, 1)

    def blocks(self, own: Floats, image: Floats) -> Floats:
        """Return the states' own blocks (N, 6, 6) of Q C Q'.

        Args:
            own: (N, 6, 6) or (6, 6), the states' own blocks of C.
            image: X C (N, k, 6), X the coefficients.
        """
        orbit = self.orbit
        shared = np.einsum("nki,nli->kl", image, self.pull)
        cross = orbit @ image
        blocks: Floats = own - cross - np.swapaxes(cross, 1, 2)
        blocks += orbit @ shared @ np.swapaxes(orbit, 1, 2)
        return blocks

    @property
    def dof(self) -> int:
        """Rank of a covariance in this gauge: 6N minus the gauge's dimension."""
        count, _, open_ = self.orbit.shape
        return int(count * POSE_DOF - open_)

    def _flat(self) -> tuple[Floats, Floats]:
        """Return U and V as matrices (6N, k)."""
        count, _, open_ = self.orbit.shape
        shape = (count * POSE_DOF, open_)
        return self.orbit.reshape(shape), self.normals.reshape(shape)

    def _require_transversal(self) -> None:
        """Refuse states that do not determine the alignment."""
        orbit, normals = self._flat()
        product = normals.T @ orbit
        if not product.size:
            return
        scale = np.sqrt(np.abs(np.diagonal(product)))
        open_ = not (scale > 0.0).all()
        if open_ or np.linalg.cond(product / scale / scale[:, None]) > _WORST_CONDITION:
            raise DegenerateGeometryError(
                f"the aligned states do not determine gauge {self.gauge.value}, so its "
                "covariance is undefined; align by more states, or use a gauge with fewer "
                "degrees of freedom"
            )


def carried(covariance: Floats, similarity: Similarity) -> Floats:
    """Return T Sigma T' (6N, 6N), or (N, 6, 6) by pose: a covariance rotated with its poses.

    Args:
        covariance: (6N, 6N) or (N, 6, 6), of left perturbations in the estimate's frame.
        similarity: The alignment; its scale acts on positions.
    """
    turn = turning(similarity, POSE_DOF)
    if covariance.ndim == 3:
        return np.asarray(turn @ covariance @ turn.T)
    size = len(covariance)
    rows = (turn @ covariance.reshape(-1, POSE_DOF, size)).reshape(size, size)
    return np.asarray((turn @ rows.T.reshape(-1, POSE_DOF, size)).reshape(size, size).T)


def turning(similarity: Similarity, block: int) -> Floats:
    """Return T (d, d), the transformation of a left perturbation of a state.

    Args:
        similarity: The alignment; its scale acts on position and velocity.
        block: d: 6 for position and rotation, 9 with velocity.
    """
    scales = np.array([similarity.scale, 1.0, similarity.scale])[: block // 3]
    return np.asarray(np.kron(np.diag(scales), similarity.rotation))


def carried_information(
    information: scipy.sparse.csr_matrix, similarity: Similarity, block: int
) -> scipy.sparse.csr_matrix:
    """Return T^-T Lambda T^-1 (n, n): an information matrix rotated with its states."""
    turn = np.linalg.inv(turning(similarity, block)).T
    count = information.shape[0] // block
    blocks = scipy.sparse.kron(scipy.sparse.eye(count), turn, format="csr")
    return (blocks @ information @ blocks.T).tocsr()


def independent_noise(transformation: STransformation, noise: Floats) -> Floats:
    """Return the states' own blocks (N, 6, 6) of Q G Q' for independent noise of the states.

    Args:
        transformation: Q, of N states.
        noise: (N, 6, 6), the blocks of G, of position (m^2) and rotation (rad^2).
    """
    return transformation.blocks(noise, transformation.pull @ noise)


def errors_of(groundtruth: Trajectory, aligned: Trajectory) -> Floats:
    """Return the errors (N, 6) of aligned states: p' - p, Log(R' R^T).

    Raises:
        InputError: States without orientations.
    """
    _require_orientations(groundtruth, aligned)
    shifts = aligned.positions - groundtruth.positions
    return np.concatenate([shifts, _turns_between(groundtruth, aligned)], axis=1)


def _turns_between(groundtruth: Trajectory, aligned: Trajectory) -> Floats:
    """Return the rotation vectors Log(R' R^T), (N, 3)."""
    truth, other = groundtruth.quaternions, aligned.quaternions
    assert truth is not None
    assert other is not None
    return so3.log(lie.to_matrix(other) @ np.swapaxes(lie.to_matrix(truth), 1, 2))


def _require_orientations(groundtruth: Trajectory, aligned: Trajectory) -> None:
    """Refuse states without orientations."""
    for who, side in (("groundtruth", groundtruth), ("estimate", aligned)):
        if side.quaternions is None:
            raise InputError(
                f"the {who} has no orientations, which the test of pose covariances needs"
            )
