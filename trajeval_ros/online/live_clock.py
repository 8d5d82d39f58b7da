"""Live estimation of the clock offset, at intervals, from the newest ten minutes."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.calibrate import Calibration, calibrate
from trajeval_ros.exceptions import TrajevalError, describe_defect
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.online.state_buffer import Tail

# Rotation and lever arm cannot be estimated together with the offset from less.
FIRST_S = 35.0
_PAST_S = 600.0
_PAUSE_S = 5.0
_PAUSE_SHARE = 0.1  # pause relative to the run's duration, so that the mean load is constant
_ESTIMATE_STEP_NS = 100_000_000
_GROUNDTRUTH_STEP_NS = 20_000_000
_INCREMENTS = 1500


@dataclass(frozen=True)
class ClockReport:
    """The present estimate of the clock offset."""

    span_s: float = 0.0  # time from the first estimated state to the newest one, seconds
    # Offset to add to the estimate's timestamps; None before the first estimate.
    offset_s: float | None = None
    sigma_s: float | None = None  # its standard deviation
    half_width_95_s: float | None = None  # half width of its 95 % interval
    status: str = "waiting"  # `waiting`, or a status of `calibration.significance.Parameter`
    reason: str = f"needs {FIRST_S:g} s of both trajectories"  # the reason for the status

    @property
    def is_significant(self) -> bool:
        """Whether the offset is statistically significant."""
        return self.status == "significant"


class OnlineClock:
    """Estimates the offset of an estimate's timestamps from the newest ten minutes.

    It keeps 10 estimated and 50 groundtruth states per second, at most 36 000 states of 64 bytes.
    Therefore the cost of an estimation is bounded.
    """

    def __init__(self, gauge: Gauge, worker: Executor | None = None) -> None:
        self._worker = worker
        self._asked: Future[tuple[ClockReport, Calibration | None]] | None = None
        self.report = ClockReport()  # the present estimate
        self.calibration: Calibration | None = None  # with the newest offset
        self._gauge = gauge
        self._groundtruth, self._estimate = Tail(), Tail()
        self._first: int | None = None
        self._next_s = FIRST_S

    def add_groundtruth(self, block: Trajectory) -> None:
        """Take groundtruth states."""
        _add(self._groundtruth, block, _GROUNDTRUTH_STEP_NS)

    def add_estimate(self, block: Trajectory) -> None:
        """Take estimated states."""
        _add(self._estimate, block, _ESTIMATE_STEP_NS)
        if self._first is None and len(self._estimate):
            self._first = int(self._estimate.stamps[0])

    @property
    def span_s(self) -> float:
        """Time from the first estimated state to the newest one, seconds."""
        return 0.0 if self._first is None else (self._estimate.newest - self._first) / NANOSECONDS

    def update(self, *, at_end: bool = False, waits: bool = False) -> bool:
        """Estimate the offset if it is due; returns whether there is a new report."""
        waits |= at_end
        is_new = self._asked is not None
        if self._asked is not None:
            if not waits and not self._asked.done():
                return False
            self._take(*self._asked.result())
            self._asked = None
            if not waits:
                return True
        span_s = self.span_s
        due = span_s >= self._next_s or (at_end and span_s > self.report.span_s)
        if not due or not len(self._groundtruth):
            return is_new
        self._next_s = span_s + max(_PAUSE_S, _PAUSE_SHARE * span_s)
        inputs = span_s, _trajectory(self._groundtruth), _trajectory(self._estimate), self._gauge
        if self._worker is not None and not waits:
            self._asked = self._worker.submit(_estimated, *inputs)
            return False
        self._take(*_estimated(*inputs))
        return True

    def _take(self, report: ClockReport, calibration: Calibration | None) -> None:
        self.report, self.calibration = report, calibration or self.calibration


def _estimated(
    span_s: float, groundtruth: Trajectory, estimate: Trajectory, gauge: Gauge
) -> tuple[ClockReport, Calibration | None]:
    """Return the clock report from the newest states, and the complete calibration."""
    try:
        # A diverged estimate can overflow; the run must go on.
        with np.errstate(over="ignore", invalid="ignore"):
            calibration = calibrate(groundtruth, estimate, gauge, most_increments=_INCREMENTS)
    except TrajevalError as error:
        return ClockReport(span_s, status="unobservable", reason=str(error)), None
    except Exception as error:  # such as LinAlgError; it must not end the node
        reason = f"the estimation has failed ({describe_defect(error)})"
        return ClockReport(span_s, status="unobservable", reason=reason), None
    offset = calibration.offset
    if offset.value is None or offset.sigma is None or offset.half_width_95 is None:
        return ClockReport(span_s, status=offset.status, reason=offset.reason), calibration
    report = ClockReport(
        span_s,
        float(offset.value[0]),
        float(offset.sigma[0]),
        float(offset.half_width_95[0]),
        offset.status,
        offset.reason,
    )
    return report, calibration


def _add(stream: Tail, block: Trajectory, step_ns: int) -> None:
    """Append the first state of every time step that is newer than all stored; drop old ones."""
    new = block.stamps > stream.newest
    if len(stream):
        new &= block.stamps // step_ns > stream.newest // step_ns
    rows = np.flatnonzero(new)
    kept = rows[np.unique(block.stamps[rows] // step_ns, return_index=True)[1]]
    if not len(kept):
        return
    # The first state of every step in order of arrival.
    rotations = block.quaternions
    stream.add(
        Trajectory(
            block.stamps[kept],
            block.positions[kept],
            None if rotations is None else rotations[kept],
        )
    )
    oldest = stream.newest - round(_PAST_S * NANOSECONDS)
    stream.drop_before(int(stream.stamps.searchsorted(oldest)))


def _trajectory(stream: Tail) -> Trajectory:
    """Return copies of the states, with orientations if all states have one."""
    states = stream.trajectory(np.arange(len(stream)))
    if states.quaternions is None or not states.quaternions[:, :3].any():
        return Trajectory(states.stamps, states.positions)
    return states
