"""Checks of single poses and of an IMU by the groundtruth quality check, in cases by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from examined_rigs import START_NS
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from trajeval_ros.calibration.groundtruth_quality.inertial_steps import ImuSeconds
from trajeval_ros.calibration.groundtruth_quality.sample_checks import (
    PoseSpan,
    ResidualChecks,
    check_poses,
    check_residuals,
)  # fmt: skip
from trajeval_ros.calibration.groundtruth_quality.start import turns_in_place
from trajeval_ros.geometry.trajectory import Trajectory

Array = NDArray[np.float64]


def walking(count: int = 200, step_ns: int = 10_000_000) -> tuple[Array, Array, Array]:
    """Return stamps, positions at 1 m/s and turns at 0.5 rad/s."""
    stamps = START_NS + step_ns * np.arange(count)
    seconds = (stamps - START_NS) / 1e9
    return stamps, np.outer(seconds, [1.0, 0.0, 0.0]), np.outer(seconds, [0.0, 0.0, 0.5])


def poses_of(stamps: Any, positions: Array, turns: Array) -> Trajectory:
    return Trajectory(stamps, positions, Rotation.from_rotvec(turns).as_quat())


def turning_imu(rate: float = 0.5) -> ImuSeconds:
    """Return an IMU that turns in its second half only, so that the median rate is zero."""
    seconds = np.arange(0.0, 4.0, 0.005)
    rates = np.zeros((800, 3))
    rates[::2, 2] = rate
    rates[1::2, 2] = -rate
    return ImuSeconds(seconds, rates, np.zeros((800, 3)))


def test_gaps_and_missing_poses_by_hand() -> None:
    stamps, positions, rotations = walking()
    kept = np.ones(200, dtype=bool)
    kept[50:60] = kept[100:102] = kept[150] = False
    result = check_poses(poses_of(stamps[kept], positions[kept], rotations[kept]), None, START_NS)
    assert result.rate_hz == pytest.approx(100.0)
    # A gap is longer than 0.1 s: the first one has 0.11 s.
    assert result.gaps == (PoseSpan(int(stamps[49]), 0.11),)
    assert result.missing_share == pytest.approx(13 / 200)
    assert result.repeated_stamps == 0
    assert result.interval_sigma_s == 0.0
    assert result.held_share == 0.0
    assert result.frozen == ()
    assert result.position_noise_m == pytest.approx(0.0, abs=1e-12)
    # Slow poses: a gap is longer than five usual steps.
    slow = 10 * (stamps - START_NS) + START_NS
    kept[:] = True
    kept[50:54] = kept[100:105] = False
    result = check_poses(poses_of(slow[kept], positions[kept], rotations[kept]), None, START_NS)
    assert result.gaps == (PoseSpan(int(slow[99]), 0.6),)


def test_repeated_stamps_count_in_order_of_arrival() -> None:
    stamps, positions, rotations = walking(50)
    stamps[10], stamps[20] = stamps[9], stamps[18] + 1
    result = check_poses(poses_of(stamps, positions, rotations), None, START_NS)
    assert result.repeated_stamps == 2


def test_uneven_intervals_have_a_robust_deviation() -> None:
    stamps, positions, rotations = walking(401)
    # Intervals of 9, 10 and 11 ms: the median absolute deviation is 1 ms.
    steps = np.tile([9, 11, 9, 11, 10], 80) * 1_000_000
    stamps = START_NS + np.concatenate([[0], np.cumsum(steps)])
    result = check_poses(poses_of(stamps, positions, rotations), None, START_NS)
    assert result.interval_sigma_s == pytest.approx(1.4826e-3)
    # Intervals of one and a half steps are missing poses, not deviations.
    stamps = START_NS + np.concatenate([[0], np.cumsum(np.tile([10, 10, 20], 134)[:400] * 10**6)])
    result = check_poses(poses_of(stamps, positions, rotations), None, START_NS)
    assert result.interval_sigma_s == 0.0
    assert result.missing_share == pytest.approx(133 / (401 + 133))


def test_held_and_frozen_poses_by_hand() -> None:
    stamps, positions, rotations = walking(400)
    positions[100:110], rotations[100:110] = positions[100], rotations[100]
    positions[200:221], rotations[200:221] = positions[200], rotations[200]
    positions[300:319], rotations[300:319] = positions[300], rotations[300]
    motion = poses_of(stamps, positions, rotations)
    result = check_poses(motion, None, START_NS)
    # Runs of 9, 20 and 18 steps; from 0.2 s on they are frozen.
    assert result.frozen == (PoseSpan(int(stamps[200]), 0.2),)
    assert result.held_share == pytest.approx(27 / 399, abs=1.5 / 399)
    rotated = poses_of(stamps, positions, walking(400)[2])
    assert check_poses(rotated, None, START_NS).held_share == 0.0
    bare = Trajectory(stamps, positions)
    assert check_poses(bare, None, START_NS).frozen == result.frozen
    # An IMU that does not turn does not confirm it, one above 0.05 rad/s does.
    for rate, count in ((0.04, 0), (0.06, 1)):
        assert len(check_poses(motion, turning_imu(rate), START_NS).frozen) == count


def test_poses_at_rest_are_not_held() -> None:
    stamps, positions, rotations = walking(400)
    # 15 mm/s is slower than what counts as moving.
    positions *= 0.015
    positions[100:110], rotations[100:110] = positions[100], rotations[100]
    assert check_poses(poses_of(stamps, positions, rotations), None, START_NS).held_share == 0.0


def test_white_noise_is_measured_beside_smooth_motion() -> None:
    generator = np.random.default_rng(0)
    stamps, positions, rotations = walking(20_000)
    positions = positions + np.sin(positions) + generator.normal(scale=1e-3, size=positions.shape)
    rotated = Rotation.from_rotvec(rotations) * Rotation.from_rotvec(
        generator.normal(scale=2e-3, size=positions.shape)
    )
    result = check_poses(Trajectory(stamps, positions, rotated.as_quat()), None, START_NS)
    # A median of 60,000 correlated values has a standard deviation of about 1 %.
    assert result.position_noise_m == pytest.approx(1e-3, rel=0.03)
    assert result.rotation_noise_rad == pytest.approx(2e-3, rel=0.03)


def residual_checks(
    positions: Array, speeds: Array, rotations: Array | None = None
) -> ResidualChecks:
    """Check errors (N, 3) of positions (m) and of rotations (rad) at 100 Hz, of noise 1e-3."""
    count = len(positions)
    fit = SimpleNamespace(
        predicted=SimpleNamespace(
            rows=np.arange(count), position_errors=positions, rotation_errors=rotations,
            marker_velocities=speeds, rates=np.roll(speeds, 1, axis=0),
        ),
        samples=SimpleNamespace(has_rotations=rotations is not None),
        rig=SimpleNamespace(body=Rotation.from_rotvec([0.2, 0.4, -1.0]).as_matrix()),
        rows=SimpleNamespace(scales=(1e-3, 1e-3)),
    )  # fmt: skip
    if rotations is None:
        fit.predicted.rotation_errors = np.zeros((count, 3))
    return check_residuals(fit, START_NS + 10_000_000 * np.arange(count))  # type: ignore[arg-type]


def test_jitter_is_the_excess_of_errors_along_the_motion() -> None:
    generator = np.random.default_rng(1)
    speeds, along, errors = generator.normal(size=(3, 6000, 3))
    errors *= 1e-3
    assert abs(residual_checks(errors, speeds).jitter_sigmas) < 4.0
    jitter_s = 5e-4
    errors += jitter_s * along[:, :1] * speeds
    result = residual_checks(errors, speeds)
    assert result.jitter_s == pytest.approx(jitter_s, rel=0.08)
    assert result.jitter_sigmas > 10.0
    # What stands still shows none.
    assert residual_checks(errors, 0.0 * speeds).jitter_s == 0.0


def test_residuals_of_both_kinds_are_checked() -> None:
    """Errors of 1,000 samples, with jumps of position, one of rotation, and an outlier."""
    generator = np.random.default_rng(4)
    positions, rotations = 1e-3 * generator.normal(size=(2, 1000, 3))
    speeds = generator.normal(size=(1000, 3))
    positions[400:] += [0.05, 0.0, 0.0]
    rotations[700:] += [0.0, 0.03, 0.0]
    rotations[50] += 0.1
    result = residual_checks(positions, speeds, rotations)
    assert [jump.kind for jump in result.jumps] == ["position", "rotation"]
    for jump, row, size in zip(result.jumps, (400, 700), (0.05, 0.03), strict=True):
        assert abs(jump.stamp_ns - (START_NS + 10_000_000 * row)) <= 40_000_000
        assert jump.size == pytest.approx(size, rel=0.05)
    assert result.outlier_share == pytest.approx(1 / 1000)
    assert result.noisy_steps == ()
    assert abs(result.jitter_sigmas) < 4.0
    alone = residual_checks(positions, speeds)
    assert [jump.kind for jump in alone.jumps] == ["position"]
    assert alone.outlier_share == 0.0
    # Noise has no steps and no outliers, however large it is.
    large = residual_checks(100.0 * generator.normal(size=(1000, 3)), speeds)
    assert (large.jumps, large.outlier_share) == ((), 0.0)
    # A residual that decays on both sides of a step is extrapolated to it.
    at = np.arange(-500, 500)
    decaying = np.where(at < 0, -1.0, 1.0) * np.exp(-np.abs(at + 0.5) / 20.0)
    [jump] = residual_checks(np.outer(0.02 * decaying, [1.0, 0.0, 0.0]), speeds).jumps
    assert jump.size == pytest.approx(0.04, rel=0.02)
    # So many jumps are noise that is not white.
    for first in (100, 200, 300):
        positions[first:] += [0.05, 0.0, 0.0]
    assert residual_checks(positions, speeds).noisy_steps == ("position",)


def test_turning_in_place_needs_both() -> None:
    generator = np.random.default_rng(0)
    rates = generator.normal(size=(1000, 3)) * [0.05, 0.09, 1.0]
    still = np.zeros((10, 3))
    assert turns_in_place(still, rates)
    assert not turns_in_place(still, rates * [1.0, 1.3, 1.0] + [0.0, 0.0, 5.0])
    moving = 0.16 * np.tile([[1.0, 1.0, 1.0], [-1.0, -1.0, -1.0]], (5, 1))
    assert turns_in_place(moving * 1.0, rates)  # 0.277 m
    assert not turns_in_place(moving * 1.2, rates)
