"""Signals of discontinuities, of the estimate alone."""

from __future__ import annotations

from collections import deque

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.discontinuities.events import CLOCK_STEP, ESTIMATE, FREEZES, GAP, Event
from trajeval_ros.metrics.discontinuities.exoneration import GAP_PERIODS
from trajeval_ros.metrics.discontinuities.one_stream import KnownEvent, OneStream
from trajeval_ros.watchdog.row_buffer import HALF_NS
from trajeval_ros.watchdog.signals import Readings, Signals

_MOST_EVENTS = 1000  # that are remembered: more take memory in a long live run


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
