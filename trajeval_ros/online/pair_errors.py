"""Errors of new pairs as vectors: eq. (23) of the tutorial in its plain form."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, lengths
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.metrics.absolute_errors import AbsoluteErrors
from trajeval_ros.metrics.premises import Doubts
from trajeval_ros.online.pairing import PairedStates


class PairErrors:
    """Errors of N pairs under the alignment at their arrival.

    Vectors are groundtruth minus aligned estimate, in the groundtruth's frame unless stated
    otherwise. A quantity that is not available or withheld is None. Quantities are computed on
    access.
    """

    def __init__(self, pairs: PairedStates, alignment: Similarity, doubts: Doubts) -> None:
        self._groundtruth, self._estimate = pairs.groundtruth, pairs.estimate
        self._alignment, self._up = alignment, pairs.groundtruth.up
        self._withheld = doubts.withheld(AbsoluteErrors).keys()
        self.stamps = pairs.stamps  # (N,) timestamps of the pairs, nanoseconds
        aligned = alignment.positions(pairs.estimate.positions)
        self.position: Floats = pairs.groundtruth.positions - aligned  # (N, 3), metres

    @cached_property
    def position_m(self) -> Floats:
        """Lengths of the position errors, (N,), metres."""
        return lengths(self.position)

    @cached_property
    def _between(self) -> Floats | None:
        """The rotation errors E = R R'^T, (N, 4)."""
        groundtruth, estimate = self._groundtruth.quaternions, self._estimate.quaternions
        if "rotation_deg" in self._withheld or groundtruth is None or estimate is None:
            return None
        aligned = self._alignment.quaternions(estimate)
        return lie.normalized(lie.multiply(groundtruth, lie.conjugate(aligned)))

    @cached_property
    def rotation_deg(self) -> Floats | None:
        """Angles of the rotation errors, (N,), degrees."""
        return None if self._between is None else np.degrees(lie.angle(self._between))

    @cached_property
    def yaw_deg(self) -> Floats | None:
        """Signed twists of the rotation errors about the up axis, (N,), degrees."""
        if self._between is None or "yaw_deg" in self._withheld:
            return None
        return np.degrees(lie.yaw(self._up.to_z_up(self._between)))

    @cached_property
    def tilt_deg(self) -> Floats | None:
        """Angles between the up axis and its image under the rotation errors, (N,), degrees."""
        if self._between is None or "tilt_deg" in self._withheld:
            return None
        return np.degrees(lie.tilt(self._up.to_z_up(self._between)))

    @property
    def rotation_vector_deg(self) -> Floats | None:
        """Rotation vectors of the rotation errors, (N, 3), degrees."""
        return None if self._between is None else np.degrees(lie.rotation_vector(self._between))

    @property
    def attitude_deg(self) -> Floats | None:
        """The rotation errors as a yaw followed by a tilt, (N, 3), degrees.

        The component along the up axis is `yaw_deg`. The components perpendicular to it are the
        rotation vector of the tilt, whose length is `tilt_deg`.
        """
        if self._between is None or self.yaw_deg is None or "tilt_deg" in self._withheld:
            return None
        level = self._up.to_z_up(self._between)
        tilted = lie.multiply(level, lie.conjugate(lie.heading(level)))
        vectors = np.degrees(lie.rotation_vector(tilted))
        vectors[:, 2] = self.yaw_deg
        rotated: Floats = vectors @ self._up.matrix
        return rotated

    @property
    def velocity(self) -> Floats | None:
        """Velocity errors, (N, 3), m/s; NaN where a side has none.

        A velocity of exactly zero is an unset field of a message.
        """
        groundtruth, estimate = self._groundtruth.velocities, self._estimate.velocities
        if "velocity_mps" in self._withheld or groundtruth is None or estimate is None:
            return None
        error = groundtruth - self._alignment.vectors(estimate)
        error[~(groundtruth.any(axis=1) & estimate.any(axis=1))] = np.nan
        return error if np.isfinite(error).any() else None

    @property
    def along_cross_vertical(self) -> Floats | None:
        """Position errors along the body's heading, to its left, and up, (N, 3), metres.

        The heading is the rotation about the up axis nearest to the groundtruth's attitude; x is
        forward (REP-103).
        """
        attitude = self._groundtruth.quaternions
        if attitude is None or "horizontal_m" in self._withheld:
            return None
        upright = lie.multiply(lie.from_matrices(self._up.matrix[None]), attitude)
        return lie.rotate(lie.conjugate(lie.heading(upright)), self._up.to_z_up(self.position))
