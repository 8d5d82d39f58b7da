"""Faults of single poses: those of a groundtruth alone, and those that a fit shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trajeval_ros.calibration.groundtruth_quality.inertial_steps import ImuSeconds
from trajeval_ros.calibration.groundtruth_quality.joint_fit import JointFit
from trajeval_ros.calibration.groundtruth_quality.sample_rows import MEDIAN_OF_CHI3
from trajeval_ros.calibration.robust_fit import BLOCKS
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices, Stamps, runs_of
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory

_GAP_S, _USUAL_STEPS = 0.1, 5.0
_SPEED_S, _MOVING_MPS = 0.25, 0.02
_FROZEN_S, _TURNING_RADPS = 0.2, 0.05
_NORMAL = 1.4826  # standard deviation over the median absolute deviation
_THIRD = np.sqrt(20.0)  # standard deviation of third differences of white noise
_HALF = 7  # samples before and after a jump
# Weights of them that extrapolate a line by half a step.
_LINE = 1.0 / _HALF - 3.5 / 28.0 * np.arange(-3.0, 4.0)
_LEAST_JUMP = (5e-3, float(np.radians(0.3)))  # m, rad
_JUMP_SIGMAS = 8.0
_OF_MEDIANS = 0.67  # standard deviation of the difference of two medians of 7 normal errors
_MOST_JUMPS_PER_MINUTE = 20.0  # more steps are noise that is not white
_OUTLIER_SIGMAS = 8.0
_SLOWEST = 0.05  # m/s or rad/s; slower samples do not show errors of timestamps


class PoseSpan(NamedTuple):
    """An interval of time."""

    start_ns: int  # by the groundtruth's clock
    duration_s: float


class GroundtruthJump(NamedTuple):
    """A step of the groundtruth."""

    stamp_ns: int  # of the first pose after it, by the groundtruth's clock
    kind: str  # `position` or `rotation`
    size: float  # metres or radians


@dataclass(frozen=True)
class PoseChecks:
    """Faults of the poses of a groundtruth alone."""

    rate_hz: float
    gaps: tuple[PoseSpan, ...]
    missing_share: float  # poses that the rate requires and that are missing
    repeated_stamps: int  # equal or decreasing timestamps
    interval_sigma_s: float  # robust standard deviation of the intervals
    held_share: float  # repeated poses in motion, in runs below 0.2 s
    frozen: tuple[PoseSpan, ...]  # longer runs of repeated poses
    position_noise_m: float  # standard deviation per axis, above a quarter of the rate
    rotation_noise_rad: float | None


def check_poses(groundtruth: Trajectory, imu: ImuSeconds | None, origin: int) -> PoseChecks:
    """Check the poses in order of arrival; frozen ones are confirmed by an IMU that turns.

    `origin` is the timestamp of the IMU's second 0, ns.
    """
    ordered = groundtruth.in_order()
    seconds, positions = (ordered.stamps - origin) / NANOSECONDS, ordered.positions
    steps = np.diff(ordered.stamps) / NANOSECONDS
    usual = float(np.median(steps))
    missing = int(np.maximum(np.rint(steps / usual) - 1.0, 0.0).sum())
    shorter = steps[steps < 1.5 * usual]
    columns = [item for item in (positions, ordered.quaternions) if item is not None]
    same: Booleans = np.logical_not(np.diff(np.hstack(columns), axis=0).any(axis=1))
    width = min(max(3, int(_SPEED_S / usual)), len(steps))
    speeds = np.linalg.norm(np.diff(positions, axis=0), axis=1) / steps
    moving = np.convolve(speeds, np.ones(width) / width, "same") > _MOVING_MPS
    held, runs = np.zeros(len(same), dtype=bool), runs_of(same)
    is_long = np.diff(seconds[runs])[:, 0] >= max(_FROZEN_S, _USUAL_STEPS * usual)
    for begin, end in runs[~is_long]:
        held[begin:end] = True
    frozen = [imu is None or _turns(imu, *seconds[run]) for run in runs[is_long]]
    fresh = np.concatenate([[True], ~same])
    rotation_noise = None
    if ordered.quaternions is not None:
        some = ordered.quaternions[fresh]
        rotated = lie.rotation_vector(lie.multiply(lie.conjugate(some[:-1]), some[1:]))
        rotation_noise = _noise(np.diff(rotated, n=2, axis=0))
    gaps = np.flatnonzero(steps > max(_GAP_S, _USUAL_STEPS * usual))
    return PoseChecks(
        rate_hz=1.0 / usual,
        gaps=spans_of(ordered.stamps, np.column_stack([gaps, gaps + 1])),
        missing_share=missing / (len(ordered) + missing),
        repeated_stamps=int(np.count_nonzero(np.diff(groundtruth.stamps) <= 0)),
        interval_sigma_s=_NORMAL * float(np.median(np.abs(shorter - usual))),
        held_share=float((held & moving).sum() / max(1, moving.sum())),
        frozen=spans_of(ordered.stamps, runs[is_long][np.asarray(frozen, dtype=bool)]),
        position_noise_m=_noise(np.diff(positions[fresh], n=3, axis=0)),
        rotation_noise_rad=rotation_noise,
    )


def spans_of(stamps: Stamps, rows: Indices) -> tuple[PoseSpan, ...]:
    """Return the intervals between two rows each, (K, 2)."""
    pairs = stamps[rows].tolist()
    return tuple(PoseSpan(start, (end - start) / NANOSECONDS) for start, end in pairs)


def _noise(differences: Floats) -> float:
    """Return the standard deviation of white noise from its third differences (N, 3)."""
    return float(_NORMAL * np.median(np.abs(differences)) / _THIRD) if len(differences) else 0.0


def _turns(imu: ImuSeconds, start_s: float, end_s: float) -> bool:
    within = (imu.seconds > start_s) & (imu.seconds < end_s)
    rates = imu.rates[within] - np.median(imu.rates, axis=0)
    return bool(len(rates)) and float(np.linalg.norm(rates, axis=1).mean()) > _TURNING_RADPS


@dataclass(frozen=True)
class ResidualChecks:
    """Faults of the poses that the residuals of a fit show."""

    jitter_s: float  # standard deviation of random errors of the timestamps
    jitter_sigmas: float  # significance of its square
    outlier_share: float
    jumps: tuple[GroundtruthJump, ...]
    noisy_steps: tuple[str, ...]  # kinds with so many steps that they are noise


def check_residuals(fit: JointFit, stamps: Stamps) -> ResidualChecks:
    """Check the residuals of a fit of the groundtruth with timestamps (N,), which increase."""
    result = fit.predicted
    kinds = [
        ("position", result.position_errors, result.marker_velocities),
        ("rotation", result.rotation_errors @ fit.rig.body.T, result.rates),
    ][: 1 + fit.samples.has_rotations]
    stamps = stamps[result.rows]
    minutes = float(stamps[-1] - stamps[0]) / NANOSECONDS / 60.0
    jumps: list[GroundtruthJump] = []
    noisy, outliers = [], []
    jitters = [
        _jitter(*item[1:], scale) for item, scale in zip(kinds, fit.rows.scales, strict=False)
    ]
    squared, sigma = min(jitters, key=lambda jitter: jitter[1])
    jitter_s = float(np.sqrt(max(squared, 0.0)))
    for (kind, errors, speeds), least in zip(kinds, _LEAST_JUMP, strict=False):
        timing = jitter_s * np.linalg.norm(speeds, axis=1)
        outliers.append(_outliers(errors, least, timing))
        rows, sizes = _steps(errors, least, timing)
        if len(rows) > max(_MOST_JUMPS_PER_MINUTE * minutes, 1.0):
            noisy.append(kind)
            continue
        pairs = zip(stamps[rows].tolist(), sizes.tolist(), strict=True)
        jumps += [GroundtruthJump(stamp, kind, size) for stamp, size in pairs]
    return ResidualChecks(
        jitter_s=jitter_s,
        jitter_sigmas=squared / sigma,
        outlier_share=float(np.any(outliers, axis=0).mean()),
        jumps=tuple(sorted(jumps)),
        noisy_steps=tuple(noisy),
    )


def _jitter(errors: Floats, speeds: Floats, scale: float) -> tuple[float, float]:
    """Return the variance of the timestamps' errors, s^2, and its standard deviation.

    A wrong timestamp is an error along the velocity (N, 3). The errors (N, 3) across it are
    those without it.
    """
    speed = np.linalg.norm(speeds, axis=1)
    used = (speed > _SLOWEST) & (np.linalg.norm(errors, axis=1) < _OUTLIER_SIGMAS * scale)
    if not used.any():
        return 0.0, np.inf
    errors, speed = errors[used], speed[used]
    along = np.einsum("ni,ni->n", errors, speeds[used]) / speed
    excess = 1.5 * along**2 - 0.5 * np.square(errors).sum(axis=1)
    block = np.arange(len(speed)) * BLOCKS // len(speed)
    products = np.bincount(block, excess * speed**2, BLOCKS)
    weights = np.bincount(block, speed**4, BLOCKS)
    total = float(weights.sum())
    variance = float(products.sum()) / total
    scatter = np.square(products - variance * weights).sum() * BLOCKS / (BLOCKS - 1)
    return variance, max(float(np.sqrt(scatter)) / total, 1e-30)


def _outliers(errors: Floats, least: float, timing: Floats) -> Booleans:
    """Return which residuals (N, 3) differ from the median of their neighbours.

    `timing` (N,) is the standard deviation of residuals by errors of the timestamps.
    """
    around = np.pad(errors, [(_HALF, _HALF), (0, 0)], mode="reflect")
    apart = np.linalg.norm(errors - _medians(around, 2 * _HALF + 1), axis=1)
    usual = np.hypot(float(np.median(apart)) / MEDIAN_OF_CHI3, timing)
    return np.asarray(apart > np.maximum(_OUTLIER_SIGMAS * usual, least))


def _medians(rows: Floats, width: int) -> Floats:
    """Return the medians of `width` successive rows (N, 3), (N - width + 1, 3)."""
    windows = np.lib.stride_tricks.sliding_window_view(rows, width, axis=0)
    return np.asarray(np.median(windows, axis=2))


def _steps(errors: Floats, least: float, timing: Floats) -> tuple[Indices, Floats]:
    """Return rows after steps of residuals (N, 3), and the sizes of the steps; see `_outliers`.

    The fitted trajectory is continuous, so a step of the residuals is one of the groundtruth.
    Medians before and after detect it. The fit follows it, so that residuals decay on both sides:
    its size is that between lines, extrapolated to the step.
    """
    if len(errors) < 4 * _HALF:
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    medians = _medians(errors, _HALF)
    steps = medians[_HALF:] - medians[:-_HALF]
    lengths = np.linalg.norm(steps, axis=1)
    scale = float(np.median(lengths)) / MEDIAN_OF_CHI3
    windows = np.lib.stride_tricks.sliding_window_view(errors, _HALF, axis=0)
    sizes = np.linalg.norm(windows[_HALF:] @ _LINE - windows[:-_HALF] @ _LINE[::-1], axis=1)
    sizes = np.maximum(sizes, lengths)
    usual = np.hypot(scale, _OF_MEDIANS * timing[_HALF : len(timing) - _HALF + 1])
    large = np.flatnonzero((lengths > _JUMP_SIGMAS * usual) & (sizes > least))
    groups: Sequence[Indices] = np.split(large, np.flatnonzero(np.diff(large) > 3 * _HALF) + 1)
    largest = np.array(
        [group[lengths[group].argmax()] for group in groups if len(group)], dtype=int
    )
    return largest + _HALF, sizes[largest]
