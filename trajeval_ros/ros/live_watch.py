"""The live watch: alarms from serialised messages, with the same watchdog as for recordings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import with_unit
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.inertial import InertialReadings
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.io.bags.pose_messages import PATH_TYPE
from trajeval_ros.io.bags.rate_messages import IMU_TYPE, ODOMETRY_TYPE, decode_rates
from trajeval_ros.io.requests.limits_file import limits_mapping
from trajeval_ros.online.notices import ERROR, OK, WARN, Notice
from trajeval_ros.online.state_rows import POSITION, QUATERNION, VELOCITY
from trajeval_ros.report.watch_lines import evidence_line
from trajeval_ros.ros.poses import PoseStream
from trajeval_ros.ros.subscriptions import ReceivedMessages
from trajeval_ros.watchdog.alarm_book import AlarmBook, WatchAlarm
from trajeval_ros.watchdog.engine import ARMING_S, Watchdog
from trajeval_ros.watchdog.limits import WatchLimits
from trajeval_ros.watchdog.recording import rates_at
from trajeval_ros.watchdog.signal_history import SignalHistory
from trajeval_ros.watchdog.signals import Readings, Signals, joined, signal_of, source_of
from trajeval_ros.watchdog.unseen import unseen

# Time after arming at which typical values are compared with those of the limits.
_COMPARED_S = 60.0
_REMEMBERED_S = 60.0  # time for which ended alarms are kept
# Turn rates that wait for states whose timestamps are still under test.
_MOST_RATES = 2000

# Type, messages, and times of arrival.
Batches = Sequence[tuple[str, ReceivedMessages, Stamps]]


class WatchedMessages(NamedTuple):
    """Messages since the last look, by source in order of arrival.

    Attributes:
        estimate: Messages of the estimate that is watched.
        others: Messages of second estimates and of map corrections, by source (`pair`,
            `pair.NAME`, `map`).
        imu: Messages of the IMU.
    """

    estimate: Batches = ()
    others: Mapping[str, Batches] = MappingProxyType({})
    imu: Sequence[bytes] = ()


@dataclass(frozen=True)
class WatchReport:
    """Result of a look.

    Attributes:
        notices: The current state, with alarms that have started and ended since the last look.
        news: Findings about the sources; every finding is reported once.
        begun: The alarms that have started.
        values: Values of the status, by name.
        history: The signals of the last minute and the limits, for the JSON file of a clip.
    """

    notices: Sequence[Notice] = ()
    news: Sequence[Notice] = ()
    begun: Sequence[Notice] = ()
    values: dict[str, Any] = field(default_factory=dict)
    history: dict[str, Any] = field(default_factory=dict)


class LiveWatch:
    """Watches one estimate by its messages.

    Attributes:
        book: The alarms.
        watchdog: Computes the signals.
    """

    def __init__(
        self,
        limits: WatchLimits,
        factor: float,
        estimate: PoseStream,
        others: Mapping[str, PoseStream] = MappingProxyType({}),
        *,
        has_imu: bool = False,
    ) -> None:
        """Create it.

        Args:
            limits: Limits learned from a healthy run.
            factor: Ratio of a limit to the largest healthy value.
            estimate: Decodes the messages of the estimate.
            others: Decode the messages of second estimates and of map corrections, by source
                (`pair`, `pair.NAME`, `map`).
            has_imu: Whether there is an IMU.

        Raises:
            InputError: The limits were learned without one of these sources.
        """
        self.book = AlarmBook(limits, factor)
        self.watchdog = Watchdog(pairs=[each for each in others if each != "map"])
        self._estimate, self._others = estimate, others
        self._needs = {*others, *(["imu"] if has_imu else [])}
        limits.require_sources(sorted(self._needs))
        self._evidence, self._limits = evidence_line(limits, factor), limits_mapping(limits)
        self._history = SignalHistory()
        self._first: list[Signals] | None = []
        self._refused = ""
        self._rates: InertialReadings | None = None
        self._unseen: list[str] = []
        self._told: list[str] = []

    def look(self, messages: WatchedMessages) -> WatchReport:
        """Process the messages, in a time proportional to their number."""
        begun: list[WatchAlarm] = []
        if not self._refused:
            try:
                begun = self._judge(messages)
            except InputError as error:
                self._refused = str(error)
                self.book.end_all()
        passed = [each for each in begun if each.is_over]
        standing = [self._notice(each) for each in [*self.book.standing, *passed]]
        return WatchReport(
            [*self._about_state(), *standing],
            [Notice("watch", OK, each) for each in self._news()],
            [self._notice(each) for each in begun],
            self._values(),
            {
                "second_0_ns": self.watchdog.origin,
                "largest_by_second": self._history.by_second,
                "factor": self.book.factor,
                "limits": self._limits,
            },
        )

    def _judge(self, messages: WatchedMessages) -> list[WatchAlarm]:
        """Return the alarms that start."""
        restarts = self.watchdog.restarts
        parts = [self._take_imu(messages.imu)]
        parts += [
            self._take_other(source, *each)
            for source, batches in messages.others.items()
            for each in batches
        ]
        parts += [self._take_estimate(*each) for each in messages.estimate]
        signals = joined(parts)
        self._history.add(signals)
        begun = self.book.add(signals)
        if self.watchdog.restarts > restarts:
            self.book.end_all()
        self.book.forget(self.watchdog.last_s - _REMEMBERED_S)
        self._compare(signals)
        return begun

    def _take_imu(self, payloads: Sequence[bytes]) -> Signals:
        if not payloads:
            return {}
        readings = decode_rates(payloads, IMU_TYPE)
        assert readings.accelerations is not None
        timed = readings.stamps != 0  # 0: the timestamp is not set
        return self.watchdog.add_inertial(
            readings.stamps[timed], readings.rates[timed], readings.accelerations[timed]
        )

    def _take_other(
        self, source: str, kind: str, taken: ReceivedMessages, arrived: Stamps
    ) -> Signals:
        columns = _poses(self._others[source], kind, taken, arrived)[:3]
        if source == "map":
            return self.watchdog.add_corrections(*columns)
        return self.watchdog.add_partner(*columns, source=source)

    def _take_estimate(self, kind: str, taken: ReceivedMessages, arrived: Stamps) -> Signals:
        stamps, positions, quaternions, velocities = _poses(self._estimate, kind, taken, arrived)
        rates = self._rates_of(kind, taken.payloads)
        if np.isfinite(velocities).any():
            self._needs.add("twist")
        return self.watchdog.add_states(
            stamps,
            positions,
            quaternions,
            lie.rotate(lie.conjugate(quaternions), velocities),
            None if rates is None else rates_at(stamps, rates),
        )

    def _rates_of(self, kind: str, payloads: Sequence[bytes]) -> InertialReadings | None:
        """Return the turn rates of the newest messages; None if messages have no twist."""
        if kind != ODOMETRY_TYPE:
            return None
        new = decode_rates(payloads, kind)
        if self._rates is None:
            self._rates = new
        else:
            self._rates = InertialReadings(
                np.concatenate([self._rates.stamps[-_MOST_RATES:], new.stamps]),
                np.concatenate([self._rates.rates[-_MOST_RATES:], new.rates]),
                None,
            )
        return self._rates if len(self._rates) else None

    def _compare(self, signals: Signals) -> None:
        """Check once, `_COMPARED_S` after arming, that the limits are of this robot.

        Raises:
            InputError: They seem to be of another robot.
        """
        armed_s = self.watchdog.armed_s
        if self._first is None or armed_s is None:
            return
        self._first.append(signals)
        if self.watchdog.last_s < armed_s + _COMPARED_S:
            return
        seen: dict[str, Readings] = joined(self._first)
        self._first = None
        self.book.limits.require_of(seen)
        there = {source_of(name) for name in seen}
        self._unseen = [*unseen(self._needs, there, self.watchdog.notices)]

    def _news(self) -> list[str]:
        """Return the findings about the sources since the last call."""
        found = [*self.watchdog.notices, *self._unseen]
        news = [each for each in found if each not in self._told]
        self._told += news
        return news

    def _about_state(self) -> Iterator[Notice]:
        if self._refused:
            yield Notice("hint", ERROR, f"watch not possible: {self._refused}", "watch")
        elif self.watchdog.armed_s is None:
            moved_s = self.watchdog.moved_s
            yield Notice("watch", OK, f"arming: {moved_s:.0f} of {ARMING_S:g} s of motion")

    def _notice(self, alarm: WatchAlarm) -> Notice:
        signal = signal_of(alarm.signal)
        peak, limit = (with_unit(each, signal.unit) for each in (alarm.peak, alarm.limit))
        begin_ns = self.watchdog.origin + round(alarm.begin_s * NANOSECONDS)
        return Notice(
            "alarm",
            ERROR if self.book.is_error(alarm) else WARN,
            f"{alarm.signal} {peak} is over {limit}: {signal.words}",
            alarm.signal,
            {
                "value": alarm.peak,
                "limit": alarm.limit,
                "unit": signal.unit,
                "stamp_ns": begin_ns,
                "evidence": self._evidence,
            },
        )

    def _values(self) -> dict[str, Any]:
        """Return the values of the status, by name."""
        armed_s = self.watchdog.armed_s
        values: dict[str, Any] = {
            "evidence": self._evidence,
            "judged [s]": None if armed_s is None else self.watchdog.last_s - armed_s,
            "states out of order": self.watchdog.out_of_order or None,
            "restarts": self.watchdog.restarts or None,
            "sources": "; ".join(self._told) or None,
        }
        for name, value in self._history.latest.items():
            limit = self.book.limits.limit(name, self.book.factor)
            if limit is not None:
                values[f"{name}, share of its limit"] = value / limit
        return values


def _poses(
    stream: PoseStream, kind: str, taken: ReceivedMessages, arrived: Stamps
) -> tuple[Stamps, Floats, Floats, Floats]:
    """Return timestamps (N,), positions (N, 3), quaternions (N, 4), world velocities (N, 3).

    Raises:
        InputError: The messages are paths.
    """
    if kind == PATH_TYPE:
        raise InputError(
            "a topic to watch has type nav_msgs/msg/Path, whose poses are revised; use a topic "
            "with one pose per message"
        )
    found = stream.poses(kind, taken.payloads, arrived)
    rows = found.states
    usable = np.isfinite(rows[:, POSITION]).all(axis=1)
    usable &= np.isfinite(rows[:, QUATERNION]).all(axis=1)
    rows = rows[usable]
    return found.stamps[usable], rows[:, POSITION], rows[:, QUATERNION], rows[:, VELOCITY]
