"""Times the live evaluator alone, fed as a node that drains its subscriptions at 50 Hz feeds it.

Groundtruth of 1 kHz and odometry of 200 Hz make 24 messages a drain. The robot is fast enough for
sub-trajectories of all five lengths to end in every drain from the start. Prints JSON.

Usage: python -m benchmarks.online MESSAGES
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from statistics import median

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.window import Window

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

TRUTH_NS, ESTIMATE_NS = 1_000_000, 5_000_000
DRAIN_TRUTH, DRAIN_ESTIMATE = 20, 4
DRAIN = DRAIN_TRUTH + DRAIN_ESTIMATE
WINDOWS = ("0", "30s")
# Drains between two updates, over and over.
UPDATES = {"50 Hz": (1,), "20 Hz": (2, 3)}
MARKS = (10_000, 100_000, 1_000_000)
BLOCK_DRAINS, BLOCKS = 10, 20


def poses(stamps: Stamps) -> tuple[Floats, Rotation]:
    """Return positions (N, 3) and attitudes of a robot that swings about at 3 to 20 m/s."""
    t = stamps * 1e-9
    positions = np.column_stack(
        [50.0 * np.sin(0.23 * t), 40.0 * np.cos(0.31 * t), 4.0 * np.sin(0.5 * t)]
    )
    leaning = 0.1 * np.sin(0.7 * t), 0.1 * np.cos(0.9 * t)
    return positions, Rotation.from_euler("ZYX", np.column_stack([0.3 * t, *leaning]))


def estimated(stamps: Stamps) -> Trajectory:
    """Return states as an odometry that drifts and jitters has them."""
    positions, attitudes = poses(stamps)
    random = np.random.default_rng(1)
    drift = np.cumsum(random.normal(scale=1e-3, size=positions.shape), axis=0)
    noise = random.normal(scale=0.005, size=positions.shape)
    jitter = Rotation.from_rotvec(random.normal(scale=0.002, size=positions.shape))
    frame = Rotation.from_rotvec([0.0, 0.0, 1.0])
    moved = frame.apply(positions + drift + noise) + [3.0, -2.0, 1.0]
    return Trajectory(stamps, moved, (frame * attitudes * jitter).as_quat())


def drains(messages: int) -> Iterator[tuple[Trajectory, Trajectory]]:
    """Yield the groundtruth and the estimate that each drain finds."""
    count = messages // DRAIN
    truth_stamps = np.arange(count * DRAIN_TRUTH, dtype=np.int64) * TRUTH_NS
    stamps = np.arange(count * DRAIN_ESTIMATE, dtype=np.int64) * ESTIMATE_NS + TRUTH_NS // 3
    positions, attitudes = poses(truth_stamps)
    truth = Trajectory(truth_stamps, positions, attitudes.as_quat())
    estimate = estimated(stamps)
    for drain in range(count):
        g = slice(drain * DRAIN_TRUTH, (drain + 1) * DRAIN_TRUTH)
        e = slice(drain * DRAIN_ESTIMATE, (drain + 1) * DRAIN_ESTIMATE)
        yield truth[g], estimate[e]


def seconds_by_drain(messages: int, window: str, pauses: tuple[int, ...]) -> Floats:
    """Return the CPU time after each drain, seconds."""
    evaluator = OnlineEvaluator(OnlineSettings(window=Window.parse(window)))
    last = np.cumsum(pauses) - 1
    updates = np.isin(np.arange(messages // DRAIN) % sum(pauses), last).tolist()
    spent = [0.0]
    for (truth, estimate), update in zip(drains(messages), updates, strict=True):
        start = time.process_time()
        evaluator.add_groundtruth(truth)
        evaluator.add_estimate(estimate)
        if update:
            evaluator.update()
        spent.append(spent[-1] + time.process_time() - start)
    return np.array(spent)


def quiet(spent: Floats) -> float:
    """Return the messages per second of the tenth of all blocks that nothing else disturbed."""
    blocks = np.diff(spent[::BLOCK_DRAINS]) / (BLOCK_DRAINS * DRAIN)
    return 1.0 / float(np.quantile(blocks, 0.1))


def around(spent: Floats, mark: int) -> float:
    """Return the usual cost of a message about the one of that number, microseconds."""
    middle, reach = mark // DRAIN, BLOCKS // 2 * BLOCK_DRAINS
    last = min(middle + reach, len(spent) - 1)
    edges = range(last - 2 * reach, last + 1, BLOCK_DRAINS)
    costs = [spent[end] - spent[begin] for begin, end in pairwise(edges)]
    return float(median(costs)) / (BLOCK_DRAINS * DRAIN) * 1e6


def main() -> None:
    """Time each window at each rate of updates."""
    messages = int(sys.argv[1])
    rows = []
    for window in WINDOWS:
        for rate, pauses in UPDATES.items():
            spent = seconds_by_drain(messages, window, pauses)
            rows.append(
                {
                    "window": window,
                    "updates": rate,
                    "messages_per_s": (len(spent) - 1) * DRAIN / spent[-1],
                    "quiet_messages_per_s": quiet(spent),
                    "us_per_message": {
                        str(mark): around(spent, mark) for mark in MARKS if mark <= messages
                    },
                }
            )
    print(json.dumps(rows))


if __name__ == "__main__":
    main()
