"""Faults written into a healthy estimate from an onset on, for measuring what a watchdog finds.

A fault of the estimator is in its twist, too, as it would be; a fault of the twist is in it alone.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.simulation.odometry_faults import Fault, diverge, freeze, jump, since, yaw


def scale(estimate: Trajectory, onset: int, _: np.random.Generator, *, share: float) -> Trajectory:
    """Let the scale grow by a share within 10 s."""
    tau = since(estimate, onset)[1]
    factor = 1.0 + share * np.minimum(tau / 10.0, 1.0)
    steps = np.diff(estimate.positions, axis=0) * factor[1:, None]
    positions = estimate.positions[0] + np.concatenate(
        [np.zeros((1, 3)), np.cumsum(steps, axis=0)]
    )
    velocities = estimate.velocities
    if velocities is not None:
        velocities = velocities * factor[:, None]
    return replace(estimate, positions=positions, velocities=velocities)


def jitter(
    estimate: Trajectory, onset: int, generator: np.random.Generator, *, sigma_s: float
) -> Trajectory:
    """Delay stamps at random; those that are overtaken are dropped."""
    first = since(estimate, onset)[0]
    stamps = estimate.stamps.copy()
    delays = np.abs(generator.normal(0.0, sigma_s, len(stamps) - first))
    stamps[first:] += np.rint(delays * NANOSECONDS).astype(np.int64)
    late = np.maximum.accumulate(stamps)
    kept = np.concatenate([[True], np.diff(late) > 1000])
    return replace(estimate, stamps=late)[kept]


def late(
    estimate: Trajectory, onset: int, _: np.random.Generator, *, delay_s: float
) -> Trajectory:
    """Delay all stamps by the same."""
    first = since(estimate, onset)[0]
    stamps = estimate.stamps.copy()
    stamps[first:] += round(delay_s * NANOSECONDS)
    return replace(estimate, stamps=stamps)


def coast(estimate: Trajectory, onset: int, _: np.random.Generator, *, turns: bool) -> Trajectory:
    """Go on at constant velocity; the rotation goes on by the gyro, or stops."""
    first, tau = since(estimate, onset)
    back = max(first - max(2, int(0.3 / np.median(np.diff(estimate.seconds)))), 0)
    span = estimate.seconds[first] - estimate.seconds[back]
    velocity = (estimate.positions[first] - estimate.positions[back]) / span
    positions = estimate.positions.copy()
    positions[first:] = positions[first] + velocity * tau[first:, None]
    velocities, quaternions = estimate.velocities, estimate.quaternions
    assert quaternions is not None
    if velocities is not None:
        velocities = velocities.copy()
        velocities[first:] = velocity
    if not turns:
        quaternions = quaternions[np.minimum(np.arange(len(quaternions)), first)]
    return replace(estimate, positions=positions, quaternions=quaternions, velocities=velocities)


def twist_scale(
    estimate: Trajectory, onset: int, _: np.random.Generator, *, factor: float
) -> Trajectory:
    """Stretch the twist alone."""
    first = since(estimate, onset)[0]
    assert estimate.velocities is not None
    velocities = estimate.velocities.copy()
    velocities[first:] *= factor
    return replace(estimate, velocities=velocities)


def twist_in_world(estimate: Trajectory, onset: int, _: np.random.Generator) -> Trajectory:
    """Give the twist in the world's axes, as if they were the body's."""
    first = since(estimate, onset)[0]
    assert estimate.velocities is not None
    assert estimate.quaternions is not None
    velocities = estimate.velocities.copy()
    velocities[first:] = lie.rotate(estimate.quaternions[first:], velocities[first:])
    return replace(estimate, velocities=velocities)


FAULTS: dict[str, Fault] = {
    **{f"jump {item:g} m": partial(jump, metres=item) for item in (0.1, 0.3, 1.0)},
    "freeze": freeze,
    "coasting, rotation alive": partial(coast, turns=True),
    "coasting, rotation stopped": partial(coast, turns=False),
    **{f"diverging {item:g} m/s2": partial(diverge, mps2=item) for item in (0.05, 0.2, 1.0)},
    **{f"yaw {item:g} deg/s": partial(yaw, rate_deg=item) for item in (0.05, 0.2, 0.5, 1.0)},
    **{f"scale +{100 * item:g} %": partial(scale, share=item) for item in (0.05, 0.2, 0.5)},
    **{f"stamps late {1e3 * s:g} ms": partial(late, delay_s=s) for s in (0.05, 0.2)},
    **{f"stamp jitter {1e3 * s:g} ms": partial(jitter, sigma_s=s) for s in (0.005, 0.02)},
    **{f"twist x {item:g}": partial(twist_scale, factor=item) for item in (0.8, 0.95)},
    "twist in world axes": twist_in_world,
}
