"""Writes a pair of TUM files, a flight and an estimate of it, of any number of poses.

The groundtruth moves at 200 Hz with a velocity that is an Ornstein-Uhlenbeck process. The
estimate drifts, is noisy, lives in another frame, and is stamped 0.7 ms late.

Usage: python -m benchmarks.tum_pairs FOLDER POSES
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from benchmarks.pair_paths import pair_paths

Array = NDArray[np.float64]

RATE_HZ = 200.0
START_NS = 1_600_000_000_000_000_000
OFFSET_NS = 700_000


def ornstein_uhlenbeck(
    random: np.random.Generator, count: int, columns: int, sigma: float, time_constant_s: float
) -> Array:
    """Return (count, columns) of noise with that standard deviation and memory."""
    decay = np.exp(-1.0 / (RATE_HZ * time_constant_s))
    drive = random.normal(scale=sigma * np.sqrt(1.0 - decay**2), size=(count, columns))
    noise: Array = lfilter([1.0], [1.0, -decay], drive, axis=0)
    return noise


def flight(random: np.random.Generator, count: int) -> tuple[Array, Rotation]:
    """Return positions (count, 3) and attitudes of a smooth flight."""
    velocity = ornstein_uhlenbeck(random, count, 3, sigma=1.0, time_constant_s=2.0)
    turning = ornstein_uhlenbeck(random, count, 1, sigma=0.5, time_constant_s=2.0)[:, 0]
    leaning = ornstein_uhlenbeck(random, count, 2, sigma=0.1, time_constant_s=1.0)
    heading = np.cumsum(turning) / RATE_HZ
    attitudes = Rotation.from_euler("ZYX", np.column_stack([heading, leaning]))
    return np.cumsum(velocity, axis=0) / RATE_HZ, attitudes


def estimate_of(
    random: np.random.Generator, positions: Array, attitudes: Rotation
) -> tuple[Array, Rotation]:
    """Return what an odometry that drifts in position and yaw makes of a flight."""
    count = len(positions)
    step = 1.0 / np.sqrt(RATE_HZ)
    position_drift = np.cumsum(random.normal(scale=0.02 * step, size=(count, 3)), axis=0)
    yaw_drift = np.cumsum(random.normal(scale=np.radians(0.05) * step, size=count))
    noise = Rotation.from_rotvec(random.normal(scale=np.radians(0.1), size=(count, 3)))
    frame = Rotation.from_rotvec([0.1, -0.2, 1.0])
    drifted = positions + position_drift + random.normal(scale=0.005, size=(count, 3))
    rotated = Rotation.from_rotvec(yaw_drift[:, None] * [0.0, 0.0, 1.0]) * attitudes * noise
    return frame.apply(drifted) + [3.0, -2.0, 1.0], frame * rotated


def write_tum(
    path: Path, stamps: NDArray[np.int64], positions: Array, attitudes: Rotation
) -> None:
    """Write a TUM file; its name appears only when it is complete."""
    unfinished = path.with_suffix(".part")
    rows = np.column_stack([positions, attitudes.as_quat()])
    line = "%d.%09d" + " %.9f" * 7 + "\n"
    with unfinished.open("w", encoding="ascii") as file:
        for first in range(0, len(rows), 10_000):
            part = slice(first, first + 10_000)
            seconds, nanoseconds = np.divmod(stamps[part], 1_000_000_000)
            file.writelines(
                line % (second, nanosecond, *row)
                for second, nanosecond, row in zip(
                    seconds.tolist(), nanoseconds.tolist(), rows[part].tolist(), strict=True
                )
            )
    unfinished.rename(path)


def write_pair(folder: Path, count: int) -> None:
    """Write both files of a pair, if they aren't there yet."""
    groundtruth, estimate = pair_paths(folder, count)
    if groundtruth.exists() and estimate.exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng(count)
    stamps = START_NS + np.arange(count, dtype=np.int64) * int(1e9 / RATE_HZ)
    positions, attitudes = flight(random, count)
    write_tum(groundtruth, stamps, positions, attitudes)
    write_tum(estimate, stamps + OFFSET_NS, *estimate_of(random, positions, attitudes))


if __name__ == "__main__":
    write_pair(Path(sys.argv[1]), int(sys.argv[2]))
