"""What a step that stays is: a restart, a correction, a flip, or another step."""

from __future__ import annotations

import numpy as np

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.metrics.discontinuities.events import CORRECTION, ESTIMATE, RESTART, STEP
from trajeval_ros.metrics.discontinuities.exoneration import SideVerdict
from trajeval_ros.metrics.discontinuities.motion_history import MotionHistory
from trajeval_ros.metrics.discontinuities.open_step import PairStep
from trajeval_ros.metrics.discontinuities.relative_motion import (
    GROUNDTRUTH_POSITION,
    POSITION,
    RelativeMotion,
    Size,
    rotation_beyond,
)
from trajeval_ros.metrics.discontinuities.usual_differences import UsualDifferences
from trajeval_ros.metrics.statistics import median

_LEAST_LATER_M = 0.09  # motion after a flip that shows whether the body is another
_BETTER = 0.7  # of the error against earlier pairs, after a correction
_LEAST_EARLIER_S = 4.0  # of a pair that a correction agrees with


def kind_of_step(
    motion: RelativeMotion,
    history: MotionHistory,
    origin: Floats,
    between: tuple[Floats, Floats],
    size: Size,
    verdict: SideVerdict,
) -> str:
    """Return whether the estimate restarted, was corrected, or made another step.

    `origin`: the estimate's first position (3,). `between`: the pairs before and after the step.
    """
    begin, end = between
    at_origin = is_at_origin(begin[POSITION], end[POSITION], origin, size.m, motion.scale)
    if verdict.side == ESTIMATE and at_origin:
        return RESTART
    marks = [mark for mark in history.marks if begin[0] - mark[0] > _LEAST_EARLIER_S]
    marks = marks[: len(marks) // 2]  # a loop closure agrees with the oldest poses
    if len(marks) > 2:
        earlier = np.array(marks)
        before, after = (median(motion.between(earlier, pair).m) for pair in between)
        if after < _BETTER * before:
            return CORRECTION
    return STEP


def is_at_origin(
    begin: Floats, end: Floats, origin: Floats, size_m: float, scale: float = 1.0
) -> bool:
    """Return whether a step between positions (3,) ends at the first one, or at zero."""
    near_m = scale * min(_distance(end, at) for at in (origin, np.zeros(3)))
    far_m = scale * _distance(begin, origin)
    return near_m < min(max(size_m / 4.0, 0.1), far_m / 3.0)


def rotates_body(
    motion: RelativeMotion, usual: UsualDifferences, step: PairStep, row: int
) -> bool | None:
    """Return whether motions after a flip that stays agree better with a rotated body.

    `row`: the first pair after the flip. Returns None if the later motion is too short to decide.
    """
    if motion.rotation is None or not motion.oriented:
        return None
    end, later = step.pairs[row], np.array(step.pairs[row + 1 :])
    if not len(later):
        return None
    beyond = rotation_beyond(motion, step.begin, end)
    moved = later[:, GROUNDTRUTH_POSITION] - end[GROUNDTRUTH_POSITION]
    later = later[np.linalg.norm(moved, axis=1) > _LEAST_LATER_M][::3]
    if len(later) < 3:
        return False if len(later) else None
    limit_m, limit_deg = usual.limit(later[:, 0] - end[0])
    same, rotated = (
        median(np.maximum(difference.m / limit_m, difference.deg / limit_deg))
        for difference in (
            motion.between(end, later),
            motion.between(end, later, rotation=beyond @ motion.rotation),
        )
    )
    return rotated < same / 2.0


def _distance(one: Floats, other: Floats) -> float:
    return float(np.linalg.norm(one - other))
