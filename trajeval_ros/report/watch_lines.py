"""The results of a watchdog as table rows and lines."""

from __future__ import annotations

from trajeval_ros.formatting.numbers import NOTHING, counted, four_digits
from trajeval_ros.watchdog.alarm_book import AlarmBook
from trajeval_ros.watchdog.limits import RULE_OF_THREE, WatchLimits
from trajeval_ros.watchdog.recording import Watched
from trajeval_ros.watchdog.signals import in_order, signal_of

ALARM_WORDS = ("alarm", "level")
ALARM_NUMBERS = ("begin s", "lasts s", "largest", "limit", "unit")
SIGNAL_WORDS = ("signal",)
SIGNAL_NUMBERS = ("largest", "at s", "healthy", "limit", "unit", "alarms")


def alarm_rows(book: AlarmBook) -> list[tuple[str, ...]]:
    """Return a row per alarm."""
    return [
        (
            alarm.signal,
            "error" if book.is_error(alarm) else "warning",
            f"{alarm.begin_s:.2f}",
            f"{alarm.last_s - alarm.begin_s:.2f}" + ("" if alarm.is_over else " +"),
            four_digits(alarm.peak),
            four_digits(alarm.limit),
            signal_of(alarm.signal).unit,
        )
        for alarm in sorted(book.alarms, key=lambda alarm: alarm.begin_s)
    ]


def signal_rows(seen: Watched, book: AlarmBook) -> list[tuple[str, ...]]:
    """Return a row per signal that has values."""
    rows: list[tuple[str, ...]] = []
    for name in in_order(seen.signals):
        seconds, values = seen.signals[name]
        if not len(values):
            continue
        limit = book.limits.limit(name, book.factor)
        place = int(values.argmax())
        healthy = book.limits.healthy.get(name)
        rows.append(
            (
                name,
                four_digits(float(values[place])),
                f"{seconds[place]:.2f}",
                NOTHING if healthy is None else four_digits(healthy.largest),
                NOTHING if limit is None else four_digits(limit),
                signal_of(name).unit,
                str(sum(alarm.signal == name for alarm in book.alarms)),
            )
        )
    return rows


def evidence_line(limits: WatchLimits, factor: float) -> str:
    """Return the sentence about the reliability of the limits, for all reports with alarms."""
    return (
        f"limits: {factor:g} times the largest values in {_hours(limits.hours)} of a run "
        f"({limits.checked or 'not checked'}); without alarms in that run, false alarms in "
        f"similar runs are fewer than {limits.most_per_hour:.3g} per hour (95 %, "
        f"{RULE_OF_THREE:g}/hours)"
    )


def seen_line(seen: Watched, book: AlarmBook) -> str:
    """Return the number of alarms and the observed time."""
    count = len(book.alarms)
    said = f"{counted(count, 'alarm')} in {_hours(seen.hours)}"
    if not count and seen.hours:  # the signals of a clip may be of one second
        return f"{said}: fewer than {RULE_OF_THREE / seen.hours:.3g} per hour (95 %)"
    return f"{said}, armed at {seen.armed_s:.1f} s"


def _hours(hours: float) -> str:
    """Return a duration in hours, with seconds if it is short."""
    return f"{hours:.2f} h" if hours >= 1.0 else f"{hours:.3f} h ({3600.0 * hours:.0f} s)"
