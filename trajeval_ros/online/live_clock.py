"""The clocks' offset while a run goes on: estimated now and then, from a bounded past."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.calibrate import calibrate
from trajeval_ros.exceptions import TrajevalError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.online.state_buffer import StateBuffer
from trajeval_ros.online.state_rows import POSITION, QUATERNION

# Shorter, and rotation and lever arm can't be fitted beside the offset.
FIRST_S = 35.0
_PAST_S = 600.0
_PAUSE_S = 5.0
_PAUSE_SHARE = 0.1  # of the time so far: so estimates become rarer, and cost a constant share
_ESTIMATE_STEP_NS = 100_000_000
_GROUNDTRUTH_STEP_NS = 20_000_000
_INCREMENTS = 1500


@dataclass(frozen=True)
class ClockReport:
    """What is known of the clocks' offset by now.

    Attributes:
        span_s: Time from the first estimated state to the newest one.
        offset_s: To be added to the estimate's stamps; None while nothing is known.
        sigma_s: Its standard deviation.
        half_width_95_s: Of its 95 % interval.
        status: `waiting`, or that of `calibration.verdict.Parameter`.
        reason: Why.
    """

    span_s: float = 0.0
    offset_s: float | None = None
    sigma_s: float | None = None
    half_width_95_s: float | None = None
    status: str = "waiting"
    reason: str = f"needs {FIRST_S:g} s of both"

    @property
    def is_significant(self) -> bool:
        """Whether the clocks differ."""
        return self.status == "significant"


class OnlineClock:
    """Estimates the offset of an estimate's stamps from the newest ten minutes.

    Ten estimated and fifty groundtruth states a second are kept, 36 000 states of 88 bytes at the
    most, and each estimate costs the same in the end.

    Attributes:
        report: What is known by now.
    """

    def __init__(self, gauge: Gauge) -> None:
        """Begin empty.

        Args:
            gauge: See `calibrate`.
        """
        self.report = ClockReport()
        self._gauge = gauge
        self._truth, self._estimate = StateBuffer(), StateBuffer()
        self._first: int | None = None
        self._next_s = FIRST_S

    def add_groundtruth(self, stamps: Stamps, rows: Floats) -> None:
        """Take groundtruth states: stamps (N,) in nanoseconds and rows (N, 10) of `states`."""
        _add(self._truth, stamps, rows, _GROUNDTRUTH_STEP_NS)

    def add_estimate(self, stamps: Stamps, rows: Floats) -> None:
        """Take estimated states: stamps (N,) in nanoseconds and rows (N, 10) of `states`."""
        _add(self._estimate, stamps, rows, _ESTIMATE_STEP_NS)
        if self._first is None and len(self._estimate):
            self._first = int(self._estimate.held[0][0])

    @property
    def span_s(self) -> float:
        """Time from the first estimated state to the newest one, seconds."""
        return 0.0 if self._first is None else (self._estimate.newest - self._first) / NANOSECONDS

    def update(self, *, at_end: bool = False) -> bool:
        """Estimate anew if it is time to; returns whether it was.

        Args:
            at_end: Nothing more will come.
        """
        span_s = self.span_s
        due = span_s >= self._next_s or (at_end and span_s > self.report.span_s)
        if not due or not len(self._truth):
            return False
        self._next_s = span_s + max(_PAUSE_S, _PAUSE_SHARE * span_s)
        self.report = self._estimated(span_s)
        return True

    def _estimated(self, span_s: float) -> ClockReport:
        try:
            # A wild estimate may overflow, which is no reason to end the run.
            with np.errstate(over="ignore", invalid="ignore"):
                found = calibrate(
                    _trajectory(self._truth),
                    _trajectory(self._estimate),
                    self._gauge,
                    most_increments=_INCREMENTS,
                ).offset
        except TrajevalError as error:
            return ClockReport(span_s, status="unobservable", reason=str(error))
        except np.linalg.LinAlgError as error:
            reason = f"can't be estimated: {error}"
            return ClockReport(span_s, status="unobservable", reason=reason)
        if found.value is None or found.sigma is None or found.half_width_95 is None:
            return ClockReport(span_s, status=found.status, reason=found.reason)
        return ClockReport(
            span_s,
            float(found.value[0]),
            float(found.sigma[0]),
            float(found.half_width_95[0]),
            found.status,
            found.reason,
        )


def _add(stream: StateBuffer, stamps: Stamps, rows: Floats, step_ns: int) -> None:
    """Keep the first state of each step of time that is newer than all held; forget old ones."""
    new = stamps > stream.newest
    if len(stream):
        new &= stamps // step_ns > stream.newest // step_ns
    new &= np.isfinite(rows[:, POSITION]).all(axis=1) & ~np.isinf(rows[:, QUATERNION.start])
    stamps, rows = stamps[new], rows[new]
    kept = np.unique(stamps // step_ns, return_index=True)[1]
    if not len(kept):
        return
    # The first that arrived of each step; steps are in order.
    stream.append(stamps[kept], rows[kept])
    oldest = stream.newest - round(_PAST_S * NANOSECONDS)
    stream.drop(int(stream.held[0].searchsorted(oldest)))


def _trajectory(stream: StateBuffer) -> Trajectory:
    stamps, rows = stream.held
    turns = rows[:, QUATERNION]
    known = not np.isnan(turns).any() and bool(turns[:, :3].any())
    return Trajectory(
        stamps.copy(),
        rows[:, POSITION].copy(),
        lie.normalized(turns) if known else None,
    )
