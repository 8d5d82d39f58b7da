"""Simulated receive times, and dropouts."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry.receive_times import LOG, ReceiveTimes
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
    reading = dataclasses.replace(estimate.reading, receive_times=receive_times)
    return dataclasses.replace(estimate, reading=reading)[kept]
