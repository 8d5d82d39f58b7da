"""Relative errors at the ends of sub-trajectories: eq. (26) and (27) of the tutorial.

Names are those of `absolute_errors`: groundtruth (p, R, v), estimate (p', R', v'), E = R R'^T.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.absolute_errors import angle_yaw_tilt, lengths, rotation_errors
from trajeval_ros.metrics.matrix_errors import by_matrices
from trajeval_ros.metrics.span_alignment import align_spans


@dataclass(frozen=True, eq=False)
class RelativeErrors:
    """Errors of eq. (27) at the ends of K sub-trajectories of one length.

    Attributes:
        starts: (K,) indices of the first pairs.
        ends: (K,) indices of the last pairs.
        position_m: (K,), length of the position error at the end.
        rotation_deg: (K,), angle of E at the end; None without orientations on both sides.
        yaw_deg: (K,), twist about the up axis, absolute value; None if the up axis is unknown.
        tilt_deg: (K,), roll and pitch; None if the up axis is unknown or the gauge is planar.
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
        angle, yaw, tilt = angle_yaw_tilt(between, groundtruth.up)
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
    """Positions and orientations for relative errors.

    Attributes:
        positions: (..., 3), metres.
        quaternions: (..., 4), xyzw, unit.
    """

    positions: Floats
    quaternions: Floats

    @classmethod
    def of(cls, trajectory: Trajectory) -> PoseArrays:
        """Return the N poses of a trajectory with orientations."""
        quaternions = trajectory.quaternions
        assert quaternions is not None
        return cls(trajectory.positions, quaternions)

    def at(self, rows: Indices) -> PoseArrays:
        """Return the poses of these rows."""
        # `take` is faster than indexing.
        return PoseArrays(self.positions.take(rows, axis=0), self.quaternions.take(rows, axis=0))


def differences_at_ends(
    truth: PoseArrays, other: PoseArrays, gauge: Gauge, scale: float = 1.0, form: str = "gauge"
) -> tuple[Floats, Floats, Floats]:
    """Align K sub-trajectories at their starts; return the differences at their ends.

    Args:
        truth: (2, K) groundtruth poses: first the starts, then the ends.
        other: (2, K) estimated poses.
        gauge: As for `relative_errors`.
        scale: As for `relative_errors`.
        form: As for `relative_errors`.

    Returns:
        Position errors (K, 3), rotation errors (K, 4), rotations of the alignments (K, 4).
    """
    first, last = rotation_errors(truth.quaternions, other.quaternions)
    # The alignment is eq. (19); for yaw its rotation is eq. (20).
    about_gravity = form in ("gauge", "tutorial") and gauge.turns_about_gravity_only
    alignment = lie.heading(first) if about_gravity else first
    # eq. (14) with the alignment by the first state, relative to the first position.
    step = scale * lie.rotate(alignment, other.positions[1] - other.positions[0])
    # R (R_a R')^T; R R'^T is available for both states.
    between = lie.multiply(last, lie.conjugate(alignment))
    if form == "tutorial":
        aligned = truth.positions[0] + step
        return truth.positions[1] - lie.rotate(between, aligned), between, alignment
    return truth.positions[1] - truth.positions[0] - step, between, alignment


def _fitted(
    truth: PoseArrays, other: PoseArrays, starts: Indices, ends: Indices
) -> tuple[Floats, Floats, Floats]:
    """Align K sub-trajectories by all their states; return the same as `differences_at_ends`."""
    difference, alignment = _fitted_differences(truth.positions, other.positions, starts, ends)
    turned = lie.multiply(alignment, other.quaternions[ends])
    between = lie.multiply(truth.quaternions[ends], lie.conjugate(turned))
    return difference, between, alignment


def _fitted_differences(
    truth: Floats, other: Floats, starts: Indices, ends: Indices
) -> tuple[Floats, Floats]:
    """Align K sub-trajectories of positions (N, 3) by yaw and position over all their states.

    Returns:
        The position errors at the ends (K, 3), and the rotations of the alignments (K, 4).
    """
    alignment, mean_p, mean_q = align_spans(truth, other, starts, ends)
    aligned = mean_p + lie.rotate(alignment, other[ends] - mean_q)
    return truth[ends] - aligned, alignment


def _euler_in_estimate_world(
    truth_q: Floats, other_q: Floats, starts: Indices, ends: Indices
) -> tuple[Floats, Floats]:
    """Return |yaw| and hypot(pitch, roll) of the relative poses' errors, degrees, (K,) each.

    As in rpg_trajectory_evaluation, the error of the relative rotation is expressed in the
    unaligned estimate's world at the end state and converted to intrinsic z-y-x Euler angles.
    """
    truth_step = lie.multiply(lie.conjugate(truth_q[starts]), truth_q[ends])
    other_step = lie.multiply(lie.conjugate(other_q[starts]), other_q[ends])
    error = lie.multiply(lie.conjugate(truth_step), other_step)
    in_world = lie.multiply(lie.multiply(other_q[ends], error), lie.conjugate(other_q[ends]))
    angles = lie.euler_angles(lie.normalized(in_world))
    yaw, tilt = np.abs(angles[:, 0]), np.hypot(angles[:, 1], angles[:, 2])
    return np.degrees(yaw), np.degrees(tilt)
