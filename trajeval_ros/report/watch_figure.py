"""Signals of a watchdog over time, relative to their limits, with the alarms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.report import canvas
from trajeval_ros.report.line_thinning import thinned
from trajeval_ros.watchdog.alarm_book import AlarmBook
from trajeval_ros.watchdog.recording import Watched
from trajeval_ros.watchdog.signals import signal_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PANEL_IN, _BELOW_IN = 1.4, 0.4
_PANELS = {
    "pair": "second estimate",
    "imu": "IMU",
    "twist": "twist",
    "map": "map",
    "": "only poses",
}
_LEAST = 1e-2
_GAP_S = 2.0
_MOST_CURVES = 6
_NARROWEST_ALARM_S = 0.1


def watch_figure(seen: Watched, book: AlarmBook, name: str) -> Figure:
    """Draw signals relative to their limits, one panel per kind of source.

    Args:
        seen: The signals.
        book: The limits and alarms.
        name: Name of the estimate in the figure.
    """
    judged = [name for name in seen.signals if book.limits.limit(name, book.factor) is not None]
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
    ratios = {}
    for signal in names:
        limit = book.limits.limit(signal, book.factor)
        if limit and len(seen.signals[signal].values):
            ratios[signal] = seen.signals[signal].values / limit
    largest = sorted(ratios, key=lambda signal: -float(ratios[signal].max()))[:_MOST_CURVES]
    for number, signal in enumerate(name for name in ratios if name in largest):
        seconds = seen.signals[signal].seconds
        stamps = np.rint(seconds * NANOSECONDS).astype(np.int64)
        columns = np.stack([seconds, np.maximum(ratios[signal], _LEAST)], axis=1)
        colour, dashes = canvas.line_style(number)
        axes.plot(
            *thinned(columns, stamps, _GAP_S).T, color=colour, linestyle=dashes, label=signal
        )
    for alarm in book.alarms:
        if alarm.signal in names:
            end_s = max(alarm.last_s, alarm.begin_s + _NARROWEST_ALARM_S)
            axes.axvspan(
                alarm.begin_s, end_s, color=canvas.soft_ink(), alpha=0.25, linewidth=0, zorder=0
            )
    axes.axhline(1.0, color=canvas.ink(), linewidth=0.8, linestyle="--")
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_ylim(_LEAST, None)
