"""The S-transformation: a joint covariance in the gauge of the evaluator's alignment.

An alignment by the group G with tangent U fulfils conditions with gradients V. To first order, the
errors of the aligned states are e = Q (T d - n). Here Q = I - U (V'U)^-1 V', d are the estimator's
errors in any gauge within G, T is the rotation by the alignment, and n are the groundtruth's
errors. Therefore Cov(e) = Q (T Sigma T' + Sigma_gt) Q': eq. (12) and (14) of the gauge paper for
any alignment.

`nav_msgs/Odometry` has no covariances between poses. They are sufficient in the gauge of the
estimator's first pose; in every other gauge only a bound is possible.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from trajeval_ros.exceptions import DegenerateGeometryError, InputError
from trajeval_ros.geometry import lie, so3
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.gauge import (
    POSE_DOF,
    Gauge,
    Similarity,
    first_state_normals,
    least_squares_normals,
    orbit_basis,
)
from trajeval_ros.geometry.trajectory import Trajectory

# Condition number of the scaled V'U above which the states do not determine the alignment.
_WORST_CONDITION = 1e8


@dataclass(frozen=True, eq=False)
class STransformation:
    """Transforms perturbations of N aligned poses to the alignment's gauge."""

    gauge: Gauge  # gauge of the alignment
    orbit: Floats  # U (N, 6, k), derivatives of the aligned states by the gauge
    normals: Floats  # V (N, 6, k), gradients of the conditions of the alignment

    @classmethod
    def of_alignment(
        cls, gauge: Gauge, align_states: int | None, groundtruth: Trajectory, aligned: Trajectory
    ) -> STransformation:
        """Return the transformation for an alignment of `pair_alignment` by the first states.

        `align_states` is their number, 1 for eq. (19) and (20), None for all N.
        """
        _require_orientations(groundtruth, aligned)
        weights = np.zeros(len(aligned))
        weights[:align_states] = 1.0 / len(weights[:align_states])
        # Rotations about the centre of the aligned states span the same space together with the
        # translations, and avoid cancellation at large coordinates.
        centred = aligned.positions - weights @ aligned.positions
        orbit = orbit_basis(gauge, centred)
        if align_states == 1 and gauge is not Gauge.NONE:
            rotation = _turns_between(groundtruth[:1], aligned[:1])[0]
            normals = first_state_normals(gauge, len(aligned), rotation)
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

    def blocks(self, diagonal: Floats, image: Floats) -> Floats:
        """Return the states' own blocks (N, 6, 6) of Q C Q'.

        `diagonal` are their blocks (N, 6, 6) or (6, 6) of C, and `image` is X C (N, k, 6) with the
        coefficients X.
        """
        orbit = self.orbit
        shared = np.einsum("nki,nli->kl", image, self.pull)
        cross = orbit @ image
        blocks: Floats = diagonal - cross - np.swapaxes(cross, 1, 2)
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

    It is of left perturbations in the estimate's frame. The alignment's scale acts on positions.
    """
    rotation = turning(similarity, POSE_DOF)
    if covariance.ndim == 3:
        return np.asarray(rotation @ covariance @ rotation.T)
    size = len(covariance)
    rows = (rotation @ covariance.reshape(-1, POSE_DOF, size)).reshape(size, size)
    return np.asarray((rotation @ rows.T.reshape(-1, POSE_DOF, size)).reshape(size, size).T)


def turning(similarity: Similarity, block: int) -> Floats:
    """Return T (d, d), the transformation of a left perturbation of a state.

    d is 6 for position and rotation, 9 with velocity. The scale acts on position and velocity.
    """
    scales = np.array([similarity.scale, 1.0, similarity.scale])[: block // 3]
    return np.asarray(np.kron(np.diag(scales), similarity.rotation))


def carried_information(
    information: scipy.sparse.csr_matrix, similarity: Similarity, block: int
) -> scipy.sparse.csr_matrix:
    """Return T^-T Lambda T^-1 (n, n): an information matrix rotated with its states."""
    rotation = np.linalg.inv(turning(similarity, block)).T
    count = information.shape[0] // block
    blocks = scipy.sparse.kron(scipy.sparse.eye(count), rotation, format="csr")
    return (blocks @ information @ blocks.T).tocsr()


def independent_noise(transformation: STransformation, noise: Floats) -> Floats:
    """Return the states' own blocks (N, 6, 6) of Q G Q' for independent noise of the states.

    The blocks (N, 6, 6) of G are of position (m^2) and rotation (rad^2).
    """
    return transformation.blocks(noise, transformation.pull @ noise)


def errors_of(groundtruth: Trajectory, aligned: Trajectory) -> Floats:
    """Return the errors (N, 6) of aligned states: p' - p, Log(R' R^T)."""
    _require_orientations(groundtruth, aligned)
    shifts = aligned.positions - groundtruth.positions
    return np.concatenate([shifts, _turns_between(groundtruth, aligned)], axis=1)


def _turns_between(groundtruth: Trajectory, aligned: Trajectory) -> Floats:
    """Return the rotation vectors Log(R' R^T), (N, 3)."""
    reference, other = groundtruth.quaternions, aligned.quaternions
    assert reference is not None
    assert other is not None
    return so3.log(lie.to_matrix(other) @ np.swapaxes(lie.to_matrix(reference), 1, 2))


def _require_orientations(groundtruth: Trajectory, aligned: Trajectory) -> None:
    """Refuse states without orientations."""
    for who, side in (("groundtruth", groundtruth), ("estimate", aligned)):
        if side.quaternions is None:
            raise InputError(
                f"the {who} has no orientations, which the test of pose covariances needs"
            )


IN_PLANE = np.array([0, 1, 5])  # x, y and yaw
# Drivers set at least this variance, m^2, for unknown.
_SENTINEL = 1e6
# Rounding of covariances with seven digits.
_ASYMMETRY, _NEGATIVE = 1e-6, 1e-9


def observed_axes(covariances: Floats) -> NDArray[np.int64]:
    """Return the coordinates that covariances (N, 6, 6) are of: all six, or x, y and yaw.

    Estimators in a plane set the other variances to zero or to a sentinel in all messages.
    """
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    unset = (variances == 0.0) | (variances >= _SENTINEL)
    in_plane = unset[:, 2:5].all() and not unset[1:, IN_PLANE].any()
    return IN_PLANE if in_plane else np.arange(POSE_DOF)


def unknown_covariances(covariances: Floats) -> str:
    """Return why covariances (N, d, d) are unknown or invalid; empty if they are valid.

    Zeros, negative variances and sentinels mean "unknown". Only the first pose can have zeros, in
    the gauge of the first pose.
    """
    if not np.isfinite(covariances).all():
        return "some are not finite"
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    if (variances < 0.0).any():
        return "a variance is negative, which means unknown"
    if (variances >= _SENTINEL).any():
        return f"a variance is {variances.max():.3g}, which means unknown"
    has_values = np.abs(covariances[1:]).max(axis=(1, 2)) > 0.0
    if not has_values.any():
        return "all are zero, which means unknown"
    if not has_values.all():
        return "some are all zero, which means unknown"
    if not (variances[1:] > 0.0).all():
        return "some variances are zero"
    if not is_covariance(covariances[1:]).all():
        return "some are not symmetric, or have negative eigenvalues"
    return ""


def is_covariance(covariances: Floats) -> Booleans:
    """Return which matrices (N, d, d) are symmetric and positive semi-definite, up to rounding."""
    units = np.sqrt(np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0.0))
    units = np.where(units > 0.0, units, 1.0)
    scaled = covariances / units[:, :, None] / units[:, None, :]
    transposed = np.swapaxes(scaled, 1, 2)
    symmetric = np.abs(scaled - transposed).max(axis=(1, 2)) < _ASYMMETRY
    smallest = np.linalg.eigvalsh((scaled + transposed) / 2.0)[:, 0]
    good: Booleans = symmetric & (smallest > -_NEGATIVE)
    return good


def initial_uncertainty(covariances: Floats, transformation: STransformation) -> Floats:
    """Return the covariance (k, k) of the first pose along the gauge's directions."""
    gradient = transformation.coefficients[:, :6]
    uncertainty: Floats = gradient @ covariances[0] @ gradient.T
    return uncertainty


def without_initial_prior(covariances: Floats, transformation: STransformation) -> Floats:
    """Remove a prior on the first pose's position and yaw from the covariances of all poses.

    Such a prior adds U P U' to the covariance in the gauge of the first pose, so that it can be
    subtracted from marginals (measured to 4e-10). The prior must be independent of everything else
    and of the first pose. This does not hold for a filter that has moved before. The covariances
    (N, 6, 6) include that of the estimator's first pose, by whose state the poses are aligned.
    """
    prior = initial_uncertainty(covariances, transformation)
    orbit = transformation.orbit[:, :6]
    stripped: Floats = covariances - orbit @ prior @ np.swapaxes(orbit, 1, 2)
    stripped = (stripped + np.swapaxes(stripped, 1, 2)) / 2.0
    if not is_covariance(stripped[1:]).all():
        raise InputError(
            "the covariance of the first pose is not only a prior of position and yaw: its "
            "removal gives a later pose a negative variance"
        )
    return stripped


def upper_bounds(covariances: Floats, transformation: STransformation) -> Floats:
    """Return upper bounds (N, 6, 6) of the covariances of aligned poses for any correlation.

    Covariance intersection: Cov(a + b) <= Cov(a) / w + Cov(b) / (1 - w) for any w. The error of an
    aligned pose is its own error minus the effect of the alignment, which is a sum over all poses.
    NEES with these bounds is a lower bound in expectation. It can detect overconfidence, but
    cannot confirm consistency.
    """
    count, _, open_ = transformation.orbit.shape
    orbit = transformation.orbit[:, :6]
    if not open_:
        return covariances
    pull = transformation.pull
    shares = pull @ covariances @ np.swapaxes(pull, 1, 2)
    # The size of a contribution is the squared motion of the poses that it causes.
    metric = np.einsum("nik,nil->kl", orbit[:, :3], orbit[:, :3]) / count
    sizes = np.sqrt(np.maximum(np.einsum("nkl,lk->n", shares, metric), 0.0))
    total = sizes.sum()
    present = sizes > 0.0
    of_alignment = np.einsum("nkl,n->kl", shares[present], total / sizes[present])
    moved = orbit @ of_alignment @ np.swapaxes(orbit, 1, 2)
    # Any weight is valid. This one compares both terms by coordinate, so that a pose with an exact
    # position keeps its uncertain tilt.
    fixed, others = (np.diagonal(blocks, axis1=1, axis2=2) for blocks in (covariances, moved))
    both = np.maximum(fixed + others, np.finfo(float).tiny)
    fixed, others = (np.sqrt((np.maximum(v, 0.0) / both).sum(axis=1)) for v in (fixed, others))
    weight = np.divide(fixed, fixed + others, out=np.ones(count), where=fixed + others > 0.0)
    weight = weight[:, None, None]
    # If one term is zero, the other has all the weight.
    bound: Floats = np.divide(covariances, weight, out=np.zeros_like(moved), where=weight > 0.0)
    bound += np.divide(moved, 1.0 - weight, out=np.zeros_like(moved), where=weight < 1.0)
    return bound
