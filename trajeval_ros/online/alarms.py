"""Alarms: limits of quantities, their largest values since the last check, and active remarks."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.formatting.numbers import with_unit
from trajeval_ros.formatting.remarks import Level, Remark
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.discontinuities.events import FROZEN
from trajeval_ros.online.reports import Snapshot, Update

_ERROR_S = 3.0  # an estimate that is lost for this time is an error


class LimitedQuantity(NamedTuple):
    """A quantity with one limit for warnings and one for errors."""

    name: str  # its name; the parameter of its limits is `limits_NAME`
    words: str  # the quantity in words
    unit: str  # unit of the quantity and its limits; empty for a plain number


LIMITED_QUANTITIES = (
    LimitedQuantity("position_error_m", "position error", "m"),
    LimitedQuantity("rotation_error_deg", "rotation error", "deg"),
    LimitedQuantity("yaw_error_deg", "yaw error", "deg"),
    LimitedQuantity("ate_position_m", "position ATE of the window", "m"),
    LimitedQuantity("drift_percent", "drift over a sub-trajectory", "%"),
    LimitedQuantity("nees", "mean NEES of the window per degree of freedom", ""),
    LimitedQuantity("latency_s", "time from arrival to publication", "s"),
    LimitedQuantity("staleness_s", "time without a message", "s"),
    LimitedQuantity("age_s", "95th percentile of the age of the newest pose", "s"),
    LimitedQuantity("arrival_s", "95th percentile of arrival after timestamp", "s"),
)


class AlarmLimits(NamedTuple):
    """Limits of a quantity; 0 is no limit."""

    warn: float = 0.0  # limit for warnings, in the quantity's unit
    error: float = 0.0  # limit for errors

    @classmethod
    def parse(cls, text: str, name: str) -> AlarmLimits:
        """Return the limits in a text such as 0.5,1.0; one number is the limit for errors."""
        try:
            numbers = [float(word) for word in text.split(",")] if text else [0.0]
        except ValueError:
            numbers = []
        if not 1 <= len(numbers) <= 2 or not all(0.0 <= number < math.inf for number in numbers):
            raise SettingsError(
                f"parameter {name} must be the limits for warnings and errors, as in 0.5,1.0, not "
                f"{text!r}"
            )
        return cls(*numbers) if len(numbers) == 2 else cls(error=numbers[0])

    @property
    def by_level(self) -> tuple[tuple[Level, float], ...]:
        """The limits with their levels, the most severe first."""
        return (Level.ERROR, self.error), (Level.WARNING, self.warn)


class Peak(NamedTuple):
    """The largest value of a quantity."""

    value: float  # in the quantity's unit
    stamp: int | None = None  # timestamp of its pair, nanoseconds; None if it belongs to no pair


class MaxSinceLast:
    """The largest values of limited quantities between two checks."""

    def __init__(self) -> None:
        self._peaks: dict[str, Peak] = {}

    def see(self, name: str, value: float | None, stamp: int | None = None) -> None:
        """Take a value of a quantity; None is ignored."""
        if value is not None and (name not in self._peaks or value > self._peaks[name].value):
            self._peaks[name] = Peak(value, stamp)

    def see_update(self, update: Update) -> None:
        """Take the errors of new pairs and of completed sub-trajectories."""
        for errors in update.errors:
            yaw = errors.yaw_deg
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


def alarms(peaks: Mapping[str, Peak], limits: Mapping[str, AlarmLimits]) -> list[Remark]:
    """Return an alarm for every quantity above its limit, by the names of the quantities."""
    remarks = []
    for name, words, unit in LIMITED_QUANTITIES:
        if name in peaks:
            value, stamp = peaks[name]
            at = {} if stamp is None else {"stamp_ns": stamp}
            for level, limit in limits[name].by_level:
                if 0.0 < limit < value:
                    text = f"{words} {with_unit(value, unit)} is over {with_unit(limit, unit)}"
                    values: dict[str, float | int | str] = {"value": value, "limit": limit}
                    values |= {"unit": unit, **at}
                    remarks.append(Remark(level, "alarm", text, name, values))
                    break
    return remarks


def alarm_below(name: str, value: float, limits: AlarmLimits, text: str) -> list[Remark]:
    """Return an alarm if a quantity is below a limit; the text may contain {limit}."""
    for level, limit in limits.by_level:
        if value < limit:
            values = {"value": value, "limit": limit}
            return [Remark(level, "alarm", text.format(limit=limit), name, values)]
    return []


def about_loss(snapshot: Snapshot) -> list[Remark]:
    """Return the remark about a frozen or diverging estimate, if it is lost."""
    loss, ate_m = snapshot.loss, snapshot.ate_before_loss_m
    if loss is None:
        return []
    at = f"{loss.t_ns / NANOSECONDS:.3f} s"
    if loss.kind == FROZEN:
        text = f"the estimate repeats its pose since {at}, while the groundtruth moves"
    else:
        text = f"the estimate diverges from the groundtruth since {at}"
    values: dict[str, float | int | str] = {
        "stamp_ns": loss.t_ns,
        "duration_s": loss.s,
        "true_m": loss.m,
        "moved_m": loss.moved_m,
    }
    if ate_m is not None:
        text += f"; the ATE until then is {with_unit(ate_m, 'm')}"
        values["ate_before_m"] = ate_m
    level = Level.ERROR if loss.s >= _ERROR_S else Level.WARNING
    return [Remark(level, loss.kind, text, values=values)]


_SHOWN_S = 10.0  # a text stays this long before its numbers change, so that it can be read
_NUMBERS = re.compile(r"[-+.,\d]+")


class ActiveAlarms:
    """The active remarks. Each is reported once when it starts, gets more severe, or ends.

    `clock` returns a time in seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        # Remarks and the times of their texts, by code and subject.
        self._shown: dict[tuple[str, str], tuple[Remark, float]] = {}

    def renew(self, remarks: Iterable[Remark]) -> list[Remark]:
        """Take all active remarks; returns new ones, and ended ones as notes."""
        before, reported = self._shown, list(self._with_times(remarks))
        self._shown = {_key(item[0]): item for item in reported if item[0].level != Level.NOTE}
        started = [
            remark
            for key, (remark, _) in self._shown.items()
            if key not in before or remark.level > before[key][0].level
        ]
        ended = [
            replace(remark, level=Level.NOTE, text=f"no longer: {remark.text}")
            for key, (remark, _) in before.items()
            if key not in self._shown
        ]
        return started + ended

    def kept_texts(self, remarks: Iterable[Remark]) -> list[Remark]:
        """Return remarks; if only numbers of a text change, it is kept for 10 s."""
        return [remark for remark, _ in self._with_times(remarks)]

    def _with_times(self, remarks: Iterable[Remark]) -> Iterator[tuple[Remark, float]]:
        now_s = self._clock()
        for remark in remarks:
            shown, since_s = self._shown.get(_key(remark), (remark, now_s))
            is_same = (shown.level, _words(shown)) == (remark.level, _words(remark))
            keeps = is_same and (shown.text == remark.text or now_s < since_s + _SHOWN_S)
            yield (shown, since_s) if keeps else (remark, now_s)


def _words(remark: Remark) -> str:
    return _NUMBERS.sub("", remark.text)


def _key(remark: Remark) -> tuple[str, str]:
    return remark.code, remark.subject
