"""Simulated runs to watch: nine motions, and estimators with the errors of real ones.

A run has an estimate with twist (25 Hz; wheel odometry of the planar robot at 50 Hz), a second
estimate of another body (20 Hz), and an IMU (200 Hz).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter, oaconvolve
from scipy.spatial.transform import Rotation

from trajeval_ros import Trajectory
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.inertial import InertialReadings
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.watchdog.recording import WatchedRun
from trajeval_ros.watchdog.signals import PAIR

RATE_HZ = 200.0
_DT, _CUT_S, _EPOCH = 1.0 / RATE_HZ, 5.0, 1_750_000_000 * NANOSECONDS
_GRAVITY = np.array([0.0, 0.0, 9.81])
# The second estimate's body in the robot's.
BODY, LEVER_M = Rotation.from_rotvec([0.4, -0.5, 0.3]), np.array([0.2, -0.1, 0.15])

# Positions (N, 3), and yaw, pitch and roll (N, 3), rad, at times (N,), s.
Motion = Callable[[np.random.Generator, Floats], tuple[Floats, Floats]]


def filtered(values: Floats, sigma_s: float) -> Floats:
    """Filter by a Gaussian along the first axis; the ends are continued by their values."""
    radius = int(4.0 * sigma_s / _DT + 0.5)
    kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) * _DT / sigma_s) ** 2)
    padded = np.pad(values, [(radius, radius)] + [(0, 0)] * (values.ndim - 1), mode="edge")
    shape = (-1,) + (1,) * (values.ndim - 1)
    result: Floats = oaconvolve(padded, (kernel / kernel.sum()).reshape(shape), "valid", axes=0)
    return result


def smooth(
    generator: np.random.Generator, count: int, correlation_s: float, sigma: float, axes: int = 1
) -> Floats:
    """Return smooth noise (N,), or (N, axes), of a correlation time and standard deviation."""
    noise = filtered(generator.normal(size=(count, axes)), correlation_s)
    result: Floats = sigma * noise / noise.std(axis=0)
    return result[:, 0] if axes == 1 else result


def _drive(speed: Floats, yaw: Floats) -> Floats:
    """Return positions (N, 3) of a robot that drives along its heading."""
    along = np.stack([np.cos(yaw), np.sin(yaw), 0.0 * yaw], axis=1)
    path: Floats = np.cumsum(speed[:, None] * along, axis=0) * _DT
    return path


def _rotated(rates: Floats) -> Floats:
    return np.cumsum(rates, axis=0) * _DT


def hover(generator: np.random.Generator, times: Floats) -> tuple[Floats, Floats]:
    """Return a multicopter that flies for 60 s, then hovers in wind between short flights."""
    count = len(times)
    flies = np.clip(3.0 * smooth(generator, count, 25.0, 1.0), 0.0, 1.0)
    flies = filtered(np.where(times < 60.0, 1.0, flies), 1.5)
    speeds = smooth(generator, count, 3.0, 0.8, 3) * [1.0, 1.0, 0.4]
    path = _rotated(speeds * flies[:, None]) + smooth(generator, count, 1.2, 0.06, 3)
    yaw = _rotated(flies * smooth(generator, count, 2.0, 0.35))
    tilt = smooth(generator, count, 0.3, 0.03, 2)
    return path, np.column_stack([yaw, tilt])


def drive_and_stand(generator: np.random.Generator, times: Floats) -> tuple[Floats, Floats]:
    """Return a robot that drives for 45 s and stands for 65 s."""
    count = len(times)
    drives = filtered(((times % 110.0 < 45.0) | (times < 50.0)).astype(float), 0.4)
    drives = np.where(drives < 0.01, 0.0, drives)
    yaw = _rotated(drives * smooth(generator, count, 1.5, 0.5))
    path = _drive(drives * (0.7 + smooth(generator, count, 2.0, 0.2)), yaw)
    path[:, 2] += _rotated(drives * smooth(generator, count, 2.0, 0.02))
    rates = drives[:, None] * smooth(generator, count, 0.5, 0.15, 2)
    return path, np.column_stack([yaw, np.tanh(_rotated(rates)) / 5.0])


def _flight(
    generator: np.random.Generator,
    count: int,
    *,
    speed_mps: float,
    correlation_s: float,
    radius_s: float,
    yaw_radps: float,
) -> tuple[Floats, Floats]:
    """Return a multicopter that tilts by its acceleration."""
    path = _rotated(smooth(generator, count, correlation_s, speed_mps, 3) * [1.0, 1.0, 0.4])
    path = path - filtered(path, radius_s)
    force = np.gradient(np.gradient(path, _DT, axis=0), _DT, axis=0) + _GRAVITY
    tilt = np.stack([force[:, 0], -force[:, 1]], axis=1) / _GRAVITY[2]
    yaw = _rotated(smooth(generator, count, correlation_s / 2.0, yaw_radps))
    return path, np.column_stack([yaw, filtered(np.clip(tilt, -1.0, 1.0), 0.05)])


def aggressive(generator: np.random.Generator, times: Floats) -> tuple[Floats, Floats]:
    """Return a flight at about 4 m/s."""
    return _flight(
        generator, len(times), speed_mps=3.5, correlation_s=1.0, radius_s=15.0, yaw_radps=1.5
    )


def race(generator: np.random.Generator, times: Floats) -> tuple[Floats, Floats]:
    """Return a flight at 5 to 10 m/s."""
    return _flight(
        generator, len(times), speed_mps=6.0, correlation_s=1.5, radius_s=10.0, yaw_radps=1.0
    )


def planar(generator: np.random.Generator, times: Floats) -> tuple[Floats, Floats]:
    """Return a wheeled robot on a floor, which turns on the spot at times."""
    count = len(times)
    drives = np.clip(smooth(generator, count, 6.0, 1.0) + 0.6, 0.0, 1.0)
    drives = filtered(np.where(times < 45.0, np.maximum(drives, 0.7), drives), 0.3)
    spins = np.clip(smooth(generator, count, 5.0, 1.0) - 1.0, 0.0, 0.8)
    yaw = _rotated(filtered(drives * smooth(generator, count, 1.5, 0.45) + spins, 0.1))
    speed = drives * (0.8 + smooth(generator, count, 2.0, 0.2))
    path = _drive(filtered(speed * (spins < 0.1), 0.2), yaw)
    shakes = smooth(generator, count, 0.1, 0.002, 2) * (drives > 0.05)[:, None]
    return path, np.column_stack([yaw, filtered(shakes, 0.1)])


def walk(generator: np.random.Generator, times: Floats) -> tuple[Floats, Floats]:
    """Return a walk with a handheld sensor."""
    count = len(times)
    yaw = _rotated(smooth(generator, count, 1.0, 0.5))
    step = 2.0 * np.pi * 1.9 * times + smooth(generator, count, 3.0, 0.5)
    path = _drive(0.9 + smooth(generator, count, 3.0, 0.3), yaw)
    path += np.stack([np.sin(step), 2.0 * np.sin(step / 2.0), 3.0 * np.sin(step)], axis=1) * 0.01
    path += smooth(generator, count, 0.4, 0.04, 3)
    tilt = smooth(generator, count, 0.35, 0.18, 2)
    tilt += 0.03 * np.stack([np.sin(step), np.sin(step / 2.0)], axis=1)
    return path, np.column_stack([yaw + smooth(generator, count, 0.4, 0.25), tilt])


def fast(generator: np.random.Generator, times: Floats) -> tuple[Floats, Floats]:
    """Return a car at 3 to 5 m/s."""
    count = len(times)
    speed = filtered(np.clip(4.0 + smooth(generator, count, 4.0, 0.8), 3.0, 5.0), 0.3)
    rate = smooth(generator, count, 2.0, 0.3)
    path = _drive(speed, _rotated(rate))
    path[:, 2] += _rotated(smooth(generator, count, 3.0, 0.1))
    tilt = smooth(generator, count, 0.3, 0.015, 2)
    tilt[:, 1] += 0.01 * rate * speed
    return path, np.column_stack([_rotated(rate), tilt])


def one_axis(generator: np.random.Generator, times: Floats) -> tuple[Floats, Floats]:
    """Return a crane: motion in a vertical plane, and pitch alone."""
    count = len(times)
    path = _rotated(smooth(generator, count, 2.0, 0.7, 3) * [1.0, 0.0, 0.6])
    pitch = smooth(generator, count, 1.0, 0.3)
    return path - filtered(path, 20.0), np.stack([0.0 * times, pitch, 0.0 * times], axis=1)


def boat(generator: np.random.Generator, times: Floats) -> tuple[Floats, Floats]:
    """Return a boat that rolls and pitches in waves."""
    count = len(times)
    yaw = _rotated(smooth(generator, count, 4.0, 0.12))
    path = _drive(1.2 + smooth(generator, count, 8.0, 0.4), yaw)
    path[:, 2] += smooth(generator, count, 1.2, 0.15)
    tilt = smooth(generator, count, 1.0, 0.09, 2)
    return path, np.column_stack([yaw + smooth(generator, count, 1.5, 0.03), tilt])


# Motions with the vibration of their accelerometers, m/s^2.
MOTIONS: dict[str, tuple[Motion, float]] = {
    "hover": (hover, 0.3),
    "drive and stand": (drive_and_stand, 0.05),
    "aggressive flight": (aggressive, 0.8),
    "planar": (planar, 0.05),
    "walk": (walk, 0.05),
    "car, 3 to 5 m/s": (fast, 0.4),
    "one axis": (one_axis, 0.1),
    "boat": (boat, 0.1),
    "race, 5 to 10 m/s": (race, 0.8),
}


def simulated(name: str, seed: int, duration_s: float) -> WatchedRun:
    """Return a healthy run of a motion."""
    motion, vibration = MOTIONS[name]
    generator = np.random.default_rng([seed, list(MOTIONS).index(name)])
    times = np.arange(0.0, duration_s + 2.0 * _CUT_S, _DT)
    path, angles = motion(generator, times)
    inner = slice(int(_CUT_S * RATE_HZ), -int(_CUT_S * RATE_HZ))
    path, rotations = path[inner] - path[inner][0], Rotation.from_euler("ZYX", angles[inner])
    wheeled = motion is planar
    own = _estimate(path, rotations, generator, 50.0 if wheeled else 25.0, 1.0, wheeled=wheeled)
    other = _estimate(path, rotations, generator, 20.0, 1.5, wheeled=False)
    assert other.quaternions is not None
    at = Rotation.from_quat(other.quaternions)
    partner = Trajectory(
        other.stamps, other.positions + at.apply(LEVER_M), (at * BODY).as_quat(), name="second"
    )
    return WatchedRun(own, _imu(path, rotations, generator, vibration), {PAIR: partner})


def _imu(
    path: Floats, turns: Rotation, generator: np.random.Generator, vibration: float
) -> InertialReadings:
    """Return readings in unknown axes, with noise, biases and vibration in motion."""
    count = len(path)
    rates = (turns[:-1].inv() * turns[1:]).as_rotvec() / _DT
    velocity = np.gradient(path, _DT, axis=0)
    force = turns.inv().apply(np.gradient(velocity, _DT, axis=0) + _GRAVITY)
    axes = Rotation.from_rotvec(generator.normal(size=3)).inv()
    moves = np.clip(5.0 * np.linalg.norm(velocity, axis=1), 0.0, 1.0)[:, None]
    measured = []
    for values, white, shakes, bias, walks in (
        (np.concatenate([rates, rates[-1:]]), 1.7e-4, 0.0 * moves, 0.005, 2e-5),
        (force, 2e-3, vibration * moves, 0.03, 1e-4),
    ):
        noise = generator.normal(size=(count, 3)) * (white / np.sqrt(_DT) + shakes)
        wander = np.cumsum(generator.normal(0.0, walks * np.sqrt(_DT), (count, 3)), axis=0)
        measured.append(axes.apply(values) + noise + wander + generator.normal(0.0, bias, 3))
    stamps = _EPOCH + np.rint(np.arange(count) * _DT * NANOSECONDS).astype(np.int64)
    return InertialReadings(stamps, *measured)


def _estimate(
    path: Floats,
    turns: Rotation,
    generator: np.random.Generator,
    rate_hz: float,
    worse: float,
    *,
    wheeled: bool,
) -> Trajectory:
    """Return a drifting estimate: yaw, tilt, scale and noise with Student's t tails."""
    step = round(RATE_HZ / rate_hz)
    rows = np.arange(generator.integers(0, step), len(path), step)
    count, dt = len(rows), step * _DT

    def heavy(*shape: int) -> Floats:
        drawn: Floats = generator.standard_t(5.0, size=shape) / np.sqrt(5.0 / 3.0)
        return drawn

    def wandering(correlation_s: float, sigma: float, axes: int) -> Floats:
        decay = np.exp(-dt / correlation_s)
        noise = generator.normal(size=(count, axes)) * sigma * np.sqrt(1.0 - decay**2)
        result: Floats = lfilter([1.0], [1.0, -decay], noise, axis=0)
        return result

    steps = np.diff(path[rows], axis=0)
    moved = np.linalg.norm(steps, axis=1)
    rotated = np.linalg.norm((turns[rows[:-1]].inv() * turns[rows[1:]]).as_rotvec(), axis=1)
    walks = heavy(count - 1) * np.radians(0.02 * worse) * np.sqrt(dt) * (moved > 1e-5)
    walks += heavy(count - 1) * 0.004 * worse * np.sqrt(rotated * np.radians(1.0))
    yaw = np.outer(np.concatenate([[0.0], np.cumsum(walks)]), [0.0, 0.0, 1.0])
    tilt = np.column_stack([wandering(8.0, np.radians(0.15 * worse), 2), np.zeros(count)])
    off = Rotation.from_rotvec(yaw) * Rotation.from_rotvec(tilt)
    scale = 1.0 + generator.normal(0.0, 0.005) + wandering(30.0, 0.006 * worse, 1)
    steps = off[:-1].apply(steps) * scale[:-1]
    spread = [1.0, 1.0, 0.0 if wheeled else 0.3]
    steps += heavy(count - 1, 3) * 0.003 * worse * np.sqrt(moved)[:, None] * spread
    moves = np.concatenate([[0.0], moved > 0.02 * dt])[:, None]
    positions = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    positions += heavy(count, 3) * 0.0015 * worse * moves * (not wheeled)
    shakes = heavy(count, 3) * np.radians(0.03 * worse) * moves * (0.3 if wheeled else 1.0)
    velocities = off.apply(np.gradient(path, _DT, axis=0)[rows]) * scale
    velocities += heavy(count, 3) * 0.015 * worse * moves
    frame = Rotation.from_rotvec([0.0, 0.0, generator.uniform(-3.0, 3.0)])
    times = rows * _DT + np.abs(generator.normal(0.0, 2e-4, count))
    kept = generator.random(count) > 0.002
    return Trajectory(
        _EPOCH + np.rint(times * NANOSECONDS).astype(np.int64)[kept],
        frame.apply(positions)[kept],
        (frame * off * turns[rows] * Rotation.from_rotvec(shakes)).as_quat()[kept],
        frame.apply(velocities)[kept],
        name="estimate",
    )
