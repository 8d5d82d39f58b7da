"""Trajectories: cleaning, order, slices, lengths."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp
from state_rows import states, trajectory
from strategies import make_groundtruth, seeds

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.source_info import SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.travelled import travelled_distance
from trajeval_ros.geometry.valid_poses import add_counts
from trajeval_ros.io.bags.transform_tree import Edge
from trajeval_ros.metrics.association import associate
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.online.pairing import Pairing

# A position and a factor of a quaternion that no robot has, finite or not.
WILD = [(1e13, 1.0), (-1e100, 1.0), (1e200, 1.0), (1.0, 1e160), (1.0, 1e300)]


def stamps(count: int) -> np.ndarray:
    return np.arange(count, dtype=np.int64) * 10**9


def test_rows_that_are_no_poses_are_dropped_and_counted_by_reason() -> None:
    positions = np.arange(18.0).reshape(6, 3)
    quaternions = np.tile([0.0, 0.0, 0.0, 2.0], (6, 1))
    velocities = np.ones((6, 3))
    positions[0, 1] = np.nan
    quaternions[1] = 0.0
    quaternions[2, 0] = np.inf
    velocities[1, 2] = np.nan  # in a row that is dropped anyway
    quaternions[0] = 0.0  # two reasons count as one row
    read = Trajectory.from_columns(
        stamps(6),
        positions,
        quaternions,
        velocities=velocities,
        reading=SourceInfo(dropped={"half_a_line": 2}),
    )
    np.testing.assert_array_equal(read.stamps, stamps(6)[3:])
    np.testing.assert_array_equal(read.positions, positions[3:])
    np.testing.assert_array_equal(read.velocities, velocities[3:])
    assert read.reading.dropped == {"half_a_line": 2, "not_finite": 2, "zero_quaternion": 1}


@pytest.mark.parametrize("order", ["C", "F"])
def test_columns_of_a_wide_table_are_stored_contiguously(order: Literal["C", "F"]) -> None:
    rows = np.asarray(np.random.default_rng(1).normal(size=(50, 13)), order=order)
    rows[:, 3:7] /= np.linalg.norm(rows[:, 3:7], axis=1, keepdims=True)
    made = Trajectory(stamps(50), rows[:, :3], rows[:, 3:7], rows[:, 7:10])
    for one in (made, made[::2], made[np.arange(50) > 7]):
        for column in (one.stamps, one.positions, one.quaternions, one.velocities):
            assert column is not None
            assert column.flags.c_contiguous
    np.testing.assert_array_equal(made.positions, rows[:, :3])
    np.testing.assert_array_equal(made.quaternions, rows[:, 3:7])
    plain = rows[:, :3].copy()
    assert Trajectory(stamps(50), plain).positions is plain


@pytest.mark.parametrize("row", WILD, ids=str)
def test_numbers_too_large_to_be_squared_are_no_pose(row: tuple[float, float]) -> None:
    position, factor = row
    positions, quaternions = np.ones((4, 3)), np.tile([0.0, 0.6, 0.0, 0.8], (4, 1))
    positions[1, 2] = position
    quaternions[1] *= factor
    read = Trajectory.from_columns(stamps(4), positions, quaternions)
    assert read.reading.dropped == {"not_finite": 1}
    assert read.quaternions is not None
    np.testing.assert_allclose(np.linalg.norm(read.quaternions, axis=1), 1.0)
    np.testing.assert_array_equal(np.delete(positions, 1, 0), read.positions)
    numbers = np.hstack([positions, quaternions])
    assert len(Edge.from_columns(stamps(5)[1:], numbers, False).stamps) == 3
    if factor == 1.0:
        with pytest.raises(InputError, match="beyond 1e\\+12 m"):
            Trajectory(stamps(4), positions).require_usable()


@given(seed=seeds)
def test_the_same_rows_are_poses_live_and_recorded(seed: int) -> None:
    random = np.random.default_rng(seed)
    truth = make_groundtruth(seed)
    assert truth.quaternions is not None
    positions, quaternions = truth.positions.copy(), truth.quaternions.copy()
    strange = [0.0, 1e-7, 1e-5, 1e11, 1e13, -1e100, 1e160, np.inf, np.nan]
    for column in (positions, quaternions):
        some = random.integers(0, len(truth), 20)
        column[some] = random.choice(strange, (20, 1))
    read = Trajectory.from_columns(truth.stamps, positions, quaternions)
    pairs = associate(truth, read, AssociationRule())
    buffer = Pairing()
    buffer.add_groundtruth(trajectory(truth.stamps, states(truth.positions, truth.quaternions)))
    block = trajectory(truth.stamps, states(positions, quaternions))
    buffer.add_estimate(block)
    live = buffer.made(at_end=True)
    assert live is not None
    np.testing.assert_array_equal(live.stamps, pairs.estimate.stamps)
    np.testing.assert_array_equal(live.estimate.positions, pairs.estimate.positions)
    dropped = add_counts(block.reading.dropped, buffer.dropped)
    assert {reason: n for reason, n in dropped.items() if n} == pairs.dropped


@pytest.mark.parametrize("column", ["velocities", "gyroscope_biases", "accelerometer_biases"])
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_columns_that_are_not_finite_throughout_are_left_out_and_said_so(
    column: str, value: float
) -> None:
    numbers = np.zeros((4, 3))
    numbers[2, 1] = value
    read = Trajectory.from_columns(
        stamps(4), np.ones((4, 3)), np.tile([0, 0, 0, 1.0], (4, 1)), **{column: numbers}
    )
    assert len(read) == 4
    assert getattr(read, column) is None
    assert any(column.replace("_", " ") in note for note in read.reading.messages(Level.NOTE))


def test_nothing_left_is_an_empty_trajectory_that_says_why() -> None:
    read = Trajectory.from_columns(stamps(3), np.full((3, 3), np.nan), np.ones((3, 4)))
    assert len(read) == 0
    assert read.path_length_m == 0.0
    assert read.duration_s == 0.0
    assert len(read.in_order()) == 0
    with pytest.raises(InputError, match="3 not_finite"):
        read.require_usable()


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"positions": np.zeros((3, 2))}, "positions"),
        ({"positions": np.zeros((4, 3))}, "positions"),
        ({"quaternions": np.eye(4)[:2]}, "quaternions"),
        ({"quaternions": np.eye(4)[3]}, "quaternions"),
        ({"velocities": np.zeros((3, 4))}, "velocities"),
        ({"covariances": np.zeros((3, 6))}, "covariances"),
    ],
)
def test_columns_of_a_wrong_shape_are_refused(columns: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Trajectory(**({"stamps": stamps(3), "positions": np.zeros((3, 3))} | columns))


def test_a_column_must_be_an_array() -> None:
    with pytest.raises(TypeError, match="quaternions must be a numpy array, not Rotation"):
        Trajectory(stamps(3), np.zeros((3, 3)), Rotation.identity(3))  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="positions must be a numpy array, not list"):
        Trajectory(stamps(1), [[0.0, 0.0, 0.0]])  # type: ignore[arg-type]


@given(seed=seeds, count=st.integers(1, 300), row=st.integers(0, 299))
@pytest.mark.parametrize("factor", [0.0, 0.9999, 2.0, np.nan, np.inf])
def test_one_quaternion_that_is_not_unit_is_refused(
    factor: float, seed: int, count: int, row: int
) -> None:
    quaternions = Rotation.random(count, random_state=seed % 2**31).as_quat()
    assert len(Trajectory(stamps(count), np.zeros((count, 3)), quaternions)) == count
    with np.errstate(invalid="ignore"):
        quaternions[row % count] *= factor
    with pytest.raises(ValueError, match="length 1"):
        Trajectory(stamps(count), np.zeros((count, 3)), quaternions)


@given(seed=seeds, size=st.sampled_from([1e-5, 0.1, 1.0, 7.0, 1e150]))
def test_quaternions_are_normalised_once(seed: int, size: float) -> None:
    raw = np.random.default_rng(seed).normal(scale=size, size=(200, 4))
    read = Trajectory.from_columns(stamps(200), np.zeros((200, 3)), raw)
    assert read.quaternions is not None
    assert read.rotations is not None
    expected = Rotation.from_quat(raw).as_quat()
    np.testing.assert_allclose(read.quaternions, expected, rtol=1e-15)
    np.testing.assert_array_equal(read.rotations.as_quat(), read.quaternions)


def test_rotations_are_none_without_quaternions_and_as_many_as_there_are() -> None:
    positions = np.zeros((3, 3))
    assert Trajectory(stamps(3), positions).rotations is None
    for count in (0, 1, 3):
        quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
        rotations = Trajectory(stamps(count), positions[:count], quaternions).rotations
        assert rotations is not None
        assert not rotations.single
        assert len(rotations) == count


def test_its_repr_is_a_line_without_arrays() -> None:
    positions = np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [3.0, 4.0, 1.25]])
    named = Trajectory(stamps(3), positions, name="vio", frame="odom", child_frame="base_link")
    assert repr(named) == "<Trajectory vio, 3 poses, 2.0 s, 6.2 m, base_link in odom>"
    assert repr(named[:1]) == "<Trajectory vio, 1 pose, 0.0 s, 0.0 m, base_link in odom>"
    assert (
        repr(Trajectory(stamps(0), positions[:0])) == "<Trajectory unnamed, 0 poses, 0.0 s, 0.0 m>"
    )


def test_stamps_must_be_whole_nanoseconds() -> None:
    with pytest.raises(TypeError, match="int64"):
        Trajectory(stamps=np.arange(3.0), positions=np.zeros((3, 3)))  # type: ignore[arg-type]


@given(seed=seeds)
def test_putting_in_order_undoes_any_shuffle(seed: int) -> None:
    trajectory = make_groundtruth(seed, 40)
    order = np.random.default_rng(seed).permutation(40)
    restored = trajectory[order].in_order()
    np.testing.assert_array_equal(restored.stamps, trajectory.stamps)
    np.testing.assert_array_equal(restored.positions, trajectory.positions)
    np.testing.assert_array_equal(restored.quaternions, trajectory.quaternions)
    np.testing.assert_array_equal(restored.velocities, trajectory.velocities)
    assert restored.reading.dropped == {}


def test_of_equal_stamps_the_first_stays_and_the_others_are_counted() -> None:
    times = np.array([3, 1, 1, 2, 3, 3], dtype=np.int64)
    positions = np.arange(18.0).reshape(6, 3)
    ordered = Trajectory(times, positions, name="odometry").in_order()
    np.testing.assert_array_equal(ordered.stamps, [1, 2, 3])
    np.testing.assert_array_equal(ordered.positions, positions[[1, 3, 0]])
    assert ordered.reading.dropped == {"duplicate_stamp": 3}
    assert "timestamps step back at 1 place" in ordered.reading.messages(Level.NOTE)[0]


@given(seed=seeds, coarse=st.integers(2, 3))
def test_rounded_stamps_dont_conflict(seed: int, coarse: int) -> None:
    # Poses on a line, never turning back, several of them with one stamp.
    moved_m = np.random.default_rng(seed).uniform(0.01, 0.02, 60)
    positions = np.outer(np.cumsum(moved_m), [0.6, 0.8, 0.0])
    rounded = stamps(60) // (coarse * 10**9) * coarse * 10**9
    ordered = Trajectory(rounded, positions).in_order()
    assert ordered.reading.dropped["duplicate_stamp"] == 60 - len(set(rounded.tolist()))
    assert ordered.reading.messages(Level.WARNING) == ()


@given(seed=seeds, place=st.integers(1, 57), offset_m=st.floats(1.0, 1e3), early=st.booleans())
def test_repeats_that_are_elsewhere_are_told_with_their_distance(
    seed: int, place: int, offset_m: float, early: bool
) -> None:
    moved_m = np.random.default_rng(seed).uniform(0.01, 0.02, 60)
    positions = np.outer(np.cumsum(moved_m), [0.6, 0.8, 0.0])
    times = stamps(60)
    times[place + 1] = times[place]
    positions[place + 1] = positions[place]
    positions[place if early else place + 1, 2] += offset_m
    (text,) = Trajectory(times, positions, name="mocap").in_order().reading.messages(Level.WARNING)
    assert text.startswith("mocap has 1 repeated timestamp (of 1) with different positions")
    assert f"up to {offset_m:.3g} m apart" in text


def test_slices_masks_and_indices_pick_rows_of_all_columns() -> None:
    trajectory = make_groundtruth(2, 20)
    mask = np.arange(20) % 3 == 0
    by_slice, by_mask = trajectory[::3], trajectory[mask]
    by_index = trajectory[np.flatnonzero(mask)]
    for picked in (by_mask, by_index):
        np.testing.assert_array_equal(picked.stamps, by_slice.stamps)
        np.testing.assert_array_equal(picked.quaternions, by_slice.quaternions)
        np.testing.assert_array_equal(picked.velocities, by_slice.velocities)
        np.testing.assert_array_equal(picked.gyroscope_biases, by_slice.gyroscope_biases)
    assert len(by_slice) == 7


def test_travelled_distance_is_along_the_path() -> None:
    corners = np.array([[0, 0, 0], [3, 4, 0], [3, 4, 12], [3, 4, 12], [0, 0, 12]], dtype=float)
    np.testing.assert_array_equal(travelled_distance(corners), [0, 5, 17, 17, 22])
    assert travelled_distance(corners[:1]).tolist() == [0.0]
    assert travelled_distance(corners[:0]).tolist() == []


def test_times_keep_nanoseconds_after_decades() -> None:
    start = 1_700_000_000_123_456_789
    trajectory = Trajectory(np.array([start, start + 1], dtype=np.int64), np.zeros((2, 3)))
    np.testing.assert_allclose(trajectory.seconds, [0.0, 1e-9], rtol=1e-12)


@given(seed=seeds)
def test_states_between_states_are_linear_and_turn_evenly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.integers(1, 10**9, 20))
    rotations = Rotation.random(20, random_state=seed % 2**31)
    path = Trajectory.from_columns(
        times, rng.normal(size=(20, 3)), rotations.as_quat(), velocities=rng.normal(size=(20, 3))
    )
    selected = np.concatenate([rng.integers(times[0] - 10, times[-1] + 10, 50), times])
    result, bracket = path.at(selected, max_gap_s=0.5)
    gap = np.append(np.diff(times) > 5 * 10**8, False)
    before = np.searchsorted(times, selected, side="right") - 1
    at_state = np.isin(selected, times)
    inside = (selected >= times[0]) & (selected <= times[-1])
    np.testing.assert_array_equal(bracket.usable, inside & (at_state | ~gap[before]))
    stamps = selected[bracket.usable]
    np.testing.assert_array_equal(result.stamps, stamps)
    for actual, column in (
        (result.positions, path.positions),
        (result.velocities, path.velocities),
    ):
        expected = np.column_stack([np.interp(stamps, times, column[:, i]) for i in range(3)])
        np.testing.assert_allclose(actual, expected, rtol=1e-6, atol=1e-6)
    assert result.rotations is not None
    between = Slerp(times.astype(float), rotations)(stamps.astype(float))
    assert (between.inv() * result.rotations).magnitude().max(initial=0.0) < 1e-6
    assert result.covariances is result.reading.frame_numbers is None
    assert result.reading.matrices is result.reading.fixes is None
