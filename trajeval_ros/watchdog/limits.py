"""Limits learned from a healthy run of the same robot and estimator, and their evidence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.watchdog.signals import Signals, in_order, signal_of, source_of, source_words

DEFAULT_FACTOR = 2.0
# Between runs of the same robot and estimator, typical values differ by a smaller factor.
_ANOTHER_ROBOT = 10.0
_FEWEST = 100
# No events in n hours: the rate is at most this / n per hour, at 95 %.
RULE_OF_THREE = 3.0


@dataclass(frozen=True)
class HealthyValues:
    """Statistics of a signal in a healthy run.

    Attributes:
        largest: Its largest value.
        typical: Its median.
    """

    largest: float
    typical: float


@dataclass(frozen=True)
class WatchLimits:
    """Statistics of all signals in a healthy run.

    Attributes:
        healthy: Statistics by name of the signal.
        hours: Duration since arming, in hours.
        sources: SOURCE by name: `estimate`, and `imu`, `map`, `pair` or `pair.NAME` if given.
        checked: How the run was found to be healthy.
    """

    healthy: Mapping[str, HealthyValues]
    hours: float
    sources: Mapping[str, str] = field(default_factory=dict)
    checked: str = ""

    @classmethod
    def learned(
        cls, signals: Signals, hours: float, sources: Mapping[str, str], checked: str
    ) -> WatchLimits:
        """Return the limits of a run that is assumed to be healthy.

        Args:
            signals: All values of its signals.
            hours: Duration since arming, in hours.
            sources: SOURCE by name, as in `sources`.
            checked: How the run was found to be healthy.
        """
        healthy = {
            name: HealthyValues(float(values.max()), float(np.median(values)))
            for name, (_, values) in signals.items()
            if len(values)
        }
        return cls(healthy, hours, sources, checked)

    def limit(self, name: str, factor: float) -> float | None:
        """Return the limit of a signal, in its unit; None if it was not in the healthy run."""
        if name not in self.healthy:
            return None
        signal = signal_of(name)
        return max(factor, signal.least_factor) * max(self.healthy[name].largest, signal.floor)

    @property
    def most_per_hour(self) -> float:
        """Upper 95 % bound of the false alarm rate per hour, if the healthy hours had no alarm."""
        return RULE_OF_THREE / self.hours

    def require_sources(self, needs: Iterable[str]) -> None:
        """Refuse limits that were learned without a source.

        Args:
            needs: The available sources, such as `twist`, `imu`, `pair`, `pair.wheel`, `map`.

        Raises:
            InputError: The limits were learned without one of the sources.
        """
        there = {source_of(name) for name in self.healthy}
        for each in needs:
            if each and each not in there:
                raise InputError(
                    f"the limits were learned without the {source_words(each)}, which this run "
                    "has; learn them again from a run with the same sources, or remove it"
                )

    def require_of(self, signals: Signals) -> None:
        """Refuse limits that were learned from another robot or other sources.

        Raises:
            InputError: They lack a source of this run, or typical values differ too much.
        """
        self.require_sources(source_of(name) for name in in_order(signals))
        off = {}
        compared = 0
        for name in self.healthy.keys() & signals.keys():
            values, learned = signals[name].values, self.healthy[name].typical
            if len(values) < _FEWEST or not learned:
                continue
            # A fault affects a part of the run, another robot all of it.
            quarters = [float(np.median(part)) for part in np.array_split(values, 4)]
            if max(quarters) > 0.0:
                compared += 1
                if min(quarters) >= _ANOTHER_ROBOT * learned:
                    off[name] = learned, min(quarters)
                elif max(quarters) <= learned / _ANOTHER_ROBOT:
                    off[name] = learned, max(quarters)
        if compared and 2 * len(off) >= compared:
            name, (learned, here_now) = min(off.items())
            raise InputError(
                f"the limits are probably of another robot or estimator: {len(off)} of "
                f"{counted(compared, 'signal')} differ by a factor of more than "
                f"{_ANOTHER_ROBOT:g} ({name}: typical value {here_now:.3g}, learned "
                f"{learned:.3g}); learn limits from a healthy run of this robot"
            )
