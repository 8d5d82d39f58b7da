"""Signals of the poses of the estimate: jumps, freezes, timestamps and speed."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.watchdog.recent import (
    POSE_WIDTH,
    POSITION,
    QUATERNION,
    SINCE,
    TIME,
    Recent,
    lengths,
    only,
    window_begins,
)
from trajeval_ros.watchdog.rotations_over_time import between
from trajeval_ros.watchdog.signals import Readings, Signals, finite

_USUAL_S, _LATELY_S = 10.0, 1.0
_MOVING_MPS = 0.05
_STEP_S = 0.5
_BEFORE_S = 5.0
_SLOWEST_TOP_MPS = 0.5
_SAME = 1e-9  # m, rad

# Columns of a step, from one state to the next, after `TIME` and `SINCE`: differences from motion
# at constant velocity (m, deg), speed (m/s), duration (s), and largest speed so far (m/s).
_INNOVATION, _TURN_INNOVATION, _SPEED, _DT, _TOP = range(2, 7)
_STOP_T, _STOP_HARD = 7, 8
_WIDTH = 9


class PoseSignals:
    """Computes signals of jumps, smoothness, freezes, timestamps and speed, state by state."""

    def __init__(self, period_s: float) -> None:
        """Create it without states.

        Args:
            period_s: Usual time between states.
        """
        self._period_s = period_s
        self._usual = max(3, int(_USUAL_S / period_s))
        self._lately = max(3, int(_LATELY_S / period_s))
        self._states = Recent(POSE_WIDTH)
        self._steps = Recent(_WIDTH)

    def add(self, rows: Floats) -> Signals:
        """Add states (N, 9 or more); return the signals at them."""
        old = len(self._states.rows)
        self._states.append(rows[:, :POSE_WIDTH])
        states = self._states.rows
        known = len(self._steps.rows)
        self._steps.append(self._new_steps(states, old))
        self._mark_stops(known)
        signals = self._signals(known)
        keep_s = 2.0 * _USUAL_S + _BEFORE_S
        latest = states[-1, TIME]
        self._states.forget(latest - keep_s)
        self._steps.forget(latest - keep_s - 3.0 * self._usual * self._period_s)
        return signals

    def _new_steps(self, states: Floats, old: int) -> Floats:
        """Return the steps that end at the states from index `old` on, (N, 9)."""
        begin = max(old - 2, 0)
        some = states[begin:]
        times = some[:, TIME]
        steps = np.full((len(some), _WIDTH), np.nan)
        steps[:, :2] = some[:, :2]
        if len(some) > 1:
            dt = np.diff(times)
            within = some[1:, SINCE] <= times[:-1]
            moved = np.diff(some[:, POSITION], axis=0)
            velocity = moved / dt[:, None]
            turned = lie.rotation_vector(between(some[:-1, QUATERNION], some[1:, QUATERNION]))
            rate = turned / dt[:, None]
            steps[1:, _SPEED] = only(lengths(velocity), within)
            steps[1:, _DT] = dt
            steps[1:, _STOP_HARD] = (lengths(moved) < _SAME) & (lengths(turned) < _SAME)
            both = within[1:] & within[:-1]
            steps[2:, _INNOVATION] = only(lengths(np.diff(velocity, axis=0)) * dt[1:], both)
            steps[2:, _TURN_INNOVATION] = only(
                np.degrees(lengths(np.diff(rate, axis=0))) * dt[1:], both
            )
        fresh = steps[old - begin :]
        fresh[:, _TOP] = self._speeds(states, old)
        return fresh

    def _speeds(self, states: Floats, old: int) -> Floats:
        """Return the largest speed so far, at the states from index `old` on, m/s.

        The speed is the mean over 0.5 s.
        """
        speeds = np.nan_to_num(self._mean_speed(states, old), nan=0.0)
        known = self._steps.rows
        largest = known[-1, _TOP] if len(known) else 0.0
        top: Floats = np.maximum.accumulate(np.concatenate([[largest], speeds]))[1:]
        return top

    @staticmethod
    def _mean_speed(states: Floats, old: int) -> Floats:
        begins, known = window_begins(states, old, _STEP_S)
        span = states[old:, TIME] - states[begins, TIME]
        moved = lengths(states[old:, POSITION] - states[begins, POSITION])
        return only(moved / np.where(span > 0.0, span, np.nan), known)

    def _mark_stops(self, first: int) -> None:
        """Fill in, for new steps, the time of the last motion and whether it ended abruptly."""
        steps = self._steps.rows
        new = np.arange(first, len(steps))
        same = steps[new, _STOP_HARD] == 1.0
        usual = self._median(_SPEED, new - 1, self._lately)
        speed = steps[new, _SPEED]
        hard = (speed > _MOVING_MPS) & (speed > 0.5 * usual)
        steps[new, _STOP_T] = np.where(same, np.nan, steps[new, TIME])
        steps[new, _STOP_HARD] = np.where(same, np.nan, hard)
        moving = np.where(same, first - 1, new)
        last = np.maximum(np.maximum.accumulate(moving), 0)
        steps[new, _STOP_T] = steps[last, _STOP_T]
        steps[new, _STOP_HARD] = steps[last, _STOP_HARD]

    def _signals(self, first: int) -> dict[str, Readings]:
        steps = self._steps.rows
        new = np.arange(first, len(steps))
        fresh = steps[new]
        times = fresh[:, TIME]
        usual = self._median(_INNOVATION, new - self._lately - 1, self._usual)
        lately = self._median(_INNOVATION, new, self._lately)
        speed = self._median(_SPEED, new, self._lately)
        smooth = np.maximum(usual, 1e-4) / np.maximum(lately, 1e-9)
        frozen = np.where(fresh[:, _STOP_HARD] == 1.0, times - fresh[:, _STOP_T], 0.0)
        return {
            "jump_m": finite(times, fresh[:, _INNOVATION]),
            "jump_deg": finite(times, fresh[:, _TURN_INNOVATION]),
            "smooth": finite(times, np.where(speed > _MOVING_MPS, smooth, 0.0 * speed)),
            "freeze_hard_s": finite(times, frozen),
            "gap": finite(times, fresh[:, _DT] / self._period_s),
            "jitter": finite(times, self._jitter(new)),
            "speed": finite(times, self._speed_ratio(first)),
        }

    def _jitter(self, rows: Indices) -> Floats:
        off = np.clip(
            self._window(_DT, rows, self._lately) - self._period_s, -self._period_s, self._period_s
        )
        jitter: Floats = np.sqrt(np.mean(np.square(off), axis=1)) / self._period_s
        return jitter

    def _speed_ratio(self, first: int) -> Floats:
        """Return the speed divided by the largest speed until 5 s earlier.

        The ratios are at the steps from index `first` on.
        """
        steps, states = self._steps.rows, self._states.rows
        new = steps[first:, TIME]
        speed = self._mean_speed(states, len(states) - len(new))
        before = np.searchsorted(steps[:, TIME], new - _BEFORE_S, side="right") - 1
        top = np.maximum(steps[np.maximum(before, 0), _TOP], _SLOWEST_TOP_MPS)
        return only(speed / top, before >= 0)

    def _window(self, column: int, last: Indices, count: int) -> Floats:
        """Return the values of a column in the `count` rows up to the given ones, (N, count).

        Rows before the first one are NaN.
        """
        values = self._steps.rows[:, column]
        places = last[:, None] + np.arange(1 - count, 1)
        return np.where(places >= 0, values[np.maximum(places, 0)], np.nan)

    def _median(self, column: int, last: Indices, count: int) -> Floats:
        median: Floats = np.median(self._window(column, last, count), axis=1)
        return median
