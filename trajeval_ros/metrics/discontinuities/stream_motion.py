"""Motions of one stream against those before and after them, at constant velocity."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices, lengths
from trajeval_ros.metrics.discontinuities.relative_motion import Size

_ALIASED_RAD = np.pi / 2.0  # rotation within one period whose direction is not certain


class StreamMotions(NamedTuple):
    """Motions between N pairs of rows, and how they differ from the motions around them."""

    begins: Indices
    ends: Indices
    seconds: Floats
    m: Floats
    deg: Floats
    step_m: Floats  # (N, 3), what the nearest motion around does not explain
    rotation: Floats  # (N, 4), the same in the body
    mps: Floats
    degps: Floats


@dataclass(frozen=True, eq=False)
class StreamMotion:
    """One unusual motion between successive poses."""

    begin_s: float
    end_s: float
    known_s: float  # time of the next pose
    gap_s: float  # its duration if that is a gap, else 0
    begin: Floats  # (7,), poses before and after it
    end: Floats
    size: Size
    step_m: Floats  # (3,)
    rotation: Floats  # (4,)
    over: Size  # difference of the next pose to the path before it


class _Velocities:
    """Velocities, rad/s in the body, of the steps between successive rows."""

    def __init__(self, stamps: Floats, poses: Floats, low: int, high: int) -> None:
        self.low, some = low, poses[low:high]
        self.seconds = np.diff(stamps[low:high])[:, None]
        vectors = lie.rotation_vector(lie.multiply(lie.conjugate(some[:-1, 3:]), some[1:, 3:]))
        self.mps = np.diff(some[:, :3], axis=0) / self.seconds
        self.radps = vectors / self.seconds
        angles = lengths(vectors)
        self.is_clear: Booleans = angles < _ALIASED_RAD

    def to(self, rows: Indices) -> tuple[Floats, Floats, Booleans]:
        """Return the velocities of the steps that end at rows, and whether they are known."""
        steps = rows - self.low - 1
        known = (steps >= 0) & (steps < len(self.seconds))
        steps = np.clip(steps, 0, len(self.seconds) - 1)
        return self.mps[steps], self.radps[steps], known


def stream_motions(
    stamps: Floats, poses: Floats, begins: Indices, ends: Indices, longest_s: float
) -> StreamMotions:
    """Return the motions between pairs of rows (N,), in ascending order of `ends`.

    A motion that takes more than `longest_s` may also be a rest.
    """
    low, high = max(int(begins.min()) - 1, 0), min(int(ends.max()) + 2, len(stamps))
    velocities = _Velocities(stamps, poses, low, high)
    seconds = stamps[ends] - stamps[begins]
    moved = poses[ends, :3] - poses[begins, :3]
    rotated = lie.multiply(lie.conjugate(poses[begins, 3:]), poses[ends, 3:])
    step_m, rotation = moved, rotated
    m, deg = lengths(moved), np.degrees(lie.angle(rotated))
    mps, degps = m / seconds, deg / seconds
    may_rest = seconds > longest_s
    m, deg = np.where(may_rest, m, np.inf), np.where(may_rest, deg, np.inf)
    for rows in (begins, ends + 1):
        at_mps, at_radps, known = velocities.to(rows)
        other = moved - at_mps * seconds[:, None]
        other_m = lengths(other)
        nearer = known & (other_m < m)
        m, step_m = np.where(nearer, other_m, m), np.where(nearer[:, None], other, step_m)
        predicted = lie.from_rotation_vector(at_radps * seconds[:, None])
        beyond = lie.multiply(lie.conjugate(predicted), rotated)
        other_deg = np.degrees(lie.angle(beyond))
        is_clear = velocities.is_clear[np.clip(rows - low - 1, 0, len(velocities.is_clear) - 1)]
        nearer = known & is_clear & (other_deg < deg)
        deg = np.where(nearer, other_deg, deg)
        rotation = np.where(nearer[:, None], beyond, rotation)
    m, deg = (np.where(np.isfinite(values), values, 0.0) for values in (m, deg))
    return StreamMotions(begins, ends, seconds, m, deg, step_m, rotation, mps, degps)


def one_motion(
    stamps: Floats, poses: Floats, motions: StreamMotions, number: int, longest_s: float
) -> StreamMotion:
    """Return one of N motions that have a pose after them; `longest_s` as for `stream_motions`."""
    begin, end = int(motions.begins[number]), int(motions.ends[number])
    size = Size(float(motions.m[number]), float(motions.deg[number]))
    over = size
    if begin > 0:
        rows = np.array([begin]), np.array([end + 1])
        both = stream_motions(stamps[: end + 2], poses[: end + 2], *rows, np.inf)
        over = Size(float(both.m[0]), float(both.deg[0]))
    begin_s, end_s, known_s = stamps[[begin, end, end + 1]].tolist()
    return StreamMotion(
        begin_s,
        end_s,
        known_s,
        end_s - begin_s if end_s - begin_s > longest_s else 0.0,
        poses[begin].copy(),
        poses[end].copy(),
        size,
        motions.step_m[number],
        motions.rotation[number],
        over,
    )


def against_earlier(stamps: Floats, poses: Floats, motion: StreamMotion, row: int) -> StreamMotion:
    """Return a motion against the one that ends at an earlier row, in place of those around it.

    Next to an unusual motion, a usual one seems unusual.
    """
    seconds = motion.end_s - motion.begin_s
    velocities = _Velocities(stamps, poses, row - 1, row + 1)
    step_m = motion.end[:3] - motion.begin[:3] - velocities.mps[0] * seconds
    rotated = lie.multiply(lie.conjugate(motion.begin[3:]), motion.end[3:])
    predicted = lie.from_rotation_vector(velocities.radps[0] * seconds)
    rotation = lie.multiply(lie.conjugate(predicted), rotated)
    size = Size(float(lengths(step_m)), float(np.degrees(lie.angle(rotation))))
    return replace(motion, size=size, step_m=step_m, rotation=rotation)
