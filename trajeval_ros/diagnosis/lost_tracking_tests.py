"""Tests for an estimate that froze or diverged, and the part of it that other tests use."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.diagnosis.findings import Detection, TestResult, Value
from trajeval_ros.diagnosis.input_pair import FEWEST
from trajeval_ros.geometry.arrays import extents
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.discontinuities.events import DIVERGED, FROZEN, Loss
from trajeval_ros.metrics.discontinuities.lost_tracking import divergences_in

if TYPE_CHECKING:
    from trajeval_ros.geometry.arrays import Floats
    from trajeval_ros.metrics.association import Association

_START_S = 1.0  # a loss within this time after the first pair is one of the start
# Of the size of the groundtruth's path. Inverse poses have up to twice its size.
_UNBOUNDED = 3.0
# Of the run, and of the groundtruth's path: a smaller loss is one of the run's errors. An estimate
# that holds its position moves a small part of that path.
_LARGE_PART, _LARGE, _HELD = 0.2, 1.5, 0.33


def losses_in(pairs: Association) -> Sequence[Loss]:
    """Return the losses of tracking in pairs; none without timestamps."""
    if pairs.rule.method == "index":
        return ()
    # Fixes and points are too few or too noisy to show a divergence.
    diverged = [] if pairs.is_at_groundtruth else divergences_in(pairs.groundtruth, pairs.estimate)
    return sorted((*pairs.tracking.frozen, *diverged), key=lambda loss: loss.t_ns)


def is_certain(loss: Loss, pairs: Association) -> bool:
    """Return whether no other mistake can look like a loss: a repeated pose, or unbounded motion.

    Until the loss, the sizes of both paths give the unit of the estimate.
    """
    if loss.kind == FROZEN:
        return True
    stamps = pairs.estimate.stamps
    groundtruth, estimate = pairs.groundtruth.positions, pairs.estimate.positions
    before, lost = stamps <= loss.t_ns, (stamps > loss.t_ns) & (stamps <= loss.end_ns)
    if np.count_nonzero(before) < FEWEST or loss.is_over:
        return False
    unit = _size(groundtruth[before]) / max(_size(estimate[before]), 1e-12)
    return unit * _size(estimate[lost]) > _UNBOUNDED * _size(groundtruth)


def is_large(loss: Loss, pairs: Association) -> bool:
    """Return whether a loss is no large drift, and long or until the end."""
    differs = loss.moved_m > _LARGE * loss.m or loss.moved_m < _HELD * loss.m
    is_long = not loss.is_over or loss.s > _LARGE_PART * pairs.estimate.duration_s
    return differs and is_long


def begins_at_start(loss: Loss, pairs: Association) -> bool:
    """Return whether a loss begins with the first pairs."""
    return loss.t_ns - int(pairs.estimate.stamps[0]) < _START_S * NANOSECONDS


def _size(positions: Floats) -> float:
    return float(np.linalg.norm(extents(positions)))


def lost_tracking(losses: Sequence[Loss], pairs: Association, first_ns: int) -> TestResult:
    """Report losses, by times since `first_ns`, the groundtruth's first timestamp."""
    seen = []
    for kind in (DIVERGED, FROZEN):
        some = [loss for loss in losses if loss.kind == kind]
        if not some:
            continue
        longest = max(some, key=lambda loss: loss.s)
        loss = some[0] if kind == DIVERGED else longest
        of_start = begins_at_start(loss, pairs) and (loss.is_over or kind == DIVERGED)
        number = len(some) if kind == FROZEN else 1
        cause = f"{kind}_at_start" if of_start else kind
        seen.append(Detection(cause, values_of(loss, first_ns, number)))
    return TestResult("lost tracking", {"losses": float(len(losses))}, tuple(seen))


def values_of(loss: Loss, first_ns: int, number: int = 1) -> dict[str, Value]:
    """Return the numbers of the sentence about a loss, the longest of some."""
    longest = f" (longest of {number} times)" if number > 1 else ""
    return {
        "at_s": (loss.t_ns - first_ns) / NANOSECONDS,
        "after_s": (loss.end_ns - first_ns) / NANOSECONDS,
        "lost_s": loss.s,
        "until": f" for {loss.s:.1f} s{longest}" if loss.is_over else longest,
        "number": longest,
        "true_m": loss.m,
        "true_deg": loss.deg,
        "moved_m": loss.moved_m,
    }
