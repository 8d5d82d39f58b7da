"""Signals of a watch around an alarm, from the JSON file of a black box's clip."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.exceptions import InputError, reason_of
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.valid_poses import LARGEST
from trajeval_ros.io.bags.write_clip import ABOUT, MESSAGES, SCHEMA
from trajeval_ros.io.json_file import mapping_in
from trajeval_ros.io.requests.limits_file import limits_in
from trajeval_ros.io.schema import require_schema
from trajeval_ros.watchdog.alarm_book import AlarmBook
from trajeval_ros.watchdog.recording import Watched
from trajeval_ros.watchdog.signals import Readings, in_order

_LAST_S = 2.0**63 / NANOSECONDS


@dataclass(frozen=True, eq=False)
class WatchedClip:
    """Signals and alarms of a clip, one value a second.

    Attributes:
        estimate: SOURCE of the estimate, in the clip's messages.
        seen: The signals.
        book: The same, compared with the limits of the node that wrote the clip.
    """

    estimate: str
    seen: Watched
    book: AlarmBook


def is_clip(source: str) -> bool:
    """Return whether a source is the folder of a clip."""
    return (Path(source) / ABOUT).is_file()


def read_watched_clip(folder: Path, factor: float | None = None) -> WatchedClip:
    """Read the signals of a clip.

    Args:
        folder: With the messages and the JSON file.
        factor: Ratio of a limit to the largest healthy value; that of the node if None.

    Raises:
        InputError: The JSON file can't be read, or no watch wrote signals into it.
    """
    path = folder / ABOUT
    try:
        about = mapping_in(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path} can't be read: {reason_of(error)}") from error
    if about is None:
        raise InputError(f"{path} is damaged; use another clip")
    require_schema(path, about.get("schema"), SCHEMA, "description of a clip", "use another clip")
    if not about.get("signals"):
        raise InputError(
            f"{folder} has no signals: its cause is a limit of the evaluation; use trajeval "
            f"evaluate with {folder / MESSAGES}"
        )
    try:
        return _clip_in(folder, about["signals"], about["causes"], factor)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path} is damaged; use another clip") from error


def _clip_in(
    folder: Path, about: dict[str, Any], causes: list[dict[str, Any]], factor: float | None
) -> WatchedClip:
    origin = int(about["second_0_ns"])
    rows = {
        name: np.array(values, dtype=float).reshape(-1, 2)
        for name, values in about["largest_by_second"].items()
    }
    signals = {name: Readings(*rows[name].T) for name in in_order(rows)}
    seconds, values = np.concatenate(list(rows.values())).T
    limits = limits_in(about["limits"], folder / ABOUT)
    factor = factor or float(about["factor"])
    times_s = np.abs(origin / NANOSECONDS + seconds)
    if not (times_s.max() < _LAST_S and max(np.abs(values).max(), factor) <= LARGEST):
        raise ValueError("a number is too large")
    book = AlarmBook(limits, factor)
    book.add(signals)
    for cause in causes:
        begin_s = (cause.get("stamp_ns", origin) - origin) / NANOSECONDS
        for alarm in book.alarms:
            if alarm.signal == cause["subject"] and 0.0 <= begin_s - alarm.begin_s < 1.0:
                alarm.begin_s, alarm.last_s = begin_s, max(alarm.last_s, begin_s)
    seen = Watched(origin, signals, float(seconds.min()), float(seconds.max()), ())
    return WatchedClip(f"{folder / MESSAGES}:{about['estimate']}", seen, book)
