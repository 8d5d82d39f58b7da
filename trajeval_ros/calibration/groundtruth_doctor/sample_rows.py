"""The groundtruth's samples as one measurement per knot.

A sample at the time tau after knot k is compared with R = R_k dR and p = p_k + v_k tau + g tau^2/2
+ R_k dp, where dR and dp are integrated from the IMU:

    e_p = p + R l - p_s        e_R = Log(R_s^T R R_IM)

All samples of an interval are averaged with robust weights. The rate of the groundtruth therefore
has no effect on the size of the problem, and its noise may be correlated within an interval.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

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
from trajeval_ros.geometry import lie, so3
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.se3 import times, transposed

MEDIAN_OF_CHI3 = 1.538  # median length of a vector of three normal components
_HUBER = 3.0  # residuals above it (in sigma) have less weight, above three times it none
_REJECTED = 1e-8  # an interval with rejected samples alone stays regular
_LEAST_SCALE = 1e-6  # m, rad


@dataclass(frozen=True, eq=False)
class TruthSamples:
    """The groundtruth by seconds of its own clock, in order."""

    seconds: Floats  # (N,)
    positions: Floats  # (N, 3), metres
    quaternions: Floats  # (N, 4), of R_WM; rough if not measured
    has_rotations: bool  # whether they are measured

    @property
    def middle_s(self) -> float:
        """The time from which the clock's skew counts."""
        return float(0.5 * (self.seconds[0] + self.seconds[-1]))


class RigStates(NamedTuple):
    """The rig at S times between the knots."""

    knots: Indices  # (S,), the knot before
    since_s: Floats  # (S, 1), tau
    turned: Floats  # (S, 3, 3), dR
    moved: Floats  # (S, 3), dp
    rotations: Floats  # (S, 3, 3), R_WI
    positions: Floats  # (S, 3), p_WI
    velocities: Floats  # (S, 3), of I
    rates: Floats  # (S, 3), angular velocities in I


@dataclass(frozen=True, eq=False)
class Predicted:
    """The rig at the S samples between the knots, and residuals of the samples."""

    rows: Indices  # (S,), in the groundtruth
    states: RigStates
    marker_velocities: Floats  # (S, 3)
    position_errors: Floats  # (S, 3), in W
    rotation_errors: Floats  # (S, 3), in M


def predict(samples: TruthSamples, steps: InertialSteps, motions: Motions, rig: Rig) -> Predicted:
    """Return the rig at all samples between the first and the last knot."""
    own, skew = samples.seconds, rig.skew
    seconds = own + rig.offset_s + skew * (own - samples.middle_s)
    rows = np.flatnonzero((seconds >= steps.knots[0]) & (seconds < steps.knots[-1]))

    def at(rows: Indices) -> tuple[Floats | Indices, ...]:
        states = rig_at(seconds[rows], steps, motions, rig)
        turned, measured = states.rotations, lie.to_matrix(samples.quaternions[rows])
        return (
            *states,
            states.velocities + times(turned, np.cross(states.rates, rig.lever)),
            states.positions + times(turned, rig.lever) - samples.positions[rows],
            so3.log(transposed(measured) @ turned @ rig.body),
        )

    *states, speeds, positions, rotations = lie.by_blocks(at, rows)
    return Predicted(rows, RigStates(*states), speeds, positions, rotations)


def rig_at(seconds: Floats, steps: InertialSteps, motions: Motions, rig: Rig) -> RigStates:
    """Return the rig at times (S,) of the IMU."""
    knots = np.clip(np.searchsorted(steps.knots, seconds, "right") - 1, 0, len(steps.knots) - 2)
    place = np.searchsorted(steps.times, seconds, "right") - 1 - steps.first[knots]
    at = knots, np.clip(place, 0, steps.held.shape[1] - 1)
    tau = (seconds - steps.knots[knots])[:, None]
    part = tau - steps.starts[at][:, None]
    rates = steps.rates[at] - rig.gyro_biases[knots]
    before, start = motions.rotations[at], rig.rotations[knots]
    force = times(before, steps.accelerations[at] - rig.acceleration_biases[knots])
    moved = motions.positions[at] + motions.velocities[at] * part + 0.5 * force * part**2
    turned = before @ so3.exp(rates * part)
    positions = rig.positions[knots] + rig.velocities[knots] * tau + 0.5 * rig.gravity * tau**2
    velocities = rig.velocities[knots] + rig.gravity * tau
    velocities = velocities + times(start, motions.velocities[at] + force * part)
    positions = positions + times(start, moved)
    return RigStates(knots, tau, turned, moved, start @ turned, positions, velocities, rates)


@dataclass(frozen=True, eq=False)
class SampleRows:
    """The measurements of Q knots: three rows of position, then three of rotation."""

    knots: Indices  # (Q,)
    residuals: Floats  # (Q, 6)
    by_state: Floats  # (Q, 6, 15)
    by_rig: Floats  # (Q, 6, 10)
    shares: Floats  # (Q, 6), information relative to a usual interval
    scales: tuple[float, float]  # robust standard deviation of a sample, m and rad

    def weighted(self, sigmas: Floats) -> SampleRows:
        """Return the rows over the standard deviations (6,) of the measurements."""
        weights = np.sqrt(self.shares) / sigmas
        return replace(
            self,
            residuals=self.residuals * weights,
            by_state=self.by_state * weights[..., None],
            by_rig=self.by_rig * weights[..., None],
        )

    def average_rotations(self, rig: Rig, width: int) -> None:
        """Replace the rotations by one per window of knots, at the knot in its middle.

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
        means = _means(columns, weights, starts, _REJECTED)
        places = np.minimum(np.searchsorted(self.knots, middles[starts]), len(self.knots) - 1)
        has_middle = self.knots[places] == middles[starts]
        places, means = places[has_middle], means[has_middle]
        count = np.diff(np.append(starts, len(self.knots)))[has_middle]
        self.by_state[:, 3:], self.shares[:, 3:] = 0.0, 0.0
        self.residuals[places, 3:], self.by_state[places, 3:, :3] = means[..., 0], means[..., 1:4]
        self.by_rig[places, 3:], self.shares[places, 3:] = means[..., 4:], (count / width)[:, None]


def averaged(found: Predicted, rig: Rig, samples: TruthSamples) -> SampleRows:
    """Return the weighted means of the samples of every interval, with their Jacobians."""
    states, lever = found.states, rig.lever
    starts = np.flatnonzero(np.diff(states.knots, prepend=-1))
    knots = states.knots[starts]
    of_position, position_scale = _weights(found.position_errors)
    of_rotation, rotation_scale = _weights(found.rotation_errors)
    tau, turned = states.since_s, states.turned
    arms = states.moved + times(turned, lever)
    error, tau1, tau2, arm, turn, tau_turn, speed = (
        _means(each, of_position, starts)
        for each in (
            found.position_errors, tau, tau**2, arms, turned, tau[..., None] * turned,
            found.marker_velocities,
        )
    )  # fmt: skip
    by_state, by_rig = np.zeros((len(knots), 6, 15)), np.zeros((len(knots), 6, 10))
    start, unit = rig.rotations[knots], np.eye(3)
    by_state[:, :3, 0:3] = -start @ so3.skew(arm)
    by_state[:, :3, 3:6] = tau1[..., None] * unit
    by_state[:, :3, 6:9] = unit
    by_state[:, :3, 9:12] = start @ tau_turn @ so3.skew(lever)
    by_state[:, :3, 12:15] = -0.5 * tau2[..., None] * start
    by_rig[:, :3, LEVER] = start @ turn
    by_rig[:, :3, OFFSET] = speed
    by_rig[:, :3, GRAVITY] = 0.5 * tau2[..., None] * tangents(rig.gravity)
    turning, tau1, turn, rate = (
        _means(each, of_rotation, starts)
        for each in (found.rotation_errors, tau, turned, states.rates)
    )
    back = so3.inverse_left_jacobian(-turning)
    into = back @ rig.body.T
    by_state[:, 3:, 0:3] = into @ transposed(turn)
    by_state[:, 3:, 9:12] = -into * tau1[..., None]
    by_rig[:, 3:, BODY] = back
    by_rig[:, 3:, OFFSET] = times(into, rate)
    since_s = samples.seconds[found.rows[starts]] - samples.middle_s
    by_rig[:, :, SKEW] = by_rig[:, :, OFFSET] * since_s[:, None]
    usual = float(np.median(np.diff(np.append(starts, len(states.knots)))))
    weights = np.stack([of_position, of_rotation * samples.has_rotations], axis=1)
    totals = np.add.reduceat(weights, starts)
    return SampleRows(
        knots,
        np.concatenate([error, turning], axis=1),
        by_state,
        by_rig,
        np.repeat(np.minimum(totals / usual, 1.0), 3, axis=1),
        (position_scale, rotation_scale),
    )


def _means(columns: Floats, weights: Floats, starts: Indices, least: float = 1e-12) -> Floats:
    """Return weighted means of columns (S, ...) of the intervals from rows `starts` (Q,)."""
    shape = (-1, *[1] * (columns.ndim - 1))
    sums = np.add.reduceat(columns * weights.reshape(shape), starts)
    total = np.maximum(np.add.reduceat(weights, starts), least)
    return np.asarray(sums / total.reshape(shape))


def _weights(errors: Floats) -> tuple[Floats, float]:
    """Return weights (S,) of errors (S, 3), and their robust standard deviation per axis."""
    lengths = np.linalg.norm(errors, axis=1)
    scale = max(float(np.median(lengths)) / MEDIAN_OF_CHI3, _LEAST_SCALE)
    ratio = np.maximum(lengths / (_HUBER * scale), 1.0)
    return np.where(ratio < _HUBER, 1.0, _REJECTED) / ratio, scale
