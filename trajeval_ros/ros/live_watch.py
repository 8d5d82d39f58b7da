"""The live watch: alarms from serialised messages, with the same watchdog as for recordings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import with_unit
from trajeval_ros.formatting.remarks import Level, Remark
from trajeval_ros.geometry.arrays import Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.io.bags.pose_messages import PATH_TYPE
from trajeval_ros.io.bags.rate_messages import decode_rates
from trajeval_ros.ros.poses import PoseStream
from trajeval_ros.ros.subscriptions import ReceivedMessages
from trajeval_ros.watchdog.engine import ARMING_S, Watchdog
from trajeval_ros.watchdog.recording import undetected_faults
from trajeval_ros.watchdog.signals import Signals, joined, signal_of, source_of
from trajeval_ros.watchdog.watch_alarms import AlarmBook, WatchAlarm

# Time after arming at which sources without data are reported.
_AWAITED_S = 60.0
_REMEMBERED_S = 60.0  # time for which ended alarms are kept

# Type, messages, and times of arrival.
Batches = Sequence[tuple[str, ReceivedMessages, Stamps]]


class WatchedMessages(NamedTuple):
    """Messages since the last look, in order of arrival."""

    estimate: Batches = ()
    # Second estimates and map corrections, by source: `pair`, `pair.NAME`, `map`.
    others: Mapping[str, Batches] = MappingProxyType({})
    imu: Sequence[bytes] = ()


@dataclass(frozen=True)
class WatchReport:
    """Result of a look."""

    remarks: Sequence[Remark] = ()  # the state, with alarms that started and ended since the last
    news: Sequence[Remark] = ()  # findings about the sources; every finding is reported once
    begun: Sequence[Remark] = ()  # the alarms that have started
    values: dict[str, Any] = field(default_factory=dict)  # values of the status, by name


class LiveWatch:
    """Watches one estimate by its messages; streams decode them, those of others by source."""

    def __init__(
        self,
        factor: float,
        estimate: PoseStream,
        others: Mapping[str, PoseStream] = MappingProxyType({}),
        *,
        has_imu: bool = False,
    ) -> None:
        self.book = AlarmBook(factor)  # the alarms
        self.watchdog = Watchdog(pairs=[other for other in others if other != "map"])
        self._estimate, self._others = estimate, others
        self._needs = {*others, *(["imu"] if has_imu else [])}
        self._latest: dict[str, tuple[int, float]] = {}  # second and largest value by signal
        self._refused = ""
        self._unseen: list[str] = []
        self._reported: list[str] = []

    def look(self, messages: WatchedMessages) -> WatchReport:
        """Process the messages, in a time proportional to their number."""
        begun: list[WatchAlarm] = []
        if not self._refused:
            try:
                begun = self._judge(messages)
            except InputError as error:
                self._refused = str(error)
                self.book.end_all()
        passed = [item for item in begun if item.is_over]
        standing = [self._remark(item) for item in [*self.book.standing, *passed]]
        return WatchReport(
            [*self._about_state(), *standing],
            [Remark(Level.NOTE, "watch", item) for item in self._news()],
            [self._remark(item) for item in begun],
            self._values(),
        )

    def _judge(self, messages: WatchedMessages) -> list[WatchAlarm]:
        restarts = self.watchdog.restarts
        parts = [self._take_imu(messages.imu)]
        parts += [
            self._take_other(source, *batch)
            for source, batches in messages.others.items()
            for batch in batches
        ]
        parts += [self._take_estimate(*item) for item in messages.estimate]
        signals = joined(parts)
        self._keep_latest(signals)
        begun = self.book.add(signals)
        if self.watchdog.restarts > restarts:
            self.book.end_all()
        self.book.forget(self.watchdog.last_s - _REMEMBERED_S)
        armed_s = self.watchdog.armed_s
        if armed_s is not None and self.watchdog.last_s >= armed_s + _AWAITED_S:
            there = {source_of(name) for name in self._latest}
            self._unseen = [*undetected_faults(self._needs, there, self.watchdog.notices)]
        return begun

    def _take_imu(self, payloads: Sequence[bytes]) -> Signals:
        if not payloads:
            return {}
        readings = decode_rates(payloads)
        assert readings.accelerations is not None
        timed = readings.stamps != 0  # 0: the timestamp is not set
        return self.watchdog.add_source(
            "imu", readings.stamps[timed], readings.rates[timed], readings.accelerations[timed]
        )

    def _take_other(
        self, source: str, kind: str, taken: ReceivedMessages, arrived: Stamps
    ) -> Signals:
        poses = _poses(self._others[source], kind, taken, arrived)
        if poses.quaternions is None:
            return {}
        return self.watchdog.add_source(source, poses.stamps, poses.positions, poses.quaternions)

    def _take_estimate(self, kind: str, taken: ReceivedMessages, arrived: Stamps) -> Signals:
        states = _poses(self._estimate, kind, taken, arrived)
        if states.velocities is not None and np.isfinite(states.velocities).any():
            self._needs.add("twist")
        return self.watchdog.add_estimate(replace(states, up=self._estimate.up(None)))

    def _keep_latest(self, signals: Signals) -> None:
        """Keep the largest value of every signal in its latest second."""
        for name, (seconds, values) in signals.items():
            if len(seconds):
                second = int(np.floor(seconds[-1]))
                largest = float(values[np.floor(seconds) == second].max())
                before, known = self._latest.get(name, (second, largest))
                self._latest[name] = second, max(largest, known) if before == second else largest

    def _news(self) -> list[str]:
        notices = [*self.watchdog.notices, *self._unseen]
        news = [item for item in notices if item not in self._reported]
        self._reported += news
        return news

    def _about_state(self) -> Iterator[Remark]:
        if self._refused:
            yield Remark(Level.ERROR, "hint", f"watch not possible: {self._refused}", "watch")
        elif self.watchdog.armed_s is None:
            moved_s = self.watchdog.moved_s
            yield Remark(Level.NOTE, "watch", f"arming: {moved_s:.0f} of {ARMING_S:g} s of motion")
        if self.watchdog.about_yaw is not None:
            yield self.watchdog.about_yaw

    def _remark(self, alarm: WatchAlarm) -> Remark:
        signal = signal_of(alarm.signal)
        peak, limit = (with_unit(item, signal.unit) for item in (alarm.peak, alarm.limit))
        begin_ns = self.watchdog.origin + round(alarm.begin_s * NANOSECONDS)
        sizes = [
            f" of {item.event.size},"
            for item in self.watchdog.events
            if item.kind == alarm.signal and item.known_ns <= begin_ns and item.event.size
        ]
        size = sizes[-1] if sizes else ""
        return Remark(
            Level.ERROR if self.book.is_error(alarm) else Level.WARNING,
            "alarm",
            f"{alarm.signal}{size} {peak} is over {limit}: {signal.words}",
            alarm.signal,
            {
                "value": alarm.peak,
                "limit": alarm.limit,
                "unit": signal.unit,
                "stamp_ns": begin_ns,
                "factor": self.book.factor,
            },
        )

    def _values(self) -> dict[str, Any]:
        armed_s = self.watchdog.armed_s
        values: dict[str, Any] = {
            "factor": self.book.factor,
            "judged [s]": None if armed_s is None else self.watchdog.last_s - armed_s,
            "states out of order": self.watchdog.out_of_order or None,
            "restarts": self.watchdog.restarts or None,
            "sources": "; ".join(self._reported) or None,
        }
        for name, (_, value) in self._latest.items():
            values[f"{name}, share of its limit"] = value / self.book.limit(name)
        return values


def _poses(stream: PoseStream, kind: str, taken: ReceivedMessages, arrived: Stamps) -> Trajectory:
    """Return the usable poses of messages."""
    if kind == PATH_TYPE:
        raise InputError(
            "a topic to watch has type nav_msgs/msg/Path, whose poses are revised; use a topic "
            "with one pose per message"
        )
    return stream.poses(kind, taken.payloads, arrived)[0]
