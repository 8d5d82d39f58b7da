"""Discontinuities of two pose streams, as events."""

from __future__ import annotations

from dataclasses import dataclass

GROUNDTRUTH, ESTIMATE, BOTH, UNDECIDED = "groundtruth", "estimate", "both", "undecided"
SIDES = GROUNDTRUTH, ESTIMATE

# Kinds. An outlier and a flip return to the former path; the others of this line stay.
OUTLIER, FLIP, STEP, RESTART, CORRECTION = "outlier", "flip", "step", "restart", "correction"
FLIP_STAYS, FROZEN_POSITION, FROZEN_ROTATION = "flip_stays", "frozen_position", "frozen_rotation"
CLOCK_STEP, LOST, GAP = "clock_step", "lost", "gap"  # gaps are events of one stream alone
FROZEN, DIVERGED = "frozen", "diverged"  # of the whole pose: the estimate is lost
# Kinds that end a part of the estimate that one alignment fits.
PARTING = STEP, RESTART
DECLARED = "declared"  # certainty of a reset that the estimator states itself
EXCURSIONS = OUTLIER, FLIP  # kinds that return to the former path
FREEZES = FROZEN_POSITION, FROZEN_ROTATION
ROUNDING_NS = 1000  # of an event's times
# Multiple of the limit of usual differences from which on a step needs attention while a run
# lasts, when its share of the error is not known.
_LARGE = 6.0


@dataclass
class Event:
    """A discontinuity. A frozen part extends its event while it lasts."""

    kind: str
    side: str  # `groundtruth`, `estimate`, `both` (clocks) or `undecided`
    t_ns: int  # timestamp of the last good pose before it
    end_ns: int  # timestamp of the first good pose after it
    m: float = 0.0  # what the other side did not move, metres; of a frozen part: what it moved
    deg: float = 0.0  # what the other side did not rotate, deg
    s: float = 0.0  # size of a clock's step, or duration, seconds
    poses: int = 0  # number of poses outside of the path
    certainty: str = "likely"  # `sure`, `likely` or `undecided`; live also `declared`
    ratio: float = 0.0  # size as a multiple of the limit of the usual differences
    gap_s: float = 0.0  # gap of the guilty side in which it is, seconds
    # Largest change of both sides' own velocities there, as fractions of the size.
    innovations: tuple[float, float] = (0.0, 0.0)

    @property
    def size(self) -> str:
        """What it moved and rotated, as in `0.31 m and 4 deg`; "" if it is no step."""
        sizes = ((self.m, f"{self.m:.2f} m"), (self.deg, f"{self.deg:.0f} deg"))
        return " and ".join(text for value, text in sizes if value)

    @property
    def is_large(self) -> bool:
        """Whether it is beyond all usual differences."""
        return self.ratio >= _LARGE


@dataclass
class Loss(Event):
    """A time in which the whole pose did not follow the other side; it is extended while it lasts.

    `m` and `deg` are the largest motion of the other side since the begin of a frozen pose; of a
    divergence, `m` is the path of the other side.
    """

    moved_m: float = 0.0  # path of a diverging estimate, in the groundtruth's unit
    is_over: bool = False  # whether it has followed again
