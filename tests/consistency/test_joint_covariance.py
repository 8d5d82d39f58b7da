"""What a joint covariance must be, and how far it may be from the estimate."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from strategies import make_groundtruth

from trajeval_ros.consistency.joint_covariance import JointCovariance
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.trajectory import Trajectory

COUNT = 4
POSES = make_groundtruth(3, COUNT)


def _joint(poses: Trajectory = POSES, **changes: object) -> JointCovariance:
    assert poses.quaternions is not None
    matrix = 0.01 * np.eye(6 * COUNT)
    joint = JointCovariance(poses.stamps, poses.positions, poses.quaternions, 6, matrix)
    return dataclasses.replace(joint, **changes)  # type: ignore[arg-type]


def _with_entry(row: int, column: int, value: float) -> np.ndarray:
    matrix = np.eye(6 * COUNT)
    matrix[row, column] = value
    return matrix


def test_a_covariance_of_zeros_says_nothing() -> None:
    with pytest.raises(InputError, match="is not positive, which means unknown"):
        _joint(covariance=np.zeros((6 * COUNT, 6 * COUNT))).require_sound()


def test_a_variance_may_be_zero_and_not_less() -> None:
    _joint(covariance=_with_entry(0, 0, 0.0)).require_sound()
    with pytest.raises(InputError, match="is not positive"):
        _joint(covariance=_with_entry(0, 0, -1e-12)).require_sound()


def test_rounding_may_make_a_millionth_of_asymmetry() -> None:
    _joint(covariance=_with_entry(0, 9, 0.99e-6)).require_sound()
    with pytest.raises(InputError, match=r"entries differ by up to 1\.01e-06"):
        _joint(covariance=_with_entry(0, 9, 1.01e-6)).require_sound()


def test_the_shape_that_the_poses_need_is_said() -> None:
    with pytest.raises(InputError, match=r"is 18 x 24; 24 x 24 is expected for 4 poses .* of 6"):
        _joint(covariance=np.eye(24)[:18]).require_sound()
    with pytest.raises(InputError, match="36 x 36 is expected for 4 poses with blocks of 9"):
        _joint(block=9).require_sound()


def test_information_may_reach_a_millionth_along_the_free_gauge() -> None:
    """Relative positions only: a chain. A prior on one position is what `free` denies."""
    size = 6 * COUNT
    rows = np.arange(size - 6)
    steps = scipy.sparse.csr_matrix((np.ones(len(rows)), (rows, rows)), shape=(size - 6, size))
    steps -= scipy.sparse.csr_matrix((np.ones(len(rows)), (rows, rows + 6)), shape=steps.shape)
    chain = (steps.T @ steps).tocsr()
    diagonal = chain.diagonal().reshape(-1, 6)[:, 0].sum()

    def with_prior(share: float, column: int = 0) -> JointCovariance:
        prior = np.zeros(size)
        prior[column] = share * diagonal
        information = (chain + scipy.sparse.diags(prior)).tocsr()
        return _joint(covariance=None, information=information, gauge="free")

    for column in range(3):
        with_prior(0.99e-6, column).require_sound()
        with pytest.raises(InputError, match="a translation of all poses is constrained"):
            with_prior(1.02e-6, column).require_sound()
    with_prior(1.0, 3).require_sound()  # roll is observable
    dataclasses.replace(with_prior(1.0), gauge="prior").require_sound()


@given(st.permutations(range(COUNT)), st.permutations(range(COUNT)), st.integers(1, COUNT))
def test_rows_are_those_of_the_timestamps(stored: list[int], asked: list[int], count: int) -> None:
    rows = _joint(POSES[np.array(stored)]).rows_of(POSES[np.array(asked[:count])])
    assert [stored[row] for row in rows] == asked[:count]


@pytest.mark.parametrize("stamp", [-1, 1])
def test_a_pose_that_the_covariance_lacks_is_named(stamp: int) -> None:
    """Before the first, after the last, and beside one in between."""
    for place in range(COUNT):
        stamps = POSES.stamps.copy()
        stamps[place] += stamp
        with pytest.raises(InputError, match=rf"timestamp {stamps[place]} ns \(1 of 4 missing\)"):
            _joint().rows_of(dataclasses.replace(POSES, stamps=stamps))


def test_poses_may_differ_by_a_tenth_of_a_millimetre_and_of_a_milliradian() -> None:
    def moved(metres: float, radians: float) -> Trajectory:
        assert POSES.quaternions is not None
        positions, quaternions = POSES.positions.copy(), POSES.quaternions.copy()
        positions[2] += metres * np.array([0.6, 0.0, 0.8])
        turn = Rotation.from_rotvec(radians * np.array([0.0, 0.6, 0.8]))
        quaternions[1] = (Rotation.from_quat(quaternions[1]) * turn).as_quat()
        return dataclasses.replace(POSES, positions=positions, quaternions=quaternions)

    assert list(_joint().rows_of(moved(0.99e-4, 0.99e-4))) == list(range(COUNT))
    with pytest.raises(InputError, match=r"up to 0\.000101 m and 0 deg"):
        _joint().rows_of(moved(1.01e-4, 0.0))
    with pytest.raises(InputError, match=r"up to 0 m and 0\.0058 deg"):
        _joint().rows_of(moved(0.0, 1.0123e-4))


@pytest.mark.parametrize("block", [6, 9])
def test_the_covariance_of_some_poses_is_that_of_their_rows(block: int) -> None:
    root = np.random.default_rng(0).normal(size=(block * COUNT, block * COUNT))
    full = root @ root.T
    some = np.array([3, 1])
    chosen = [block * pose + row for pose in some for row in range(6)]
    expected = full[chosen][:, chosen]
    dense = _joint(block=block, covariance=full)
    information = scipy.sparse.csr_matrix(np.linalg.inv(full))
    sparse = _joint(block=block, covariance=None, information=information, gauge="prior")
    np.testing.assert_array_equal(dense.pose_covariance(some), expected)
    tolerance = 1e-12 * np.linalg.cond(full) * full.max()
    np.testing.assert_allclose(sparse.pose_covariance(some), expected, rtol=0.0, atol=tolerance)
