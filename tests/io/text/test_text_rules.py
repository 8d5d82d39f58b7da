"""Rules that choose a layout, a unit or a time of text files, at their limits."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from refusals import is_refused
from scipy.spatial.transform import Rotation

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.text.names import (
    BODY_TWISTS,
    FAST_LIO,
    FIXED_AXES,
    GROUPS,
    Layout,
)
from trajeval_ros.io.text.reader import array_trajectory
from trajeval_ros.io.text.states import states_of

Array = NDArray[Any]
SECOND = 10**9


def groups_of(names: str, rows: Any) -> tuple[Layout, dict[str, Array]]:
    layout = Layout("named", tuple(names.split()))
    columns = np.array(rows, dtype=float)
    return layout, {name: columns[:, list(at)] for name, at in layout.groups.items()}


def test_twists_of_the_body_are_turned() -> None:
    rng = np.random.default_rng(0)
    turns = Rotation.random(5, random_state=1)
    rows = np.hstack([rng.normal(size=(5, 3)), turns.as_quat(), rng.normal(size=(5, 6))])
    names = "x y z qx qy qz qw body_vx body_vy body_vz"
    layout, groups = groups_of(f"{names} vx vy vz", rows)
    both = states_of(Path("x"), layout, groups, 5)
    np.testing.assert_array_equal(both.velocities, rows[:, 10:])  # type: ignore[arg-type]
    layout, groups = groups_of(names, rows[:, :10])
    found = states_of(Path("x"), layout, groups, 5)
    assert found.velocities is not None
    np.testing.assert_allclose(found.velocities, turns.apply(rows[:, 7:10]), rtol=1e-13)
    rows[2, 3:7] = 0.0  # turns nothing
    layout, groups = groups_of(names, rows[:, :10])
    found = states_of(Path("x"), layout, groups, 5)
    assert found.velocities is not None
    np.testing.assert_array_equal(found.velocities[2], rows[2, 7:10])
    layout, groups = groups_of("x y z body_vx body_vy body_vz", rows[:, [0, 1, 2, 7, 8, 9]])
    assert states_of(Path("x"), layout, groups, 5).velocities is None


TURN = 2.0 * math.pi


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("angle", "refused"), [(TURN + 0.0099, False), (TURN + 0.0101, True), (360.0, True)]
)
def test_angles_are_in_radians_up_to_a_turn(sign: float, angle: float, *, refused: bool) -> None:
    layout, groups = groups_of("x y z roll pitch yaw", [[0, 0, 0, 0, 0, 0]] * 2)
    groups["angles"][1, 1] = sign * angle
    assert is_refused(states_of, Path("x"), layout, groups, 2) == refused
    if refused:
        with pytest.raises(InputError, match=r"x, row 2: pitch is .* name the column pitch_deg"):
            states_of(Path("x"), layout, groups, 2)
    layout, groups = groups_of("x y yaw_deg", [[0, 0, math.degrees(sign * angle)]])
    found = states_of(Path("x"), layout, groups, 1)
    assert found.quaternions is not None
    between = Rotation.from_quat(found.quaternions[0]).inv() * Rotation.from_rotvec(
        [0.0, 0.0, sign * angle]
    )
    assert between.magnitude() < 1e-12
    np.testing.assert_array_equal(found.positions, [[0.0, 0.0, 0.0]])
    assert [remark.code for remark in found.remarks] == ["no_height"]


@given(st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_angles_are_about_z_then_y_then_x(angles: list[float]) -> None:
    layout, groups = groups_of("x y z roll pitch yaw", [[0, 0, 0, *angles]])
    found = states_of(Path("x"), layout, groups, 1)
    about = [np.array(axis) * angle for axis, angle in zip(np.eye(3), angles, strict=True)]
    x, y, z = map(Rotation.from_rotvec, about)
    assert found.quaternions is not None
    assert (Rotation.from_quat(found.quaternions[0]).inv() * z * y * x).magnitude() < 1e-14


@pytest.mark.parametrize(("angle", "is_kept"), [(0.99e9, True), (1.01e9, False)])
def test_sums_of_angles_without_digits_are_no_rotations(angle: float, *, is_kept: bool) -> None:
    layout = Layout("g2o", ("x", "y", "yaw"))
    groups = {"planar": np.zeros((1, 2)), "heading": np.array([[angle]])}
    found = states_of(Path("x"), layout, groups, 1).quaternions
    assert found is not None
    assert np.isfinite(found).all() == is_kept


@pytest.mark.parametrize(
    ("length", "refused"), [(math.pi + 0.99e-3, False), (math.pi + 1.01e-3, True)]
)
def test_rotation_vectors_of_fast_lio_are_up_to_pi(length: float, *, refused: bool) -> None:
    vector = length * np.array([[2.0, -3.0, 6.0]]) / 7.0
    groups = {"position": np.zeros((1, 3)), "rotation_vector": vector}
    layout = Layout(FAST_LIO, ("rx", "ry", "rz", "x", "y", "z"))
    assert is_refused(states_of, Path("x"), layout, groups, 1) == refused
    named = Layout("named", layout.columns)
    found = states_of(Path("x"), named, groups, 1).quaternions
    assert found is not None
    between = Rotation.from_quat(found[0]).inv() * Rotation.from_rotvec(vector[0])
    assert between.magnitude() < 1e-14


@pytest.mark.parametrize(
    "group", ["covariance", "covariance_upper", "covariance_lower", "variances"]
)
@pytest.mark.parametrize("convention", [FIXED_AXES, BODY_TWISTS])
def test_covariances_are_symmetric_and_about_the_stated_axes(group: str, convention: str) -> None:
    rng = np.random.default_rng(2)
    half = rng.normal(size=(3, 6, 6))
    whole = half @ half.swapaxes(1, 2)
    if group == "variances":
        whole = whole * np.eye(6)
    rows, columns = np.array([[int(digit) - 1 for digit in item[1:]] for item in GROUPS[group]]).T
    turns = Rotation.random(3, random_state=4)
    groups = {
        "position": np.zeros((3, 3)),
        "quaternion": turns.as_quat(),
        group: whole[:, rows, columns],
    }
    layout = Layout("named", (), covariances=convention)
    found = states_of(Path("x"), layout, groups, 3)
    assert found.covariances is not None
    expected = whole
    if convention == BODY_TWISTS:
        both = np.zeros((3, 6, 6))
        both[:, :3, :3] = both[:, 3:, 3:] = turns.as_matrix()
        expected = both @ whole @ both.swapaxes(1, 2)
    np.testing.assert_allclose(found.covariances, expected, rtol=1e-12, atol=1e-12)
    assert len(found.remarks) == (convention == FIXED_AXES)
    del groups["quaternion"]
    assert states_of(Path("x"), layout, groups, 3).covariances is None


def test_columns_of_an_array() -> None:
    turns = Rotation.random(4, random_state=0).as_quat()
    rows = np.hstack([np.arange(4)[:, None] + 0.5, np.ones((4, 3)), turns])
    found = array_trajectory(rows, "vio")
    assert found.stamps.tolist() == [500_000_000 + row * SECOND for row in range(4)]
    np.testing.assert_array_equal(found.positions, np.ones((4, 3)))
    np.testing.assert_allclose(found.quaternions, turns, atol=1e-15)  # type: ignore[arg-type]
    for factor, refused in ((1.0099, False), (1.0101, True), (0.9901, False), (0.9899, True)):
        longer = rows.copy()
        longer[1, 4:] *= factor
        assert is_refused(array_trajectory, longer, "vio") == refused
    unclear = rows.copy()
    unclear[:, 1:5] = unclear[:, 4:]  # both are of unit length
    assert is_refused(array_trajectory, unclear, "vio")
    rows[2, 0] = np.nan
    found = array_trajectory(rows, "vio")
    assert (len(found), found.reading.dropped["not_finite"]) == (3, 1)
    assert found.reading.format == "numpy (N, 8)"
    assert is_refused(array_trajectory, np.array([["a"]]), "vio")
    assert is_refused(array_trajectory, np.zeros((3, 5)), "vio")
    assert is_refused(array_trajectory, np.zeros(3), "vio")
    assert is_refused(array_trajectory, np.zeros((0, 3)), "vio")
