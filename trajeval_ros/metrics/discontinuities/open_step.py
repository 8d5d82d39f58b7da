"""A step that is not yet known to stay or to return."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.discontinuities.events import UNDECIDED
from trajeval_ros.metrics.discontinuities.exoneration import SideVerdict
from trajeval_ros.metrics.discontinuities.relative_motion import Size

_BACK = 1.0 / 3.0  # of a step: a pose that differs by less has returned
_MOST_PAIRS, _THINNED = 400, slice(200, 300)  # pairs that are kept, and those that are dropped
_LESSER = 0.2  # relative to the other part: a smaller part of a step may be noise
_CLEAR = 3.0  # limits: a part of a step that is no noise


@dataclass(eq=False)
class OpenStep:
    """A motion that differs by more than usual, and the pairs since."""

    begin: Floats  # (15,): the last good pair
    size: Size  # the largest so far
    first: Size
    limits: tuple[float, float]  # of the usual differences, metres and deg
    gap_s: float  # time from the last good pair to the first pair after the step
    last_s: float  # time of the last unusual motion
    pairs: list[Floats] = field(default_factory=list)  # the last good one, and those since
    unusual: int = 1
    clock_is_tested: bool = False

    @property
    def after(self) -> Floats:
        """The first pair after the step."""
        return self.pairs[1]

    @property
    def ratio(self) -> float:
        """The size as a multiple of the limits."""
        return ratio_of(self.size, self.limits)

    @property
    def by_parts(self) -> tuple[bool, bool]:
        """Whether it is a step of the position and of the rotation."""
        return by_parts(self.size, self.limits)

    def add(self, pair: Floats, total: Size, *, is_unusual: bool) -> None:
        """Take the next pair; `total`: difference to the last good one."""
        self.pairs.append(pair)
        if len(self.pairs) > _MOST_PAIRS:
            del self.pairs[_THINNED]
        if is_unusual:
            m, deg = max(self.size.m, total.m), max(self.size.deg, total.deg)
            self.size, self.last_s = Size(m, deg), float(pair[0])
            self.unusual += 1

    def is_back(self, total: Size, limits: tuple[float, float]) -> bool:
        """Return whether a pair is on the former path; `limits`: of the usual differences."""
        by_m, by_deg = self.by_parts
        least_m, least_deg = (
            max(size * _BACK, min(limit, size / 2))
            for size, limit in zip(self.size, limits, strict=True)
        )
        return (not by_m or total.m < least_m) and (not by_deg or total.deg < least_deg)

    def has_edge(self, difference: Size) -> bool:
        """Return whether a motion is an edge: a difference that crosses zero is no return."""
        by_m, by_deg = self.by_parts
        return (by_m and difference.m > self.first.m / 2) or (
            by_deg and difference.deg > self.first.deg / 2
        )

    def end_of_motion(self) -> int:
        """Return the row of the pair after the last unusual motion."""
        rows = range(len(self.pairs))
        return next((row for row in rows if self.pairs[row][0] >= self.last_s), len(rows) - 1)


def ratio_of(size: Size, limits: tuple[float, float]) -> float:
    """Return a difference as a multiple of its limits, the larger one of both parts."""
    return max(size.m / limits[0], size.deg / limits[1])


def by_parts(size: Size, limits: tuple[float, float]) -> tuple[bool, bool]:
    """Return whether a step is one of position and of rotation; the lesser one may be noise."""
    m, deg = size.m / limits[0], size.deg / limits[1]
    return (
        m > 1.0 and (m > _LESSER * deg or m > _CLEAR),
        deg > 1.0 and (deg > _LESSER * m or deg > _CLEAR),
    )


def is_back(total: Size, size: Size) -> bool:
    """Return whether a difference is small next to a step, in the parts that the step has."""
    return (not size.m or total.m < _BACK * size.m) and (
        not size.deg or total.deg < _BACK * size.deg
    )


def both_edges(out: SideVerdict, back: SideVerdict) -> SideVerdict:
    """Return the verdict on an excursion by its begin and its end."""
    if out.side == back.side:
        return out
    if out.side in ("", UNDECIDED):
        return dataclasses.replace(back, certainty="likely" if back.side else "")
    if back.side in ("", UNDECIDED):
        return dataclasses.replace(out, certainty="likely")
    return dataclasses.replace(out, side=UNDECIDED, certainty=UNDECIDED)
