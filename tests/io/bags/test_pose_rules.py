"""Rules for poses of messages at their limits: times, frames, resets, transforms, PX4."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from composed import compose_transforms
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.io.bags.containers import Topic
from trajeval_ros.io.bags.declared_resets import about_resets, declared_resets
from trajeval_ros.io.bags.message_definitions import Connection
from trajeval_ros.io.bags.pose_columns import PoseColumns, frames_changes
from trajeval_ros.io.bags.transform_tree import (
    Edge,
    common_span,
    find_way,
    fixed_transform,
    leading_edge,
)
from trajeval_ros.io.bags.usable_poses import has_world_twist, usable_poses

SECOND = 10**9


def poses(count: int = 6, **columns: Any) -> PoseColumns:
    rng = np.random.default_rng(count)
    made = PoseColumns(
        stamps=np.arange(count) * SECOND,
        positions=rng.normal(size=(count, 3)),
        quaternions=lie.normalized(rng.normal(size=(count, 4))),
        body_velocities=rng.normal(size=(count, 3)),
        covariances=None,
        fix_quality=None,
        frames=[(0, "map", "base")],
        rows=np.arange(count),
        undecodable=0,
    )
    return made.replaced(**columns)


@given(
    st.lists(st.tuples(st.sampled_from("ab"), st.booleans()), min_size=1, max_size=20),
)
def test_frames_of_the_picked_poses_are_those_they_had(rows: list[tuple[str, bool]]) -> None:
    names, usable = [name for name, _ in rows], np.array([kept for _, kept in rows])
    entries = [(row, name, "x") for row, name in enumerate(names)]
    columns = poses(len(rows), frames=frames_changes(entries), dropped={"other": 2})
    found = columns.picked(usable, "other")
    assert found.rows.tolist() == np.flatnonzero(usable).tolist()
    kept = [name for name, good in zip(names, usable, strict=True) if good]
    by_row = [
        next(frame for row, frame, _ in reversed(found.frames) if row <= place)
        for place in range(len(kept))
    ]
    assert by_row == kept
    changes = [row for row in range(len(kept)) if not row or kept[row] != kept[row - 1]]
    assert [row for row, *_ in found.frames] == changes
    assert found.dropped == {"other": 2 + int((~usable).sum())}


def test_poses_are_joined_by_column() -> None:
    first, second = poses(3), poses(4)
    found = first.joined(second)
    for name in ("stamps", "positions", "quaternions", "body_velocities", "rows"):
        expected = np.concatenate([getattr(item, name) for item in (first, second)])
        np.testing.assert_array_equal(getattr(found, name), expected)
    assert found.covariances is found.flags is None
    assert found.frames == first.frames


def test_frames_change_only_where_they_differ() -> None:
    entries = [(0, "a", "x"), (2, "a", "x"), (3, "a", "y"), (5, "b", "y"), (8, "b", "y")]
    assert frames_changes(entries) == [(0, "a", "x"), (3, "a", "y"), (5, "b", "y")]
    assert frames_changes([]) == []
    timed = np.ones(6, dtype=bool)
    columns = poses(frames=[(0, "map", "base"), (4, "odom", "base")])
    for before, changes in (
        (None, [((0, "map", "base"), (4, "odom", "base"))]),
        ((0, "map", "base"), [((0, "map", "base"), (4, "odom", "base"))]),
        ((7, "odom", "base"), [((7, "odom", "base"), (0, "map", "base")),
            ((0, "map", "base"), (4, "odom", "base"))]),
    ):  # fmt: skip
        assert usable_poses(columns, timed, before).frame_changes == changes


def test_poses_without_a_time_are_counted() -> None:
    timed = np.array([True, False, True, False, False, True])
    found = usable_poses(poses(undecodable=3, dropped={"zero_stamp": 1}), timed)
    assert found.columns.rows.tolist() == [0, 2, 5]
    assert found.dropped == {"undecodable": 3, "zero_stamp": 4}
    assert usable_poses(poses(), np.ones(6, dtype=bool)).dropped == {}


def test_a_twist_is_turned_from_the_body_unless_the_body_is_the_world() -> None:
    columns, timed = poses(), np.ones(6, dtype=bool)
    assert columns.quaternions is not None
    assert columns.body_velocities is not None
    expected = Rotation.from_quat(columns.quaternions).apply(columns.body_velocities)
    long = columns.replaced(quaternions=columns.quaternions * 3.0)
    for item in (columns, long):
        found = usable_poses(item, timed).velocities
        assert found is not None
        np.testing.assert_allclose(found, expected, atol=1e-14)
    for frames, is_of_world in (
        ([(0, "world", "world")], True),
        ([(0, "world", "world"), (3, "map", "map")], True),
        ([(0, "world", "world"), (3, "map", "base")], False),
        ([(0, "", "")], False),
        ([], False),
    ):
        given_ = columns.replaced(frames=frames)
        assert has_world_twist(given_) == is_of_world
        if is_of_world:
            assert usable_poses(given_, timed).velocities is columns.body_velocities
    other = np.ones((6, 3))
    assert usable_poses(columns.replaced(velocities=other), timed).velocities is other
    for missing in ("quaternions", "body_velocities"):
        lacking = columns.replaced(**{missing: None})
        assert usable_poses(lacking, timed).velocities is None


@pytest.mark.parametrize(("length", "is_turned"), [(1e-6, False), (1.001e-6, True), (0.0, False)])
def test_a_quaternion_without_length_turns_no_velocity(length: float, *, is_turned: bool) -> None:
    columns = poses(2)
    assert columns.quaternions is not None
    quaternions = np.array([[0.0, 0.0, 0.0, length], [0.0, 0.0, 0.0, 1.0]])
    found = usable_poses(columns.replaced(quaternions=quaternions), np.ones(2, dtype=bool))
    assert found.velocities is not None
    assert found.velocities.any(axis=1).tolist() == [is_turned, True]
    still = columns.replaced(body_velocities=np.zeros((2, 3)))
    nothing = usable_poses(still, np.ones(2, dtype=bool)).velocities
    assert nothing is not None
    assert not nothing.any()


def test_a_reset_is_the_step_beyond_the_motion() -> None:
    headings = np.radians([0.0, 0.0, 30.0, 30.0, 30.0, -15.0, -15.0, -15.0])
    counters = np.array([3, 3, 4, 4, 4, 2, 2, 3])
    columns = poses(
        8,
        flags=np.column_stack([counters, np.zeros(8, dtype=np.int64)]),
        positions=np.column_stack([np.cumsum([0, 2, 5, 2, 2, 2, 2, 2.5]), *np.zeros((2, 8))]),
        velocities=np.column_stack([np.full(8, 2.0), *np.zeros((2, 8))]),
        quaternions=Rotation.from_rotvec(np.outer(headings, [0.0, 0.0, 1.0])).as_quat(),
    )
    found = declared_resets(columns)
    assert [item.stamp_ns for item in found] == [2 * SECOND, 5 * SECOND, 7 * SECOND]
    np.testing.assert_allclose([item.position_m for item in found], [3.0, 0.0, 0.5], atol=1e-14)
    np.testing.assert_allclose(
        [item.rotation_deg for item in found], [30.0, 45.0, 0.0], atol=1e-12
    )
    without = declared_resets(columns.replaced(velocities=None, quaternions=None))
    np.testing.assert_allclose([item.position_m for item in without], [5.0, 2.0, 2.5])
    assert [item.rotation_deg for item in without] == [0.0] * 3
    assert declared_resets(columns.replaced(flags=None)) == ()
    unknown = columns.replaced(velocities=np.full((8, 3), np.nan))
    assert declared_resets(unknown)[0].position_m == 5.0


@pytest.mark.parametrize("count", [0, 1, 5, 6, 7])
def test_five_resets_are_listed(count: int) -> None:
    counters = np.arange(count + 1)
    columns = poses(
        count + 1,
        flags=np.column_stack([counters, 0 * counters]),
        positions=np.zeros((count + 1, 3)),
    )
    resets = declared_resets(columns)
    told = [remark.text for remark in about_resets(resets, SECOND // 2)]
    assert list(about_resets(resets, None)) == []
    if not count:
        assert told == []
        return
    [text] = told
    assert text.count(" 0.00 m and ") == min(count, 5)
    assert "at 0.50 s" in text
    assert ("more" in text) == (count > 5)
    assert (f", and {count - 5} more; " in text) == (count > 5)
    assert text.endswith(f"use --start @{count}.000")


def edge(stamps: list[int], *, is_static: bool = False, seed: int = 0) -> Edge:
    rng = np.random.default_rng(seed)
    numbers = np.hstack([rng.normal(size=(len(stamps), 3)), rng.normal(size=(len(stamps), 4))])
    return Edge.from_columns(np.array(stamps, dtype=np.int64), numbers, is_static)


def test_an_edge_is_interpolated_between_its_transforms_and_exact_at_them() -> None:
    found = edge([10, 20, 50])
    places, turns = found.at(np.array([10, 12, 20, 35, 50]))
    assert np.array_equal(places[[0, 2, 4]], found.translations)
    np.testing.assert_allclose(
        places[1], 0.8 * found.translations[0] + 0.2 * found.translations[1]
    )
    np.testing.assert_allclose(
        places[3], 0.5 * found.translations[1] + 0.5 * found.translations[2]
    )
    expected = Slerp(found.stamps, Rotation.from_quat(found.quaternions))([10, 12, 20, 35, 50])
    between = Rotation.from_quat(turns).inv() * expected
    assert between.magnitude().max() < 1e-14


def test_parts_of_an_edge() -> None:
    found = edge([10, 20, 30, 40])
    for stamp, first in ((5, 10), (10, 10), (11, 10), (19, 10), (20, 20), (40, 40), (99, 40)):
        assert found.since(stamp).stamps[0] == first
        assert found.since(stamp).stamps[-1] == 40
    for begin, end, inside in ((10, 40, [10, 20, 30, 40]), (11, 39, [20, 30]), (41, 50, [])):
        assert found.within(begin, end).tolist() == inside
    later = edge([30, 60], seed=1)
    both = found.joined(later)
    assert both.stamps.tolist() == [10, 20, 30, 40, 60]
    np.testing.assert_array_equal(both.translations[2], later.translations[0])
    np.testing.assert_array_equal(both.quaternions[[2, 4]], later.quaternions)
    fixed = edge([5, 3, 9, 7], is_static=True)
    assert fixed.stamps.tolist() == [7]
    places, turns = fixed.at(np.array([0, 100]))
    np.testing.assert_array_equal(places, fixed.translations.repeat(2, axis=0))
    np.testing.assert_array_equal(turns, fixed.quaternions.repeat(2, axis=0))


@pytest.mark.parametrize(("place", "leads"), [(2 * SECOND, "slow"), (2 * SECOND + 1, "fast")])
def test_the_first_two_seconds_decide_which_edge_leads(place: int, leads: str) -> None:
    edges = {
        ("a", "fast"): edge([0, SECOND, 3 * SECOND, 4 * SECOND]),
        ("fast", "slow"): edge([0, 1, place, 5 * SECOND]),
        ("slow", "b"): edge([7], is_static=True),
    }
    if leads == "fast":  # equal numbers: the first on the way
        edges["fast", "slow"] = edge([0, place, 5 * SECOND])
    way = find_way(edges, "a", "b", "t")
    span = common_span(edges, way)
    assert span == (0, 4 * SECOND)
    assert leading_edge(edges, way, span)[1] == leads
    stamps, *_ = compose_transforms(edges, "a", "b", "t")
    expected = edges["a", "fast"] if leads == "fast" else edges["fast", "slow"]
    assert stamps.tolist() == [stamp for stamp in expected.stamps.tolist() if stamp <= 4 * SECOND]


def test_edges_that_meet_in_one_instant_have_one_pose() -> None:
    edges = {("a", "b"): edge([0, 5, 10]), ("b", "c"): edge([10, 15])}
    stamps, *_ = compose_transforms(edges, "a", "c", "t")
    assert stamps.tolist() == [10]
    edges["b", "c"] = edge([11, 15])
    with pytest.raises(InputError, match="no common time span"):
        compose_transforms(edges, "a", "c", "t")
    still = {("a", "b"): edge([0], is_static=True), ("b", "c"): edge([9])}
    assert find_way(still, "c", "a", "t") == [(("b", "c"), False), (("a", "b"), False)]
    position, turn = fixed_transform(still, "b", "a", "t")
    inverse = Rotation.from_quat(still["a", "b"].quaternions[0]).inv()
    np.testing.assert_allclose(position, -inverse.apply(still["a", "b"].translations[0]))
    assert (Rotation.from_quat(turn) * inverse.inv()).magnitude() < 1e-14
    with pytest.raises(InputError, match="unknown frame c; use one of"):
        fixed_transform(still, "a", "c", "t")


def test_messages_of_a_topic_are_counted_if_none_are_declared() -> None:
    class Owner:
        def count(self, topic: int) -> int:
            return 10 * topic

    def connection(number: int, count: int) -> Connection:
        return Connection(number, "/a", "a/msg/B", "", "", count, "cdr", Owner())

    both = connection(1, -1), connection(2, 7), connection(3, 0)
    assert Topic("/a", "a/msg/B", None, both).count == 17
    assert Topic("/a", "a/msg/B", 0, both).count == 0
    assert dataclasses.replace(Topic("/a", "a/msg/B", None, both), declared=4).count == 4
