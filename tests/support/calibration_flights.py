"""Flights whose clocks and bodies are known to differ, with an odometry that drifts."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from trajeval_ros.geometry.trajectory import Trajectory

Array = NDArray[np.float64]
EPOCH = 1_700_000_000_000_000_000
RATE_HZ = 200.0


@dataclasses.dataclass(frozen=True)
class Fault:
    """By what the marker's clock and body differ from the estimate's."""

    offset_s: float = 0.0
    skew: float = 0.0
    rotation_vector: ArrayLike = (0.0, 0.0, 0.0)
    lever_m: ArrayLike = (0.0, 0.0, 0.0)


def stamps_of(seconds: Array) -> NDArray[np.int64]:
    return EPOCH + np.rint(seconds * 1e9).astype(np.int64)


def marked(stamps: Array, poses: Trajectory, duration_s: float, fault: Fault) -> Trajectory:
    """Return body poses as a marker with that fault would report them.

    Args:
        stamps: (N,) seconds by the estimate's clock.
        poses: Positions and rotations of the body.
        duration_s: Of the estimate's run, in whose middle the offset holds.
        fault: What is wrong.
    """
    assert poses.rotations is not None
    rotation = Rotation.from_rotvec(np.asarray(fault.rotation_vector))
    clock = stamps + fault.offset_s + fault.skew * (stamps - duration_s / 2.0)
    return Trajectory(
        stamps_of(clock),
        poses.positions + poses.rotations.apply(np.asarray(fault.lever_m)),
        (poses.rotations * rotation).as_quat(),
    )


def fly(
    seed: int,
    duration_s: float = 60.0,
    kind: str = "drone",
    fault: Fault | None = None,
    *,
    drift: float = 1.0,
    scale: float = 1.0,
) -> tuple[Trajectory, Trajectory]:
    """Return groundtruth of a marker at 200 Hz and a drifting estimate of the body at 20 Hz.

    Args:
        seed: Of everything.
        duration_s: Of the estimate; the groundtruth is 3 s longer at both ends.
        kind: `drone`, `car` (planar), `road` (planar, heading along its path, with a slight
            tilt), `straight`, `translating` or `static`.
        fault: What the marker's clock and body differ by.
        drift: In units of a VIO's: 0.1 deg/sqrt(s) of yaw, 8 mm/sqrt(s), 1 % of scale.
        scale: The estimate's unit, metres.
    """
    random = np.random.default_rng(seed)
    motion = _Motion(random, kind)
    step_s = 1.0 / RATE_HZ
    times = np.arange(0.0, duration_s, step_s)
    count = len(times)
    true = motion.positions(times)

    yaw = np.cumsum(random.normal(0.0, np.radians(0.1) * drift * np.sqrt(step_s), count))
    memory = np.exp(-step_s / 5.0)
    news = random.normal(0.0, np.radians(0.15) * drift * np.sqrt(1.0 - memory**2), (count, 2))
    tilt = lfilter([1.0], [1.0, -memory], news, axis=0)
    rotated = Rotation.from_rotvec(np.column_stack([tilt, yaw]))
    stretch = 1.0 + 0.01 * drift * random.normal()
    steps = stretch * rotated[1:].apply(np.diff(true, axis=0))
    steps += random.normal(0.0, 0.008 * drift * np.sqrt(step_s), steps.shape)
    drifted = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])

    seen = slice(0, None, 10)
    noise = random.normal(0.0, 0.001, (len(times[seen]), 3))
    jitter = Rotation.from_rotvec(random.normal(0.0, np.radians(0.02), noise.shape))
    world = Rotation.from_rotvec([0.0, 0.0, random.uniform(-3.0, 3.0)])
    estimate = Trajectory(
        stamps_of(times[seen]),
        (world.apply(drifted[seen] + noise) + random.normal(0.0, 5.0, 3)) / scale,
        (world * rotated[seen] * motion.rotations(times[seen]) * jitter).as_quat(),
    )
    wide = np.arange(-3.0, duration_s + 3.0, step_s)
    shaken = Rotation.from_rotvec(random.normal(0.0, np.radians(0.05), (len(wide), 3)))
    body = Trajectory(stamps_of(wide), motion.positions(wide), motion.rotations(wide).as_quat())
    truth = marked(wide, body, times[seen][-1], fault or Fault())
    assert truth.rotations is not None
    truth = dataclasses.replace(
        truth,
        positions=truth.positions + random.normal(0.0, 0.001, truth.positions.shape),
        quaternions=(truth.rotations * shaken).as_quat(),
    )
    return truth, estimate


class _Motion:
    """Sums of sine waves."""

    def __init__(self, random: np.random.Generator, kind: str) -> None:
        self._kind = kind
        waves = (12, 3)
        self._frequencies = 2.0 * np.pi * random.uniform(0.05, 0.6, waves)
        self._sizes = random.normal(size=waves) * 0.55 / self._frequencies**0.8
        self._phases = random.uniform(0.0, 2.0 * np.pi, waves)
        self._rates = 2.0 * np.pi * random.uniform(0.05, 0.8, waves)
        self._angles = random.normal(size=waves) * [0.6, 0.15, 0.15] / np.sqrt(2.0 * self._rates)
        self._starts = random.uniform(0.0, 2.0 * np.pi, waves)

    def positions(self, times: Array) -> Array:
        if self._kind == "static":
            return np.zeros((len(times), 3))
        if self._kind == "straight":
            return np.outer(times, [10.0, 0.0, 0.0])
        moved = _waves(times, self._frequencies, self._phases, self._sizes)
        if self._kind in ("car", "road"):
            moved = _waves(times, self._frequencies / 5.0, self._phases, 12.0 * self._sizes)
            moved[:, 2] = 0.0
        return moved

    def rotations(self, times: Array) -> Rotation:
        if self._kind in ("straight", "translating", "static"):
            return Rotation.identity(len(times))
        angles = _waves(times, self._rates, self._starts, self._angles)
        if self._kind == "car":
            angles[:, 1:] = 0.0
        if self._kind == "road":
            velocity = np.gradient(self.positions(times), times, axis=0)
            angles[:, 0] = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))
            angles[:, 1:] *= 0.05
        return Rotation.from_euler("ZYX", angles)


def _waves(times: Array, frequencies: Array, phases: Array, sizes: Array) -> Array:
    summed: Array = (np.sin(times[:, None, None] * frequencies + phases) * sizes).sum(axis=1)
    return summed
