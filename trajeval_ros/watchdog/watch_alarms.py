"""Alarms: periods in which signals exceed their limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.watchdog.signals import Readings, Signals, signal_of, source_of

# An alarm ends if its signal is below this share of the limit for this time.
_CALM_SHARE, _CALM_S = 0.7, 5.0
# An alarm is an error if it exceeds this multiple of its limit, if it lasts this long, or if a
# signal of another source has an alarm within this time. Otherwise it is a warning.
_GRAVE, _LASTING_S, _TOGETHER_S = 1.5, 5.0, 5.0


@dataclass
class WatchAlarm:
    """A period in which a signal exceeds its limit; times are seconds since the watch started."""

    signal: str
    limit: float
    begin_s: float  # time at which it exceeded the limit
    last_s: float  # latest time at which it was above 0.7 of the limit
    peak: float
    peak_s: float  # time of the largest value
    is_over: bool = False  # whether the alarm has ended


class AlarmBook:
    """Compares signals with limits, reading by reading."""

    def __init__(self, factor: float = 1.0) -> None:
        self.alarms: list[WatchAlarm] = []  # all alarms so far, in the order in which they began
        self.factor = factor  # on all limits of `SIGNALS`, for one robot
        self._open: dict[str, WatchAlarm] = {}

    def limit(self, name: str) -> float:
        """Return the limit of a signal, in its unit."""
        return self.factor * signal_of(name).limit

    def add(self, signals: Signals) -> list[WatchAlarm]:
        """Add new readings; return the alarms that start in them."""
        before = len(self.alarms)
        for name, readings in signals.items():
            if len(readings.values):
                self._compare(name, readings, self.limit(name))
        self.alarms[before:] = sorted(self.alarms[before:], key=lambda alarm: alarm.begin_s)
        return self.alarms[before:]

    def _compare(self, name: str, readings: Readings, limit: float) -> None:
        seconds, values = readings
        start = 0
        while start < len(values):
            alarm = self._open.get(name)
            if alarm is None:
                over = np.flatnonzero(values[start:] > limit)
                if not len(over):
                    return
                start += int(over[0])
                begin, value = float(seconds[start]), float(values[start])
                alarm = self._open[name] = WatchAlarm(name, limit, begin, begin, value, begin)
                self.alarms.append(alarm)
            near = values[start:] > _CALM_SHARE * limit
            last = np.maximum.accumulate(np.where(near, seconds[start:], alarm.last_s))
            calm = np.flatnonzero(seconds[start:] - last >= _CALM_S)
            end = start + int(calm[0]) if len(calm) else len(values)
            if end > start:
                row = start + int(np.argmax(values[start:end]))
                if values[row] > alarm.peak:
                    alarm.peak, alarm.peak_s = float(values[row]), float(seconds[row])
                alarm.last_s = float(last[end - start - 1])
            if len(calm):
                alarm.is_over = True
                del self._open[name]
            start = end

    def end_all(self) -> None:
        """End all open alarms, because the estimator and its clock restarted."""
        for alarm in self._open.values():
            alarm.is_over = True
        self._open = {}

    def forget(self, before_s: float) -> None:
        """Forget alarms that ended before a time, s, so that memory is bounded in a live run."""
        self.alarms = [
            alarm for alarm in self.alarms if not alarm.is_over or alarm.last_s >= before_s
        ]

    def is_error(self, alarm: WatchAlarm) -> bool:
        """Return whether an alarm is an error, by the readings so far; if not, it is a warning."""
        if alarm.peak > _GRAVE * alarm.limit or alarm.last_s - alarm.begin_s >= _LASTING_S:
            return True
        source = source_of(alarm.signal)
        return any(
            source_of(other.signal) != source and abs(other.begin_s - alarm.begin_s) <= _TOGETHER_S
            for other in self.alarms
        )

    @property
    def standing(self) -> list[WatchAlarm]:
        """The open alarms, in descending order of peak / limit."""
        return sorted(self._open.values(), key=lambda item: -item.peak / item.limit)
