"""Buffers of states and the store of pairs, against plain models."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from state_rows import states, trajectory
from strategies import make_groundtruth, seeds

from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.travelled import travelled_distance
from trajeval_ros.geometry.up_axis import UP_AXES, UpAxis
from trajeval_ros.online.live_frames import in_plane
from trajeval_ros.online.pairing import PairedStates
from trajeval_ros.online.state_buffer import (
    NEVER,
    BufferLimits,
    StateCounts,
    Tail,
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
    st.tuples(st.just("append"), st.integers(0, 300)),
    st.tuples(st.just("drop"), st.integers(0, 300)),
    st.tuples(st.just("late"), st.integers(0, 40)),
)
COLUMNS = ("positions", "velocities", "covariances")


def block_at(stamps: list[int], sign: float, given: set[str]) -> Trajectory:
    """Return states whose numbers all are the timestamp."""
    numbers = sign * np.array(stamps, dtype=float).reshape(-1, 1)
    shapes = {"positions": (3,), "velocities": (3,), "covariances": (6, 6)}
    columns = {
        name: np.repeat(numbers, int(np.prod(shape)), axis=1).reshape(-1, *shape)
        for name, shape in shapes.items()
        if name == "positions" or name in given
    }
    return Trajectory(np.array(stamps, dtype=np.int64), **columns)


@settings(max_examples=30)
@given(
    st.lists(st.tuples(steps, st.sets(st.sampled_from(COLUMNS[1:]))), max_size=12),
    st.randoms(use_true_random=False),
)
def test_a_tail_holds_what_a_sorted_list_does(operations: list[Any], random: Any) -> None:
    tail, model, top, dropped = Tail(), dict[int, tuple[float, set[str]]](), 0, 0
    assert tail.newest == NEVER
    assert len(tail.trajectory()) == 0
    for (kind, count), known in operations:
        before = sorted(model)
        if kind == "drop":
            count = min(count, len(model))
            tail.drop_before(count)
            dropped += count
            for stamp in before[:count]:
                del model[stamp]
        else:
            sign, begin = 1.0, max(model, default=top) + 1
            stamps = list(range(begin, begin + count))
            if kind == "late":
                sign, stamps = -1.0, [random.randrange(top, top + 500) for _ in range(count)]
            row, new = tail.add(block_at(stamps, sign, known))
            assert new == len(set(stamps) - model.keys())
            assert tail.stamps[:row].tolist() == before[:row]
            for stamp in stamps:
                model.setdefault(stamp, (sign * stamp, known))
        held, result = sorted(model), tail.trajectory()
        assert tail.stamps.tolist() == result.stamps.tolist() == held
        assert (len(tail), tail.dropped) == (len(model), dropped)
        assert tail.newest == max(model, default=NEVER)
        assert result.positions[:, 1].tolist() == [model[stamp][0] for stamp in held]
        # A velocity is there if all states have one; an unknown covariance is zero.
        if len(model):
            all_known = all("velocities" in known for _, known in model.values())
            assert (result.velocities is not None) == all_known
            assert np.array_equal(tail.poses().poses[:, :3], result.positions)
            one = tail.trajectory(np.array([len(tail) - 1]))
            value, known = model[held[-1]]
            assert (one.velocities is not None) == ("velocities" in known)
            if one.covariances is not None:
                expected = value if "covariances" in known else 0.0
                assert (one.covariances == expected).all()
            else:
                assert value == 0.0 or "covariances" not in known


def test_a_tail_that_is_refilled_and_drained_stays_small() -> None:
    tail = Tail()
    for begin in range(0, 100_000, 100):
        tail.add(block_at(list(range(begin, begin + 100)), 1.0, set()))
        tail.drop_before(max(len(tail) - 120, 0))
    assert len(tail._columns["stamps"]) <= 1024
    assert tail.stamps.tolist() == list(range(99_880, 100_000))


@given(st.lists(st.tuples(st.booleans(), st.booleans()), max_size=30))
def test_states_that_are_no_poses_are_left_out_of_a_block(faults: list[tuple[bool, bool]]) -> None:
    count = len(faults)
    positions, quaternions = np.zeros((count, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    for row, (lost, short) in enumerate(faults):
        positions[row, row % 3] = np.nan if lost else 1.0
        quaternions[row] *= 0.0 if short else 2.0
    usable = np.array([not (lost or short) for lost, short in faults], dtype=bool)
    no_place, no_turn = sum(a for a, _ in faults), sum(b and not a for a, b in faults)
    expected = {"not_finite": no_place, "zero_quaternion": no_turn}
    dropped = {name: number for name, number in expected.items() if number}
    counts = StateCounts()
    stamps = np.arange(count, dtype=np.int64)[::-1] * 3
    block = trajectory(stamps, states(positions, quaternions))
    assert block.reading.dropped == dropped
    counts.count(block.stamps)
    kept = block.stamps
    assert kept.tolist() == stamps[usable].tolist()
    assert counts.poses == usable.sum()
    if len(kept):
        assert (counts.first, counts.last) == (kept.min(), kept.max())
        assert counts.duration_s == (kept.max() - kept.min()) / SECOND


def test_states_and_reasons_are_counted() -> None:
    counts = StateCounts()
    assert counts.duration_s == 0.0
    counts.count(np.array([5, 9, 7]) * SECOND)
    counts.count(np.array([3]) * SECOND)
    assert (counts.poses, counts.first, counts.last) == (4, 3 * SECOND, 9 * SECOND)
    assert counts.duration_s == 6.0
    counts.drop("too_late", 2)
    counts.drop("too_late", 0)
    counts.drop("other", 0)
    assert counts.dropped == {"too_late": 2}


def test_states_are_kept_from_the_horizon_on() -> None:
    assert BufferLimits().horizon(25 * SECOND) == 15 * SECOND
    assert BufferLimits(0.25).horizon(7) == 7 - SECOND // 4
    assert BufferLimits(np.inf).horizon(7) == NEVER
    assert (BufferLimits().past_states, BufferLimits().waiting_states) == (500_000, 500_000)


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


@settings(max_examples=20)
@given(seed=seeds, axis=st.sampled_from(sorted(UP_AXES)))
def test_a_state_in_the_plane_has_no_height_and_only_a_heading(seed: int, axis: str) -> None:
    source, _ = random_rows(seed, axis)
    above = UpAxis(axis).matrix[2]
    result = in_plane(source)
    assert result.up == source.up
    np.testing.assert_array_equal(result.covariances, source.covariances)
    for part in ("positions", "velocities"):
        flat, vectors = getattr(result, part), getattr(source, part)
        np.testing.assert_allclose(flat @ above, 0.0, atol=1e-15)
        across = vectors - np.outer(vectors @ above, above)
        np.testing.assert_allclose(flat, across, rtol=1e-14, atol=1e-14)
    rotations = Rotation.from_quat(turns_of(result))
    upwards = rotations.apply([0.0, 0.0, 1.0])  # the body stands upright
    np.testing.assert_allclose(upwards, np.tile(above, (12, 1)), atol=1e-14)
    # What is left is a tilt: the rotation about the vertical nearest to the orientation.
    rest = rotations.inv() * Rotation.from_quat(turns_of(source))
    np.testing.assert_allclose(rest.as_quat()[:, 2], 0.0, atol=1e-13)


@settings(max_examples=20)
@given(
    seed=seeds,
    batches=st.lists(st.tuples(st.integers(1, 30), st.integers(1, 25)), min_size=1, max_size=8),
    late=st.booleans(),
)
def test_a_store_has_the_newest_pairs_and_the_path_from_the_start(
    seed: int, batches: list[tuple[int, int]], *, late: bool
) -> None:
    """A late pair lies on the path; one before the oldest stored pair is left out."""
    rng = np.random.default_rng(seed)
    total = sum(count for count, _ in batches)
    stamps = np.cumsum(rng.integers(1, SECOND, size=total))
    sides = [Trajectory(stamps, rng.normal(size=(total, 3))) for _ in range(2)]
    order = np.arange(total)
    if late:  # by up to five pairs
        order = np.argsort(order + rng.integers(0, 6, size=total), kind="stable")
    store, end, known = PairStore(), 0, np.empty(0, dtype=int)
    left = np.zeros(total)  # path of the pairs that were dropped
    for count, keep in batches:
        new = np.sort(order[end : end + count])
        end += count
        store.add(PairedStates(*(side[new] for side in sides)))
        if store.begin:
            new = new[new > known[0]]
        known = np.sort(np.concatenate([known, new]))
        store.drop_before(store.end - keep)
        if len(known) > keep:
            dropped = travelled_distance(sides[0].positions[known])[-keep]
            left[known[-keep:]] = dropped + left[known[0]]
            known = known[-keep:]
        result = store.pairs(slice(None))
        assert (len(store), store.end - store.begin) == (len(known), len(known))
        np.testing.assert_array_equal(store.stamps(), stamps[known])
        for side, source in zip((result.groundtruth, result.estimate), sides, strict=True):
            np.testing.assert_array_equal(side.positions, source.positions[known])
        path = left[known[0]] + travelled_distance(sides[0].positions[known])
        np.testing.assert_allclose(store.along(), path, rtol=1e-12)
        for first in (store.begin - 1, store.begin, store.begin + 1):
            rows = slice(max(first - store.begin, 0), None)
            np.testing.assert_array_equal(store.stamps(first), stamps[known][rows])
            np.testing.assert_array_equal(store.along(first), store.along()[rows])


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
    side = Trajectory(np.arange(10) * SECOND, positions)
    store.add(PairedStates(side, side))
    store.drop_before(2)
    assert store.window_begin(Window.parse(window)) == first
    assert PairStore().window_begin(Window.parse(window)) == 0
