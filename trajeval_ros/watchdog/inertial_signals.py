"""Signals of an estimate against an IMU: rotation and gravity."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, lengths
from trajeval_ros.geometry.inertial import rotations_by_gyro
from trajeval_ros.geometry.interpolation import columns_at, slerp_at
from trajeval_ros.watchdog.inertial_mounting import (
    ACCELERATION,
    FARTHEST_S,
    GYRO,
    IMU_WIDTH,
    Mounting,
    mounting_of,
)
from trajeval_ros.watchdog.judging import judged
from trajeval_ros.watchdog.rotations_over_time import between
from trajeval_ros.watchdog.row_buffer import (
    POSE_WIDTH,
    POSITION,
    QUATERNION,
    SINCE,
    TIME,
    Comparison,
    RowBuffer,
    only,
    window_begins,
)
from trajeval_ros.watchdog.signals import Signals, finite

_FEWEST = 20
_GYRO_WINDOWS_S, _GRAVITY_S = (1.0, 20.0), 5.0
_VELOCITY_S = 0.1
_GRAVITY_FLOOR_RAD = np.radians(0.3)
_KEPT_S = _GYRO_WINDOWS_S[-1] + 2.0
# Columns of IMU rows after the measurements: orientation integrated from the gyroscope, and the
# integral of the specific force in the estimate's world frame.
_TRACK, _FORCE = slice(8, 12), slice(12, 15)
_IMU_WIDTH = 15
# Columns of states after the pose: orientation of the body by the gyroscope, velocity, and
# integral of the specific force.
_BODY, _MOVING, _SUMMED = slice(9, 13), slice(13, 16), slice(16, 19)
_STATE_WIDTH = 19


class InertialSignals(Comparison):
    """Compares states with an IMU."""

    def __init__(self, period_s: float, armed_s: float) -> None:
        """Create it; data until `armed_s` determine the mounting."""
        super().__init__(IMU_WIDTH)
        self._period_s, self._armed_s = period_s, armed_s
        self._mounting: Mounting | None = None
        self._imu = RowBuffer(_IMU_WIDTH)
        self._rows = RowBuffer(_STATE_WIDTH)
        self._gravity: Floats | None = None  # minus gravity before arming (3,), m/s^2

    def _advance(self) -> Signals:
        states, raw = self._states.rows, self._other.rows
        if not len(states) or len(raw) < 2:
            return {}
        if self._mounting is None:
            late = self._armed_s + 2.0 * FARTHEST_S
            if raw[-1, TIME] < late or states[-1, TIME] < self._armed_s:
                return {}
            if not self._find_mounting():
                return {}
        return self._covered_signals()

    def _find_mounting(self) -> bool:
        """Estimate the mounting from the data before arming; return whether it succeeded."""
        states, raw = self._states.rows, self._other.rows
        before = states[states[:, TIME] < self._armed_s]
        imu = raw[raw[:, TIME] < self._armed_s + 2.0 * FARTHEST_S]
        inside = (before[:, TIME] > imu[0, TIME] + 1.0) if len(imu) else np.zeros(len(before))
        if np.count_nonzero(inside) < _FEWEST:
            return self._refuse(
                "too little IMU data during the motion before arming: the IMU is not compared"
            )
        mounting = mounting_of(before, imu)
        if not mounting.is_related:
            return self._refuse(
                "rotations of IMU and estimate do not agree for any axes and clock offsets "
                "within 0.5 s: the IMU is not compared; check that it is of this robot and "
                "has the same clock"
            )
        self.notices += mounting.remarks()
        self._mounting = mounting
        return True

    def _covered_signals(self) -> Signals:
        """Return the signals at the new states that the IMU covers."""
        mounting = self._mounting
        assert mounting is not None
        waiting, raw = self._states.rows, self._other.rows
        done = self._rows.rows[-1, TIME] if len(self._rows.rows) else -np.inf
        first = int(np.searchsorted(waiting[:, TIME], done, side="right"))
        # Readings and states are interpolated, so both need data before and after.
        latest = float(waiting[-1, TIME]) + mounting.offset_s
        usable = int(np.searchsorted(raw[:, TIME], latest, side="right"))
        if not usable:
            return {}
        until = raw[usable - 1, TIME] - mounting.offset_s
        ready = int(np.searchsorted(waiting[:, TIME], until, side="right"))
        new = waiting[first:ready]
        new = new[new[:, TIME] + mounting.offset_s >= raw[0, TIME]]
        if not len(new):
            return {}
        self._add_inertial_rows(mounting, float(new[-1, TIME]))
        new = new[new[:, TIME] + mounting.offset_s >= self._imu.rows[0, TIME]]
        old = len(self._rows.rows)
        self._rows.append(self._rows_of(mounting, new))
        self._add_velocities(old)
        if self._gravity is None:
            self._find_gravity(mounting)
        signals = self._signals(mounting, old)
        now = float(new[-1, TIME])
        self._states.forget(now)
        self._rows.forget(now - _KEPT_S)
        self._imu.forget(now + mounting.offset_s - 2.0)
        self._other.forget(now + mounting.offset_s - 2.0)
        return signals

    def _add_inertial_rows(self, mounting: Mounting, until: float) -> None:
        """Integrate the readings until the first one after a time of the estimate's clock."""
        raw, waiting = self._other.rows, self._states.rows
        known = self._imu.rows
        begin = 0
        if len(known):
            begin = int(np.searchsorted(raw[:, TIME], known[-1, TIME]))  # the latest known row
        end = int(np.searchsorted(raw[:, TIME], until + mounting.offset_s)) + 1
        part = raw[begin:end]
        if len(part) < 2:
            return
        rows = np.zeros((len(part), _IMU_WIDTH))
        rows[:, :IMU_WIDTH] = part
        first = known[-1, _TRACK] if len(known) else np.array([0.0, 0.0, 0.0, 1.0])
        rows[:, _TRACK] = rotations_by_gyro(part[:, TIME], part[:, GYRO] - mounting.bias, first)
        at = np.clip(part[:, TIME] - mounting.offset_s, waiting[0, TIME], waiting[-1, TIME])
        body = slerp_at(waiting[:, TIME], waiting[:, QUATERNION], at)
        sensor = lie.multiply(body, mounting.rotation[None])
        force = lie.rotate(sensor, part[:, ACCELERATION])
        steps = 0.5 * (force[1:] + force[:-1]) * np.diff(part[:, TIME])[:, None]
        start = known[-1, _FORCE] if len(known) else np.zeros(3)
        rows[:, _FORCE] = np.concatenate([start[None], start + np.cumsum(steps, axis=0)])
        self._imu.append(rows[1:] if len(known) else rows)

    def _rows_of(self, mounting: Mounting, new: Floats) -> Floats:
        """Return states with the IMU's values at their times."""
        imu = self._imu.rows
        times = imu[:, TIME]
        at = new[:, TIME] + mounting.offset_s
        rows = np.zeros((len(new), _STATE_WIDTH))
        rows[:, :POSE_WIDTH] = new
        after = np.minimum(np.searchsorted(times, at), len(imu) - 1)
        rows[:, SINCE] = np.maximum(new[:, SINCE], imu[after, SINCE] - mounting.offset_s)
        track = slerp_at(times, imu[:, _TRACK], at)
        rows[:, _BODY] = lie.multiply(
            lie.multiply(mounting.rotation, track), lie.conjugate(mounting.rotation)
        )
        # A velocity is the mean over 0.1 s, so it is valid in the middle of that time.
        late = at - 0.5 * self._velocity_rows * self._period_s
        rows[:, _SUMMED] = columns_at(times, imu[:, _FORCE], late)
        return rows

    @property
    def _velocity_rows(self) -> int:
        return max(1, round(_VELOCITY_S / self._period_s))

    def _add_velocities(self, first: int) -> None:
        """Fill in the velocities, means over 0.1 s."""
        rows = self._rows.rows
        count = self._velocity_rows
        ends = np.arange(first, len(rows))
        begins = np.maximum(ends - count, 0)
        span = rows[ends, TIME] - rows[begins, TIME]
        known = (ends >= count) & (rows[begins, TIME] >= rows[ends, SINCE])
        moved = rows[ends, POSITION] - rows[begins, POSITION]
        rows[first:, _MOVING] = moved / np.where(known, span, np.nan)[:, None]

    def _specific_gravity(self, first: int) -> Floats:
        """Return mean(R a) - dv/dt over windows, (N, 3), m/s^2: minus gravity in the world frame.

        R a is the IMU's specific force in the world frame, v the velocity of the estimate.
        """
        rows = self._rows.rows
        begins, known = window_begins(rows, first, _GRAVITY_S)
        own = rows[first:]
        span = np.where(known, own[:, TIME] - rows[begins, TIME], np.nan)
        force = own[:, _SUMMED] - rows[begins, _SUMMED]
        gained = own[:, _MOVING] - rows[begins, _MOVING]
        gravity: Floats = (force - gained) / span[:, None]
        return gravity

    def _find_gravity(self, mounting: Mounting) -> None:
        """Compute gravity as the median before arming; NaN if it is not compared."""
        before = self._rows.rows[:, TIME] < self._armed_s
        gravity = self._specific_gravity(0)[before]
        known = np.isfinite(gravity[:, 0]) & (mounting.axis is None)
        self._gravity = np.median(gravity[known], axis=0) if known.any() else np.full(3, np.nan)

    def _signals(self, mounting: Mounting, first: int) -> Signals:
        rows = self._rows.rows
        own, times = rows[first:], rows[first:, TIME]
        signals = {}
        for window_s in _GYRO_WINDOWS_S:
            begins, known = window_begins(rows, first, window_s)
            by_gyro = between(rows[begins, _BODY], own[:, _BODY])
            rotated = between(rows[begins, QUATERNION], own[:, QUATERNION])
            off = lie.rotation_vector(between(by_gyro, rotated))
            if mounting.axis is not None:
                off = np.outer(off @ mounting.axis, mounting.axis)
            back = np.swapaxes(lie.to_matrix(by_gyro), 1, 2)
            jacobian = np.concatenate([window_s * back, np.eye(3) - back], axis=2)
            floor_rad = np.radians(0.1 + 0.02 * window_s)
            off_deg = np.degrees(judged(off, jacobian, mounting.covariance, floor_rad))
            signals[f"gyro_deg_{window_s:g}s"] = finite(times, only(off_deg, known))
        signals["gravity_mps2_5s"] = finite(times, self._gravity_error(mounting, first))
        return signals

    def _gravity_error(self, mounting: Mounting, first: int) -> Floats:
        """Return the change of gravity since arming, (N,), m/s^2.

        An error of the mounting tilts gravity, unless it is about the vertical: only its variance
        across gravity reduces the value, as in `judged`.
        """
        gravity, reference = self._specific_gravity(first), self._gravity
        assert reference is not None
        quaternions = self._rows.rows[first:, QUATERNION]
        up = lie.rotate(lie.conjugate(quaternions), np.broadcast_to(reference, gravity.shape))
        up = up / np.maximum(lengths(up), 1e-9)[:, None]
        spread = mounting.covariance[3:, 3:]
        variance = np.trace(spread) - np.einsum("ni,ij,nj->n", up, spread, up)
        share = _GRAVITY_FLOOR_RAD / np.sqrt(_GRAVITY_FLOOR_RAD**2 + np.maximum(variance, 0.0))
        error: Floats = lengths(gravity - reference) * share
        return error
