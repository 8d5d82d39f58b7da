"""Correction of the timestamps after clock steps."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.discontinuities.events import CLOCK_STEP, Event

_SAME_NS = 1000  # rounding of an event's time


def without_clock_steps(
    trajectory: Trajectory, events: Sequence[Event], side: str, offset_ns: int = 0
) -> Trajectory:
    """Return one side with the timestamps of its clock before the first step, in order of time.

    The steps of both clocks together are kept. `offset_ns` is that of `discontinuities`.
    """
    steps = [event for event in events if event.kind == CLOCK_STEP and event.side == side]
    if not steps:
        return trajectory
    receptions = trajectory.reading.receptions
    order = np.arange(len(trajectory))
    if receptions is not None:
        order = np.argsort(receptions.times, kind="stable")
    stamps = trajectory.stamps[order] + offset_ns
    corrected = stamps.copy()
    for event in steps:
        last = np.flatnonzero(np.abs(stamps - event.t_ns) <= _SAME_NS)
        if len(last):
            corrected[last[0] + 1 :] -= round(event.s * NANOSECONDS)
    return dataclasses.replace(trajectory[order], stamps=corrected - offset_ns).in_order()
