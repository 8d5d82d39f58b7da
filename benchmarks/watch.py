"""False alarms and detection of `trajeval watch`: the tables of docs/watchdog.md.

Healthy runs are simulated (nine motions) and recorded. Faults start at random times of the second
half after arming, and are detected if a signal that is calm without the fault exceeds its limit
within 30 s. The last rows are the control: faults of the twist, which pairs and IMU cannot detect.

Usage: python -m benchmarks.watch DATA [--factor 1] [--onsets 6] [--runs 6] [--seed 8800]
"""

from __future__ import annotations

import argparse
import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.watch_faults import FAULTS
from benchmarks.watch_motions import MOTIONS, simulated
from benchmarks.watch_streams import streams
from trajeval_ros.formatting.text_tables import markdown_table
from trajeval_ros.geometry.inertial import InertialReadings
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.watchdog.engine import Watchdog
from trajeval_ros.watchdog.recording import Watched, WatchedRun, feed, watched
from trajeval_ros.watchdog.signals import Readings, Signals, signal_of, source_of
from trajeval_ros.watchdog.watch_alarms import AlarmBook

HORIZON_S = 30.0
EPISODE_S = 30.0  # alarms closer than this are one episode
# A true fault, two SLAMs that differ, and odometry against AMCL in a simulator that pauses.
NOT_HEALTHY = ("vio_mono/V2_03", "ros_example/ORB-SLAM", "ros_example/S-PTAM", "nav2/odom")
SETS = {"only poses": "", "+ twist": "twist", "+ IMU": "imu", "+ second estimate": "pair"}
# Faults that are none while the robot is at rest, and what is no rest.
LOST = ("freeze", "coasting, rotation alive", "coasting, rotation stopped")
_MOVING_MPS = 0.05
_SEED, _RUN_S, _FAULTY_S = 2, 600.0, 135.0


@dataclass(frozen=True)
class Health:
    """Alarms of a healthy run."""

    hours: float
    episodes: int
    largest: dict[str, float]  # largest ratio of value and limit at factor 1, by signal


def health_of(seen: Watched, factor: float) -> Health:
    """Return the alarms of a run."""
    begins = sorted(item.begin_s for item in AlarmBook(factor).add(seen.signals))
    episodes = int(np.count_nonzero(np.diff(begins) > EPISODE_S)) + bool(begins)
    largest = {
        name: float(values.max()) / signal_of(name).limit
        for name, (_, values) in seen.signals.items()
        if len(values)
    }
    return Health(seen.hours, episodes, largest)


@dataclass(frozen=True, eq=False)
class Healthy:
    """A run in which faults start.

    Attributes:
        name: What tables call it.
        run: All of it.
        middle: Stamp, ns, where its second half begins.
        watchdog: That has seen the first half.
        over: The signals that exceed their limits without a fault.
    """

    name: str
    run: WatchedRun
    middle: int
    watchdog: Watchdog
    over: frozenset[str]

    def second_half(self, estimate: Trajectory, end: int) -> Signals:
        """Return the signals of an estimate after the middle, with the other sources as were."""
        watchdog = copy.deepcopy(self.watchdog)
        return feed(watchdog, _part(replace(self.run, estimate=estimate), self.middle, end))


def _part(run: WatchedRun, begin: int, end: int) -> WatchedRun:
    """Return what of a run has stamps from `begin` on and before `end`."""

    def cut(item: Trajectory) -> Trajectory:
        return item[(item.stamps >= begin) & (item.stamps < end)]

    imu = run.imu
    if imu is not None:
        rows = (imu.stamps >= begin) & (imu.stamps < end)
        assert imu.accelerations is not None
        imu = InertialReadings(imu.stamps[rows], imu.rates[rows], imu.accelerations[rows])
    partners = {name: cut(partner) for name, partner in run.partners.items()}
    return WatchedRun(cut(run.estimate), imu, partners)


def halved(name: str, run: WatchedRun, factor: float) -> Healthy:
    """Watch the first half of a run."""
    last = int(run.estimate.stamps[-1])
    seen = watched(run)
    armed = seen.origin + round(seen.armed_s * NANOSECONDS)
    middle = (armed + last) // 2
    watchdog = Watchdog(int(run.estimate.stamps[0]))
    feed(watchdog, _part(run, 0, middle))
    alarms = AlarmBook(factor).add(seen.signals)
    return Healthy(name, run, middle, watchdog, frozenset(alarm.signal for alarm in alarms))


def _of(signals: Signals, needs: str, since_s: float) -> dict[str, Readings]:
    """Return the readings of one set from a time on."""
    result = {}
    for name, (seconds, values) in signals.items():
        if source_of(name) == needs:
            rows = seconds >= since_s
            result[name] = Readings(seconds[rows], values[rows])
    return result


def delays(
    half: Healthy, fault: str, onset: int, generator: np.random.Generator, factor: float
) -> Mapping[str, float | None]:
    """Return after what time each set finds a fault, s; None where it doesn't."""
    bad = FAULTS[fault](half.run.estimate, onset, generator)
    end = onset + round(HORIZON_S * NANOSECONDS)
    signals = half.second_half(bad, end)
    since_s = (onset - half.watchdog.origin) / NANOSECONDS
    first: dict[str, float | None] = {}
    signals = {name: signal for name, signal in signals.items() if name not in half.over}
    alone = AlarmBook(factor).add(_of(signals, "", since_s))
    for label, needs in SETS.items():
        extra = _of(signals, needs, since_s)
        if needs and not extra:
            continue
        alarms = alone + (AlarmBook(factor).add(extra) if needs else [])
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
    result: dict[str, dict[str, list[float | None]]] = {
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
                    result[fault][label].append(delay)
    return result


def _cell(delays_s: list[float | None]) -> str:
    hits = [item for item in delays_s if item is not None]
    if not delays_s:
        return "-"
    share = f"{100.0 * len(hits) / len(delays_s):.0f} %"
    return f"{share}, {np.median(hits):.1f} s" if hits else share


def _health_row(name: str, outcome: list[Health]) -> list[str]:
    hours, episodes = sum(item.hours for item in outcome), sum(item.episodes for item in outcome)
    largest: dict[str, float] = {}
    for item in outcome:
        for signal, ratio in item.largest.items():
            largest[signal] = max(ratio, largest.get(signal, 0.0))
    worst = max(largest, key=lambda signal: largest[signal])
    return [name, f"{hours:.2f}", str(episodes), f"{largest[worst]:.2f} ({worst})"]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder with euroc, bags, gnss, real_estimators")
    parser.add_argument("--factor", type=float, default=1.0)
    parser.add_argument("--onsets", type=int, default=6)
    parser.add_argument("--runs", type=int, default=6, help="simulated runs per motion")
    parser.add_argument("--seed", type=int, default=8800)
    arguments = parser.parse_args()
    factor, runs = arguments.factor, streams(arguments.data)
    seeds = range(arguments.seed, arguments.seed + arguments.runs)
    words = ["run", "hours", "episodes", "largest value / limit"]
    rows = [
        _health_row(
            name, [health_of(watched(simulated(name, seed, _RUN_S)), factor) for seed in seeds]
        )
        for name in MOTIONS
    ]
    rows += [_health_row(name, [health_of(watched(run), factor)]) for name, run in runs.items()]
    print(f"Alarms of healthy runs, factor {factor:g}:\n")
    print("\n".join(markdown_table(words, rows)))
    recorded = {name: run for name, run in runs.items() if name not in NOT_HEALTHY}
    flown = {name: simulated(name, arguments.seed, _FAULTY_S) for name in MOTIONS}
    for title, given in (("recorded", recorded), ("simulated", flown)):
        halves = [halved(name, run, factor) for name, run in given.items()]
        result = detections(halves, factor, arguments.onsets)
        table = [[fault, *map(_cell, by_set.values())] for fault, by_set in result.items()]
        print(f"\nFaults in {title} runs, within {HORIZON_S:g} s, median delay:\n")
        print("\n".join(markdown_table(["fault", *SETS], table)))


if __name__ == "__main__":
    main()
