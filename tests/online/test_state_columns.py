"""Rows of states, the buffers that hold them, and the store of pairs, against plain models."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from strategies import make_groundtruth, seeds

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.frame_axes import upright
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UP_AXES, UpAxis
from trajeval_ros.geometry.valid_poses import LARGEST
from trajeval_ros.online.state_buffer import (
    NEVER,
    BufferLimits,
    StateBuffer,
    StateCounts,
    usable_rows,
)
from trajeval_ros.online.state_rows import (
    Pairs,
    all_columns,
    as_wide,
    on_plane,
    states,
    trajectory,
    turned_covariances,
    upright_rows,
)
from trajeval_ros.online.window import PairStore, Window

Array = NDArray[Any]
SECOND = 10**9


def numbered(stamps: list[int], width: int = 10, sign: float = 1.0) -> Array:
    """Return rows whose columns all are the row's timestamp."""
    return sign * np.repeat(np.array(stamps, dtype=float)[:, None], width, axis=1)


def turns_of(trajectory: Trajectory) -> Array:
    assert trajectory.quaternions is not None
    return trajectory.quaternions


steps = st.one_of(
    st.tuples(st.just("append"), st.integers(0, 300), st.sampled_from([10, 46])),
    st.tuples(st.just("drop"), st.integers(0, 300), st.just(0)),
    st.tuples(st.just("merge"), st.integers(0, 40), st.sampled_from([10, 46])),
)


@settings(max_examples=20)
@given(st.lists(steps, max_size=12), st.randoms(use_true_random=False))
def test_a_buffer_holds_what_a_sorted_list_does(operations: list[Any], random: Any) -> None:
    buffer, model, width, top = StateBuffer(), dict[int, float](), 10, 0
    assert buffer.newest == NEVER
    for kind, count, columns in operations:
        if kind == "drop":
            count = min(count, len(model))
            buffer.drop(count)
            for each in sorted(model)[:count]:
                del model[each]
        elif kind == "append":
            stamps = list(range(max(model, default=top) + 1, max(model, default=top) + 1 + count))
            buffer.append(np.array(stamps, dtype=np.int64), numbered(stamps, columns))
            model |= {each: each for each in stamps}
            width = max(width, columns)
        else:
            stamps = [random.randrange(top, top + 500) for _ in range(count)]
            again = buffer.merge(np.array(stamps, dtype=np.int64), numbered(stamps, columns, -1))
            assert again == len(stamps) - len(set(stamps) - model.keys())
            model |= {each: -each for each in stamps if each not in model}
            width = max(width, columns)
        held, rows = buffer.held
        assert len(buffer) == len(model)
        assert held.tolist() == sorted(model)
        assert rows[:, 0].tolist() == [model[each] for each in sorted(model)]
        np.testing.assert_array_equal(rows[:, :10], rows[:, :1].repeat(10, axis=1))
        assert rows.shape[1] == width
        assert buffer.newest == max(model, default=NEVER)


def test_a_buffer_that_is_refilled_and_drained_stays_small() -> None:
    buffer = StateBuffer()
    for begin in range(0, 100_000, 100):
        buffer.append(np.arange(begin, begin + 100), np.zeros((100, 10)))
        buffer.drop(max(len(buffer) - 120, 0))
    assert len(buffer.stamps) <= 512
    assert buffer.held[0].tolist() == list(range(99_880, 100_000))


@given(st.lists(st.tuples(st.booleans(), st.booleans()), max_size=30))
def test_states_that_are_no_poses_are_counted_once(faults: list[tuple[bool, bool]]) -> None:
    count = len(faults)
    positions, quaternions = np.zeros((count, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    for row, (lost, short) in enumerate(faults):
        positions[row, row % 3] = np.nan if lost else 1.0
        quaternions[row] *= 0.0 if short else 2.0
    rows = states(positions, quaternions)
    usable, dropped = usable_rows(rows)
    assert usable.tolist() == [not (lost or short) for lost, short in faults]
    no_place, no_turn = sum(a for a, _ in faults), sum(b and not a for a, b in faults)
    expected = {"not_finite": no_place, "zero_quaternion": no_turn}
    assert dropped == {name: number for name, number in expected.items() if number}
    counts = StateCounts()
    stamps = np.arange(count, dtype=np.int64)[::-1] * 3
    kept, _ = counts.take(stamps, rows)
    assert kept.tolist() == stamps[usable].tolist()
    assert (counts.poses, counts.dropped) == (usable.sum(), dropped)
    if len(kept):
        assert (counts.first, counts.last) == (kept.min(), kept.max())
        assert counts.duration_s == (kept.max() - kept.min()) / SECOND


@pytest.mark.parametrize(
    ("size", "is_valid"),
    [(LARGEST, True), (np.nextafter(LARGEST, 2e12), False), (-np.nextafter(LARGEST, 2e12), False)],
)
def test_a_velocity_beyond_the_largest_is_not_measured(size: float, *, is_valid: bool) -> None:
    rows = states(np.zeros((2, 3)), None, np.array([[0.0, size, 0.0], [1.0, 2.0, 3.0]]))
    given_rows = rows.copy()
    _, kept = StateCounts().take(np.arange(2), rows)
    np.testing.assert_array_equal(rows, given_rows)  # the caller's rows are not changed
    assert np.isfinite(kept[:, 7:]).all(axis=1).tolist() == [is_valid, True]
    assert np.isfinite(kept[:, :3]).all()


def test_counts_are_taken_back() -> None:
    counts = StateCounts()
    assert counts.duration_s == 0.0
    counts.count(np.array([5, 9, 7]) * SECOND)
    counts.count(np.array([3]) * SECOND)
    assert (counts.poses, counts.first, counts.last) == (4, 3 * SECOND, 9 * SECOND)
    assert counts.duration_s == 6.0
    counts.take_back(0, 1)
    assert (counts.poses, counts.last) == (4, 9 * SECOND)
    counts.take_back(2, 5 * SECOND)
    assert (counts.poses, counts.first, counts.last) == (2, 3 * SECOND, 5 * SECOND)
    counts.take_back(2, 4 * SECOND)
    assert (counts.poses, counts.first, counts.last) == (0, None, None)
    counts.drop("too_late", 2)
    counts.drop("too_late", 0)
    counts.drop("other", 0)
    assert counts.dropped == {"too_late": 2}


def test_states_are_kept_from_the_horizon_on() -> None:
    assert BufferLimits().horizon(25 * SECOND) == 15 * SECOND
    assert BufferLimits(0.25).horizon(7) == 7 - SECOND // 4
    assert BufferLimits(np.inf).horizon(7) == NEVER
    assert (BufferLimits().past_states, BufferLimits().waiting_states) == (500_000, 500_000)


@given(seed=seeds)
def test_rows_become_a_trajectory_and_back(seed: int) -> None:
    source = make_groundtruth(seed, 20)
    rows = states(source.positions, 3.0 * turns_of(source), source.velocities)
    found = trajectory(source.stamps, rows)
    np.testing.assert_array_equal(found.stamps, source.stamps)
    np.testing.assert_array_equal(found.positions, source.positions)
    np.testing.assert_allclose(turns_of(found), turns_of(source), atol=1e-15)
    assert np.array_equal(found.velocities, source.velocities)  # type: ignore[arg-type]
    assert found.covariances is None
    points = trajectory(source.stamps, states(source.positions))
    assert points.quaternions is points.velocities is None
    wide = np.hstack([rows, np.random.default_rng(seed).normal(size=(20, 36))])
    covariances = trajectory(source.stamps, wide).covariances
    assert covariances is not None
    np.testing.assert_array_equal(covariances.reshape(20, 36), wide[:, 10:])
    assert trajectory(source.stamps, as_wide(rows, 46)).covariances is None


@pytest.mark.parametrize("width", [3, 7, 10, 46])
def test_rows_of_positions_and_poses_are_completed(width: int) -> None:
    rows = np.random.default_rng(width).normal(size=(5, width))
    found = all_columns(rows)
    if width >= 10:
        assert found is rows
        return
    np.testing.assert_array_equal(found[:, :3], rows[:, :3])
    assert np.isnan(found[:, 7:]).all()
    if width == 7:
        unit = rows[:, 3:] / np.linalg.norm(rows[:, 3:], axis=1)[:, None]
        np.testing.assert_allclose(found[:, 3:7], unit, rtol=1e-15)
    else:
        assert np.isnan(found[:, 3:7]).all()


@pytest.mark.parametrize("shape", [(5, 4), (5, 9), (5, 11), (5, 45), (5, 47), (10,), (3, 10, 1)])
def test_rows_of_another_width_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="rows of 3, 7, 10 or 46 columns"):
        all_columns(np.zeros(shape))


def test_rows_are_widened_with_zeros_and_cut() -> None:
    rows = np.random.default_rng(0).normal(size=(4, 46))
    np.testing.assert_array_equal(as_wide(rows, 10), rows[:, :10])
    np.testing.assert_array_equal(as_wide(rows, 46), rows)
    widened = as_wide(rows[:, :10], 46)
    np.testing.assert_array_equal(widened[:, :10], rows[:, :10])
    assert widened.shape == (4, 46)
    assert not widened[:, 10:].any()
    assert np.isfinite(rows).all()


def random_rows(seed: int, axis: str) -> tuple[Trajectory, Array]:
    """Return a trajectory with covariances, and its rows."""
    source = make_groundtruth(seed, 12)
    halves = np.random.default_rng(seed).normal(size=(12, 6, 6))
    covariances = halves @ halves.swapaxes(1, 2)
    source = dataclasses.replace(
        source,
        covariances=covariances,
        up=UpAxis(axis),
        gyroscope_biases=None,
        accelerometer_biases=None,
    )
    rows = states(source.positions, turns_of(source), source.velocities)
    return source, np.hstack([rows, covariances.reshape(12, 36)])


@given(seed=seeds, axis=st.sampled_from(sorted(UP_AXES)))
def test_upright_rows_are_the_upright_trajectory(seed: int, axis: str) -> None:
    source, rows = random_rows(seed, axis)
    expected = upright(source)
    found = trajectory(source.stamps, upright_rows(rows, UpAxis(axis)))
    for name in ("positions", "velocities", "covariances"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), rtol=1e-13, atol=1e-12, err_msg=name
        )
    between = lie.multiply(lie.conjugate(turns_of(found)), turns_of(expected))
    assert lie.angle(between).max() < 1e-14
    np.testing.assert_array_equal(upright_rows(rows[:, :10], UpAxis(axis)).shape, (12, 10))


@settings(max_examples=20)
@given(seed=seeds, axis=st.sampled_from(sorted(UP_AXES)))
def test_a_state_in_the_plane_has_no_height_and_only_a_heading(seed: int, axis: str) -> None:
    source, rows = random_rows(seed, axis)
    up = UpAxis(axis)
    above = up.matrix[2]
    rows[3, 3:7] = np.nan
    found = on_plane(rows, up)
    for part in (slice(0, 3), slice(7, 10)):
        np.testing.assert_allclose(found[:, part] @ above, 0.0, atol=1e-15)
        across = rows[:, part] - np.outer(rows[:, part] @ above, above)
        np.testing.assert_allclose(found[:, part], across, rtol=1e-14, atol=1e-14)
    assert np.isnan(found[3, 3:7]).all()
    turned = np.delete(np.arange(12), 3)
    rotations = Rotation.from_quat(found[turned, 3:7])
    upwards = rotations.apply([0.0, 0.0, 1.0])  # the body stands upright
    np.testing.assert_allclose(upwards, np.tile(above, (11, 1)), atol=1e-14)
    # What is left is a tilt: the rotation about the vertical nearest to the orientation.
    rest = rotations.inv() * Rotation.from_quat(turns_of(source)[turned])
    np.testing.assert_allclose(rest.as_quat()[:, 2], 0.0, atol=1e-13)
    lost = rows.copy()
    lost[:, :3] = np.nan
    assert np.isnan(on_plane(lost, up)[:, :3]).all()


@given(seed=seeds)
def test_covariances_are_turned_by_the_orientation_and_back(seed: int) -> None:
    source, rows = random_rows(seed, "z")
    rows[2, 3:7] = np.nan
    turned = turned_covariances(rows)
    np.testing.assert_array_equal(turned[2], rows[2])
    np.testing.assert_array_equal(turned[:, :10], rows[:, :10])
    for row in (0, 5, 11):
        turn = np.eye(6)
        turn[3:, 3:] = Rotation.from_quat(turns_of(source)[row]).as_matrix()
        expected = turn @ rows[row, 10:].reshape(6, 6) @ turn.T
        np.testing.assert_allclose(
            turned[row, 10:].reshape(6, 6), expected, rtol=1e-12, atol=1e-12
        )
    np.testing.assert_allclose(
        turned_covariances(turned, to_body=True), rows, rtol=1e-12, atol=1e-12
    )
    assert turned_covariances(rows[:, :10]).shape == (12, 10)


def test_pairs_are_picked_and_put_in_order() -> None:
    one = Pairs(np.array([1, 5]), numbered([1, 5]), numbered([1, 5], 46, -1.0))
    other = Pairs(np.array([3, 5]), numbered([30, 50]), numbered([3, 5], 46, -1.0))
    assert Pairs.in_order([one]) is one
    both = Pairs.in_order([one, other])
    assert both.stamps.tolist() == [1, 3, 5, 5]
    assert both.groundtruth[:, 0].tolist() == [1, 30, 5, 50]
    assert both.estimate[:, 0].tolist() == [-1, -3, -5, -5]
    assert both.without_covariances().estimate.shape == (4, 10)
    assert both.picked(slice(1, None)).groundtruth[:, 4].tolist() == [30, 5, 50]
    lacking = other.picked(np.array([0]))
    lacking.estimate[0, 3] = np.nan
    assert (one.have_rotations, lacking.have_rotations) == (True, False)
    nothing = Pairs.none()
    assert [each.shape for each in nothing] == [(0,), (0, 10), (0, 10)]


@settings(max_examples=20)
@given(
    seed=seeds,
    batches=st.lists(st.tuples(st.integers(0, 30), st.integers(0, 25)), min_size=1, max_size=8),
    covariances=st.booleans(),
)
def test_a_store_has_the_newest_pairs_and_the_path_from_the_start(
    seed: int, batches: list[tuple[int, int]], *, covariances: bool
) -> None:
    rng = np.random.default_rng(seed)
    total = sum(count for count, _ in batches)
    stamps = np.cumsum(rng.integers(1, SECOND, size=total))
    groundtruth, estimate = rng.normal(size=(total, 10)), rng.normal(size=(total, 46))
    path = np.zeros(total)
    path[1:] = np.cumsum(np.linalg.norm(np.diff(groundtruth[:, :3], axis=0), axis=1))
    store, end, begin = PairStore(covariances=covariances), 0, 0
    for count, keep in batches:
        rows = slice(end, end + count)
        store.append(Pairs(stamps[rows], groundtruth[rows], estimate[rows]))
        end += count
        begin = min(max(begin, end - keep), end)
        store.drop_before(end - keep)
        assert (store.begin, store.end, len(store)) == (begin, end, end - begin)
        for first in (None, begin - 1, begin, begin + 1):
            rows = slice(max(begin, begin if first is None else first), end)
            np.testing.assert_array_equal(store.stamps(first), stamps[rows])
            np.testing.assert_array_equal(store.groundtruth(first), groundtruth[rows])
            width = 46 if covariances else 10
            np.testing.assert_array_equal(store.estimate(first), estimate[rows, :width])
            np.testing.assert_allclose(store.along(first), path[rows], rtol=1e-13)


@pytest.mark.parametrize(
    ("window", "first"),
    [
        ("0", 2),
        ("4", 6),
        ("7", 3),
        ("8", 2),
        ("9", 2),
        ("3s", 6),
        ("2.999999999s", 7),
        ("3.000000001s", 6),
        ("7s", 2),
        ("1.5m", 6),
        ("1.499999999m", 7),
        ("1.500000001m", 6),
        ("0.0001m", 9),
        ("100m", 2),
    ],
)
def test_a_window_contains_its_border(window: str, first: int) -> None:
    """Of ten pairs, one second and half a metre apart, the first two were dropped."""
    store = PairStore()
    positions = np.zeros((10, 3))
    positions[:, 1] = 0.5 * np.arange(10)
    rows = states(positions)
    store.append(Pairs(np.arange(10) * SECOND, rows, rows))
    store.drop_before(2)
    assert store.window_begin(Window.parse(window)) == first
    assert PairStore().window_begin(Window.parse(window)) == 0
