"""Conversion of trajectories between a body and a marker on it: T_G_B = T_G_M T_B_M^-1."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import note
from trajeval_ros.geometry import lie, so3
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import Trajectory

_NUMBERS = 7  # of a pose as text
_UNIT = 0.01  # tolerance of a quaternion's length, for rounded digits
# Remarks on a trajectory after a conversion by a lever arm.
MARKERS_VELOCITIES = note(
    "column_dropped", "velocities dropped: they are of the marker, not of the body"
)
BODYS_VELOCITIES = note(
    "column_dropped", "velocities dropped: they are of the body, not of the marker"
)


@dataclass(frozen=True, eq=False)
class HandEye:
    """T_B_M: pose of the groundtruth's marker in the estimate's body.

    Attributes:
        rotation_xyzw: (4,), rotation from the marker's axes to the body's.
        lever_m: (3,), position of the marker's origin in the body, metres.
        body: Name of the body's frame, "" if unknown.
        marker: Name of the marker's frame, "" if unknown.

    Example:
        >>> import numpy as np
        >>> from trajeval_ros import HandEye
        >>> HandEye(np.array([0.0, 0.0, 0.0, 1.0]), np.array([0.1, 0.0, 0.2])).inverse().lever_m
        array([-0.1, -0. , -0.2])
    """

    rotation_xyzw: Floats
    lever_m: Floats
    body: str = ""
    marker: str = ""

    @classmethod
    def of(cls, rotation_vector: Floats | None, lever_m: Floats | None) -> HandEye:
        """Return the pose of a rotation vector (3,), rad, and a lever arm (3,); None is zero."""
        vector = np.zeros(3) if rotation_vector is None else rotation_vector
        lever = np.zeros(3) if lever_m is None else lever_m
        return cls(lie.from_rotation_vector(vector), lever)

    @classmethod
    def from_text(cls, text: str) -> HandEye | None:
        """Return the pose of a text X,Y,Z,QX,QY,QZ,QW (metres, quaternion); None for other texts.

        Raises:
            InputError: The quaternion is not of length 1.
        """
        try:
            numbers = np.array([float(part) for part in text.split(",")])
        except ValueError:
            return None
        if len(numbers) != _NUMBERS:
            return None
        length = float(np.linalg.norm(numbers[3:]))
        if not (abs(length - 1.0) < _UNIT and np.isfinite(numbers).all()):
            raise InputError(
                f"the quaternion of the pose {text} has length {length:.3g}; give "
                "X,Y,Z,QX,QY,QZ,QW with a quaternion of length 1"
            )
        return cls(numbers[3:] / length, numbers[:3])

    def after(self, first: HandEye) -> HandEye:
        """Return this pose of a body in another one, composed with a pose in that body."""
        lever = self.lever_m + lie.rotate(self.rotation_xyzw, first.lever_m)
        rotation = lie.multiply(self.rotation_xyzw, first.rotation_xyzw)
        return HandEye(rotation, lever, self.body or first.body, first.marker)

    def names(self, groundtruth: str, estimate: str, *, of_marker: bool) -> tuple[str, str]:
        """Return the names of both bodies after the conversion of one side.

        Args:
            groundtruth: The groundtruth's body.
            estimate: The estimate's body.
            of_marker: Whether the estimate is converted to the marker; otherwise the groundtruth
                is converted to the body.
        """
        if of_marker:
            return groundtruth, self.marker or groundtruth
        return self.body or estimate, estimate

    def inverse(self) -> HandEye:
        """Return the pose of the body in the marker's frame."""
        back = lie.conjugate(self.rotation_xyzw)
        return HandEye(back, -lie.rotate(back, self.lever_m), self.marker, self.body)

    def require_frames(self, groundtruth: Trajectory, estimate: Trajectory) -> None:
        """Refuse a pose that is the inverse of the one needed, according to the frames' names.

        Raises:
            InputError: The names show that it is inverted.
        """
        named = self.body and self.body == groundtruth.child_frame
        if named and self.marker == estimate.child_frame and self.body != self.marker:
            raise InputError(
                f"the hand-eye transform of {self.marker!r} in {self.body!r} is inverted, since "
                f"the groundtruth is of {self.body!r}; give its inverse, with frame_id "
                f"{self.marker} and child_frame_id {self.body}"
            )

    def of_body(self, groundtruth: Trajectory, body: str = "") -> Trajectory:
        """Return the groundtruth of the body from poses of the marker.

        Velocities are of the marker and are dropped if there is a lever arm. Biases are rotated to
        the body's axes.

        Args:
            groundtruth: Poses with orientations.
            body: Name of the body's frame.
        """
        marker = groundtruth.quaternions
        assert marker is not None
        quaternions = lie.multiply(marker, lie.conjugate(self.rotation_xyzw))
        arm = lie.rotate(quaternions, self.lever_m)
        velocities, reading = groundtruth.velocities, groundtruth.reading.without("matrices")
        if velocities is not None and self.lever_m.any():
            velocities = None
            reading = reading.remarked(MARKERS_VELOCITIES)
        return dataclasses.replace(
            groundtruth,
            positions=groundtruth.positions - arm,
            quaternions=lie.normalized(quaternions),
            velocities=velocities,
            covariances=None,
            child_frame=body or groundtruth.child_frame,
            reading=reading,
            gyroscope_biases=self._rotated(groundtruth.gyroscope_biases),
            accelerometer_biases=self._rotated(groundtruth.accelerometer_biases),
        )

    def _rotated(self, vectors: Floats | None) -> Floats | None:
        return None if vectors is None else lie.rotate(self.rotation_xyzw, vectors)

    def of_marker(self, estimate: Trajectory, scale: float, marker: str = "") -> Trajectory:
        """Return the estimate of the marker's position, for groundtruth without orientations.

        Args:
            estimate: Poses of the body, with orientations.
            scale: Groundtruth metres per unit of the estimate.
            marker: Name of the marker's frame.

        Raises:
            InputError: The estimate has no orientations.
        """
        quaternions = estimate.quaternions
        if quaternions is None:
            raise InputError(
                f"{estimate.name or 'the estimate'} has no orientations, which a lever arm needs"
            )
        arm = lie.rotate(quaternions, self.lever_m / scale)
        velocities, reading = estimate.velocities, estimate.reading
        if velocities is not None and self.lever_m.any():
            velocities = None
            reading = reading.remarked(BODYS_VELOCITIES)
        covariances = estimate.covariances
        if covariances is not None:
            covariances = at_arms(covariances, arm)
        return dataclasses.replace(
            estimate,
            positions=estimate.positions + arm,
            velocities=velocities,
            covariances=covariances,
            child_frame=marker or estimate.child_frame,
            reading=reading,
        )


def at_arms(covariances: Floats, arms: Floats) -> Floats:
    """Return covariances (N, 6, 6) of poses whose positions are moved by arms fixed to the body.

    `covariances`: (N, 6, 6), of position and of left perturbations of the rotation. `arms`: (N,
    3), in the frame of the positions, metres.
    """
    # The perturbation of p + R l by R <- Exp(dphi) R: dp - [R l]x dphi.
    change = np.broadcast_to(np.eye(6), (len(arms), 6, 6)).copy()
    change[:, :3, 3:] = -so3.skew(arms)
    moved: Floats = change @ covariances @ change.swapaxes(1, 2)
    return moved
