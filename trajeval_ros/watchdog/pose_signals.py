"""Signals of poses: coasting, corrections of the map, and discontinuities."""

from __future__ import annotations

from collections import deque

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Indices, Stamps, lengths
from trajeval_ros.geometry.interpolation import columns_at
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.discontinuities.events import CLOCK_STEP, ESTIMATE, FREEZES, GAP, Event
from trajeval_ros.metrics.discontinuities.exoneration import GAP_PERIODS
from trajeval_ros.metrics.discontinuities.one_stream import KnownEvent, OneStream
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
)
from trajeval_ros.watchdog.signals import Readings, Signals, finite

_USUAL_S, _LATELY_S = 10.0, 1.0
_MOVING_MPS = 0.05
_SAME = 1e-9  # m
# Of encoders: a longer step after a repeated position is a motion, and larger innovations are
# no multiples of few steps.
_COARSEST_M, _MOST_STEPS = 5e-3, 5.0
_CORRECTION_S = 1.0

# Columns of a step, from one state to the next, after `TIME` and `SINCE`: difference from motion
# at constant velocity (m), speed (m/s), and resolution of the positions so far (m).
_INNOVATION, _SPEED, _RESOLUTION = range(2, 5)
_WIDTH = 5
_MOST_EVENTS = 1000  # that are remembered: more take memory in a long live run


class SmoothSignal:
    """Computes how much smoother the last second is than usual: an estimate that coasts.

    Positions of encoders have a resolution: the length of a step after a repeated position. A
    smaller innovation is none of the estimate.
    """

    def __init__(self, period_s: float) -> None:
        """Create it without states; `period_s` is the usual time between them."""
        self._keep_s = 2.0 * _USUAL_S
        self._period_s = period_s
        self._usual = max(3, int(_USUAL_S / period_s))
        self._lately = max(3, int(_LATELY_S / period_s))
        self._states = RowBuffer(POSE_WIDTH)
        self._steps = RowBuffer(_WIDTH)
        self._resolution_m = np.inf

    def add(self, rows: Floats) -> Signals:
        """Add states (N, 9 or more); return the signal at them."""
        old = len(self._states.rows)
        self._states.append(rows[:, :POSE_WIDTH])
        known = len(self._steps.rows)
        self._steps.append(self._new_steps(self._states.rows, old))
        signals = self._signals(known)
        latest = rows[-1, TIME]
        self._states.forget(latest - self._keep_s)
        self._steps.forget(latest - self._keep_s - 3.0 * self._usual * self._period_s)
        return signals

    def _new_steps(self, states: Floats, old: int) -> Floats:
        """Return the steps that end at the states from index `old` on, (N, 5)."""
        begin = max(old - 2, 0)
        some = states[begin:]
        times = some[:, TIME]
        steps = np.full((len(some), _WIDTH), np.nan)
        steps[:, :2] = some[:, :2]
        if len(some) > 1:
            dt = np.diff(times)
            within = some[1:, SINCE] <= times[:-1]
            moved = np.diff(some[:, POSITION], axis=0)
            moved_m = lengths(moved)
            velocity = moved / dt[:, None]
            steps[1:, _SPEED] = only(lengths(velocity), within)
            both = within[1:] & within[:-1]
            steps[2:, _INNOVATION] = only(lengths(np.diff(velocity, axis=0)) * dt[1:], both)
            follows = (moved_m[:-1] < _SAME) & (moved_m[1:] >= _SAME)
            steps[2:, _RESOLUTION] = np.where(follows, moved_m[1:], np.inf)
        new = steps[old - begin :]
        finest = np.fmin.accumulate(np.append(self._resolution_m, new[:, _RESOLUTION]))[1:]
        self._resolution_m = float(finest[-1])
        new[:, _RESOLUTION] = finest
        return new

    def _signals(self, first: int) -> Signals:
        steps = self._steps.rows
        rows = np.arange(first, len(steps))
        times, resolution = steps[rows, TIME], steps[rows, _RESOLUTION]
        usual = self._median(_INNOVATION, rows - self._lately - 1, self._usual)
        lately = self._median(_INNOVATION, rows, self._lately)
        speed = self._median(_SPEED, rows, self._lately)
        counts = (resolution < _COARSEST_M) & (usual < _MOST_STEPS * resolution)
        resolution = np.where(counts, resolution, 1e-9)
        smooth = np.maximum(usual, 1e-4) / np.maximum(lately, resolution)
        return {"smooth": finite(times, np.where(speed > _MOVING_MPS, smooth, 0.0 * speed))}

    def _median(self, column: int, last: Indices, count: int) -> Floats:
        """Return the medians of a column in the `count` rows up to the given ones, (N,).

        Rows before the first one are NaN.
        """
        values = self._steps.rows[:, column]
        places = last[:, None] + np.arange(1 - count, 1)
        medians: Floats = np.median(
            np.where(places >= 0, values[np.maximum(places, 0)], np.nan), axis=1
        )
        return medians


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
        rotated = np.degrees(lie.angle(between(old[:, QUATERNION], new[:, QUATERNION])))
        signals = {
            "map_correction_m_1s": finite(times, only(moved, before >= 0)),
            "map_correction_deg_1s": finite(times, only(rotated, before >= 0)),
        }
        self._done = float(times[-1])
        self._states.forget_until(self._done)
        self._transforms.forget_until(self._done - _CORRECTION_S)
        return signals


def _in_map(transforms: Floats, positions: Floats) -> Floats:
    """Return positions (N, 3) of the estimate, transformed to the map by transforms (N, 9)."""
    moved: Floats = lie.rotate(transforms[:, QUATERNION], positions) + transforms[:, POSITION]
    return moved


class EventSignals:
    """Finds discontinuities; the signal of a kind is at the states since the first event of it."""

    def __init__(self, origin: int) -> None:
        """Create it without states; seconds count from the timestamp `origin`, ns."""
        self.known: deque[KnownEvent] = deque(maxlen=_MOST_EVENTS)  # the newest events
        self._origin, self._stream = origin, OneStream(ESTIMATE)
        self._waiting: list[KnownEvent] = []
        self._kinds: dict[str, None] = {}  # seen so far
        # Events that last, and when they were known, seconds.
        self._lasting: list[tuple[Event, float]] = []

    def add(self, stamps: Stamps, poses: Floats, received: Stamps | None = None) -> None:
        """Add messages in order of arrival: timestamps (N,), ns, poses (N, 7), received (N,)."""
        self._waiting += self._stream.add(stamps, poses, received)
        self._stream.events.clear()

    def signals(self, times: Floats, since_s: float) -> Signals:
        """Return the signals at states (N,), s, in order, by the messages since the last call.

        Events that are known before `since_s` are dropped.
        """
        since_ns = self._origin + round(since_s * NANOSECONDS)
        known = [item for item in self._waiting if item.known_ns >= since_ns]
        known.sort(key=lambda item: item.known_ns)
        self._waiting.clear()
        self.known += known
        if not len(times):
            return {}
        values = {kind: np.zeros(len(times)) for kind in self._kinds}
        for item in known:
            at_s = (item.known_ns - self._origin) / NANOSECONDS
            row = min(int(times.searchsorted(at_s - HALF_NS)), len(times) - 1)
            if item.kind not in values:
                values[item.kind] = np.where(np.arange(len(times)) < row, np.nan, 0.0)
            values[item.kind][row] = max(_value_of(item), values[item.kind][row])
            if item.kind in FREEZES:
                self._lasting.append((item.event, at_s))
        for event, known_s in self._lasting:
            begin_s, end_s = (
                (ns - self._origin) / NANOSECONDS for ns in (event.t_ns, event.end_ns)
            )
            rows = (times >= known_s - HALF_NS) & (times <= end_s + HALF_NS)
            values[event.kind][rows] = times[rows] - begin_s
        self._lasting = [item for item in self._lasting if item[0] in self._stream.frozen]
        self._kinds.update(dict.fromkeys(values))
        signals = {}
        for kind, column in values.items():
            since = np.isfinite(column)
            signals[kind] = Readings(times[since], column[since])
        return signals


def _value_of(item: KnownEvent) -> float:
    """Return the value of the signal of an event, in the unit of its limit."""
    if item.kind == GAP:
        return GAP_PERIODS * item.ratio
    return abs(item.event.s) if item.kind == CLOCK_STEP else item.ratio
