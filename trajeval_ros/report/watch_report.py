"""The alarms and signals of a watchdog as lines of text, table rows and a figure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.formatting.numbers import counted, four_digits
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.report import canvas
from trajeval_ros.report.line_thinning import thinned
from trajeval_ros.watchdog.recording import Watched
from trajeval_ros.watchdog.signals import in_order, signal_of
from trajeval_ros.watchdog.watch_alarms import AlarmBook

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ALARM_WORDS = ("alarm", "level")
ALARM_NUMBERS = ("begin s", "lasts s", "largest", "limit", "unit")
SIGNAL_WORDS = ("signal",)
SIGNAL_NUMBERS = ("largest", "at s", "limit", "unit", "alarms")
_PANEL_IN, _BELOW_IN = 1.4, 0.4
_PANELS = {
    "pair": "second estimate",
    "imu": "IMU",
    "twist": "twist",
    "map": "map",
    "": "only poses",
}
_LEAST = 1e-2
# A gap is a loss of poses, which no factor makes healthy.
_LOSS = "gap"
# Ratio of the factor to the largest value of a healthy run.
_RESERVE = 1.4
# No events in n hours: the rate is at most this / n per hour, at 95 %.
_RULE_OF_THREE = 3.0
_GAP_NS = 2 * NANOSECONDS
_MOST_CURVES, _MOST_EVENTS = 6, 6
_NARROWEST_ALARM_S = 0.1


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
        place = int(values.argmax())
        rows.append(
            (
                name,
                four_digits(float(values[place])),
                f"{seconds[place]:.2f}",
                four_digits(book.limit(name)),
                signal_of(name).unit,
                str(sum(alarm.signal == name for alarm in book.alarms)),
            )
        )
    return rows


def events_line(seen: Watched) -> str:
    """Return the discontinuities, or the largest of many, with their times and sizes."""
    events = sorted(seen.events, key=lambda event: event.ratio)[-_MOST_EVENTS:]
    texts = [
        f"{event.kind.replace('_', ' ')}{' of ' * bool(event.size)}{event.size} at "
        f"{(event.t_ns - seen.origin) / NANOSECONDS:.2f} s"
        for event in sorted(events, key=lambda event: event.t_ns)
    ]
    rest = len(seen.events) - len(texts)
    more = f" and {rest} smaller" if rest else ""
    return f"discontinuities: {', '.join(texts)}{more}"


def factor_line(seen: Watched, book: AlarmBook) -> str:
    """Return the sentence about the factor that this run needs."""
    largest = {
        name: float(values.max()) / signal_of(name).limit
        for name, (_, values) in seen.signals.items()
        if len(values) and name != _LOSS
    }
    name = max(largest, key=lambda item: largest[item])
    needed = math.ceil(10.0 * _RESERVE * largest[name]) / 10.0
    sentence = f"the largest value is {largest[name]:.2g} times its limit at factor 1 ({name})"
    if needed <= book.factor:
        return f"{sentence}; factor: {book.factor:g}"
    return f"{sentence}; factor: {book.factor:g}. If this run is healthy, use --factor {needed:g}"


def seen_line(seen: Watched, book: AlarmBook) -> str:
    """Return the number of alarms and the observed time."""
    count = len(book.alarms)
    sentence = f"{counted(count, 'alarm')} in {_hours(seen.hours)}"
    if not count and seen.hours:  # the signals of a clip may be of one second
        return f"{sentence}: fewer than {_RULE_OF_THREE / seen.hours:.3g} per hour (95 %)"
    return f"{sentence}, armed at {seen.armed_s:.1f} s"


def _hours(hours: float) -> str:
    """Return a duration in hours, with seconds if it is short."""
    return f"{hours:.2f} h" if hours >= 1.0 else f"{hours:.3f} h ({3600.0 * hours:.0f} s)"


def watch_figure(seen: Watched, book: AlarmBook, name: str) -> Figure:
    """Draw signals relative to their limits, one panel per kind of source."""
    judged = [name for name, (_, values) in seen.signals.items() if len(values)]
    kinds = [kind for kind in _PANELS if any(signal_of(s).needs == kind for s in judged)]
    title = f"{name}, {counted(len(book.alarms), 'alarm')} in {3600 * seen.hours:.0f} s"
    figure = canvas.new_figure(_PANEL_IN * len(kinds) + _BELOW_IN, title)
    if not kinds:
        return figure
    rows = 0
    panels = figure.subplots(len(kinds), 1, sharex=True, squeeze=False)[:, 0]
    for axes, kind in zip(panels, kinds, strict=True):
        _draw(axes, seen, book, [signal for signal in judged if signal_of(signal).needs == kind])
        axes.set_ylabel(f"{_PANELS[kind]}\nvalue / limit")
        rows += canvas.legend_above(axes)
    panels[-1].set_xlim(0.0, seen.end_s)
    panels[-1].set_xlabel("time since the first message [s]")
    canvas.grow(figure, rows)
    return figure


def _draw(axes: Axes, seen: Watched, book: AlarmBook, names: Sequence[str]) -> None:
    """Draw the signals nearest to their limits, and the alarms."""
    ratios = {name: seen.signals[name].values / book.limit(name) for name in names}
    largest = sorted(ratios, key=lambda signal: -float(ratios[signal].max()))[:_MOST_CURVES]
    for number, signal in enumerate(name for name in ratios if name in largest):
        seconds = seen.signals[signal].seconds
        stamps = np.rint(seconds * NANOSECONDS).astype(np.int64)
        columns = np.stack([seconds, np.maximum(ratios[signal], _LEAST)], axis=1)
        colour, dashes = canvas.line_style(number)
        axes.plot(
            *thinned(columns, stamps, lambda steps: steps > _GAP_NS).T,
            color=colour,
            linestyle=dashes,
            label=signal,
        )
    for alarm in book.alarms:
        if alarm.signal in names:
            end_s = max(alarm.last_s, alarm.begin_s + _NARROWEST_ALARM_S)
            axes.axvspan(
                alarm.begin_s, end_s, color=canvas.soft_ink(), alpha=0.25, linewidth=0, zorder=0
            )
    axes.axhline(1.0, color=canvas.text_color(), linewidth=0.8, linestyle="--")
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_ylim(_LEAST, None)
