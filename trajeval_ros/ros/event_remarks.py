"""Remarks about discontinuities of a live run."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

from trajeval_ros.diagnosis.discontinuities import sentence_about, summary_of
from trajeval_ros.formatting.remarks import Level, Remark, warning
from trajeval_ros.metrics.discontinuities.events import (
    BOTH,
    CLOCK_STEP,
    CORRECTION,
    DECLARED,
    ESTIMATE,
    FLIP,
    FLIP_STAYS,
    FREEZES,
    FROZEN,
    FROZEN_POSITION,
    FROZEN_ROTATION,
    OUTLIER,
    PARTING,
    Event,
)
from trajeval_ros.online.reports import Snapshot
from trajeval_ros.ros.live_estimate import LiveEstimate

SUMMARY = "count"  # subject of the remark about all steps
_SERIOUS = CLOCK_STEP, FLIP, FLIP_STAYS, *FREEZES  # kinds of any size that are warnings
_NEW_RUN = "one alignment can't fit them; to start a new run, call ~/reset or set on_restart"


def about_event(event: Event) -> Remark:
    """Return the remark about a discontinuity; its code is the kind."""
    text = sentence_about(event)
    if event.certainty == DECLARED:
        text = "the estimator declares a reset; to start a new run there, set on_restart"
    values = {**dataclasses.asdict(event), "stamp_ns": event.end_ns}
    del values["innovations"]
    return Remark(_level(event), event.kind, text, event.side, values)


def lasts(event: Event) -> bool:
    """Return whether a discontinuity is a condition, with a remark while it lasts."""
    return event.kind in FREEZES or (event.kind == CLOCK_STEP and event.side != BOTH)


def about_steps(estimate: LiveEstimate) -> Iterator[Remark]:
    """Yield the warning of all discontinuities so far that matter and do not last."""
    frozen = [id(event) for event in estimate.discontinuities.frozen]
    events = [
        event
        for event in estimate.discontinuities.events
        if _level(event) == Level.WARNING
        and (event.kind != CLOCK_STEP or event.side == BOTH)
        and id(event) not in frozen
    ]
    if events:
        text, is_parted = summary_of(events), any(event.kind in PARTING for event in events)
        code = max(events, key=lambda event: event.ratio).kind
        yield warning(code, f"{text}; {_NEW_RUN}" if is_parted else text, SUMMARY)


def about_frozen(estimate: LiveEstimate, snapshot: Snapshot) -> Iterator[Remark]:
    """Yield the warnings of positions and rotations that are frozen now.

    A whole pose of the estimate that is repeated is a loss of tracking, with another remark. Of
    a groundtruth whose pose is repeated, the position is reported.
    """
    is_lost = snapshot.loss is not None and snapshot.loss.kind == FROZEN
    frozen = estimate.discontinuities.frozen
    of_position = {event.side for event in frozen if event.kind == FROZEN_POSITION}
    for event in frozen:
        is_reported = event.kind == FROZEN_ROTATION and event.side in of_position
        if not is_reported and not (is_lost and event.side == ESTIMATE):
            yield about_event(event)


def _level(event: Event) -> Level:
    if event.kind in _SERIOUS or event.certainty == DECLARED:
        return Level.WARNING
    is_usual = event.kind == CORRECTION or (event.kind == OUTLIER and event.side == ESTIMATE)
    return Level.WARNING if event.is_large and not is_usual else Level.NOTE
