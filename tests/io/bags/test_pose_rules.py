"""Poses of messages: times, frames, twists and transforms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from composed import compose_transforms
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.io.bags.pose_columns import PoseColumns, frames_changes
from trajeval_ros.io.bags.transform_tree import (
    Edge,
    find_way,
    fixed_transform,
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
    result = columns.picked(usable, "other")
    assert result.rows.tolist() == np.flatnonzero(usable).tolist()
    kept = [name for name, good in zip(names, usable, strict=True) if good]
    by_row = [
        next(frame for row, frame, _ in reversed(result.frames) if row <= place)
        for place in range(len(kept))
    ]
    assert by_row == kept
    changes = [row for row in range(len(kept)) if not row or kept[row] != kept[row - 1]]
    assert [row for row, *_ in result.frames] == changes
    assert result.dropped == {"other": 2 + int((~usable).sum())}


def test_poses_without_a_time_are_counted() -> None:
    timed = np.array([True, False, True, False, False, True])
    result = usable_poses(poses(undecodable=3, dropped={"zero_stamp": 1}), timed)
    assert result.columns.rows.tolist() == [0, 2, 5]
    assert result.dropped == {"undecodable": 3, "zero_stamp": 4}
    assert usable_poses(poses(), np.ones(6, dtype=bool)).dropped == {}


def test_a_twist_is_turned_from_the_body_unless_the_body_is_the_world() -> None:
    columns, timed = poses(), np.ones(6, dtype=bool)
    assert columns.quaternions is not None
    assert columns.body_velocities is not None
    expected = Rotation.from_quat(columns.quaternions).apply(columns.body_velocities)
    long = columns.replaced(quaternions=columns.quaternions * 3.0)
    for item in (columns, long):
        result = usable_poses(item, timed).velocities
        assert result is not None
        np.testing.assert_allclose(result, expected, atol=1e-14)
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


def edge(stamps: list[int], *, is_static: bool = False, seed: int = 0) -> Edge:
    rng = np.random.default_rng(seed)
    numbers = np.hstack([rng.normal(size=(len(stamps), 3)), rng.normal(size=(len(stamps), 4))])
    return Edge.from_columns(np.array(stamps, dtype=np.int64), numbers, is_static)


def test_an_edge_is_interpolated_between_its_transforms_and_exact_at_them() -> None:
    result = edge([10, 20, 50])
    places, rotations = result.at(np.array([10, 12, 20, 35, 50]))
    assert np.array_equal(places[[0, 2, 4]], result.translations)
    np.testing.assert_allclose(
        places[1], 0.8 * result.translations[0] + 0.2 * result.translations[1]
    )
    np.testing.assert_allclose(
        places[3], 0.5 * result.translations[1] + 0.5 * result.translations[2]
    )
    expected = Slerp(result.stamps, Rotation.from_quat(result.quaternions))([10, 12, 20, 35, 50])
    between = Rotation.from_quat(rotations).inv() * expected
    assert between.magnitude().max() < 1e-14


def test_edges_that_meet_in_one_instant_have_one_pose() -> None:
    edges = {("a", "b"): edge([0, 5, 10]), ("b", "c"): edge([10, 15])}
    stamps, *_ = compose_transforms(edges, "a", "c", "t")
    assert stamps.tolist() == [10]
    edges["b", "c"] = edge([11, 15])
    with pytest.raises(InputError, match="no common time span"):
        compose_transforms(edges, "a", "c", "t")
    still = {("a", "b"): edge([0], is_static=True), ("b", "c"): edge([9])}
    assert find_way(still, "c", "a", "t") == [(("b", "c"), False), (("a", "b"), False)]
    position, rotation = fixed_transform(still, "b", "a", "t")
    inverse = Rotation.from_quat(still["a", "b"].quaternions[0]).inv()
    np.testing.assert_allclose(position, -inverse.apply(still["a", "b"].translations[0]))
    assert (Rotation.from_quat(rotation) * inverse.inv()).magnitude() < 1e-14
    with pytest.raises(InputError, match="unknown frame c; use one of"):
        fixed_transform(still, "a", "c", "t")
