"""Runs whose alignment determines its rotation well or badly, and their numbers."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy.spatial.transform import Rotation
from strategies import START, make_groundtruth

from trajeval_ros import Evaluation, Gauge, Protocol, Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.metrics.alignment import Alignment

TURNING = (Gauge.YAW, Gauge.PLANAR, Gauge.SE3, Gauge.SIM3)
X = Rotation.from_rotvec(np.radians(20.0) * np.array([0.48, 0.6, 0.64]))


def on(gauge: Gauge = Gauge.SE3, way: str = "positions") -> Protocol:
    return Protocol(gauge=gauge, align_with=way, lengths=())


def road(roll_deg: float, *, error_m: float = 0.3, seed: int = 1) -> tuple[Trajectory, Trajectory]:
    """Return 150 m of a road that bends by 1 m, and an estimate whose drift looks like a roll.

    Its orientations are right to 0.1 deg.
    """
    random = np.random.default_rng(seed)
    along = np.linspace(0.0, 150.0, 301)
    side = np.sin(along / 25.0)
    positions = np.column_stack([along, side, 0.3 * np.cos(along / 40.0)])
    heading = np.arctan(np.cos(along / 25.0) / 25.0)
    rotations = Rotation.from_rotvec(heading[:, None] * [0.0, 0.0, 1.0])
    stamps = START + np.arange(len(along), dtype=np.int64) * 50_000_000
    truth = Trajectory(stamps, positions, rotations.as_quat())
    drift = Rotation.from_rotvec([np.radians(roll_deg), 0.0, 0.0]).apply(positions)
    drift += error_m * np.sin(along[:, None] / 150.0 * np.array([13.0, 17.0, 15.0]))
    noise = Rotation.from_rotvec(np.radians(0.1 / math.sqrt(3.0)) * random.normal(size=(301, 3)))
    return truth, Trajectory(stamps, drift, (noise * rotations).as_quat())


def flight(seed: int, count: int = 200) -> tuple[Trajectory, Trajectory]:
    """Return a motion in space, and an estimate with errors of 0.1 m and 0.02 rad."""
    truth = dataclasses.replace(
        make_groundtruth(seed, count),
        gyroscope_biases=None,
        accelerometer_biases=None,
        up=UpAxis("z"),  # of some seeds, the motion rather shows another axis
    )
    random = np.random.default_rng(seed + 1)
    assert truth.rotations is not None
    rotated = Rotation.from_rotvec(random.normal(scale=0.02, size=(count, 3))) * truth.rotations
    drift = np.cumsum(random.normal(scale=0.02, size=(count, 3)), axis=0)
    return truth, dataclasses.replace(
        truth, positions=truth.positions + drift, quaternions=rotated.as_quat(), velocities=None
    )


def of_marker(truth: Trajectory, turn: Rotation = X) -> Trajectory:
    assert truth.rotations is not None
    return dataclasses.replace(truth, quaternions=(truth.rotations * turn).as_quat())


def freedom_numbers(alignment: Alignment) -> list[float]:
    freedom = alignment.freedom
    assert freedom is not None
    assert freedom.orientations is not None
    return [freedom.std_deg, *dataclasses.astuple(freedom.orientations)]


def rotation_warnings(result: Evaluation) -> list[str]:
    words = ("constant rotation", "do not determine", "withheld", "another body")
    return [warning for warning in result.warnings if any(word in warning for word in words)]


def rmse(result: Evaluation, metric: str) -> float:
    statistics = result.ate[metric]
    assert statistics is not None
    return statistics.rmse
