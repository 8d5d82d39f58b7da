"""Limits and small rules of trajectories, axes and stamps, in cases worked out by hand."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from strategies import make_groundtruth

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import at_rows, extents, runs_of
from trajeval_ros.geometry.frame_axes import between_own_axes, upright, with_world_axes
from trajeval_ros.geometry.gauge import Gauge, Similarity
from trajeval_ros.geometry.interpolation import bracket_stamps, columns_at, slerp_at, steps_at
from trajeval_ros.geometry.pose_conventions import Conventions, mirrored_quaternions
from trajeval_ros.geometry.receptions import LOG, ReceiveTimes
from trajeval_ros.geometry.stamp_trust import trusted_states
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.trajectory_edits import TimeSpan
from trajeval_ros.geometry.travelled import (
    speeds,
    step_angles,
    step_lengths,
    travelled_distance,
    turned_angle,
)
from trajeval_ros.geometry.up_axis import UP_AXES, UpAxis
from trajeval_ros.geometry.valid_poses import (
    add_counts,
    at_length_one,
    conflicts_of,
    reasons,
    valid_mask,
)

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


def test_extents_are_by_column() -> None:
    assert extents(np.array([[1.0, 5.0], [4.0, -1.0], [2.0, 0.0]])).tolist() == [3.0, 6.0]


def test_rows_of_columns_that_exist() -> None:
    both = ReceiveTimes(np.arange(4), "node", None, None, np.arange(4) + 10)
    part = at_rows(both, ("times", "body_rates", "corrected"), slice(1, 3), by="log")
    assert part.times.tolist() == [1, 2]
    assert part.body_rates is None
    assert part.corrected is not None
    assert part.corrected.tolist() == [11, 12]
    assert part.by == "log"


def test_lengths_and_angles_along_a_path() -> None:
    positions = np.array([[0.0, 0, 0], [3, 4, 0], [3, 4, 12], [3, 4, 12]])
    turns = Rotation.from_rotvec(np.outer([0.0, 0.5, 0.2, 3.2], [1.0, 0, 0])).as_quat()
    np.testing.assert_allclose(step_lengths(positions), [5, 12, 0])
    np.testing.assert_allclose(travelled_distance(positions), [0, 5, 17, 17])
    np.testing.assert_allclose(step_angles(turns), [0.5, 0.3, 3.0], atol=1e-12)
    np.testing.assert_allclose(turned_angle(turns), [0, 0.5, 0.8, 3.8], atol=1e-12)
    stamps = np.array([0, 2, 3, 5]) * SECOND
    linear, angular = speeds(stamps, positions, turns)
    np.testing.assert_allclose(linear, [2.5, 12, 0])
    assert angular is not None
    np.testing.assert_allclose(angular, [0.25, 0.3, 1.5], atol=1e-12)
    assert speeds(stamps, positions, None)[1] is None


def test_stamps_are_bracketed_by_states() -> None:
    times = np.array([0, 10, 20, 50])
    asked = np.array([-1, 0, 4, 10, 25, 50, 51])
    found = bracket_stamps(times, asked, 10e-9)
    assert found.start.tolist() == [0, 0, 0, 1, 2, 3, 2]
    assert found.end.tolist() == [0, 0, 1, 1, 3, 3, 3]
    np.testing.assert_allclose(found.fraction, [0, 0, 0.4, 0, 1 / 6, 0, 0])
    assert found.early.tolist() == [True, *[False] * 6]
    assert found.late.tolist() == [*[False] * 6, True]
    # The step of 10 ns is no gap, the one of 30 ns is.
    assert found.gap.tolist() == [False, False, False, False, True, False, False]
    assert found.usable.tolist() == [False, True, True, True, False, True, False]
    assert found.dropped("estimate") == {
        "before_estimate": 1, "after_estimate": 1, "in_estimate_gap": 1
    }  # fmt: skip
    assert bracket_stamps(times, asked, 30e-9).usable.tolist()[4]
    assert not bracket_stamps(times, asked, 29e-9).usable.tolist()[4]
    assert found.is_between
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
    turns = lie.from_rotation_vector(np.outer([0.0, 1.0, 2.0], [0.0, 0.0, 1.0]))
    found = lie.rotation_vector(slerp_at(times, turns, at))[:, 2]
    np.testing.assert_allclose(found, [0, 0, 0.25, 1, 1.5, 2, 2], atol=1e-12)


@pytest.mark.parametrize("name", UP_AXES)
def test_the_up_axis_becomes_z(name: str) -> None:
    axis = UpAxis(name)
    up = np.zeros(3)
    up["xyz".index(name[-1])] = -1.0 if name.startswith("-") else 1.0
    np.testing.assert_array_equal(axis.matrix @ up, [0.0, 0.0, 1.0])
    assert np.linalg.det(axis.matrix) == pytest.approx(1.0)
    vectors = np.random.default_rng(0).normal(size=(4, 3))
    np.testing.assert_array_equal(axis.turned(vectors), vectors @ axis.matrix.T)
    quaternions = Rotation.random(4, random_state=1).as_quat()
    turned = Rotation.from_quat(axis.turned(quaternions)).as_matrix()
    expected = axis.matrix @ Rotation.from_quat(quaternions).as_matrix() @ axis.matrix.T
    np.testing.assert_allclose(turned, expected, atol=1e-14)
    converted = UpAxis("z", f"rotated from {name}, given")
    np.testing.assert_array_equal(converted.applied, axis.matrix)
    np.testing.assert_array_equal(axis.applied, np.eye(3))


@pytest.mark.parametrize("name", UP_AXES)
def test_upright_states_are_turned_as_a_whole(name: str) -> None:
    truth = make_groundtruth(2, 20)
    root = np.random.default_rng(0).normal(size=(20, 6, 6))
    truth = dataclasses.replace(truth, up=UpAxis(name), covariances=root @ np.swapaxes(root, 1, 2))
    found, turn = upright(truth), UpAxis(name).matrix
    np.testing.assert_allclose(found.positions, truth.positions @ turn.T)
    assert found.velocities is not None
    assert truth.velocities is not None
    np.testing.assert_allclose(found.velocities, truth.velocities @ turn.T)
    assert found.rotations is not None
    assert truth.rotations is not None
    np.testing.assert_allclose(
        found.rotations.as_matrix(), turn @ truth.rotations.as_matrix(), atol=1e-14
    )
    both = np.kron(np.eye(2), turn)
    assert found.covariances is not None
    assert truth.covariances is not None
    np.testing.assert_allclose(found.covariances, both @ truth.covariances @ both.T, atol=1e-12)
    assert found.up.name == "z"
    assert len(found.reading.remarks) == (name != "z")
    # An alignment of converted trajectories, as one of the original ones.
    similarity = Similarity(Rotation.random(random_state=3).as_matrix(), np.arange(3.0), 2.0)
    back = between_own_axes(similarity, UpAxis("-y"), UpAxis(name))
    np.testing.assert_allclose(
        UpAxis("-y").matrix @ back.positions(truth.positions).T,
        similarity.positions(found.positions).T,
        atol=1e-12,
    )


def test_axes_that_are_there_already_are_refused() -> None:
    optical = with_world_axes(make_groundtruth(1, 10), "optical")
    assert optical.up.name == "-y"
    with pytest.raises(InputError, match="already has optical axes"):
        with_world_axes(optical, "optical")
    assert with_world_axes(optical, "ros").up.name == "z"


def test_times_of_reception_are_published_ones_if_they_differ() -> None:
    logged, published = np.array([10, 20, 31]) * SECOND, np.array([9, 18, 30]) * SECOND
    found = ReceiveTimes.of_bag(logged, published)
    assert (found.by, found.recording_s) == ("publish", (1.0, 2.0))
    assert found.times is published
    assert ReceiveTimes.of_bag(logged, published, LOG).times is logged
    assert ReceiveTimes.of_bag(logged, logged.copy()).by == "log"
    assert ReceiveTimes.of_bag(logged, np.array([0, 18, 30])).by == "log"
    assert ReceiveTimes.of_bag(logged, np.array([1, 18, 30])).by == "publish"


def test_poses_that_are_usable() -> None:
    positions = np.zeros((6, 3))
    positions[1, 2], positions[2, 0], positions[3, 1] = 1e12, 1.0001e12, np.nan
    quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (6, 1))
    quaternions[4], quaternions[5] = [0, 0, 0, 0.99e-6], [0, 1.01e-6, 0, 0]
    finite, nonzero = valid_mask(positions, quaternions)
    assert finite.tolist() == [True, True, False, False, True, True]
    assert nonzero.tolist() == [True, True, True, True, False, True]
    quaternions[1, 0] = 1e200
    assert not valid_mask(positions, quaternions)[0][1]
    assert valid_mask(positions)[1].all()


def test_unit_quaternions_keep_their_digits() -> None:
    eps = np.finfo(float).eps
    unit = np.array([0.5, 0.5, 0.5, 0.5])
    rows = np.array([unit * (1.0 + 3.0 * eps), unit * (1.0 + 20.0 * eps), unit * 2.0])
    found = at_length_one(rows)
    assert found[0].tolist() == rows[0].tolist()
    assert found[1].tolist() != rows[1].tolist()
    np.testing.assert_allclose(found, np.tile(unit, (3, 1)), rtol=1e-15)


def test_conflicts_are_farther_apart_than_neighbours() -> None:
    stamps = np.array([0, 1, 1, 2, 3, 3, 4])
    positions = np.zeros((7, 3))
    positions[:, 0] = [0.0, 1.0, 2.9, 2.0, 3.0, 3.1, 4.0]
    # The neighbours are 2 m apart, and three median steps are 3 m.
    assert conflicts_of(stamps, positions) == (0, 0.0)
    positions[2, 0] = 4.01
    number, largest = conflicts_of(stamps, positions)
    assert number == 1
    assert largest == pytest.approx(3.01)
    positions[5, 0] = 8.0
    assert conflicts_of(stamps, positions) == (2, 5.0)
    # A fast step: what noise explains is less than the way of the neighbours.
    positions[:, 0] = [0.0, 1.0, 9.0, 11.0, 12.0, 12.0, 13.0]
    assert conflicts_of(stamps, positions)[0] == 0
    positions[2, 0] = 12.1
    assert conflicts_of(stamps, positions)[0] == 1
    assert conflicts_of(np.array([5, 5]), np.array([[0.0, 0, 0], [1, 0, 0]])) == (1, 1.0)


def test_counts_add_up_without_zeros() -> None:
    assert add_counts({"a": 1, "b": 0}, {"a": 2, "c": 3}) == {"a": 3, "c": 3}
    assert reasons({"not_finite": 3, "before_groundtruth": 12}) == (
        "3 not finite, 12 before the groundtruth"
    )


@pytest.mark.parametrize("axes", ["x,-y,z", "-z,x,y", "-x,-y,-z", "y,x,z"])
def test_mirrored_rotations_are_conjugated_matrices(axes: str) -> None:
    matrix, _ = Conventions(axes=axes)._permutation()
    quaternions = Rotation.random(6, random_state=2).as_quat()
    found = Rotation.from_quat(mirrored_quaternions(quaternions, matrix)).as_matrix()
    expected = matrix @ Rotation.from_quat(quaternions).as_matrix() @ matrix.T
    np.testing.assert_allclose(found, expected, atol=1e-14)


@pytest.mark.parametrize(
    "wrong",
    [
        {"scale": 0.0}, {"scale": np.inf}, {"clock_rate": -0.91e6}, {"clock_rate": 9.1e6},
        {"axes": "x,y"}, {"axes": "rotations=x,-y,z"},
    ],
)  # fmt: skip
def test_conventions_have_their_limits(wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError):
        Conventions(**wrong)
    Conventions(scale=1e-9, clock_rate=-0.9e6, axes="positions=x,-y,z")
    Conventions(scale=1e9, clock_rate=9e6, axes="rotations=-x,-y,z")


@pytest.mark.parametrize(
    ("gauge", "states", "first"),
    [(Gauge.SIM3, 3, 2), (Gauge.SE3, 3, 2), (Gauge.YAW, 2, 2), (Gauge.PLANAR, 2, 2),
     (Gauge.TRANSLATION, 1, 2), (Gauge.NONE, 1, 2)],
)  # fmt: skip
def test_an_alignment_needs_twice_its_states(gauge: Gauge, states: int, first: int) -> None:
    assert gauge.minimum_states == states
    assert gauge.enough_pairs(None) == gauge.enough_pairs(7) == 2 * states
    assert gauge.enough_pairs(1) == first


@pytest.mark.parametrize(
    ("seconds", "trusted", "farthest"),
    [
        ([1e6, 0, 0.1, 0.2], [1, 2, 3], 1e6),
        # Within a second, stamps are near.
        ([0, 1.0, 2.0], [0, 1, 2], 0.0),
        ([0, 0.5, 1.6, 0.9], [0, 1, 2, 3], 0.0),
        ([0, 0.5, 1.6, 0.55], [0, 1, 3], 1.05),
        # Two far ones beside each other are a jump of time.
        ([0, 0.1, 100, 100.1], [0, 1, 2, 3], 0.0),
        ([0, 0.1, 100, 0.2], [0, 1, 3], 99.8),
        # Three that increase are a slow stream.
        ([0, 2, 4, 6], [0, 1, 2, 3], 0.0),
        # At the end, a gap of a minute is believed.
        ([0, 0.1, 60.1], [0, 1, 2], 0.0),
        ([0, 0.1, 60.2], [0, 1], 60.1),
        ([0, 0.1, -5.0], [0, 1], 5.1),
        ([10.0], [0], 0.0),
    ],
)  # fmt: skip
def test_stamps_that_stand_alone(
    seconds: list[float], trusted: list[int], farthest: float
) -> None:
    stamps = np.array([round(second * SECOND) for second in seconds]) + 10**18
    rows, trust = trusted_states(stamps)
    assert rows.tolist() == trusted
    assert trust.lone == len(seconds) - len(trusted)
    assert trust.farthest_ns == round(farthest * SECOND)
    assert (f"{farthest:.4g} s" in trust.message) == (trust.lone > 0)
    assert trust.message.startswith("1 pose dropped" if trust.lone else "")


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
