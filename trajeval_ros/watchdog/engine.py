"""The watchdog: computes signals from an estimate and the sources that it is compared with.

Each source is processed in its own order, and a signal at a time depends only on messages up to
that time. A recording and a live run therefore give the same values in any order of arrival.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trajeval_ros.consistency.yaw_information import YawInformation
from trajeval_ros.formatting.remarks import Remark
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps, lengths
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.coverage import StampedPoses
from trajeval_ros.metrics.discontinuities.one_stream import KnownEvent
from trajeval_ros.watchdog.inertial_mounting import IMU_WIDTH
from trajeval_ros.watchdog.inertial_signals import InertialSignals
from trajeval_ros.watchdog.pair_signals import PairSignals
from trajeval_ros.watchdog.pose_signals import CorrectionSignals, EventSignals, SmoothSignal
from trajeval_ros.watchdog.row_buffer import (
    POSE_WIDTH,
    POSITION,
    REMEMBERED_S,
    SINCE,
    STATE_WIDTH,
    TIME,
    VELOCITY,
    Comparison,
    OrderedFeed,
    RowBuffer,
)
from trajeval_ros.watchdog.signals import PAIR, Readings, Signals, joined
from trajeval_ros.watchdog.twist_signals import TwistSignals

ARMING_S = 30.0
_MOVING_MPS = 0.1
# If timestamps of the estimate step back by more than this, the estimator has restarted.
RESTART_S = 1.0
_BLOCK = 1024


class Watchdog:
    """Watches one estimate.

    The watchdog arms when the robot has moved for 30 s in total. The data before arming determine
    the mounting and clock of the IMU, the lag of the twist, and the body and scale of second
    estimates. Signals start at arming.
    """

    def __init__(self, origin: int | None = None, pairs: Sequence[str] = (PAIR,)) -> None:
        """Create it without a message.

        Seconds count from the timestamp `origin`, ns, or from the first message. `pairs` are the
        second estimates, as `pair_sources` names them.
        """
        self.restarts = 0  # number of restarts of the estimator
        self._origin = origin
        self._told: list[str] = []
        self._pair_names = tuple(pairs)
        self._begin()

    def _begin(self) -> None:
        self.moved_s = 0.0  # duration of motion so far, until arming, seconds
        self.armed_s: float | None = None  # time of arming, seconds since the first message
        widths = {"imu": IMU_WIDTH, **dict.fromkeys(("map", *self._pair_names), POSE_WIDTH)}
        self._feeds = {name: OrderedFeed() for name in ("states", *widths)}
        self._states = RowBuffer(STATE_WIDTH)
        self._waiting = {name: RowBuffer(width) for name, width in widths.items()}
        self._events: EventSignals | None = None
        self._smooth: SmoothSignal | None = None
        self._twist: TwistSignals | None = None
        self._others: dict[str, InertialSignals | CorrectionSignals | PairSignals] = {}
        self._counted_s = -np.inf
        self._yaw = YawInformation()

    @property
    def origin(self) -> int:
        """The timestamp, ns, from which seconds are counted; 0 before the first message."""
        return self._origin or 0

    @property
    def notices(self) -> list[str]:
        """Findings about the sources, one sentence each."""
        groups = [] if self._twist is None else [self._twist.notices]
        groups += [
            other.notices for other in self._others.values() if isinstance(other, Comparison)
        ]
        result = [item for group in groups for item in group]
        return [*self._told, *result]

    @property
    def about_yaw(self) -> Remark | None:
        """The warning about covariances that claim to know yaw; None without an IMU."""
        return self._yaw.remark if np.isfinite(self._feeds["imu"].last) else None

    @property
    def events(self) -> list[KnownEvent]:
        """The newest discontinuities of the estimate that are known since arming."""
        return [] if self._events is None else list(self._events.known)

    @property
    def out_of_order(self) -> int:
        """Number of states dropped, because their timestamps did not increase."""
        return self._feeds["states"].out_of_order

    @property
    def last_s(self) -> float:
        """Time of the latest state, seconds since the first message."""
        return self._feeds["states"].last

    def _seconds(self, stamps: Stamps) -> Floats:
        if self._origin is None:
            self._origin = int(stamps[0])
        seconds: Floats = (stamps - self._origin) / NANOSECONDS
        return seconds

    def add_estimate(self, states: Trajectory) -> Signals:
        """Add states of the estimate, in order of arrival; return the signals that they determine.

        States without orientations are left out. Covariances are tested, if there are any.
        """
        if states.quaternions is None or not len(states):
            return {}
        seconds = self._seconds(states.stamps)
        latest = np.maximum.accumulate(np.concatenate([[self.last_s], seconds]))[:-1]
        back = np.flatnonzero(seconds < latest - RESTART_S)
        if not len(back):
            return self._add_in_order(states, states.quaternions)
        first = int(back[0])
        before = self._add_in_order(states[:first], states.quaternions[:first])
        self.restarts += 1
        self._told.append(
            f"the estimate's timestamps step back by {latest[first] - seconds[first]:.1f} s: the "
            "estimator restarted, and the watch restarts"
        )
        self._begin()
        return joined([before, self.add_estimate(states[first:])])

    def _add_in_order(self, states: Trajectory, quaternions: Floats) -> Signals:
        stamps, receive_times = states.stamps, states.reading.receive_times
        if states.covariances is not None:
            self._yaw.add(stamps, states.covariances[:, 3:, 3:], states.up.matrix[2])
        velocities = np.full((len(states), 3), np.nan)
        if states.velocities is not None:
            velocities = lie.rotate(lie.conjugate(quaternions), states.velocities)
        rows = self._feeds["states"].rows(
            self._seconds(stamps), states.positions, quaternions, velocities
        )
        if self._events is None:
            self._events = EventSignals(self.origin)
        received = None if receive_times is None else receive_times.times
        self._events.add(*StampedPoses.of(states), received)
        if self.armed_s is None:
            signals = self._before_armed(rows)
        else:
            signals = self._signals(rows) if len(rows) else {}
        if self.armed_s is None:
            return {}
        times = rows[rows[:, TIME] >= self.armed_s, TIME]
        return {**signals, **self._events.signals(times, self.armed_s)}

    def _before_armed(self, rows: Floats) -> Signals:
        """Keep states until the watch arms; return the first signals then."""
        if not len(rows):
            return {}
        self._states.append(rows)
        if not self._arms():
            self._states.forget(rows[-1, TIME] - REMEMBERED_S)
            return {}
        kept = self._states.rows.copy()
        self._states = RowBuffer(STATE_WIDTH)
        return self._first_signals(kept)

    def _arms(self) -> bool:
        """Sum the duration of motion; arm if it is long enough, and return whether it is."""
        rows = self._states.rows
        begin = int(np.searchsorted(rows[:, TIME], self._counted_s))
        some = rows[begin:]
        dt = np.diff(some[:, TIME])
        within = some[1:, SINCE] <= some[:-1, TIME]
        moved = lengths(np.diff(some[:, POSITION], axis=0))
        total = self.moved_s + np.cumsum(np.where(within & (moved > _MOVING_MPS * dt), dt, 0.0))
        self._counted_s = float(rows[-1, TIME])
        if not len(total):
            return False
        self.moved_s = min(float(total[-1]), ARMING_S)
        if self.moved_s < ARMING_S:
            return False
        self.armed_s = float(some[1 + int(np.searchsorted(total, ARMING_S)), TIME])
        return True

    def _first_signals(self, kept: Floats) -> Signals:
        """Create the signals from the data before arming; return their first readings."""
        assert self.armed_s is not None
        oldest = self.armed_s - REMEMBERED_S
        kept = kept[kept[:, TIME] >= oldest]
        before = kept[kept[:, TIME] < self.armed_s]
        period_s = float(np.median(np.diff(before[:, TIME])))
        self._smooth = SmoothSignal(period_s)
        self._others = {"imu": InertialSignals(period_s, self.armed_s), "map": CorrectionSignals()}
        for name in self._pair_names:
            self._others[name] = PairSignals(name, period_s, self.armed_s)
        velocities = before[:, VELOCITY]
        if np.isfinite(velocities).all() and velocities.any():
            self._twist = TwistSignals(before)
        parts = []
        for name, item in self._waiting.items():
            item.forget_until(oldest)
            parts.append(self._by_source(name, item.rows))
        self._waiting = {}
        return joined([*parts, self._signals(kept)])

    def _signals(self, rows: Floats) -> Signals:
        parts: list[Signals] = []
        assert self._smooth is not None
        for begin in range(0, len(rows), _BLOCK):
            some = rows[begin : begin + _BLOCK]
            parts.append(self._smooth.add(some))
            if self._twist is not None and self._twist.usable:
                parts.append(self._twist.add(some))
            parts += [other.add(some) for other in self._others.values()]
        return self._since_armed(joined(parts))

    def _since_armed(self, signals: Signals) -> Signals:
        """Return the readings since arming."""
        assert self.armed_s is not None
        result = {}
        for name, (seconds, values) in signals.items():
            first = int(np.searchsorted(seconds, self.armed_s))
            if first < len(seconds):
                result[name] = Readings(seconds[first:], values[first:])
        return result

    def add_source(self, name: str, stamps: Stamps, *columns: Floats) -> Signals:
        """Add rows of another source, with timestamps (N,), ns; return the signals.

        Columns are those of `imu`: rates and accelerations (N, 3) in its axes, rad/s and m/s^2;
        of a second estimate, in any frame and scale, or of `map`, poses of the estimate's frame
        in the map: positions (N, 3) and quaternions (N, 4).
        """
        if not len(stamps):
            return {}
        rows = self._feeds[name].rows(self._seconds(stamps), *columns)
        if self.armed_s is not None:
            return self._since_armed(self._by_source(name, rows))
        self._waiting[name].append(rows)
        # The estimate may never arrive; memory stays bounded.
        latest = max(self.last_s, self._feeds[name].last)
        self._waiting[name].forget_until(latest - REMEMBERED_S)
        return {}

    def _by_source(self, name: str, rows: Floats) -> Signals:
        """Return the signals that rows of a source determine, after arming."""
        return self._others[name].add_other(rows) if len(rows) else {}
