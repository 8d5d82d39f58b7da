"""The recordings that a watchdog is measured on; IMUs of flights are made from groundtruth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.interpolate import UnivariateSpline

from trajeval_ros import read_many
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.inertial import InertialReadings
from trajeval_ros.geometry.interpolation import slerp_at
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.io.watched_sources import read_watched
from trajeval_ros.watchdog.recording import WatchedRun
from trajeval_ros.watchdog.rotations_over_time import between
from trajeval_ros.watchdog.signals import PAIR

_STEP_S = 0.005
_SKIPPED = 1  # vio_mono's files begin with a placeholder


def imu_of(truth: Trajectory, seed: int) -> InertialReadings:
    """Return the IMU of a real motion: groundtruth differentiated, with an ADIS16448's noise."""
    generator = np.random.default_rng(seed)
    assert truth.quaternions is not None
    known = truth.seconds
    times = np.arange(0.05, known[-1] - 0.05, _STEP_S)
    attitudes = slerp_at(known, truth.quaternions, times)
    rates = lie.rotation_vector(between(attitudes[:-1], attitudes[1:])) / _STEP_S
    rates = np.vstack([rates, rates[-1]])
    smooth = [
        UnivariateSpline(known, column, k=5, s=len(known) * 0.0005**2)(times, 2)
        for column in truth.positions.T
    ]
    force = lie.rotate(lie.conjugate(attitudes), np.stack(smooth, axis=1) + [0.0, 0.0, 9.81])
    for values, white, bias, walk in (
        (rates, 1.7e-4, 0.01, 2e-5),
        (force, 2e-3, 0.03, 3e-3),
    ):
        steps = generator.normal(0.0, walk * np.sqrt(_STEP_S), values.shape)
        values += generator.normal(0.0, white / np.sqrt(_STEP_S), values.shape)
        values += generator.normal(0.0, bias, 3) + np.cumsum(steps, axis=0)
    stamps = truth.stamps[0] + np.rint(times * NANOSECONDS).astype(np.int64)
    return InertialReadings(stamps, rates, force)


def streams(data: Path) -> dict[str, WatchedRun]:
    """Return the recordings by name; V2_03 is one with a real fault."""
    flights = ("MH_01", "MH_05", "V2_03")
    euroc = data / "euroc"
    truths = read_many([euroc / f"groundtruth/{name}.txt" for name in flights])
    imus = {
        name: imu_of(truth, seed)
        for seed, (name, truth) in enumerate(zip(flights, truths, strict=True))
    }
    mono = read_many([euroc / f"vio_mono/{name}.txt" for name in flights])
    vins, openvins = (
        replace(item.in_order(), covariances=None)
        for item in read_many(
            [euroc / "vins_mono/MH_01.csv", euroc / "openvins/MH_01_with_covariance.csv"]
        )
    )
    result = {
        f"vio_mono/{name}": WatchedRun(item[_SKIPPED:], imu=imus[name])
        for name, item in zip(flights, mono, strict=True)
    }
    result["vio_mono/MH_01"] = replace(result["vio_mono/MH_01"], partners={PAIR: openvins})
    result["vins_mono/MH_01"] = WatchedRun(vins, imu=imus["MH_01"], partners={PAIR: openvins})
    result["openvins/MH_01"] = WatchedRun(openvins, imu=imus["MH_01"], partners={PAIR: vins})
    nav2 = str(data / "bags/nav2_turtlebot.mcap")
    result["nav2/odom"] = read_watched(f"{nav2}:/odom", partners={PAIR: f"{nav2}:/amcl_pose"})
    husky = str(data / "gnss/husky_outdoor.bag")
    result["husky/odom"] = read_watched(husky, f"{husky}:/imu/data")
    example = str(data / "bags/ROS_example.bag")
    for own, other in (("ORB-SLAM", "S-PTAM"), ("S-PTAM", "ORB-SLAM")):
        run = read_watched(f"{example}:/{own}", partners={PAIR: f"{example}:/{other}"})
        result[f"ros_example/{own}"] = run
    result.update(_of_real_estimators(data / "real_estimators"))
    return result


def _of_real_estimators(folder: Path) -> dict[str, WatchedRun]:
    """Return lidar odometry, and pairs of OpenVINS with and without FEJ on a simulated flight."""
    result = {}
    lidar = f"{folder}/lidar/lockstep/bag"
    for own, other in (("small_gicp", "kiss_icp"), ("kiss_icp", "rko_lio")):
        partner = {PAIR: f"{lidar}:/{other}/odometry"}
        result[f"lidar/{own}"] = read_watched(f"{lidar}:/{own}/odometry", partners=partner)
    both = [np.load(folder / f"openvins_simulation/stereo_fej_{way}.npz") for way in ("on", "off")]
    for run, seed in enumerate(both[0]["seeds"].tolist()):
        on, off = (_columns(item["stamps_ns"], item["estimate"][run]) for item in both)
        imu = imu_of(_columns(both[0]["stamps_ns"], both[0]["truth"]), seed)
        result[f"openvins/simulated {seed}"] = WatchedRun(on, imu, {PAIR: off})
    return result


def _columns(stamps: Stamps, rows: Floats) -> Trajectory:
    """Return states of rows (N, 10): position, quaternion and velocity in the world."""
    return Trajectory(stamps, rows[:, :3], lie.normalized(rows[:, 3:7]), rows[:, 7:10])
