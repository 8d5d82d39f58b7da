"""Steps that are not yet known to stay or to return, and the rules that both searches share."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats, Indices
from trajeval_ros.metrics.discontinuities.events import UNDECIDED
from trajeval_ros.metrics.discontinuities.exoneration import SideVerdict
from trajeval_ros.metrics.discontinuities.relative_motion import Difference, Size

GAP = 2.5  # periods: a longer step of timestamps is no usual motion
# A step stays after this time, and this number of periods, without an unusual motion: longer
# delays an alarm, shorter takes an outlier for a step.
_CALM_S, _CALM_PERIODS = 1.0, 4.0
_LOST_S, _LOST_MOTIONS = 10.0, 5  # unusual motions without a calm time
RETURN_S, MOST_STAYED = 60.0, 8  # longest excursion whose return is known, and steps kept
# Smallest rotation of a flip, since corrections of a heading are smaller, and largest motion of
# the centre of a marker that flips.
FLIP_DEG, FLIP_M = 60.0, 0.3
# Smallest events, as multiples of the limit: single poses of heavy-tailed noise exceed 1.5.
LEAST_RATIO, LEAST_RATIO_OF_OUTLIER = 1.5, 2.5
_BACK = 1.0 / 3.0  # of a step: a pose that differs by less has returned
_MOST_PAIRS, _THINNED = 400, slice(200, 300)  # pairs that are kept, and those that are dropped
_LESSER = 0.2  # relative to the other part: a smaller part of a step may be noise
_CLEAR = 3.0  # limits: a part of a step that is no noise


class OpenStep:
    """Unusual motions without a calm time among them."""

    def __init__(self, size: Size, limits: tuple[float, float], at_s: float, gap_s: float) -> None:
        """Create it with the first unusual motion, which ends at `at_s`, perhaps after a gap."""
        self.size = self.first_size = size  # the largest so far, and the first
        self.limits = limits  # of the usual differences, metres and deg
        self.last_s, self.gap_s = at_s, gap_s
        self.unusual = 1

    def grow(self, size: Size, at_s: float) -> None:
        """Take the next unusual motion."""
        self.size = Size(*map(max, self.size, size))
        self.last_s = at_s
        self.unusual += 1

    @property
    def ratio(self) -> float:
        """The size as a multiple of the limits."""
        return ratio_of(self.size, self.limits)

    @property
    def by_parts(self) -> tuple[bool, bool]:
        """Whether it is a step of the position and of the rotation."""
        return by_parts(self.size, self.limits)

    @property
    def parts(self) -> Size:
        """The size in the parts that jump, and 0 in the other one."""
        by_m, by_deg = self.by_parts
        return Size(self.size.m if by_m else 0.0, self.size.deg if by_deg else 0.0)


class PairStep(OpenStep):
    """A motion of one side against the other one that differs by more than usual."""

    def __init__(
        self, begin: Floats, after: Floats, size: Size, limits: tuple[float, float]
    ) -> None:
        """Create it with the last good pair (15,) and the first one after it."""
        super().__init__(size, limits, float(after[0]), float(after[0] - begin[0]))
        self.begin = begin
        self.pairs = [begin, after]  # the last good one, and those since
        self.clock_is_tested = False

    @property
    def after(self) -> Floats:
        """The first pair after the step."""
        return self.pairs[1]

    def add(self, pairs: Floats) -> None:
        """Take the next pairs (N, 15)."""
        for pair in pairs:
            self.pairs.append(pair)
            if len(self.pairs) > _MOST_PAIRS:
                del self.pairs[_THINNED]

    def are_back(
        self,
        sizes: Sequence[Floats],
        totals: Difference,
        limits: tuple[Floats, Floats],
        motions: Difference,
    ) -> Booleans:
        """Return at which of N pairs the poses return to the former path.

        There, the difference to the last good pair is small, and the motion is an edge: a
        difference that crosses zero is no return. `sizes`: (2, N) of the step before, metres and
        deg; `limits`: of the usual `totals`.
        """
        parts = _larger_parts(
            *(size / most for size, most in zip(sizes, self.limits, strict=True))
        )
        is_near, is_edge = np.ones(len(totals.m), dtype=bool), np.zeros(len(totals.m), dtype=bool)
        for kind, by_part in enumerate(parts):
            size = sizes[kind]
            least = np.maximum(size * _BACK, np.minimum(limits[kind], size / 2))
            is_near &= ~by_part | (totals[kind] < least)
            is_edge |= by_part & (motions[kind] > self.first_size[kind] / 2)
        return is_near & is_edge

    def end_of_motion(self) -> int:
        """Return the row of the pair after the last unusual motion."""
        rows = range(len(self.pairs))
        return next((row for row in rows if self.pairs[row][0] >= self.last_s), len(rows) - 1)


def is_lost(lasted_s: Floats | float, unusual: Indices | int) -> Booleans | bool:
    """Return whether poses (...) neither return nor calm down for a time with unusual motions."""
    return (lasted_s > _LOST_S) & (unusual > _LOST_MOTIONS)


def calm_s(period_s: float) -> float:
    """Return the time without unusual motions after which a step stays."""
    return max(_CALM_S, _CALM_PERIODS * period_s)


def ratio_of(size: Size, limits: tuple[float, float]) -> float:
    """Return a difference as a multiple of its limits, the larger one of both parts."""
    return max(size.m / limits[0], size.deg / limits[1])


def by_parts(size: Size, limits: tuple[float, float]) -> tuple[bool, bool]:
    """Return whether a step is one of position and of rotation; the lesser one may be noise."""
    by_m, by_deg = _larger_parts(size.m / limits[0], size.deg / limits[1])
    return bool(by_m), bool(by_deg)


def _larger_parts(m: Any, deg: Any) -> tuple[Any, Any]:
    """Return which of the parts (...), as multiples of their limits, are no noise."""
    return (
        (m > 1.0) & ((m > _LESSER * deg) | (m > _CLEAR)),
        (deg > 1.0) & ((deg > _LESSER * m) | (deg > _CLEAR)),
    )


def is_back(total: Size, size: Size) -> bool:
    """Return whether a difference is small next to a step, in the parts that the step has."""
    return (not size.m or total.m < _BACK * size.m) and (
        not size.deg or total.deg < _BACK * size.deg
    )


def is_flip(size: Size, *, holds_position: bool = False) -> bool:
    """Return whether a step is one of the rotation: the position holds, or hardly moves."""
    return size.deg > FLIP_DEG and (size.m < FLIP_M or holds_position)


def both_edges(out: SideVerdict, back: SideVerdict) -> SideVerdict:
    """Return the verdict on an excursion by its begin and its end.

    An edge at which both sides move smoothly leaves doubt about a side that is only likely.
    """
    if out.side == back.side:
        return out
    doubtful, other = (out, back) if out.side in ("", UNDECIDED) else (back, out)
    if not other.side:
        return other
    if doubtful.side not in ("", UNDECIDED) or (not doubtful.side and other.certainty != "sure"):
        return dataclasses.replace(other, side=UNDECIDED, certainty=UNDECIDED)
    return dataclasses.replace(other, certainty="likely")
