"""What an evaluation does at discontinuities: it corrects clocks, drops outliers, and splits."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import require_one_of
from trajeval_ros.geometry.arrays import Indices, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.travelled import step_angles, step_lengths
from trajeval_ros.metrics.discontinuities.events import (
    CLOCK_STEP,
    EXCURSIONS,
    GROUNDTRUTH,
    ROUNDING_NS,
    Event,
)

WHOLE, SPLIT = ON_RESTART = "whole", "split"


@dataclass(frozen=True)
class DiscontinuityRule:
    """What an evaluation does at discontinuities; by default, it reports them.

    Raises:
        SettingsError: An unknown value of `on_restart`.
    """

    on_restart: str = WHOLE  # `split` states the ATE of the parts together, aligned separately
    drop_groundtruth_outliers: bool = False
    correct_clock_steps: bool = False

    def __post_init__(self) -> None:
        """Refuse an unknown value."""
        require_one_of(self.on_restart, ON_RESTART, "rule for restarts")

    @property
    def changes_inputs(self) -> bool:
        """Whether poses or timestamps change."""
        return self.drop_groundtruth_outliers or self.correct_clock_steps


def without_clock_steps(
    trajectory: Trajectory, events: Sequence[Event], side: str, offset_ns: int = 0
) -> Trajectory:
    """Return one side with the timestamps of its clock before the first step, in order of time.

    The steps of both clocks together are kept. `offset_ns` is that of `discontinuities`. Events
    are at times that are corrected for the steps before them.
    """
    steps = [event for event in events if event.kind == CLOCK_STEP and event.side == side]
    if not steps:
        return trajectory
    receive_times = trajectory.reading.receive_times
    order = np.arange(len(trajectory))
    if receive_times is not None:
        order = np.argsort(receive_times.times, kind="stable")
    stamps = trajectory.stamps[order] + offset_ns
    corrected = stamps.copy()
    for event in steps:
        last = np.flatnonzero(np.abs(corrected - event.t_ns) <= ROUNDING_NS)
        if len(last):
            corrected[last[0] + 1 :] -= round(event.s * NANOSECONDS)
    return dataclasses.replace(trajectory[order], stamps=corrected - offset_ns).in_order()


def is_groundtruth_outlier(event: Event) -> bool:
    """Return whether the groundtruth leaves its path for a time, and returns."""
    return event.kind in EXCURSIONS and event.side == GROUNDTRUTH


def without_groundtruth_outliers(
    groundtruth: Trajectory, events: Sequence[Event], span_ns: Stamps
) -> Trajectory:
    """Return the groundtruth without the poses inside of its outliers and flips.

    `span_ns`: timestamps of the first and the last pose of the estimate, on the groundtruth's
    clock.
    """
    kept = np.ones(len(groundtruth), dtype=bool)
    first_ns, last_ns = groundtruth.stamps[[0, -1]]
    first_ns, last_ns = max(first_ns, span_ns[0]), min(last_ns, span_ns[-1])
    for event in filter(is_groundtruth_outlier, events):
        inside = (groundtruth.stamps >= event.t_ns) & (groundtruth.stamps <= event.end_ns)
        rows = np.flatnonzero(inside)
        is_open = event.t_ns <= first_ns, event.end_ns >= last_ns
        kept[_between_edges(groundtruth[rows], rows, event, is_open)] = False
    return groundtruth if kept.all() else groundtruth[kept]


def _between_edges(
    poses: Trajectory, rows: Indices, event: Event, is_open: tuple[bool, bool]
) -> Indices:
    """Return the rows (M,) of N poses from the good one before an outlier to the one after it.

    The first and the last pose of the outlier are at steps of more than half of its size. One at
    an end of the run, where it `is_open`, has one such step.
    """
    is_edge = np.zeros(max(len(rows) - 1, 0), dtype=bool)
    if event.m:
        is_edge |= step_lengths(poses.positions) > event.m / 2.0
    if event.deg and poses.quaternions is not None:
        is_edge |= np.degrees(step_angles(poses.quaternions)) > event.deg / 2.0
    edges = np.flatnonzero(is_edge)
    if len(edges) == 1 and any(is_open):
        return rows[: edges[0] + 1] if is_open[0] else rows[edges[0] + 1 :]
    return rows[edges[0] + 1 : edges[-1] + 1] if len(edges) > 1 else rows[1:-1]
