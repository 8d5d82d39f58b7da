"""Signals of map corrections: how far they move the robot in the map."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.watchdog.recent import (
    HALF_NS,
    POSE_WIDTH,
    POSITION,
    QUATERNION,
    REMEMBERED_S,
    TIME,
    Recent,
    interpolated,
    lengths,
    only,
)
from trajeval_ros.watchdog.rotations_over_time import angles_deg, between
from trajeval_ros.watchdog.signals import WINDOWS_S, Signals, finite


class CorrectionSignals:
    """Compares the transform from the map with the transform one window earlier, at the robot.

    If the robot's position in the estimate's frame is p, its position in the map is T p. A
    correction from T' to T moves the robot by T p - T' p and rotates it by the angle of T'^-1 T. A
    transform is valid until the next one.
    """

    def __init__(self) -> None:
        """Create it without a transform."""
        self._states = Recent(POSE_WIDTH)
        self._transforms = Recent(POSE_WIDTH)
        self._done = -np.inf

    def add(self, rows: Floats) -> Signals:
        """Add states (N, 9 or more); return the signals at transforms up to the last state."""
        self._states.append(rows[:, :POSE_WIDTH])
        self._states.forget_until(rows[-1, TIME] - REMEMBERED_S)
        return self._advance()

    def add_transforms(self, rows: Floats) -> Signals:
        """Add transforms (N, 9); return the signals at transforms up to the last state."""
        self._transforms.append(rows)
        self._transforms.forget_until(rows[-1, TIME] - REMEMBERED_S)
        return self._advance()

    def _advance(self) -> Signals:
        states, rows = self._states.rows, self._transforms.rows
        if not len(states):
            return {}
        first = int(np.searchsorted(rows[:, TIME], self._done, side="right"))
        ready = int(np.searchsorted(rows[:, TIME], states[-1, TIME], side="right"))
        if first >= ready:
            return {}
        new = rows[first:ready]
        times = new[:, TIME]
        robot = interpolated(states[:, TIME], states[:, POSITION], times)
        signals = {}
        for window_s in WINDOWS_S:
            before = np.searchsorted(rows[:, TIME], times - window_s + HALF_NS, side="right") - 1
            old = rows[np.maximum(before, 0)]
            moved = lengths(_in_map(new, robot) - _in_map(old, robot))
            turned = angles_deg(between(old[:, QUATERNION], new[:, QUATERNION]))
            for stem, values in (("map_correction_m", moved), ("map_correction_deg", turned)):
                signals[f"{stem}_{window_s:g}s"] = finite(times, only(values, before >= 0))
        self._done = float(times[-1])
        self._states.forget_until(self._done)
        self._transforms.forget_until(self._done - WINDOWS_S[-1])
        return signals


def _in_map(transforms: Floats, positions: Floats) -> Floats:
    """Return positions (N, 3) of the estimate, transformed to the map by transforms (N, 9)."""
    moved: Floats = lie.rotate(transforms[:, QUATERNION], positions) + transforms[:, POSITION]
    return moved
