"""Simulates how often the interval of the noise-corrected ATE by GNSS fixes covers the true one.

A car and a drone, estimates that are good and poor, receivers of two kinds; prints the table of
docs/gnss.md. Everything goes the way of a user's evaluation, from fixes and an estimate on.

Usage: python -m benchmarks.gnss [--trajectories 20] [--draws 15] [--only "car, rtk"]
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from trajeval_ros import Protocol, Request, run
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.fix_selection import FixRule, fix_trajectory
from trajeval_ros.geometry.fixes import Fixes
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.geodesy import places_at
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.alignment import align
from trajeval_ros.simulation.simulated_sensors import ANTENNA_M, RECEIVERS, SITE, receiver_errors

RATE_HZ = 20.0
DURATION_S = {"car": 600.0, "drone": 300.0}
MAX_SIGMA_M = {"rtk": 0.05, "consumer": 3.0}
# Standard deviations of an estimate's drift: heading (deg per sqrt s), scale, position (m/sqrt s).
DRIFT = (0.004, 0.0006, 0.002)
TIMES = {"good": 1.0, "poor": 8.0}
# Shares of their sigma that fixes claim.
CLAIMED = {1.0: "", 0.5: ", half sigma reported"}


@dataclass(frozen=True)
class Draw:
    """One evaluation.

    Attributes:
        true_m: The ATE of the whole run, without noise.
        true_here_m: The same at the fixes that were paired.
        naive_m: The ATE by the fixes.
        own_m: The own error.
        interval_m: Its interval.
        resolved: Whether more than an upper end is claimed.
    """

    true_m: float
    true_here_m: float
    naive_m: float
    own_m: float
    interval_m: tuple[float, float]
    resolved: bool


def smooth(random: np.random.Generator, count: int, seconds: float, size: float) -> Floats:
    """Return noise without frequencies above those of so many seconds, (count,)."""
    frequencies = np.fft.rfftfreq(count) * RATE_HZ
    damped = np.exp(-0.5 * (2.0 * np.pi * frequencies * seconds) ** 2)
    wave = np.fft.irfft(np.fft.rfft(random.standard_normal(count)) * damped, count)
    scaled: Floats = size * wave / wave.std()
    return scaled


def motion(random: np.random.Generator, kind: str) -> tuple[Floats, Rotation]:
    """Return N positions of a body, and its attitudes."""
    count = int(DURATION_S[kind] * RATE_HZ)
    if kind == "drone":
        waves = ((6.0, 25.0), (6.0, 25.0), (8.0, 6.0))
        positions = np.stack([smooth(random, count, *wave) for wave in waves], axis=1)
        rotations = ((8.0, 1.5), (1.5, 0.12), (1.5, 0.12))
        angles = np.stack([smooth(random, count, *rotation) for rotation in rotations], axis=1)
        return positions, Rotation.from_euler("ZYX", angles)
    speed = np.clip(9.0 + smooth(random, count, 15.0, 3.0), 0.5, None)
    yaw = np.cumsum(smooth(random, count, 6.0, 0.12)) / RATE_HZ
    height = smooth(random, count, 20.0, 4.0)
    level = np.cumsum(np.stack([speed * np.cos(yaw), speed * np.sin(yaw)], axis=1), axis=0)
    pitch = -np.arctan2(np.gradient(height) * RATE_HZ, speed)
    angles = np.stack([yaw, pitch, smooth(random, count, 3.0, 0.02)], axis=1)
    return np.column_stack([level / RATE_HZ, height]), Rotation.from_euler("ZYX", angles)


def drifted(
    random: np.random.Generator, positions: Floats, attitudes: Rotation, times: float
) -> tuple[Floats, Rotation]:
    """Return what an odometry makes of a motion, in a frame of its own."""
    count = len(positions)
    heading, scale, walk = (times * item for item in DRIFT)
    yaw = np.cumsum(random.standard_normal(count)) * np.radians(heading) / np.sqrt(RATE_HZ)
    rotated = Rotation.from_euler("Z", yaw[:, None])
    steps = np.diff(positions, axis=0, prepend=positions[:1])
    walks = np.cumsum(random.standard_normal((count, 3)), axis=0) * walk / np.sqrt(RATE_HZ)
    path = (1.0 + scale * random.standard_normal()) * np.cumsum(rotated.apply(steps), axis=0)
    frame = Rotation.from_euler("Z", random.uniform(-np.pi, np.pi))
    tilt = np.zeros((count, 3))
    tilt[:, 0], tilt[:, 1] = (smooth(random, count, 20.0, 0.002 * times) for _ in range(2))
    return (
        frame.apply(path + walks * [1.0, 1.0, 0.7]),
        frame * rotated * Rotation.from_rotvec(tilt) * attitudes,
    )


def rmse(truth: Floats, other: Floats) -> float:
    """Return the position rmse after an alignment by yaw, metres."""
    errors = truth - align(Gauge.YAW, truth, other).similarity.positions(other)
    return float(np.sqrt(np.square(errors).sum(axis=1).mean()))


def draws_of(
    kind: str, quality: str, grade: str, claimed: float, trajectories: int, draws: int
) -> list[Draw]:
    """Return the evaluations of one row of the table, by fixes that claim a share of their sigma.

    The gate is as far below, so that it leaves out the same fixes.
    """
    receiver, result = RECEIVERS[grade], []
    protocol = Protocol(gauge="yaw", lengths=(), lever_m=ANTENNA_M)
    rule = FixRule(
        datum=SITE,
        max_sigma_m=claimed * MAX_SIGMA_M[grade],
        correlation_s=receiver.correlation_s,
    )
    for number in range(trajectories):
        random = np.random.default_rng([number, kind == "car", quality == "good"])
        positions, attitudes = motion(random, kind)
        path, rotated = drifted(random, positions, attitudes, TIMES[quality])
        stamps = np.arange(len(path)) * round(NANOSECONDS / RATE_HZ) + 10**18
        estimate = Trajectory(stamps, path, rotated.as_quat(), name="estimate")
        antenna = positions + attitudes.apply(ANTENNA_M)
        true_m = rmse(positions, path)
        for draw in range(draws):
            random = np.random.default_rng([number, draw, kind == "car", grade == "rtk", 1])
            rows = np.arange(10, len(path), int(RATE_HZ))
            errors, sigma, arrives = receiver_errors(receiver, random, rows / RATE_HZ)
            fixes = Fixes(
                places=places_at(antenna[rows] + errors, SITE),
                status=np.full(len(rows), receiver.status),
                covariance_types=np.full(len(rows), 2),
                covariances=np.square(claimed * sigma[:, None] * [1.0, 1.0, 2.0])[:, :, None]
                * np.eye(3),
            )
            truth = fix_trajectory(stamps[rows][arrives], fixes[arrives], name="fix")
            outcome = run(truth, [estimate], Request(protocol, fixes=rule)).runs[0]
            own, ate = outcome.noise_corrected_ate, outcome.evaluation.ate["position_m"]
            assert own is not None
            assert ate is not None
            pairs = outcome.evaluation.association
            paired = np.searchsorted(stamps, pairs.groundtruth.stamps)
            here_m = rmse(antenna[paired], pairs.estimate.positions)
            result.append(Draw(true_m, here_m, ate.rmse, own.ate_m, own.interval_m, own.resolved))
    return result


def row_of(name: str, detected: list[Draw]) -> str:
    """Return one line of the table."""
    true, here, naive, own = (
        np.array([getattr(item, field) for item in detected])
        for field in ("true_m", "true_here_m", "naive_m", "own_m")
    )
    low, high = np.array([item.interval_m for item in detected]).T
    quantiles = np.percentile(own / true, [50, 5, 95])
    return (
        f"| {name} | {np.median(true):.3g} m | {np.median(naive / true):.3g} | "
        f"{quantiles[0]:.3f} [{quantiles[1]:.2f}, {quantiles[2]:.2f}] | "
        f"{np.mean((low <= here) & (here <= high)):.2f} | {np.mean(here <= high):.2f} | "
        f"{np.mean([item.resolved for item in detected]):.2f} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trajectories", type=int, default=20)
    parser.add_argument("--draws", type=int, default=15)
    parser.add_argument("--only", default="", help='part of a row\'s name, such as "car, rtk"')
    given = parser.parse_args()
    head = ("run", "true ATE", "ATE / true", "noise-corrected ATE / true")
    print(f"| {' | '.join(head)} | covers | below holds | resolved |")
    print("|---|---|---|---|---|---|---|")
    for grade, claimed, kind, quality in product(RECEIVERS, CLAIMED, DURATION_S, TIMES):
        name = f"{quality} {kind}, {grade}{CLAIMED[claimed]}"
        if given.only in name:
            result = draws_of(kind, quality, grade, claimed, given.trajectories, given.draws)
            print(row_of(name, result), flush=True)


if __name__ == "__main__":
    main()
