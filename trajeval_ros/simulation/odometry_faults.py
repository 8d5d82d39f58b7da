"""Faults of an odometry from an onset on, and delays of its messages.

A fault of the estimator is in its twist, too, as it would be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.source_info import LOG, ReceiveTimes
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory


class Delay(NamedTuple):
    """A model of delays: a constant plus an exponential part; some messages are lost."""

    constant_s: float
    mean_s: float  # of the exponential part
    lost: float = 0.0  # fraction of the messages


USUAL, SLOW = Delay(0.015, 0.005), Delay(0.12, 0.03, 0.02)


def with_receive_times(estimate: Trajectory, delay: Delay, seed: int) -> Trajectory:
    """Return an estimate as it was received: with receive times, without lost messages.

    A message is never received before an older one, as on one topic.
    """
    random = np.random.default_rng(seed)
    count = len(estimate)
    delays_s = delay.constant_s + random.exponential(delay.mean_s, count)
    times = estimate.stamps + (delays_s * NANOSECONDS).astype(np.int64)
    kept = random.random(count) >= delay.lost
    receive_times = ReceiveTimes(np.maximum.accumulate(times), LOG)
    reading = replace(estimate.reading, receive_times=receive_times)
    return replace(estimate, reading=reading)[kept]


# Estimate, stamp of the onset in ns, and a generator, to the estimate with the fault.
Fault = Callable[[Trajectory, int, np.random.Generator], Trajectory]


def since(estimate: Trajectory, onset: int) -> tuple[int, Floats]:
    """Return the first state at or after the onset, and the time since it, s, of all states."""
    tau = np.maximum(estimate.stamps - onset, 0) / NANOSECONDS
    return int(np.searchsorted(estimate.stamps, onset)), tau


def _rotated(about_z: Floats) -> Floats:
    """Return rotations (N, 4) about z by angles (N,), rad."""
    zero = np.zeros_like(about_z)
    return np.stack([zero, zero, np.sin(0.5 * about_z), np.cos(0.5 * about_z)], axis=1)


def _direction(generator: np.random.Generator) -> Floats:
    vector = generator.normal(size=3) * [1.0, 1.0, 0.3]
    return np.asarray(vector / np.linalg.norm(vector))


def yaw(
    estimate: Trajectory, onset: int, _: np.random.Generator, *, rate_deg: float
) -> Trajectory:
    """Let the yaw drift at a rate, deg/s."""
    tau = since(estimate, onset)[1]
    rotation = _rotated(np.radians(rate_deg) * tau)
    steps = lie.rotate(rotation[1:], np.diff(estimate.positions, axis=0))
    positions = estimate.positions[0] + np.concatenate(
        [np.zeros((1, 3)), np.cumsum(steps, axis=0)]
    )
    assert estimate.quaternions is not None
    velocities = estimate.velocities
    if velocities is not None:
        velocities = lie.rotate(rotation, velocities)
    return replace(
        estimate,
        positions=positions,
        quaternions=lie.normalized(lie.multiply(rotation, estimate.quaternions)),
        velocities=velocities,
    )


def jump(
    estimate: Trajectory, onset: int, generator: np.random.Generator, *, metres: float
) -> Trajectory:
    """Move all positions from the onset on."""
    first = since(estimate, onset)[0]
    positions = estimate.positions.copy()
    positions[first:] += metres * _direction(generator)
    return replace(estimate, positions=positions)


def freeze(estimate: Trajectory, onset: int, _: np.random.Generator) -> Trajectory:
    """Repeat the pose and twist of the onset."""
    first = since(estimate, onset)[0]
    held = np.minimum(np.arange(len(estimate)), first)
    return replace(estimate[held], stamps=estimate.stamps)


def diverge(
    estimate: Trajectory, onset: int, generator: np.random.Generator, *, mps2: float
) -> Trajectory:
    """Accelerate away from the groundtruth."""
    tau = since(estimate, onset)[1]
    along = _direction(generator)
    velocities = estimate.velocities
    if velocities is not None:
        velocities = velocities + mps2 * tau[:, None] * along
    positions = estimate.positions + 0.5 * mps2 * tau[:, None] ** 2 * along
    return replace(estimate, positions=positions, velocities=velocities)


# The faults of `trajeval simulate --fault`, in words and as functions.
FAULTS: dict[str, tuple[str, Fault]] = {
    "yaw": ("yaw drifts by 1 deg/s", partial(yaw, rate_deg=1.0)),
    "jump": ("the position jumps by 1 m", partial(jump, metres=1.0)),
    "freeze": ("the pose is repeated", freeze),
    "divergence": ("the position accelerates by 1 m/s2", partial(diverge, mps2=1.0)),
}
