"""The result of a watchdog run as JSON."""

from __future__ import annotations

from typing import Any

from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.watchdog.recording import Watched
from trajeval_ros.watchdog.signals import signal_of
from trajeval_ros.watchdog.watch_alarms import AlarmBook

_OF_EVENT = "kind", "t_ns", "end_ns", "m", "deg", "s", "certainty", "ratio", "gap_s"
SCHEMA = "trajeval-watch/3"


def watch_json(estimate: str, seen: Watched, book: AlarmBook) -> dict[str, Any]:
    """Return signals with limits, and alarms (docs/watchdog.md), of the SOURCE `estimate`."""

    def stamp(seconds: float) -> int:
        return seen.origin + round(seconds * NANOSECONDS)

    signals = []
    for name, (seconds, values) in seen.signals.items():
        if not len(values):
            continue
        row = int(values.argmax())
        signals.append(
            {
                "name": name,
                "unit": signal_of(name).unit,
                "largest": float(values[row]),
                "stamp_ns": stamp(float(seconds[row])),
                "limit": book.limit(name),
            }
        )
    return {
        "schema": SCHEMA,
        "estimate": estimate,
        "armed_ns": stamp(seen.armed_s),
        "judged_s": seen.end_s - seen.armed_s,
        "factor": book.factor,
        "alarms": [
            {
                "signal": alarm.signal,
                "level": "error" if book.is_error(alarm) else "warning",
                "begin_ns": stamp(alarm.begin_s),
                "last_ns": stamp(alarm.last_s),
                "is_over": alarm.is_over,
                "peak": alarm.peak,
                "peak_ns": stamp(alarm.peak_s),
                "limit": alarm.limit,
            }
            for alarm in book.alarms
        ],
        "signals": signals,
        "events": [{name: getattr(event, name) for name in _OF_EVENT} for event in seen.events],
        "notices": list(seen.notices),
    }
