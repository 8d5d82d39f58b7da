"""Bags of flights to watch: odometry, second estimates, an IMU, map corrections, and faults."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.watch_faults import FAULTS
from trajeval_ros import Trajectory, simulate
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.io.bags.write_bag import write_bag
from trajeval_ros.simulation.simulated_sensors import imu_readings
from trajeval_ros.watchdog.recording import WatchedRun

SECOND = 1_000_000_000
ODOMETRY_TYPE = "nav_msgs/msg/Odometry"


def varied(covariance: Floats, count: int) -> Floats:
    """Return covariances (N, 6, 6) that vary by 1e-9, since constant ones are no estimates."""
    return (1.0 + 1e-9 * np.arange(count))[:, None, None] * covariance


def watched_bag(
    folder: Path,
    name: str,
    seed: int,
    fault: str = "",
    duration_s: float = 75.0,
    covariance: Floats | None = None,
    correction_m: float = 0.0,
) -> Path:
    """Write a flight; a fault begins after 50 s, and a map correction comes after 60 s."""
    groundtruth = simulate(seed, duration_s).groundtruth
    generator = np.random.default_rng(seed)
    made = []
    for rows in (slice(None, None, 10), slice(5, None, 20), slice(2, None, 25)):
        own = groundtruth[rows]
        walk = np.cumsum(generator.normal(0.0, 5e-4, own.positions.shape), axis=0)
        made.append(Trajectory(own.stamps, own.positions + walk, own.quaternions, own.velocities))
    if fault:
        onset = int(groundtruth.stamps[0]) + 50 * SECOND
        made[0] = FAULTS[fault](made[0], onset, generator)
    if covariance is not None:
        covariances = varied(covariance, len(made[0]))
        made[0] = dataclasses.replace(made[0], covariances=covariances)
    write_bag(
        folder / name,
        {
            "/odom": (made[0], ODOMETRY_TYPE),
            "/vio": (made[1], "geometry_msgs/msg/PoseStamped"),
            "/wheel": (made[2], "geometry_msgs/msg/PoseStamped"),
            "/map_to_odom": (
                map_to_odom(groundtruth, correction_m),
                "geometry_msgs/msg/PoseStamped",
            ),
            "/groundtruth": (groundtruth, "geometry_msgs/msg/PoseStamped"),
        },
        transforms=[map_to_odom(groundtruth, correction_m)],
        inertial={"/imu": imu_readings(groundtruth, seed)},
    )
    return folder / name


def map_to_odom(groundtruth: Trajectory, correction_m: float) -> Trajectory:
    """Return small corrections ten times a second, and one along x after 60 s."""
    stamps = groundtruth.stamps[::20]
    seconds = (stamps - stamps[0]) / SECOND
    wander = 0.002 * np.sin(0.7 * seconds)
    positions = np.stack([3.0 + wander, 1.0 - wander, 0.0 * seconds], axis=1)
    positions[seconds >= 60.0, 0] += correction_m
    rotations = lie.from_rotation_vector(np.outer(0.5 + 0.1 * wander, [0.0, 0.0, 1.0]))
    return Trajectory(stamps, positions, rotations, frame="map", child_frame="odom")


@cache
def flight(seed: int = 3, duration_s: float = 75.0) -> WatchedRun:
    """Return a simulated estimate without a gap, its IMU, and a second estimate with other noise.

    The second one is the groundtruth, thinned and turned: a partner of another rate and frame.
    """
    simulated = simulate(seed, duration_s)
    groundtruth = simulated.groundtruth
    generator = np.random.default_rng(seed)
    own = groundtruth[::10]
    walk = np.cumsum(generator.normal(0.0, 5e-4, own.positions.shape), axis=0)
    assert own.quaternions is not None
    tilt = lie.from_rotation_vector(generator.normal(0.0, 5e-4, own.positions.shape))
    estimate = dataclasses.replace(
        own,
        positions=own.positions + walk,
        quaternions=lie.normalized(lie.multiply(own.quaternions, tilt)),
        name="odometry",
    )
    noise = np.cumsum(generator.normal(0.0, 5e-4, groundtruth[5::20].positions.shape), axis=0)
    partner = groundtruth[5::20]
    partner = dataclasses.replace(partner, positions=partner.positions + noise, velocities=None)
    return WatchedRun(
        estimate,
        imu=imu_readings(groundtruth, seed),
        partners={"pair": partner},
        corrections=map_to_odom(groundtruth, 0.0),
    )


def watched_sources(path: Path) -> list[str]:
    """Return the flight's sources, as `trajeval watch` takes them."""
    return [f"{path}:/odom", "--imu", f"{path}:/imu", "--with", f"{path}:/vio"]


def all_sources(path: Path, corrections: str = "/map_to_odom") -> list[str]:
    """Return the flight's sources with two second estimates and map corrections."""
    return [
        *watched_sources(path), "--with", f"{path}:/wheel",
        "--map-to-odom", f"{path}:{corrections}",
    ]  # fmt: skip
