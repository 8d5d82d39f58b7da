"""Rotations, covariances and arrays of text files."""

from __future__ import annotations

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


@given(st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_angles_are_about_z_then_y_then_x(angles: list[float]) -> None:
    layout, groups = groups_of("x y z roll pitch yaw", [[0, 0, 0, *angles]])
    result = states_of(Path("x"), layout, groups, 1)
    about = [np.array(axis) * angle for axis, angle in zip(np.eye(3), angles, strict=True)]
    x, y, z = map(Rotation.from_rotvec, about)
    assert result.quaternions is not None
    assert (Rotation.from_quat(result.quaternions[0]).inv() * z * y * x).magnitude() < 1e-14


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
    rotations = Rotation.random(3, random_state=4)
    groups = {
        "position": np.zeros((3, 3)),
        "quaternion": rotations.as_quat(),
        group: whole[:, rows, columns],
    }
    layout = Layout("named", (), covariances=convention)
    result = states_of(Path("x"), layout, groups, 3)
    assert result.covariances is not None
    expected = whole
    if convention == BODY_TWISTS:
        both = np.zeros((3, 6, 6))
        both[:, :3, :3] = both[:, 3:, 3:] = rotations.as_matrix()
        expected = both @ whole @ both.swapaxes(1, 2)
    np.testing.assert_allclose(result.covariances, expected, rtol=1e-12, atol=1e-12)
    assert len(result.remarks) == (convention == FIXED_AXES)
    del groups["quaternion"]
    assert states_of(Path("x"), layout, groups, 3).covariances is None


def test_columns_of_an_array() -> None:
    rotations = Rotation.random(4, random_state=0).as_quat()
    rows = np.hstack([np.arange(4)[:, None] + 0.5, np.ones((4, 3)), rotations])
    result = array_trajectory(rows, "vio")
    assert result.stamps.tolist() == [500_000_000 + row * SECOND for row in range(4)]
    np.testing.assert_array_equal(result.positions, np.ones((4, 3)))
    np.testing.assert_allclose(result.quaternions, rotations, atol=1e-15)  # type: ignore[arg-type]
    for factor, refused in ((1.0099, False), (1.0101, True), (0.9901, False), (0.9899, True)):
        longer = rows.copy()
        longer[1, 4:] *= factor
        assert is_refused(array_trajectory, longer, "vio") == refused
    unclear = rows.copy()
    unclear[:, 1:5] = unclear[:, 4:]  # both are of unit length
    assert is_refused(array_trajectory, unclear, "vio")
    for clock in (unclear[:, 0], 21.0 * np.arange(4)):  # maybe in milliseconds
        rows_of_clock = np.column_stack([clock, unclear[:, 1:]])
        with pytest.raises(InputError, match=r"; pass columns to Trajectory\.from_positions\Z"):
            array_trajectory(rows_of_clock, "vio")
    rows[2, 0] = np.nan
    result = array_trajectory(rows, "vio")
    assert (len(result), result.reading.dropped["not_finite"]) == (3, 1)
    assert result.reading.format == "numpy (N, 8)"
    assert is_refused(array_trajectory, np.array([["a"]]), "vio")
    assert is_refused(array_trajectory, np.zeros((3, 5)), "vio")
    assert is_refused(array_trajectory, np.zeros(3), "vio")
    assert is_refused(array_trajectory, np.zeros((0, 3)), "vio")
