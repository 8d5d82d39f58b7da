"""What is done to the states that were read before they are paired."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence

from trajeval_ros.exceptions import InputError, TrajevalError
from trajeval_ros.geometry.fixes import FixRule
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.sub_trajectory_length import Length
from trajeval_ros.pipeline.request import Request


def with_fixes_placed(
    groundtruth: Trajectory, estimates: Sequence[Trajectory], request: Request
) -> tuple[Trajectory, list[Trajectory], Request]:
    """Return both sides with their GNSS fixes in one frame, and the request that fits them."""
    exchanged = -1 if request.mends.swap else 1
    truth, *others = [groundtruth, *estimates][::exchanged]
    level = request.protocol.gauge is Gauge.PLANAR
    with named(truth):
        truth = request.fixes.applied(truth, level=level)
        request = request.for_trajectories(truth, others)
    placed = [_in_frame_of(truth, each, level=level) for each in others]
    groundtruth, *placed = [truth, *placed][::exchanged]
    return groundtruth, placed, request


def _in_frame_of(groundtruth: Trajectory, estimate: Trajectory, *, level: bool) -> Trajectory:
    """Return an estimate of GNSS fixes in the frame of the groundtruth's, where both are."""
    if estimate.fixes is None:
        return estimate
    datum = None if groundtruth.fixes is None else groundtruth.fixes.datum
    with named(estimate):
        return FixRule(datum=datum).applied(estimate, level=level)


def with_up(
    up: tuple[str, str], groundtruth: Trajectory, *estimates: Trajectory
) -> list[Trajectory]:
    """Return trajectories with the axes that were given."""
    axes = [UpAxis(up[0]), *[UpAxis(up[1])] * len(estimates)]
    return [
        dataclasses.replace(each, up=axis)
        for each, axis in zip((groundtruth, *estimates), axes, strict=True)
    ]


def cut_to_span(estimate: Trajectory, span_ns: tuple[int, int], protocol: Protocol) -> Trajectory:
    """Return the states of the estimate that lie within the span."""
    if not estimate.stamped or protocol.association.method == "index":
        raise InputError("pairs by row index exclude a time span; remove --start and --end")
    offset = round(protocol.association.time_offset_s * NANOSECONDS)
    stamps = estimate.stamps + offset
    inside = (stamps >= span_ns[0]) & (stamps <= span_ns[1])
    if not inside.any():
        raise InputError("no pose in the time span")
    return estimate[inside]


def with_lengths_of(groundtruth: Trajectory, protocol: Protocol) -> Protocol:
    """Return the protocol with shares of the whole groundtruth's path in metres.

    A share of the matched path would be another length for each algorithm. The toolbox's rule
    has lengths of all groundtruth anyway.
    """
    if protocol.selection.rule == "toolbox":
        return protocol
    whole = groundtruth.in_order() if protocol.in_order else groundtruth
    lengths = tuple(
        Length(each.value / 100.0 * whole.path_length_m, "m") if each.unit == "%" else each
        for each in protocol.lengths
    )
    return dataclasses.replace(protocol, lengths=lengths)


@contextlib.contextmanager
def named(estimate: Trajectory) -> Iterator[None]:
    """State which estimate an error is about."""
    name = estimate.source or estimate.name
    try:
        yield
    except TrajevalError as error:
        raise InputError(f"{name}: {error}" if name else str(error)) from error
