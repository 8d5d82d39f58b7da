"""What a watchdog finds, how fast, and its alarms on healthy runs: the tables of docs/watchdog.md.

Limits are learned on the first half of each healthy recording, from its arming on. In its second
half alarms are counted, and faults written in at random onsets; a fault is found if a signal goes
over its limit within 30 s. The last rows are the control: faults of the twist, which pairs and IMU
can't see, so that what they find there is chance.

Usage: python -m benchmarks.watch DATA [--factor 2] [--onsets 6]
"""

from __future__ import annotations

import argparse
import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.watch_faults import FAULTS
from benchmarks.watch_streams import streams
from trajeval_ros.formatting.text_tables import markdown_table
from trajeval_ros.geometry.inertial import InertialReadings
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.watchdog.alarm_book import AlarmBook
from trajeval_ros.watchdog.engine import Watchdog
from trajeval_ros.watchdog.limits import WatchLimits
from trajeval_ros.watchdog.recording import WatchedRun, feed
from trajeval_ros.watchdog.signals import Readings, Signals, source_of

HORIZON_S = 30.0
WITH_FAULTS = ("vio_mono/V2_03",)
SETS = {"only poses": "", "+ twist": "twist", "+ IMU": "imu", "+ second estimate": "pair"}
# Faults that are none while the robot is at rest, and what is no rest.
LOST = ("freeze", "coasting, rotation alive", "coasting, rotation stopped")
_MOVING_MPS = 0.05
_SEED = 2


@dataclass(frozen=True, eq=False)
class Healthy:
    """A recording whose first half was learned.

    Attributes:
        name: What tables call it.
        run: All of it.
        middle: Stamp, ns, where its second half begins.
        watchdog: That has seen the first half.
        limits: Learned of it.
    """

    name: str
    run: WatchedRun
    middle: int
    watchdog: Watchdog
    limits: WatchLimits

    def second_half(self, estimate: Trajectory, end: int) -> Signals:
        """Return the signals of an estimate after the middle, with the other sources as were."""
        watchdog = copy.deepcopy(self.watchdog)
        return feed(watchdog, _part(replace(self.run, estimate=estimate), self.middle, end))


def _part(run: WatchedRun, begin: int, end: int) -> WatchedRun:
    """Return what of a run has stamps from `begin` on and before `end`."""

    def cut(each: Trajectory) -> Trajectory:
        return each[(each.stamps >= begin) & (each.stamps < end)]

    imu = run.imu
    if imu is not None:
        rows = (imu.stamps >= begin) & (imu.stamps < end)
        assert imu.accelerations is not None
        imu = InertialReadings(imu.stamps[rows], imu.rates[rows], imu.accelerations[rows])
    partners = {name: cut(each) for name, each in run.partners.items()}
    return WatchedRun(cut(run.estimate), run.twist, imu, partners)


def learned(name: str, run: WatchedRun) -> Healthy:
    """Watch the first half of a recording."""
    last = int(run.estimate.stamps[-1])
    whole = Watchdog(int(run.estimate.stamps[0]))
    feed(whole, run)
    assert whole.armed_s is not None
    armed = whole.origin + round(whole.armed_s * NANOSECONDS)
    middle = (armed + last) // 2
    watchdog = Watchdog(int(run.estimate.stamps[0]))
    signals = feed(watchdog, _part(run, 0, middle))
    limits = WatchLimits.learned(signals, (middle - armed) / NANOSECONDS / 3600.0, {}, "")
    return Healthy(name, run, middle, watchdog, limits)


def _of(signals: Signals, needs: str, since_s: float) -> dict[str, Readings]:
    """Return the readings of one set from a time on."""
    found = {}
    for name, (seconds, values) in signals.items():
        if source_of(name) == needs:
            rows = seconds >= since_s
            found[name] = Readings(seconds[rows], values[rows])
    return found


def healthy_alarms(halves: list[Healthy], factor: float) -> dict[str, tuple[list[str], float]]:
    """Return the alarms of each set on second halves, and the hours."""
    found: dict[str, tuple[list[str], float]] = {}
    for label, needs in SETS.items():
        alarms, hours = [], 0.0
        for half in halves:
            end = int(half.run.estimate.stamps[-1]) + 1
            signals = _of(half.second_half(half.run.estimate, end), needs, -np.inf)
            if signals:
                book = AlarmBook(half.limits, factor)
                alarms += [f"{each.signal} ({half.name})" for each in book.add(signals)]
                hours += (end - half.middle) / NANOSECONDS / 3600.0
        found[label] = alarms, hours
    return found


def delays(
    half: Healthy, fault: str, onset: int, generator: np.random.Generator, factor: float
) -> Mapping[str, float | None]:
    """Return after what time each set finds a fault, s; None where it doesn't."""
    bad = FAULTS[fault](half.run.estimate, onset, generator)
    end = onset + round(HORIZON_S * NANOSECONDS)
    signals = half.second_half(bad, end)
    since_s = (onset - half.watchdog.origin) / NANOSECONDS
    first: dict[str, float | None] = {}
    alone = AlarmBook(half.limits, factor).add(_of(signals, "", since_s))
    for label, needs in SETS.items():
        extra = _of(signals, needs, since_s)
        if needs and not extra:
            continue
        alarms = alone + (AlarmBook(half.limits, factor).add(extra) if needs else [])
        begins = [alarm.begin_s - since_s for alarm in alarms]
        first[label] = min(begins) if begins else None
    return first


def _moves(estimate: Trajectory, onset: int) -> bool:
    """Whether the robot moves: the estimate of one at rest may well stand still."""
    row = int(np.searchsorted(estimate.stamps, onset))
    rows = slice(max(row - 5, 0), row + 5)
    moved = np.linalg.norm(np.diff(estimate.positions[rows], axis=0), axis=1)
    return bool(np.median(moved / np.diff(estimate.seconds[rows])) > _MOVING_MPS)


def detections(
    halves: list[Healthy], factor: float, onsets: int
) -> dict[str, dict[str, list[float | None]]]:
    """Return the delays of each fault by set; None where it wasn't found."""
    generator = np.random.default_rng(_SEED)
    found: dict[str, dict[str, list[float | None]]] = {
        fault: {label: [] for label in SETS} for fault in FAULTS
    }
    for half in halves:
        latest = int(half.run.estimate.stamps[-1]) - round(HORIZON_S * NANOSECONDS)
        latest = max(latest, half.middle + 2 * NANOSECONDS)
        for fault in FAULTS:
            if fault.startswith("twist") and half.run.estimate.velocities is None:
                continue
            for _ in range(onsets):
                onset = int(generator.integers(half.middle, latest))
                while fault in LOST and not _moves(half.run.estimate, onset):
                    onset = int(generator.integers(half.middle, latest))
                for label, delay in delays(half, fault, onset, generator, factor).items():
                    found[fault][label].append(delay)
    return found


def _cell(delays_s: list[float | None]) -> str:
    hits = [each for each in delays_s if each is not None]
    if not delays_s:
        return "-"
    share = f"{100.0 * len(hits) / len(delays_s):.0f} %"
    return f"{share}, {np.median(hits):.1f} s" if hits else share


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder with euroc, bags and gnss")
    parser.add_argument("--factor", type=float, default=2.0)
    parser.add_argument("--onsets", type=int, default=6)
    arguments = parser.parse_args()
    runs = streams(arguments.data)
    halves = [learned(name, run) for name, run in runs.items() if name not in WITH_FAULTS]
    print(f"Alarms on second halves of healthy runs, K = {arguments.factor:g}:\n")
    rows = [
        [label, str(len(alarms)), f"{hours:.2f}", ", ".join(alarms) or "-"]
        for label, (alarms, hours) in healthy_alarms(halves, arguments.factor).items()
    ]
    print("\n".join(markdown_table(["signals", "alarms", "hours", "which"], rows)))
    print(f"\nFaults found within {HORIZON_S:g} s and median delay, K = {arguments.factor:g}:\n")
    found = detections(halves, arguments.factor, arguments.onsets)
    table = [[fault, *map(_cell, by_set.values())] for fault, by_set in found.items()]
    print("\n".join(markdown_table(["fault", *SETS], table)))


if __name__ == "__main__":
    main()
