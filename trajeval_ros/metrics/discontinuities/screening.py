"""A fast test of recorded runs: which motions are unusual enough to be discontinuities.

The search takes as much time as the rest of the evaluation. Most recordings have no or few motions
that it would examine, which columns of all pairs show in a hundredth of the time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps, lengths
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.association import Association
from trajeval_ros.metrics.discontinuities.open_step import GAP
from trajeval_ros.metrics.discontinuities.stamp_steps import SMALLEST_S
from trajeval_ros.metrics.discontinuities.usual_differences import LEAST_DEG, LEAST_M
from trajeval_ros.metrics.statistics import median

_FEW_PAIRS = 500  # the search takes no noticeable time
_BLOCK = 240  # pairs with a common median: as many as the search remembers
# Multiple of the median: fewer than the 6 of the search, since the alignment of all pairs is less
# exact than the search's own.
_OF_MEDIAN = 4.0


def unusual_times(
    pairs: Association,
    similarity: Similarity,
    groundtruth: Trajectory,
    estimate: Trajectory,
    *,
    in_gaps: bool = False,
) -> Stamps | None:
    """Return the timestamps (K,) of pairs next to which the search can have a result.

    None if it can have one anywhere. `groundtruth`, `estimate`: in the order of their sources.
    `similarity`: aligns the pairs. `in_gaps`: clocks may have stepped, and all else is usual.
    """
    if len(pairs) < _FEW_PAIRS or any(map(_has_irregular_stamps, (groundtruth, estimate))):
        return None
    true, aligned = pairs.groundtruth, similarity.trajectory(pairs.estimate)
    roots = _roots_of_steps(true.stamps)
    differences = [lengths(np.diff(true.positions - aligned.positions, axis=0))]
    unusual = _unusual(differences, roots, LEAST_M)
    if true.quaternions is not None and aligned.quaternions is not None:
        back = lie.conjugate(aligned.quaternions)
        angles = [_angles(lie.multiply(lie.conjugate(true.quaternions), aligned.quaternions))]
        unusual |= _unusual(angles, roots, LEAST_DEG)
        if unusual.any():  # where the alignment does not fit, rotations between the worlds may
            worlds = lie.multiply(true.quaternions, back)
            steps, true_steps = (np.diff(side.positions, axis=0) for side in (aligned, true))
            differences.append(lengths(true_steps - lie.rotate(worlds[1:], steps)))
            angles.append(_angles(worlds))
            unusual = _unusual(differences, roots, LEAST_M) | _unusual(angles, roots, LEAST_DEG)
    if in_gaps:
        unusual &= roots > 1.0
    return true.stamps[1:][unusual]


def _angles(rotations: Floats) -> Floats:
    """Return the angles (N - 1,) between successive rotations (N, 4), deg."""
    cosines = np.abs(np.einsum("ni,ni->n", rotations[1:], rotations[:-1]))
    angles: Floats = np.degrees(2.0 * np.arccos(np.minimum(cosines, 1.0)))
    return angles


def _has_irregular_stamps(side: Trajectory) -> bool:
    """Return whether timestamps go back, or differ from regular receive times."""
    steps = np.diff(side.stamps)
    if steps.min(initial=1) <= 0:
        return True
    received = side.reading.receive_times
    if received is None:
        return False
    more = steps - np.diff(received.times)
    return bool(np.abs(more).max(initial=0) > SMALLEST_S * NANOSECONDS)


def has_repeats(side: Trajectory) -> bool:
    """Return whether a part of a pose is repeated, but for a rotation that never changes."""
    parts = [side.positions] if side.quaternions is None else [side.positions, side.quaternions]
    repeats = [(part[1:] == part[:-1]).all(axis=1) for part in parts]
    return bool(repeats[0].any() or (repeats[-1].any() and not repeats[-1].all()))


def _roots_of_steps(stamps: Stamps) -> Floats:
    """Return the roots of the steps (N - 1,) over the usual step, 1 for steps without a gap.

    Differences grow with the root of the time.
    """
    steps = np.diff(stamps).astype(np.float64)
    ratios = steps / max(median(steps), 1.0)
    return np.sqrt(np.where(ratios > GAP, ratios, 1.0))


def _unusual(kinds: Sequence[Floats], roots: Floats, least: float) -> Booleans:
    """Return which changes (N,) exceed the limit about them; `least`: the smallest limit.

    Of several kinds of changes, the one with the smallest median there is compared. The limit
    follows from the changes before, too, since all may grow there.
    """
    unusual, before = np.empty(len(roots), dtype=bool), np.inf
    for begin in range(0, len(roots), _BLOCK):
        block = slice(max(0, min(begin, len(roots) - _BLOCK)), begin + _BLOCK)
        usual, _, changes = min((median(kind[block]), row, kind) for row, kind in enumerate(kinds))
        rows = slice(begin, begin + _BLOCK)
        unusual[rows] = changes[rows] > max(least, _OF_MEDIAN * min(usual, before)) * roots[rows]
        before = usual
    return unusual
