"""Signals of an estimate against an IMU: rotation, clock, gravity, and drift at rest."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.watchdog.inertial_mounting import (
    ACCELERATION,
    FARTHEST_S,
    GYRO,
    IMU_WIDTH,
    Mounting,
    mounting_of,
    turned_by_gyro,
)
from trajeval_ros.watchdog.recent import (
    POSE_WIDTH,
    POSITION,
    QUATERNION,
    SINCE,
    TIME,
    Recent,
    interpolated,
    lengths,
    only,
    window_begins,
)
from trajeval_ros.watchdog.rotations_over_time import angles_deg, between, slerp_at
from trajeval_ros.watchdog.signals import WINDOWS_S, Signals, finite

_FEWEST = 20
_RATE_S, _SLIP_S = 0.25, 10.0
_LEAST_SLOPE = 0.02  # mean square of the turn rate's slope, (rad/s^2)^2
_VELOCITY_S = 0.1
_STILL_S, _STILL_MPS2, _STILL_RADPS = 1.0, 0.25, 0.02
_KEPT_S = WINDOWS_S[-1] + 12.0
# Columns of IMU rows after the measurements: orientation integrated from the gyroscope, whether
# the IMU is at rest, and the integral of the specific force in the estimate's world frame.
_TRACK, _STILL, _FORCE = slice(8, 12), 12, slice(13, 16)
_IMU_WIDTH = 16
# Columns of states after the pose: orientation of the body by the gyroscope, running sums of
# products and squares for the clock slip, velocity, and integral of the specific force.
_BODY, _PRODUCT, _SQUARE, _MOVING, _SUMMED = slice(9, 13), 13, 14, slice(15, 18), slice(18, 21)
_RATE, _OWN_RATE, _AT_REST = 21, 22, 23
_STATE_WIDTH = 24


class InertialSignals:
    """Compares states with an IMU; both may arrive in any order.

    Attributes:
        notices: Findings at the start, one sentence each.
        usable: Whether the IMU can be compared.
    """

    def __init__(self, period_s: float, armed_s: float) -> None:
        """Create it; the mounting is estimated once the IMU's data reach the time of arming.

        Args:
            period_s: Usual time between states.
            armed_s: Time of arming; later data are not used for the mounting.
        """
        self.notices: list[str] = []
        self.usable = True
        self._period_s, self._armed_s = period_s, armed_s
        self._mounting: Mounting | None = None
        self._waiting = Recent(POSE_WIDTH)
        self._raw = Recent(IMU_WIDTH)
        self._imu = Recent(_IMU_WIDTH)
        self._rows = Recent(_STATE_WIDTH)
        self._slip_s = 0.0
        self._gravity: dict[float, Floats] = {}

    def add_inertial(self, rows: Floats) -> Signals:
        """Add rows of the IMU (N, 8); return the signals at states that the IMU covers."""
        if not self.usable:
            return {}
        self._raw.remember(rows)
        return self._advance()

    def add(self, rows: Floats) -> Signals:
        """Add states (N, 9 or more); return the signals at states that the IMU covers."""
        if not self.usable:
            return {}
        self._waiting.remember(rows[:, :POSE_WIDTH])
        return self._advance()

    def _advance(self) -> Signals:
        states, raw = self._waiting.rows, self._raw.rows
        if not len(states) or len(raw) < 2:
            return {}
        if self._mounting is None:
            late = self._armed_s + 2.0 * FARTHEST_S
            if raw[-1, TIME] < late or states[-1, TIME] < self._armed_s:
                return {}
            if not self._find_mounting():
                return {}
        return self._judge()

    def _find_mounting(self) -> bool:
        """Estimate the mounting from the data before arming; return whether it succeeded."""
        states, raw = self._waiting.rows, self._raw.rows
        before = states[states[:, TIME] < self._armed_s]
        imu = raw[raw[:, TIME] < self._armed_s + 2.0 * FARTHEST_S]
        inside = (before[:, TIME] > imu[0, TIME] + 1.0) if len(imu) else np.zeros(len(before))
        if np.count_nonzero(inside) < _FEWEST:
            self.usable = False
            self.notices.append(
                "too little IMU data during the motion before arming: the IMU is not compared"
            )
            return False
        mounting = mounting_of(before, imu)
        if not mounting.is_related:
            self.usable = False
            self.notices.append(
                "rotations of IMU and estimate do not agree for any axes and clock offsets "
                "within 0.5 s: the IMU is not compared; check that it is of this robot and "
                "has the same clock"
            )
            return False
        self.notices += mounting.remarks()
        self._mounting = mounting
        return True

    def _judge(self) -> Signals:
        """Return the signals at the new states that the IMU covers."""
        mounting = self._mounting
        assert mounting is not None
        waiting, raw = self._waiting.rows, self._raw.rows
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
        self._add_rates(old)
        if not self._gravity:
            self._find_references(mounting)
        signals = self._signals(mounting, old)
        now = float(new[-1, TIME])
        self._waiting.forget(now)
        self._rows.forget(now - _KEPT_S)
        self._imu.forget(now + mounting.offset_s - 2.0)
        self._raw.forget(now + mounting.offset_s - 2.0)
        return signals

    def _add_inertial_rows(self, mounting: Mounting, until: float) -> None:
        """Integrate the readings until the first one after a time of the estimate's clock."""
        raw, waiting = self._raw.rows, self._waiting.rows
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
        rows[:, _TRACK] = turned_by_gyro(part, mounting.bias, first)
        at = np.clip(part[:, TIME] - mounting.offset_s, waiting[0, TIME], waiting[-1, TIME])
        body = slerp_at(waiting[:, TIME], waiting[:, QUATERNION], at)
        sensor = lie.multiply(body, mounting.rotation[None])
        force = lie.rotate(sensor, part[:, ACCELERATION])
        steps = 0.5 * (force[1:] + force[:-1]) * np.diff(part[:, TIME])[:, None]
        start = known[-1, _FORCE] if len(known) else np.zeros(3)
        rows[:, _FORCE] = np.concatenate([start[None], start + np.cumsum(steps, axis=0)])
        self._imu.append(rows[1:] if len(known) else rows)
        self._mark_still(mounting, len(rows) - (1 if len(known) else 0))

    def _mark_still(self, mounting: Mounting, count: int) -> None:
        """Mark which of the latest `count` readings end a second at rest."""
        rows = self._imu.rows
        first = len(rows) - count
        begins, known = window_begins(rows, first, _STILL_S)
        ends = np.arange(first, len(rows)) + 1
        turn = lengths(rows[:, GYRO] - mounting.bias)
        # Deviations from the mean avoid cancellation in the difference of squares.
        force = rows[:, ACCELERATION] - rows[:, ACCELERATION].mean(axis=0)
        sums = np.concatenate(
            [np.zeros((1, 7)), np.cumsum(np.column_stack([force, force**2, turn]), axis=0)]
        )
        mean = (sums[ends] - sums[begins]) / (ends - begins)[:, None]
        variance = np.sum(mean[:, 3:6] - mean[:, :3] ** 2, axis=1)
        still = (variance < _STILL_MPS2**2) & (mean[:, 6] < _STILL_RADPS)
        rows[first:, _STILL] = known & still

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
        rows[:, _SUMMED] = interpolated(times, imu[:, _FORCE], late)
        before = np.maximum(np.searchsorted(times, at, side="right") - 1, 0)
        rows[:, _AT_REST] = imu[before, _STILL]
        return rows

    @property
    def _velocity_rows(self) -> int:
        return max(1, round(_VELOCITY_S / self._period_s))

    def _add_rates(self, first: int) -> None:
        """Fill in the turn rates of both, running sums for the clock slip, and velocities."""
        rows = self._rows.rows
        own = rows[first:]
        begins, known = window_begins(rows, first, _RATE_S)
        span = np.maximum(own[:, TIME] - rows[begins, TIME], 1e-3)
        for column, quaternion in ((_OWN_RATE, QUATERNION), (_RATE, _BODY)):
            turn = lie.angle(between(rows[begins, quaternion], own[:, quaternion]))
            rows[first:, column] = np.where(known, turn / span, 0.0)
        before = max(first - 1, 0)
        rate, dt = rows[before:, _RATE], np.diff(rows[before:, TIME])
        slope = np.zeros(len(own))
        slope[len(own) - len(dt) :] = np.diff(rate) / dt
        off = own[:, _OWN_RATE] - own[:, _RATE]
        for column, terms in ((_PRODUCT, off * slope), (_SQUARE, slope**2)):
            start = rows[first - 1, column] if first else 0.0
            rows[first:, column] = start + np.cumsum(np.where(known, terms, 0.0))
        count = self._velocity_rows
        ends = np.arange(first, len(rows))
        begins = np.maximum(ends - count, 0)
        span = rows[ends, TIME] - rows[begins, TIME]
        known = (ends >= count) & (rows[begins, TIME] >= rows[ends, SINCE])
        moved = rows[ends, POSITION] - rows[begins, POSITION]
        velocity = moved / np.where(known, span, np.nan)[:, None]
        rows[first:, _MOVING] = velocity

    def _slip(self, first: int) -> tuple[Floats, Floats]:
        """Return the clock slip, s, and the mean square of the turn rate's slope, (rad/s^2)^2.

        The slip is the time offset in addition to that of the mounting. It is the regression
        coefficient, over 10 s, of the difference of the turn rates on the slope of the turn rate.
        """
        rows = self._rows.rows
        begins, known = window_begins(rows, first, _SLIP_S)
        product = rows[first:, _PRODUCT] - rows[begins, _PRODUCT]
        square = rows[first:, _SQUARE] - rows[begins, _SQUARE]
        slope = square * self._period_s / _SLIP_S
        slip = product / np.where(square > 0.0, square, np.nan)
        return only(slip, known), only(slope, known)

    def _specific_gravity(self, first: int, window_s: float) -> Floats:
        """Return mean(R a) - dv/dt over windows, (N, 3), m/s^2: minus gravity in the world frame.

        R a is the IMU's specific force in the world frame, v the velocity of the estimate.
        """
        rows = self._rows.rows
        begins, known = window_begins(rows, first, window_s)
        own = rows[first:]
        span = np.where(known, own[:, TIME] - rows[begins, TIME], np.nan)
        force = own[:, _SUMMED] - rows[begins, _SUMMED]
        gained = own[:, _MOVING] - rows[begins, _MOVING]
        gravity: Floats = (force - gained) / span[:, None]
        return gravity

    def _find_references(self, mounting: Mounting) -> None:
        """Compute the reference values of slip and gravity from the data before arming."""
        before = self._rows.rows[:, TIME] < self._armed_s
        slip, slope = self._slip(0)
        seen = before & (slope > _LEAST_SLOPE)
        self._slip_s = float(np.median(slip[seen])) if seen.any() else 0.0
        for window_s in WINDOWS_S[:2]:
            gravity = self._specific_gravity(0, window_s)[before]
            known = np.isfinite(gravity[:, 0]) & (mounting.axis is None)
            reference = np.median(gravity[known], axis=0) if known.any() else np.full(3, np.nan)
            self._gravity[window_s] = reference

    def _signals(self, mounting: Mounting, first: int) -> Signals:
        rows = self._rows.rows
        own, times = rows[first:], rows[first:, TIME]
        signals = {}
        for window_s in WINDOWS_S:
            begins, known = window_begins(rows, first, window_s)
            by_gyro = between(rows[begins, _BODY], own[:, _BODY])
            turned = between(rows[begins, QUATERNION], own[:, QUATERNION])
            off = angles_deg(between(by_gyro, turned), mounting.axis)
            signals[f"gyro_deg_{window_s:g}s"] = finite(times, only(off, known))
        slip, slope = self._slip(first)
        off_ms = np.where(slope > _LEAST_SLOPE, 1e3 * np.abs(slip - self._slip_s), 0.0 * slope)
        signals["gyro_slip_ms"] = finite(times, off_ms)
        for window_s, reference in self._gravity.items():
            gravity = self._specific_gravity(first, window_s)
            across = lengths(np.cross(gravity, reference))
            tilt_deg = np.degrees(np.arctan2(across, gravity @ reference))
            signals[f"gravity_deg_{window_s:g}s"] = finite(times, tilt_deg)
        signals["gravity_mps2_5s"] = finite(times, lengths(gravity - reference))
        begins, known = window_begins(rows, first, 1.0)
        moved = lengths(own[:, POSITION] - rows[begins, POSITION])
        signals["standstill_m"] = finite(
            times, only(np.where(own[:, _AT_REST] > 0.0, moved, 0.0), known)
        )
        return signals
