"""The as-available accuracy of one estimate: errors, their parts, ages and deadlines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import SettingsError, require_one_of
from trajeval_ros.formatting.remarks import Remark, warning
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.availability import (
    HORIZON_S,
    MOTIONS,
    PARTS,
    RATE_HZ,
    STEP_NS,
    TWIST,
    AvailableSamples,
    Messages,
    in_use,
    instants,
    sampled,
)
from trajeval_ros.metrics.reception_clock import ClockRule, ReceptionClock, judged_receptions
from trajeval_ros.metrics.statistics import Statistics, statistics_of

NONE = "none"
RECEIVED = ("auto", "publish", "log")


@dataclass(frozen=True)
class AvailabilityRule:
    """What to compute.

    Attributes:
        motion: Prediction of a pose: `hold`, `constant` (the twist between the newest two poses)
            or `twist` (that of the message); `none` to compute nothing.
        deadline_s: Largest age of a pose that is in time, seconds.
        received: Which times of a bag are receptions; `auto`: publish times if they differ.
        receive_clock: Correction of the receptions, as `ClockRule.parse` reads it.
    """

    motion: str = NONE
    deadline_s: float = 0.1
    received: str = "auto"
    receive_clock: str = "0"

    def __post_init__(self) -> None:
        """Refuse unknown values."""
        require_one_of(self.motion, (NONE, *MOTIONS), "prediction of --as-available")
        require_one_of(self.received, RECEIVED, "time of reception")
        ClockRule.parse(self.receive_clock)
        if not self.deadline_s > 0.0:
            raise SettingsError(f"the deadline must be positive, not {self.deadline_s:g} s")

    @property
    def is_asked_for(self) -> bool:
        """Whether something is computed."""
        return self.motion != NONE


@dataclass(frozen=True)
class Spans:
    """Spans of time.

    Attributes:
        count: Their number.
        total_s: Their duration together, seconds.
        longest_s: Duration of the longest, seconds.
    """

    count: int
    total_s: float
    longest_s: float

    @classmethod
    def of(cls, seconds: Floats) -> Spans:
        """Return the spans of durations (N,)."""
        return cls(len(seconds), float(seconds.sum()), float(seconds.max(initial=0.0)))


@dataclass(frozen=True)
class Part:
    """A part of the error.

    Attributes:
        rmse_m: Its rmse, metres.
        share: The share of the squared error: sum of e . part by sum of e . e; shares add up to 1.
        rmse_deg: The same of the rotation; None without orientations.
        share_deg: The same of the rotation; None without orientations.
    """

    rmse_m: float
    share: float
    rmse_deg: float | None
    share_deg: float | None


@dataclass(frozen=True)
class Availability:
    """The numbers of an estimate; all but the first ones are None if they are withheld.

    Attributes:
        motion: Prediction of a pose.
        rate_hz: Rate of the instants.
        horizon_s: Longest prediction.
        deadline_s: Largest age in time.
        received: What the times of reception are: see `Receptions.by`; empty if unknown.
        clock: The comparison of clocks; None without receptions.
        recording_s: Median and maximum of log minus publish time; None if a bag lacks one.
        why_withheld: Why there are no numbers; empty if there are.
        samples: Number of instants.
        without_groundtruth: Number of instants that lack groundtruth.
        time_to_first_pose_s: Time from the groundtruth's start to the first reception.
        late_messages: Number of messages that arrived after newer ones.
        position_m: As-available position error.
        rotation_deg: As-available rotation error; None without orientations.
        age_error_m: Position error without its estimator part.
        age_error_deg: Rotation error without its estimator part.
        age_s: Ages of the poses in use.
        latency_s: Reception minus timestamp of the messages.
        interval_s: Intervals of the messages.
        available_percent: Percentage of the instants with an age within the deadline.
        missed_deadlines: Spans with ages above it.
        dropouts: Intervals of more than two usual ones.
        parts: The parts of the error, by `PARTS`.
        corrections: `age_s` of the newest correction, as of map to odom; None without.
    """

    motion: str
    deadline_s: float
    received: str
    clock: ReceptionClock | None
    recording_s: tuple[float, float] | None
    why_withheld: str = ""
    rate_hz: int = RATE_HZ
    horizon_s: float = HORIZON_S
    samples: int | None = None
    without_groundtruth: int | None = None
    time_to_first_pose_s: float | None = None
    late_messages: int | None = None
    position_m: Statistics | None = None
    rotation_deg: Statistics | None = None
    age_error_m: Statistics | None = None
    age_error_deg: Statistics | None = None
    age_s: Statistics | None = None
    latency_s: Statistics | None = None
    interval_s: Statistics | None = None
    available_percent: float | None = None
    missed_deadlines: Spans | None = None
    dropouts: Spans | None = None
    parts: dict[str, Part] | None = None
    corrections: dict[str, Statistics | None] | None = None

    @property
    def remarks(self) -> list[Remark]:
        """The warning about the clocks, or about withheld numbers."""
        said = self.why_withheld or (self.clock.sentence if self.clock is not None else "")
        return [warning("reception_clock", f"as available: {said}")] if said else []


@dataclass(frozen=True, eq=False)
class AsAvailable:
    """The as-available accuracy of one estimate.

    Attributes:
        numbers: Its numbers.
        samples: The errors at all instants; None if the numbers are withheld.
        messages: The messages that were in use, aligned; None if the numbers are withheld.
    """

    numbers: Availability
    samples: AvailableSamples | None = None
    messages: Messages | None = None


def as_available(
    groundtruth: Trajectory,
    estimate: Trajectory,
    similarity: Similarity,
    rule: AvailabilityRule,
    max_gap_s: float,
    offset_ns: int = 0,
) -> AsAvailable:
    """Return the as-available accuracy of an estimate.

    Args:
        groundtruth: States in order of time.
        estimate: Poses in the estimate's frame, with receptions, in any order.
        similarity: The alignment of the evaluation, from all pairs at their timestamps.
        rule: What to compute.
        max_gap_s: Longest gap of the groundtruth to interpolate across, seconds.
        offset_ns: Offset of the estimate's timestamps, nanoseconds; not of the receptions.
    """
    receptions = estimate.reading.receptions
    if receptions is None or not len(receptions):
        said = "no times of reception; evaluate a bag, or name a column received"
        return AsAvailable(Availability(rule.motion, rule.deadline_s, "", None, None, said))
    own_clock = ClockRule.parse(rule.receive_clock)
    times, clock = judged_receptions(estimate.stamps + offset_ns, receptions.times, own_clock)
    about = (rule.motion, rule.deadline_s, receptions.by, clock, receptions.recording_s)
    said = "" if clock.is_usable else clock.sentence
    if rule.motion == TWIST and (receptions.body_rates is None or estimate.velocities is None):
        said = "the messages have no twist; use --as-available constant"
    if said:
        return AsAvailable(Availability(*about, said))
    messages = Messages.of(similarity.trajectory(estimate), times, rule.motion, offset_ns)
    stamps = instants(int(groundtruth.stamps[0]), int(groundtruth.stamps[-1]))
    have = in_use(messages, stamps) >= 0
    samples = sampled(groundtruth, messages, stamps[have], max_gap_s)
    if not len(samples.stamps):
        said = "no instant has both a received pose and groundtruth; check the clocks"
        return AsAvailable(Availability(*about, said))
    before, lacking = int((~have).sum()), int(have.sum()) - len(samples.stamps)
    return AsAvailable(_numbers(about, samples, messages, before, lacking), samples, messages)


def _numbers(
    about: tuple[str, float, str, ReceptionClock, tuple[float, float] | None],
    samples: AvailableSamples,
    messages: Messages,
    before: int,
    lacking: int,
) -> Availability:
    age_s = samples.age / NANOSECONDS
    missed = age_s > about[1]
    distinct = np.diff(messages.stamps, prepend=messages.stamps[:1] - 1) > 0
    stamps, received = messages.stamps[distinct], messages.times[distinct]
    intervals, usual = np.diff(stamps), messages.usual_ns[distinct]
    rotation = samples.rotation
    corrected = messages.corrected
    correction_s = (
        None if corrected is None else (samples.stamps - corrected[samples.rows]) / NANOSECONDS
    )
    return Availability(
        *about,
        samples=len(age_s),
        without_groundtruth=lacking,
        time_to_first_pose_s=before / RATE_HZ,
        late_messages=messages.late,
        position_m=_lengths(samples.position),
        rotation_deg=None if rotation is None else _lengths(np.degrees(rotation)),
        age_error_m=_lengths(samples.position[1:]),
        age_error_deg=None if rotation is None else _lengths(np.degrees(rotation[1:])),
        age_s=statistics_of(age_s),
        latency_s=statistics_of((received - stamps) / NANOSECONDS),
        interval_s=statistics_of(intervals / NANOSECONDS),
        available_percent=100.0 * float(np.mean(~missed)),
        missed_deadlines=Spans.of(_spans_s(samples.stamps, missed)),
        dropouts=Spans.of(intervals[intervals > 2 * usual[:-1]] / NANOSECONDS),
        parts=_parts(samples.position, rotation),
        corrections=None if correction_s is None else {"age_s": statistics_of(correction_s)},
    )


def _lengths(parts: Floats) -> Statistics | None:
    """Return the statistics of the lengths of sums of parts (K, N, 3)."""
    return statistics_of(np.linalg.norm(parts.sum(axis=0), axis=1))


def _parts(position: Floats, rotation: Floats | None) -> dict[str, Part]:
    """Return rmse and share of the parts (4, N, 3) of the errors."""
    found = [_rmse_and_share(position)]
    found += [] if rotation is None else [_rmse_and_share(np.degrees(rotation))]
    return {
        name: Part(*position, *(turned[0] if turned else (None, None)))
        for name, position, *turned in zip(PARTS, *found, strict=True)
    }


def _rmse_and_share(parts: Floats) -> list[tuple[float, float]]:
    error = parts.sum(axis=0)
    squared = float((error**2).sum())
    return [
        (
            float(np.sqrt((part**2).sum(axis=1).mean())),
            float((part * error).sum()) / squared if squared else 0.0,
        )
        for part in parts
    ]


def _spans_s(stamps: Stamps, chosen: Booleans) -> Floats:
    """Return the durations of the spans of chosen instants, seconds."""
    rows = np.flatnonzero(chosen)
    if not len(rows):
        return np.zeros(0)
    begins = np.flatnonzero(np.diff(stamps[rows], prepend=stamps[rows[0]] - 2 * STEP_NS) > STEP_NS)
    counts: Floats = np.diff(begins, append=len(rows)) / RATE_HZ
    return counts
