"""What is watched: the signals, what they need, and the least that a limit may be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry.arrays import Floats

WINDOWS_S = (1.0, 5.0, 20.0)


class Signal(NamedTuple):
    """A quantity that a healthy estimate keeps small.

    Attributes:
        name: As in limits, tables and topics.
        unit: Of its values; "" for ratios.
        needs: The source it needs beside poses: "", `twist`, `imu` or `pair`.
        floor: The least healthy value that a limit is taken of: an idle robot learns nothing.
        least_factor: Below this multiple of the healthy value it is worth no alarm.
        words: What it is.
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
        seconds: (N,) since the watch began; rising.
        values: (N,), finite, in the signal's unit.
    """

    seconds: Floats
    values: Floats


Signals = Mapping[str, Readings]


def _windowed(stem: str, needs: str, words: str, windows: tuple[float, ...]) -> list[Signal]:
    """Return the same signal over several windows; longer ones may drift further."""
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
    *_windowed("pair_m", "pair", "translation, difference of two estimates", WINDOWS_S),
    *_windowed("pair_deg", "pair", "rotation, difference of two estimates", WINDOWS_S),
    *_windowed("pair_angle_deg", "pair", "angle turned, difference of two estimates", WINDOWS_S),
    Signal(
        "pair_scale",
        "",
        "pair",
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
)
SIGNAL_NAMED = {signal.name: signal for signal in SIGNALS}


def finite(seconds: Floats, values: Floats) -> Readings:
    """Return the values that are known."""
    known = np.isfinite(values)
    return Readings(seconds[known], values[known])


def joined(parts: list[Signals]) -> dict[str, Readings]:
    """Return signals that came one after the other as one."""
    names = dict.fromkeys(name for part in parts for name in part)
    return {
        name: Readings(
            np.concatenate([part[name].seconds for part in parts if name in part]),
            np.concatenate([part[name].values for part in parts if name in part]),
        )
        for name in names
    }
