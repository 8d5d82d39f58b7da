"""Delay of messages at arrival, and time from arrival to the publication of their errors."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.trajectory import NANOSECONDS

_BATCHES = 200  # batches of messages in the median
UNKNOWN = int(np.iinfo(np.int64).min)  # an unknown time of arrival
_WAITING = 10_000  # largest number of estimates whose errors are not published yet


class Arrivals:
    """The offset between the timestamps of a stream and the times of arrival."""

    def __init__(self) -> None:
        """Create it empty."""
        self._offsets: deque[float] = deque(maxlen=_BATCHES)

    def see(self, stamps: NDArray[np.int64], arrived_ns: NDArray[np.int64]) -> None:
        """Add timestamps (N,) of messages and their times of arrival (N,), nanoseconds.

        A time of arrival may be `UNKNOWN`.
        """
        middle = len(stamps) // 2  # one message represents the batch
        if len(stamps) and arrived_ns[middle] != UNKNOWN:
            self._offsets.append(int(arrived_ns[middle] - stamps[middle]) / NANOSECONDS)

    @property
    def offset_s(self) -> float | None:
        """Median of arrival minus timestamp, s: transport, processing, and clock offset."""
        return float(np.median(self._offsets)) if self._offsets else None


class Latency:
    """The time from an estimate's arrival to the publication of its error."""

    def __init__(self) -> None:
        """Create it empty."""
        self._waiting: deque[tuple[int, int]] = deque(maxlen=_WAITING)
        self._seconds: deque[float] = deque(maxlen=10 * _BATCHES)

    def arrive(self, stamps: NDArray[np.int64], received_ns: NDArray[np.int64]) -> None:
        """Store the times of arrival of estimates."""
        self._waiting.extend(zip(stamps.tolist(), received_ns.tolist(), strict=True))

    def publish(self, stamp: int, now_ns: int) -> float | None:
        """Store that errors up to a timestamp are published; the latency is of the newest one.

        Returns:
            Latency of the first of them, seconds; None if none arrived since the last call.
        """
        received = []
        while self._waiting and self._waiting[0][0] <= stamp:
            received.append(self._waiting.popleft()[1])
        if not received:
            return None
        self._seconds.append((now_ns - received[-1]) / NANOSECONDS)
        return (now_ns - min(received)) / NANOSECONDS

    @property
    def p95_s(self) -> float | None:
        """The 95th percentile of the latest latencies, seconds."""
        return float(np.percentile(list(self._seconds), 95)) if self._seconds else None
