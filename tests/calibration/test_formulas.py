"""Formulas of the calibration: increments and closed forms."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from exact_flights import FAULT, SCALE_OF_ESTIMATE, flown
from hypothesis import given, settings
from scipy.spatial.transform import Rotation
from strategies import seeds

from trajeval_ros.calibration.hand_eye import closest_rotation, lever_arm, robust_rotation
from trajeval_ros.calibration.increments import (
    BODY_ROTATION,
    LEVER,
    OFFSET,
    SCALE,
    SKEW,
    Increments,
)
from trajeval_ros.geometry import so3


def test_positions_alone_start_at_the_turn_between_the_worlds() -> None:
    fault = dataclasses.replace(FAULT, lever_m=(0.0, 0.0, 0.0), skew=0.0)
    truth, estimate, unknowns = flown(oriented=False, fault=fault)
    increments = Increments(truth, estimate)
    scaled = increments.start(FAULT.offset_s, with_scale=True, about_z=False)
    np.testing.assert_allclose(scaled.rotation, unknowns.rotation, atol=1e-4)
    assert scaled.scale == pytest.approx(SCALE_OF_ESTIMATE, rel=1e-4)
    assert not scaled.lever_m.any()
    assert (scaled.offset_s, scaled.skew) == (FAULT.offset_s, 0.0)
    rigid = increments.start(FAULT.offset_s, with_scale=False, about_z=True)
    assert rigid.scale == 1.0
    np.testing.assert_array_equal(rigid.rotation[2], [0.0, 0.0, 1.0])
    nothing = increments.start(1e4, with_scale=True, about_z=False)
    np.testing.assert_array_equal(nothing.rotation, np.eye(3))
    assert nothing.scale == 1.0


@pytest.mark.parametrize("oriented", [True, False])
def test_either_side_has_the_same_jacobian(oriented: bool) -> None:
    # Without orientations, the columns of the other side leave out the lever arm.
    fault = FAULT if oriented else dataclasses.replace(FAULT, lever_m=(0.0, 0.0, 0.0))
    truth, estimate, unknowns = flown(oriented=oriented, fault=fault)
    increments = Increments(truth, estimate)
    result = increments.linearise(unknowns)
    jacobian_with_swapped_sides, known = increments.jacobian_with_swapped_sides(
        unknowns, result.rows
    )
    assert known.sum() > 300
    columns = [OFFSET, SKEW, BODY_ROTATION, LEVER, SCALE] if oriented else [OFFSET, SKEW, SCALE]
    for column in columns:
        estimated, other = (
            result.jacobian[known][..., column],
            jacobian_with_swapped_sides[known][..., column],
        )
        size = np.abs(estimated).max()
        # The clock's derivatives are over +-20 and +-50 ms: an error of 1e-3.
        np.testing.assert_allclose(other, estimated, atol=5e-3 * size)


@given(seed=seeds)
@settings(max_examples=15)
def test_closest_rotations_are_scipys(seed: int) -> None:
    generator = np.random.default_rng(seed)
    vectors, noise = generator.normal(size=(2, 12, 3))
    rotation = Rotation.from_rotvec(generator.normal(size=3))
    targets = rotation.apply(vectors) + 0.3 * noise
    weights = generator.uniform(0.1, 5.0, size=12)
    expected, _ = Rotation.align_vectors(targets, vectors, weights)
    result = closest_rotation(targets, vectors, weights)
    np.testing.assert_allclose(result, expected.as_matrix(), atol=1e-9)
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
    rotation = Rotation.from_rotvec([0.3, 0.6, -1.0])
    targets = rotation.apply(vectors) + 1e-3 * generator.normal(size=(200, 3))
    targets[:40] = generator.normal(size=(40, 3)) + [3.0, 0.0, 0.0]
    apart = rotation.inv() * Rotation.from_matrix(robust_rotation(targets, vectors))
    plain = rotation.inv() * Rotation.from_matrix(closest_rotation(targets, vectors))
    assert apart.magnitude() < 0.05 * plain.magnitude()
    level = Rotation.from_rotvec([0.0, 0.0, 0.7])
    result = robust_rotation(level.apply(vectors), vectors, about_z=True)
    np.testing.assert_allclose(result, level.as_matrix(), atol=1e-9)


@given(seed=seeds)
@settings(max_examples=10)
def test_lever_arms_of_exact_motions(seed: int) -> None:
    generator = np.random.default_rng(seed)
    rotated = Rotation.from_rotvec(generator.normal(size=(20, 3))).as_matrix() - np.eye(3)
    steps, lever = generator.normal(size=(20, 3)), np.array([0.3, -0.2, 0.5])
    for scale, with_scale in ((1.0, False), (1.0, True), (2.5, True)):
        result, size = lever_arm(
            rotated, steps, scale * steps + rotated @ lever, with_scale=with_scale
        )
        np.testing.assert_allclose(result, lever, atol=1e-9)
        assert size == pytest.approx(scale)
