"""Signals of the twist: displacements of the pose minus the integral of the twist."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.watchdog.recent import (
    POSITION,
    QUATERNION,
    RATE,
    SINCE,
    STATE_WIDTH,
    TIME,
    VELOCITY,
    Recent,
    change_within,
    interpolated,
    lengths,
    only,
    window_begins,
)
from trajeval_ros.watchdog.rotations_over_time import between
from trajeval_ros.watchdog.signals import WINDOWS_S, Signals, finite

_LAGS_S = np.arange(-0.5, 1.001, 0.025)
# A smaller lag is within the noise of its estimate.
_LEAST_LAG_S = 0.03
_TOLD_LAG_S = 0.05
_LEAST_SPREAD = 1e-6  # m/s, rad/s
_SCALE_S = 10.0
_SLOWEST_M = 0.05  # rms of displacements in 1 s
# Minimum ratio of residuals in body and world axes for a twist in world axes.
_CLEARLY = 3.0
_INTEGRAL = slice(STATE_WIDTH, STATE_WIDTH + 3)
_PRODUCT, _SQUARE = STATE_WIDTH + 3, STATE_WIDTH + 4


class TwistSignals:
    """Compares displacements with the integral of the twist, corrected for its lag.

    Attributes:
        lag_s: Lag of the twist relative to the pose, s.
        notices: Findings at the start, one sentence each.
        usable: Whether the twist is in the body frame, so that it can be compared.
    """

    def __init__(self, before: Floats, period_s: float) -> None:
        """Estimate the lag, and test in which frame the twist is.

        Args:
            before: (N, 15) states before arming, with velocities in the body.
            period_s: Usual time between states.
        """
        self.notices: list[str] = []
        self._least_square = _SLOWEST_M**2 * _SCALE_S / period_s
        self.lag_s = _lag_of(before)
        self._waiting = Recent(STATE_WIDTH)
        self._rows = Recent(_SQUARE + 1)
        self.usable = self._is_in_body(before)
        if abs(self.lag_s) > _TOLD_LAG_S:
            way = "later" if self.lag_s > 0.0 else "earlier"
            self.notices.append(
                f"the twist is {abs(self.lag_s):.2f} s {way} than the pose (corrected)"
            )

    def _is_in_body(self, before: Floats) -> bool:
        """Return whether the twist is in the body frame; add a notice if it is not."""
        in_body = _misfit(before, before[:, VELOCITY], self.lag_s)
        world = lie.rotate(lie.conjugate(before[:, QUATERNION]), before[:, VELOCITY])
        in_world = _misfit(before, world, self.lag_s)
        if in_world * _CLEARLY > in_body:
            return True
        self.notices.append(
            "the twist is in the world frame, not in child_frame_id as nav_msgs/Odometry "
            "requires, and is not compared; correct the estimator"
        )
        return False

    def add(self, rows: Floats) -> Signals:
        """Add states (N, 15); return the signals at states for which the twist has arrived."""
        self._waiting.append(rows)
        waiting = self._waiting.rows
        ready = int(
            np.searchsorted(
                waiting[:, TIME], waiting[-1, TIME] - max(self.lag_s, 0.0), side="right"
            )
        )
        done = self._rows.rows[-1, TIME] if len(self._rows.rows) else -np.inf
        first = int(np.searchsorted(waiting[:, TIME], done, side="right"))
        if first >= ready:
            return {}
        new = waiting[first:ready]
        velocities = interpolated(
            waiting[:, TIME], waiting[:, VELOCITY], new[:, TIME] + self.lag_s
        )
        old = len(self._rows.rows)
        self._rows.append(np.column_stack([new, np.zeros((len(new), 5))]))
        self._integrate(old, velocities)
        self._waiting.forget(new[-1, TIME] - abs(self.lag_s) - 1.0)
        signals = self._signals(old)
        self._rows.forget(new[-1, TIME] - 2.0 * _SCALE_S)
        return signals

    def _integrate(self, first: int, velocities: Floats) -> None:
        """Integrate the velocities in the estimate's world frame, by the trapezoidal rule.

        Also fill in the running sums for the scale signal.
        """
        rows = self._rows.rows
        rows[first:, VELOCITY] = lie.rotate(rows[first:, QUATERNION], velocities)
        begin = max(first - 1, 0)
        some = rows[begin:]
        steps = 0.5 * (some[1:, VELOCITY] + some[:-1, VELOCITY])
        steps *= np.diff(some[:, TIME])[:, None]
        rows[begin + 1 :, _INTEGRAL] = rows[begin, _INTEGRAL] + np.cumsum(steps, axis=0)
        _, known = window_begins(rows, first, 1.0)
        pose, twist = (
            change_within(rows, first, 1.0, columns) for columns in (POSITION, _INTEGRAL)
        )
        for column, values in (
            (_PRODUCT, np.sum(pose * twist, axis=1)),
            (_SQUARE, np.sum(twist * twist, axis=1)),
        ):
            before = rows[first - 1, column] if first else 0.0
            rows[first:, column] = before + np.cumsum(np.where(known, values, 0.0))

    def _signals(self, first: int) -> Signals:
        rows = self._rows.rows
        own, times = rows[first:], rows[first:, TIME]
        signals = {}
        for window_s in WINDOWS_S[:2]:
            _, known = window_begins(rows, first, window_s)
            pose, twist = (
                change_within(rows, first, window_s, columns) for columns in (POSITION, _INTEGRAL)
            )
            signals[f"twist_m_{window_s:g}s"] = finite(times, only(lengths(pose - twist), known))
        begins, known = window_begins(rows, first, _SCALE_S)
        product = own[:, _PRODUCT] - rows[begins, _PRODUCT]
        square = own[:, _SQUARE] - rows[begins, _SQUARE]
        enough = square > self._least_square
        off = np.abs(product / np.where(enough, square, 1.0) - 1.0)
        signals["twist_scale"] = finite(times, only(np.where(enough, off, 0.0), known))
        return signals


def _steps_of(states: Floats) -> tuple[Floats, Floats, Indices]:
    """Return the steps without a gap: middle times (M,), velocities (M, 3) and indices (M,)."""
    dt = np.diff(states[:, TIME])
    whole = states[1:, SINCE] <= states[:-1, TIME]
    velocity = np.diff(states[:, POSITION], axis=0)[whole] / dt[whole, None]
    middle = 0.5 * (states[1:, TIME] + states[:-1, TIME])[whole]
    return middle, velocity, np.flatnonzero(whole)


def _lag_of(states: Floats) -> float:
    """Return the lag of the twist, s, at which speeds and turn rates agree best.

    The cost is the standard deviation of the difference divided by that of the quantity itself,
    summed over both. A constant speed, which does not depend on the lag, then has little effect.
    """
    middle, velocity, rows = _steps_of(states)
    dt = (states[1:, TIME] - states[:-1, TIME])[rows]
    turns = lie.angle(between(states[:-1, QUATERNION], states[1:, QUATERNION]))[rows] / dt
    shown = [(lengths(velocity), lengths(states[:, VELOCITY]))]
    if np.isfinite(states[:, RATE]).all() and states[:, RATE].any():
        shown.append((turns, lengths(states[:, RATE])))

    def spread(lag: float) -> float:
        at = middle + lag
        off = [np.std(pose - np.interp(at, states[:, TIME], told)) for pose, told in shown]
        usual = [max(float(np.std(pose)), _LEAST_SPREAD) for pose, _ in shown]
        return float(np.sum(np.divide(off, usual)))

    lag = min(_LAGS_S.tolist(), key=spread)
    return lag if abs(lag) > _LEAST_LAG_S else 0.0


def _misfit(states: Floats, velocities: Floats, lag_s: float) -> float:
    """Return the median difference between velocities of the poses and of the twist, m/s."""
    middle, velocity, rows = _steps_of(states)
    told = interpolated(states[:, TIME], velocities, middle + lag_s)
    in_world = lie.rotate(states[rows, QUATERNION], told)
    return float(np.median(lengths(velocity - in_world)))
