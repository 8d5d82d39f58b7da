"""The signals: their sources, units and limits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.arrays import Floats

# Source of a second estimate, and the separator before its name if there are several.
PAIR, _OF = "pair", "."
_SOURCES = {
    "twist": "twist",
    "imu": "IMU",
    PAIR: "second estimate",
    "map": "map-to-odom transform",
}


class Signal(NamedTuple):
    """A quantity that is small for a healthy estimate."""

    name: str  # name in limits, tables and topics
    unit: str  # unit of the values; "" for ratios
    # The source that it needs in addition to poses: "", `twist`, `imu`, `pair` or `map`.
    needs: str
    # Limit at factor 1: above the largest value of healthy flights, walks and drives.
    limit: float
    words: str  # description for messages


class Readings(NamedTuple):
    """Values of one signal."""

    seconds: Floats  # (N,), since the watch started; increasing
    values: Floats  # (N,), finite, in the signal's unit


Signals = Mapping[str, Readings]


SIGNALS: tuple[Signal, ...] = (
    Signal("pair_percent_5s", "%", PAIR, 7.0, "translation in 5 s, difference of two estimates"),
    Signal("pair_percent_20s", "%", PAIR, 7.0, "translation in 20 s, difference of two estimates"),
    Signal("pair_deg_5s", "deg", PAIR, 3.0, "rotation in 5 s, difference of two estimates"),
    Signal("pair_deg_20s", "deg", PAIR, 4.0, "rotation in 20 s, difference of two estimates"),
    Signal("gyro_deg_1s", "deg", "imu", 2.0, "rotation in 1 s, estimate against gyroscope"),
    Signal("gyro_deg_20s", "deg", "imu", 4.0, "rotation in 20 s, estimate against gyroscope"),
    Signal("gravity_mps2_5s", "m/s2", "imu", 0.4, "gravity in 5 s, IMU against estimate"),
    Signal("twist_m_5s", "m", "twist", 0.2, "translation in 5 s, pose against twist"),
    Signal("smooth", "", "", 60.0, "median innovation over innovation of the last second"),
    *(
        Signal(kind, "", "", 1.5, f"{words}, in multiples of the usual differences")
        for kind, words in (
            ("step", "jump of the pose"),
            ("restart", "jump of the pose to the first one"),
            ("outlier", "pose that leaves the path and returns"),
            ("flip", "rotation by more than 60 deg that returns"),
            ("flip_stays", "rotation by more than 60 deg that stays"),
            ("lost", "jumps without a calm second"),
        )
    ),
    Signal("frozen_position", "s", "", 0.5, "same position since a stop without slowing down"),
    Signal("frozen_rotation", "s", "", 0.5, "same rotation since a stop without slowing down"),
    Signal("gap", "", "", 4.0, "time since the last pose, in median periods"),
    Signal("clock_step", "s", "", 0.04, "jump of the timestamps, by the receive times"),
    Signal("map_correction_m_1s", "m", "map", 0.3, "translation in 1 s by map corrections"),
    Signal("map_correction_deg_1s", "deg", "map", 6.0, "rotation in 1 s by map corrections"),
)
SIGNAL_NAMED = {signal.name: signal for signal in SIGNALS}


def pair_sources(names: Sequence[str]) -> list[str]:
    """Return the sources of second estimates: `pair` for one, `pair.NAME` for several."""
    if len(set(names)) < len(names):
        twice = next(item for item in names if names.count(item) > 1)
        raise SettingsError(f"two second estimates have the name {twice}; remove one of them")
    return [PAIR] if len(names) == 1 else [f"{PAIR}{_OF}{name}" for name in names]


def signal_of(name: str) -> Signal:
    """Return the signal of a name such as `pair_deg_5s` or `pair_deg_5s.wheel`."""
    return SIGNAL_NAMED[name.partition(_OF)[0]]


def source_of(name: str) -> str:
    """Return the source of a signal, such as `imu`, `pair` or `pair.wheel`."""
    stem, of, partner = name.partition(_OF)
    return SIGNAL_NAMED[stem].needs + of + partner


def source_words(source: str) -> str:
    """Return a source for messages: `IMU`, `second estimate`, `second estimate wheel`."""
    kind, _, partner = source.partition(_OF)
    return f"{_SOURCES[kind]} {partner}".rstrip()


def in_order(names: Iterable[str]) -> list[str]:
    """Return the names of signals in the order of `SIGNALS`."""
    places = {name: place for place, name in enumerate(SIGNAL_NAMED)}
    return sorted(names, key=lambda name: places[name.partition(_OF)[0]])


def finite(seconds: Floats, values: Floats) -> Readings:
    """Return the readings without values that are not finite."""
    known = np.isfinite(values)
    return Readings(seconds[known], values[known])


def joined(parts: list[Signals]) -> dict[str, Readings]:
    """Concatenate signals that follow each other in time."""
    names = dict.fromkeys(name for part in parts for name in part)
    return {
        name: Readings(
            np.concatenate([part[name].seconds for part in parts if name in part]),
            np.concatenate([part[name].values for part in parts if name in part]),
        )
        for name in names
    }
