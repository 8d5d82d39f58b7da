"""Tests by exact equality of timestamps, rows and files."""

from __future__ import annotations

import numpy as np

from trajeval_ros.diagnosis.both_sides import Recording
from trajeval_ros.diagnosis.evidence import Examined, Seen, Value
from trajeval_ros.diagnosis.motion_track import MotionTrack, lengths
from trajeval_ros.diagnosis.short_motions import best_rotations
from trajeval_ros.formatting.source_roles import (
    is_named_estimate,
    is_named_groundtruth,
    own_name,
)
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.thinning import evenly
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.statistics import median

_PROBES = 400
_ENOUGH = 5000  # timestamps for the test of rounding
_FEWEST_POSES = 30
# Equal positions: tolerance of timestamps, least number and share of poses with a partner, share
# of them that is equal, decimals of text files, and relative error of an interpolation.
_SAME_S = 2e-6
_FEWEST_EQUAL, _SHARED, _NEARLY_ALL_PERCENT = 3, 0.5, 90.0
_DECIMALS = range(3, 10)
_ROUNDING = 4.0 * float(np.finfo(np.float64).eps)
# After a rigid fit: least number of poses, and largest difference as a fraction of the extent.
_FEWEST_FITTED, _FITTED_SHARE = 10, 1e-6
# Largest extent of a body at rest, as a fraction of the other side's, and least extent of motion,
# in units of the source.
_STILL_SHARE, _MOVED = 1e-5, 0.3


def rounded_stamps(recording: Recording) -> Examined:
    """Test for rounded timestamps that several poses share."""
    seen = []
    for side, track, read in (
        ("estimate", recording.track, recording.estimate),
        ("groundtruth", recording.truth, recording.groundtruth),
    ):
        first = read.stamps[:_ENOUGH] / NANOSECONDS
        step_s = next(
            (
                step
                for step in (1.0, 0.5, 0.1)
                if (np.abs(first / step - np.rint(first / step)) < 1e-4).all()
            ),
            0.0,
        )
        if not step_s or len(track) < 10:
            continue
        seconds = read.stamps / NANOSECONDS
        stamps, counts = np.unique(seconds, return_counts=True)
        shared = median(counts)
        moving = float(np.mean(np.any(np.diff(track.positions, axis=0) != 0.0, axis=1)))
        if shared >= 2.0 and moving > 0.5:
            if len(stamps) > 1:
                step_s = max(step_s, float(np.diff(stamps).min()))
            values: dict[str, Value] = {"side": side, "step_s": step_s, "poses_per_stamp": shared}
            seen.append(Seen("stamps_rounded", 1.0, values))
    return Examined("rounded stamps", seen=tuple(seen))


def duplicated_rows(recording: Recording) -> Examined:
    """Test for blocks of moving poses that occur twice, bit by bit, at one distance in rows."""
    seen: list[Seen] = []
    scores: dict[str, float] = {}
    for side, track in _sides(recording):
        if len(track) < _FEWEST_POSES:
            continue
        repeats, rows_apart, extent = _repeats(track)
        share = min(1.0, repeats / min(_PROBES, len(track)))
        scores[f"{side} share"] = share
        if repeats >= max(10, 0.02 * _PROBES) and extent > 1e-3 * _travelled(track.positions):
            values: dict[str, Value] = {
                "side": side,
                "percent": 100.0 * share,
                "rows_apart": float(rows_apart),
            }
            seen.append(Seen("duplicated", share, values))
    return Examined("duplicated rows", scores, tuple(seen))


def _repeats(track: MotionTrack) -> tuple[int, int, float]:
    """Return the number of repeated probes of 400, their distance in rows, and their extent."""
    count = len(track)
    probes = evenly(count, _PROBES)
    # Candidates by a hash table of the first coordinate, which is faster than a sort.
    bits = np.ascontiguousarray(track.positions[:, 0]).view(np.int64)
    bits = (bits ^ (bits >> 23)) & 0x3FFFF
    table = np.zeros(0x40000, dtype=bool)
    table[bits[probes]] = True
    some = np.flatnonzero(table[bits])
    if len(some) > 20_000:
        some = some[:: len(some) // 20_000 + 1]
    rows = track.positions[some]
    if track.quaternions is not None:
        rows = np.concatenate([rows, track.quaternions[some]], axis=1)
    order = np.lexsort((some, rows[:, 1], rows[:, 0]))
    same = (rows[order[1:]] == rows[order[:-1]]).all(axis=1)
    first, second = np.sort([some[order[:-1]][same], some[order[1:]][same]], axis=0)
    far = second - first > 5
    first, second = first[far], second[far]
    if len(first) < 10:
        return 0, 0, 0.0
    # A copied block repeats at one distance; a body at rest repeats at all distances.
    distances, numbers = np.unique(second - first, return_counts=True)
    most = int(np.argmax(numbers))
    again = first[second - first == distances[most]]
    extent = float(np.linalg.norm(np.ptp(track.positions[again], axis=0)))
    return int(numbers[most]), int(distances[most]), extent


def same_positions(recording: Recording) -> Examined:
    """Test whether the positions of both sides are equal at equal timestamps, or in equal rows.

    They are equal as written, or up to rounding after a rigid transformation.
    """
    test = "same positions"
    truth, track = recording.in_order if recording.by_time else (recording.truth, recording.track)
    few, many = sorted((truth, track), key=len)
    rows = same = evenly(len(few), _PROBES)
    where = "in equal rows"
    if recording.by_time:
        where = "at equal timestamps"
        place = np.searchsorted(many.seconds, few.seconds[rows] - _SAME_S).clip(0, len(many) - 1)
        known = np.abs(many.seconds[place] - few.seconds[rows]) < _SAME_S
        rows, same = rows[known], place[known]
    elif len(few) != len(many):
        return Examined(test, why_not="the numbers of rows differ")
    if len(rows) < max(_FEWEST_EQUAL, _SHARED * min(len(few), _PROBES)):
        return Examined(test, why_not=f"too few poses {where}")
    one, other = few.positions[rows], many.positions[same]
    percent = 100.0 * _equal(one, other)
    if percent < _NEARLY_ALL_PERCENT and len(rows) >= _FEWEST_FITTED:
        percent, where = 100.0 * _equal_when_fitted(one, other), f"{where}, after a rigid fit,"
    moves = bool(np.ptp(one, axis=0).any())
    if not moves or percent < _NEARLY_ALL_PERCENT:
        return Examined(test, {"percent": percent})
    values: dict[str, Value] = {"percent": percent, "where": where}
    return Examined(test, {"percent": percent}, (Seen("identical", 1.0, values),))


def _equal(one: Floats, other: Floats) -> float:
    """Return the share of equal rows (N, 3); one side may have fewer digits than the other."""
    size = max(float(np.abs(one).max()), float(np.abs(other).max()))
    written = [(one, other)]
    for decimals in _DECIMALS:
        written += [(one.round(decimals), other), (one, other.round(decimals))]
    # An interpolation at a groundtruth timestamp differs by rounding.
    return max(float(np.mean((np.abs(a - b) <= _ROUNDING * size).all(axis=1))) for a, b in written)


def _equal_when_fitted(one: Floats, other: Floats) -> float:
    """Return the share of rows (N, 3) that are equal up to rounding after a rigid fit."""
    a, b = one - one.mean(axis=0), other - other.mean(axis=0)
    size = float(np.sqrt(np.mean(np.sum(b * b, axis=1))))
    turned = best_rotations(b.T @ a)[1]
    return float(np.mean(lengths(b - a @ turned.T) < _FITTED_SHARE * size))


def standing_still(recording: Recording) -> Examined:
    """Test for a side that does not move while the other one moves."""
    sizes = {side: _travelled(track.positions) for side, track in _sides(recording)}
    still = min(sizes, key=lambda side: sizes[side])
    moving = max(sizes.values())
    scores = {f"{side} path": size for side, size in sizes.items()}
    if min(map(len, (recording.truth, recording.track))) < 10 or moving < _MOVED:
        return Examined("standing still", scores, why_not="neither side moves")
    if sizes[still] > _STILL_SHARE * moving:
        return Examined("standing still", scores)
    values: dict[str, Value] = {"side": still, "other": _other(still), "path_m": moving}
    return Examined("standing still", scores, (Seen("stands_still", 1.0, values),))


def swapped_names(recording: Recording) -> Examined:
    """Test whether the name of the estimate says groundtruth, and the groundtruth's does not."""
    truth, estimate = (
        each.source or each.name for each in (recording.groundtruth, recording.estimate)
    )
    own = own_name(estimate)
    # A folder can name the groundtruth, as in `state_groundtruth_estimate0/data.csv`.
    says_groundtruth = is_named_groundtruth(own) and not is_named_estimate(own)
    if not says_groundtruth or not truth or is_named_groundtruth(truth):
        return Examined("source names")
    values: dict[str, Value] = {"groundtruth": truth, "estimate": estimate}
    return Examined("source names", seen=(Seen("swapped", 0.0, values),))


def _sides(recording: Recording) -> list[tuple[str, MotionTrack]]:
    return [("estimate", recording.track), ("groundtruth", recording.truth)]


def _other(side: str) -> str:
    return "groundtruth" if side == "estimate" else "estimate"


def _travelled(positions: Floats) -> float:
    """Return the extent of a path without outliers."""
    some = positions[evenly(len(positions), _PROBES)]
    outliers = len(some) // 50
    ranked = np.sort(some, axis=0)
    return float(np.linalg.norm(ranked[len(some) - 1 - outliers] - ranked[outliers]))
