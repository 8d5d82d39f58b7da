"""Absolute and relative errors of paired states: eq. (21) to (27) of the tutorial.

Groundtruth states are (p, R, v), estimated ones (p', R', v'); the rotation error is
E = R R'^T in the groundtruth's world. `plain` errors are differences, p - p'. The tutorial's
own form, eq. (23), p - E p', depends on where the world's origin is and is offered by name.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.metrics.matrix_errors import by_matrices
from trajeval_ros.metrics.span_alignment import align_spans


@dataclass(frozen=True, eq=False)
class AbsoluteErrors:
    """Errors of N aligned states; a column that can't be had is None, never zeros.

    Attributes:
        position_m: (N,), length of the position error.
        horizontal_m: (N,), length of its level part, across the groundtruth's up axis.
        vertical_m: (N,), length of its part along that axis.
        rotation_deg: (N,), angle of E.
        yaw_deg: (N,), absolute twist of E about gravity, the groundtruth's up axis.
        tilt_deg: (N,), angle between the up axis and its image under E: roll and pitch.
        velocity_mps: (N,), length of the velocity error.
        gyroscope_bias: (N,), rad/s, length of the difference, in the body.
        accelerometer_bias: (N,), m/s^2, length of the difference, in the body.
    """

    position_m: Floats
    horizontal_m: Floats | None = None
    vertical_m: Floats | None = None
    rotation_deg: Floats | None = None
    yaw_deg: Floats | None = None
    tilt_deg: Floats | None = None
    velocity_mps: Floats | None = None
    gyroscope_bias: Floats | None = None
    accelerometer_bias: Floats | None = None


def absolute_errors(
    groundtruth: Trajectory, aligned: Trajectory, form: str = "plain", *, rotation: bool = True
) -> AbsoluteErrors:
    """Return the errors of an aligned estimate, state by state: eq. (23).

    Args:
        groundtruth: N states.
        aligned: N states, paired with the groundtruth's and aligned with them, eq. (14).
        form: `plain` or `tutorial`; the latter needs rotations on both sides.
        rotation: False withholds all that depends on an undetermined rotation.
    """
    velocities = aligned.velocities if rotation else None
    truth_q, aligned_q = groundtruth.quaternions, aligned.quaternions
    angle = yaw = tilt = None
    if truth_q is not None and aligned_q is not None and rotation:
        angle, yaw, tilt = lie.by_blocks(
            lambda true, other: _sizes(rotation_errors(true, other), groundtruth.up),
            truth_q,
            aligned_q,
        )
        if form == "tutorial" and velocities is not None:
            velocities = lie.rotate(rotation_errors(truth_q, aligned_q), velocities)
    position, horizontal, vertical = lie.by_blocks(
        lambda errors: _parts(errors, groundtruth.up),
        position_errors(groundtruth, aligned, form),
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
    """Return the lengths of position errors (N, 3), of their level parts and of the rest."""
    level = up.turned(errors)
    return lengths(errors), np.hypot(level[:, 0], level[:, 1]), np.abs(level[:, 2])


def position_errors(groundtruth: Trajectory, aligned: Trajectory, form: str) -> Floats:
    """Return the position errors (N, 3) in the groundtruth's frame, metres.

    Args:
        groundtruth: N states.
        aligned: N states, aligned.
        form: `tutorial` for p - E p', which needs rotations on both sides; else it is p - p'.
    """
    if form != "tutorial":
        return groundtruth.positions - aligned.positions
    assert groundtruth.quaternions is not None
    assert aligned.quaternions is not None
    between = rotation_errors(groundtruth.quaternions, aligned.quaternions)
    return groundtruth.positions - lie.rotate(between, aligned.positions)


def rotation_errors(truth_q: Floats, aligned_q: Floats) -> Floats:
    """Return the rotation errors E = R R'^T of eq. (23), (N, 4)."""
    return lie.multiply(truth_q, lie.conjugate(aligned_q))


def _sizes(between: Floats, up: UpAxis) -> tuple[Floats, Floats, Floats]:
    """Return angle, absolute yaw and tilt of E, degrees."""
    level = up.turned(between)
    return (
        np.degrees(lie.angle(between)),
        np.degrees(np.abs(lie.yaw(level))),
        np.degrees(lie.tilt(level)),
    )


@dataclass(frozen=True, eq=False)
class RelativeErrors:
    """Errors (27) at the ends of K sub-trajectories of one length.

    Attributes:
        starts: (K,) index of the pair of states that each begins with.
        ends: (K,) index of the pair that it ends with.
        position_m: (K,), length of the position error at the end.
        rotation_deg: (K,), angle of E at the end; None without orientations on both sides.
        yaw_deg: (K,), absolute twist about gravity; None where it isn't known which way is up.
        tilt_deg: (K,), roll and pitch; likewise, and where a plane leaves none.
        velocity_mps: (K,), length of the velocity error at the end, or None.
    """

    starts: Indices
    ends: Indices
    position_m: Floats
    rotation_deg: Floats | None
    yaw_deg: Floats | None
    tilt_deg: Floats | None
    velocity_mps: Floats | None = None


def relative_errors(
    groundtruth: Trajectory,
    estimate: Trajectory,
    starts: Indices,
    ends: Indices,
    gauge: Gauge,
    scale: float = 1.0,
    form: str = "gauge",
) -> RelativeErrors:
    """Return the errors at the ends of sub-trajectories that are aligned at their starts.

    Args:
        groundtruth: N states with rotations; for `fitted` they may have positions alone.
        estimate: Likewise, paired with the groundtruth's, in their own frame.
        starts: (K,) indices of first states.
        ends: (K,) indices of last states.
        gauge: What each alignment by the first state may change, eq. (19) and (20).
        scale: The global alignment's, since one state has none.
        form: `gauge`: aligned by the gauge, plain difference at the end. `se3`: aligned by
            SE(3) whatever the gauge, which is the error of relative poses (KITTI, rpg).
            `tutorial`: aligned by the gauge, eq. (26) to the letter. `euler`: as `se3`, with
            yaw and tilt as Euler angles of the error in the estimate's own world, as
            rpg_trajectory_evaluation has them. `fitted`: aligned by yaw and position over all
            its states, eq. (18), plain difference at the end. `matrices`: as `se3`, with the
            matrices as KITTI's files have them, which the devkit doesn't make rotations. `evo`:
            as `se3`.

    Gauges `none` and `translation` use SE(3) here: a relative error without an alignment of
    the first state's rotation would be an absolute one.
    """
    if form == "fitted" and (groundtruth.quaternions is None or estimate.quaternions is None):
        sides = groundtruth.positions, estimate.positions
        errors = _fitted_differences(*sides, starts, ends)[0]
        return RelativeErrors(starts, ends, lengths(errors), None, None, None)
    truth, other = PoseArrays.of(groundtruth), PoseArrays.of(estimate)

    def at_ends(s: Indices, e: Indices) -> tuple[Floats, ...]:
        rows = np.stack([s, e])
        if form == "fitted":
            difference, between, first = _fitted(truth, other, s, e)
        else:
            difference, between, first = differences_at_ends(
                truth.at(rows), other.at(rows), gauge, scale, form
            )
        angle, yaw, tilt = _sizes(between, groundtruth.up)
        if form == "euler":
            yaw, tilt = _euler_in_estimate_world(truth.quaternions, other.quaternions, s, e)
        position = lengths(difference)
        if form == "matrices":
            position, angle = by_matrices(groundtruth, estimate, s, e, scale)
        errors = (position, angle, yaw, tilt)
        if groundtruth.velocities is None or estimate.velocities is None:
            return errors
        velocity = scale * lie.rotate(first, estimate.velocities[e])
        if form == "tutorial":
            velocity = lie.rotate(between, velocity)
        return (*errors, lengths(groundtruth.velocities[e] - velocity))

    return RelativeErrors(starts, ends, *lie.by_blocks(at_ends, starts, ends))


class PoseArrays(NamedTuple):
    """The columns of poses that relative errors need.

    Attributes:
        positions: (..., 3), metres.
        quaternions: (..., 4), xyzw, unit.
    """

    positions: Floats
    quaternions: Floats

    @classmethod
    def of(cls, trajectory: Trajectory) -> PoseArrays:
        """Return the N poses of a trajectory with rotations."""
        quaternions = trajectory.quaternions
        assert quaternions is not None
        return cls(trajectory.positions, quaternions)

    def at(self, rows: Indices) -> PoseArrays:
        """Return the poses of these rows."""
        # Faster than by [rows].
        return PoseArrays(self.positions.take(rows, axis=0), self.quaternions.take(rows, axis=0))


def differences_at_ends(
    truth: PoseArrays, other: PoseArrays, gauge: Gauge, scale: float = 1.0, form: str = "gauge"
) -> tuple[Floats, Floats, Floats]:
    """Align K sub-trajectories at their starts; return the differences at their ends.

    Args:
        truth: (2, K) groundtruth poses, those of the starts and those of the ends.
        other: (2, K) estimated poses.
        gauge: As for `relative_errors`.
        scale: As for `relative_errors`.
        form: As for `relative_errors`.

    Returns:
        The position errors (K, 3), the rotation errors (K, 4), the alignments' rotations (K, 4).
    """
    first, last = rotation_errors(truth.quaternions, other.quaternions)
    # The alignment is eq. (19), for yaw with the rotation of eq. (20).
    about_gravity = form in ("gauge", "tutorial") and gauge.turns_about_gravity_only
    alignment = lie.heading(first) if about_gravity else first
    # eq. (14) with the first state's alignment, relative to that state's position.
    step = scale * lie.rotate(alignment, other.positions[1] - other.positions[0])
    # R (R_a R')^T, with R R'^T at hand for both states.
    between = lie.multiply(last, lie.conjugate(alignment))
    if form == "tutorial":
        aligned = truth.positions[0] + step
        return truth.positions[1] - lie.rotate(between, aligned), between, alignment
    return truth.positions[1] - truth.positions[0] - step, between, alignment


def _fitted(
    truth: PoseArrays, other: PoseArrays, starts: Indices, ends: Indices
) -> tuple[Floats, Floats, Floats]:
    """Align K sub-trajectories by all their states; return what `differences_at_ends` does."""
    difference, alignment = _fitted_differences(truth.positions, other.positions, starts, ends)
    turned = lie.multiply(alignment, other.quaternions[ends])
    between = lie.multiply(truth.quaternions[ends], lie.conjugate(turned))
    return difference, between, alignment


def _fitted_differences(
    truth: Floats, other: Floats, starts: Indices, ends: Indices
) -> tuple[Floats, Floats]:
    """Align K sub-trajectories of positions (N, 3) by yaw and position over all their states.

    Returns:
        The position errors at their ends (K, 3), and the alignments' rotations (K, 4).
    """
    alignment, mean_p, mean_q = align_spans(truth, other, starts, ends)
    aligned = mean_p + lie.rotate(alignment, other[ends] - mean_q)
    return truth[ends] - aligned, alignment


def _euler_in_estimate_world(
    truth_q: Floats, other_q: Floats, starts: Indices, ends: Indices
) -> tuple[Floats, Floats]:
    """Return |yaw| and hypot(pitch, roll) of relative poses' error, degrees, as the toolbox.

    The relative rotation's error is turned into the unaligned estimate's world at the end
    state, then read as intrinsic z-y-x Euler angles.
    """
    truth_step = lie.multiply(lie.conjugate(truth_q[starts]), truth_q[ends])
    other_step = lie.multiply(lie.conjugate(other_q[starts]), other_q[ends])
    error = lie.multiply(lie.conjugate(truth_step), other_step)
    in_world = lie.multiply(lie.multiply(other_q[ends], error), lie.conjugate(other_q[ends]))
    angles = lie.euler_angles(lie.normalized(in_world))
    yaw, tilt = np.abs(angles[:, 0]), np.hypot(angles[:, 1], angles[:, 2])
    return np.degrees(yaw), np.degrees(tilt)


def lengths(vectors: Floats) -> Floats:
    """Return the lengths (N,) of vectors (N, 3)."""
    norms: Floats = np.sqrt(np.einsum("ni,ni->n", vectors, vectors))
    return norms


def _differences(groundtruth: Floats | None, estimate: Floats | None) -> Floats | None:
    if groundtruth is None or estimate is None:
        return None
    return lengths(groundtruth - estimate)
