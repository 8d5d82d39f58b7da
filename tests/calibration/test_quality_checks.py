"""Checks of single poses and of an IMU by the groundtruth quality check, in cases by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from examined_rigs import START_NS
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from trajeval_ros.calibration.groundtruth_quality.examine import _difference
from trajeval_ros.calibration.groundtruth_quality.inertial_steps import ImuSeconds
from trajeval_ros.calibration.groundtruth_quality.repair import _with_bridges
from trajeval_ros.calibration.groundtruth_quality.sample_checks import (
    PoseSpan,
    _jitter,
    _noise,
    _outliers,
    _steps,
    check_poses,
    check_residuals,
)  # fmt: skip
from trajeval_ros.calibration.groundtruth_quality.sample_rows import _weights
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
    assert _noise(np.empty((0, 3))) == 0.0


def test_jitter_is_the_excess_of_errors_along_the_motion() -> None:
    generator = np.random.default_rng(1)
    count, jitter_s, sigma_m = 6000, 4e-3, 1e-3
    speeds = generator.normal(size=(count, 3))
    errors = sigma_m * generator.normal(size=(count, 3))
    without, _ = _jitter(errors, speeds, sigma_m)
    errors += jitter_s * generator.normal(size=(count, 1)) * speeds
    variance, sigma = _jitter(errors, speeds, 0.1)  # all errors are used
    assert variance == pytest.approx(jitter_s**2, rel=0.15)
    assert abs(variance - jitter_s**2) < 4.0 * sigma
    # The sampling error of a variance of Gaussians is sqrt(2 / N) or more.
    assert 0.5 * np.sqrt(2.0 / count) < sigma / jitter_s**2 < 5.0 * np.sqrt(2.0 / count)
    assert abs(without) < 1e-7
    # Slow samples and outliers show nothing.
    slow = 0.049 * speeds / np.linalg.norm(speeds, axis=1, keepdims=True)
    assert _jitter(errors, slow, sigma_m) == (0.0, np.inf)
    far = 8.1 * sigma_m * np.ones((count, 3)) / np.sqrt(3.0)
    assert _jitter(far, speeds, sigma_m) == (0.0, np.inf)
    near = 7.9 * sigma_m * np.ones((count, 3)) / np.sqrt(3.0)
    assert np.isfinite(_jitter(near, speeds, sigma_m)[1])


def test_jitter_by_hand() -> None:
    speeds = np.tile([2.0, 0.0, 0.0], (24, 1))
    along = np.tile([0.02, -0.02], 12)
    errors = np.column_stack([along, np.full(24, 0.01), np.zeros(24)])
    # 1.5 * 4e-4 - 0.5 * 5e-4 m^2 over 4 m^2/s^2.
    variance, sigma = _jitter(errors, speeds, 0.1)
    assert variance == pytest.approx(3.5e-4 / 4.0)
    assert sigma == pytest.approx(0.0, abs=1e-15)
    # Twelve blocks of two, one of which is different.
    errors[:2, 0] = 0.0
    variance, sigma = _jitter(errors, speeds, 0.1)
    expected = (11 * 3.5e-4 - 0.5e-4) / 12 / 4.0
    assert variance == pytest.approx(expected)
    blocks = 2.0 * 4.0 * np.array([-0.5e-4, *[3.5e-4] * 11]) - 2.0 * 16.0 * expected
    scatter = np.sqrt(np.square(blocks).sum() * 12.0 / 11.0) / (24 * 16.0)
    assert sigma == pytest.approx(scatter)


def test_outliers_differ_from_their_neighbours() -> None:
    generator = np.random.default_rng(2)
    errors = 1e-3 * generator.normal(size=(400, 3)) + [0.5, 0.0, 0.0]
    errors[200:] += 0.05  # a step is no outlier
    bad = [0, 8, 100, 391, 399]  # also the first and the last
    errors[bad] += [0.03, 0.0, 0.0]
    exact = np.zeros(400)
    assert np.flatnonzero(_outliers(errors, 5e-3, exact)).tolist() == bad
    assert np.flatnonzero(_outliers(errors, 0.02, exact)).tolist() == bad
    assert not _outliers(errors, 0.04, exact).any()
    # Noise of 10 mm: the limit is eight standard deviations.
    large = 1e-2 * generator.normal(size=(400, 3))
    large[[50, 300]] = [[0.0, 0.065, 0.0], [0.0, 0.0, 0.1]]
    assert np.flatnonzero(_outliers(large, 5e-3, exact)).tolist() == [300]
    # Errors of timestamps explain what is fast.
    timing = np.where(np.arange(400) < 50, 0.01, 0.0)
    assert np.flatnonzero(_outliers(errors, 5e-3, timing)).tolist() == bad[2:]


def test_steps_of_residuals_by_hand() -> None:
    generator = np.random.default_rng(3)
    errors = 1e-4 * generator.normal(size=(300, 3))
    errors[100:] += [0.02, 0.0, 0.0]
    errors[200:] -= [0.0, 0.01, 0.0]
    exact = np.zeros(300)
    rows, sizes = _steps(errors, 5e-3, exact)
    assert rows.tolist() == pytest.approx([100, 200], abs=4)
    np.testing.assert_allclose(sizes, [0.02, 0.01], rtol=0.05)
    rows, sizes = _steps(errors, 0.015, exact)
    assert len(rows) == 1
    assert not len(_steps(errors, 0.025, exact)[0])
    assert not len(_steps(errors[93:120], 5e-3, exact[:27])[0])  # fewer than 28 samples
    assert len(_steps(errors[93:121], 5e-3, exact[:28])[0]) == 1
    # Errors of timestamps explain what is fast: here, up to the first step.
    rows, _ = _steps(errors, 5e-3, np.where(np.arange(300) < 120, 0.01, 0.0))
    assert rows.tolist() == pytest.approx([200], abs=4)
    # Steps of noise are none, however large it is.
    assert not len(_steps(100.0 * generator.normal(size=(300, 3)), 5e-3, exact)[0])
    # A residual that decays on both sides of a step is extrapolated to it.
    at = np.arange(-150, 150)
    decaying = np.where(at < 0, -1.0, 1.0) * np.exp(-np.abs(at + 0.5) / 20.0)
    rows, sizes = _steps(np.outer(0.02 * decaying, [1.0, 0.0, 0.0]), 5e-3, exact)
    assert rows.tolist() == pytest.approx([150], abs=1)
    assert sizes[0] == pytest.approx(0.04, rel=0.02)


def test_residuals_of_both_kinds_are_checked() -> None:
    """Errors of position and rotation of 1,000 samples at 100 Hz, with a jump of each."""
    generator = np.random.default_rng(4)
    count = 1000
    stamps = START_NS + 10_000_000 * np.arange(count)
    positions = 1e-3 * generator.normal(size=(count, 3))
    rotations = 1e-3 * generator.normal(size=(count, 3))
    positions[400:] += [0.05, 0.0, 0.0]
    rotations[700:] += [0.0, 0.03, 0.0]
    rotations[50] += 0.1
    body = Rotation.from_rotvec([0.2, 0.4, -1.0]).as_matrix()
    speeds = generator.normal(size=(2, count, 3))
    fit = SimpleNamespace(
        predicted=SimpleNamespace(
            rows=np.arange(count),
            position_errors=positions,
            rotation_errors=rotations,
            marker_velocities=speeds[0],
            rates=speeds[1],
        ),
        samples=SimpleNamespace(has_rotations=True),
        rig=SimpleNamespace(body=body),
        rows=SimpleNamespace(scales=(1e-3, 1e-3)),
    )
    result = check_residuals(fit, stamps)  # type: ignore[arg-type]
    kinds = {jump.kind: jump for jump in result.jumps}
    assert len(result.jumps) == 2
    assert abs(kinds["position"].stamp_ns - int(stamps[400])) <= 40_000_000
    assert kinds["position"].size == pytest.approx(0.05, rel=0.05)
    assert abs(kinds["rotation"].stamp_ns - int(stamps[700])) <= 40_000_000
    assert kinds["rotation"].size == pytest.approx(0.03, rel=0.05)
    assert [jump.stamp_ns for jump in result.jumps] == sorted(
        jump.stamp_ns for jump in result.jumps
    )
    assert result.outlier_share == pytest.approx(1 / count)
    assert result.noisy_steps == ()
    assert abs(result.jitter_sigmas) < 4.0
    fit.samples.has_rotations = False
    alone = check_residuals(fit, stamps)  # type: ignore[arg-type]
    assert [jump.kind for jump in alone.jumps] == ["position"]
    assert alone.outlier_share == 0.0
    # More than 20 jumps a minute are noise: at 10 s, four.
    for first in (100, 200, 300):
        positions[first:] += [0.05, 0.0, 0.0]
    assert check_residuals(fit, stamps).noisy_steps == ("position",)  # type: ignore[arg-type]


def test_weights_of_errors_fall_from_three_sigmas_on() -> None:
    errors = np.zeros((9, 3))
    errors[:, 1] = [1.538, 1.538, 1.538, 1.538, 1.538, 2.999, 6.0, 8.99, 9.01]
    weights, scale = _weights(errors)
    assert scale == pytest.approx(1.0)
    np.testing.assert_allclose(weights[:8], [1, 1, 1, 1, 1, 1, 0.5, 3 / 8.99])
    assert weights[8] == pytest.approx(1e-8 / (9.01 / 3.0))
    assert _weights(np.zeros((3, 3)))[1] == 1e-6


def test_turning_in_place_needs_both() -> None:
    generator = np.random.default_rng(0)
    rates = generator.normal(size=(1000, 3)) * [0.05, 0.09, 1.0]
    still = np.zeros((10, 3))
    assert turns_in_place(still, rates)
    assert not turns_in_place(still, rates * [1.0, 1.3, 1.0] + [0.0, 0.0, 5.0])
    moving = 0.16 * np.tile([[1.0, 1.0, 1.0], [-1.0, -1.0, -1.0]], (5, 1))
    assert turns_in_place(moving * 1.0, rates)  # 0.277 m
    assert not turns_in_place(moving * 1.2, rates)


def test_horizons_disagree_by_size_and_by_deviations() -> None:
    def found_by(
        apart: Array, sigma: float, turn_deg: float, fixed: tuple[Array, ...] = ()
    ) -> tuple[Array, bool]:
        # Both fits find a rotation of 100 deg, and the long one a further one about its axes.
        body = Rotation.from_rotvec([60.0, 0.0, -80.0], degrees=True)
        more = body * Rotation.from_rotvec([0.0, turn_deg, 0.0], degrees=True)
        brief, lasting = (
            SimpleNamespace(
                values=np.concatenate([item.as_rotvec(degrees=True), arm, np.zeros(4)]),
                sigmas=np.full(10, sigma),
                fixed_directions=fixed,
            )
            for item, arm in ((body, np.zeros(3)), (more, apart))
        )
        return _difference(brief, lasting)  # type: ignore[arg-type]

    result, disagree = found_by(np.array([-19.0, 0.0, 0.0]), 0.01, 0.99)
    np.testing.assert_allclose(result, [0.0, 0.99, 0.0, 19.0, 0.0, 0.0], atol=1e-12)
    assert not disagree
    assert found_by(np.zeros(3), 0.01, 1.01)[1]
    assert found_by(np.array([0.0, -20.1, 0.0]), 0.01, 0.0)[1]
    # Five standard deviations of the difference.
    assert not found_by(np.array([0.0, 21.0, 0.0]), 21.0 / (4.99 * np.sqrt(2.0)), 0.0)[1]
    assert found_by(np.array([0.0, 21.0, 0.0]), 21.0 / (5.01 * np.sqrt(2.0)), 0.0)[1]
    along = found_by(np.array([5.0, 50.0, 0.0]), 0.01, 0.0, (np.array([0.0, 1.0, 0.0]),))
    np.testing.assert_allclose(along[0][3:], [5.0, 0.0, 0.0])
    assert not along[1]


def test_bridges_fill_gaps_of_two_seconds() -> None:
    stamps = np.array([0, 1, 2, 6, 7, 30]) * 500_000_000
    gaps = (PoseSpan(int(stamps[2]), 2.0), PoseSpan(int(stamps[4]), 11.5))
    result = _with_bridges(stamps, gaps)
    assert result.tolist() == [item * 500_000_000 for item in (0, 1, 2, 3, 4, 5, 6, 7, 30)]
