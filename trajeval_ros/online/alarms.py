"""Alarms: limits of quantities, and their largest values since the last check."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from trajeval_ros.formatting.numbers import with_unit
from trajeval_ros.online.notices import ERROR, WARN, Notice
from trajeval_ros.online.reports import Snapshot, Update


class LimitedQuantity(NamedTuple):
    """A quantity with one limit for warnings and one for errors.

    Attributes:
        name: Suffix of the parameters `warn_NAME` and `error_NAME`.
        words: The quantity in words.
        unit: Unit of the quantity and its limits; empty for a plain number.
    """

    name: str
    words: str
    unit: str


LIMITED_QUANTITIES = (
    LimitedQuantity("position_error_m", "position error", "m"),
    LimitedQuantity("rotation_error_deg", "rotation error", "deg"),
    LimitedQuantity("yaw_error_deg", "yaw error", "deg"),
    LimitedQuantity("ate_position_m", "position ATE of the window", "m"),
    LimitedQuantity("drift_percent", "drift over a sub-trajectory", "%"),
    LimitedQuantity("nees", "mean NEES of the window per degree of freedom", ""),
    LimitedQuantity("latency_s", "time from arrival to publication", "s"),
    LimitedQuantity("staleness_s", "time without a message", "s"),
)


class Peak(NamedTuple):
    """The largest value of a quantity.

    Attributes:
        value: In the quantity's unit.
        stamp: Timestamp of its pair, nanoseconds; None if it belongs to no pair.
    """

    value: float
    stamp: int | None = None


class Peaks:
    """The largest values of limited quantities between two checks."""

    def __init__(self) -> None:
        """Create it without values."""
        self._peaks: dict[str, Peak] = {}

    def see(self, name: str, value: float | None, stamp: int | None = None) -> None:
        """Take a value of a quantity; None is ignored."""
        if value is not None and (name not in self._peaks or value > self._peaks[name].value):
            self._peaks[name] = Peak(value, stamp)

    def see_update(self, update: Update, *, knows_up: bool) -> None:
        """Take the errors of new pairs and of completed sub-trajectories.

        Args:
            update: The new results.
            knows_up: False ignores errors that depend on the up axis.
        """
        for errors in update.errors:
            yaw = errors.yaw_deg if knows_up else None
            for name, values in (
                ("position_error_m", errors.position_m),
                ("rotation_error_deg", errors.rotation_deg),
                ("yaw_error_deg", None if yaw is None else np.abs(yaw)),
            ):
                if values is not None:
                    row = int(values.argmax())
                    self.see(name, float(values[row]), int(errors.stamps[row]))
        for end in update.ends:
            self.see("drift_percent", end.drift_percent, end.stamp)

    def see_snapshot(self, snapshot: Snapshot) -> None:
        """Take the statistics of the window."""
        self.see("ate_position_m", snapshot.window_position_rmse_m)
        self.see("nees", None if snapshot.nees is None else snapshot.nees.mean)

    def take(self) -> dict[str, Peak]:
        """Return the largest values since the last call by name, and reset them."""
        peaks, self._peaks = self._peaks, {}
        return peaks


def alarms(peaks: Mapping[str, Peak], limits: Mapping[str, Any]) -> list[Notice]:
    """Return an alarm for every quantity above its limit.

    Args:
        peaks: The largest values by name of the quantity.
        limits: The limits by `warn_NAME` and `error_NAME`; 0 is no limit.
    """
    notices = []
    for name, words, unit in LIMITED_QUANTITIES:
        if name not in peaks:
            continue
        value, stamp = peaks[name]
        for level, limit in ((ERROR, limits[f"error_{name}"]), (WARN, limits[f"warn_{name}"])):
            if 0.0 < limit < value:
                number, bound = (with_unit(quantity, unit) for quantity in (value, limit))
                text = f"{words} {number} is over {bound}"
                values: dict[str, float | int | str] = {
                    "value": value,
                    "limit": limit,
                    "unit": unit,
                }
                if stamp is not None:
                    values["stamp_ns"] = stamp
                notices.append(Notice("alarm", level, text, name, values))
                break
    return notices
