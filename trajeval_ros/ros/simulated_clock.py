"""Simulated time at the reception of messages, interpolated between messages of /clock."""

from __future__ import annotations

import struct
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.geometry.arrays import Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.ros.subscriptions import TopicInput
from trajeval_ros.ros.timing import UNKNOWN

if TYPE_CHECKING:
    from rclpy.node import Node

TOPIC, TYPE = "/clock", "rosgraph_msgs/msg/Clock"
_SAMPLES = 256  # samples that are kept; with /clock at 100 Hz, 2.5 s
_NS = struct.Struct("<iI")
_ENCAPSULATION = b"\0\1"  # little-endian CDR, as every node of ROS writes it


class ClockSamples:
    """Samples of simulated time and their times of reception, for interpolation.

    The clock of a ROS node does not interpolate: with /clock at 10 Hz it has steps of 0.1 s.
    """

    def __init__(self) -> None:
        """Create it without any."""
        self._samples: deque[tuple[int, int]] = deque(maxlen=_SAMPLES)

    def see(self, received: int, time_ns: int) -> None:
        """Add a simulated time and its time of reception, nanoseconds."""
        if self._samples and (time_ns < self._samples[-1][1] or received < self._samples[-1][0]):
            self._samples.clear()  # time starts again
        self._samples.append((received, time_ns))

    def at(self, received: Stamps) -> Stamps:
        """Return the simulated time at which messages were received, (N,), nanoseconds.

        After the newest sample, time is extrapolated for at most one interval of samples. Later
        times, and times before the oldest sample, are `UNKNOWN`.
        """
        found = np.full(len(received), UNKNOWN)
        if len(self._samples) < 2:
            return found
        walls, times = np.array(self._samples).T
        last = walls[-1] - walls[-2]
        rate = (times[-1] - times[-2]) / max(last, 1)
        known = (received >= walls[0]) & (received <= walls[-1] + last)
        # Differences to the newest sample are small; whole times lose digits as float64.
        between = np.interp(received - walls[-1], walls - walls[-1], times - times[-1])
        beyond = np.maximum(received - walls[-1], 0) * rate
        return np.where(known, times[-1] + np.round(between + beyond).astype(np.int64), found)


class SimulatedClock:
    """Reads /clock directly, because an executor does not report times of reception."""

    def __init__(self, node: Node) -> None:
        """Start to search for publishers."""
        self._input = TopicInput(node, TOPIC, (TYPE,), is_optional=True)
        self._samples = ClockSamples()

    def match(self) -> None:
        """Connect to the present publishers."""
        self._input.match()

    def at(self, received: Stamps) -> Stamps:
        """Return the simulated time at which messages were received; see `ClockSamples.at`."""
        taken = self._input.take()
        for payload, when in zip(taken.payloads, taken.received, strict=True):
            if payload[:2] == _ENCAPSULATION and len(payload) >= 4 + _NS.size:
                seconds, nanoseconds = _NS.unpack_from(payload, 4)
                self._samples.see(when, seconds * NANOSECONDS + nanoseconds)
        return self._samples.at(received)
