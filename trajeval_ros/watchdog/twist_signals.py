"""Signals of a pose against its own message's twist: motion of the pose, less the integral."""

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
# A smaller one is noise of the search.
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
    """Compares displacements with the integral of the twist, by the twist's lag.

    Attributes:
        lag_s: By which the twist is later than the pose.
        notices: Findings at the start, one sentence each.
        usable: Whether there is anything to compare: a twist in the body's axes.
    """

    def __init__(self, before: Floats, period_s: float) -> None:
        """Find lag and axes.

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
        """Return the signals at the states that the twist has reached; rows are (N, 15)."""
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
        """Sum up the velocities, by the trapezoidal rule, in the estimate's world."""
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
    """Return times in the middle of steps, velocities there, and which are without a gap."""
    dt = np.diff(states[:, TIME])
    whole = states[1:, SINCE] <= states[:-1, TIME]
    velocity = np.diff(states[:, POSITION], axis=0)[whole] / dt[whole, None]
    middle = 0.5 * (states[1:, TIME] + states[:-1, TIME])[whole]
    return middle, velocity, np.flatnonzero(whole)


def _lag_of(states: Floats) -> float:
    """Return how much later than the pose the twist is, s: where speeds and turn rates fit best.

    Each counts by the spread of its difference over its own spread, so that a speed that is kept
    says little.
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
    """Return the median difference of the poses' velocities and the twist's, m/s."""
    middle, velocity, rows = _steps_of(states)
    told = interpolated(states[:, TIME], velocities, middle + lag_s)
    in_world = lie.rotate(states[rows, QUATERNION], told)
    return float(np.median(lengths(velocity - in_world)))
