"""Signal of the twist: displacements of the pose minus the integral of the twist."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, lengths
from trajeval_ros.geometry.interpolation import columns_at
from trajeval_ros.watchdog.row_buffer import (
    POSITION,
    QUATERNION,
    SINCE,
    STATE_WIDTH,
    TIME,
    VELOCITY,
    RowBuffer,
    change_within,
    only,
    window_begins,
)
from trajeval_ros.watchdog.signals import Signals, finite

_WINDOW_S = 5.0
_LAGS_S = np.arange(-0.5, 1.001, 0.025)
# The lag is estimated from displacements in 1 s, in ten blocks of the time before arming.
_LAG_WINDOW_S, _BLOCKS, _P_VALUE = 1.0, 10, 0.005
# A smaller lag is within the noise of its estimate.
_LEAST_LAG_S = 0.03
_TOLD_LAG_S = 0.05
# Minimum ratio of residuals in body and world axes for a twist in world axes.
_CLEARLY = 3.0
# A factor of the twist that is stated: noise of the poses adds to their motion.
_LEAST_LOG_FACTOR = np.log(1.5)
_KMH, _NEAR_KMH = 3.6, 0.05
_INTEGRAL = slice(STATE_WIDTH, STATE_WIDTH + 3)


class TwistSignals:
    """Compares displacements with the integral of the twist, corrected for its lag."""

    def __init__(self, before: Floats) -> None:
        """Estimate the lag from states (N, 12) before arming, and find the twist's frame."""
        self.notices: list[str] = []  # findings at the start, one sentence each
        self.lag_s, chance = _lag_of(before)  # lag of the twist relative to the pose, s
        self._waiting = RowBuffer(STATE_WIDTH)
        self._rows = RowBuffer(_INTEGRAL.stop)
        self._tell_factor(before)
        # Whether the twist is in the body frame, so that it can be compared.
        self.usable = self._is_in_body(before)
        if abs(self.lag_s) > _TOLD_LAG_S:
            way = "later" if self.lag_s > 0.0 else "earlier"
            self.notices.append(
                f"the twist is {abs(self.lag_s):.2f} s {way} than the pose (corrected; "
                f"p = {chance:.2g})"
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

    def _tell_factor(self, before: Floats) -> None:
        """Add a notice if the twist is another multiple of the motion."""
        within = before[1:, SINCE] <= before[:-1, TIME]
        dt = np.diff(before[:, TIME])[within]
        moved = lengths(np.diff(before[:, POSITION], axis=0))[within]
        twist = lengths(before[1:, VELOCITY])[within] * dt
        factor = float(twist.sum() / max(float(moved.sum()), 1e-9))
        if factor and abs(np.log(factor)) > _LEAST_LOG_FACTOR:
            is_kmh = abs(factor / _KMH - 1.0) < _NEAR_KMH
            unit = ", as if it were in km/h," if is_kmh else ""
            self.notices.append(
                f"the twist is {factor:.3g} times the motion of the pose{unit} and "
                "nav_msgs/Odometry requires m/s; correct the estimator"
            )

    def add(self, rows: Floats) -> Signals:
        """Add states (N, 12); return the signals at states for which the twist has arrived."""
        self._waiting.append(rows)
        waiting = self._waiting.rows
        until = waiting[-1, TIME] - max(self.lag_s, 0.0)
        ready = int(np.searchsorted(waiting[:, TIME], until, side="right"))
        done = self._rows.rows[-1, TIME] if len(self._rows.rows) else -np.inf
        first = int(np.searchsorted(waiting[:, TIME], done, side="right"))
        if first >= ready:
            return {}
        new = waiting[first:ready]
        velocities = columns_at(waiting[:, TIME], waiting[:, VELOCITY], new[:, TIME] + self.lag_s)
        old = len(self._rows.rows)
        self._rows.append(np.column_stack([new, np.zeros((len(new), 3))]))
        self._integrate(old, velocities)
        self._waiting.forget(new[-1, TIME] - abs(self.lag_s) - 1.0)
        rows = self._rows.rows
        _, known = window_begins(rows, old, _WINDOW_S)
        pose, twist = (
            change_within(rows, old, _WINDOW_S, columns) for columns in (POSITION, _INTEGRAL)
        )
        result = finite(rows[old:, TIME], only(lengths(pose - twist), known))
        self._rows.forget(new[-1, TIME] - 2.0 * _WINDOW_S)
        return {"twist_m_5s": result}

    def _integrate(self, first: int, velocities: Floats) -> None:
        """Integrate the velocities in the estimate's world frame, by the trapezoidal rule."""
        rows = self._rows.rows
        rows[first:, VELOCITY] = lie.rotate(rows[first:, QUATERNION], velocities)
        begin = max(first - 1, 0)
        path = _path(rows[begin:, TIME], rows[begin:, VELOCITY])
        rows[begin:, _INTEGRAL] = rows[begin, _INTEGRAL] + path


def _path(times: Floats, velocities: Floats) -> Floats:
    """Return the integral of velocities (N, 3) since the first time, by the trapezoidal rule."""
    steps = 0.5 * (velocities[1:] + velocities[:-1]) * np.diff(times)[:, None]
    path: Floats = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    return path


def _lag_of(states: Floats) -> tuple[float, float]:
    """Return the lag of the twist, s, and its p-value; lag 0 if no other lag is significant.

    The cost of a lag is the mean difference of displacements in 1 s and integrals of the twist,
    as vectors. The lag that is best in nine blocks of the time is applied to the tenth. Its gains
    over no lag are tested by Wilcoxon's signed-rank test: a flat cost has none, and a large gain
    in one block does not decide.
    """
    begins, known = window_begins(states, 0, _LAG_WINDOW_S)
    ends = np.flatnonzero(known)
    if len(ends) < 10 * _BLOCKS:
        return 0.0, 1.0
    begins = begins[ends]
    times, moved = states[:, TIME], states[ends, POSITION] - states[begins, POSITION]
    costs = []
    for lag_s in _LAGS_S:
        twists = columns_at(times, states[:, VELOCITY], times + lag_s)
        path = _path(times, lie.rotate(states[:, QUATERNION], twists))
        off = lengths(moved - (path[ends] - path[begins]))
        costs.append([part.mean() for part in np.array_split(off, _BLOCKS)])
    cost = np.array(costs)
    in_others = cost.sum(axis=1, keepdims=True) - cost
    none = int(np.argmin(np.abs(_LAGS_S)))
    gains = cost[none] - cost[np.argmin(in_others, axis=0), np.arange(_BLOCKS)]
    chance = _signed_rank_p_value(gains)
    lag_s = float(_LAGS_S[int(np.argmin(cost.sum(axis=1)))])
    if chance > _P_VALUE or abs(lag_s) <= _LEAST_LAG_S:
        return 0.0, chance
    return lag_s, chance


def _signed_rank_p_value(gains: Floats) -> float:
    """Return the one-sided p-value of positive gains (N,), exact over all 2^N signs."""
    ranks = np.argsort(np.argsort(np.abs(gains))) + 1.0
    signs = (np.arange(2 ** len(gains))[:, None] >> np.arange(len(gains))) & 1
    return float(np.mean(signs @ ranks >= ranks[gains > 0.0].sum()))


def _misfit(states: Floats, velocities: Floats, lag_s: float) -> float:
    """Return the median difference between velocities of the poses and of the twist, m/s."""
    dt = np.diff(states[:, TIME])
    whole = states[1:, SINCE] <= states[:-1, TIME]
    velocity = np.diff(states[:, POSITION], axis=0)[whole] / dt[whole, None]
    middle = 0.5 * (states[1:, TIME] + states[:-1, TIME])[whole]
    twists = columns_at(states[:, TIME], velocities, middle + lag_s)
    in_world = lie.rotate(states[:-1, QUATERNION][whole], twists)
    return float(np.median(lengths(velocity - in_world)))
