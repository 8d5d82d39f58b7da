"""The parts of an estimate between its steps and restarts, with separate alignments."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.association import Association
from trajeval_ros.metrics.discontinuities.events import (
    ESTIMATE,
    GROUNDTRUTH,
    OUTLIER,
    PARTING,
    RESTART,
    ROUNDING_NS,
    Event,
)
from trajeval_ros.metrics.pair_alignment import align_pairs
from trajeval_ros.metrics.protocol import Protocol

# Shorter parts have no ATE: an alignment fits any error of a few poses.
_SHORTEST_S, _FEWEST = 5.0, 10
# In errors of the parts: a smaller step is one of their errors. A groundtruth has no drift, whose
# correction looks like a step.
_SIGMAS = {GROUNDTRUTH: 1.0, ESTIMATE: 5.0}


@dataclass(frozen=True)
class RunPart:
    """Pairs between two discontinuities, aligned separately."""

    begin_ns: int
    end_ns: int
    pairs: int
    ate: float | None  # position RMSE, metres; None if the part is too short

    @property
    def duration_s(self) -> float:
        """Time from its first to its last pair, seconds."""
        return (self.end_ns - self.begin_ns) / NANOSECONDS


def parts_of(
    pairs: Association, events: Sequence[Event], protocol: Protocol
) -> tuple[RunPart, ...]:
    """Return the parts of pairs between restarts and large steps; none without one.

    A step within the usual errors of the parts, such as one by a loop closure, is no cut.
    """
    sure = [event for event in events if event.kind in PARTING and event.certainty == "sure"]
    parts = _cut(pairs, sure, protocol)
    together = together_m(parts)
    if together is None:
        return parts
    large = [
        event
        for event in sure
        if event.kind == RESTART or event.m > _SIGMAS[event.side] * together
    ]
    return parts if len(large) == len(sure) else _cut(pairs, large, protocol)


def _cut(pairs: Association, events: Sequence[Event], protocol: Protocol) -> tuple[RunPart, ...]:
    """Return the parts of pairs between events; none without one."""
    stamps = pairs.groundtruth.stamps
    cuts = [event.end_ns - ROUNDING_NS for event in events]
    numbers = np.searchsorted(np.sort(np.array(cuts, dtype=np.int64)), stamps, "right")
    if not cuts or numbers[0] == numbers[-1]:
        return ()
    parts = []
    for number in np.unique(numbers):
        rows = np.flatnonzero(numbers == number)
        begin_ns, end_ns = int(stamps[rows[0]]), int(stamps[rows[-1]])
        is_long = end_ns - begin_ns >= _SHORTEST_S * NANOSECONDS and len(rows) >= _FEWEST
        ate = _ate(pairs, rows, protocol) if is_long else None
        parts.append(RunPart(begin_ns, end_ns, len(rows), ate))
    return tuple(parts)


def together_m(parts: Sequence[RunPart]) -> float | None:
    """Return the RMSE over the pairs of all parts with an ATE, metres; None without any."""
    measured = [(part.pairs, part.ate) for part in parts if part.ate is not None]
    if not measured:
        return None
    squares = sum(count * ate * ate for count, ate in measured)
    return math.sqrt(squares / sum(count for count, _ in measured))


def without_outliers_m(pairs: Association, events: Sequence[Event], errors_m: np.ndarray) -> float:
    """Return the RMSE of errors (N,) of the pairs outside of outliers, metres."""
    stamps = pairs.groundtruth.stamps
    kept = np.ones(len(stamps), dtype=bool)
    for event in events:
        if event.kind == OUTLIER:
            kept &= (stamps < event.t_ns) | (stamps > event.end_ns)
    return float(np.sqrt(np.mean(np.square(errors_m[kept])))) if kept.any() else math.nan


def _ate(pairs: Association, rows: np.ndarray, protocol: Protocol) -> float | None:
    sides = pairs.groundtruth[rows], pairs.estimate[rows]
    part = dataclasses.replace(pairs, groundtruth=sides[0], estimate=sides[1])
    try:
        similarity = align_pairs(part, protocol).similarity
    except InputError:
        return None
    apart = sides[0].positions - similarity.positions(sides[1].positions)
    return float(np.sqrt(np.mean(np.square(apart).sum(axis=1))))
