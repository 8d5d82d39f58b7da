"""The groundtruth's samples as one measurement per knot.

A sample at the time tau after knot k is compared with R = R_k dR and p = p_k + v_k tau + g tau^2/2
+ R_k dp, where dR and dp are integrated from the IMU:

    e_p = p + R l - p_s        e_R = Log(R_s^T R R_IM)

All samples of an interval are averaged with robust weights. The rate of the groundtruth therefore
has no effect on the size of the problem, and its noise may be correlated within an interval.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trajeval_ros.calibration.groundtruth_quality.inertial_steps import InertialSteps, Motions
from trajeval_ros.calibration.groundtruth_quality.rig import (
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
from trajeval_ros.geometry.banded_matrices import AT_ONCE
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
    rotated: Floats  # (S, 3, 3), dR
    moved: Floats  # (S, 3), dp
    rotations: Floats  # (S, 3, 3), R_WI
    positions: Floats  # (S, 3), p_WI
    velocities: Floats  # (S, 3), of I
    rates: Floats  # (S, 3), angular velocities in I


class Predicted(NamedTuple):
    """Residuals of the S samples between the knots, and what their Jacobians are made of."""

    rows: Indices  # (S,), in the groundtruth
    knots: Indices  # (S,), the knot before
    since_s: Floats  # (S, 1), tau
    rotated: Floats  # (S, 3, 3), dR
    arms: Floats  # (S, 3), dp + dR l
    marker_velocities: Floats  # (S, 3)
    rates: Floats  # (S, 3), angular velocities in I
    position_errors: Floats  # (S, 3), in W
    rotation_errors: Floats  # (S, 3), in M


def predict(samples: TruthSamples, steps: InertialSteps, motions: Motions, rig: Rig) -> Predicted:
    """Return all samples between the first and the last knot, compared with the rig."""
    groundtruth_s = samples.seconds
    seconds = groundtruth_s + rig.offset_s + rig.skew * (groundtruth_s - samples.middle_s)
    inside = np.flatnonzero((seconds >= steps.knots[0]) & (seconds < steps.knots[-1]))

    def at(rows: Indices) -> Predicted:
        result = rig_at(seconds[rows], steps, motions, rig)
        rotated, measured = result.rotations, lie.to_matrix(samples.quaternions[rows])
        return Predicted(
            rows,
            result.knots,
            result.since_s,
            result.rotated,
            result.moved + times(result.rotated, rig.lever),
            result.velocities + times(rotated, np.cross(result.rates, rig.lever)),
            result.rates,
            result.positions + times(rotated, rig.lever) - samples.positions[rows],
            so3.log(transposed(measured) @ rotated @ rig.body),
        )

    return Predicted(*lie.by_blocks(at, inside))


def rig_at(seconds: Floats, steps: InertialSteps, motions: Motions, rig: Rig) -> RigStates:
    """Return the rig at times (S,) of the IMU."""
    knots = np.clip(np.searchsorted(steps.knots, seconds, "right") - 1, 0, len(steps.knots) - 2)
    place = np.searchsorted(steps.times, seconds, "right") - 1 - steps.first[knots]
    at = knots, np.clip(place, 0, steps.held.shape[1] - 1)
    tau = (seconds - steps.knots[knots])[:, None]
    part = tau - steps.starts[at][:, None]
    rates = steps.rates[at] - rig.biases[knots, :3]
    before, start = motions.rotations[at], rig.rotations[knots]
    force = times(before, steps.accelerations[at] - rig.biases[knots, 3:])
    moved = motions.positions[at] + motions.velocities[at] * part + 0.5 * force * part**2
    rotated = before @ so3.exp(rates * part)
    positions = rig.positions[knots] + rig.velocities[knots] * tau + 0.5 * rig.gravity * tau**2
    velocities = rig.velocities[knots] + rig.gravity * tau
    velocities = velocities + times(start, motions.velocities[at] + force * part)
    positions = positions + times(start, moved)
    return RigStates(knots, tau, rotated, moved, start @ rotated, positions, velocities, rates)


@dataclass(frozen=True, eq=False)
class SampleRows:
    """The measurements of Q knots: three rows of position, then three of rotation."""

    knots: Indices  # (Q,)
    by_state: Floats  # (Q, 6, 15)
    by_rig: Floats  # (Q, 6, 11), by the calibration; the last column has the residuals
    shares: Floats  # (Q, 6), information relative to a usual interval
    scales: tuple[float, float]  # robust standard deviation of a sample, m and rad

    @property
    def residuals(self) -> Floats:
        """Residuals (Q, 6), m and rad."""
        return self.by_rig[..., -1]

    def weighted(self, sigmas: Floats) -> Iterator[tuple[Indices, Floats, Floats]]:
        """Yield parts of knots and rows over the standard deviations (6,) of measurements."""
        for start in range(0, len(self.knots), AT_ONCE):
            part = slice(start, start + AT_ONCE)
            weights = (np.sqrt(self.shares[part]) / sigmas)[..., None]
            yield self.knots[part], self.by_state[part] * weights, self.by_rig[part] * weights

    def average_rotations(self, rig: Rig, width: int) -> None:
        """Replace the rotations by one per window of knots, at the knot in its middle.

        The estimated rotation carries the errors of the other knots there.
        """
        window = self.knots // width
        starts = np.flatnonzero(np.diff(window, prepend=-1))
        middles = np.minimum(window * width + width // 2, len(rig.rotations) - 1)
        carried = self.by_state[:, 3:, :3] @ transposed(rig.rotations[self.knots])
        carried = carried @ rig.rotations[middles]
        columns = np.concatenate([carried, self.by_rig[:, 3:]], axis=2)
        means = _means(columns, self.shares[:, 3], starts, _REJECTED)
        places = np.minimum(np.searchsorted(self.knots, middles[starts]), len(self.knots) - 1)
        has_middle = self.knots[places] == middles[starts]
        places, means = places[has_middle], means[has_middle]
        count = np.diff(np.append(starts, len(self.knots)))[has_middle]
        self.by_state[:, 3:], self.shares[:, 3:] = 0.0, 0.0
        self.by_state[places, 3:, :3], self.by_rig[places, 3:] = means[..., :3], means[..., 3:]
        self.shares[places, 3:] = (count / width)[:, None]


def averaged(result: Predicted, rig: Rig, samples: TruthSamples) -> SampleRows:
    """Return the weighted means of the samples of every interval, with their Jacobians."""
    starts = np.flatnonzero(np.diff(result.knots, prepend=-1))
    ends = np.append(starts[1:], len(result.knots))
    of_position, position_scale = _weights(result.position_errors)
    of_rotation, rotation_scale = _weights(result.rotation_errors)
    usual, unit = float(np.median(ends - starts)), np.eye(3)

    def rows(starts: Indices, ends: Indices) -> tuple[Floats | Indices, ...]:
        part = slice(starts[0], ends[-1])
        predicted = Predicted._make(item[part] for item in result)
        starts = starts - starts[0]
        knots, tau = predicted.knots[starts], predicted.since_s
        start = rig.rotations[knots]
        by_state, by_rig = np.zeros((len(knots), 6, 15)), np.zeros((len(knots), 6, 11))
        error, tau1, tau2, arm, rotation, tau_turn, speed = (
            _means(item, of_position[part], starts)
            for item in (
                predicted.position_errors, tau, tau**2, predicted.arms, predicted.rotated,
                tau[..., None] * predicted.rotated, predicted.marker_velocities,
            )
        )  # fmt: skip
        by_state[:, :3, 0:3] = -start @ so3.skew(arm)
        by_state[:, :3, 3:6] = tau1[..., None] * unit
        by_state[:, :3, 6:9] = unit
        by_state[:, :3, 9:12] = start @ tau_turn @ so3.skew(rig.lever)
        by_state[:, :3, 12:15] = -0.5 * tau2[..., None] * start
        by_rig[:, :3, LEVER] = start @ rotation
        by_rig[:, :3, OFFSET], by_rig[:, :3, -1] = speed, error
        by_rig[:, :3, GRAVITY] = 0.5 * tau2[..., None] * tangents(rig.gravity)
        error, tau1, rotation, rate = (
            _means(item, of_rotation[part], starts)
            for item in (predicted.rotation_errors, tau, predicted.rotated, predicted.rates)
        )
        back = so3.inverse_left_jacobian(-error)
        into = back @ rig.body.T
        by_state[:, 3:, 0:3] = into @ transposed(rotation)
        by_state[:, 3:, 9:12] = -into * tau1[..., None]
        by_rig[:, 3:, BODY] = back
        by_rig[:, 3:, OFFSET], by_rig[:, 3:, -1] = times(into, rate), error
        since_s = samples.seconds[predicted.rows[starts]] - samples.middle_s
        by_rig[:, :, SKEW] = by_rig[:, :, OFFSET] * since_s[:, None]
        weights = np.stack([of_position[part], of_rotation[part] * samples.has_rotations], axis=1)
        shares = np.minimum(np.add.reduceat(weights, starts) / usual, 1.0)
        return knots, by_state, by_rig, np.repeat(shares, 3, axis=1)

    knots, by_state, by_rig, shares = lie.by_blocks(rows, starts, ends)
    return SampleRows(knots, by_state, by_rig, shares, (position_scale, rotation_scale))


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
