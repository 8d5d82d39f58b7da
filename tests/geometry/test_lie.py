"""Quaternion arithmetic against scipy's, and where scipy is not asked."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp
from strategies import SAME_ROTATION_RAD, Array, seeds

from trajeval_ros.geometry import lie, so3


def rotations(seed: int, count: int = 50) -> Rotation:
    return Rotation.random(count, random_state=seed % 2**31)


def quaternions(seed: int, count: int = 50) -> Array:
    """Return random unit quaternions of either sign."""
    sign = np.random.default_rng(seed).choice([-1.0, 1.0], size=(count, 1))
    return rotations(seed, count).as_quat() * sign


def assert_same_rotations(actual: Array, theirs: Array) -> None:
    cosine = np.abs(np.einsum("...i,...i->...", actual, theirs))
    np.testing.assert_allclose(cosine, 1.0, rtol=0, atol=1e-14)


@given(a=seeds, b=seeds)
def test_products_are_scipys(a: int, b: int) -> None:
    actual = lie.multiply(quaternions(a), quaternions(b))
    assert_same_rotations(actual, (rotations(a) * rotations(b)).as_quat())


@given(a=seeds, b=seeds)
def test_rotating_is_scipys(a: int, b: int) -> None:
    vectors = np.random.default_rng(b).normal(size=(50, 3))
    rotated = lie.rotate(quaternions(a), vectors)
    np.testing.assert_allclose(rotated, rotations(a).apply(vectors), atol=1e-13)


@given(seed=seeds)
def test_angles_are_scipys(seed: int) -> None:
    np.testing.assert_allclose(
        lie.angle(quaternions(seed)), rotations(seed).magnitude(), rtol=1e-13
    )


@pytest.mark.parametrize("size", [1e-300, 1e-15, 1e-12, 1e-9, 1e-8, 1e-6, 1e-3, 1.0, 3.0])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_tiny_and_common_angles_are_exact(size: float, sign: float) -> None:
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    quaternion = sign * np.append(axis * np.sin(size / 2.0), np.cos(size / 2.0))
    tolerance = 1e-14 if size > 1e-150 else 1.0  # squares of smaller numbers underflow to zero
    np.testing.assert_allclose(lie.angle(quaternion), size, rtol=tolerance)


@pytest.mark.parametrize("short_of_half_turn", [0.0, 1e-12, 1e-9, 1e-6])
def test_angles_near_half_a_turn_are_exact(short_of_half_turn: float) -> None:
    half = short_of_half_turn / 2.0
    quaternion = np.array([0.6 * np.cos(half), 0.0, 0.8 * np.cos(half), np.sin(half)])
    # numpy's atan2 is good to 4 units in the last place.
    rounding = 4.0 * float(np.spacing(np.pi))
    result = np.pi - lie.angle(quaternion)
    assert result == pytest.approx(short_of_half_turn, rel=0, abs=rounding)


@pytest.mark.parametrize("size", [1e-12, 1e-9, 1e-3, 1.0, 3.1])
@pytest.mark.parametrize("direction", [-1.0, 1.0])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_yaw_is_the_signed_twist_and_tilt_the_swing(
    size: float, direction: float, sign: float
) -> None:
    sine, cosine = np.sin(size / 2.0), np.cos(size / 2.0)
    about_z = sign * np.array([0.0, 0.0, direction * sine, cosine])
    about_level = sign * np.array([0.6 * sine, direction * 0.8 * sine, 0.0, cosine])
    np.testing.assert_allclose(lie.yaw(about_z), direction * size, rtol=1e-13)
    np.testing.assert_allclose(lie.tilt(about_level), size, rtol=1e-13)
    assert lie.tilt(about_z) == 0.0
    assert lie.yaw(about_level) == pytest.approx(0.0, abs=1e-15)


@given(seed=seeds, turn=st.floats(-3.1, 3.1))
def test_yaw_adds_up_and_tilt_does_not_see_turns_about_gravity(seed: int, turn: float) -> None:
    q = quaternions(seed)
    about_z = np.array([0.0, 0.0, np.sin(turn / 2.0), np.cos(turn / 2.0)])
    rotated = lie.multiply(about_z, q)
    apart = lie.yaw(rotated) - lie.yaw(q) - turn
    np.testing.assert_allclose(np.cos(apart), 1.0, atol=1e-9)
    np.testing.assert_allclose(lie.tilt(rotated), lie.tilt(q), atol=1e-12)
    assert (np.abs(lie.yaw(q)) <= np.pi).all()


@given(seed=seeds)
def test_tilt_is_the_angle_between_the_vertical_and_its_image(seed: int) -> None:
    image = rotations(seed).apply([0.0, 0.0, 1.0])
    level = np.hypot(image[:, 0], image[:, 1])
    np.testing.assert_allclose(
        lie.tilt(quaternions(seed)), np.arctan2(level, image[:, 2]), atol=1e-12
    )


@given(seed=seeds)
def test_half_the_angles_cosine_is_that_of_yaw_times_that_of_tilt(seed: int) -> None:
    q = quaternions(seed)
    np.testing.assert_allclose(
        np.cos(lie.angle(q) / 2.0),
        np.cos(lie.yaw(q) / 2.0) * np.cos(lie.tilt(q) / 2.0),
        atol=1e-12,
    )


@given(a=seeds, size=st.sampled_from([0.0, 1e-14, 1e-10, 1e-9, 1e-8, 1e-4, 0.1, 1.0, 3.0, 3.1415]))
def test_interpolation_is_scipys_slerp(a: int, size: float) -> None:
    random = np.random.default_rng(a)
    axis = random.normal(size=3)
    start = Rotation.random(random_state=a % 2**31)
    end = Rotation.from_rotvec(axis / np.linalg.norm(axis) * size) * start
    fractions = np.concatenate([[0.0, 1.0], random.uniform(size=20)])
    expected = Slerp([0.0, 1.0], Rotation.concatenate([start, end]))(fractions)
    sign = random.choice([-1.0, 1.0], size=(2, 22, 1))
    actual = lie.slerp(sign[0] * start.as_quat(), sign[1] * end.as_quat(), fractions)
    apart = (Rotation.from_quat(actual) * expected.inv()).magnitude()
    # Two interpolations, a product and what normalises them are each known to 8 u of a unit
    # quaternion, an angle to twice that; near half a turn, over what is missing of it.
    rounding = 40.0 * np.finfo(np.float64).eps / (np.pi - size if size >= 3.0 else 1.0)
    np.testing.assert_allclose(apart, 0.0, rtol=0, atol=rounding)
    np.testing.assert_allclose(np.linalg.norm(actual, axis=1), 1.0, atol=1e-15)


@pytest.mark.parametrize("count", [0, 1, 8191, 8192, 8193, 20_000])
def test_work_by_blocks_is_work_at_once(count: int) -> None:
    random = np.random.default_rng(count)
    a, b = random.normal(size=(count, 4)), random.normal(size=(count, 4))
    product, angle = lie.by_blocks(lambda x, y: (x * y, lie.angle(x)), a, b)
    np.testing.assert_array_equal(product, a * b)
    # numpy's vector loops and what they leave over may take another atan2, each to 4 units in the
    # last place.
    np.testing.assert_allclose(angle, lie.angle(a), rtol=8.0 * np.finfo(np.float64).eps)


@given(seed=seeds)
def test_a_matrix_is_the_quaternion_of_scipy(seed: int) -> None:
    rotation = Rotation.random(random_state=seed % 2**31)
    mine = lie.from_matrix(rotation.as_matrix())
    theirs = rotation.as_quat()
    assert mine[3] >= 0.0
    np.testing.assert_allclose(mine, theirs * np.sign(theirs[3]), atol=1e-15)


@given(seed=seeds, size=st.sampled_from([1e-100, 1e-3, 1.0, 1e100]))
def test_normalising_is_scipys(seed: int, size: float) -> None:
    raw = np.random.default_rng(seed).normal(scale=size, size=(50, 4))
    actual = lie.normalized(raw)
    np.testing.assert_allclose(actual, Rotation.from_quat(raw).as_quat(), rtol=1e-15)
    # Our norm and numpy's: 3.5 half units in the last place each, and one of the division.
    np.testing.assert_allclose(
        np.linalg.norm(actual, axis=1), 1.0, rtol=4.0 * np.finfo(np.float64).eps
    )
    np.testing.assert_array_equal(lie.normalized(raw[0]), actual[0])
    np.testing.assert_array_equal(lie.normalized(raw.reshape(5, 10, 4)), actual.reshape(5, 10, 4))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("component", [0.0, 1e-200, np.nan, np.inf])
def test_a_quaternion_of_no_length_is_not_finite(component: float) -> None:
    assert not np.isfinite(lie.normalized(np.full(4, component))).any()


@given(seed=seeds)
def test_matrices_are_scipys_both_ways(seed: int) -> None:
    q = quaternions(seed)
    matrices = lie.to_matrix(q)
    np.testing.assert_allclose(matrices, Rotation.from_quat(q).as_matrix(), rtol=0, atol=1e-15)
    back = lie.from_matrices(matrices)
    theirs = Rotation.from_matrix(matrices).as_quat()
    np.testing.assert_allclose(back, theirs, rtol=0, atol=1e-15)
    np.testing.assert_allclose(lie.to_matrix(back), matrices, rtol=0, atol=2e-15)
    np.testing.assert_array_equal(lie.to_matrix(q[0]), matrices[0])
    assert lie.to_matrix(q[:0]).shape == (0, 3, 3)
    assert lie.from_matrices(matrices[:0]).shape == (0, 4)


@given(
    a=seeds, size=st.sampled_from([0.0, 1e-200, 1e-9, 9.99e-4, 1.001e-3, 0.5, 3.0, 3.1415, 6.0])
)
def test_rotation_vectors_are_scipys_both_ways(a: int, size: float) -> None:
    axes = np.random.default_rng(a).normal(size=(20, 3))
    vectors = size * axes / np.linalg.norm(axes, axis=1)[:, None]
    actual = lie.from_rotation_vector(vectors)
    np.testing.assert_allclose(actual, Rotation.from_rotvec(vectors).as_quat(), rtol=0, atol=3e-16)
    np.testing.assert_array_equal(lie.from_rotation_vector(vectors[0]), actual[0])
    if size < 3.0:
        np.testing.assert_allclose(lie.rotation_vector(actual), vectors, rtol=1e-14, atol=1e-300)
        np.testing.assert_allclose(lie.to_matrix(actual), so3.exp(vectors), rtol=0, atol=2e-15)


@given(seed=seeds)
def test_euler_angles_are_scipys_and_make_the_rotation(seed: int) -> None:
    q = quaternions(seed)
    actual = lie.euler_angles(q)
    np.testing.assert_allclose(actual, rotations(seed).as_euler("ZYX"), rtol=0, atol=4e-15)
    made = Rotation.from_euler("ZYX", actual)
    np.testing.assert_allclose((made.inv() * rotations(seed)).magnitude(), 0.0, atol=2e-15)
    np.testing.assert_array_equal(lie.euler_angles(q[0]), actual[0])


@given(yaw=st.floats(-3.1, 3.1), roll=st.floats(-3.1, 3.1), error=st.floats(-4e-8, 4e-8))
@pytest.mark.parametrize("pitch", [-np.pi / 2, np.pi / 2])
@pytest.mark.filterwarnings("ignore:Gimbal lock:UserWarning")
def test_euler_angles_straight_up_or_down_have_no_roll(
    pitch: float, yaw: float, roll: float, error: float
) -> None:
    rotation = Rotation.from_euler("ZYX", [yaw, pitch + error, roll])
    actual = lie.euler_angles(rotation.as_quat())
    assert actual[2] == 0.0
    assert abs(actual[0]) <= np.pi
    np.testing.assert_allclose(actual[1], pitch, rtol=0, atol=1e-7)
    made = Rotation.from_euler("ZYX", actual)
    # The roll that was left out has no effect but through the pitch's distance from a right angle.
    assert (made.inv() * rotation).magnitude() < 1e-7


@pytest.mark.parametrize("axis", np.eye(3))
@pytest.mark.parametrize("angle", [0.0, 1e-9, np.pi / 2, np.pi - 1e-9, np.pi])
def test_a_matrix_of_half_a_turn_keeps_its_digits(axis: Array, angle: float) -> None:
    rotation = Rotation.from_rotvec(angle * axis)
    between = Rotation.from_quat(lie.from_matrix(rotation.as_matrix())) * rotation.inv()
    assert between.magnitude() <= SAME_ROTATION_RAD
