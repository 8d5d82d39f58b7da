"""Absolute errors of paired states: eq. (21) to (24) of the tutorial.

Groundtruth states are (p, R, v), estimated states (p', R', v'). The rotation error is E = R R'^T
in the groundtruth's frame. `plain` position errors are p - p'. Form `tutorial` is p - E p', eq.
(23), which depends on the origin of the frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, lengths
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.metrics.premises import Premise, relies_on

_ANGLE = (Premise.ORIENTATIONS, Premise.ALIGNMENT_ROTATION, Premise.BODY_ROTATION)


@dataclass(frozen=True, eq=False)
class AbsoluteErrors:
    """Errors of N aligned states; a quantity that is not available is None, never zeros."""

    position_m: Floats = relies_on(required=True)  # (N,), length of the position error
    # (N,), its component perpendicular to the groundtruth's up axis.
    horizontal_m: Floats | None = relies_on(Premise.UP_AXIS, Premise.DIRECTIONS)
    # (N,), its component along the up axis, absolute value.
    vertical_m: Floats | None = relies_on(Premise.HEIGHT, Premise.UP_AXIS, Premise.DIRECTIONS)
    rotation_deg: Floats | None = relies_on(*_ANGLE)  # (N,), angle of E
    # (N,), twist of E about the groundtruth's up axis, absolute value.
    yaw_deg: Floats | None = relies_on(*_ANGLE, Premise.UP_AXIS)
    # (N,), angle between the up axis and its image under E: roll and pitch.
    tilt_deg: Floats | None = relies_on(Premise.ROLL_AND_PITCH, *_ANGLE, Premise.UP_AXIS)
    # (N,), length of the velocity error.
    velocity_mps: Floats | None = relies_on(Premise.ALIGNMENT_ROTATION, Premise.BODY_ROTATION)
    # (N,), rad/s, length of the difference, in the body frame.
    gyroscope_bias: Floats | None = relies_on()
    # (N,), m/s^2, length of the difference, in the body frame.
    accelerometer_bias: Floats | None = relies_on()


def absolute_errors(
    groundtruth: Trajectory, aligned: Trajectory, form: str = "plain", *, rotation: bool = True
) -> AbsoluteErrors:
    """Return the errors of N aligned states paired with groundtruth, eq. (23).

    `form` is `plain` or `tutorial`, which needs orientations on both sides. `rotation=False`
    withholds all errors that depend on an undetermined rotation.
    """
    velocities = aligned.velocities if rotation else None
    groundtruth_q, aligned_q = groundtruth.quaternions, aligned.quaternions
    angle = yaw = tilt = None
    if groundtruth_q is not None and aligned_q is not None and rotation:
        angle, yaw, tilt = lie.by_blocks(
            lambda true, other: angle_yaw_tilt(rotation_errors(true, other), groundtruth.up),
            groundtruth_q,
            aligned_q,
        )
        if form == "tutorial" and velocities is not None:
            velocities = lie.rotate(rotation_errors(groundtruth_q, aligned_q), velocities)
    position, horizontal, vertical = lie.by_blocks(
        lambda errors: _parts(errors, groundtruth.up), position_errors(groundtruth, aligned, form)
    )
    return AbsoluteErrors(
        position_m=position,
        horizontal_m=horizontal,
        vertical_m=vertical,
        rotation_deg=angle,
        yaw_deg=yaw,
        tilt_deg=tilt,
        velocity_mps=_differences(groundtruth.velocities, velocities),
        gyroscope_bias=_differences(groundtruth.gyroscope_biases, aligned.gyroscope_biases),
        accelerometer_bias=_differences(
            groundtruth.accelerometer_biases, aligned.accelerometer_biases
        ),
    )


def _parts(errors: Floats, up: UpAxis) -> tuple[Floats, Floats, Floats]:
    """Return the lengths (N,) of errors (N, 3), and of their horizontal and vertical parts."""
    level = up.to_z_up(errors)
    return lengths(errors), np.hypot(level[:, 0], level[:, 1]), np.abs(level[:, 2])


def position_errors(groundtruth: Trajectory, aligned: Trajectory, form: str) -> Floats:
    """Return the position errors (N, 3) in the groundtruth's frame, metres.

    Form `tutorial` is p - E p', which needs orientations on both sides; others are p - p'.
    """
    if form != "tutorial":
        return groundtruth.positions - aligned.positions
    assert groundtruth.quaternions is not None
    assert aligned.quaternions is not None
    between = rotation_errors(groundtruth.quaternions, aligned.quaternions)
    return groundtruth.positions - lie.rotate(between, aligned.positions)


def rotation_errors(groundtruth_q: Floats, aligned_q: Floats) -> Floats:
    """Return the rotation errors E = R R'^T of eq. (23), (N, 4)."""
    return lie.multiply(groundtruth_q, lie.conjugate(aligned_q))


def angle_yaw_tilt(between: Floats, up: UpAxis) -> tuple[Floats, Floats, Floats]:
    """Return angle, absolute yaw and tilt of E, degrees."""
    level = up.to_z_up(between)
    return (
        np.degrees(lie.angle(between)),
        np.degrees(np.abs(lie.yaw(level))),
        np.degrees(lie.tilt(level)),
    )


def _differences(groundtruth: Floats | None, estimate: Floats | None) -> Floats | None:
    if groundtruth is None or estimate is None:
        return None
    return lengths(groundtruth - estimate)


@dataclass(frozen=True, eq=False)
class ErrorVectors:
    """Errors of N aligned states, groundtruth minus estimate; None if not available."""

    # (N, 3), along the axes of the groundtruth's frame. Its length is `AbsoluteErrors.position_m`.
    position_world_m: Floats
    # (N, 3), the same vector along the axes of the groundtruth's body.
    position_body_m: Floats | None = None
    # (N, 3), rotation vector of E = R R'^T, about the axes of the groundtruth's frame: roll,
    # pitch, yaw. Its length is `AbsoluteErrors.rotation_deg`.
    rotation_world_deg: Floats | None = None
    # (N, 3), rotation vector of R'^T R, about the axes of the body. It is the same for the
    # groundtruth's and the estimate's body: E keeps its own axis.
    rotation_body_deg: Floats | None = None


def error_vectors(
    groundtruth: Trajectory, aligned: Trajectory, form: str, *, rotation: bool
) -> ErrorVectors:
    """Return the errors of `absolute_errors` axis by axis, before lengths are taken."""
    position = position_errors(groundtruth, aligned, form)
    if groundtruth.quaternions is None:
        return ErrorVectors(position)
    to_body = lie.conjugate(groundtruth.quaternions)
    in_body = lie.rotate(to_body, position)
    if aligned.quaternions is None or not rotation:
        return ErrorVectors(position, in_body)
    between = lie.normalized(rotation_errors(groundtruth.quaternions, aligned.quaternions))
    turn = np.degrees(lie.rotation_vector(between))
    return ErrorVectors(position, in_body, turn, lie.rotate(to_body, turn))
