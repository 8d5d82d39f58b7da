"""Segments and gaps of the piecewise process, in cases worked out by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from groundtruth_samples import samples_at
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from strategies import seeds

from trajeval_ros.continuous_time.kernels import MATERN_32, MATERN_52, Hyperparameters
from trajeval_ros.continuous_time.piecewise_gp import (
    MOST_TURN_RAD,
    GPSegments,
    PiecewiseGP,
    TwoScaleGP,
    _inverse_root,
    _inverse_roots,
    _middle,
    _rows,
    blended,
    runs_between,
    smooth_step,
    thinned,
)
from trajeval_ros.continuous_time.samples import Belief
from trajeval_ros.geometry import se3

Array = NDArray[np.float64]


@pytest.mark.parametrize(
    ("count", "size", "starts"),
    [
        (20, 20, [0]),
        (12, 20, [0]),
        (30, 20, [0, 10]),
        (31, 20, [0, 10, 11]),
        (7, 4, [0, 2, 3]),
        (3, 1, [0, 1, 2]),
    ],
)
def test_segments_overlap_by_half_and_the_last_is_full(
    count: int, size: int, starts: list[int]
) -> None:
    rows = _rows(count, size, np.empty(0, dtype=np.int64))
    assert rows[:, 0].tolist() == starts
    np.testing.assert_array_equal(np.diff(rows, axis=1), 1)
    assert rows.shape[1] == min(size, count)
    assert rows[-1, -1] == count - 1


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


def test_segments_are_shortened_until_no_turn_is_large() -> None:
    seconds = 0.1 * np.arange(60.0)

    def size(rate: float) -> int:
        turning = samples_at(seconds, turns=np.outer(seconds, [0.0, 0.0, rate]))
        return int(GPSegments.of(turning, 20).rows.shape[1])

    # The middle of n samples is n / 2 steps of 0.1 s from the first one.
    assert size(0.99 * MOST_TURN_RAD) == 20
    assert size(1.01 * MOST_TURN_RAD) == 14  # 20 * 3 / 4 = 15, made even
    assert size(1.01 * MOST_TURN_RAD / 0.7) == 10
    assert size(10.0) == 6  # the smallest, though more than 2 rad


def test_segments_of_a_fit_have_twenty_samples() -> None:
    samples = samples_at(0.1 * np.arange(50.0))
    fitted = PiecewiseGP.fit(samples, (MATERN_32,))
    assert fitted.segments.rows.shape == (4, 20)
    assert [hyperparameter.noise for hyperparameter in fitted.hyperparameters] == [0.01, 0.02]
    assert len(PiecewiseGP.fit(dataclasses.replace(samples, oriented=False)).roots) == 1


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
        turn = segments.references[:, :3, :3]
        expected = np.zeros((2, 6, 6))
        expected[:, 3:, 3:] = np.diag([4.0, 5.0, 6.0])
        positions = np.diag([1.0, 2.0, 3.0])
        expected[:, :3, :3] = (
            positions if joint else se3.congruent(se3.transposed(turn), positions)
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
        turn = pose[0, :3, :3].T
        np.testing.assert_allclose(jacobian[:3, :3], turn, atol=1e-8)
    expected = jacobian @ np.diag(variances[0]) @ jacobian.T
    np.testing.assert_allclose(covariance[0], expected, atol=1e-7)


def test_weights_of_segments_rise_where_both_are_known() -> None:
    segments = GPSegments.of(samples_at(np.arange(10.0)), 4)  # from 0, 2, 4 and 6
    times = np.array([0.0, 1.9, 2.0, 2.5, 3.0, 4.0, 4.5, 6.25, 9.0])
    first, second, weight = segments.around(times)
    assert second.tolist() == [0, 0, 1, 1, 1, 2, 2, 3, 3]
    # The first segment has no predecessor.
    assert first.tolist() == [0, 0, 0, 0, 0, 1, 1, 2, 2]
    assert weight[:2].tolist() == [1.0, 1.0]
    # From its start at 2 s, until the predecessor ends at 3 s.
    np.testing.assert_allclose(weight[2:], smooth_step(np.array([0, 0.5, 1, 0, 0.5, 0.25, 1])))


def test_segments_on_both_sides_of_a_break_are_not_mixed() -> None:
    seconds = np.r_[0:4, 10:14].astype(float)
    segments = GPSegments.of(samples_at(seconds), 4, breaks=np.array([3]))
    assert segments.rows[:, 0].tolist() == [0, 4]
    # The middle of the gap is at 6.5 s.
    first, second, weight = segments.around(np.array([3.5, 6.4, 6.6, 10.5]))
    assert second.tolist() == first.tolist() == [0, 0, 1, 1]
    assert (weight == 1.0).all()


@given(share=st.floats(-0.5, 1.5))
def test_the_smooth_step_is_the_integral_of_a_beta_density(share: float) -> None:
    from scipy.special import betainc

    expected = betainc(3.0, 3.0, min(max(share, 0.0), 1.0))
    assert smooth_step(np.array([share]))[0] == pytest.approx(expected, abs=1e-12)


def test_the_middle_gap_is_that_of_the_missing_time() -> None:
    assert _middle(np.array([1.0, 1.0, 1.0, 10.0])) == 10.0
    assert _middle(np.array([3.0, 1.0, 2.0])) == 2.0
    assert _middle(np.array([4.0, 5.0, 2.0, 1.0])) == 4.0


def test_thinning_keeps_both_edges_of_gaps() -> None:
    samples = samples_at(np.r_[0.0:1.0:0.1, 5.03:6.0:0.1])
    kept = thinned(samples, np.array([9]), 0.35)
    # Cells begin at 0, 0.35, 0.7, then at 5.25, 5.6, 5.95; rows 9 and 10 are the edges.
    assert kept.tolist() == [0, 4, 7, 9, 10, 13, 16, 19]


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
    found = blended(first, second, np.array([weight]))
    apart = np.array([2.0, -1.0, 4.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(found.poses[0, :3, 3], weight * apart[:3])
    expected = (1.0 - weight) * first.covariances[0] + weight * second.covariances[0]
    expected += weight * (1.0 - weight) * np.outer(apart, apart)
    np.testing.assert_allclose(found.covariances[0], expected, rtol=1e-12, atol=1e-12)


@given(seed=seeds)
@settings(max_examples=8)
def test_a_blend_with_one_belief_is_that_belief(seed: int) -> None:
    generator = np.random.default_rng(seed)
    poses = se3.exp(generator.normal(scale=0.5, size=(2, 1, 6)))
    roots = generator.normal(size=(2, 1, 6, 6))
    one, other = (
        Belief(pose, root @ se3.transposed(root)) for pose, root in zip(poses, roots, strict=True)
    )
    for weight, expected in ((0.0, one), (1.0, other)):
        found = blended(one, other, np.array([weight]))
        np.testing.assert_allclose(found.poses, expected.poses, atol=1e-12)
        np.testing.assert_allclose(found.covariances, expected.covariances, rtol=1e-10, atol=1e-10)
    # The order of the two does not matter.
    there = blended(one, other, np.array([0.3]))
    back = blended(other, one, np.array([0.7]))
    np.testing.assert_allclose(there.poses, back.poses, atol=1e-12)
    np.testing.assert_allclose(there.covariances, back.covariances, rtol=1e-9, atol=1e-9)


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
    found = gp.in_segment(np.zeros(1, dtype=np.int64), asked)
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
    np.testing.assert_allclose(found.poses, poses, atol=1e-10)
    np.testing.assert_allclose(found.covariances, covariances, rtol=1e-9, atol=1e-12)
    assert gp.at(asked).covariances == pytest.approx(covariances, rel=1e-9, abs=1e-12)


def test_a_variance_is_never_below_a_share_of_the_prior() -> None:
    samples = samples_at(0.01 * np.arange(8.0))
    chosen = [(MATERN_52, Hyperparameters(1e3, 50.0, 1e-7))] * 2
    gp = PiecewiseGP.conditioned(GPSegments.of(samples, 8), chosen)
    found = gp.in_segment(np.zeros(8, dtype=np.int64), samples.times)
    assert np.linalg.eigvalsh(found.covariances).min() > 0.9e-14 * 1e6


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
    found = fitted._weight(np.full(4, 399), asked, np.ones(4, dtype=bool))
    expected = smooth_step(np.array([0.0, 0.5, 1.0, 0.02 / fitted.ramp_s]))
    np.testing.assert_allclose(found, expected, atol=1e-9)
    middle = fitted.at(asked[2:3])
    alone = fitted.coarse.at(asked[2:3])
    np.testing.assert_allclose(middle.poses, alone.poses, atol=1e-9)
    np.testing.assert_allclose(middle.covariances, alone.covariances, rtol=1e-6)
    outside = np.array([seconds[100] + 0.001])
    np.testing.assert_array_equal(fitted.at(outside).poses, fitted.fine.at(outside).poses)


def test_short_gaps_have_a_transition_of_a_tenth() -> None:
    seconds = np.r_[0.0:100.0, 110.0:200.0] * 0.01
    samples = samples_at(seconds)
    one = TwoScaleGP(
        PiecewiseGP.fit(samples), None, samples.times, np.array([99]), np.zeros(190, bool), 1.0
    )
    start = seconds[99]
    found = one._weight(np.array([99]), np.array([start + 0.005]), np.array([True]))
    assert found[0] == pytest.approx(smooth_step(np.array([0.005 / (0.1 * 0.11)]))[0])


@pytest.mark.parametrize(
    ("step_s", "gap_s", "coarse_s"),
    [
        (0.005, 1.0, 0.05),  # twenty steps span the gap
        (0.005, 3.0, 0.1),  # the largest step
        (0.06, 3.0, 0.1),
        (0.07, 3.0, None),  # 0.1 s is not worth it
        (1.0, 9.0, None),
    ],
)
def test_a_coarse_process_spans_gaps_with_twenty_samples(
    step_s: float, gap_s: float, coarse_s: float | None
) -> None:
    seconds = step_s * np.arange(80.0)
    seconds[40:] += gap_s - step_s
    fitted = TwoScaleGP.fit(samples_at(seconds), (MATERN_52,))
    assert (fitted.coarse is None) == (coarse_s is None)
    assert fitted.ramp_s == pytest.approx(coarse_s or max(step_s, 0.1))
    if fitted.coarse is not None:
        kept = np.unique(fitted.coarse.segments.times)
        assert np.median(np.diff(kept)) == pytest.approx(fitted.ramp_s, abs=1.01 * step_s)


def test_gaps_shorter_than_the_coarse_step_are_not_covered() -> None:
    seconds = np.r_[0.0:40.0, 44.0:80.0, 480.0:520.0] * 0.005
    fitted = TwoScaleGP.fit(samples_at(seconds), (MATERN_52,))
    # The gap of 2 s has coarse steps of 0.1 s, longer than the gap of 25 ms.
    assert fitted.gaps.tolist() == [75]
    assert fitted.ramp_s == pytest.approx(0.1)
    short = TwoScaleGP.fit(
        samples_at(np.r_[0.0:40.0, 480.0:490.0, 900.0:940.0] * 0.005), (MATERN_32,)
    )
    assert short.short.tolist() == 40 * [False] + 10 * [True] + 40 * [False]
    inside = short.times[44] + 0.001
    assert short.coarse is not None
    np.testing.assert_allclose(
        short.at(np.array([inside])).poses, short.coarse.at(np.array([inside])).poses, atol=1e-12
    )


def test_shares_that_are_added_to_a_singular_diagonal(monkeypatch: pytest.MonkeyPatch) -> None:
    added: list[float] = []

    def singular(matrix: Array) -> Array:
        added.append(float(matrix[0, 0]))
        raise np.linalg.LinAlgError

    monkeypatch.setattr(np.linalg, "cholesky", singular)
    with pytest.raises(AssertionError, match="a share of 1e-6"):
        _inverse_root(np.zeros((2, 2)), Hyperparameters(10.0, 1.0, 0.0))
    assert added == pytest.approx([0.0, 1e-8, 1e-6, 1e-4])
