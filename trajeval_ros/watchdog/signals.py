"""The signals: their sources, units, and minimum healthy values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.arrays import Floats

WINDOWS_S = (1.0, 5.0, 20.0)
# Source of a second estimate, and the separator before its name if there are several.
PAIR, _OF = "pair", "."
_SOURCES = {
    "twist": "twist",
    "imu": "IMU",
    PAIR: "second estimate",
    "map": "map-to-odom transform",
}


class Signal(NamedTuple):
    """A quantity that is small for a healthy estimate.

    Attributes:
        name: Name in limits, tables and topics.
        unit: Unit of the values; "" for ratios.
        needs: The source that it needs in addition to poses: "", `twist`, `imu`, `pair` or `map`.
        floor: Minimum healthy value for a limit, for runs in which the robot is idle.
        least_factor: Minimum ratio of its limit to the healthy value.
        words: Description for messages.
    """

    name: str
    unit: str
    needs: str
    floor: float
    words: str
    least_factor: float = 0.0


class Readings(NamedTuple):
    """Values of one signal.

    Attributes:
        seconds: (N,), since the watch started; increasing.
        values: (N,), finite, in the signal's unit.
    """

    seconds: Floats
    values: Floats


Signals = Mapping[str, Readings]


def _windowed(stem: str, needs: str, words: str, windows: tuple[float, ...]) -> list[Signal]:
    """Return one signal per window; the floor increases with the window."""
    in_metres = stem.endswith("_m")
    return [
        Signal(
            f"{stem}_{window:g}s",
            "m" if in_metres else "deg",
            needs,
            0.01 + 0.005 * window if in_metres else 0.1 + 0.02 * window,
            f"{words} in {window:g} s",
        )
        for window in windows
    ]


SIGNALS: tuple[Signal, ...] = (
    *_windowed("pair_m", PAIR, "translation, difference of two estimates", WINDOWS_S),
    *_windowed("pair_deg", PAIR, "rotation, difference of two estimates", WINDOWS_S),
    *_windowed("pair_angle_deg", PAIR, "angle turned, difference of two estimates", WINDOWS_S),
    Signal(
        "pair_scale",
        "",
        PAIR,
        0.02,
        "log ratio of the path lengths of two estimates in 10 s",
        3.0,
    ),
    *_windowed("gyro_deg", "imu", "rotation, estimate against gyroscope", WINDOWS_S),
    Signal("gyro_slip_ms", "ms", "imu", 3.0, "clock of the estimate against the gyroscope"),
    *_windowed("twist_m", "twist", "translation, pose against twist", WINDOWS_S[:2]),
    Signal("twist_scale", "", "twist", 0.01, "slope of pose over twist in 10 s, minus 1"),
    Signal("smooth", "", "", 30.0, "median innovation over innovation of the last second"),
    Signal("freeze_hard_s", "s", "", 0.25, "same pose since a stop without slowing down"),
    Signal("jump_m", "m", "", 0.01, "innovation of position against constant velocity"),
    Signal(
        "jump_deg", "deg", "", 0.1, "innovation of rotation against constant angular velocity", 3.0
    ),
    Signal("gap", "", "", 1.5, "time since the last pose, in median periods"),
    Signal("jitter", "", "", 0.02, "RMS of timestamp intervals in 1 s, in median periods"),
    Signal("gravity_deg_1s", "deg", "imu", 0.5, "direction of gravity, IMU against estimate"),
    Signal("gravity_deg_5s", "deg", "imu", 0.3, "direction of gravity in 5 s"),
    Signal("gravity_mps2_5s", "m/s2", "imu", 0.05, "gravity vector in 5 s"),
    Signal("speed", "", "", 1.0, "speed over the largest speed until 5 s ago"),
    Signal("standstill_m", "m", "imu", 0.005, "motion in 1 s while the IMU is at rest"),
    *_windowed("map_correction_m", "map", "translation by map corrections", WINDOWS_S),
    *_windowed("map_correction_deg", "map", "rotation by map corrections", WINDOWS_S),
)
SIGNAL_NAMED = {signal.name: signal for signal in SIGNALS}


def pair_sources(names: Sequence[str]) -> list[str]:
    """Return the sources of second estimates: `pair` for one, `pair.NAME` for several.

    Args:
        names: Names of the second estimates: letters, digits and underscores.

    Raises:
        SettingsError: Two have the same name.

    Example:
        >>> from trajeval_ros.watchdog.signals import pair_sources
        >>> pair_sources(["vio"]), pair_sources(["vio", "wheel"])
        (['pair'], ['pair.vio', 'pair.wheel'])
    """
    if len(set(names)) < len(names):
        twice = next(each for each in names if names.count(each) > 1)
        raise SettingsError(f"two second estimates have the name {twice}; remove one of them")
    return [PAIR] if len(names) == 1 else [f"{PAIR}{_OF}{name}" for name in names]


def signal_of(name: str) -> Signal:
    """Return the signal of a name such as `pair_m_1s` or `pair_m_1s.wheel`."""
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
