"""Simulated and real rigs with an IMU and a faulty groundtruth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paths import SHARED
from scipy.spatial.transform import Rotation

from trajeval_ros import Trajectory
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.inertial import InertialReadings

START_NS = 1_700_000_000_000_000_000
GRAVITY = np.array([0.0, 0.0, 9.81])
REAL = SHARED / "data" / "groundtruth_doctor"
TURNS = {
    "handheld": (0.35, 0.35, 0.5), "car": (0.0, 0.0, 1.2), "turntable": (0.0, 0.0, 1.5),
    "rest": (0.0, 0.0, 0.0),
}  # fmt: skip
MOVES = {
    "handheld": (0.4, 0.4, 0.25), "car": (3.0, 3.0, 0.0), "turntable": (0.0, 0.0, 0.0),
    "rest": (0.0, 0.0, 0.0),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Motion:
    """Sums of five sines: positions, and Euler angles."""

    amplitudes: Floats  # (5, 6)
    rates: Floats  # (5, 6), rad/s
    phases: Floats  # (5, 6)

    def waves(self, seconds: Floats, derivative: int = 0) -> Floats:
        phases = seconds[:, None, None] * self.rates + self.phases + derivative * np.pi / 2.0
        waves: Floats = (self.amplitudes * self.rates**derivative * np.sin(phases)).sum(axis=1)
        return waves

    def positions(self, seconds: Floats, derivative: int = 0) -> Floats:
        return self.waves(seconds, derivative)[:, :3]

    def rotations(self, seconds: Floats) -> Rotation:
        return Rotation.from_euler("ZYX", self.waves(seconds)[:, [5, 4, 3]])


@dataclass(frozen=True, eq=False)
class ExaminedRig:
    """A groundtruth, the IMU of its rig, and the motion."""

    groundtruth: Trajectory
    readings: InertialReadings
    motion: Motion

    def errors(self, result: Trajectory) -> tuple[float, float]:
        """Return the rmse of positions (m) and rotations (rad) of states of the IMU."""
        seconds = (result.stamps - START_NS) / 1e9
        apart = result.positions - self.motion.positions(seconds)
        assert result.rotations is not None
        rotated = (self.motion.rotations(seconds).inv() * result.rotations).magnitude()
        return (
            float(np.sqrt(np.square(apart).sum(axis=1).mean())),
            float(np.sqrt(np.square(rotated).mean())),
        )


def rig(
    seed: int = 0,
    kind: str = "handheld",
    *,
    duration_s: float = 30.0,
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
    lever_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    offset_s: float = 0.0,
    skew: float = 0.0,
    tilt_deg: float = 0.0,
    jitter_s: float = 0.0,
    noise: tuple[float, float] = (5e-4, 2e-3),
    tails: float = np.inf,
    world: Rotation | None = None,
) -> ExaminedRig:
    """Return a rig; the groundtruth's noise is Student's t with `tails` degrees of freedom."""
    generator = np.random.default_rng([seed, 38])
    sizes = np.array([*MOVES[kind], *TURNS[kind]])
    amplitudes = generator.uniform(0.4, 1.0, (5, 6)) * sizes / 2.0
    rates = 2.0 * np.pi * generator.uniform(0.05, 0.6 if kind == "handheld" else 0.2, (5, 6))
    motion = Motion(amplitudes, rates, generator.uniform(0.0, 2.0 * np.pi, (5, 6)))
    seconds = np.arange(0.0, duration_s, 0.005)
    before, after = (motion.rotations(seconds + side) for side in (-1e-4, 1e-4))
    gyroscope = (before.inv() * after).as_rotvec() / 2e-4
    force = motion.rotations(seconds).inv().apply(motion.positions(seconds, 2) + GRAVITY)
    gyroscope += generator.normal(0.0, 0.01, 3) + generator.normal(0.0, 4e-3, force.shape)
    force += generator.normal(0.0, 0.1, 3) + generator.normal(0.0, 0.06, force.shape)
    times = np.arange(0.3, duration_s - 0.3, 0.01)
    stamps = times - offset_s - skew * (times - times.mean())
    seen = times + generator.normal(0.0, jitter_s, len(times))
    rotated = Rotation.from_rotvec([tilt_deg, 0.0, 0.0], degrees=True)
    rotated = rotated if world is None else world * rotated
    body = motion.rotations(seen)
    white = generator.standard_t if np.isfinite(tails) else None
    draws = generator.normal(size=(2, *body.as_rotvec().shape))
    if white is not None:
        draws = white(tails, draws.shape)
    positions = rotated.apply(motion.positions(seen) + body.apply(lever_m)) + noise[0] * draws[0]
    rotations = rotated * body * Rotation.from_rotvec(turn_deg, degrees=True)
    rotations = rotations * Rotation.from_rotvec(noise[1] * draws[1])
    return ExaminedRig(
        Trajectory.from_columns(
            START_NS + np.rint(stamps * 1e9).astype(np.int64), positions, rotations.as_quat()
        ),
        InertialReadings(START_NS + np.rint(seconds * 1e9).astype(np.int64), gyroscope, force),
        motion,
    )


def real(name: str) -> tuple[Trajectory, InertialReadings]:
    """Return a recording of the shared folder."""
    folder = REAL / name
    imu = "V1_01_original" if name == "V1_01_corrected" else name
    if not folder.is_dir():
        pytest.skip("the recordings are not in ../shared/data")
    poses = np.loadtxt(folder / "groundtruth.txt.gz")
    readings = np.loadtxt(REAL / imu / "imu.csv.gz", delimiter=",")
    stamps = START_NS + np.rint(poses[:, 0] * 1e9).astype(np.int64)
    times = START_NS + (readings[:, 0] - readings[0, 0]).astype(np.int64)
    return (
        Trajectory.from_columns(stamps, poses[:, 1:4], poses[:, 4:8], name=name),
        InertialReadings(times, readings[:, 1:4], readings[:, 4:7]),
    )


def reference(path: Path) -> Any:
    """Return a JSON of the shared folder."""
    import json

    file = SHARED / "reference" / path
    if not file.is_file():
        pytest.skip("the references are not in ../shared")
    return json.loads(file.read_text())
