"""Segments and gaps of the piecewise process, in cases worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from groundtruth_samples import samples_at
from hypothesis import given, settings
from strategies import seeds

from trajeval_ros.continuous_time.kernels import MATERN_32, MATERN_52, Hyperparameters
from trajeval_ros.continuous_time.piecewise_gp import (
    GPSegments,
    PiecewiseGP,
    TwoScaleGP,
    _inverse_root,
    _inverse_roots,
    _rows,
    blended,
    runs_between,
    smooth_step,
)
from trajeval_ros.continuous_time.samples import Belief
from trajeval_ros.geometry import se3


def test_segments_do_not_cross_breaks() -> None:
    breaks = np.array([9, 12])
    first, lengths = runs_between(20, breaks)
    assert first.tolist() == [0, 10, 13]
    assert lengths.tolist() == [10, 3, 7]
    # The run of three is shorter than a segment.
    assert _rows(20, 4, breaks)[:, 0].tolist() == [0, 2, 4, 6, 13, 15, 16]
    assert _rows(20, 7, breaks)[:, 0].tolist() == [0, 3, 13]
    # If all runs are, the breaks are ignored.
    assert _rows(20, 11, breaks)[:, 0].tolist() == [0, 5, 9]


def test_coordinates_of_segments_are_relative_to_the_middle() -> None:
    samples = samples_at(0.1 * np.arange(9.0))
    for joint in (False, True):
        segments = GPSegments.of(samples, 6, joint=joint)
        assert segments.rows.tolist() == [[0, 1, 2, 3, 4, 5], [3, 4, 5, 6, 7, 8]]
        np.testing.assert_array_equal(segments.references, samples.poses[[3, 6]])
        nothing = np.zeros((2, 6))
        poses, spread = segments.poses_at(
            np.array([0, 1]), nothing, np.tile(np.arange(1.0, 7.0), (2, 1))
        )
        np.testing.assert_allclose(poses, segments.references, atol=1e-14)
        rotation = segments.references[:, :3, :3]
        expected = np.zeros((2, 6, 6))
        expected[:, 3:, 3:] = np.diag([4.0, 5.0, 6.0])
        positions = np.diag([1.0, 2.0, 3.0])
        expected[:, :3, :3] = (
            positions if joint else se3.congruent(se3.transposed(rotation), positions)
        )
        np.testing.assert_allclose(spread, expected, atol=1e-12)
        for segment in (0, 1):
            means = segments.coordinates[segment]
            poses, _ = segments.poses_at(np.full(6, segment), means, np.ones((6, 6)))
            np.testing.assert_allclose(poses, samples.poses[segments.rows[segment]], atol=1e-12)


@pytest.mark.parametrize("joint", [False, True])
def test_covariances_of_segments_are_those_of_perturbations_on_the_right(joint: bool) -> None:
    segments = GPSegments.of(samples_at(0.1 * np.arange(8.0)), 6, joint=joint)
    mean = np.array([[0.3, -0.2, 0.5, 0.4, -0.6, 0.9]])
    zeros = np.zeros(1, dtype=np.int64)
    variances = np.array([[1.0, 4.0, 9.0, 0.25, 0.5, 2.0]])
    pose, covariance = segments.poses_at(zeros, mean, variances)
    jacobian = np.empty((6, 6))
    for axis, step in enumerate(1e-6 * np.eye(6)):
        ahead, behind = (
            segments.poses_at(zeros, mean + sign * step, variances)[0] for sign in (1.0, -1.0)
        )
        jacobian[:, axis] = se3.log(se3.inverse(behind) @ ahead)[0] / 2e-6
    if not joint:  # a position is perturbed along the axes of the mean's body
        rotation = pose[0, :3, :3].T
        np.testing.assert_allclose(jacobian[:3, :3], rotation, atol=1e-8)
    expected = jacobian @ np.diag(variances[0]) @ jacobian.T
    np.testing.assert_allclose(covariance[0], expected, atol=1e-7)


def test_a_blend_has_the_moments_of_the_mixture() -> None:
    # Without uncertain rotations, poses of equal orientation are vectors.
    spreads = np.zeros((2, 1, 6, 6))
    spreads[0, 0, :3, :3], spreads[1, 0, :3, :3] = np.diag([1.0, 2.0, 3.0]), 3.0 * np.eye(3)
    places = np.array([[[0.0, 0.0, 0.0]], [[2.0, -1.0, 4.0]]])
    first, second = (
        Belief(se3.poses(np.eye(3)[None], place), spread)
        for place, spread in zip(places, spreads, strict=True)
    )
    weight = 0.3
    result = blended(first, second, np.array([weight]))
    apart = np.array([2.0, -1.0, 4.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(result.poses[0, :3, 3], weight * apart[:3])
    expected = (1.0 - weight) * first.covariances[0] + weight * second.covariances[0]
    expected += weight * (1.0 - weight) * np.outer(apart, apart)
    np.testing.assert_allclose(result.covariances[0], expected, rtol=1e-12, atol=1e-12)


@given(seed=seeds)
@settings(max_examples=5)
def test_a_segment_is_a_conditioned_gaussian(seed: int) -> None:
    """Eq. (31), by the conditional of a joint Gaussian."""
    generator = np.random.default_rng(seed)
    samples = samples_at(
        np.cumsum(generator.uniform(0.1, 0.3, size=6)), generator.normal(size=(6, 3))
    )
    chosen = [
        (MATERN_52, Hyperparameters(1.5, 0.4, 0.1)),
        (MATERN_32, Hyperparameters(0.7, 0.6, 0.05)),
    ]
    gp = PiecewiseGP.conditioned(GPSegments.of(samples, 6), chosen)
    asked = np.array([0.5 * (samples.times[1] + samples.times[2])])
    result = gp.in_segment(np.zeros(1, dtype=np.int64), asked)
    means, variances = np.zeros((1, 6)), np.zeros((1, 6))
    for block, (kernel, given_) in enumerate(chosen):
        columns = slice(3 * block, 3 * block + 3)
        lags = samples.times[:, None] - samples.times
        inside = given_.sigma**2 * kernel.between(lags, given_.length)
        inside += given_.noise**2 * np.eye(6)
        cross = given_.sigma**2 * kernel.between(asked - samples.times, given_.length)
        gain = np.linalg.solve(inside, cross)
        means[0, columns] = gain @ gp.segments.coordinates[0, :, columns]
        variances[0, columns] = given_.sigma**2 - gain @ cross
    poses, covariances = gp.segments.poses_at(np.zeros(1, dtype=np.int64), means, variances)
    np.testing.assert_allclose(result.poses, poses, atol=1e-10)
    np.testing.assert_allclose(result.covariances, covariances, rtol=1e-9, atol=1e-12)
    assert gp.at(asked).covariances == pytest.approx(covariances, rel=1e-9, abs=1e-12)


def test_a_singular_prior_has_a_root_with_a_larger_diagonal() -> None:
    ones = np.ones((4, 4))
    easy = Hyperparameters(1.0, 1.0, 0.5)
    root = _inverse_root(ones, easy)
    np.testing.assert_allclose(root @ (ones + 0.25 * np.eye(4)) @ root.T, np.eye(4), atol=1e-12)
    assert np.triu(root, 1).max() == 0.0
    # Without noise: 1e-10 of the variance is added.
    hard = Hyperparameters(2.0, 1.0, 0.0)
    root = _inverse_root(4.0 * ones, hard)
    product = root @ (4.0 * ones + 4e-10 * np.eye(4)) @ root.T
    np.testing.assert_allclose(product, np.eye(4), atol=1e-4)
    times = np.arange(300.0)[:, None] + np.array([0.0, 0.3, 0.7])
    roots = _inverse_roots(MATERN_32, times, easy)
    lags = times[0, :, None] - times[0]
    expected = _inverse_root(MATERN_32.between(lags, 1.0), easy)
    np.testing.assert_allclose(roots, np.tile(expected, (300, 1, 1)), atol=1e-12)


def test_gaps_have_a_coarse_process_with_a_smooth_transition() -> None:
    seconds = np.r_[0.0:400.0, 700.0:1100.0] * 0.005
    wave = np.stack([np.sin(seconds), np.cos(seconds), 0.1 * seconds], axis=1)
    samples = samples_at(seconds, wave)
    assert samples.gaps.tolist() == [399]
    fitted = TwoScaleGP.fit(samples, (MATERN_52,))
    assert fitted.coarse is not None
    gap_s = 301 * 0.005
    assert fitted.ramp_s == pytest.approx(gap_s / 20.0)
    assert fitted.gaps.tolist() == [399]
    assert not fitted.short.any()
    start, end = seconds[399], seconds[400]
    asked = np.array([start, start + 0.5 * fitted.ramp_s, 0.5 * (start + end), end - 0.02])
    result = fitted._weight(np.full(4, 399), asked, np.ones(4, dtype=bool))
    expected = smooth_step(np.array([0.0, 0.5, 1.0, 0.02 / fitted.ramp_s]))
    np.testing.assert_allclose(result, expected, atol=1e-9)
    middle = fitted.at(asked[2:3])
    alone = fitted.coarse.at(asked[2:3])
    np.testing.assert_allclose(middle.poses, alone.poses, atol=1e-9)
    np.testing.assert_allclose(middle.covariances, alone.covariances, rtol=1e-6)
    outside = np.array([seconds[100] + 0.001])
    np.testing.assert_array_equal(fitted.at(outside).poses, fitted.fine.at(outside).poses)
