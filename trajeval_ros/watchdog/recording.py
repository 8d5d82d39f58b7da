"""A recording as input of a watchdog, in slices of time as in a live run."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.inertial import InertialReadings
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.discontinuities.events import Event
from trajeval_ros.watchdog.engine import ARMING_S, Watchdog
from trajeval_ros.watchdog.signals import PAIR, Readings, Signals, joined, source_of, source_words
from trajeval_ros.watchdog.watch_alarms import AlarmBook

_SLICE_S = 10.0


@dataclass(frozen=True, eq=False)
class WatchedRun:
    """An estimate and the sources that it is compared with."""

    estimate: Trajectory  # the states that are watched, in order of arrival
    imu: InertialReadings | None = None  # readings of the robot's IMU
    # Second estimates of the same robot, of any frame, body and scale, by source (see
    # `pair_sources`).
    partners: Mapping[str, Trajectory] = field(default_factory=dict)
    corrections: Trajectory | None = None  # transforms from the map to the estimate's frame

    @property
    def others(self) -> dict[str, Trajectory]:
        """Second estimates and corrections, by source."""
        corrections = {} if self.corrections is None else {"map": self.corrections}
        return {**self.partners, **corrections}


@dataclass(frozen=True, eq=False)
class Watched:
    """Signals of a recording."""

    origin: int  # timestamp, ns, from which seconds are counted
    signals: Signals  # values since arming, by name
    armed_s: float  # time of arming, s
    end_s: float  # time of the last state, s
    notices: tuple[str, ...]  # findings about the sources, one sentence each
    events: tuple[Event, ...] = ()  # discontinuities of the estimate since arming

    @property
    def hours(self) -> float:
        """Duration since arming, hours."""
        return (self.end_s - self.armed_s) / 3600.0


def watched(run: WatchedRun) -> Watched:
    """Watch a recording."""
    name = run.estimate.name or "the estimate"
    if not len(run.estimate):
        raise InputError(f"{name} has no usable pose")
    for other in (run.estimate, *run.others.values()):
        if not other.reading.stamped:
            raise InputError(
                f"{other.name or 'an estimate'} has no timestamps, which watch needs; give a "
                "recording with timestamps"
            )
        if other.quaternions is None:
            raise InputError(
                f"{other.name or 'an estimate'} has no orientations, which watch needs; give a "
                "topic with poses"
            )
    watchdog = Watchdog(int(run.estimate.stamps[0]), tuple(run.partners))
    signals = feed(watchdog, run)
    if watchdog.armed_s is None:
        raise InputError(
            f"{name} has only {watchdog.moved_s:.0f} s of motion, and arming needs {ARMING_S:g} "
            "s; give a run with more motion"
        )
    needs = {
        need
        for need, source in (
            ("twist", run.estimate.velocities),
            ("imu", run.imu),
            *run.others.items(),
        )
        if source is not None
    }
    there = {source_of(name) for name in signals}
    notices = [*watchdog.notices, *undetected_faults(needs, there, watchdog.notices)]
    if watchdog.about_yaw is not None:
        notices.insert(0, watchdog.about_yaw.text)
    if watchdog.out_of_order:
        notices.append(
            f"{counted(watchdog.out_of_order, 'state')} of {name} dropped: timestamps do not "
            "increase"
        )
    times = watchdog.armed_s, watchdog.last_s
    events = tuple(item.event for item in watchdog.events)
    return Watched(watchdog.origin, signals, *times, tuple(notices), events)


def feed(watchdog: Watchdog, run: WatchedRun) -> dict[str, Readings]:
    """Feed a run to a watchdog in order of time, and return the signals."""
    return joined(list(_fed(watchdog, run)))


def _fed(watchdog: Watchdog, run: WatchedRun) -> Iterator[Signals]:
    """Feed all sources in slices of time, as in a live run, and yield the signals."""
    estimate, imu = run.estimate, run.imu
    others: dict[str, tuple[Stamps, Floats | None, Floats | None]] = {}
    if imu is not None:
        others["imu"] = imu.stamps, imu.rates, imu.accelerations
    for name, other in run.others.items():
        others[name] = other.stamps, other.positions, other.quaternions
    sources = [estimate.stamps, *(stamps for stamps, _, _ in others.values())]
    first = min(int(source.min()) for source in sources)
    slices = [_slices(source, first) for source in sources]
    empty = np.empty(0, dtype=np.int64)
    for own in itertools.zip_longest(*slices, fillvalue=empty):
        for (name, (stamps, values, more)), rows in zip(others.items(), own[1:], strict=True):
            assert values is not None
            assert more is not None
            yield watchdog.add_source(name, stamps[rows], values[rows], more[rows])
        yield watchdog.add_estimate(estimate[own[0]])


def _slices(stamps: Stamps, first: int) -> list[Stamps]:
    """Return the row indices by slice of time, in order of arrival.

    A timestamp that steps back belongs to the slice of the latest timestamp before it.
    """
    latest = np.maximum.accumulate(stamps) - first
    number = latest // round(_SLICE_S * NANOSECONDS)
    places = np.searchsorted(number, np.arange(int(number[-1]) + 2))
    rows = np.arange(len(stamps))
    return [rows[begin:end] for begin, end in itertools.pairwise(places.tolist())]


def error_spans(run: WatchedRun, factor: float) -> list[tuple[int, int]]:
    """Return first and last timestamp of every error, ns, in the estimate's clock."""
    seen = watched(run)
    book = AlarmBook(factor)
    book.add(seen.signals)
    return [
        (
            seen.origin + round(alarm.begin_s * NANOSECONDS),
            seen.origin + round(alarm.last_s * NANOSECONDS),
        )
        for alarm in book.alarms
        if book.is_error(alarm)
    ]


_SEES = {"imu": "slow rotation", PAIR: "slow divergence", "map": "map corrections"}


def undetected_faults(
    needs: Collection[str], there: Collection[str], notices: Sequence[str]
) -> Iterator[str]:
    """Yield one sentence per source whose faults are not detected.

    `needs` are the given sources: `twist`, `imu`, `pair`, `pair.NAME`, `map`. `there` are those
    with signals. A source that a notice names has no further sentence.
    """
    if "twist" not in needs:
        yield "no twist: disagreement of pose and velocity is not detected"
    kinds = {need.partition(".")[0] for need in needs}
    for kind in ("imu", PAIR):
        if kind not in kinds:
            yield f"no {source_words(kind)}: {_SEES[kind]} not detected"
    for need in sorted(set(needs) - {"twist"} - set(there)):
        words = source_words(need)
        if not any(words in notice for notice in notices):
            yield (
                f"no data of the {words} after arming ({ARMING_S:g} s of motion), so "
                f"{_SEES[need.partition('.')[0]]} not detected; check its clock"
            )
