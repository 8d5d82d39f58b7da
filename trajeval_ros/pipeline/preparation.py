"""Preparation of the trajectories before the association."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from trajeval_ros.exceptions import InputError, TrajevalError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import note
from trajeval_ros.geometry.fix_selection import FixRule
from trajeval_ros.geometry.frame_axes import upright
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.geometry.vertical_axis import require_up_axis
from trajeval_ros.metrics import evaluation as metrics
from trajeval_ros.metrics.discontinuities.events import ESTIMATE, GROUNDTRUTH
from trajeval_ros.metrics.discontinuities.handling import (
    DiscontinuityRule,
    is_groundtruth_outlier,
    without_clock_steps,
    without_groundtruth_outliers,
)
from trajeval_ros.metrics.discontinuities.recorded import discontinuities
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.sub_trajectories import Length
from trajeval_ros.pipeline.request import Request

if TYPE_CHECKING:
    from trajeval_ros.metrics.association import Association
    from trajeval_ros.metrics.discontinuities.events import Event
    from trajeval_ros.metrics.evaluation import Evaluation

Change: TypeAlias = Callable[[Trajectory], Trajectory]


@dataclass(frozen=True, eq=False)
class Inputs:
    """Groundtruth and one estimate; for the hints of a live run, only the states in pairs."""

    groundtruth: Trajectory
    estimate: Trajectory
    pairs: Association | None = None  # for the hints of a live run; None before the association
    # All groundtruth states, and the poses in the order of their receive times; None if these are
    # the two sides.
    streams: tuple[Trajectory, Trajectory] | None = None
    events: Sequence[Event] | None = None  # discontinuities of the two sides, if they are known

    @classmethod
    def of(cls, groundtruth: Trajectory, estimate: Trajectory) -> Inputs:
        """Return the two sides, with the poses as received if they were revised afterwards."""
        received = estimate.reading.as_received
        streams = None if received is None else (groundtruth, received)
        return cls(groundtruth, estimate, streams=streams)

    def changed(self, groundtruth: Change, estimate: Change) -> Inputs:
        """Apply a change to each side, in the pairs too."""
        pairs = self.pairs
        if pairs is not None:
            pairs = dataclasses.replace(
                pairs,
                groundtruth=groundtruth(pairs.groundtruth),
                estimate=estimate(pairs.estimate),
            )
        streams = self.streams
        if streams is not None:
            streams = groundtruth(streams[0]), estimate(streams[1])
        sides = groundtruth(self.groundtruth), estimate(self.estimate)
        return Inputs(*sides, pairs, streams, self.events)

    def evaluated(self, protocol: Protocol) -> Evaluation:
        """Associate, unless there are pairs, align and compute the errors."""
        if self.pairs is None:
            return metrics.evaluate(self.groundtruth, self.estimate, protocol)
        return metrics.evaluate_pairs(self.pairs, self.groundtruth, self.estimate, protocol)


def as_given(trajectory: Trajectory) -> Trajectory:
    """Return a trajectory without a change."""
    return trajectory


def with_fixes_placed(
    groundtruth: Trajectory, estimates: Sequence[Trajectory], request: Request
) -> tuple[Trajectory, list[Trajectory], Request]:
    """Return both sides with GNSS fixes in one frame, and the request with its default gauge."""
    level = request.protocol.gauge is Gauge.PLANAR
    with named(groundtruth):
        groundtruth = request.fixes.applied(groundtruth, level=level)
        request = request.for_trajectories(groundtruth, estimates)
    placed = [_in_frame_of(groundtruth, estimate, level=level) for estimate in estimates]
    return groundtruth, placed, request


def _in_frame_of(groundtruth: Trajectory, estimate: Trajectory, *, level: bool) -> Trajectory:
    """Return an estimate of GNSS fixes in the groundtruth's frame, if that has fixes, too."""
    if estimate.reading.fixes is None:
        return estimate
    datum = None if groundtruth.reading.fixes is None else groundtruth.reading.fixes.datum
    with named(estimate):
        return FixRule(datum=datum).applied(estimate, level=level)


def corrected_and_cut(inputs: Inputs, request: Request) -> Inputs:
    """Apply the request's corrections, up axes and time span."""
    corrections, span = request.corrections, request.time_span
    while corrections is not None:
        inputs = inputs.changed(corrections.groundtruth.corrected, corrections.estimate.corrected)
        corrections = corrections.then
    inputs = with_up_axes(inputs, request)
    if span is None:
        return inputs
    groundtruth = inputs.groundtruth
    first_ns = int(groundtruth.stamps.min()) if len(groundtruth) else 0
    with named(groundtruth):
        groundtruth = span.cut(groundtruth, first_ns)
    offset_ns = round(request.protocol.association.time_offset_s * NANOSECONDS)
    streams = inputs.streams
    if streams is not None:
        streams = groundtruth, span.cut(streams[1], first_ns, offset_ns)
    estimate = span.cut(inputs.estimate, first_ns, offset_ns)
    return Inputs(groundtruth, estimate, streams=streams)


def at_discontinuities(inputs: Inputs, rule: DiscontinuityRule, offset_s: float) -> Inputs:
    """Correct clock steps and drop outliers of the groundtruth, if the rule states it.

    `offset_s` is added to the estimate's timestamps. The groundtruth has a note on dropped poses.
    """
    if not rule.changes_inputs:
        return inputs
    offset_ns = round(offset_s * NANOSECONDS)
    groundtruth, estimate, events = inputs.groundtruth, inputs.estimate, inputs.events
    if rule.correct_clock_steps:
        events = events or discontinuities(groundtruth, estimate, offset_ns)
        groundtruth = without_clock_steps(groundtruth, events, GROUNDTRUTH)
        estimate, events = without_clock_steps(estimate, events, ESTIMATE, offset_ns), None
    if rule.drop_groundtruth_outliers:
        events = events or discontinuities(groundtruth, estimate, offset_ns)
        kept = without_groundtruth_outliers(
            groundtruth, events, estimate.stamps[[0, -1]] + offset_ns
        )
        number = len(groundtruth) - len(kept)
        text = (
            f"--drop-groundtruth-outliers: {counted(number, 'pose')} dropped in "
            f"{counted(sum(map(is_groundtruth_outlier, events)), 'outlier')} of the groundtruth"
        )
        remark = note("groundtruth_outliers", text)
        groundtruth = dataclasses.replace(kept, reading=kept.reading.remarked(remark))
    return dataclasses.replace(inputs, groundtruth=groundtruth, estimate=estimate)


def with_up_axes(inputs: Inputs, request: Request) -> Inputs:
    """Replace the up axes of both sides by those of the request, if it has any."""
    if request.up is None:
        return inputs
    groundtruth, estimate = (UpAxis(name) for name in request.up)
    return inputs.changed(
        lambda item: dataclasses.replace(item, up=groundtruth),
        lambda item: dataclasses.replace(item, up=estimate),
    )


def in_world_axes(inputs: Inputs, request: Request) -> tuple[Inputs, Protocol]:
    """Return the inputs in the frames of the errors, and the protocol with lengths in metres.

    Covariances are about the world's axes. For a protocol about gravity, z is up.
    """
    protocol = request.protocol
    inputs = inputs.changed(as_given, request.covariances.about_world)
    if request.span_ns is not None:
        estimate = cut_to_span(inputs.estimate, request.span_ns, protocol)
        inputs = dataclasses.replace(inputs, estimate=estimate)
    if request.lengths_of_groundtruth:
        protocol = with_lengths_of(inputs.groundtruth, protocol)
    return in_gauge_axes(inputs, protocol), protocol


def in_gauge_axes(inputs: Inputs, protocol: Protocol) -> Inputs:
    """Return the inputs with z up if the gauge is about gravity; refuse a wrong up axis."""
    require_up_axis(inputs.groundtruth, inputs.estimate, protocol.gauge)
    return inputs.changed(upright, upright) if protocol.is_upright else inputs


def cut_to_span(estimate: Trajectory, span_ns: tuple[int, int], protocol: Protocol) -> Trajectory:
    """Return the states of the estimate within a time span by the groundtruth's clock."""
    if not estimate.reading.stamped or protocol.association.method == "index":
        raise InputError("pairs by row index exclude a time span; remove --start and --end")
    offset = round(protocol.association.time_offset_s * NANOSECONDS)
    stamps = estimate.stamps + offset
    inside = (stamps >= span_ns[0]) & (stamps <= span_ns[1])
    if not inside.any():
        raise InputError("no pose in the time span")
    return estimate[inside]


def with_lengths_of(groundtruth: Trajectory, protocol: Protocol) -> Protocol:
    """Return the protocol with lengths in percent converted to metres of the whole groundtruth.

    Percentages of the paired path would be different lengths for different algorithms. The
    toolbox's rule uses all groundtruth anyway.
    """
    if protocol.selection.rule == "toolbox":
        return protocol
    whole = groundtruth.in_order() if protocol.in_order else groundtruth
    lengths = tuple(
        Length(length.value / 100.0 * whole.path_length_m, "m") if length.unit == "%" else length
        for length in protocol.lengths
    )
    return dataclasses.replace(protocol, lengths=lengths)


@contextlib.contextmanager
def named(estimate: Trajectory) -> Iterator[None]:
    """Put the source or name of a trajectory before the message of an error."""
    name = estimate.reading.source or estimate.name
    try:
        yield
    except TrajevalError as error:
        raise InputError(f"{name}: {error}" if name else str(error)) from error
