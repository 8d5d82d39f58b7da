"""Relative errors at the ends of sub-trajectories: eq. (26) and (27) of the tutorial.

Names are those of `absolute_errors`: groundtruth (p, R, v), estimate (p', R', v'), E = R R'^T.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Indices, lengths
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.absolute_errors import angle_yaw_tilt, rotation_errors
from trajeval_ros.metrics.other_programs import by_matrices
from trajeval_ros.metrics.premises import Premise, relies_on

_ANGLE = (Premise.ORIENTATIONS, Premise.BODY_ROTATION, Premise.FIRST_STATES)


@dataclass(frozen=True, eq=False)
class RelativeErrors:
    """Errors of eq. (27) at the ends of K sub-trajectories of one length."""

    starts: Indices  # (K,) indices of the first pairs
    ends: Indices  # (K,) indices of the last pairs
    # (K,), length of the position error at the end; without it, there are no relative errors.
    position_m: Floats = relies_on(Premise.FIRST_STATES, required=True)
    # (K,), angle of E at the end; None without orientations on both sides.
    rotation_deg: Floats | None = relies_on(*_ANGLE)
    # (K,), twist about the up axis, absolute value; None if the up axis is unknown.
    yaw_deg: Floats | None = relies_on(*_ANGLE, Premise.RELATIVE_UP_AXIS)
    # (K,), roll and pitch; None if the up axis is unknown or the gauge is planar.
    tilt_deg: Floats | None = relies_on(Premise.ROLL_AND_PITCH, *_ANGLE, Premise.RELATIVE_UP_AXIS)
    # (K,), length of the velocity error at the end, or None.
    velocity_mps: Floats | None = relies_on(Premise.BODY_ROTATION, Premise.FIRST_STATES)


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
        groundtruth: N states with orientations; form `fitted` accepts positions alone.
        estimate: N states paired with the groundtruth, in their own frame; likewise.
        starts: (K,) indices of the first states.
        ends: (K,) indices of the last states.
        gauge: Group of the alignment by the first state, eq. (19) and (20).
        scale: Scale of the alignment of the whole trajectory; one state has none.
        form: `gauge`: alignment by the gauge, plain difference at the end.
            `se3`: alignment in SE(3) for any gauge: the error of relative poses (KITTI, rpg).
            `tutorial`: alignment by the gauge, eq. (26) to the letter.
            `euler`: as `se3`; yaw and tilt are Euler angles of the error in the estimate's
            world, as in rpg_trajectory_evaluation.
            `fitted`: alignment by yaw and position over all states, eq. (18), plain difference.
            `matrices`: as `se3`, with the matrices of KITTI's files, which the devkit does not
            orthonormalise.
            `evo`: as `se3`.

    Gauges `none` and `translation` use SE(3) here: without a rotation of the first state a
    relative error would be an absolute one.
    """
    if form == "fitted" and (groundtruth.quaternions is None or estimate.quaternions is None):
        sides = groundtruth.positions, estimate.positions
        errors = _fitted_differences(*sides, starts, ends)[0]
        return RelativeErrors(starts, ends, lengths(errors))
    groundtruth_poses, estimate_poses = PoseArrays.of(groundtruth), PoseArrays.of(estimate)
    # Once per pair: most pairs are both a start and an end.
    [rotations] = lie.by_blocks(
        lambda *sides: (rotation_errors(*sides),),
        groundtruth_poses.quaternions,
        estimate_poses.quaternions,
    )

    def at_ends(s: Indices, e: Indices) -> tuple[Floats, ...]:
        rows = np.stack([s, e])
        if form == "fitted":
            difference, between, first = _fitted(groundtruth_poses, estimate_poses, s, e)
        else:
            # `take` is faster than indexing.
            difference, between, first = differences_at_ends(
                groundtruth_poses.positions.take(rows, axis=0),
                estimate_poses.positions.take(rows, axis=0),
                rotations.take(rows, axis=0),
                gauge,
                scale,
                form,
            )
        angle, yaw, tilt = angle_yaw_tilt(between, groundtruth.up)
        if form == "euler":
            yaw, tilt = _euler_in_estimate_world(
                groundtruth_poses.quaternions, estimate_poses.quaternions, s, e
            )
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
    """Positions and orientations for relative errors."""

    positions: Floats  # (..., 3), metres
    quaternions: Floats  # (..., 4), xyzw, unit

    @classmethod
    def of(cls, trajectory: Trajectory) -> PoseArrays:
        """Return the N poses of a trajectory with orientations."""
        quaternions = trajectory.quaternions
        assert quaternions is not None
        return cls(trajectory.positions, quaternions)


def differences_at_ends(
    groundtruth: Floats,
    other: Floats,
    turns: Floats,
    gauge: Gauge,
    scale: float = 1.0,
    form: str = "gauge",
) -> tuple[Floats, Floats, Floats]:
    """Align K sub-trajectories at their starts; return the differences at their ends.

    Positions of both sides (2, K, 3) and `rotation_errors` (2, K, 4): first those of the starts,
    then those of the ends. The other arguments are those of `relative_errors`. Returned are
    position errors (K, 3), rotation errors (K, 4) and rotations of the alignments (K, 4).
    """
    first, last = turns
    # The alignment is eq. (19); for yaw its rotation is eq. (20).
    rot_z = form in ("gauge", "tutorial") and gauge.yaw_only
    alignment = lie.heading(first) if rot_z else first
    # eq. (14) with the alignment by the first state, relative to the first position.
    step = scale * lie.rotate(alignment, other[1] - other[0])
    # R (R_a R')^T; R R'^T is available for both states.
    between = lie.multiply(last, lie.conjugate(alignment))
    if form == "tutorial":
        difference = groundtruth[1] - lie.rotate(between, groundtruth[0] + step)
    else:
        difference = groundtruth[1] - groundtruth[0] - step
    return difference, between, alignment


def _fitted(
    groundtruth: PoseArrays, other: PoseArrays, starts: Indices, ends: Indices
) -> tuple[Floats, Floats, Floats]:
    """Align K sub-trajectories by all their states; return the same as `differences_at_ends`."""
    difference, alignment = _fitted_differences(
        groundtruth.positions, other.positions, starts, ends
    )
    rotated = lie.multiply(alignment, other.quaternions[ends])
    between = lie.multiply(groundtruth.quaternions[ends], lie.conjugate(rotated))
    return difference, between, alignment


def _fitted_differences(
    groundtruth: Floats, other: Floats, starts: Indices, ends: Indices
) -> tuple[Floats, Floats]:
    """Align K sub-trajectories of positions (N, 3) by yaw and position over all their states.

    Returned are the position errors at the ends (K, 3), and the rotations of the alignments (K,
    4).
    """
    alignment, mean_p, mean_q = align_spans(groundtruth, other, starts, ends)
    aligned = mean_p + lie.rotate(alignment, other[ends] - mean_q)
    return groundtruth[ends] - aligned, alignment


def _euler_in_estimate_world(
    groundtruth_q: Floats, other_q: Floats, starts: Indices, ends: Indices
) -> tuple[Floats, Floats]:
    """Return |yaw| and hypot(pitch, roll) of the relative poses' errors, degrees, (K,) each.

    As in rpg_trajectory_evaluation, the error of the relative rotation is expressed in the
    unaligned estimate's world at the end state and converted to intrinsic z-y-x Euler angles.
    """
    groundtruth_step = lie.multiply(lie.conjugate(groundtruth_q[starts]), groundtruth_q[ends])
    other_step = lie.multiply(lie.conjugate(other_q[starts]), other_q[ends])
    error = lie.multiply(lie.conjugate(groundtruth_step), other_step)
    in_world = lie.multiply(lie.multiply(other_q[ends], error), lie.conjugate(other_q[ends]))
    angles = lie.euler_angles(lie.normalized(in_world))
    yaw, tilt = np.abs(angles[:, 0]), np.hypot(angles[:, 1], angles[:, 2])
    return np.degrees(yaw), np.degrees(tilt)


def align_spans(
    groundtruth: Floats, estimate: Floats, starts: Indices, ends: Indices
) -> tuple[Floats, Floats, Floats]:
    """Align K spans of positions (N, 3) by yaw and position over all states of a span, eq. (18).

    The sums of a span, last state included, are differences of running sums, in O(N + K). These
    are about the trajectory's mean, to avoid cancellation. Returned are rotations about z (K, 4),
    xyzw, and the means of groundtruth and estimate (K, 3), which the alignment maps to each other.
    """
    middle_p, middle_q = groundtruth.mean(axis=0), estimate.mean(axis=0)
    p, q = groundtruth - middle_p, estimate - middle_q
    count = (ends - starts + 1).astype(np.float64)[:, None]

    def mean(columns: Floats) -> Floats:
        running = np.concatenate([np.zeros((1, columns.shape[1])), np.cumsum(columns, axis=0)])
        spans: Floats = (running[ends + 1] - running[starts]) / count
        return spans

    mean_p, mean_q = mean(p), mean(q)
    dot = p[:, 0] * q[:, 0] + p[:, 1] * q[:, 1]
    cross = p[:, 1] * q[:, 0] - p[:, 0] * q[:, 1]
    both = mean(np.column_stack([dot, cross]))
    cosine = both[:, 0] - mean_p[:, 0] * mean_q[:, 0] - mean_p[:, 1] * mean_q[:, 1]
    sine = both[:, 1] - mean_p[:, 1] * mean_q[:, 0] + mean_p[:, 0] * mean_q[:, 1]
    half = np.arctan2(sine, cosine) / 2.0
    rotations = np.zeros((len(starts), 4))
    rotations[:, 2], rotations[:, 3] = np.sin(half), np.cos(half)
    return rotations, mean_p + middle_p, mean_q + middle_q
