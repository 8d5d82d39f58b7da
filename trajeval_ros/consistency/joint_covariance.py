"""The joint covariance of all poses of a run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse

from trajeval_ros.exceptions import DegenerateGeometryError, InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.banded_matrices import BandedGaussian, bandwidth
from trajeval_ros.geometry.gauge import Gauge, orbit_basis
from trajeval_ros.geometry.trajectory import Trajectory

BLOCKS = {"p,phi": 6, "p,phi,v": 9}
# Largest differences between a pose of the file and of the trajectory.
_SAME_POSITION_M, _SAME_ROTATION_RAD = 1e-4, 1e-4
_ASYMMETRY = 1e-6
# Largest information along the gauge, relative to the diagonal.
_LEFT_IN_GAUGE = 1e-6
# Largest number of rows of a dense inverse; more take too long.
MOST_DENSE = 3000
# Largest bandwidth; the elimination of wider bands takes as long as a dense one.
_WIDEST_BAND = 1500


@dataclass(frozen=True, eq=False)
class JointCovariance:
    """Covariance or information of N poses, perturbed on the left in the estimate's frame.

    Attributes:
        stamps: (N,) int64, nanoseconds.
        positions: (N, 3), metres, of the estimate.
        quaternions: (N, 4), xyzw, of the estimate.
        block: d: 6 for position and rotation, 9 with velocity.
        covariance: (N d, N d), or None.
        information: (N d, N d), sparse, all other parameters eliminated, or None.
        gauge: `free` for an information matrix of rank N d - 4, without a prior on position and
            yaw; other values have no effect.

    Example:
        >>> import numpy as np
        >>> from trajeval_ros import JointCovariance
        >>> joint = JointCovariance(
        ...     stamps=np.array([0, 100_000_000]), positions=np.zeros((2, 3)),
        ...     quaternions=np.array([[0.0, 0.0, 0.0, 1.0]] * 2), block=6,
        ...     covariance=0.01 * np.eye(12))
        >>> joint.require_sound()
    """

    stamps: Indices
    positions: Floats
    quaternions: Floats
    block: int
    covariance: Floats | None = None
    information: scipy.sparse.csr_matrix | None = None
    gauge: str = "unknown"

    def require_sound(self) -> None:
        """Raise InputError if the matrix cannot be a covariance of these poses."""
        matrix = self.covariance if self.information is None else self.information
        what = "covariance" if self.information is None else "information matrix"
        if matrix is None:
            raise InputError(
                "the joint covariance file has neither a covariance nor an information matrix"
            )
        size = len(self.stamps) * self.block
        if matrix.shape != (size, size):
            raise InputError(
                f"the joint {what} is {matrix.shape[0]} x {matrix.shape[1]}; {size} x {size} is "
                f"expected for {counted(len(self.stamps), 'pose')} with blocks of {self.block}"
            )
        values = matrix if self.information is None else self.information.data
        if not np.isfinite(values).all():
            raise InputError(f"the joint {what} has entries that are not finite")
        difference, largest = abs(matrix - matrix.T).max(), abs(matrix).max()
        if not difference <= _ASYMMETRY * largest:
            raise InputError(
                f"the joint {what} is not symmetric: entries differ by up to {difference:.3g} "
                "from the transpose"
            )
        diagonal = matrix.diagonal()
        if (diagonal < 0.0).any() or largest == 0.0:
            raise InputError(
                f"the diagonal of the joint {what} is not positive, which means unknown"
            )
        if self.information is not None and self.gauge == "free":
            self._require_free_gauge()

    def rows_of(self, trajectory: Trajectory) -> Indices:
        """Return the rows (M,) of a trajectory's M poses, by timestamp.

        Raises:
            InputError: A pose of the trajectory is missing, or has another position or rotation.
        """
        order = np.argsort(self.stamps, kind="stable")
        place = np.searchsorted(self.stamps[order], trajectory.stamps)
        rows = order[np.minimum(place, len(order) - 1)]
        missing = np.flatnonzero(self.stamps[rows] != trajectory.stamps)
        if len(missing):
            raise InputError(
                f"the joint covariance has no pose at timestamp {trajectory.stamps[missing[0]]} "
                f"ns ({len(missing)} of {len(rows)} missing); check that it is from this "
                "estimate"
            )
        away = np.linalg.norm(self.positions[rows] - trajectory.positions, axis=1).max()
        quaternions = trajectory.quaternions
        assert quaternions is not None
        angle = lie.angle(lie.multiply(lie.conjugate(self.quaternions[rows]), quaternions)).max()
        if away > _SAME_POSITION_M or angle > _SAME_ROTATION_RAD:
            raise InputError(
                f"the poses of the joint covariance differ from the estimate by up to {away:.3g} "
                f"m and {np.degrees(angle):.3g} deg at equal timestamps; check that it is from "
                "this estimate"
            )
        return rows

    @property
    def is_dense(self) -> bool:
        """Whether a dense covariance is available, or can be computed in reasonable time."""
        return self.covariance is not None or len(self.stamps) * self.block <= MOST_DENSE

    def pose_covariance(self, rows: Indices) -> Floats:
        """Return the covariance (6M, 6M) of position and rotation of some poses, in some gauge.

        Raises:
            InputError: The information is singular beyond the gauge.
        """
        covariance = self._inverse() if self.covariance is None else self.covariance
        index = self.pose_rows(rows)
        selected: Floats = covariance[np.ix_(index, index)]
        return selected

    def pose_rows(self, rows: Indices) -> Indices:
        """Return the matrix rows (6M,) of position and rotation of some poses."""
        index: Indices = (rows[:, None] * self.block + np.arange(6)).ravel()
        return index

    def _inverse(self) -> Floats:
        """Return the dense inverse of the information, in some gauge."""
        assert self.information is not None
        try:
            factor = scipy.linalg.cho_factor(self._held().toarray(), lower=True)
        except np.linalg.LinAlgError:
            raise self._indefinite() from None
        inverse: Floats = scipy.linalg.cho_solve(factor, np.eye(len(factor[0])))
        return inverse

    def banded(self) -> BandedGaussian | None:
        """Return the factors of the information, in some gauge; None if it is not banded.

        Raises:
            InputError: The information is singular beyond the gauge.
        """
        assert self.information is not None
        if bandwidth(self.information) > _WIDEST_BAND:
            return None
        try:
            return BandedGaussian(self._held())
        except DegenerateGeometryError:
            raise self._indefinite() from None

    def _held(self) -> scipy.sparse.csr_matrix:
        """Return the information with a prior along a free gauge."""
        assert self.information is not None
        if self.gauge != "free":
            return self.information
        # Any prior on position and yaw of one pose will do, because the alignment removes it.
        held = [0, 1, 2, 5]
        prior = np.zeros(self.information.shape[0])
        prior[held] = self.information.diagonal()[held]
        return (self.information + scipy.sparse.diags(prior)).tocsr()

    def _indefinite(self) -> InputError:
        """Return the error for a matrix that is not positive definite."""
        return InputError(
            "the joint information matrix is not positive definite"
            + (" except for position and yaw" if self.gauge == "free" else "")
            + "; set gauge free if it has no prior, and use one connected run"
        )

    def _require_free_gauge(self) -> None:
        """Refuse an information matrix with gauge free that constrains translations."""
        assert self.information is not None
        shifts = orbit_basis(Gauge.YAW, np.zeros((len(self.stamps), 3)))[:, :3, 1:]
        padding = ((0, 0), (0, self.block - 3), (0, 0))
        moves = np.pad(shifts, padding).reshape(-1, 3)
        known = np.einsum("nk,nk->k", moves, self.information @ moves)
        scale = np.einsum("nk,n,nk->k", moves, self.information.diagonal(), moves)
        if (known > _LEFT_IN_GAUGE * scale).any():
            raise InputError(
                "the joint information matrix declares gauge free, but a translation of all "
                "poses is constrained by a prior; set gauge prior"
            )
