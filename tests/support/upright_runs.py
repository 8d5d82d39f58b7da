"""Runs in frames with any axis up."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from trajeval_ros.cli.app import main
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UP_AXES, Z_UP, UpAxis

Array = NDArray[np.float64]
axes = st.sampled_from(UP_AXES)
OF_VERTICAL = ("yaw_deg", "tilt_deg", "horizontal_m", "vertical_m")


def direction(axis: str) -> Array:
    unit: Array = (-1.0 if axis.startswith("-") else 1.0) * np.eye(3)["xyz".index(axis[-1])]
    return unit


def standing(trajectory: Trajectory, axis: str, *, states_axis: bool = True) -> Trajectory:
    """Return a trajectory of a z-up world in one that has another axis up."""
    rotation = Rotation.align_vectors([direction(axis)], [[0.0, 0.0, 1.0]])[0]
    assert trajectory.rotations is not None
    velocities = trajectory.velocities
    return dataclasses.replace(
        trajectory,
        positions=rotation.apply(trajectory.positions),
        quaternions=(rotation * trajectory.rotations).as_quat(),
        velocities=None if velocities is None else rotation.apply(velocities),
        covariances=None,
        up=UpAxis(axis) if states_axis else Z_UP,
    )


def car(seed: int, *, slope_deg: float = 0.0, count: int = 400) -> Trajectory:
    """Return a vehicle that drives round in a plane, in a world with z up."""
    random = np.random.default_rng(seed)
    rates = 0.3 + 0.4 * np.sin(np.linspace(0.0, 6.0, count) + random.uniform(0.0, 6.0))
    heading = random.uniform(-np.pi, np.pi) + np.cumsum(rates) * 0.1
    ahead = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(count)])
    bumps = random.normal(scale=0.02, size=(count, 2))
    rotations = Rotation.from_euler("ZYX", np.column_stack([heading, bumps]))
    slope = Rotation.from_euler("X", slope_deg, degrees=True)
    height = 0.3 * np.sin(np.linspace(0.0, 9.0, count))
    places = np.cumsum(ahead, axis=0) + np.outer(height, [0.0, 0.0, 1.0])
    stamps = 10**18 + np.arange(count, dtype=np.int64) * 100_000_000
    return Trajectory(stamps, slope.apply(places), (slope * rotations).as_quat())


def erring(truth: Trajectory, seed: int = 1) -> Trajectory:
    """Return an estimate of a trajectory, in its frame."""
    random = np.random.default_rng(seed)
    assert truth.rotations is not None
    wrong = Rotation.from_rotvec(random.normal(scale=0.03, size=(len(truth), 3)))
    return dataclasses.replace(
        truth,
        positions=truth.positions + random.normal(scale=0.2, size=truth.positions.shape),
        quaternions=(wrong * truth.rotations).as_quat(),
    )


def write_tum(path: Path, trajectory: Trajectory) -> None:
    assert trajectory.quaternions is not None
    columns = [trajectory.stamps * 1e-9 % 1e6, trajectory.positions, trajectory.quaternions]
    np.savetxt(path, np.column_stack(columns), fmt="%.12f")


def evaluated(folder: Path, *options: str) -> tuple[int, Any]:
    arguments = ["evaluate", "-g", str(folder / "truth.txt"), "-e", str(folder / "estimate.txt")]
    file = folder / "result.json"
    file.unlink(missing_ok=True)
    status = main([*arguments, "--json", str(file), *options])
    return status, json.loads(file.read_text()) if file.exists() else None
