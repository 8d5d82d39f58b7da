"""Findings and remarks about discontinuities of groundtruth and estimate, and their texts."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np

from trajeval_ros.diagnosis.causes import CAUSES, DISCONTINUITIES, cause_name
from trajeval_ros.diagnosis.findings import Detection, Diagnosis, Finding, TestResult, Value
from trajeval_ros.diagnosis.lost_tracking_tests import values_of
from trajeval_ros.formatting.numbers import counted, four_digits
from trajeval_ros.formatting.remarks import Remark, note
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.discontinuities import events as kinds
from trajeval_ros.metrics.discontinuities.events import Event, Loss
from trajeval_ros.metrics.discontinuities.parts import (
    RunPart,
    parts_of,
    together_m,
    without_outliers_m,
)
from trajeval_ros.metrics.discontinuities.recorded import discontinuities
from trajeval_ros.metrics.discontinuities.screening import has_repeats, unusual_times
from trajeval_ros.metrics.evaluation import Evaluation

_FALLS = 0.8  # of the ATE: steps that cause more of it are a finding
# The same without outliers: a good estimate has a few, which are its errors.
_OUTLIERS_FALL = {kinds.GROUNDTRUTH: 0.8, kinds.ESTIMATE: 0.5}
_SIGMAS = 5.0  # errors: a larger outlier of the groundtruth is wrong, whatever its share is
_NOISY = "gnss"  # kind of groundtruth whose noise hides steps
_MOST = 3  # parts that are named
_ROW_NS = NANOSECONDS // 10  # between poses without timestamps, as of most recordings
# Side of a frozen pose by the finding about it.
_FROZEN = {
    "frozen": kinds.ESTIMATE,
    "frozen_at_start": kinds.ESTIMATE,
    "groundtruth_frozen": kinds.GROUNDTRUTH,
    "groundtruth_held": kinds.GROUNDTRUTH,
}
_NOUNS = {kinds.LOST: "interval of irregular motion"}


def with_events(
    evaluation: Evaluation,
    groundtruth: Trajectory,
    estimate: Trajectory,
    *,
    paired: bool,
    is_explained: bool = False,
) -> Evaluation:
    """Return an evaluation with its discontinuities, by the groundtruth's clock, and its parts.

    The trajectories are in the order of their sources, without the time offset. If they are
    `paired`, or have no timestamps, those of the pairs are used. Nothing for GNSS fixes. If a
    mistake explains all motions, only exact repeats and steps of clocks are searched for.
    """
    pairs, rule = evaluation.association, evaluation.association.rule
    if evaluation.groundtruth.kind == _NOISY:
        return evaluation
    has_times = _has_times(evaluation)
    if paired or not has_times:
        groundtruth, estimate = pairs.groundtruth, pairs.estimate
    else:
        stamps = estimate.stamps + round(rule.time_offset_s * NANOSECONDS)
        estimate = dataclasses.replace(estimate, stamps=stamps)
    if not has_times:
        stamps = _ROW_NS * np.arange(len(pairs))
        groundtruth, estimate = (
            dataclasses.replace(side, stamps=stamps) for side in (groundtruth, estimate)
        )
        pairs = dataclasses.replace(pairs, groundtruth=groundtruth, estimate=estimate)
    sides = groundtruth, estimate
    similarity = evaluation.alignment.similarity
    unusual = unusual_times(pairs, similarity, *sides, in_gaps=is_explained)
    if unusual is not None and not len(unusual) and not any(map(has_repeats, sides)):
        return evaluation
    events = tuple(discontinuities(*sides, unusual=unusual if has_times else None))
    parts = parts_of(pairs, events, evaluation.protocol) if has_times else ()
    return dataclasses.replace(evaluation, events=events, parts=parts)


def without_jumps(evaluation: Evaluation) -> Evaluation:
    """Return an evaluation with exact repeats alone as events, which no convention explains."""
    events = tuple(event for event in evaluation.events if event.kind in kinds.FREEZES)
    return dataclasses.replace(evaluation, events=events, parts=())


def with_divergences(evaluation: Evaluation, losses: Sequence[Loss]) -> Evaluation:
    """Return an evaluation with divergences as events, too; a step of a clock explains them."""
    diverged = [loss for loss in losses if loss.kind == kinds.DIVERGED]
    if not diverged or has_clock_step(evaluation):
        return evaluation
    events = sorted((*evaluation.events, *diverged), key=lambda event: event.t_ns)
    return dataclasses.replace(evaluation, events=tuple(events))


def _has_times(evaluation: Evaluation) -> bool:
    return evaluation.association.rule.method != "index"


def has_clock_step(evaluation: Evaluation) -> bool:
    """Return whether a clock stepped."""
    return any(event.kind == kinds.CLOCK_STEP for event in evaluation.events)


def changes_motions(evaluation: Evaluation) -> bool:
    """Return whether a clock stepped or a body flipped, which looks like most other mistakes.

    Several flips that stay are the effect of wrong rotations.
    """
    flips = [event.certainty for event in evaluation.events if event.kind == kinds.FLIP_STAYS]
    return flips == ["sure"] or has_clock_step(evaluation)


def examined_discontinuities(evaluation: Evaluation, known: Diagnosis) -> TestResult:
    """Return the discontinuities that cause errors, one per kind and side.

    `known`: other findings. Most explain steps; a frozen position is not repeated.
    """
    events = _unexplained(evaluation, known) if _has_times(evaluation) else []
    first_ns = int(evaluation.groundtruth.stamps.min())
    scores = {"events": float(len(evaluation.events))}
    seen = [
        _seen(group, evaluation.parts, first_ns)
        for group in _grouped(events)
        if _is_cause(group, evaluation)
    ]
    return TestResult("discontinuities", scores, tuple(seen))


def about_small_discontinuities(evaluation: Evaluation, known: Diagnosis) -> Iterator[Remark]:
    """Count the discontinuities that are no finding, in one note."""
    groups = _grouped(_unexplained(evaluation, known))
    has_times = _has_times(evaluation)
    rest = [group for group in groups if not (has_times and _is_cause(group, evaluation))]
    if rest:
        first_ns = int(evaluation.groundtruth.stamps.min()) if has_times else None
        events = [event for group in rest for event in group]
        yield note("discontinuities", summary_of(events, first_ns))


def sentence_about(event: Event, first_ns: int = 0) -> str:
    """Return the sentence about one discontinuity, with times since `first_ns`.

    That of a frozen part has its begin alone, since it lasts.
    """
    if event.kind in kinds.FREEZES:
        part = event.kind.removeprefix("frozen_")
        other, motion = kinds.SIDES[event.side == kinds.GROUNDTRUTH], f"moves {event.m:.2f} m"
        if event.kind == kinds.FROZEN_ROTATION:
            motion = f"rotates by {event.deg:.0f} deg"
        since_s = (event.t_ns - first_ns) / NANOSECONDS
        return (
            f"the {part} of the {event.side} is frozen since {since_s:.1f} s, while the {other} "
            f"{motion}"
        )
    if isinstance(event, Loss):
        return _sentence_about_loss([event], first_ns)
    seen = _seen([event], (), first_ns)
    if seen.cause in DISCONTINUITIES:
        return Finding.of(seen).sentence
    return summary_of([event], first_ns)


def summary_of(events: Sequence[Event], first_ns: int | None = 0) -> str:
    """Return the numbers of discontinuities by kind and side, with times since `first_ns`.

    It is None if the poses have no timestamps.
    """
    text = "; ".join(_counted(group, first_ns) for group in _grouped(events))
    undecided = any(event.side == kinds.UNDECIDED for event in events)
    return text + ("; compare with a second source" if undecided else "")


def _unexplained(evaluation: Evaluation, known: Diagnosis) -> list[Event]:
    """Return the events that no other finding explains."""
    frozen = {_FROZEN[finding.cause] for finding in known.findings if finding.cause in _FROZEN}
    graver = {finding.cause for finding in known.findings if finding.rank >= CAUSES["scale"].rank}
    if graver - DISCONTINUITIES - _FROZEN.keys() - {"identical"}:
        return []
    return [
        event
        for event in evaluation.events
        if not (event.kind in kinds.FREEZES and event.side in frozen)
    ]


def _grouped(events: Sequence[Event]) -> list[list[Event]]:
    """Return the events by kind and side."""
    groups: dict[tuple[str, str], list[Event]] = {}
    for event in events:
        groups.setdefault((event.kind, event.side), []).append(event)
    return list(groups.values())


def _is_cause(group: Sequence[Event], evaluation: Evaluation) -> bool:
    """Return whether discontinuities of one kind and side cause errors."""
    kind, side = group[0].kind, group[0].side
    whole = evaluation.ate["position_m"]
    if cause_name(kind, side) not in DISCONTINUITIES or whole is None:
        return False
    if kind in kinds.PARTING:
        together = together_m(evaluation.parts)
        if together is not None:
            return together < _FALLS * _without_cuts_at(group, evaluation, whole.rmse)
        # Parts too short: a step gives an ATE of at most half its size, and steps add as squares.
        return bool(evaluation.parts) and math.hypot(*(event.m for event in group)) > whole.rmse
    if kind == kinds.OUTLIER:
        errors_m = evaluation.absolute.position_m
        rest = without_outliers_m(evaluation.association, evaluation.events, errors_m)
        largest_m = max(event.m for event in group)
        is_wrong = side == kinds.GROUNDTRUTH and largest_m > _SIGMAS * whole.rmse
        return is_wrong or rest < _OUTLIERS_FALL[side] * whole.rmse
    return True


def _without_cuts_at(group: Sequence[Event], evaluation: Evaluation, whole_m: float) -> float:
    """Return the ATE of the parts that the other steps and restarts begin, metres."""
    rest = [event for event in evaluation.events if event not in group]
    parts = parts_of(evaluation.association, rest, evaluation.protocol)
    together = together_m(parts)
    return whole_m if together is None else together


def _seen(group: Sequence[Event], parts: Sequence[RunPart], first_ns: int) -> Detection:
    """Return the cause of discontinuities of one kind and side: its largest one."""
    event = max(group, key=lambda event: (event.ratio, abs(event.s)))
    begin_s, end_s = ((ns - first_ns) / NANOSECONDS for ns in (event.t_ns, event.end_ns))
    values: dict[str, Value] = {
        "side": event.side,
        "other": kinds.SIDES[event.side == kinds.GROUNDTRUTH],
        "m": event.m,
        "deg": event.deg,
        "s": event.s,
        "begin_s": begin_s,
        "end_s": end_s,
        "size": event.size,
        "lasting": f" for {event.s:.2f} s" if event.s else "",
        "gap": f", in a gap of {event.gap_s:.1f} s" if event.gap_s else "",
        "number": f" (largest of {len(group)})" if len(group) > 1 else "",
        "proof": "; the receive times did not" if event.certainty == "sure" else "",
        "parts": _parts_text(parts) if event.kind in kinds.PARTING else "",
    }
    return Detection(cause_name(event.kind, event.side), values)


def _parts_text(parts: Sequence[RunPart]) -> str:
    together = together_m(parts)
    if together is None:
        return "the parts are too short for separate alignments"
    named = [part for part in parts if part.ate is not None]
    sizes = ", ".join(
        f"{four_digits(part.ate or 0.0)} m ({part.duration_s:.0f} s)" for part in named[:_MOST]
    )
    more = f" (first {_MOST} of {len(named)})" if len(named) > _MOST else ""
    return (
        f"ATE of the parts{more} {sizes}, together {four_digits(together)} m: --on-restart split"
    )


def _counted(group: Sequence[Event], first_ns: int | None) -> str:
    """Return the number of events of one kind and side, with the largest size.

    `first_ns` is the first timestamp; None if the poses have none.
    """
    kind, side = group[0].kind, group[0].side
    if kind == kinds.DIVERGED and first_ns is not None:
        return _sentence_about_loss(group, first_ns)
    largest = max(group, key=lambda event: (event.m, event.deg))
    size = largest.size and f" of up to {largest.size}"
    at_ns = group[0].t_ns if kind in kinds.FREEZES else group[0].end_ns
    at = f"pair {round(at_ns / _ROW_NS) + 1}"
    if first_ns is not None:
        at = f"{(at_ns - first_ns) / NANOSECONDS:.1f} s"
    first = f"at {at}" if len(group) == 1 else f"the first at {at}"
    whose, shares = f"of the {side}", ""
    if side == kinds.UNDECIDED:
        value, unit = (largest.m, "m") if largest.m else (largest.deg, "deg")
        one, other = (f"{share * value:.3g} {unit}" for share in largest.innovations)
        whose = "of an undecided side"
        shares = f" ({one} in the groundtruth's own motion, {other} in the estimate's)"
    noun = _NOUNS.get(kind, kind.replace("_", " "))
    return f"{counted(len(group), noun)} {whose}{size}{shares}, {first}"


def _sentence_about_loss(group: Sequence[Event], first_ns: int) -> str:
    losses = [event for event in group if isinstance(event, Loss)]
    longest = max(losses, key=lambda loss: loss.s)
    values = values_of(longest, first_ns, len(losses))
    return Finding.of(Detection(longest.kind, values)).sentence
