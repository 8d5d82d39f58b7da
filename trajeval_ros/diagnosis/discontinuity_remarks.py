"""Remarks on discontinuities of groundtruth and estimate."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted, four_digits
from trajeval_ros.formatting.remarks import Remark, note, warning
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.association import associate
from trajeval_ros.metrics.discontinuities import events as kinds
from trajeval_ros.metrics.discontinuities.clock_correction import without_clock_steps
from trajeval_ros.metrics.discontinuities.detector import discontinuities
from trajeval_ros.metrics.discontinuities.events import Event
from trajeval_ros.metrics.discontinuities.parts import Part, together_m, without_outliers_m
from trajeval_ros.metrics.evaluation import Evaluation, evaluate_pairs

_FALLS = 0.8  # of the ATE: a discontinuity that causes more of it is worth a warning
_SPARSE = ("gnss", "points")  # kinds of groundtruth whose noise hides steps
_MOST = 3  # parts that are named
_WHAT = {
    kinds.OUTLIER: "outlier",
    kinds.STEP: "step",
    kinds.RESTART: "restart",
    kinds.CORRECTION: "correction",
    kinds.LOST: "interval of irregular motion",
}


def events_of(evaluation: Evaluation, *, paired: bool) -> tuple[Event, ...]:
    """Return the discontinuities of an evaluation's trajectories, by the groundtruth's clock.

    If they are `paired`, those of the pairs. None without timestamps, and for fixes and points.
    """
    pairs, rule = evaluation.association, evaluation.association.rule
    if rule.method == "index" or evaluation.groundtruth.kind in _SPARSE:
        return ()
    if paired:
        return tuple(discontinuities(pairs.groundtruth, pairs.estimate))
    offset_ns = round(rule.time_offset_s * NANOSECONDS)
    return tuple(discontinuities(evaluation.groundtruth, evaluation.estimate, offset_ns))


def about_discontinuities(
    evaluation: Evaluation, events: Sequence[Event], parts: Sequence[Part]
) -> Iterator[Remark]:
    """Name the discontinuities that cause errors; others are counted in one note."""
    whole, first_ns = evaluation.ate["position_m"], int(evaluation.groundtruth.stamps.min())
    errors_m = evaluation.absolute.position_m
    together = together_m(parts)
    split_helps = whole is not None and together is not None and together < _FALLS * whole.rmse
    outliers_count = (
        whole is not None
        and without_outliers_m(evaluation.association, events, errors_m) < _FALLS * whole.rmse
    )
    rest = []
    groups: dict[tuple[str, str], list[Event]] = {}
    for event in events:
        groups.setdefault((event.kind, event.side), []).append(event)
    for (kind, side), some in groups.items():
        is_grave = (
            kind in (kinds.FLIP, kinds.FLIP_STAYS, kinds.CLOCK_STEP, kinds.FROZEN_POSITION)
            or (kind in kinds.PARTING and split_helps)
            or (kind == kinds.OUTLIER and outliers_count)
        )
        if not is_grave:
            rest += some
            continue
        worst = max(some, key=lambda event: (event.ratio, abs(event.s)))
        text = _sentence(worst, first_ns)
        if kind == kinds.CLOCK_STEP and side in kinds.SIDES:
            text += _with_correct_clocks(evaluation, events)
        elif kind == kinds.CLOCK_STEP:
            text += "; evaluate the time before and after it separately"
        if len(some) > 1:
            text += f" (largest of {len(some)} times)"
        if kind in kinds.PARTING and side != kinds.GROUNDTRUTH:
            text += f"; {_parts_text(parts)}"
        yield warning(kind, text)
    if rest:
        yield note("discontinuities", _counted(rest, first_ns))


def _sentence(event: Event, first_ns: int) -> str:
    at = f"at {(event.end_ns - first_ns) / NANOSECONDS:.2f} s"
    size = " and ".join(
        text
        for value, text in (
            (event.m, f"{event.m:.2f} m"),
            (event.deg, f"{event.deg:.0f} deg"),
        )
        if value
    )
    lasting = f" for {event.s:.2f} s" if event.s else ""
    gap = f", in a gap of {event.gap_s:.1f} s" if event.gap_s else ""
    who = "one side" if event.side == kinds.UNDECIDED else f"the {event.side}"
    if event.kind == kinds.CLOCK_STEP:
        whose = "both clocks" if event.side == kinds.BOTH else f"{who}'s clock"
        why = " (the receive times did not)" if event.certainty == "sure" else ""
        return f"{whose} stepped by {event.s:+.3f} s {at}{why}"
    if event.kind == kinds.FROZEN_POSITION:
        other = kinds.SIDES[event.side == kinds.GROUNDTRUTH]
        begin = f"from {(event.t_ns - first_ns) / NANOSECONDS:.1f} s"
        return (
            f"the position of {who} is frozen {begin}{lasting}, while the {other} moves "
            f"{event.m:.2f} m"
        )
    if event.kind == kinds.RESTART:
        return f"{who} restarted at its origin {at}{gap}, {size} away"
    if event.kind in (kinds.FLIP, kinds.FLIP_STAYS):
        return f"{who} rotated by {event.deg:.0f} deg {at}{lasting}"
    if event.kind == kinds.OUTLIER:
        return f"{who} has an outlier of {size} {at}{lasting}"
    if event.side == kinds.UNDECIDED:
        first, second = event.innovations
        return (
            f"one side jumped by {size} {at}: both are too slow or have a gap there (innovations "
            f"{first:.2f} and {second:.2f} of it); compare with a second source"
        )
    return f"{who} jumped by {size} {at}{gap}"


def _with_correct_clocks(evaluation: Evaluation, events: Sequence[Event]) -> str:
    """Return the ATE with corrected timestamps, as text; "" if nothing can be evaluated."""
    offset_ns = round(evaluation.association.rule.time_offset_s * NANOSECONDS)
    groundtruth = without_clock_steps(evaluation.groundtruth, events, kinds.GROUNDTRUTH)
    estimate = without_clock_steps(evaluation.estimate, events, kinds.ESTIMATE, offset_ns)
    protocol = dataclasses.replace(evaluation.protocol, lengths=())
    try:
        pairs = associate(groundtruth, estimate, evaluation.association.rule)
        position = evaluate_pairs(pairs, groundtruth, estimate, protocol).ate["position_m"]
    except InputError:
        return ""
    assert position is not None
    return f"; with corrected timestamps, the ATE is {four_digits(position.rmse)} m"


def _parts_text(parts: Sequence[Part]) -> str:
    together = together_m(parts)
    named = [part for part in parts if part.ate is not None]
    assert together is not None
    sizes = ", ".join(f"{four_digits(part.ate or 0.0)} m" for part in named[:_MOST])
    more = f" of {len(named)}" if len(named) > _MOST else ""
    return f"ATE of the parts{more} {sizes}, together {four_digits(together)} m"


def _counted(events: Sequence[Event], first_ns: int) -> str:
    """Return the number of events by kind and side, with the largest size."""
    groups: dict[tuple[str, str], list[Event]] = {}
    for event in events:
        groups.setdefault((event.kind, event.side), []).append(event)
    texts = []
    for (kind, side), some in groups.items():
        what = _WHAT.get(kind, kind.replace("_", " "))
        largest = max(event.m for event in some)
        size = f" of up to {largest:.2f} m" if largest else ""
        at = f"{(some[0].end_ns - first_ns) / NANOSECONDS:.1f} s"
        first = f"at {at}" if len(some) == 1 else f"the first at {at}"
        whose = "of an undecided side" if side == kinds.UNDECIDED else f"of the {side}"
        texts.append(f"{counted(len(some), what)} {whose}{size}, {first}")
    return "; ".join(texts)
