"""Periods of a recorded run in which the watchdog reports errors."""

from __future__ import annotations

from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.watchdog.alarm_book import AlarmBook
from trajeval_ros.watchdog.limits import DEFAULT_FACTOR, WatchLimits
from trajeval_ros.watchdog.recording import WatchedRun, watched


def error_spans(run: WatchedRun, limits: WatchLimits) -> list[tuple[int, int]]:
    """Return first and last timestamp of every error, ns, in the estimate's clock.

    Raises:
        InputError: The run can't be watched, or the limits are of another robot.
    """
    seen = watched(run)
    limits.require_of(seen.signals)
    book = AlarmBook(limits, DEFAULT_FACTOR)
    book.add(seen.signals)
    return [
        (
            seen.origin + round(alarm.begin_s * NANOSECONDS),
            seen.origin + round(alarm.last_s * NANOSECONDS),
        )
        for alarm in book.alarms
        if book.is_error(alarm)
    ]
