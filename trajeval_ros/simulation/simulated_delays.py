"""Simulated times of reception, and dropouts."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry.receptions import LOG, ReceiveTimes
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory


class Delay(NamedTuple):
    """A model of delays: a constant plus an exponential part; some messages are lost."""

    constant_s: float
    mean_s: float  # of the exponential part
    lost: float = 0.0  # fraction of the messages


USUAL, SLOW = Delay(0.015, 0.005), Delay(0.12, 0.03, 0.02)


def with_receptions(estimate: Trajectory, delay: Delay, seed: int) -> Trajectory:
    """Return an estimate as it was received: with times of reception, without lost messages.

    A message is never received before an older one, as on one topic.
    """
    random = np.random.default_rng(seed)
    count = len(estimate)
    delays_s = delay.constant_s + random.exponential(delay.mean_s, count)
    times = estimate.stamps + (delays_s * NANOSECONDS).astype(np.int64)
    kept = random.random(count) >= delay.lost
    receptions = ReceiveTimes(np.maximum.accumulate(times), LOG)
    reading = dataclasses.replace(estimate.reading, receptions=receptions)
    return dataclasses.replace(estimate, reading=reading)[kept]
