"""A fast test of recorded runs: which motions are unusual enough to be discontinuities.

The search takes as much time as the rest of the evaluation. Most recordings have no or few motions
that it would examine, which columns of all pairs show in a hundredth of the time. Motions also
differ if axes, scales or clocks do, or if the estimate diverges, but then neither side changes its
velocity suddenly, so that the search would exonerate both.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices, Stamps, lengths
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.metrics.association import Association
from trajeval_ros.metrics.discontinuities.exoneration import EXONERATES
from trajeval_ros.metrics.discontinuities.open_step import GAP, LEAST_RATIO, calm_s
from trajeval_ros.metrics.discontinuities.pose_stream import innovations
from trajeval_ros.metrics.discontinuities.stamp_steps import SMALLEST_S
from trajeval_ros.metrics.discontinuities.usual_differences import LEAST_DEG, LEAST_M
from trajeval_ros.metrics.statistics import median

_FEW_PAIRS = 500  # the search takes no noticeable time
_BLOCK = 240  # pairs with a common median: as many as the search remembers
# Multiple of the median: fewer than the 6 of the search, since the alignment of all pairs is less
# exact than the search's own.
_OF_MEDIAN = 4.0
# Smallest change of velocity of a guilty side, relative to the limits.
_SUDDEN = LEAST_RATIO * EXONERATES
_NEIGHBOURS = 3  # poses that are compared for a change of velocity


def unusual_times(
    pairs: Association,
    similarity: Similarity,
    groundtruth: Trajectory,
    estimate: Trajectory,
    *,
    in_gaps: bool = False,
) -> Stamps | None:
    """Return the timestamps (K,) of pairs next to which the search can have a result.

    None if it can have one anywhere. `groundtruth`, `estimate`: in the order of their sources, by
    one clock. `similarity`: aligns the pairs. `in_gaps`: clocks may have stepped, and all else is
    usual.
    """
    if len(pairs) < _FEW_PAIRS or any(map(_has_irregular_stamps, (groundtruth, estimate))):
        return None
    true, roots = pairs.groundtruth, _roots_of_steps(pairs.groundtruth.stamps)
    if in_gaps and not (roots > 1.0).any():
        return true.stamps[:0]
    unusual, limits = _unusual_motions(true, similarity.trajectory(pairs.estimate), roots)
    if in_gaps:
        unusual &= roots > 1.0
    times = true.stamps[1:][unusual]
    if not len(times) or has_repeats(groundtruth) or has_repeats(estimate):
        return times  # a repeated pose is a gap
    # The search compares motions until they are usual for this time.
    usual_ns = median(np.diff(true.stamps))
    before_ns = round(GAP * usual_ns)
    after_ns = round(NANOSECONDS * calm_s(usual_ns / NANOSECONDS))
    span = times[0] - before_ns, times[-1] + after_ns
    sudden = [
        _sudden_times(side, span, true.stamps, limits, unit)
        for side, unit in ((groundtruth, 1.0), (estimate, similarity.scale))
    ]
    known = np.sort(np.concatenate(sudden))
    first, last = known.searchsorted([times - before_ns, times + after_ns])
    with_changes: Stamps = times[last > first]
    return with_changes


def _unusual_motions(
    true: Trajectory, aligned: Trajectory, roots: Floats
) -> tuple[Booleans, tuple[Floats, Floats]]:
    """Return which motions (N - 1,) between pairs differ by more than usual, and the limits.

    These are metres and deg; `roots` (N - 1,) of the time steps.
    """
    differences = lengths(np.diff(true.positions - aligned.positions, axis=0))
    unusual, limits_m = _unusual([differences], roots, LEAST_M)
    if true.quaternions is None or aligned.quaternions is None:
        return unusual, (limits_m, np.full(len(roots), np.inf))
    angles = _angles(lie.multiply(lie.conjugate(true.quaternions), aligned.quaternions))
    rotates, limits_deg = _unusual([angles], roots, LEAST_DEG)
    unusual |= rotates
    rows = np.flatnonzero(unusual)
    if len(rows):  # where the alignment does not fit, rotations between the worlds may
        blocks = rows[[0, -1]] // _BLOCK * _BLOCK
        near = slice(max(int(blocks[0]) - _BLOCK, 0), int(blocks[1]) + _BLOCK)
        ends = slice(near.start, near.stop + 1)
        worlds = lie.multiply(true.quaternions[ends], lie.conjugate(aligned.quaternions[ends]))
        steps, true_steps = (np.diff(side.positions[ends], axis=0) for side in (aligned, true))
        moved = lengths(true_steps - lie.rotate(worlds[1:], steps))
        by_m, limits_m[near] = _unusual([differences[near], moved], roots[near], LEAST_M)
        by_deg, limits_deg[near] = _unusual(
            [angles[near], _angles(worlds)], roots[near], LEAST_DEG
        )
        unusual[near] = by_m | by_deg
    return unusual, (limits_m, limits_deg)


def _sudden_times(
    side: Trajectory,
    span: tuple[int, int],
    stamps: Stamps,
    limits: tuple[Floats, Floats],
    unit: float,
) -> Stamps:
    """Return when the velocity of a side changes by a part of the limits, and the ends of gaps.

    They are searched within a span of timestamps. The limits (N - 1,), metres and deg, are those
    between `stamps` (N,), and `unit` is metres per unit of the side.
    """
    begin, end = side.stamps.searchsorted(span)
    rows = slice(max(begin - _NEIGHBOURS, 0), end + _NEIGHBOURS)
    near = side[rows]
    if len(near) < 2:
        return near.stamps
    poses = np.hstack([near.positions, near.known_quaternions])
    steps, by_m, by_deg = innovations(near.seconds, poses)
    at = (stamps.searchsorted(near.stamps[1:]) - 1).clip(0, len(stamps) - 2)
    least_m, least_deg = (_SUDDEN * values[at] for values in limits)
    is_sudden = (unit * by_m >= least_m) | (by_deg >= least_deg) | (steps > GAP * median(steps))
    ends: Stamps = near.stamps[1:][is_sudden]
    return ends


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
    return len(repeated_rows(side)) > 0


def repeated_rows(side: Trajectory) -> Indices:
    """Return the rows that repeat a part of the pose before, but of a constant rotation."""
    rows = _repeats_of(side.positions)
    if side.quaternions is None:
        return rows
    rotations = _repeats_of(side.quaternions)
    return np.append(rows, rotations) if len(rotations) < len(side) - 1 else rows


def _repeats_of(part: Floats) -> Indices:
    """Return the rows of a part (N, K) that are equal to the row before."""
    rows = 1 + np.flatnonzero(part[1:, 0] == part[:-1, 0])  # the first column decides most often
    repeats: Indices = rows[(part[rows] == part[rows - 1]).all(axis=1)]
    return repeats


def _roots_of_steps(stamps: Stamps) -> Floats:
    """Return the roots of the steps (N - 1,) over the usual step, 1 for steps without a gap.

    Differences grow with the root of the time.
    """
    steps = np.diff(stamps).astype(np.float64)
    ratios = steps / max(median(steps), 1.0)
    return np.sqrt(np.where(ratios > GAP, ratios, 1.0))


def _unusual(kinds: Sequence[Floats], roots: Floats, least: float) -> tuple[Booleans, Floats]:
    """Return which changes (N,) exceed the limit about them, and it; `least`: the smallest limit.

    Of several kinds of changes, the one with the smallest median there is compared. The limit
    follows from the changes before, too, since all may grow there.
    """
    count, size = len(roots), min(_BLOCK, len(roots))
    begins = np.minimum(np.arange(0, count, _BLOCK), count - size)
    medians = np.stack([_medians(changes, begins, size) for changes in kinds])
    usual, block_of = medians.min(axis=0), np.arange(count) // _BLOCK
    before = np.append(np.inf, usual[:-1])
    limits = np.maximum(least, _OF_MEDIAN * np.minimum(usual, before))[block_of] * roots
    changes = np.stack(kinds)[medians.argmin(axis=0)[block_of], np.arange(count)]
    return changes > limits, limits


def _medians(values: Floats, begins: Indices, size: int) -> Floats:
    """Return the medians (B,) of as many successive values from each of the begins (B,) on."""
    middle = [(size - 1) // 2, size // 2]
    blocks = np.lib.stride_tricks.sliding_window_view(values, size)[begins]
    return np.asarray(np.partition(blocks, middle, axis=1)[:, middle].mean(axis=1))
