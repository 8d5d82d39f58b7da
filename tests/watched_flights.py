"""Bags of flights to watch: odometry, a second estimate, an IMU, and a fault if asked for."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from benchmarks.watch_faults import FAULTS
from trajeval_ros import Trajectory, simulate
from trajeval_ros.cli.app import main
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.io.bags.write_bag import write_bag
from trajeval_ros.visual_inertial.simulated_imu import readings_of

SECOND = 1_000_000_000
ODOMETRY_TYPE = "nav_msgs/msg/Odometry"


def watched_bag(
    folder: Path,
    name: str,
    seed: int,
    fault: str = "",
    duration_s: float = 75.0,
    covariance: Floats | None = None,
) -> Path:
    """Write a flight; a fault begins after 50 s."""
    truth = simulate(seed, duration_s).groundtruth
    generator = np.random.default_rng(seed)
    made = []
    for rows in (slice(None, None, 10), slice(5, None, 20)):
        own = truth[rows]
        walk = np.cumsum(generator.normal(0.0, 5e-4, own.positions.shape), axis=0)
        made.append(Trajectory(own.stamps, own.positions + walk, own.quaternions, own.velocities))
    if fault:
        onset = int(truth.stamps[0]) + 50 * SECOND
        made[0] = FAULTS[fault](made[0], onset, generator)
    if covariance is not None:
        covariances = np.tile(covariance, (len(made[0]), 1, 1))
        made[0] = dataclasses.replace(made[0], covariances=covariances)
    write_bag(
        folder / name,
        {
            "/odom": (made[0], ODOMETRY_TYPE),
            "/vio": (made[1], "geometry_msgs/msg/PoseStamped"),
            "/truth": (truth, "geometry_msgs/msg/PoseStamped"),
        },
        inertial={"/imu": readings_of(truth, seed)},
    )
    return folder / name


def watched_sources(path: Path) -> list[str]:
    """Return the flight's sources, as `trajeval watch` takes them."""
    return [f"{path}:/odom", "--imu", f"{path}:/imu", "--with", f"{path}:/vio"]


def learned_limits(folder: Path) -> Path:
    """Learn limits of a healthy flight, and return their file."""
    path = folder / "limits.yaml"
    good = watched_bag(folder, "good", 3)
    assert main(["watch", *watched_sources(good), "--learn", str(path), "--quiet"]) == 0
    return path
