"""Preparation of the trajectories before the association."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence

from trajeval_ros.exceptions import InputError, TrajevalError
from trajeval_ros.geometry.fix_selection import FixRule
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.sub_trajectory_length import Length
from trajeval_ros.pipeline.request import Request


def with_fixes_placed(
    groundtruth: Trajectory, estimates: Sequence[Trajectory], request: Request
) -> tuple[Trajectory, list[Trajectory], Request]:
    """Return both sides with GNSS fixes in one frame, and the request with its default gauge."""
    exchanged = -1 if request.mends.swap else 1
    truth, *others = [groundtruth, *estimates][::exchanged]
    level = request.protocol.gauge is Gauge.PLANAR
    with named(truth):
        truth = request.fixes.applied(truth, level=level)
        request = request.for_trajectories(truth, others)
    placed = [_in_frame_of(truth, other, level=level) for other in others]
    groundtruth, *placed = [truth, *placed][::exchanged]
    return groundtruth, placed, request


def _in_frame_of(groundtruth: Trajectory, estimate: Trajectory, *, level: bool) -> Trajectory:
    """Return an estimate of GNSS fixes in the groundtruth's frame, if that has fixes, too."""
    if estimate.fixes is None:
        return estimate
    datum = None if groundtruth.fixes is None else groundtruth.fixes.datum
    with named(estimate):
        return FixRule(datum=datum).applied(estimate, level=level)


def with_up(
    up: tuple[str, str], groundtruth: Trajectory, *estimates: Trajectory
) -> list[Trajectory]:
    """Return trajectories with given up axes."""
    axes = [UpAxis(up[0]), *[UpAxis(up[1])] * len(estimates)]
    return [
        dataclasses.replace(trajectory, up=axis)
        for trajectory, axis in zip((groundtruth, *estimates), axes, strict=True)
    ]


def cut_to_span(estimate: Trajectory, span_ns: tuple[int, int], protocol: Protocol) -> Trajectory:
    """Return the states of the estimate within a time span by the groundtruth's clock."""
    if not estimate.stamped or protocol.association.method == "index":
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
    name = estimate.source or estimate.name
    try:
        yield
    except TrajevalError as error:
        raise InputError(f"{name}: {error}" if name else str(error)) from error
