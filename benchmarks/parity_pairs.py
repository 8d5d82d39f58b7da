"""Writes small trajectory pairs, groundtruth and estimate, that programs are compared on.

Everything is generated from seeds. Text with 9 decimals: TUM (`stamp x y z qx qy qz qw`) and KITTI
(3 x 4 matrices, row-major). Stamps are whole nanoseconds until they are written, so that
differences of stamps are exactly those intended. Without a seed the pairs are those of
tests/data/parity; the last digits may differ from one C library or numpy to the next.

Usage: python -m benchmarks.parity_pairs FOLDER [SEED]
"""

from __future__ import annotations

import sys
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
Poses = tuple[Array, Array]
Motion = Callable[[Stamps], Poses]
Frame = tuple[Sequence[float], Sequence[float]]
Random = np.random.Generator

NS = 1_000_000_000
EPOCH = 1_500_000_000 * NS + 123_456_789  # a float64 holds such seconds to 2.4e-7 s
FRAME: Frame = ([0.3, -1.1, 2.0], [12.0, -7.0, 3.0])  # an estimate's: rotation vector, translation


def turn(rotation_vectors: ArrayLike) -> Array:
    """Return unit quaternions (N, 4), xyzw, of rotation vectors (N, 3), rad."""
    vectors = np.atleast_2d(np.asarray(rotation_vectors, dtype=float))
    half = 0.5 * np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.hstack([0.5 * np.sinc(half / np.pi) * vectors, np.cos(half)])


def times(a: Array, b: Array) -> Array:
    """Return the products of quaternions, xyzw."""
    v, w, x, y = a[:, :3], a[:, 3:], b[:, :3], b[:, 3:]
    real = w * y - np.sum(v * x, axis=1, keepdims=True)
    return np.hstack([w * x + y * v + np.cross(v, x), real])


def matrices(q: Array) -> Array:
    """Return rotation matrices (N, 3, 3) of unit quaternions, xyzw."""
    v, w = q[:, :3], q[:, 3, None, None]
    cross = np.cross(v[:, None, :], np.eye(3)[None])  # rows are v x e_i: the transpose of [v]x
    outer = v[:, :, None] * v[:, None, :]
    dot = np.sum(v * v, axis=1)[:, None, None]
    rotated: Array = (w * w - dot) * np.eye(3) + 2.0 * outer + 2.0 * w * np.swapaxes(cross, 1, 2)
    return rotated


def flight(stamps: Stamps, size: float = 4.0, period_s: float = 17.0) -> Poses:
    """Return positions (N, 3) and quaternions (N, 4) of a smooth loop that never repeats."""
    phase = 2.0 * np.pi * (stamps - EPOCH) / NS / period_s
    p = np.column_stack([np.sin(phase), 0.8 * np.sin(1.7 * phase), 0.3 * np.sin(0.9 * phase + 1)])
    yaw = turn(np.outer(1.3 * phase, [0, 0, 1]))
    tilt = turn(np.column_stack([0.2 * np.sin(3 * phase), 0.3 * np.cos(2 * phase), 0 * phase]))
    return size * p, times(yaw, tilt)


@dataclass(frozen=True)
class Noise:
    """Standard deviations: white of each pose, and of what drifts in one second."""

    white_m: float = 0.01
    drift_m: float = 0.02
    white_deg: float = 0.2
    drift_deg: float = 0.3


USUAL = Noise()


def observed(rng: Random, stamps: Stamps, p: Array, q: Array, noise: Noise = USUAL) -> Poses:
    """Add white noise, and drift of position and heading by the root of the time in seconds."""
    step = np.sqrt(np.diff(stamps, prepend=stamps[0]).clip(0) / NS)[:, None]
    bend = np.cumsum(np.radians(noise.drift_deg) * step * rng.normal(size=(len(p), 1)), axis=0)
    yaw = turn(bend * [[0.0, 0.0, 1.0]])
    moves = np.diff(p, axis=0, prepend=p[:1])
    path = p[:1] + np.cumsum(np.einsum("nij,nj->ni", matrices(yaw), moves), axis=0)
    path = path + np.cumsum(noise.drift_m * step * rng.normal(size=p.shape), axis=0)
    shake = turn(np.radians(noise.white_deg) * rng.normal(size=p.shape))
    return path + noise.white_m * rng.normal(size=p.shape), times(times(yaw, q), shake)


def moved(
    p: Array,
    q: Array,
    rotation_vector: Sequence[float],
    translation: Sequence[float],
    scale: float = 1.0,
) -> Poses:
    """Return poses as another world frame, turned, shifted and scaled, has them."""
    rotation = turn(rotation_vector)
    p = scale * p @ matrices(rotation)[0].T + translation
    return p, times(np.repeat(rotation, len(q), axis=0), q)


def write_tum(path: Path, stamps: Stamps, p: Array, q: Array, decimals: int = 9) -> None:
    """Write stamps (N,), ns, positions and quaternions."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w") as file:
        for stamp, row in zip(np.asarray(stamps).tolist(), np.hstack([p, q]), strict=True):
            whole, rest = divmod(stamp, NS)
            numbers = " ".join(f"{number:.{decimals}f}" for number in row)
            file.write(f"{whole}.{rest // 10 ** (9 - decimals):0{decimals}d} {numbers}\n")


def write_kitti(path: Path, p: Array, q: Array, frames: Stamps | None = None) -> None:
    """Write matrices (12 columns), after the number of each frame (13 columns) if given."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = np.concatenate([matrices(q), p[:, :, None]], axis=2).reshape(-1, 12)
    with path.open("w") as file:
        for index, row in enumerate(rows):
            lead = "" if frames is None else f"{frames[index]} "
            file.write(lead + " ".join(f"{number:.9f}" for number in row) + "\n")


def at(rate_hz: float, duration_s: float, start_ns: int = 0) -> Stamps:
    """Return even stamps, ns."""
    count = round(rate_hz * duration_s)
    return EPOCH + start_ns + np.arange(count, dtype=np.int64) * round(NS / rate_hz)


def jittered(rng: Random, stamps: Stamps, sigma_s: float) -> Stamps:
    """Return stamps that are late or early at random, still in order."""
    return np.sort(stamps + np.rint(sigma_s * NS * rng.normal(size=len(stamps))).astype(np.int64))


def write_pair(
    folder: Path,
    rng: Random,
    gt: Stamps,
    est: Stamps,
    path: Motion = flight,
    frame: Frame = FRAME,
    scale: float = 1.0,
    noise: Noise = USUAL,
) -> None:
    """Write groundtruth and estimate of one path at their stamps."""
    write_tum(folder / "gt.txt", gt, *path(gt))
    seen = observed(rng, est, *path(est), noise)
    write_tum(folder / "est.txt", est, *moved(*seen, *frame, scale=scale))


def ordinary(folder: Path, rng: Random) -> None:
    """Write pairs as robots record them."""
    level: Frame = ([0.0, 0.0, 1.2], [3.0, -2.0, 0.5])
    write_pair(folder / "drone_loop", rng, at(100, 40), at(20, 39, 503_000_000), frame=level)
    gt, est = jittered(rng, at(50, 40), 1e-3), jittered(rng, at(15, 40), 4e-3)
    s, e = (gt - EPOCH) / NS, (est - EPOCH) / NS
    gt = gt[~((s > 9) & (s < 10.3)) & ~((s > 24) & (s < 27.5))]
    est = est[(e > 1) & ~((e > 14) & (e < 16)) & ~((e > 26) & (e < 31))]
    write_pair(folder / "handheld_gaps", rng, gt, est, lambda stamps: flight(stamps, 1.5, 7.0))
    write_pair(folder / "mono_scale", rng, at(20, 30), at(20, 30, 1_700_000), scale=0.37)
    est = EPOCH + np.cumsum(rng.integers(200_000_000, 2_500_000_000, 58))
    write_pair(folder / "keyframes", rng, at(20, 80), est, noise=Noise(drift_m=0.005))
    write_pair(folder / "slow_gt", rng, at(2, 40), jittered(rng, at(20, 40), 2e-3))
    gt, est = at(10, 30), at(5, 30, 2_000_000)
    utm = np.array([512_345.678, 5_234_567.891, 431.25])
    write_tum(folder / "utm/gt.txt", gt, flight(gt, 60)[0] + utm, flight(gt, 60)[1])
    p, q = observed(rng, est, *flight(est, 60))
    write_tum(folder / "utm/est.txt", est, *moved(p, q, [0, 0, -0.7], [1.0, 2.0, 3.0]))
    write_tum(folder / "utm/est_utm.txt", est, p + utm, q)
    for name, wiggle_m in (("straight", 1.0), ("straight_flat", 0.01)):

        def road(stamps: Stamps, wiggle_m: float = wiggle_m) -> Poses:
            s = 8.0 * (stamps - EPOCH) / NS
            p = np.column_stack([s, wiggle_m * np.sin(s / 20), 0.5 * wiggle_m * np.cos(s / 31)])
            return p, turn(np.outer(wiggle_m / 20 * np.cos(s / 20), [0, 0, 1]))

        write_pair(
            folder / name,
            rng,
            gt,
            est,
            road,
            noise=Noise(white_m=0.05, drift_m=0.0, drift_deg=0.0),
        )


def car(folder: Path, rng: Random) -> None:
    """Write a car as in KITTI: z forward, x to the right, y down; it stops once on its 1.3 km."""
    count = 580
    k = np.arange(count)
    speed = np.where((k > 250) & (k < 290), 0.0, 24 + 5 * np.sin(k / 40))
    heading = 1.6 * np.sin(k / 90) + 0.4 * np.sin(k / 23)
    heading[251:290] = heading[250]
    q = turn(np.outer(heading, [0, 1, 0]))
    steps = 0.1 * speed[:, None] * matrices(q)[:, :, 2] + np.outer(np.sin(k / 50), [0, 0.02, 0])
    p = np.cumsum(steps, axis=0) - steps[0]
    write_kitti(folder / "car_kitti/gt.txt", p, q)
    drift = np.cumsum(np.radians(0.01) * rng.normal(size=(count, 3)) + [0, 2e-5, 1e-5], axis=0)
    p = np.cumsum(1.004 * np.einsum("nij,nj->ni", matrices(turn(drift)), steps), axis=0)
    p, q = p - p[0] + 0.003 * rng.normal(size=p.shape), times(turn(drift), q)
    write_kitti(folder / "car_kitti/est.txt", p, q)
    kept = np.flatnonzero((rng.random(count) > 0.03) & ~((k > 400) & (k < 425)) | (k == 0))
    write_kitti(folder / "car_kitti/est_frames.txt", p[kept], q[kept], kept)
    (folder / "car_kitti/times.txt").write_text("".join(f"{0.1 * item:.9f}\n" for item in k))


def odd_stamps(folder: Path, rng: Random) -> None:
    """Write pairs that tell one rule of association from another."""
    gt, est = at(50, 9.6), at(25, 9.6)
    est[1::2] += 3_000_000  # the others' stamps are groundtruth's very own
    truth, seen = flight(gt), observed(rng, est, *flight(est))
    gt_swaps = np.r_[240:360, 0:240, 360:480]  # parts change places; of the estimate, neighbours
    est_swaps = np.arange(240) ^ (np.arange(240) // 10 % 2)
    for name, stamps, (p, q), swaps, repeats in (
        ("gt", gt, truth, gt_swaps, [0, 48, 100, 100, 123, 300, 411, 479]),
        ("est", est, seen, est_swaps, [0, 7, 7, 100, 239]),
    ):
        write_tum(folder / f"stamp_order/{name}.txt", stamps, p, q)
        write_tum(folder / f"stamp_order/{name}_unsorted.txt", stamps[swaps], p[swaps], q[swaps])
        rows = np.sort([*range(len(stamps)), *repeats])
        again = np.append(False, np.diff(rows) == 0)[:, None]  # later rows are elsewhere
        p = p[rows] + again * rng.normal(size=(len(rows), 3))
        write_tum(folder / f"stamp_order/{name}_repeated.txt", stamps[rows], p, q[rows])
    gt = at(10, 24)
    limits = np.tile([10_000_000, -10_000_000, 20_000_000, -20_000_000], 60)
    about = rng.choice([0, 1, -1, 50, -50, 119, -119, 239, -239, 500, -500, 1000, -1000], 240)
    write_pair(folder / "limit_stamps", rng, gt, gt + limits + about)  # evo's 10 ms, RPG's 20 ms
    write_pair(folder / "half_period", rng, at(50, 10), at(50, 10, 10_000_000))
    lines = (folder / "half_period/gt.txt").read_text().splitlines(keepends=True)
    (folder / "half_period/gt_parts.txt").write_text("".join(lines[250:] + lines[:250]))


def odd_numbers(folder: Path, rng: Random) -> None:
    """Write quaternions of either sign and of few digits, and very few poses."""
    gt, est = at(20, 15), at(10, 15, 1_000_000)
    truth, seen = flight(gt), observed(rng, est, *flight(est))
    for name, digits, sign in (("quaternion_flips", 9, -1.0), ("few_digits", 4, 1.0)):
        for file, stamps, (p, q) in (("gt.txt", gt, truth), ("est.txt", est, seen)):
            flips = np.where(rng.random((len(q), 1)) < 0.4, sign, 1.0)
            write_tum(folder / name / file, stamps, p, flips * q, digits)
    write_pair(folder / "five_poses", rng, at(2, 2.5), at(2, 2.5, 1_000_000))


def write_pairs(folder: Path, seed: int | None = None) -> None:
    """Write all pairs; without a seed, those that tests/data/parity has."""
    for make in (ordinary, car, odd_stamps, odd_numbers):
        name = zlib.crc32(make.__name__.encode())
        make(folder, np.random.default_rng([name] if seed is None else [name, seed]))


if __name__ == "__main__":
    write_pairs(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else None)
