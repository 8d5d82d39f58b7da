"""Lengths, axes and stamps of trajectories, in cases worked out by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from strategies import make_groundtruth

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import runs_of
from trajeval_ros.geometry.frame_axes import between_own_axes, upright
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.geometry.interpolation import bracket_stamps, columns_at, slerp_at, steps_at
from trajeval_ros.geometry.pose_conventions import Conventions, mirrored_quaternions
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.trajectory_edits import TimeSpan
from trajeval_ros.geometry.travelled import (
    rotation_angle,
    speeds,
    step_angles,
    step_lengths,
    travelled_distance,
)
from trajeval_ros.geometry.up_axis import UP_AXES, UpAxis

SECOND = 1_000_000_000


@given(st.lists(st.booleans(), max_size=30))
def test_runs_are_those_of_a_loop(flags: list[bool]) -> None:
    expected, begin = [], None
    for row, flag in enumerate([*flags, False]):
        if flag and begin is None:
            begin = row
        if not flag and begin is not None:
            expected.append([begin, row])
            begin = None
    assert runs_of(np.array(flags, dtype=bool)).tolist() == expected


def test_lengths_and_angles_along_a_path() -> None:
    positions = np.array([[0.0, 0, 0], [3, 4, 0], [3, 4, 12], [3, 4, 12]])
    rotations = Rotation.from_rotvec(np.outer([0.0, 0.5, 0.2, 3.2], [1.0, 0, 0])).as_quat()
    np.testing.assert_allclose(step_lengths(positions), [5, 12, 0])
    np.testing.assert_allclose(travelled_distance(positions), [0, 5, 17, 17])
    np.testing.assert_allclose(step_angles(rotations), [0.5, 0.3, 3.0], atol=1e-12)
    np.testing.assert_allclose(rotation_angle(rotations), [0, 0.5, 0.8, 3.8], atol=1e-12)
    stamps = np.array([0, 2, 3, 5]) * SECOND
    linear, angular = speeds(stamps, positions, rotations)
    np.testing.assert_allclose(linear, [2.5, 12, 0])
    assert angular is not None
    np.testing.assert_allclose(angular, [0.25, 0.3, 1.5], atol=1e-12)
    assert speeds(stamps, positions, None)[1] is None


def test_stamps_are_bracketed_by_states() -> None:
    times = np.array([0, 10, 20, 50])
    asked = np.array([-1, 0, 4, 10, 25, 50, 51])
    result = bracket_stamps(times, asked, 10e-9)
    assert result.start.tolist() == [0, 0, 0, 1, 2, 3, 2]
    assert result.end.tolist() == [0, 0, 1, 1, 3, 3, 3]
    np.testing.assert_allclose(result.fraction, [0, 0, 0.4, 0, 1 / 6, 0, 0])
    assert result.early.tolist() == [True, *[False] * 6]
    assert result.late.tolist() == [*[False] * 6, True]
    # The step of 10 ns is no gap, the one of 30 ns is.
    assert result.gap.tolist() == [False, False, False, False, True, False, False]
    assert result.usable.tolist() == [False, True, True, True, False, True, False]
    assert result.dropped("estimate") == {
        "before_estimate": 1, "after_estimate": 1, "in_estimate_gap": 1
    }  # fmt: skip
    assert bracket_stamps(times, asked, 30e-9).usable.tolist()[4]
    assert not bracket_stamps(times, asked, 29e-9).usable.tolist()[4]
    assert result.is_between
    assert not bracket_stamps(times, times, 1.0).is_between
    assert not bracket_stamps(times, np.array([-1, 25]), 10e-9).is_between


def test_columns_between_times() -> None:
    times = np.array([0.0, 1.0, 3.0])
    at = np.array([-0.5, 0.0, 0.25, 1.0, 2.0, 3.0, 4.0])
    before, fraction = steps_at(times, at)
    assert before.tolist() == [0, 0, 0, 1, 1, 1, 1]
    np.testing.assert_allclose(fraction, [-0.5, 0, 0.25, 0, 0.5, 1, 1.5])
    columns = np.array([[0.0, 1.0], [2.0, 0.0], [6.0, 4.0]])
    expected = [[0, 1], [0, 1], [0.5, 0.75], [2, 0], [4, 2], [6, 4], [6, 4]]
    np.testing.assert_allclose(columns_at(times, columns, at), expected)
    rotations = lie.from_rotation_vector(np.outer([0.0, 1.0, 2.0], [0.0, 0.0, 1.0]))
    result = lie.rotation_vector(slerp_at(times, rotations, at))[:, 2]
    np.testing.assert_allclose(result, [0, 0, 0.25, 1, 1.5, 2, 2], atol=1e-12)


@pytest.mark.parametrize("name", UP_AXES)
def test_upright_states_are_turned_as_a_whole(name: str) -> None:
    truth = make_groundtruth(2, 20)
    root = np.random.default_rng(0).normal(size=(20, 6, 6))
    truth = dataclasses.replace(truth, up=UpAxis(name), covariances=root @ np.swapaxes(root, 1, 2))
    result, rotation = upright(truth), UpAxis(name).matrix
    np.testing.assert_allclose(result.positions, truth.positions @ rotation.T)
    assert result.velocities is not None
    assert truth.velocities is not None
    np.testing.assert_allclose(result.velocities, truth.velocities @ rotation.T)
    assert result.rotations is not None
    assert truth.rotations is not None
    np.testing.assert_allclose(
        result.rotations.as_matrix(), rotation @ truth.rotations.as_matrix(), atol=1e-14
    )
    both = np.kron(np.eye(2), rotation)
    assert result.covariances is not None
    assert truth.covariances is not None
    np.testing.assert_allclose(result.covariances, both @ truth.covariances @ both.T, atol=1e-12)
    assert result.up.name == "z"
    assert len(result.reading.remarks) == (name != "z")
    # An alignment of converted trajectories, as one of the original ones.
    similarity = Similarity(Rotation.random(random_state=3).as_matrix(), np.arange(3.0), 2.0)
    back = between_own_axes(similarity, UpAxis("-y"), UpAxis(name))
    np.testing.assert_allclose(
        UpAxis("-y").matrix @ back.positions(truth.positions).T,
        similarity.positions(result.positions).T,
        atol=1e-12,
    )


@pytest.mark.parametrize("axes", ["x,-y,z", "-z,x,y", "-x,-y,-z", "y,x,z"])
def test_mirrored_rotations_are_conjugated_matrices(axes: str) -> None:
    matrix, _ = Conventions(axes=axes)._permutation()
    quaternions = Rotation.random(6, random_state=2).as_quat()
    result = Rotation.from_quat(mirrored_quaternions(quaternions, matrix)).as_matrix()
    expected = matrix @ Rotation.from_quat(quaternions).as_matrix() @ matrix.T
    np.testing.assert_allclose(result, expected, atol=1e-14)


def test_spans_of_time_include_their_ends() -> None:
    path = Trajectory(np.arange(6) * SECOND, np.zeros((6, 3)))
    span = TimeSpan.parse("1", "3")
    assert span is not None
    assert span.cut(path, 0).stamps.tolist() == [SECOND, 2 * SECOND, 3 * SECOND]
    assert span.cut(path, SECOND).stamps.tolist() == [2 * SECOND, 3 * SECOND, 4 * SECOND]
    # The trajectory's clock is 1 s early.
    assert span.cut(path, SECOND, SECOND).stamps.tolist() == [SECOND, 2 * SECOND, 3 * SECOND]
    assert span.cut(path, SECOND, 1).stamps.tolist() == [2 * SECOND, 3 * SECOND]
    with pytest.raises(InputError, match=r"from 0.000 to 5.000 s"):
        span.cut(path, 10 * SECOND)
    for start, end in (("2", "1.9"), ("@2", "@1")):
        with pytest.raises(SettingsError, match="before start"):
            TimeSpan.parse(start, end)
    assert TimeSpan.parse("2", "2") == TimeSpan(2 * SECOND, 2 * SECOND)
    assert TimeSpan.parse("2", "@1") is not None
    for wrong in ("-1", "4e9", "nan", "a"):
        with pytest.raises(SettingsError, match="not valid"):
            TimeSpan.parse(wrong, None)
    assert TimeSpan.parse("@-1", None) == TimeSpan(-SECOND, None, True)
