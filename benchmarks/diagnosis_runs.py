"""Runs that a diagnosis is measured on: simulated with five kinds of drift, and real ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.protocol import Protocol

Array = NDArray[np.float64]
EPOCH = 1_700_000_000_000_000_123
KINDS = ("drone", "handheld", "car", "robot")
DRIFTS = ("walk", "heavy", "loops", "scale", "tilt")
# Degrees of freedom of Student's t; the others than the first one are for judging alone.
_TAILS = {"heavy": 2.2, "t2": 2.0, "heavier": 1.5, "t1.2": 1.2}
# What each moves like: reach in metres, and rates in Hz of its slow and fast motion.
_REACH = {"drone": (4.0, 0.01, 0.25), "handheld": (1.5, 0.02, 0.6)}
_FINE_HZ, _TRUTH_HZ, _ESTIMATE_HZ = 200, 100, 20
REAL = {
    "vio MH_01": ("euroc/groundtruth/MH_01.txt", "euroc/vio_mono/MH_01.txt", Gauge.YAW, 0.1),
    "vio MH_05": ("euroc/groundtruth/MH_05.txt", "euroc/vio_mono/MH_05.txt", Gauge.YAW, 0.1),
    "VINS MH_01": ("euroc/groundtruth/MH_01.txt", "euroc/vins_mono/MH_01.csv", Gauge.YAW, 0.1),
    "OpenVINS MH_01": (
        "euroc/groundtruth/MH_01.txt",
        "euroc/openvins/MH_01_with_covariance.csv",
        Gauge.YAW,
        0.1,
    ),
    "fr2_desk": ("tum/fr2_desk_groundtruth.txt", "tum/fr2_desk_ORB.txt", Gauge.SE3, 0.1),
    "KITTI 00": ("kitti/KITTI_00_gt.txt", "kitti/KITTI_00_ORB.txt", Gauge.SE3, 0.25),
    "ORB-SLAM": (
        "bags/ROS_example.bag:/groundtruth",
        "bags/ROS_example.bag:/ORB-SLAM",
        Gauge.SE3,
        0.25,
    ),
    "S-PTAM": (
        "bags/ROS_example.bag:/groundtruth",
        "bags/ROS_example.bag:/S-PTAM",
        Gauge.SE3,
        0.25,
    ),
}
_KITTI_TIMES = "kitti/KITTI_00_gt_times.txt"


@dataclass(frozen=True, eq=False)
class Pair:
    """Groundtruth and an estimate, and how they are compared."""

    name: str
    truth: Trajectory
    estimate: Trajectory
    gauge: Gauge = Gauge.YAW
    max_gap_s: float = 0.1

    @property
    def protocol(self) -> Protocol:
        """The settings."""
        rule = AssociationRule(max_gap_s=self.max_gap_s)
        return Protocol(gauge=self.gauge, lengths=(), association=rule)

    def part(self, start_s: float, duration_s: float) -> Pair:
        """Return a part of the run, with groundtruth of five seconds more at both ends."""
        first = int(self.estimate.stamps[0]) + round(1e9 * start_s)
        last = first + round(1e9 * duration_s)
        near, more = self.truth.stamps, 5 * 10**9
        return dataclasses.replace(
            self,
            name=f"{self.name} {start_s:.0f}+{duration_s:.0f} s",
            truth=self.truth[(near >= first - more) & (near <= last + more)],
            estimate=self.estimate[
                (self.estimate.stamps >= first) & (self.estimate.stamps <= last)
            ],
        )


def recorded(folder: Path) -> Iterator[Pair]:
    """Yield the real recordings that are in the folder."""
    for name, (truth, estimate, gauge, max_gap_s) in REAL.items():
        if not (folder / truth.split(":")[0]).exists():
            continue
        sides = [read_trajectory(str(folder / item)).in_order() for item in (truth, estimate)]
        if name.startswith("KITTI"):
            seconds = np.loadtxt(folder / _KITTI_TIMES)
            stamps = np.rint(1e9 * seconds).astype(np.int64)
            sides = [
                dataclasses.replace(
                    side,
                    stamps=stamps[: len(side)],
                    reading=dataclasses.replace(side.reading, stamped=True),
                )
                for side in sides
            ]
        yield Pair(name, sides[0], sides[1], gauge, max_gap_s)


def simulated(
    seed: int,
    kind: str,
    drift: str,
    duration_s: float,
    *,
    worse: float = 1.0,
) -> Pair:
    """Return a run of one kind, and an odometry of it with one kind of drift.

    Args:
        seed: Of everything.
        kind: One of `KINDS`.
        drift: One of `DRIFTS`, or "t2", "heavier" or "t1.2".
        duration_s: How long it is.
        worse: How many times larger the drift is.
    """
    random = np.random.default_rng(seed)
    times = np.arange(0.0, duration_s, 1.0 / _FINE_HZ)
    positions, quaternions = _motion(random, times, kind)
    truth = slice(None, None, _FINE_HZ // _TRUTH_HZ)
    seen = slice(int(random.integers(0, 9)), None, _FINE_HZ // _ESTIMATE_HZ)
    shaken = lie.from_rotation_vector(random.normal(0.0, 5e-4, positions[truth].shape))
    groundtruth = Trajectory.from_columns(
        _stamps(times[truth]),
        positions[truth] + random.normal(0.0, 3e-4, positions[truth].shape),
        lie.multiply(quaternions[truth], shaken),
        name="groundtruth",
    )
    estimate = _odometry(random, times[seen], positions[seen], quaternions[seen], drift, worse)
    return Pair(f"{kind} {drift} {seed}", groundtruth, estimate)


def with_outliers(pair: Pair, seed: int, number: int, longest: int, *, lost: bool) -> Pair:
    """Return a pair with series of outliers of the estimate, after which it goes on as before.

    Args:
        pair: A right recording.
        seed: Of places, lengths and sizes.
        number: How many series.
        longest: The most poses in a series.
        lost: Whether outliers repeat the first pose, as of an estimator that lost tracking;
            otherwise they are off by some metres and up to 60 deg.
    """
    random = np.random.default_rng(seed)
    positions, quaternions = pair.estimate.positions.copy(), pair.estimate.quaternions
    assert quaternions is not None
    quaternions = quaternions.copy()
    for row in random.integers(5, len(positions) - longest, number):
        rows = slice(row, row + int(random.integers(1, longest + 1)))
        if lost:
            positions[rows], quaternions[rows] = positions[0], quaternions[0]
        else:
            positions[rows] += random.normal(0.0, 3.0, 3)
            rotation = lie.from_rotation_vector(random.normal(0.0, np.radians(20.0), 3))
            quaternions[rows] = lie.multiply(rotation, quaternions[rows])
    estimate = dataclasses.replace(pair.estimate, positions=positions, quaternions=quaternions)
    return dataclasses.replace(pair, name=f"{pair.name} {number}x{longest}", estimate=estimate)


def _stamps(seconds: Array) -> NDArray[np.int64]:
    return EPOCH + np.rint(1e9 * seconds).astype(np.int64)


def _about_z(angles: Array) -> Array:
    rotated: Array = lie.from_rotation_vector(np.outer(angles, [0.0, 0.0, 1.0]))
    return rotated


def _waves(
    random: np.random.Generator, times: Array, size: float, slow_hz: float, fast_hz: float
) -> Array:
    """Return a sum of waves of random rates, of an rms size; slower ones are larger."""
    rates = np.exp(random.uniform(np.log(slow_hz), np.log(fast_hz), 8))
    sizes = random.normal(size=8) / np.sqrt(rates / slow_hz)
    phases = random.uniform(0.0, 2.0 * np.pi, 8)
    summed = (sizes[:, None] * np.sin(2.0 * np.pi * np.outer(rates, times) + phases[:, None])).sum(
        axis=0
    )
    waves: Array = size * summed / np.sqrt(np.sum(sizes**2) / 2.0)
    return waves


def _motion(random: np.random.Generator, times: Array, kind: str) -> tuple[Array, Array]:
    if kind in _REACH:
        reach, slow, fast = _REACH[kind]
        positions = np.column_stack(
            [_waves(random, times, reach * share, slow, fast) for share in (1.0, 1.0, 0.35)]
        )
        yaw = _waves(random, times, 1.2, 0.01, 0.2)
        tilts = [_waves(random, times, 0.12, 0.05, 1.2) for _ in range(2)]
    else:
        fast = kind == "car"
        speed = np.abs(_waves(random, times, 3.0, 0.01, 0.05) + 8.0)
        if not fast:  # it stops now and then
            speed = np.clip(np.abs(_waves(random, times, 0.5, 0.02, 0.1)) - 0.15, 0.0, 1.2)
        turning = _waves(random, times, 0.35 if fast else 0.6, 0.02, 0.2) * np.minimum(speed, 1.0)
        yaw = np.cumsum(turning) / _FINE_HZ
        level = np.column_stack([speed * np.cos(yaw), speed * np.sin(yaw)])
        height = _waves(random, times, 0.5 if fast else 0.02, 0.01, 0.05)
        positions = np.column_stack([np.cumsum(level, axis=0) / _FINE_HZ, height])
        tilts = [_waves(random, times, 0.015, 0.05, 1.0) for _ in range(2)]
    tilted = lie.multiply(
        lie.from_rotation_vector(np.outer(tilts[0], [0.0, 1.0, 0.0])),
        lie.from_rotation_vector(np.outer(tilts[1], [1.0, 0.0, 0.0])),
    )
    world = _about_z(random.uniform(-np.pi, np.pi, 1))
    quaternions = lie.multiply(world, lie.multiply(_about_z(yaw), tilted))
    return lie.rotate(world, positions) + random.normal(0.0, 3.0, 3), quaternions


def _odometry(
    random: np.random.Generator,
    times: Array,
    positions: Array,
    quaternions: Array,
    drift: str,
    worse: float,
) -> Trajectory:
    """Return an estimate that sums disturbed steps up, in a world of its own."""
    draw: Callable[..., Array] = random.normal
    if drift in _TAILS:
        tail = _TAILS[drift]
        draw = lambda mean, size, shape: mean + 0.6 * size * random.standard_t(tail, shape)  # noqa: E731
    count, root = len(times), np.sqrt(1.0 / _ESTIMATE_HZ)
    rate = root * np.radians(random.uniform(0.03, 0.4)) * worse
    rotated = _about_z(np.cumsum(draw(0.0, rate, count)))
    steps = np.diff(positions, axis=0)
    speed = np.linalg.norm(steps, axis=1, keepdims=True)
    scale = np.full((count - 1, 1), 1.0 + random.normal(0.0, 0.04 if drift == "scale" else 0.01))
    if drift == "scale":
        scale += np.cumsum(random.normal(0.0, 0.003 * root, count - 1))[:, None]
    moved = scale * lie.rotate(rotated[:-1], steps)
    moved += speed * np.cumsum(draw(0.0, 0.004 * root * worse, (count - 1, 3)), axis=0)
    moved += draw(0.0, root * random.uniform(0.002, 0.01) * worse, (count - 1, 3))
    path = np.concatenate([np.zeros((1, 3)), np.cumsum(moved, axis=0)])
    if drift == "loops":
        for share in random.uniform(0.2, 0.95, 4):  # half of the drift is taken back at once
            row = int(share * count)
            path[row:] -= 0.5 * (path[row] - (positions[row] - positions[0]))
    waves = [_waves(random, times, 1.0, 0.005, 0.1) for _ in range(2)]
    tilt = np.column_stack([*waves, np.zeros(count)])
    tilt *= np.radians(random.uniform(0.1, 2.0 if drift == "tilt" else 0.5))
    seen = lie.multiply(lie.multiply(rotated, lie.from_rotation_vector(tilt)), quaternions)
    noise = lie.from_rotation_vector(draw(0.0, np.radians(0.1), (count, 3)))
    world = _about_z(random.uniform(-np.pi, np.pi, 1))
    path = lie.rotate(world, path + random.normal(0.0, 0.003, path.shape))
    return Trajectory.from_columns(
        _stamps(times),
        path - path[0],
        lie.multiply(world, lie.multiply(seen, noise)),
        name="estimate",
    )
