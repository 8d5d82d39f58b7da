"""Mounting of an IMU on the estimate's body: rotation, time offset and gyroscope bias."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.hand_eye import closest_rotation
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Indices, lengths
from trajeval_ros.geometry.inertial import rotations_by_gyro
from trajeval_ros.geometry.interpolation import columns_at, slerp_at
from trajeval_ros.watchdog.rotations_over_time import between, only_axis
from trajeval_ros.watchdog.row_buffer import QUATERNION, TIME, window_begins

# Columns of an IMU row after `TIME` and `SINCE`: rad/s, m/s^2.
GYRO, ACCELERATION = slice(2, 5), slice(5, 8)
IMU_WIDTH = 8
FARTHEST_S = 0.5  # largest time offset that is searched
_COARSE_S, _FINE_S, _NEAR_S = 0.05, 0.005, 0.05
_INCREMENT_S, _BIAS_S = 0.5, 10.0
_MOST = 2000
_PASSES = 5
_BIAS_PRIOR_RADPS = 0.02
_MEDIAN_LENGTH, _LEAST_RAD = 1.538, 1e-4  # of a normal vector of three components, in sigma
_SCALE_RAD = 0.01  # the loss is linear for larger residuals
# IMU and estimate are unrelated if the median misfit of rotations divided by their median angle
# exceeds this. Only rotations above this quantile of the angle are used.
_UNRELATED = 0.5
_MOST_TURNED = 0.75
_TOLD_OFFSET_S, _TOLD_TURN_DEG = 0.05, 5.0


@dataclass(frozen=True, eq=False)
class Mounting:
    """Rotation, time offset and gyroscope bias of an IMU on the estimate's body."""

    rotation: Floats  # rotation from the IMU's axes to the estimate's body (4,), xyzw
    bias: Floats  # bias of the gyroscope (3,), rad/s, in the IMU's axes
    offset_s: float  # time offset: time t of the estimate's clock is t + offset of the IMU's clock
    # The only axis (3,) about which the robot rotated, in the body; `rotation` is not determined
    # about it. None if the robot rotated about several axes.
    axis: Floats | None
    # Median difference of rotations in 0.5 s divided by their median angle, for the 25 % of them
    # with the largest angles.
    misfit: float
    # (6, 6), covariance of the bias (rad/s) and of the rotation (rad), both in the body
    covariance: Floats

    @property
    def is_related(self) -> bool:
        """Whether the rotations of IMU and estimate agree."""
        return self.misfit < _UNRELATED

    def remarks(self) -> list[str]:
        """Return the remarks for the user, one sentence each."""
        sentences = []
        angle_deg = math.degrees(float(lie.angle(self.rotation)))
        if self.axis is not None:
            sentences.append(
                "the robot rotated about only one axis: the gyroscope is compared about this "
                "axis only, and gravity is not compared"
            )
        elif angle_deg > _TOLD_TURN_DEG:
            sentences.append(
                f"the IMU frame is rotated by {angle_deg:.1f} deg from the estimate's body "
                "(estimated from rotations, applied)"
            )
        if abs(self.offset_s) > _TOLD_OFFSET_S:
            way = "behind" if self.offset_s > 0.0 else "ahead of"
            sentences.append(
                f"the estimate's clock is {abs(self.offset_s):.3f} s {way} the IMU's (applied)"
            )
        return sentences


def mounting_of(states: Floats, imu: Floats) -> Mounting:
    """Estimate the mounting from rotations in 0.5 s of states (N, 9) and IMU rows (M, 8)."""
    raw = rotations_by_gyro(imu[:, TIME], imu[:, GYRO])
    begins, known = window_begins(states, 0, _INCREMENT_S)
    ends = np.flatnonzero(known)
    begins = begins[ends]
    times = states[:, TIME]
    inside = (times[begins] > imu[0, TIME] + FARTHEST_S) & (
        times[ends] < imu[-1, TIME] - FARTHEST_S
    )
    begins, ends = begins[inside], ends[inside]
    few = slice(None, None, max(1, len(ends) // _MOST))
    begins, ends = begins[few], ends[few]
    own = lie.rotation_vector(between(states[begins, QUATERNION], states[ends, QUATERNION]))
    span = (times[ends] - times[begins])[:, None]

    def by_gyro(offset_s: float) -> Floats:
        start = slerp_at(imu[:, TIME], raw, times[begins] + offset_s)
        end = slerp_at(imu[:, TIME], raw, times[ends] + offset_s)
        return lie.rotation_vector(between(start, end))

    def best_of(offsets: Floats, axis: Floats | None) -> float:
        misfits = [_turn_and_bias(own, by_gyro(offset), span, axis)[0] for offset in offsets]
        return float(offsets[int(np.argmin(misfits))])

    coarse = np.arange(-FARTHEST_S, FARTHEST_S + 1e-9, _COARSE_S)
    near = np.arange(-_NEAR_S, _NEAR_S + 1e-9, _FINE_S)
    axis = only_axis(own, by_gyro(best_of(coarse, None)))
    offset_s = best_of(best_of(coarse, axis) + near, axis)
    misfit, rotation, bias = _turn_and_bias(own, by_gyro(offset_s), span, axis)
    first = lie.from_matrix(rotation)
    quaternion, bias, covariance = _refined(states, imu, offset_s, first, bias)
    return Mounting(quaternion, bias, offset_s, axis, misfit, covariance)


def _turn_and_bias(
    own: Floats, gyro: Floats, span: Floats, axis: Floats | None
) -> tuple[float, Floats, Floats]:
    """Fit rotation (3, 3) and bias (3,), rad/s, to rotation vectors; return them after the misfit.

    The rotation vectors of estimate and gyroscope are (N, 3), rad, the durations (N, 1), s. With
    an `axis` (3,), only rotations about it count.
    """
    bias, rotation = np.zeros(3), np.eye(3)
    for _ in range(_PASSES):
        rotation = closest_rotation(own, gyro - bias * span)
        bias = np.median((gyro - own @ rotation) / span, axis=0)
    off = own - (gyro - bias * span) @ rotation.T
    angles = lengths(off) if axis is None else np.abs(off @ axis)
    rotated = lengths(own)
    most = rotated >= np.quantile(rotated, _MOST_TURNED)
    return float(np.median(angles[most]) / max(np.median(rotated[most]), 1e-9)), rotation, bias


def _refined(
    states: Floats, imu: Floats, offset_s: float, rotation: Floats, bias: Floats
) -> tuple[Floats, Floats, Floats]:
    """Refine rotation (4,) and bias (3,) on windows of 10 s, where the bias has more effect.

    With the mounting X, the rotation G by the gyroscope and A by the estimate, the residual is
    r = Log((X G X')' A). The method is Gauss-Newton with dr/db = P' X int G dt, dr/dX = I - P',
    P = X G X', and a soft l1 loss. A prime is the transpose. The third result is the covariance of
    bias and rotation in the body (6, 6), with the prior of a gyroscope's bias.
    """
    times = states[:, TIME]
    begins, known = window_begins(states, 0, _BIAS_S)
    inside = (times[begins] + offset_s >= imu[0, TIME]) & (times + offset_s <= imu[-1, TIME])
    ends: Indices = np.flatnonzero(known & inside)
    ends = ends[:: max(1, len(ends) // _MOST)]
    begins = begins[ends]
    covariance = np.diag([_BIAS_PRIOR_RADPS**2] * 3 + [1.0] * 3)
    if len(ends) < 2:
        return rotation, bias, covariance
    weak, overlap = np.linalg.inv(covariance), float(np.median(np.diff(times[ends]))) / _BIAS_S
    own = between(states[begins, QUATERNION], states[ends, QUATERNION])
    for _ in range(_PASSES):
        track = rotations_by_gyro(imu[:, TIME], imu[:, GYRO] - bias)
        matrices = lie.to_matrix(track).reshape(-1, 9)
        steps = 0.5 * (matrices[1:] + matrices[:-1]) * np.diff(imu[:, TIME])[:, None]
        integral = np.concatenate([np.zeros((1, 9)), np.cumsum(steps, axis=0)])
        start, end = (
            slerp_at(imu[:, TIME], track, times[item] + offset_s) for item in (begins, ends)
        )
        summed = [
            columns_at(imu[:, TIME], integral, times[item] + offset_s).reshape(-1, 3, 3)
            for item in (begins, ends)
        ]
        swept = np.swapaxes(lie.to_matrix(start), 1, 2) @ (summed[1] - summed[0])
        predicted = lie.multiply(
            lie.multiply(rotation, between(start, end)), lie.conjugate(rotation)
        )
        residual = lie.rotation_vector(between(predicted, own))
        back = np.swapaxes(lie.to_matrix(predicted), 1, 2)
        jacobian = np.concatenate(
            [back @ lie.to_matrix(rotation) @ swept, np.eye(3) - back], axis=2
        )
        weights = (1.0 + np.square(residual / _SCALE_RAD)) ** -0.25
        weighted = (jacobian * weights[:, :, None]).reshape(-1, 6)
        solution = np.linalg.lstsq(weighted, -(residual * weights).reshape(-1), rcond=1e-3)[0]
        sigma = max(float(np.median(lengths(residual))) / _MEDIAN_LENGTH, _LEAST_RAD)
        covariance = np.linalg.inv(overlap / sigma**2 * weighted.T @ weighted + weak)
        bias = bias + solution[:3]
        rotation = lie.multiply(
            lie.from_rotation_vector(np.asarray(solution[3:], float)), rotation
        )
    into_body = np.eye(6)
    into_body[:3, :3] = lie.to_matrix(rotation[None])[0]
    return lie.normalized(rotation), bias, into_body @ covariance @ into_body.T
