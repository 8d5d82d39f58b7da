"""Formulas of the calibration: increments, closed forms, weights and verdicts."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from calibration_flights import EPOCH
from exact_flights import DURATION_S, FAULT, SCALE_OF_ESTIMATE, flown
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import f as fisher
from scipy.stats import t as student
from strategies import seeds

from trajeval_ros.calibration import robust_fit
from trajeval_ros.calibration.hand_eye import closest_rotation, lever_arm, robust_rotation
from trajeval_ros.calibration.increments import (
    LEVER,
    OFFSET,
    SCALE,
    SKEW,
    TURN,
    Increments,
    PoseInterpolator,
    Unknowns,
    nearest_rows,
    whole_nanoseconds,
)
from trajeval_ros.calibration.observability import Directions, _directions, _turning, basis_of
from trajeval_ros.calibration.robust_fit import block_of, huber_cost
from trajeval_ros.calibration.significance import axis_name, judge, unobservable
from trajeval_ros.geometry import so3


@pytest.mark.parametrize("oriented", [True, False])
def test_true_parameters_leave_no_residual(oriented: bool) -> None:
    truth, estimate, unknowns = flown(oriented=oriented)
    increments = Increments(truth, estimate)
    found = increments.linearise(unknowns)
    assert found.residual.shape[1] == (6 if oriented else 3)
    # Linear interpolation over 2 ms leaves an eighth of 4e-6 s^2 times an acceleration.
    np.testing.assert_allclose(found.residual, 0.0, atol=1e-5)
    assert increments.horizon_s == 1.0
    # The last second has no pair; a quarter of the horizon is allowed.
    assert len(increments) == 401 - 15
    begin = increments.start(FAULT.offset_s, with_scale=True, about_z=False)
    assert begin.skew == 0.0
    if oriented:
        np.testing.assert_allclose(begin.turn, unknowns.turn, atol=0.01)
        np.testing.assert_allclose(begin.lever_m, unknowns.lever_m, atol=0.02)
        assert begin.scale == pytest.approx(SCALE_OF_ESTIMATE, rel=0.01)


def test_positions_alone_start_at_the_turn_between_the_worlds() -> None:
    fault = dataclasses.replace(FAULT, lever_m=(0.0, 0.0, 0.0), skew=0.0)
    truth, estimate, unknowns = flown(oriented=False, fault=fault)
    increments = Increments(truth, estimate)
    scaled = increments.start(FAULT.offset_s, with_scale=True, about_z=False)
    np.testing.assert_allclose(scaled.turn, unknowns.turn, atol=1e-4)
    assert scaled.scale == pytest.approx(SCALE_OF_ESTIMATE, rel=1e-4)
    assert not scaled.lever_m.any()
    assert (scaled.offset_s, scaled.skew) == (FAULT.offset_s, 0.0)
    rigid = increments.start(FAULT.offset_s, with_scale=False, about_z=True)
    assert rigid.scale == 1.0
    np.testing.assert_array_equal(rigid.turn[2], [0.0, 0.0, 1.0])
    nothing = increments.start(1e4, with_scale=True, about_z=False)
    np.testing.assert_array_equal(nothing.turn, np.eye(3))
    assert nothing.scale == 1.0


@pytest.mark.parametrize("oriented", [True, False])
def test_jacobians_of_increments_are_derivatives(oriented: bool) -> None:
    truth, estimate, unknowns = flown(oriented=oriented)
    increments = Increments(truth, estimate, 60)
    assert len(increments) <= 60
    at = unknowns.moved(np.array([0.004, 1e-5, 0.1, -0.05, 0.2, 0.1, 0.3, -0.2, 0.1]))
    found = increments.linearise(at)
    middle_s = (increments._since + increments._till)[found.rows] / 2.0 - DURATION_S / 2.0
    # A skew is an offset that grows from the middle of the run on.
    np.testing.assert_allclose(
        found.jacobian[..., 1], found.jacobian[..., 0] * middle_s[:, None], rtol=1e-9
    )
    for column in [0, *range(2, 9)]:
        step = np.zeros(9)
        # The derivative by the clock is over 20 ms.
        size = 0.02 if column == 0 else 1e-6
        step[column] = size
        ahead, behind = (increments.linearise(at.moved(sign * step)) for sign in (1.0, -1.0))
        both = np.intersect1d(np.intersect1d(ahead.rows, behind.rows), found.rows)
        one, other = (item.residual[np.isin(item.rows, both)] for item in (ahead, behind))
        change = (one - other) / (2.0 * size)
        jacobian = found.jacobian[np.isin(found.rows, both), :, column]
        # By the rotation, r_R is linearised at a small residual.
        if oriented and column in range(2, 5):
            np.testing.assert_allclose(jacobian[:, :3], change[:, :3], atol=1e-5)
            np.testing.assert_allclose(jacobian[:, 3:], change[:, 3:], atol=0.3)
        else:
            np.testing.assert_allclose(jacobian, change, atol=1e-5)


@pytest.mark.parametrize("oriented", [True, False])
def test_either_side_has_the_same_jacobian(oriented: bool) -> None:
    # Without orientations, the columns of the other side leave out the lever arm.
    fault = FAULT if oriented else dataclasses.replace(FAULT, lever_m=(0.0, 0.0, 0.0))
    truth, estimate, unknowns = flown(oriented=oriented, fault=fault)
    increments = Increments(truth, estimate)
    found = increments.linearise(unknowns)
    jacobian_with_swapped_sides, known = increments.jacobian_with_swapped_sides(
        unknowns, found.rows
    )
    assert known.sum() > 300
    columns = [OFFSET, SKEW, TURN, LEVER, SCALE] if oriented else [OFFSET, SKEW, SCALE]
    for column in columns:
        own, other = (
            found.jacobian[known][..., column],
            jacobian_with_swapped_sides[known][..., column],
        )
        size = np.abs(own).max()
        # The clock's derivatives are over +-20 and +-50 ms: an error of 1e-3.
        np.testing.assert_allclose(other, own, atol=5e-3 * size)


def test_a_step_of_the_parameters_turns_on_the_left() -> None:
    start = Unknowns(0.1, 2e-4, so3.exp(np.array([0.2, 0.5, -0.3])), np.arange(3.0), 1.5)
    step = np.array([0.01, 1e-5, 0.3, -0.2, 0.1, 1.0, 2.0, 3.0, 0.25])
    found = start.moved(step)
    assert (found.offset_s, found.skew, found.scale) == pytest.approx((0.11, 2.1e-4, 1.75))
    np.testing.assert_allclose(found.turn, so3.exp(step[2:5]) @ start.turn, atol=1e-14)
    np.testing.assert_allclose(found.lever_m, [1.0, 3.0, 5.0])


def test_pairs_do_not_cross_gaps() -> None:
    truth, estimate, _ = flown()
    kept = np.ones(401, dtype=bool)
    kept[200:210] = False  # 0.55 s without a state
    some = Increments(truth, estimate[kept])
    # Of the 10 + 5 pairs around the gap that a whole second would have, none is left.
    first = (estimate[kept].stamps[some._first] - EPOCH) / 1e9
    last = (estimate[kept].stamps[some._last] - EPOCH) / 1e9
    assert not ((first < 9.99) & (last > 10.01)).any()
    assert (np.abs(last - first - 1.0) <= 0.25).all()
    kept[:] = True
    kept[200:209] = False  # 0.5 s are no gap
    some = Increments(truth, estimate[kept])
    first = (estimate[kept].stamps[some._first] - EPOCH) / 1e9
    last = (estimate[kept].stamps[some._last] - EPOCH) / 1e9
    assert ((first < 9.99) & (last > 10.01)).any()
    sparse = Increments(truth, estimate[::10])
    assert sparse.horizon_s == pytest.approx(1.5)
    own = PoseInterpolator.of(estimate[::10], with_rotations=True, sparse=True)
    assert (own.step_s, own.gap_s) == pytest.approx((0.5, 2.0))
    dense = PoseInterpolator.of(estimate, with_rotations=False)
    assert (dense.step_s, dense.gap_s) == pytest.approx((0.05, 0.5))
    assert dense.quaternions is None


@given(
    st.lists(st.integers(0, 100), min_size=1, max_size=12, unique=True),
    st.lists(st.integers(-20, 120), min_size=1, max_size=12),
)
def test_nearest_rows_are_nearest(stamps: list[int], wanted: list[int]) -> None:
    times = np.array(sorted(stamps))
    found = nearest_rows(times, np.array(wanted))
    for row, item in zip(found.tolist(), wanted, strict=True):
        assert abs(times[row] - item) == np.abs(times - item).min()
    assert whole_nanoseconds(0.1 + 0.2) == 300_000_000


@given(seed=seeds)
@settings(max_examples=15)
def test_closest_rotations_are_scipys(seed: int) -> None:
    generator = np.random.default_rng(seed)
    vectors, noise = generator.normal(size=(2, 12, 3))
    turn = Rotation.from_rotvec(generator.normal(size=3))
    targets = turn.apply(vectors) + 0.3 * noise
    weights = generator.uniform(0.1, 5.0, size=12)
    expected, _ = Rotation.align_vectors(targets, vectors, weights)
    found = closest_rotation(targets, vectors, weights)
    np.testing.assert_allclose(found, expected.as_matrix(), atol=1e-9)
    equal, _ = Rotation.align_vectors(targets, vectors)
    np.testing.assert_allclose(closest_rotation(targets, vectors), equal.as_matrix(), atol=1e-9)
    # Mirrored vectors have a proper rotation, too.
    assert np.linalg.det(closest_rotation(-targets, vectors)) == pytest.approx(1.0)

    def cost(angle: float) -> float:
        return float(weights @ np.square(targets - vectors @ so3.rot_z(angle).T).sum(1))

    level = closest_rotation(targets, vectors, weights, about_z=True)
    best = float(so3.yaw_of_matrix(level))
    assert cost(best) <= min(cost(best + 0.01), cost(best - 0.01))


def test_outliers_hardly_turn_a_robust_rotation() -> None:
    generator = np.random.default_rng(0)
    vectors = generator.normal(size=(200, 3))
    turn = Rotation.from_rotvec([0.3, 0.6, -1.0])
    targets = turn.apply(vectors) + 1e-3 * generator.normal(size=(200, 3))
    targets[:40] = generator.normal(size=(40, 3)) + [3.0, 0.0, 0.0]
    apart = turn.inv() * Rotation.from_matrix(robust_rotation(targets, vectors))
    plain = turn.inv() * Rotation.from_matrix(closest_rotation(targets, vectors))
    assert apart.magnitude() < 0.05 * plain.magnitude()
    level = Rotation.from_rotvec([0.0, 0.0, 0.7])
    found = robust_rotation(level.apply(vectors), vectors, about_z=True)
    np.testing.assert_allclose(found, level.as_matrix(), atol=1e-9)


@given(seed=seeds)
@settings(max_examples=10)
def test_lever_arms_of_exact_motions(seed: int) -> None:
    generator = np.random.default_rng(seed)
    turned = Rotation.from_rotvec(generator.normal(size=(20, 3))).as_matrix() - np.eye(3)
    steps, lever = generator.normal(size=(20, 3)), np.array([0.3, -0.2, 0.5])
    for scale, with_scale in ((1.0, False), (1.0, True), (2.5, True)):
        found, size = lever_arm(
            turned, steps, scale * steps + turned @ lever, with_scale=with_scale
        )
        np.testing.assert_allclose(found, lever, atol=1e-9)
        assert size == pytest.approx(scale)


def test_time_blocks_are_equal_and_three_horizons_long() -> None:
    seconds = np.arange(0.0, 36.0001, 0.5) + 100.0
    assert np.bincount(block_of(seconds, 1.0)).tolist() == [*[6] * 11, 7]
    # 20 s have six blocks of 3 s, the last one with the rest.
    seconds = np.arange(0.0, 20.001, 0.5)
    assert np.bincount(block_of(seconds, 1.0)).tolist() == [6, 6, 6, 6, 6, 11]
    assert np.bincount(block_of(seconds, 2.5)).tolist() == [15, 15 + 11]
    long = np.arange(0.0, 120.001, 1.0)
    assert np.bincount(block_of(long, 1.0)).tolist() == [*[10] * 11, 11]
    # Blocks without data are not counted.
    assert block_of(np.array([0.0, 1.0, 30.0, 36.0]), 1.0).tolist() == [0, 0, 1, 2]
    assert block_of(np.zeros(3), 1.0).tolist() == [0, 0, 0]


def test_huber_weights_by_hand() -> None:
    residual = np.zeros((5, 6))
    residual[:, 0] = [1.5382, 0.5, 1.5382, 3.8455, 7.691]
    residual[:, 4] = 1e-9
    weights = robust_fit._weights(residual, (slice(0, 3), slice(3, 6)))
    # The spread is 1; beyond 2.5 of it, weights fall with the length.
    np.testing.assert_allclose(weights[:, 0], [1, 1, 1, 2.5 / 3.8455, 2.5 / 7.691])
    np.testing.assert_allclose(weights[:, 1], 1e14)
    only = robust_fit._weights(residual, (slice(3, 6),))
    assert not only[:, 0].any()
    bare = robust_fit._weights(residual[:, :3], (slice(0, 3), slice(3, 6)))
    np.testing.assert_array_equal(bare[:, 0], weights[:, 0])
    assert not bare[:, 1].any()
    # The cost is quadratic within, and linear beyond.
    cost = huber_cost(residual, residual, slice(0, 3))
    inside = (2 * 1.5382**2 + 0.25) / 2.0
    outside = 2.5 * (3.8455 - 1.25) + 2.5 * (7.691 - 1.25)
    assert cost == pytest.approx((inside + outside) / 5.0)
    assert huber_cost(np.zeros((3, 6)), residual, slice(0, 3)) == pytest.approx(1e-12)
    assert huber_cost(np.zeros((3, 6)), residual, slice(3, 6)) == pytest.approx(1e-14)


def test_the_inverse_of_a_hessian_leaves_out_what_is_undetermined() -> None:
    generator = np.random.default_rng(0)
    root = generator.normal(size=(4, 6)) * np.array([1.0, 1e-6, 1e6, 1.0])[:, None]
    hessian = root @ root.T
    scale = np.outer(1.0 / np.sqrt(np.diag(hessian)), 1.0 / np.sqrt(np.diag(hessian)))
    found = robust_fit._inverse(hessian)
    np.testing.assert_allclose(found / scale @ (hessian * scale), np.eye(4), atol=1e-9)
    nothing = np.zeros((5, 5))
    nothing[:4, :4] = hessian
    np.testing.assert_allclose(robust_fit._inverse(nothing)[:4, :4] / scale, found / scale)
    assert not robust_fit._inverse(nothing)[4].any()
    singular = np.array([[1.0, 1.0], [1.0, 1.0]])
    np.testing.assert_allclose(robust_fit._inverse(singular), 0.25 * singular)


def test_a_sandwich_by_hand() -> None:
    gradients = np.array([[1.0], [-2.0], [3.0], [0.5]])
    # sum g^2 / h^2 times B / (B - P).
    found = robust_fit.sandwich(np.array([[4.0]]), gradients)
    assert found[0, 0] == pytest.approx(14.25 / 16.0 * 4.0 / 3.0)


def test_reliability_is_the_correlation_of_both_jacobians() -> None:
    generator = np.random.default_rng(1)
    motion = generator.normal(size=(4000, 3, 1))
    one, other = (motion + generator.normal(size=motion.shape) for _ in range(2))
    found = _directions(one, other, np.ones((4000, 3)))
    # Equal powers of motion and noise.
    assert found.reliability[0] == pytest.approx(0.5, abs=0.02)
    assert _directions(one, -one, np.ones((4000, 3))).reliability[0] == pytest.approx(-1.0)
    assert _directions(0.0 * one, one, np.ones((4000, 3))).reliability[0] == 0.0
    weights = generator.uniform(size=(4000, 3))
    products = [float((weights * a * b).sum()) for a, b in (
        (one[..., 0], one[..., 0]), (other[..., 0], other[..., 0]), (one[..., 0], other[..., 0])
    )]  # fmt: skip
    expected = products[2] / np.sqrt(products[0] * products[1])
    assert _directions(one, other, weights).reliability[0] == pytest.approx(expected)
    # Two parameters: their directions are those of the sum of both informations.
    both = np.concatenate([one, 3.0 * one, other], axis=2)[:, :, [0, 1]]
    axes = _directions(both, both, np.ones((4000, 3))).directions
    np.testing.assert_allclose(np.abs(axes[1]), [1 / np.sqrt(10), 3 / np.sqrt(10)], atol=1e-9)
    directions = Directions(np.eye(3), np.array([0.49, 0.5, 0.9]))
    assert directions.seen.tolist() == [False, True, True]


@pytest.mark.parametrize(("angle", "seen"), [(0.0199, 0), (0.0201, 2)])
def test_lever_arms_of_positions_need_turns(angle: float, seen: int) -> None:
    # A turn by t about z moves a point by 2 sin(t / 2) per metre.
    turned = np.tile(so3.rot_z(2.0 * np.arcsin(angle / 2.0)) - np.eye(3), (5, 1, 1))
    found = _turning(turned)
    assert int(found.seen.sum()) == seen
    if seen:
        np.testing.assert_allclose(found.directions[~found.seen], [[0.0, 0.0, 1.0]], atol=1e-9)


def test_a_basis_has_free_directions_as_columns() -> None:
    axis = np.array([[0.0, 0.6, 0.8]])
    found = basis_of({"offset": np.eye(1), "lever": axis, "scale": np.eye(1)})
    expected = np.zeros((9, 3))
    expected[0, 0] = expected[8, 2] = 1.0
    expected[5:8, 1] = axis[0]
    np.testing.assert_array_equal(found, expected)
    assert basis_of({}).shape == (9, 0)


def test_names_of_axes() -> None:
    assert axis_name(np.array([0.0, -1.0, 0.0])) == "y"
    assert axis_name(np.array([0.0, np.sqrt(1 - 0.971**2), 0.971])) == "z"
    assert axis_name(np.array([0.969, np.sqrt(1 - 0.969**2), 0.0])) == "(0.97 0.25 0.00)"


def test_verdicts_of_a_parameter_by_hand() -> None:
    seen = Directions(np.eye(3), np.ones(3))
    covariance = np.diag([0.01, 0.04, 0.09])
    value = np.array([1.0, -0.5, 0.2])

    def verdict(size: float = 1.0, *, systematic: float = 0.0, widest: float = 10.0,
                directions: Directions = seen, whole: bool = False):  # fmt: skip
        return judge(size * value, covariance, systematic, directions, 12, widest=widest, unit="m",
                     whole=whole)  # fmt: skip

    quantile = float(student.ppf(0.975, 11))
    found = verdict(systematic=0.3)
    assert found.sigma is not None
    assert found.half_width_95 is not None
    sigma = np.sqrt([0.10, 0.13, 0.18])
    np.testing.assert_allclose(found.sigma, sigma)
    np.testing.assert_allclose(found.half_width_95, quantile * sigma, rtol=1e-9)
    statistic = float((value**2 / sigma**2).sum()) / 3.0
    assert found.chance == pytest.approx(float(fisher.sf(statistic, 3, 11)))
    critical = np.sqrt(fisher.isf(0.0027, 3, 11) / ((value**2 / [0.01, 0.04, 0.09]).sum() / 3.0))
    assert verdict(1.001 * critical).is_significant
    assert verdict(0.999 * critical).status == "insignificant"
    assert verdict(100.0).reason == "p < 1e-6"
    # The precision is that of the run alone, along its worst direction.
    assert verdict(systematic=9.0, widest=1.001 * quantile * 0.3).status == "insignificant"
    weak = verdict(widest=0.999 * quantile * 0.3)
    assert weak.status == "weak"
    assert weak.reason.startswith("95 % half width 0.66 m, limit")
    part = Directions(np.eye(3), np.array([1.0, 1.0, 0.2]))
    hidden = verdict(directions=part)
    assert hidden.seen == 2
    assert hidden.sigma is not None
    np.testing.assert_allclose(hidden.sigma, [0.1, 0.2, np.nan])
    assert "not observable along z, assumed 0 there" in hidden.reason
    assert verdict(directions=part, whole=True).status == "unobservable"
    none = verdict(directions=Directions(np.eye(3), np.array([0.1, 0.3, 0.2])))
    assert "reliability 0.30, required 0.5" in none.reason
    assert unobservable("why").reliability.size == 0
    assert unobservable("why").chance is None
