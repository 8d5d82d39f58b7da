"""The as-available accuracy of one estimate: errors, their parts, ages and deadlines."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trajeval_ros.exceptions import SettingsError, require_one_of
from trajeval_ros.formatting.remarks import Remark, warning
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps, runs_of
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.association_rule import AssociationRule
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
from trajeval_ros.metrics.receive_clock import (
    ReceiveClock,
    clock_correction,
    judged_receive_times,
)
from trajeval_ros.metrics.statistics import Statistics, statistics_of

NONE = "none"
RECEIVED = ("auto", "publish", "log")


@dataclass(frozen=True)
class AvailabilityRule:
    """What to compute."""

    # Prediction of a pose: `hold`, `constant` (the twist between the newest two poses) or `twist`
    # (that of the message); `none` to compute nothing.
    motion: str = NONE
    deadline_s: float = 0.1  # largest age of a pose that is in time, seconds
    received: str = "auto"  # which times of a bag are receive_times
    receive_clock: str = "0"  # correction of the receive_times, as `clock_correction` reads it

    def __post_init__(self) -> None:
        """Refuse unknown values."""
        require_one_of(self.motion, (NONE, *MOTIONS), "prediction of --as-available")
        require_one_of(self.received, RECEIVED, "receive time")
        clock_correction(self.receive_clock)
        if not self.deadline_s > 0.0:
            raise SettingsError(f"the deadline must be positive, not {self.deadline_s:g} s")

    @property
    def is_asked_for(self) -> bool:
        """Whether something is computed."""
        return self.motion != NONE


@dataclass(frozen=True)
class Spans:
    """Spans of time."""

    count: int
    total_s: float
    longest_s: float

    @classmethod
    def of(cls, seconds: Floats) -> Spans:
        """Return the spans of durations (N,), seconds."""
        return cls(len(seconds), float(seconds.sum()), float(seconds.max(initial=0.0)))


@dataclass(frozen=True)
class Part:
    """A part of the error; the rotation's values are None without orientations."""

    rmse_m: float
    share: float  # sum of e . part by sum of e . e; the shares of all parts add up to 1
    rmse_deg: float | None = None
    share_deg: float | None = None


@dataclass(frozen=True)
class Availability:
    """The numbers of an estimate; those after `horizon_s` are None if they are withheld."""

    motion: str  # prediction of a pose
    deadline_s: float  # largest age in time
    received: str = ""  # what the receive times are: see `ReceiveTimes.by`; empty if unknown
    clock: ReceiveClock | None = None  # the comparison of clocks; None without receive_times
    recording_s: tuple[float, float] | None = None  # see `ReceiveTimes.recording_s`
    why_withheld: str = ""  # why there are no numbers; empty if there are
    rate_hz: int = RATE_HZ  # rate of the instants
    horizon_s: float = HORIZON_S  # longest prediction
    samples: int | None = None  # number of instants
    without_groundtruth: int | None = None  # number of instants that lack groundtruth
    time_to_first_pose_s: float | None = None  # from the groundtruth's start to a receive time
    late_messages: int | None = None  # number of messages that arrived after newer ones
    position_m: Statistics | None = None  # as-available position error
    rotation_deg: Statistics | None = None  # and rotation error; None without orientations
    age_error_m: Statistics | None = None  # position error without its estimator part
    age_error_deg: Statistics | None = None  # rotation error without its estimator part
    age_s: Statistics | None = None  # ages of the poses in use
    latency_s: Statistics | None = None  # receive time minus timestamp of the messages
    interval_s: Statistics | None = None  # intervals of the messages
    available_percent: float | None = None  # percentage of instants with an age in time
    missed_deadlines: Spans | None = None  # spans with ages above the deadline
    dropouts: Spans | None = None  # intervals of more than two usual ones, and a final silence
    parts: dict[str, Part] | None = None  # the parts of the error, by `PARTS`
    # `age_s` of the newest correction, as of map to odom; None without corrections.
    corrections: dict[str, Statistics | None] | None = None

    @property
    def remarks(self) -> list[Remark]:
        """The warning about the clocks, or about withheld numbers."""
        sentence = self.why_withheld or (self.clock.sentence if self.clock is not None else "")
        return [warning("receive_clock", f"as available: {sentence}")] if sentence else []


@dataclass(frozen=True, eq=False)
class AsAvailable:
    """The as-available accuracy of one estimate; only its numbers if these are withheld."""

    numbers: Availability
    samples: AvailableSamples | None = None  # the errors at all instants


def as_available(
    groundtruth: Trajectory,
    estimate: Trajectory,
    similarity: Similarity,
    rule: AvailabilityRule,
    association: AssociationRule,
) -> AsAvailable:
    """Return the as-available accuracy of an estimate.

    Args:
        groundtruth: States in order of time.
        estimate: Poses in the estimate's frame, with receive_times, in any order.
        similarity: The alignment of the evaluation, from all pairs at their timestamps.
        rule: What to compute.
        association: Its gaps of the groundtruth are not interpolated, and its offset is that of
            the estimate's timestamps, not of the receive times.
    """
    offset_ns = round(association.time_offset_s * NANOSECONDS)
    known, messages = usable_messages(estimate, similarity, rule, offset_ns)
    if messages is None:
        return AsAvailable(known)
    stamps = instants(int(groundtruth.stamps[0]), int(groundtruth.stamps[-1]))
    have = in_use(messages, stamps) >= 0
    samples = sampled(groundtruth, messages, stamps[have], association)
    before = int((~have).sum())
    if not len(samples.stamps):
        reason = "no instant has both a received pose and groundtruth; check the clocks"
        return AsAvailable(replace(known, why_withheld=reason))
    lacking = len(stamps) - before - len(samples.stamps)
    known = replace(known, without_groundtruth=lacking, time_to_first_pose_s=before / RATE_HZ)
    return AsAvailable(_with_numbers(known, samples), samples)


def usable_messages(
    estimate: Trajectory,
    similarity: Similarity,
    rule: AvailabilityRule,
    offset_ns: int = 0,
    *,
    has_moved: bool = False,
) -> tuple[Availability, Messages | None]:
    """Return what is known without groundtruth, and the aligned messages; None if withheld.

    Many drivers leave the twist zero. `has_moved`: whether an earlier message had a velocity.
    """
    known = Availability(rule.motion, rule.deadline_s)
    receive_times = estimate.reading.receive_times
    if receive_times is None or not len(receive_times):
        reason = "no receive times; evaluate a bag, or name a column received"
        return replace(known, why_withheld=reason), None
    stamps, velocities, rates = estimate.stamps, estimate.velocities, receive_times.body_rates
    times, clock = judged_receive_times(
        stamps + offset_ns, receive_times.times, rule.receive_clock
    )
    known = replace(
        known, received=receive_times.by, clock=clock, recording_s=receive_times.recording_s
    )
    has_twist = rates is not None and velocities is not None and np.isfinite(rates).all()
    if not clock.is_usable:
        return replace(known, why_withheld=clock.sentence), None
    if rule.motion == TWIST and not (has_twist and (has_moved or np.any(velocities))):
        reason = "the messages have no twist; use --as-available constant"
        return replace(known, why_withheld=reason), None
    return known, Messages.of(similarity.trajectory(estimate), times, rule.motion, offset_ns)


def _with_numbers(known: Availability, samples: AvailableSamples) -> Availability:
    messages, age_s = samples.messages, samples.age / NANOSECONDS
    missed = age_s > known.deadline_s
    distinct = np.diff(messages.stamps, prepend=messages.stamps[:1] - 1) > 0
    stamps, usual = messages.stamps[distinct], messages.usual_ns[distinct]
    intervals = np.diff(stamps)
    # After the last message, the groundtruth goes on without an estimate.
    silences = np.append(intervals, samples.stamps[-1] - messages.times[distinct][-1])
    rotation = None if samples.rotation is None else np.degrees(samples.rotation)
    errors = [_rmse_and_share(item) for item in (samples.position, rotation) if item is not None]
    since = None
    if messages.corrected is not None:
        since = samples.stamps - messages.corrected[samples.rows]
    return replace(
        known,
        samples=len(age_s),
        late_messages=messages.late,
        position_m=statistics_of(samples.position_m),
        rotation_deg=None if rotation is None else _lengths(rotation),
        age_error_m=statistics_of(samples.moved_m),
        age_error_deg=None if rotation is None else _lengths(rotation[1:]),
        age_s=statistics_of(age_s),
        latency_s=statistics_of((messages.times[distinct] - stamps) / NANOSECONDS),
        interval_s=statistics_of(intervals / NANOSECONDS),
        available_percent=100.0 * float(np.mean(~missed)),
        missed_deadlines=Spans.of(_spans_s(samples.stamps, missed)),
        dropouts=Spans.of(silences[silences > 2 * usual] / NANOSECONDS),
        parts={name: Part(*sum(of, ())) for name, *of in zip(PARTS, *errors, strict=True)},
        corrections=None if since is None else {"age_s": statistics_of(since / NANOSECONDS)},
    )


def _lengths(parts: Floats) -> Statistics | None:
    """Return the statistics of the lengths of sums of parts (K, N, 3)."""
    return statistics_of(np.linalg.norm(parts.sum(axis=0), axis=1))


def _rmse_and_share(parts: Floats) -> list[tuple[float, ...]]:
    """Return rmse and share of parts (4, N, 3) of the errors."""
    error = parts.sum(axis=0)
    rmses = np.sqrt((parts**2).sum(axis=2).mean(axis=1))
    shares = (parts * error).sum(axis=(1, 2)) / ((error**2).sum() or 1.0)
    return list(zip(rmses.tolist(), shares.tolist(), strict=True))


def _spans_s(stamps: Stamps, chosen: Booleans) -> Floats:
    """Return the durations of the spans of chosen instants, seconds."""
    places = (stamps - stamps[0]) // STEP_NS
    flags = np.zeros(places[-1] + 1, dtype=bool)
    flags[places] = chosen
    return np.diff(runs_of(flags))[:, 0] / RATE_HZ
