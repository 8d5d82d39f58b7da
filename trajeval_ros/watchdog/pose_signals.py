"""Signals of poses: jumps, freezes, repetitions, gaps, and corrections of the map."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.geometry.interpolation import columns_at
from trajeval_ros.metrics.absolute_errors import lengths
from trajeval_ros.watchdog.rotations_over_time import between
from trajeval_ros.watchdog.row_buffer import (
    HALF_NS,
    POSE_WIDTH,
    POSITION,
    QUATERNION,
    REMEMBERED_S,
    SINCE,
    TIME,
    RowBuffer,
    only,
    window_begins,
)
from trajeval_ros.watchdog.signals import Readings, Signals, finite

_USUAL_S, _LATELY_S = 10.0, 1.0
_MOVING_MPS = 0.05
_REPEATED_S, _MOVED = 2.0, 0.1  # s; m, rad
_SAME = 1e-9  # m, rad
_CORRECTION_S = 1.0

# Columns of a step, from one state to the next, after `TIME` and `SINCE`: differences from motion
# at constant velocity (m, deg), speed (m/s) and duration (s); time of the last motion, whether it
# ended abruptly, and the number of repetitions that followed a motion so far.
_INNOVATION, _TURN_INNOVATION, _SPEED, _DT = range(2, 6)
_STOP_T, _STOP_HARD, _REPEATS = 6, 7, 8
_WIDTH = 9


class PoseSignals:
    """Computes signals of jumps, smoothness, freezes, repetitions and gaps, state by state."""

    def __init__(self, period_s: float) -> None:
        """Create it without states; `period_s` is the usual time between them."""
        self._period_s = period_s
        self._usual = max(3, int(_USUAL_S / period_s))
        self._lately = max(3, int(_LATELY_S / period_s))
        self._states = RowBuffer(POSE_WIDTH)
        self._steps = RowBuffer(_WIDTH)

    def add(self, rows: Floats) -> Signals:
        """Add states (N, 9 or more); return the signals at them."""
        old = len(self._states.rows)
        self._states.append(rows[:, :POSE_WIDTH])
        states = self._states.rows
        known = len(self._steps.rows)
        self._steps.append(self._new_steps(states, old))
        self._mark_stops(known)
        signals = self._signals(known)
        keep_s = 2.0 * _USUAL_S
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
        return steps[old - begin :]

    def _mark_stops(self, first: int) -> None:
        """Fill in, for new steps, what is known about the last motion, and the repetitions."""
        steps = self._steps.rows
        new = np.arange(first, len(steps))
        same = steps[new, _STOP_HARD] == 1.0
        was_moving = bool(first) and steps[first - 1, _STOP_T] == steps[first - 1, TIME]
        follows = np.concatenate([[was_moving], ~same[:-1]])
        before = steps[first - 1, _REPEATS] if first else 0.0
        steps[new, _REPEATS] = before + np.cumsum(same & follows)
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
            "repeats": finite(times, self._repeats(first)),
            "gap": finite(times, fresh[:, _DT] / self._period_s),
        }

    def _repeats(self, first: int) -> Floats:
        """Return how often the steps from `first` on went from motion to a repeated pose, in 2 s.

        The robot must have moved in this time: wheel odometry repeats its pose at rest.
        """
        steps, states = self._steps.rows, self._states.rows
        old = len(states) - (len(steps) - first)
        begins, known = window_begins(states, old, _REPEATED_S)
        moved = lengths(states[old:, POSITION] - states[begins, POSITION])
        turned = lie.angle(between(states[begins, QUATERNION], states[old:, QUATERNION]))
        past, both = window_begins(steps, first, _REPEATED_S)
        repeats = steps[first:, _REPEATS] - steps[past, _REPEATS]
        is_moving = known & both & ((moved > _MOVED) | (turned > _MOVED))
        return np.where(is_moving, repeats, 0.0)

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


class CorrectionSignals:
    """Compares the transform from the map with the transform 1 s earlier, at the robot.

    If the robot's position in the estimate's frame is p, its position in the map is T p. A
    correction from T' to T moves the robot by T p - T' p and rotates it by the angle of T'^-1 T. A
    transform is valid until the next one.
    """

    def __init__(self) -> None:
        self._states = RowBuffer(POSE_WIDTH)
        self._transforms = RowBuffer(POSE_WIDTH)
        self._done = -np.inf

    def add(self, rows: Floats) -> Signals:
        """Add states (N, 9 or more); return the signals at transforms up to the last state."""
        self._states.append(rows[:, :POSE_WIDTH])
        self._states.forget_until(rows[-1, TIME] - REMEMBERED_S)
        return self._advance()

    def add_other(self, rows: Floats) -> Signals:
        """Add transforms (N, 9); return the signals at transforms up to the last state."""
        self._transforms.append(rows)
        self._transforms.forget_until(rows[-1, TIME] - REMEMBERED_S)
        return self._advance()

    def _advance(self) -> Signals:
        states, rows = self._states.rows, self._transforms.rows
        if not len(states):
            return {}
        first = int(np.searchsorted(rows[:, TIME], self._done, side="right"))
        ready = int(np.searchsorted(rows[:, TIME], states[-1, TIME], side="right"))
        if first >= ready:
            return {}
        new = rows[first:ready]
        times = new[:, TIME]
        robot = columns_at(states[:, TIME], states[:, POSITION], times)
        since = times - _CORRECTION_S + HALF_NS
        before = np.searchsorted(rows[:, TIME], since, side="right") - 1
        old = rows[np.maximum(before, 0)]
        moved = lengths(_in_map(new, robot) - _in_map(old, robot))
        turned = np.degrees(lie.angle(between(old[:, QUATERNION], new[:, QUATERNION])))
        signals = {
            "map_correction_m_1s": finite(times, only(moved, before >= 0)),
            "map_correction_deg_1s": finite(times, only(turned, before >= 0)),
        }
        self._done = float(times[-1])
        self._states.forget_until(self._done)
        self._transforms.forget_until(self._done - _CORRECTION_S)
        return signals


def _in_map(transforms: Floats, positions: Floats) -> Floats:
    """Return positions (N, 3) of the estimate, transformed to the map by transforms (N, 9)."""
    moved: Floats = lie.rotate(transforms[:, QUATERNION], positions) + transforms[:, POSITION]
    return moved
