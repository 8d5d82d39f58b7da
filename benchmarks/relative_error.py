"""Times relative errors of five lengths inside a process; prints the seconds as JSON.

Usage: python -m benchmarks.relative_error RUNS
"""

from __future__ import annotations

import json
import sys
import time
from statistics import median

import numpy as np

from benchmarks.tum_pairs import RATE_HZ, estimate_of, flight
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.travelled import travelled_distance
from trajeval_ros.metrics.relative_errors import relative_errors
from trajeval_ros.metrics.statistics import statistics_of
from trajeval_ros.metrics.sub_trajectories import Selection, select

LENGTHS_M = (8.0, 16.0, 24.0, 32.0, 40.0)
SIZES = (100_000, 200_000)


def simulated_pair(count: int) -> tuple[Trajectory, Trajectory]:
    """Return a groundtruth and an estimate of it."""
    random = np.random.default_rng(count)
    stamps = np.arange(count, dtype=np.int64) * int(1e9 / RATE_HZ)
    positions, attitudes = flight(random, count)
    moved, rotated = estimate_of(random, positions, attitudes)
    return (
        Trajectory.from_columns(stamps, positions, attitudes.as_quat()),
        Trajectory.from_columns(stamps, moved, rotated.as_quat()),
    )


def seconds_for(groundtruth: Trajectory, estimate: Trajectory) -> float:
    """Choose the sub-trajectories of all lengths, measure them, and sum them up."""
    start = time.process_time()
    along = travelled_distance(groundtruth.positions)
    for length in LENGTHS_M:
        starts, ends = select(along, length, Selection())
        errors = relative_errors(groundtruth, estimate, starts, ends, Gauge.SE3)
        for item in (errors.position_m, errors.rotation_deg, errors.yaw_deg, errors.tilt_deg):
            statistics_of(item)
    return time.process_time() - start


def main() -> None:
    """Time both sizes in turn, so that the machine's moods strike both."""
    runs = int(sys.argv[1])
    pairs = {count: simulated_pair(count) for count in SIZES}
    timed: dict[int, list[float]] = {count: [] for count in SIZES}
    for _ in range(runs):
        for count, pair in pairs.items():
            timed[count].append(seconds_for(*pair))
    print(json.dumps({str(count): median(seconds) for count, seconds in timed.items()}))


if __name__ == "__main__":
    main()
