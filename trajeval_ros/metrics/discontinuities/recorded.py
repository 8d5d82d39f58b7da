"""Discontinuities of recorded trajectories, by the same search as live."""

from __future__ import annotations

import dataclasses

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Indices, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.discontinuities.detector import Discontinuities
from trajeval_ros.metrics.discontinuities.events import SIDES, Event
from trajeval_ros.metrics.discontinuities.one_stream import OneStream
from trajeval_ros.metrics.discontinuities.relative_motion import CELL_S
from trajeval_ros.metrics.discontinuities.screening import repeated_rows
from trajeval_ros.metrics.discontinuities.step_search import LEARN_S, examined_intervals

_BLOCK_S = 60.0  # messages that are taken at a time: more take memory, fewer time


def discontinuities(
    groundtruth: Trajectory,
    estimate: Trajectory,
    offset_ns: int = 0,
    unusual: Stamps | None = None,
) -> list[Event]:
    """Return the events of two recorded trajectories, as a live run finds them, by time.

    If both sides have receive times, their states are taken in that order; else in the given one.
    `offset_ns` is added to the estimate's timestamps. Far from `unusual` motions (K,), by the
    groundtruth's clock, no motion is examined; None if any can be unusual.
    """
    if offset_ns:
        estimate = dataclasses.replace(estimate, stamps=estimate.stamps + offset_ns)
    if unusual is not None:
        groundtruth, estimate = _needed(groundtruth, estimate, unusual)
    oriented = groundtruth.quaternions is not None and estimate.quaternions is not None
    search, sides, blocks = Discontinuities(oriented=oriented, unusual=unusual), [], []
    times = [item.reading.receive_times for item in (groundtruth, estimate)]
    has_times = all(time is not None for time in times)
    for trajectory, receive_times in zip((groundtruth, estimate), times, strict=True):
        received = None
        if has_times and receive_times is not None:
            order = np.argsort(receive_times.times, kind="stable")
            trajectory, received = trajectory[order], receive_times.times[order]
        columns = [trajectory.positions]
        if oriented and trajectory.quaternions is not None:
            columns.append(trajectory.quaternions)
        sides.append((trajectory.stamps, np.hstack(columns), received))
        blocks.append(np.maximum.accumulate(trajectory.stamps if received is None else received))
    rows = [0, 0]
    for until in _ends_of_blocks(np.sort(np.concatenate(blocks))):
        for number, (stamps, poses, received) in enumerate(sides):
            begin = rows[number]
            end = int(np.searchsorted(blocks[number], until, "right"))
            part = None if received is None else received[begin:end]
            search.add(SIDES[number], stamps[begin:end], poses[begin:end], part)
            rows[number] = end
    return search.finish()


def _needed(
    groundtruth: Trajectory, estimate: Trajectory, unusual: Stamps
) -> tuple[Trajectory, Trajectory]:
    """Return two sides in order of time without the poses that the search does not use.

    Far from `unusual` motions (K,) and from repeated poses, it learns from the first pair of a
    cell of time alone, which may be interpolated between two poses.
    """
    sides = groundtruth, estimate
    begin_ns = max(int(side.stamps[0]) for side in sides)
    used = np.concatenate([unusual, *(side.stamps[repeated_rows(side)] for side in sides)])
    examined = examined_intervals((used - begin_ns) / NANOSECONDS)
    learned = [0, *examined, *(number - 1 for number in examined)]
    seconds = [(side.stamps - begin_ns) / NANOSECONDS for side in sides]
    # Of a cell, its first pose and the neighbours, since the first pair may be one by rounding.
    firsts = [
        _with_neighbours(np.flatnonzero(np.diff(times // CELL_S, prepend=-np.inf)), len(times))
        for times in seconds
    ]
    needed = []
    for number, times in enumerate(seconds):
        # The first motion of an interval begins in the cell before it.
        is_needed = firsts[number] | np.isin(times // LEARN_S, learned)
        is_needed |= np.isin((times + CELL_S) // LEARN_S, learned)
        other = 1 - number
        # The poses between which the other side's are interpolated.
        rows = times.searchsorted(seconds[other][firsts[other]])
        needed.append(sides[number][is_needed | _with_neighbours(rows, len(times))])
    return needed[0], needed[1]


def _with_neighbours(rows: Indices, count: int) -> Booleans:
    """Return which of so many rows are one of some rows (K,), or next to one."""
    chosen = np.zeros(count, dtype=bool)
    for near in (-1, 0, 1):
        chosen[(rows + near).clip(0, count - 1)] = True
    return chosen


def stream_discontinuities(trajectory: Trajectory, side: str) -> list[Event]:
    """Return the events of one recorded trajectory alone, as a live run finds them, by time.

    If it has receive times, its states are taken in that order; else in the given one.
    """
    receive_times, received = trajectory.reading.receive_times, None
    if receive_times is not None:
        order = np.argsort(receive_times.times, kind="stable")
        trajectory, received = trajectory[order], receive_times.times[order]
    columns = [trajectory.positions]
    if trajectory.quaternions is not None:
        columns.append(trajectory.quaternions)
    stream = OneStream(side, oriented=trajectory.quaternions is not None)
    stream.add(trajectory.stamps, np.hstack(columns), received)
    return stream.finish()


def _ends_of_blocks(times: Stamps) -> list[int]:
    """Return the ends of the blocks that have messages; `times`: (N,), sorted, nanoseconds.

    There are no more blocks than messages, even if a timestamp is centuries away.
    """
    block_ns = round(_BLOCK_S * NANOSECONDS)
    numbers = -((times[0] - times) // block_ns)
    ends: list[int] = (times[0] + block_ns * numbers[np.diff(numbers, append=-1) != 0]).tolist()
    return ends
