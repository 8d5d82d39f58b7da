"""Noise, blocks, windows and repair of the groundtruth quality check's fit."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from examined_rigs import START_NS, rig
from scipy.spatial.transform import Rotation
from small_rigs import Small, small_rig

from trajeval_ros.calibration.groundtruth_quality import start
from trajeval_ros.calibration.groundtruth_quality.examine import IMU_NOISE
from trajeval_ros.calibration.groundtruth_quality.inertial_steps import InertialSteps
from trajeval_ros.calibration.groundtruth_quality.joint_fit import Horizon, JointFit
from trajeval_ros.calibration.groundtruth_quality.repair import repaired
from trajeval_ros.calibration.groundtruth_quality.rig import LEVER, OFFSET
from trajeval_ros.calibration.groundtruth_quality.sample_checks import PoseSpan
from trajeval_ros.calibration.groundtruth_quality.sample_rows import SampleRows, rig_at
from trajeval_ros.geometry.inertial import ImuNoise
from trajeval_ros.geometry.trajectory import Trajectory


@pytest.fixture(scope="module")
def small() -> Small:
    return small_rig()


def test_the_sandwich_is_that_of_reduced_scores(small: Small) -> None:
    """With four intervals, every knot is a block of its own but the last two."""
    fit = small.fit()
    moved, scores = fit._by_calibration, np.zeros((12, 10))
    (_, before, after, by_rig), (knots, by_state, _, columns) = fit._rows()
    assert after is not None
    block = [0, 2, 4, 7, 9]
    for knot in range(4):
        jacobian = (
            by_rig[knot, :, :-1] - before[knot] @ moved[knot] - after[knot] @ moved[knot + 1]
        )
        scores[block[knot]] += jacobian.T @ by_rig[knot, :, -1]
    for place, knot in enumerate(knots.tolist()):
        jacobian = columns[place, :, :-1] - by_state[place] @ moved[knot]
        scores[block[knot]] += jacobian.T @ columns[place, :, -1]
    scores -= scores.mean(axis=0)
    model = fit.covariance_of_model
    expected = model @ (scores.T @ scores * 12.0 / 11.0) @ model
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(fit.covariance_of_blocks / scale, expected / scale, atol=1e-6)


def test_rows_are_over_their_standard_deviations(small: Small) -> None:
    rows = small.fit().rows
    sigmas = np.arange(1.0, 7.0)
    [(knots, by_state, by_rig)] = rows.weighted(sigmas)
    weights = np.sqrt(rows.shares) / sigmas
    np.testing.assert_array_equal(knots, rows.knots)
    np.testing.assert_allclose(by_rig[..., -1], rows.residuals * weights)
    np.testing.assert_allclose(by_state[:, :, 4], rows.by_state[:, :, 4] * weights)
    np.testing.assert_allclose(by_rig[:, :, 9], rows.by_rig[:, :, 9] * weights)
    # Four samples of 40 Hz are usual, and an interval of three has less information.
    assert rows.knots.tolist() == [0, 1, 2, 3]
    counts = np.bincount(small.fit().predicted.knots)
    expected = np.minimum(counts / np.median(counts), 1.0)
    np.testing.assert_allclose(rows.shares, np.repeat(expected[:, None], 6, axis=1))


def test_positions_of_a_car_are_not_trusted_more_than_its_imu_over_a_knot() -> None:
    """Otherwise its clock is wrong by 10 ms, since its turns hardly determine it."""
    result = []
    for axes in (3, 1):
        made = small_rig()
        made.steps.rates[..., : 3 - axes] = 0.0
        fit = made.fit(sigmas=(1e-4, 0.02))
        fit._estimate_noise(np.full(2, 1e9))
        result.append(fit.sigmas)
    # White noise of 2e-2 m/s^2/sqrt(Hz), integrated twice over 0.1 s.
    drift_m = 2e-2 * np.sqrt(0.1**3 / 3.0)
    np.testing.assert_allclose(result[0], np.repeat([3e-5, 6e-3], 3))
    np.testing.assert_allclose(result[1], np.repeat([drift_m, 6e-3], 3))


def test_broken_intervals_have_less_weight_from_the_fifth_iteration_on(small: Small) -> None:
    fit = small.fit()
    before = fit._rows_of_intervals(np.arange(4))
    squared = np.square(before[2][:, :9, -1]).sum(axis=1)
    sizes = np.sqrt(np.array([10.0, 49.0, 51.0, 5000.0]) / squared)
    fit._whiten = fit._whiten * sizes[:, None, None]
    fit._iteration = 4
    before = fit._rows_of_intervals(np.arange(4))
    fit._iteration = 5
    after = fit._rows_of_intervals(np.arange(4))
    # The square root of the weight of a quadratic cost that grows linearly beyond chi2 = 50.
    expected = [1.0, 1.0, (50.0 / 51.0) ** 0.25, (50.0 / 5000.0) ** 0.25]
    for one, other in zip(before, after, strict=True):
        scaled = one[:, :9] * np.array(expected)[:, None, None]
        # Small elements are differences of large products.
        rounding = 16.0 * np.finfo(float).eps * float(np.abs(scaled).max())
        np.testing.assert_allclose(other[:, :9], scaled, rtol=1e-9, atol=rounding)
        np.testing.assert_array_equal(other[:, 9:], one[:, 9:])  # random walks


@pytest.mark.slow
def test_a_solved_fit_is_a_minimum_with_the_noise_of_its_residuals() -> None:
    made = rig(6, duration_s=22.0, lever_m=(0.05, -0.03, 0.02), offset_s=0.004)
    truth, readings = made.groundtruth, made.readings
    assert truth.quaternions is not None
    assert readings.accelerations is not None
    case, horizon = start.prepared(truth, readings, 0.0), Horizon(0.05, IMU_NOISE, (1e-3, 3e-3))
    assert case.free.all()
    knots = start.knots_of(case.samples, case.imu, horizon.knot_s)
    steps, first = InertialSteps(knots, case.imu), start.first_rig(case.samples, case.imu, knots)
    fit = JointFit(case.samples, steps, first, horizon, case.free)
    fit.solve(20)
    # Five samples of a knot are averaged.
    noise = np.repeat([5e-4, 2e-3], 3) / np.sqrt(5.0)
    np.testing.assert_allclose(fit.sigmas, noise, rtol=0.2)
    # The samples' clock is early, and their marker is off the IMU.
    values, sigmas = fit.rig.values(), np.sqrt(np.diag(fit.covariance_of_model))
    fit.solve(1, estimate_noise=False)
    assert (np.abs(fit.rig.values() - values) < 0.05 * sigmas).all()
    assert abs(values[6] - 0.004) < 5.0 * sigmas[6]
    assert (np.abs(values[LEVER] - [0.05, -0.03, 0.02]) < 5.0 * sigmas[LEVER]).all()
    before = fit.rig.values()[OFFSET]
    fit.solve_again(fit.rig, case.free & (np.arange(10) != OFFSET))
    assert fit.rig.values()[OFFSET] == before
    assert not fit.covariance_of_model[OFFSET].any()


def test_unobservable_directions_of_the_lever_arm_are_fixed(small: Small) -> None:
    fit = small.fit()
    values, vectors = np.diag([0.049**2, 0.051**2, 1.0]), Rotation.from_rotvec([0.3, 0.2, 0.1])
    rotation = vectors.as_matrix()
    fit.covariance_of_model[LEVER, LEVER] = rotation @ values @ rotation.T
    fit.fix_unobservable_lever()
    assert len(fit.fixed_directions) == 2
    for result, expected in zip(fit.fixed_directions, rotation.T[1:], strict=True):
        assert abs(result @ expected) == pytest.approx(1.0)
    fit = small.fit()
    fit.covariance_of_model[LEVER, LEVER] = 0.049**2 * np.eye(3)
    fit.fix_unobservable_lever()
    assert fit.fixed_directions == []


def test_rotations_are_averaged_over_windows() -> None:
    generator = np.random.default_rng(0)
    count, width = 11, 4
    rotations = Rotation.random(12, random_state=0).as_matrix()
    by_state = generator.normal(size=(count, 6, 15))
    rows = SampleRows(
        np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 11]), by_state,
        generator.normal(size=(count, 6, 11)),
        np.repeat(generator.uniform(0.5, 1.0, (count, 2)), 3, axis=1), (1.0, 1.0),
    )  # fmt: skip
    before = dataclasses.replace(
        rows, by_state=by_state.copy(), by_rig=rows.by_rig.copy(), shares=rows.shares.copy(),
    )  # fmt: skip
    rows.average_rotations(SimpleNamespace(rotations=rotations), width)  # type: ignore[arg-type]
    np.testing.assert_array_equal(rows.by_rig[:, :3], before.by_rig[:, :3])
    np.testing.assert_array_equal(rows.shares[:, :3], before.shares[:, :3])
    # The middles are knots 2, 6 and 10; the last one has no samples.
    assert np.flatnonzero(rows.shares[:, 3]).tolist() == [2, 6]
    for middle in (2, 6):
        part = slice(middle - 2, middle + 2)
        weights = before.shares[part, 3] / before.shares[part, 3].sum()
        np.testing.assert_allclose(
            rows.by_rig[middle, 3:], np.einsum("k,kij->ij", weights, before.by_rig[part, 3:])
        )
        carried = sum(
            weight * jacobian @ rotations[knot].T @ rotations[middle]
            for weight, jacobian, knot in zip(
                weights, before.by_state[part, 3:, :3], range(middle - 2, middle + 2), strict=True
            )
        )
        np.testing.assert_allclose(rows.by_state[middle, 3:, :3], carried, atol=1e-12)
        assert not rows.by_state[middle, 3:, 3:].any()
        np.testing.assert_array_equal(rows.shares[middle, 3:], 1.0)
    assert not rows.by_state[[0, 1, 3, 4, 5, 7, 8, 9, 10], 3:].any()


def test_repaired_states_are_those_of_the_imu(small: Small) -> None:
    fit: JointFit = small.fit()
    fit.rig = dataclasses.replace(fit.rig, shift_s=0.005)
    own_ns = START_NS + np.rint(1e9 * (small.samples.seconds - 0.1)).astype(np.int64)
    truth = Trajectory(own_ns, small.samples.positions, small.samples.quaternions, frame="map")
    result = repaired(fit, truth, (), 4.0)
    inside = fit.predicted.rows
    seconds = small.samples.seconds[inside]
    later = 0.02 + 1e-3 * (seconds - small.samples.middle_s)
    expected = own_ns[inside] + 5_000_000 + np.rint(1e9 * later).astype(np.int64)
    np.testing.assert_array_equal(result.stamps, expected)
    states = rig_at(seconds + later, fit.steps, fit.motions, fit.rig)
    np.testing.assert_allclose(result.positions, states.positions, atol=1e-6)
    np.testing.assert_allclose(result.velocities, states.velocities, atol=1e-6)
    assert result.rotations is not None
    np.testing.assert_allclose(result.rotations.as_matrix(), states.rotations, atol=1e-6)
    np.testing.assert_array_equal(result.gyroscope_biases, fit.rig.biases[states.knots, :3])
    assert result.frame == "map"
    ratio = np.median(np.diag(fit.covariance_of_blocks) / np.diag(fit.covariance_of_model))
    scale = 4.0 * max(1.0, float(ratio))
    knot = fit.pose_covariances()[states.knots[0]]
    assert result.covariances is not None
    np.testing.assert_allclose(result.covariances[0, :3, :3], scale * knot[:3, :3], rtol=1e-6)
    rotation = states.rotations[0]
    np.testing.assert_allclose(
        result.covariances[0, 3:, 3:],
        scale * rotation @ knot[3:, 3:] @ rotation.T,
        rtol=1e-6,
        atol=1e-12,
    )
    np.testing.assert_allclose(
        result.covariances[0, :3, 3:], scale * knot[:3, 3:] @ rotation.T, rtol=1e-5, atol=1e-9
    )
    # A gap is bridged by states at the usual distance.
    kept = np.r_[0:4, 10 : len(own_ns)]
    gap = PoseSpan(int(own_ns[3]), (int(own_ns[10]) - int(own_ns[3])) / 1e9)
    again = repaired(fit, truth[kept], (gap,), 4.0)
    np.testing.assert_allclose(again.stamps, result.stamps, atol=1)


def test_rough_orientations_are_found_from_positions() -> None:
    made = rig(5, noise=(1e-5, 1e-5))
    readings, truth = made.readings, made.groundtruth
    imu = start.imu_of(readings)
    own = (truth.stamps - START_NS) / 1e9
    result = start.rough_orientations(own, truth.positions, imu)
    apart = made.motion.rotations(own).inv() * Rotation.from_quat(result)
    # Good enough for a start: the gyroscope's drift within windows of 5 s is about 3 deg.
    assert np.degrees(np.median(apart.magnitude())) < 6.0
    guess = start.guess_of(truth, imu)
    assert guess.signal == "angular rate"
    assert guess.offset_s == pytest.approx(0.0, abs=5e-3)
    late = dataclasses.replace(truth, stamps=truth.stamps - 700_000_000)
    assert start.guess_of(late, imu).offset_s == pytest.approx(0.7, abs=5e-3)
    bare = dataclasses.replace(late, quaternions=None)
    swings = start.guess_of(bare, imu)
    assert swings.signal == "speed"
    assert swings.offset_s == pytest.approx(0.7, abs=0.02)
    far = dataclasses.replace(truth, stamps=truth.stamps - 700 * 10**9)
    assert start.guess_of(far, imu).offset_s == pytest.approx(700.0, abs=5e-3)


def test_uncertainty_of_an_exact_imu_and_of_a_doubtful_one(small: Small) -> None:
    steps = small_rig().steps
    exact, _ = steps.uncertainty(np.zeros(3), ImuNoise(0.0, 0.0))
    least = np.diag(np.repeat([1e-14, 1e-14, 1e-16], 3))
    np.testing.assert_allclose(exact, np.tile(least, (4, 1, 1)), atol=1e-30)
    noise = ImuNoise(1e-3, 1e-2)
    sure, by_biases = small.steps.uncertainty(np.zeros(3), noise)
    steps.doubtful = np.array([False, True, False, False])
    doubtful, same = steps.uncertainty(np.zeros(3), noise)
    np.testing.assert_allclose(doubtful[0], sure[0])
    np.testing.assert_allclose(doubtful[1] - least, 1e4 * (sure[1] - least), rtol=1e-9)
    np.testing.assert_array_equal(by_biases, same)
