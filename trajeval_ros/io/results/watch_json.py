"""The result of a watchdog run as JSON."""

from __future__ import annotations

from typing import Any

from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.watchdog.alarm_book import AlarmBook
from trajeval_ros.watchdog.recording import Watched
from trajeval_ros.watchdog.signals import signal_of

SCHEMA = "trajeval-watch/1"


def watch_json(estimate: str, seen: Watched, book: AlarmBook) -> dict[str, Any]:
    """Return signals with limits, alarms and evidence (docs/watchdog.md).

    Args:
        estimate: SOURCE of the estimate.
        seen: Signals of the run.
        book: Alarms of the run, and the limits.
    """

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
                "limit": book.limits.limit(name, book.factor),
            }
        )
    return {
        "schema": SCHEMA,
        "estimate": estimate,
        "armed_ns": stamp(seen.armed_s),
        "judged_s": seen.end_s - seen.armed_s,
        "factor": book.factor,
        "evidence": {
            "hours": book.limits.hours,
            "most_false_alarms_per_hour": book.limits.most_per_hour,
            "checked": book.limits.checked,
            "sources": dict(book.limits.sources),
        },
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
        "notices": list(seen.notices),
    }
