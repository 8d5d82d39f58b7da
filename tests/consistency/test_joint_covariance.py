"""What a joint covariance must be, and how far it may be from the estimate."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given
from hypothesis import strategies as st
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


def test_a_covariance_of_zeros_says_nothing() -> None:
    with pytest.raises(InputError, match="is not positive, which means unknown"):
        _joint(covariance=np.zeros((6 * COUNT, 6 * COUNT))).require_sound()


def test_the_shape_that_the_poses_need_is_said() -> None:
    with pytest.raises(InputError, match=r"is 18 x 24; 24 x 24 is expected for 4 poses .* of 6"):
        _joint(covariance=np.eye(24)[:18]).require_sound()
    with pytest.raises(InputError, match="36 x 36 is expected for 4 poses with blocks of 9"):
        _joint(block=9).require_sound()


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
