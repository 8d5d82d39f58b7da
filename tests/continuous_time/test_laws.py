"""Laws of the continuous-time models, and what they say of groundtruth that says nothing."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest
from dense_joint import dense_covariance
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation
from solved_process import solved
from strategies import make_groundtruth, seeds

from trajeval_ros.continuous_time.continuous_trajectory import (
    ContinuousTrajectory,
    LinearInterpolation,
    MarkovPoses,
    fit_trajectory,
)
from trajeval_ros.continuous_time.kernels import (
    MATERN_32,
    MATERN_52,
    SQUARED_EXPONENTIAL,
    Hyperparameters,
    Kernel,
    most_likely,
    negative_log_likelihood,
)
from trajeval_ros.continuous_time.manifolds import Positions, Rotations, _factors
from trajeval_ros.continuous_time.piecewise_gp import SIZE, GPSegments, PiecewiseGP, TwoScaleGP
from trajeval_ros.continuous_time.samples import MODELS, Belief, Noise, Samples
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry import se3
from trajeval_ros.geometry.banded_matrices import BandedGaussian, Factor
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.likelihood.correlated_groundtruth import JointPosterior

Array = NDArray[np.float64]
UNIT_ROUNDOFF = float(np.finfo(np.float64).eps) / 2.0
KERNELS = [SQUARED_EXPONENTIAL, MATERN_52, MATERN_32]
CHOSEN = [
    (MATERN_52, Hyperparameters(3.0, 0.8, 1e-3)),
    (MATERN_52, Hyperparameters(1.0, 0.7, 1e-3)),
]
UNCERTAIN = [name for name in MODELS if name not in ("linear", "nearest", "auto")]


def smooth(count: int, seed: int = 0, step_s: float = 0.2) -> Trajectory:
    """Return a slow motion with a turn, sampled evenly and without noise."""
    random = np.random.default_rng(seed)
    times = step_s * np.arange(count)
    phase = random.uniform(0.0, 2.0 * np.pi, size=(2, 3))
    positions = np.array([3.0, 2.0, 1.0]) * np.sin(times[:, None] * [0.5, 0.7, 0.9] + phase[0])
    rotations = np.array([0.2, 0.2, 1.2]) * np.sin(times[:, None] * [0.8, 0.6, 0.4] + phase[1])
    stamps = 1_700_000_000_000_000_000 + np.round(times * 1e9).astype(np.int64)
    return Trajectory(stamps, positions, Rotation.from_rotvec(rotations).as_quat())


def jump(below: Belief, above: Belief) -> float:
    return max(
        float(np.abs(below.poses - above.poses).max()),
        float(np.abs(below.covariances - above.covariances).max()),
    )


@given(seed=seeds, count=st.integers(2, 30), size=st.integers(1, 6))
def test_block_tridiagonal_is_its_dense_matrix(seed: int, count: int, size: int) -> None:
    random = np.random.default_rng(seed)
    roots = random.normal(size=(count, size, size + 3))
    below = random.normal(size=(count - 1, size, size))
    diagonal = roots @ roots.swapaxes(1, 2) + 0.1 * np.eye(size)
    diagonal[1:] += below @ below.swapaxes(1, 2)
    diagonal[:-1] += np.eye(size)
    dense = np.zeros((count * size, count * size))
    for row in range(count):
        here = slice(row * size, (row + 1) * size)
        dense[here, here] = diagonal[row]
        if row:
            before = slice((row - 1) * size, row * size)
            dense[here, before], dense[before, here] = below[row - 1], below[row - 1].T
    factor = Factor.of(diagonal, below)
    inverse = np.linalg.inv(dense)
    own, beside = factor.inverse_blocks()
    scale = np.abs(inverse).max()
    links = BandedGaussian(csr_matrix(dense)).marginals(size * np.arange(count), size)
    np.testing.assert_allclose(own, links, atol=1e-9 * scale)
    for row in range(count):
        here = slice(row * size, (row + 1) * size)
        np.testing.assert_allclose(own[row], inverse[here, here], atol=1e-9 * scale)
        if row:
            before = slice((row - 1) * size, row * size)
            np.testing.assert_allclose(beside[row - 1], inverse[before, here], atol=1e-9 * scale)
    rows = random.normal(size=(count, size))
    assert np.sum(factor.whitened(rows) ** 2) == pytest.approx(
        rows.ravel() @ inverse @ rows.ravel()
    )
    assert factor.log_determinant == pytest.approx(np.linalg.slogdet(dense)[1])


@pytest.mark.parametrize("kernel", KERNELS)
@given(seed=seeds)
def test_gradient_of_the_likelihood(kernel: Kernel, seed: int) -> None:
    random = np.random.default_rng(seed)
    times = np.sort(random.uniform(0.0, 5.0, size=(3, 8)), axis=1)
    lags = times[:, :, None] - times[:, None, :]
    targets = random.normal(size=(3, 8, 3))
    at = np.log(random.uniform([0.5, 0.3, 0.05], [2.0, 1.5, 0.3]))
    gradient = negative_log_likelihood(kernel, lags, targets, at)[1]
    for axis in range(3):
        step = 1e-5 * np.eye(3)[axis]
        up, down = (
            negative_log_likelihood(kernel, lags, targets, at + sign * step)[0] for sign in (1, -1)
        )
        assert gradient[axis] == pytest.approx((up - down) / 2e-5, rel=1e-6, abs=1e-4)


def test_hyperparameters_are_recovered() -> None:
    random = np.random.default_rng(3)
    times = np.tile(0.1 * np.arange(20), (40, 1))
    lags = times[:, :, None] - times[:, None, :]
    covariance = 1.5**2 * MATERN_52.between(lags[0], 0.6) + 0.02**2 * np.eye(20)
    targets = np.linalg.cholesky(covariance) @ random.normal(size=(40, 20, 3))
    kernel, result = most_likely((MATERN_32, MATERN_52), times, targets, 0.02, 0.1)
    assert kernel is MATERN_52
    assert result.sigma == pytest.approx(1.5, rel=0.3)
    assert result.length == pytest.approx(0.6, rel=0.3)


@pytest.mark.parametrize("count", range(13, 61))
def test_continuous_across_all_samples_and_borders(count: int) -> None:
    samples = Samples.of(smooth(count), Noise(1e-3, 1e-3))
    gp = PiecewiseGP.conditioned(GPSegments.of(samples, 12), CHOSEN)
    knots = samples.times[1:-1]
    assert jump(gp.at(knots - 1e-9), gp.at(knots + 1e-9)) < 1e-6


@pytest.mark.parametrize("model", UNCERTAIN)
def test_continuous_across_gaps_too(model: str) -> None:
    whole = make_groundtruth(5, 400)
    kept = np.r_[np.arange(0, 150), np.arange(175, 300), np.arange(320, 400)]
    fitted = fit_trajectory(whole[kept], model)
    knots = fitted.samples.times[1:-1]
    near = jump(fitted.poses.at(knots - 1e-9), fitted.poses.at(knots + 1e-9))
    assert near < 1e-5  # it moves by some 1e-8 in between


# The model of the paper has no second scale.
@pytest.mark.slow
@pytest.mark.parametrize("model", [name for name in UNCERTAIN if name != "paper"])
def test_few_samples_between_gaps_are_believed(model: str) -> None:
    seconds = np.r_[0:1500, 2100, 2700:2712, 3400, 3401, 4000:5500, 5990:6000] / 300.0
    rotation = np.stack(
        [0.3 * np.sin(seconds), 0.2 * np.cos(0.7 * seconds), 0.8 * seconds], axis=1
    )
    some = Trajectory(
        (1e9 * seconds).astype(np.int64) + 10**18,
        np.stack([np.sin(rotation[:, 2]), np.cos(rotation[:, 2]), rotation[:, 0]], axis=1),
        Rotation.from_rotvec(rotation).as_quat(),
    )
    assert some.rotations is not None
    fitted = fit_trajectory(some, model, Noise(0.005, 0.01))
    belief = fitted.at(some.stamps)
    apart = np.linalg.norm(belief.poses[:, :3, 3] - some.positions, axis=1)
    assert apart.max() < 3.0 * 0.005
    rotated = some.rotations.inv() * Rotation.from_matrix(belief.poses[:, :3, :3])
    assert rotated.magnitude().max() < 3.0 * 0.01
    knots = fitted.samples.times[1:-1]
    near = jump(fitted.poses.at(knots - 1e-9), fitted.poses.at(knots + 1e-9))
    assert near < 1e-5


@pytest.mark.slow
def test_recordings_with_many_gaps_are_believed(recording: Callable[[str], Trajectory]) -> None:
    groundtruth = recording("tum/fr2_desk_groundtruth.txt").in_order()
    noise = Noise(0.005, math.radians(1.0))
    fitted = fit_trajectory(groundtruth, "matern", noise)
    belief = fitted.at(groundtruth.stamps)
    apart = np.linalg.norm(belief.poses[:, :3, 3] - groundtruth.positions, axis=1)
    assert apart.max() < 3.0 * noise.position_m


@pytest.mark.parametrize("model", UNCERTAIN)
def test_less_is_known_inside_a_gap(model: str) -> None:
    whole = smooth(120)
    fitted = fit_trajectory(whole[np.r_[np.arange(0, 50), np.arange(60, 120)]], model)
    times = np.linspace(fitted.samples.times[49], fitted.samples.times[50], 41)
    size = np.trace(fitted.poses.at(times).covariances[:, :3, :3], axis1=1, axis2=2)
    steps = np.diff(size)
    peak = int(np.argmax(size))
    assert 10 < peak < 30
    assert (steps[: peak - 1] > 0.0).all()
    assert (steps[peak + 1 :] < 0.0).all()


def lost_in_rounding(fitted: ContinuousTrajectory) -> float:
    """Return how far rounding may lift a variance at a sample, as a share of the noise's.

    A process explains |L^-1 k|^2 of its prior variance sigma^2, with L L^T = K of n samples, and
    the variance is what is left. With an explicit L^-1 that is known to u cond(L) sigma^2, and
    cond(L) is at most sqrt(n) sigma / noise.
    """
    if not isinstance(fitted.poses, TwoScaleGP):
        return 0.0  # an information matrix is inverted: nothing is subtracted
    fine = fitted.poses.fine
    ratio = max(
        hyperparameter.sigma / hyperparameter.noise for hyperparameter in fine.hyperparameters
    )
    return math.sqrt(fine.segments.rows.shape[1]) * UNIT_ROUNDOFF * ratio**3


@pytest.mark.parametrize("noise", [1e-3, 1e-4])
@pytest.mark.parametrize("model", ["matern", "matern52", "matern32", "wnoa", "wnoj"])
def test_samples_are_interpolated_as_their_noise_vanishes(model: str, noise: float) -> None:
    motion = smooth(60)
    fitted = fit_trajectory(motion, model, Noise(noise, noise))
    belief = fitted.at(motion.stamps)
    assert motion.rotations is not None
    expected = se3.poses(motion.rotations.as_matrix(), motion.positions)
    np.testing.assert_allclose(belief.poses, expected, rtol=0, atol=5.0 * noise)
    # A sample and its neighbours say more than the sample alone.
    most = np.linalg.eigvalsh(belief.covariances).max()
    assert most <= noise**2 * (1.0 + lost_in_rounding(fitted))


@pytest.mark.slow
@pytest.mark.parametrize("model", ["matern", "matern52", "matern32", "wnoa", "wnoj", "linear"])
@given(seed=seeds)
@settings(max_examples=5)
def test_another_world_frame_changes_nothing(model: str, seed: int) -> None:
    random = np.random.default_rng(seed)
    motion = smooth(40, seed % 7)
    rotation = Rotation.random(random_state=seed % 2**31)
    shift = random.normal(scale=50.0, size=3)
    assert motion.rotations is not None
    moved = dataclasses.replace(
        motion,
        positions=rotation.apply(motion.positions) + shift,
        quaternions=(rotation * motion.rotations).as_quat(),
    )
    stamps = motion.stamps[:-1] + 70_000_000
    here, there = (fit_trajectory(item, model).at(stamps) for item in (motion, moved))
    world = se3.poses(rotation.as_matrix(), shift)
    # The optimiser stops within its tolerance of the most likely hyperparameters.
    np.testing.assert_allclose(there.poses, world @ here.poses, atol=2e-5)
    np.testing.assert_allclose(there.covariances, here.covariances, rtol=2e-2, atol=1e-9)


def test_same_hyperparameters_make_it_exactly_equivariant() -> None:
    samples = Samples.of(smooth(45), Noise(1e-3, 1e-3))
    world = se3.exp(np.array([10.0, -20.0, 5.0, 1.0, 0.5, -2.0]))
    moved = dataclasses.replace(samples, poses=world @ samples.poses)
    times = np.linspace(samples.times[0], samples.times[-1], 300)
    for joint in (False, True):
        here, there = (
            PiecewiseGP.conditioned(GPSegments.of(item, SIZE, joint=joint), CHOSEN).at(times)
            for item in (samples, moved)
        )
        np.testing.assert_allclose(there.poses, world @ here.poses, atol=1e-9)
        np.testing.assert_allclose(there.covariances, here.covariances, atol=1e-9)


@pytest.mark.parametrize("model", ["matern", "wnoa", "linear"])
def test_no_clock_and_no_sign_of_a_quaternion_matters(model: str) -> None:
    motion = smooth(40)
    quaternions = motion.quaternions
    assert quaternions is not None
    signs = np.where(np.arange(40) % 3, 1.0, -1.0)[:, None]
    motion = dataclasses.replace(motion, quaternions=quaternions)
    other = dataclasses.replace(
        motion,
        stamps=motion.stamps - 1_600_000_000_123_456_789,
        quaternions=signs * quaternions,
    )
    here = fit_trajectory(motion, model).at(motion.stamps[:-1] + 70_000_000)
    there = fit_trajectory(other, model).at(other.stamps[:-1] + 70_000_000)
    # Times count from the first stamp and q and -q are one matrix, so both fits are the same
    # operations. An optimiser, given an input that differs in its last bit, may stop elsewhere.
    np.testing.assert_array_equal(there.poses, here.poses)
    np.testing.assert_array_equal(there.covariances, here.covariances)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_markov_positions_are_a_dense_gaussian_process(order: int) -> None:
    """White noise integrated m times, on a polynomial of degree m - 1 that nothing is known of."""
    random = np.random.default_rng(order)
    times = np.sort(random.uniform(0.0, 4.0, size=9))
    asked = random.uniform(times[0], times[-1], size=12)
    positions = random.normal(size=(9, 3))
    noise, density = 0.1, 0.7

    def covariance(first: Array, second: Array) -> Array:
        """Integral of (s - u)^(m-1) (t - u)^(m-1) / (m-1)!^2 over u from 0 to the earlier time."""
        nodes, weights = np.polynomial.legendre.leggauss(6)
        until = np.minimum(first[:, None], second)[..., None]
        u = 0.5 * until * (nodes + 1.0)
        grown = ((first[:, None, None] - u) * (second[None, :, None] - u)) ** (order - 1)
        scale = density / float(np.prod(np.arange(1, order))) ** 2
        return np.asarray(scale * (0.5 * until[..., 0]) * (grown @ weights))

    basis, asked_basis = (np.vander(item, order) for item in (times, asked))
    inverse = np.linalg.inv(covariance(times, times) + noise**2 * np.eye(9))
    known = np.linalg.inv(basis.T @ inverse @ basis)
    trend = known @ basis.T @ inverse @ positions
    cross = covariance(asked, times)
    mean = asked_basis @ trend + cross @ inverse @ (positions - basis @ trend)
    left = asked_basis - cross @ inverse @ basis
    variance = np.diagonal(covariance(asked, asked) - cross @ inverse @ cross.T) + np.einsum(
        "qi,ij,qj->q", left, known, left
    )
    process = solved(Positions(), order, times, positions, noise, density)
    result, spread = process.interpolator().at(asked)
    np.testing.assert_allclose(result, mean, atol=1e-9)
    np.testing.assert_allclose(spread[:, 0, 0], variance, atol=1e-9)


def test_a_markov_process_knows_no_direction_of_time() -> None:
    random = np.random.default_rng(0)
    times = 0.3 * np.arange(30) + random.uniform(0.0, 0.2, size=30)
    positions = np.cumsum(random.normal(size=(30, 3)), axis=0)
    asked = random.uniform(times[0], times[-1], size=50)
    for order in (1, 2, 3):
        forth = solved(Positions(), order, times, positions, 0.01, 0.3).interpolator()
        back = solved(Positions(), order, -times[::-1], positions[::-1], 0.01, 0.3).interpolator()
        for one, other in zip(forth.at(asked), back.at(-asked), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-10)


def test_brownian_motion_is_linear_interpolation() -> None:
    motion = smooth(30)
    samples = Samples.of(motion, Noise(1e-7, 1e-7))
    times = np.linspace(0.01, samples.times[-1] - 0.01, 200)
    linear = LinearInterpolation(samples).at(times).poses
    for manifold, measured, axes in (
        (Positions(), samples.poses[:, :3, 3], linear[:, :3, 3]),
        (Rotations(), samples.poses[:, :3, :3], linear[:, :3, :3]),
    ):
        process = solved(manifold, 1, samples.times, measured, 1e-7, 1.0)
        np.testing.assert_allclose(process.interpolator().at(times)[0], axes, atol=1e-9)


def test_joint_posterior_agrees_with_single_poses() -> None:
    samples = Samples.of(smooth(40), Noise())
    process = MarkovPoses.fit(samples, 2).positions.process
    asked = np.linspace(1.03, 6.07, 15)
    joint = JointPosterior.of(process, asked)
    dense = dense_covariance(joint)
    single = process.interpolator().at(asked)[1]
    for place in range(len(asked)):
        block = dense[3 * place : 3 * place + 3, 3 * place : 3 * place + 3]
        np.testing.assert_allclose(block, single[place], rtol=1e-6)
    errors = np.random.default_rng(1).normal(scale=0.01, size=(15, 3))
    with_tolerance = dense + 1e-4 * np.eye(45)
    expected = -0.5 * (
        errors.ravel() @ np.linalg.solve(with_tolerance, errors.ravel())
        + np.linalg.slogdet(2.0 * np.pi * with_tolerance)[1]
    )
    observed = joint.observed(np.tile(1e-4 * np.eye(3), (15, 1, 1)))
    assert observed.log_density(errors) == pytest.approx(expected, rel=1e-8)
    determinant = np.linalg.slogdet(with_tolerance)[1]
    assert observed.log_determinant == pytest.approx(determinant, rel=1e-7)
    columns = np.stack([errors, errors[::-1]], axis=-1)
    solved = np.linalg.solve(with_tolerance, columns.reshape(45, 2)).reshape(15, 3, 2)
    np.testing.assert_allclose(observed.solve(columns), solved, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("order", [2, 3])
def test_joint_posterior_at_queries_close_to_samples_and_to_each_other(order: int) -> None:
    samples = Samples.of(smooth(40), Noise())
    process = MarkovPoses.fit(samples, order).positions.process
    step = samples.usual_step_s
    apart = np.array([0.0, 1e-9, 5e-6, 1e-4, 2e-3, 0.02]) * step
    asked = np.concatenate([samples.times[7] + apart, samples.times[20] + 0.4 * step + apart])
    joint = JointPosterior.of(process, asked)
    dense = dense_covariance(joint)
    single = process.interpolator().at(asked)[1]
    blocks = dense.reshape(12, 3, 12, 3)
    item = np.arange(12)
    np.testing.assert_allclose(blocks[item, :, item], single, rtol=1e-5)
    # Two queries at almost the same time have the same error.
    np.testing.assert_allclose(blocks[0, :, 2], single[0], rtol=1e-3)
    np.testing.assert_allclose(blocks[6, :, 8], single[6], rtol=1e-3)
    errors = np.random.default_rng(1).normal(scale=0.01, size=(12, 3))
    tolerance = 1e-4 * np.eye(36)
    expected = -0.5 * (
        errors.ravel() @ np.linalg.solve(dense + tolerance, errors.ravel())
        + np.linalg.slogdet(2.0 * np.pi * (dense + tolerance))[1]
    )
    result = joint.observed(np.tile(1e-4 * np.eye(3), (12, 1, 1))).log_density(errors)
    # The closest knots have a billionth of the variance of a step, and rounding errors of both
    # sides grow by its inverse: 2.2e-7 for an operation, a few of them here.
    assert result == pytest.approx(expected, rel=10 * np.finfo(float).eps / 1e-9)


@pytest.mark.slow
def test_positions_alone_are_enough() -> None:
    motion = smooth(30)
    bare = dataclasses.replace(motion, quaternions=None)
    stamps = motion.stamps[:-1] + 90_000_000
    for model in MODELS:
        whole, alone = (fit_trajectory(item, model).at(stamps) for item in (motion, bare))
        if model not in ("paper", "auto"):
            np.testing.assert_allclose(
                alone.poses[:, :3, 3], whole.poses[:, :3, 3], rtol=0, atol=1e-7
            )
        assert not alone.covariances[:, 3:].any()


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_nearly_equal_stamps_are_merged_and_said(model: str) -> None:
    motion = smooth(60)
    twice = np.sort(np.r_[np.arange(60), [20, 33, 34]])
    stamps = motion.stamps[twice].copy()
    stamps[[21, 35]] += 100
    near = dataclasses.replace(motion[twice], stamps=stamps)
    fitted = fit_trajectory(near, model)
    assert any("2 groundtruth poses merged" in statement for statement in fitted.statements)
    belief = fitted.at(motion.stamps[5:-5] + 50_000_000)
    assert np.isfinite(belief.poses).all()
    assert (np.linalg.eigvalsh(belief.covariances) > 0.0).all()


@pytest.mark.parametrize("model", MODELS)
def test_no_motion_is_said_and_gives_no_confident_number(model: str) -> None:
    still = dataclasses.replace(
        smooth(40), positions=np.ones((40, 3)), quaternions=Rotation.identity(40).as_quat()
    )
    gap = still[np.r_[np.arange(0, 15), np.arange(30, 40)]]
    fitted = fit_trajectory(gap, model)
    assert any("moves less than its noise" in statement for statement in fitted.statements)
    belief = fitted.at(still.stamps[20:25])
    assert np.isfinite(belief.covariances).all()
    # Not surer than half a sample, though nothing ever moved.
    assert np.linalg.eigvalsh(belief.covariances)[:, 0].min() > 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_half_turns_in_a_gap_are_said(model: str) -> None:
    motion = smooth(40)
    rotations = np.zeros((40, 3))
    rotations[20:, 2] = 3.0
    wild = dataclasses.replace(motion, quaternions=Rotation.from_rotvec(rotations).as_quat())
    fitted = fit_trajectory(wild, model)
    assert any(
        "differ by more than 115 deg at 1 place" in statement for statement in fitted.statements
    )
    belief = fitted.at(motion.stamps[:-1] + 100_000_000)
    assert np.isfinite(belief.poses).all()
    assert np.isfinite(belief.covariances).all()


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("count", [2, 3, 4, 7])
def test_few_samples(model: str, count: int) -> None:
    motion = smooth(count)
    fitted = fit_trajectory(motion, model)
    assert any(
        f"{count} groundtruth samples are too few" in statement for statement in fitted.statements
    )
    stamps = motion.stamps[:-1] + 100_000_000
    positions = fitted.markov.positions.process
    joint = JointPosterior.of(positions, fitted.samples.seconds(stamps))
    assert (np.linalg.eigvalsh(dense_covariance(joint)) > 0.0).all()
    belief = fitted.at(stamps)
    assert np.isfinite(belief.poses).all()
    assert (np.linalg.eigvalsh(belief.covariances) > 0.0).all()


@pytest.mark.parametrize("model", ["matern", "paper"])
def test_hardly_any_noise_leaves_digits(model: str) -> None:
    motion = smooth(80)
    belief = fit_trajectory(motion, model, Noise(1e-6, 1e-6)).at(motion.stamps[:-1] + 90_000_000)
    assert np.isfinite(belief.poses).all()
    assert (np.linalg.eigvalsh(belief.covariances) > 0.0).all()


def test_refuses_what_says_nothing() -> None:
    motion = smooth(10)
    with pytest.raises(InputError, match="1 pose, and association continuous needs"):
        fit_trajectory(motion[:1])
    with pytest.raises(SettingsError, match="unknown continuous model 'cubic'"):
        fit_trajectory(motion, "cubic")
    with pytest.raises(SettingsError, match="must be greater than zero"):
        Noise(0.0, 0.1)
    with pytest.raises(InputError, match="1 of 2 timestamps are outside"):
        fit_trajectory(motion).at(motion.stamps[[0, -1]] + 1)
    together = dataclasses.replace(motion, stamps=motion.stamps[0] + np.arange(10))
    with pytest.raises(InputError, match="within 1e-06 s, which is too short"):
        fit_trajectory(together)


@pytest.mark.parametrize("angle", [1e-3, 0.05, 0.3, 0.7, 0.7071, 0.7072, 1.0, 2.0, 3.0])
def test_the_factor_of_the_inverse_jacobian_and_its_derivatives(angle: float) -> None:
    """By Bernoulli numbers: x / 2 cot(x / 2) is the sum of (-1)^n B_2n x^2n / (2n)!."""
    from scipy.special import bernoulli, factorial

    even = np.arange(2, 122, 2)
    terms = np.abs(bernoulli(120)[even]) / factorial(even)
    powers = np.arange(60.0)
    square = angle**2
    expected = [
        np.sum(terms * square**powers),
        np.sum((terms * powers)[1:] * square ** (powers[1:] - 1.0)),
        np.sum((terms * powers * (powers - 1.0))[2:] * square ** (powers[2:] - 2.0)),
    ]
    result = np.ravel(_factors(np.array([[0.0, angle, 0.0]])))
    # The closed form of the second derivative divides rounding errors by s^3, at s = 0.5.
    for one, other, tolerance in zip(result, expected, [1e-12, 1e-11, 1e-9], strict=True):
        assert one == pytest.approx(other, rel=tolerance)
