"""Tests by exact equality of timestamps, rows and files."""

from __future__ import annotations

import re

import numpy as np

from trajeval_ros.diagnosis.both_sides import Recording
from trajeval_ros.diagnosis.evidence import Examined, Seen, Value
from trajeval_ros.diagnosis.motion_track import MotionTrack, lengths
from trajeval_ros.diagnosis.short_motions import best_rotations
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.thinning import evenly
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.metrics.statistics import median

_PROBES = 400
_ENOUGH = 5000  # timestamps for the test of rounding
_FEWEST_POSES = 30
# Largest extent of a body at rest, as a fraction of the other side's, and least extent of motion,
# in units of the source.
_STILL_SHARE, _MOVED = 1e-5, 0.3
_TRUE_NAMES = re.compile(
    r"(ground.?truth|\bgt\b|_gt\b|\bgt_|vicon|mocap|optitrack|leica|vrpn)", re.I
)
_ESTIMATED_NAMES = re.compile(
    r"(vio\b|vins|slam|odometry|\bodom|openvins|rovio|okvis|msckf|estimate|kimera|svo\b)", re.I
)


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
        share = repeats / min(_PROBES, len(track))
        scores[f"{side} share"] = share
        if repeats >= max(10, 0.02 * _PROBES) and extent > 1e-3 * _travelled(track.positions):
            values: dict[str, Value] = {
                "side": side,
                "percent": 100.0 * share,
                "rows_apart": float(rows_apart),
            }
            seen.append(Seen("duplicated", min(1.0, share), values))
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


def same_motion(recording: Recording) -> Examined:
    """Compare positions at equal timestamps, as read and after a rigid fit."""
    if not recording.by_time:
        return Examined("same file", why_not="poses are paired by row index")
    truth, track = recording.in_order
    if min(len(truth), len(track)) < 10:
        return Examined("same file", why_not="too few poses")
    rows = evenly(len(track), _PROBES)
    seconds = track.seconds[rows]
    after = np.clip(np.searchsorted(truth.seconds, seconds), 1, len(truth) - 1)
    before_is_nearer = seconds - truth.seconds[after - 1] < truth.seconds[after] - seconds
    nearest = np.where(before_is_nearer, after - 1, after)
    known = np.abs(truth.seconds[nearest] - seconds) < 2e-6
    estimate, true = track.positions[rows][known], truth.positions[nearest[known]]
    if len(true) < 10:
        return Examined("same file", why_not="no equal timestamps")
    # The median tolerates repeated timestamps with another pose.
    apart = median(lengths(true - estimate))
    a, b = estimate - estimate.mean(axis=0), true - true.mean(axis=0)
    size = float(np.sqrt(np.mean(np.sum(b * b, axis=1))))
    turned = best_rotations(b.T @ a)[1]
    fitted = float(np.sqrt(np.mean(np.sum((b - a @ turned.T) ** 2, axis=1))))
    left = min(apart, fitted)
    scores = {"difference_m": left}
    if size > 0.0 and left < max(2e-6, 1e-6 * size):
        return Examined("same file", scores, (Seen("identical", 1.0, {"difference_m": left}),))
    return Examined("same file", scores)


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
    """Test whether the names of the sources contradict their roles."""
    truth, estimate = (
        each.source.rsplit("/", 1)[-1] or each.name
        for each in (recording.groundtruth, recording.estimate)
    )
    swapped = (
        _ESTIMATED_NAMES.search(truth)
        and _TRUE_NAMES.search(estimate)
        and not _TRUE_NAMES.search(truth)
        and not _ESTIMATED_NAMES.search(estimate)
    )
    if not swapped:
        return Examined("source names")
    values: dict[str, Value] = {
        "groundtruth": recording.groundtruth.source or recording.groundtruth.name,
        "estimate": recording.estimate.source or recording.estimate.name,
    }
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
