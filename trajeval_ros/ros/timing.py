"""Times of arrival: simulated time, delays, and latency."""

from __future__ import annotations

import bisect
import struct
from collections import deque
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.stream_health import UNKNOWN
from trajeval_ros.ros.subscriptions import TopicInput

if TYPE_CHECKING:
    from rclpy.node import Node


_LATENCIES = 2000  # in the percentile
_WAITING = 10_000  # largest number of estimates whose errors are not published yet


_EVERY_NS = 50_000_000  # time of arrival between two stored messages
_KEPT = 300  # stored messages per stream, at least 15 s
# All streams have the same span, so that their offsets are comparable in a replay at any rate.
_OFFSET_NS = 5 * NANOSECONDS
_COMPARED, _FEWEST = 20, 3  # newest messages of which clocks are compared, about one second
_CONTINUOUS_S = 1.0  # timestamps that differ by more from their times of arrival are a step


class Arrivals:
    """The timestamps of a stream and their times of arrival, at most 20 per second."""

    def __init__(self) -> None:
        self._samples: deque[tuple[int, int]] = deque(maxlen=_KEPT)

    def see(self, stamps: Stamps, arrived_ns: Stamps) -> None:
        """Add timestamps (N,) of messages and their times of arrival (N,), nanoseconds.

        A time of arrival may be `UNKNOWN`.
        """
        known = arrived_ns != UNKNOWN
        stamps, arrived_ns = stamps[known], arrived_ns[known]
        if not len(stamps):
            return
        last = self._samples[-1][0] if self._samples else UNKNOWN
        if arrived_ns[0] < last:
            self._samples.clear()  # simulated time started again
        steps = np.diff(arrived_ns // _EVERY_NS, prepend=last // _EVERY_NS)
        new = steps != 0
        self._samples.extend(zip(arrived_ns[new].tolist(), stamps[new].tolist(), strict=True))

    @property
    def columns(self) -> tuple[Stamps, Stamps]:
        """Times of arrival and timestamps of stored messages, (N,) each, nanoseconds."""
        arrived, stamps = np.array(self._samples, dtype=np.int64).reshape(-1, 2).T
        return arrived, stamps

    @property
    def offset_s(self) -> float | None:
        """Median of arrival minus timestamp, s: transport, processing, and clock offset."""
        arrived, stamps = self.columns
        if not len(arrived):
            return None
        newest = arrived >= arrived[-1] - _OFFSET_NS
        return float(np.median((arrived - stamps)[newest])) / NANOSECONDS

    def ahead(self, arrived: Stamps, stamps: Stamps) -> tuple[Stamps, NDArray[np.bool_]]:
        """Return how far timestamps are ahead of the messages that arrive at the same time.

        Of another stream are the times of arrival (N,), in order, and the timestamps (N,), ns.
        Returned are differences (K,), ns, and which messages are compared (N,): those that arrive
        between two messages without a step of the clock between these.
        """
        times, known = self.columns
        after = times.searchsorted(arrived, side="left")
        inside = (after > 0) & (after < len(times))
        steady = np.abs(self._steps_s(times, known)) <= _CONTINUOUS_S
        inside[inside] = steady[after[inside] - 1]
        end, begin = after[inside], after[inside] - 1
        share = (arrived[inside] - times[begin]) / (times[end] - times[begin])
        between = known[begin] + np.round(share * (known[end] - known[begin])).astype(np.int64)
        return stamps[inside] - between, inside

    @staticmethod
    def _steps_s(arrived: Stamps, stamps: Stamps) -> Floats:
        """Return the steps of timestamps (N - 1,) beyond those of the times of arrival, s."""
        passed, stepped = np.diff(arrived) / NANOSECONDS, np.diff(stamps) / NANOSECONDS
        forward = stepped > 0.0
        rate = float(np.median(stepped[forward] / passed[forward])) if forward.any() else 1.0
        steps: Floats = stepped - rate * passed
        return steps


class ComparedClocks:
    """Compares the timestamps of an estimate and of the groundtruth that arrive together."""

    def __init__(self) -> None:
        self._leads: deque[float] = deque(maxlen=_COMPARED)  # seconds
        self._at_start_s: float | None = None
        self._newest = 0  # newest time of arrival that was compared

    @property
    def apart_s(self) -> float | None:
        """The estimate's clock minus the groundtruth's, seconds; None as long as it is unknown.

        Clocks that agreed at the start still agree: a delay has grown, or one of them stepped.
        """
        if self._at_start_s is None:
            return None
        return min(float(np.median(self._leads)), self._at_start_s, key=abs)

    def update(self, groundtruth: Arrivals, estimate: Arrivals) -> None:
        """Compare the messages since the last call."""
        arrived, stamps = estimate.columns
        if not len(arrived) or arrived[-1] == self._newest:
            return
        if arrived[-1] < self._newest:  # simulated time started again
            self._newest = 0
        rows = np.flatnonzero(arrived > self._newest)
        leads_ns, compared = groundtruth.ahead(arrived[rows], stamps[rows])
        if not compared.any():
            return
        self._newest = int(arrived[rows[compared][-1]])
        self._leads.extend((leads_ns / NANOSECONDS).tolist())
        if self._at_start_s is None and len(self._leads) >= _FEWEST:
            self._at_start_s = float(np.median(self._leads))


class Latency:
    """The time from an estimate's arrival to the publication of its error."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[int, int]] = deque(maxlen=_WAITING)
        self._seconds: deque[float] = deque(maxlen=_LATENCIES)

    def arrive(self, stamps: NDArray[np.int64], received_ns: NDArray[np.int64]) -> None:
        """Store the times of arrival of estimates."""
        self._waiting.extend(zip(stamps.tolist(), received_ns.tolist(), strict=True))

    def publish(self, stamp: int, now_ns: int) -> float | None:
        """Store that errors up to a timestamp are published; the latency is of the newest one.

        Returned is that of the first of them, seconds; None if none arrived since the last call.
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


TOPIC, TYPE = "/clock", "rosgraph_msgs/msg/Clock"
_KEPT_NS = 10 * NANOSECONDS  # samples that are kept: a busy node reads its messages seconds late
_LAST_NS = int(np.iinfo(np.int64).max)
_USUAL_SAMPLES = 20  # newest intervals, whose longest one is extrapolated
_NS = struct.Struct("<iI")
_ENCAPSULATION = b"\0\1"  # little-endian CDR, as every node of ROS writes it


class ClockSamples:
    """Samples of simulated time and their receive times, for interpolation.

    The clock of a ROS node does not interpolate: with /clock at 10 Hz it has steps of 0.1 s.
    """

    def __init__(self) -> None:
        self._walls: list[int] = []  # receive times
        self._times: list[int] = []

    def see(self, received: int, time_ns: int) -> None:
        """Add a simulated time and its receive time, nanoseconds."""
        if self._walls and received < self._walls[-1]:
            self._walls, self._times = [], []  # the machine's time steps back
        self._walls.append(received)
        self._times.append(time_ns)
        half = len(self._walls) // 2
        if self._walls[half] < received - _KEPT_NS:
            del self._walls[:half], self._times[:half]

    def at(self, received: Stamps) -> Stamps:
        """Return the simulated time at which messages were received, (N,), nanoseconds.

        After the newest sample, and after the last one before a step back of simulated time, time
        is extrapolated by at most one interval of samples. Later times, and times before the
        oldest sample, are `UNKNOWN`.
        """
        # At 1 kHz, thousands of samples are kept; messages are usually after most of them.
        first = bisect.bisect_right(self._walls, int(received.min(initial=_LAST_NS))) - 1
        # Steps back of time are among the newest intervals, too.
        first = max(min(first, len(self._walls) - 2 * _USUAL_SAMPLES), 0)
        walls, times = np.array([self._walls[first:], self._times[first:]], dtype=np.int64)
        intervals, steps = np.diff(walls), np.diff(times)
        forward = np.append(steps >= 0, False)  # whether time goes on to another sample
        usual = np.flatnonzero(forward)[-_USUAL_SAMPLES:]
        if not len(usual):
            return np.full(len(received), UNKNOWN)
        # Samples may arrive together: the newest interval alone is not the usual one.
        lasts = np.where(forward, np.append(intervals, 0), intervals[usual].max())
        most = np.where(forward, np.append(steps, 0), steps[usual].max())
        rate = steps[usual].sum() / max(int(intervals[usual].sum()), 1)
        rates = np.where(forward, most / np.maximum(lasts, 1), rate)
        row = np.searchsorted(walls, received, side="right") - 1
        passed = received - walls[row]
        # Differences to a sample are small; whole times lose digits as float64.
        later = np.minimum(np.round(passed * rates[row]).astype(np.int64), most[row])
        return np.where((row >= 0) & (passed <= lasts[row]), times[row] + later, UNKNOWN)


class SimulatedClock:
    """Reads /clock directly, because an executor does not report receive times."""

    def __init__(self, node: Node) -> None:
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
