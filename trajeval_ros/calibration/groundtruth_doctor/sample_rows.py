"""The groundtruth's samples as one measurement per knot.

A sample at the time tau after knot k is compared with R = R_k dR and p = p_k + v_k tau + g tau^2/2
+ R_k dp, where dR and dp are integrated from the IMU:

    e_p = p + R l - p_s        e_R = Log(R_s^T R R_IM)

All samples of an interval are averaged with robust weights. The rate of the groundtruth therefore
has no effect on the size of the problem, and its noise may be correlated within an interval.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajeval_ros.calibration.groundtruth_doctor.inertial_steps import InertialSteps, Motions
from trajeval_ros.calibration.groundtruth_doctor.rig import (
    BODY,
    GRAVITY,
    LEVER,
    OFFSET,
    SKEW,
    Rig,
    tangents,
)  # fmt: skip
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.se3 import times, transposed

_MEDIAN_OF_CHI3 = 1.538
_HUBER = 3.0  # residuals above it (in sigma) have less weight, above three times it none
_REJECTED = 1e-8  # an interval with rejected samples alone stays regular
_LEAST_SCALE = 1e-6  # m, rad


@dataclass(frozen=True, eq=False)
class TruthSamples:
    """The groundtruth by seconds of its own clock, in order."""

    seconds: Floats  # (N,)
    positions: Floats  # (N, 3), metres
    rotations: Floats | None  # (N, 3, 3), R_WM

    @property
    def middle_s(self) -> float:
        """The time from which the clock's skew counts."""
        return float(0.5 * (self.seconds[0] + self.seconds[-1]))

    def imu_seconds(self, offset_s: float, skew: float) -> Floats:
        """Return the samples' times (N,) by the IMU's clock."""
        return self.seconds + offset_s + skew * (self.seconds - self.middle_s)


@dataclass(frozen=True, eq=False)
class Predicted:
    """The rig at the S samples between the knots, and residuals of the samples."""

    rows: Indices  # (S,), in the groundtruth
    seconds: Floats  # (S,), by the groundtruth's clock
    knots: Indices  # (S,), the knot before
    since_s: Floats  # (S, 1), tau
    turned: Floats  # (S, 3, 3), dR
    moved: Floats  # (S, 3), dp
    rotations: Floats  # (S, 3, 3), R_WI
    positions: Floats  # (S, 3), p_WI
    velocities: Floats  # (S, 3), of I
    marker_velocities: Floats  # (S, 3)
    rates: Floats  # (S, 3), angular velocities in I
    position_errors: Floats  # (S, 3), in W
    rotation_errors: Floats  # (S, 3), in M; zero for a groundtruth without orientations


def predict(samples: TruthSamples, steps: InertialSteps, motions: Motions, rig: Rig) -> Predicted:
    """Return the rig at all samples between the first and the last knot."""
    seconds = samples.imu_seconds(rig.offset_s, rig.skew)
    rows = np.flatnonzero((seconds >= steps.knots[0]) & (seconds < steps.knots[-1]))
    states = rig_at(seconds[rows], steps, motions, rig)
    knots, since_s, turned, moved, rotations, positions, velocities, rates = states
    marker = velocities + times(rotations, np.cross(rates, rig.lever))
    errors = np.zeros((len(rows), 3))
    if samples.rotations is not None:
        errors = so3.log(transposed(samples.rotations[rows]) @ rotations @ rig.body)
    return Predicted(
        rows, samples.seconds[rows], knots, since_s, turned, moved, rotations, positions,
        velocities, marker, rates,
        positions + times(rotations, rig.lever) - samples.positions[rows], errors,
    )  # fmt: skip


def rig_at(
    seconds: Floats, steps: InertialSteps, motions: Motions, rig: Rig
) -> tuple[Indices, Floats, Floats, Floats, Floats, Floats, Floats, Floats]:
    """Return knot, tau, dR, dp, R_WI, p_WI, velocity and angular velocity at times (S,)."""
    knots = np.clip(np.searchsorted(steps.knots, seconds, "right") - 1, 0, len(steps.knots) - 2)
    place = np.searchsorted(steps.times, seconds, "right") - 1 - steps.first[knots]
    place = np.clip(place, 0, steps.held.shape[1] - 1)
    tau = (seconds - steps.knots[knots])[:, None]
    part = tau - steps.starts[knots, place][:, None]
    rates = steps.rates[knots, place] - rig.gyro_biases[knots]
    before = motions.rotations[knots, place]
    force = times(before, steps.accelerations[knots, place] - rig.acceleration_biases[knots])
    faster = motions.velocities[knots, place] + force * part
    moved = motions.positions[knots, place] + motions.velocities[knots, place] * part
    moved = moved + 0.5 * force * part**2
    turned = before @ so3.exp(rates * part)
    start = rig.rotations[knots]
    positions = rig.positions[knots] + rig.velocities[knots] * tau + 0.5 * rig.gravity * tau**2
    velocities = rig.velocities[knots] + rig.gravity * tau + times(start, faster)
    positions = positions + times(start, moved)
    return knots, tau, turned, moved, start @ turned, positions, velocities, rates


@dataclass(frozen=True, eq=False)
class SampleRows:
    """The measurements of Q knots: three rows of position, then three of rotation."""

    knots: Indices  # (Q,)
    residuals: Floats  # (Q, 6)
    by_state: Floats  # (Q, 6, 15)
    by_rig: Floats  # (Q, 6, 10)
    shares: Floats  # (Q, 6), information relative to a usual interval
    scales: Floats  # (2,), robust standard deviation of a sample, m and rad

    def weighted(self, sigmas: Floats) -> tuple[Floats, Floats, Floats]:
        """Return residuals and Jacobians over the standard deviations (6,) of the measurements."""
        weights = np.sqrt(self.shares) / sigmas
        return (
            self.residuals * weights,
            self.by_state * weights[..., None],
            self.by_rig * weights[..., None],
        )

    def with_mean_rotations(self, rig: Rig, width: int) -> SampleRows:
        """Return rows with one rotation per window of knots, at the knot in its middle.

        The estimated rotation carries the errors of the other knots there.
        """
        window = self.knots // width
        starts = np.flatnonzero(np.diff(window, prepend=-1))
        middles = np.minimum(window * width + width // 2, len(rig.rotations) - 1)
        carried = self.by_state[:, 3:, :3] @ transposed(rig.rotations[self.knots])
        columns = np.concatenate(
            [self.residuals[:, 3:, None], carried @ rig.rotations[middles], self.by_rig[:, 3:]],
            axis=2,
        )
        weights = self.shares[:, 3]
        sums = np.add.reduceat(columns * weights[:, None, None], starts, axis=0)
        total = np.add.reduceat(weights, starts)
        means = sums / np.maximum(total, _REJECTED)[:, None, None]
        places = np.minimum(np.searchsorted(self.knots, middles[starts]), len(self.knots) - 1)
        has_middle = self.knots[places] == middles[starts]
        places, means = places[has_middle], means[has_middle]
        count = np.diff(np.append(starts, len(self.knots)))[has_middle]
        residuals, by_state, by_rig, shares = (
            each.copy() for each in (self.residuals, self.by_state, self.by_rig, self.shares)
        )
        by_state[:, 3:], shares[:, 3:] = 0.0, 0.0
        residuals[places, 3:], by_state[places, 3:, :3] = means[..., 0], means[..., 1:4]
        by_rig[places, 3:], shares[places, 3:] = means[..., 4:], (count / width)[:, None]
        return replace(self, residuals=residuals, by_state=by_state, by_rig=by_rig, shares=shares)


def averaged(found: Predicted, rig: Rig, middle_s: float, *, has_rotations: bool) -> SampleRows:
    """Return the weighted means of the samples of every interval, with their Jacobians."""
    starts = np.flatnonzero(np.diff(found.knots, prepend=-1))
    knots = found.knots[starts]
    count = np.diff(np.append(starts, len(found.knots)))
    of_position, position_scale = _weights(found.position_errors)
    of_rotation, rotation_scale = _weights(found.rotation_errors)

    def means(weights: Floats, *columns: Floats) -> list[Floats]:
        flat = np.hstack([each.reshape(len(weights), -1) for each in columns])
        sums = np.add.reduceat(flat * weights[:, None], starts, axis=0)
        parts = np.split(sums / total(weights)[:, None], np.cumsum(
            [each[0].size for each in columns])[:-1], axis=1)  # fmt: skip
        pairs = zip(parts, columns, strict=True)
        return [part.reshape(len(starts), *column.shape[1:]) for part, column in pairs]

    def total(weights: Floats) -> Floats:
        return np.maximum(np.add.reduceat(weights, starts), 1e-12)

    tau, turned = found.since_s, found.turned
    arms = found.moved + times(turned, rig.lever)
    error, tau1, tau2, arm, turn, tau_turn, speed = means(
        of_position, found.position_errors, tau, tau**2, arms, turned, tau[..., None] * turned,
        found.marker_velocities,
    )  # fmt: skip
    by_state, by_rig = np.zeros((len(knots), 6, 15)), np.zeros((len(knots), 6, 10))
    start, unit = rig.rotations[knots], np.eye(3)
    by_state[:, :3, 0:3] = -start @ so3.skew(arm)
    by_state[:, :3, 3:6] = tau1[..., None] * unit
    by_state[:, :3, 6:9] = unit
    by_state[:, :3, 9:12] = start @ tau_turn @ so3.skew(rig.lever)
    by_state[:, :3, 12:15] = -0.5 * tau2[..., None] * start
    by_rig[:, :3, LEVER] = start @ turn
    by_rig[:, :3, OFFSET] = speed
    by_rig[:, :3, GRAVITY] = 0.5 * tau2[..., None] * tangents(rig.gravity)
    residuals = np.concatenate([error, np.zeros_like(error)], axis=1)
    if has_rotations:
        error, tau1, turn, rate = means(
            of_rotation, found.rotation_errors, tau, turned, found.rates
        )
        back = so3.inverse_left_jacobian(-error)
        into = back @ rig.body.T
        residuals[:, 3:] = error
        by_state[:, 3:, 0:3] = into @ transposed(turn)
        by_state[:, 3:, 9:12] = -into * tau1[..., None]
        by_rig[:, 3:, BODY] = back
        by_rig[:, 3:, OFFSET] = times(into, rate)
    by_rig[:, :, SKEW] = by_rig[:, :, OFFSET] * (found.seconds[starts] - middle_s)[:, None]
    usual = float(np.median(count))
    shares = np.stack([total(of_position), total(of_rotation) * has_rotations], axis=1)
    return SampleRows(
        knots, residuals, by_state, by_rig,
        np.repeat(np.minimum(shares / usual, 1.0), 3, axis=1),
        np.array([position_scale, rotation_scale]),
    )  # fmt: skip


def _weights(errors: Floats) -> tuple[Floats, float]:
    """Return weights (S,) of errors (S, 3), and their robust standard deviation per axis."""
    lengths = np.linalg.norm(errors, axis=1)
    scale = max(float(np.median(lengths)) / _MEDIAN_OF_CHI3, _LEAST_SCALE)
    ratio = np.maximum(lengths / (_HUBER * scale), 1.0)
    return np.where(ratio < _HUBER, 1.0, _REJECTED) / ratio, scale
