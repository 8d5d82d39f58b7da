"""Arrays that users give: times, shapes, matrices and the order of quaternions."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import array_input
from trajeval_ros.geometry.trajectory import Trajectory

Array = NDArray[np.float64]


SECOND = 1_000_000_000


def test_seconds_become_nanoseconds_exactly() -> None:
    seconds = [1_700_000_000.25, -0.5, 0.1, 2.0000000004]
    result = array_input.stamps_of(seconds, None, 4)
    assert result is not None
    assert result.tolist() == [1_700_000_000_250_000_000, -500_000_000, 100_000_000, 2 * SECOND]
    assert array_input.stamps_of([9.2e9], None, 1) is not None
    with pytest.raises(InputError, match="probably milliseconds"):
        array_input.stamps_of([9.3e9], None, 1)
    with pytest.raises(InputError, match="not finite in row 1"):
        array_input.stamps_of([0.0, np.inf], None, 2)
    with pytest.raises(InputError, match="given twice"):
        array_input.stamps_of([0.0], [0], 1)
    with pytest.raises(InputError, match="integer nanoseconds"):
        array_input.stamps_of(None, [0.5], 1)
    with pytest.raises(InputError, match=r"shape \(1,\), expected \(2,\)"):
        array_input.stamps_of(None, [0], 2)
    assert array_input.stamps_of(None, None, 3) is None


@pytest.mark.parametrize(
    ("values", "shapes"),
    [
        (np.zeros((2, 3)), r"\(N, 4\) or \(2, 2\)"),
        (np.zeros((2, 4, 1)), r"\(N, 4\) or \(2, 2\)"),
        (np.zeros(4), r"\(N, 4\) or \(2, 2\)"),
    ],
)
def test_shapes_that_are_wrong(values: Array, shapes: str) -> None:
    with pytest.raises(InputError, match=shapes):
        array_input.require_shape(values, "rows", (None, 4), (2, 2))
    array_input.require_shape(np.zeros((2, 2)), "rows", (None, 4), (2, 2))
    array_input.require_shape(np.zeros((9, 4)), "rows", (None, 4), (2, 2))


def test_matrices_that_are_no_poses() -> None:
    good = np.tile(np.eye(4), (3, 1, 1))
    array_input.require_poses(good)
    scaled = good.copy()
    scaled[1, :3, :3] *= 1.0 + 0.49e-3  # of squares, 0.98e-3
    array_input.require_poses(scaled)
    scaled[1, :3, :3] = np.eye(3) * (1.0 + 0.51e-3)
    with pytest.raises(InputError, match="matrix 1 has no rotation"):
        array_input.require_poses(scaled)
    mirrored = good.copy()
    mirrored[2, 0, 0] = -1.0
    with pytest.raises(InputError, match="matrix 2 has no rotation"):
        array_input.require_poses(mirrored)
    last = good.copy()
    last[1, 3, 0] = 0.9e-6
    array_input.require_poses(last)
    last[1, 3, 0] = -1.1e-6
    last[0] = np.nan  # rows of NaN are left, and counted
    with pytest.raises(InputError, match="matrix 1 has the last row"):
        array_input.require_poses(last)
    rotations = Rotation.random(5, random_state=0).as_matrix()
    rough = rotations.copy()
    rough += 1e-5 * np.random.default_rng(0).normal(size=(5, 3, 3))
    result = Rotation.from_quat(array_input.quaternions_of(rough)).as_matrix()
    np.testing.assert_allclose(result, rotations, atol=1e-4)
    rough[3], rough[4] = np.nan, -rough[4]
    assert np.isnan(array_input.quaternions_of(rough)).all(axis=1).tolist() == [
        False, False, False, True, True
    ]  # fmt: skip
    with pytest.raises(InputError, match="not an array of real numbers"):
        array_input.numbers([[1, 2], [3]], "rows")
    with pytest.raises(InputError, match="not an array of real numbers"):
        array_input.numbers(["a"], "rows")


def test_wxyz_is_another_order() -> None:
    positions = np.zeros((2, 3))
    first = Trajectory.from_positions(positions, [[1, 0, 0, 0], [0, 1, 0, 0]], wxyz=True)
    assert first.quaternions is not None
    assert first.quaternions.tolist() == [[0, 0, 0, 1], [1, 0, 0, 0]]
    assert first.stamps.tolist() == [0, SECOND]
    assert not first.reading.stamped
