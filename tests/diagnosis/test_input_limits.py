"""Equal positions, sides at rest and velocities of another frame, at their limits."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trajeval_ros.diagnosis.column_tests import same_positions, standing_still, velocities
from trajeval_ros.diagnosis.findings import TestResult
from trajeval_ros.diagnosis.input_pair import TimedPoses
from trajeval_ros.geometry.arrays import Floats


def pair_of(groundtruth: TimedPoses, estimate: TimedPoses, *, by_time: bool = True) -> Any:
    return SimpleNamespace(
        poses={"estimate": estimate, "groundtruth": groundtruth},
        has_enough=min(len(groundtruth), len(estimate)) >= 12,
        in_order=(groundtruth, estimate),
        by_time=by_time,
    )


def walk(count: int = 100, seed: int = 0) -> Floats:
    steps: Floats = np.random.default_rng(seed).normal(size=(count, 3))
    return np.cumsum(steps, axis=0)


def same(true: Floats, own: Floats, late_s: float = 0.0, *, by_time: bool = True) -> TestResult:
    seconds = 0.1 * np.arange(max(len(true), len(own)))
    sides = TimedPoses(seconds[: len(true)], true), TimedPoses(seconds[: len(own)] + late_s, own)
    return same_positions(pair_of(*sides, by_time=by_time))


@pytest.mark.parametrize(("different", "is_seen"), [(10, True), (11, False)])
@pytest.mark.parametrize("fitted", [False, True])
def test_positions_are_identical_if_nine_tenths_are_equal(
    different: int, *, fitted: bool, is_seen: bool
) -> None:
    true = walk()
    own = true.copy()
    own[:different] += 1e-3
    if fitted:
        own = true.copy()
        own[0] += 1e-9 * different
        own = Rotation.from_rotvec([0.4, -0.9, 0.6]).apply(own) + [5.0, 0.0, -3.0]
        is_seen = True
    found = same(true, own)
    assert [item.cause for item in found.seen] == ["identical"] * is_seen
    for seen in found.seen:
        where = "at equal timestamps" + (", after a rigid fit," if fitted else "")
        assert seen.values["where"] == where
        assert seen.values["percent"] == pytest.approx(100.0 if fitted else 100.0 - different)
        assert found.scores == {"percent": seen.values["percent"]}


@pytest.mark.parametrize(("off", "is_seen"), [(0.95e-6, True), (1.05e-6, False)])
def test_a_rigid_fit_is_right_to_a_millionth_of_the_extent(off: float, *, is_seen: bool) -> None:
    """By pairs of opposite errors, which no rigid motion can reduce."""
    true = walk()
    true = np.concatenate([true, -true])
    size = np.sqrt(np.mean(np.sum((true - true.mean(axis=0)) ** 2, axis=1)))
    own = true + off * size * np.array([0.0, 0.0, 1.0]) * (-1.0) ** np.arange(200)[:, None]
    assert bool(same(true, own).seen) == is_seen


@pytest.mark.parametrize("decimals", [3, 9])
def test_one_side_may_have_fewer_digits(decimals: int) -> None:
    true = walk()
    for sides in ((true, true.round(decimals)), (true.round(decimals), true)):
        assert same(*sides).scores["percent"] == 100.0
    assert not same(true, true.round(2)).seen


@pytest.mark.parametrize(("late_s", "is_compared"), [(1.9e-6, True), (2.1e-6, False)])
def test_timestamps_are_equal_to_two_microseconds(late_s: float, *, is_compared: bool) -> None:
    true = walk()
    for sign in (1.0, -1.0):
        found = same(true, true, sign * late_s)
        assert bool(found.scores) == is_compared
    assert not same(true, true, 0.05, by_time=False).why_not
    assert same(true, true[:-1], by_time=False).why_not == "the numbers of rows differ"
    assert same(true[:3], true).seen
    assert same(true[:2], true).why_not == "too few poses at equal timestamps"
    assert not same(np.ones((9, 3)), np.ones((9, 3))).seen


@pytest.mark.parametrize(
    ("moved", "still", "count", "is_seen"),
    [
        (0.31, 0.0, 12, True),
        (0.29, 0.0, 12, False),
        (0.31, 0.0, 11, False),
        (100.0, 0.99e-3, 12, True),
        (100.0, 1.01e-3, 12, False),
        (1e6, 0.29, 12, True),
        (1e6, 0.31, 12, False),
    ],
)
@pytest.mark.parametrize("side", ["estimate", "groundtruth"])
def test_a_side_stands_still_beside_the_motion_of_the_other(
    moved: float, still: float, count: int, side: str, *, is_seen: bool
) -> None:
    along = np.linspace(0.0, 1.0, count)
    poses = [
        TimedPoses(along, np.outer(along, [0.6, 0.0, -0.8]) * item) for item in (moved, still)
    ]
    other = "groundtruth" if side == "estimate" else "estimate"
    found = standing_still(pair_of(**{side: poses[1], other: poses[0]}))
    assert found.scores == pytest.approx({f"{side} path": still, f"{other} path": moved})
    assert [item.cause for item in found.seen] == ["stands_still"] * is_seen
    for seen in found.seen:
        assert seen.values == {
            "side": side,
            "other": other,
            "path_m": found.scores[f"{other} path"],
        }


def test_one_in_fifty_positions_at_each_end_is_no_part_of_the_path() -> None:
    positions = np.linspace(0.0, 99.0, 100)
    positions[[3, 50]] = 1e6
    positions[[7, 80]] = -1e6
    poses = TimedPoses(np.arange(100.0), np.outer(positions, [1.0, 0.0, 0.0]))
    ranked = np.sort(positions)
    scores = standing_still(pair_of(poses, poses)).scores
    assert scores["estimate path"] == ranked[97] - ranked[2]


@pytest.mark.parametrize(
    ("count", "step_s", "angle_deg", "factor", "is_seen"),
    [
        (14, 0.29, 90.0, 1.0, True),
        (13, 0.29, 90.0, 1.0, False),
        (32, 0.31, 90.0, 1.0, False),
        (40, 0.1, 29.5, 1.0, True),  # of a chord of 0.51
        (40, 0.1, 28.5, 1.0, False),
        (40, 0.1, 90.0, 0.69, True),  # of a tenth of the square
        (40, 0.1, 90.0, 0.68, False),
    ],
)
def test_velocities_of_the_body_are_told_by_their_difference_from_the_positions(
    count: int, step_s: float, angle_deg: float, factor: float, *, is_seen: bool
) -> None:
    seconds = step_s * np.arange(count)
    turned = Rotation.from_rotvec(np.radians([[0.0, 0.0, angle_deg]] * count))
    velocity = np.array([2.0, 0.0, 0.0])
    positions = np.outer(seconds, velocity)
    body = turned.inv().apply(np.tile(velocity, (count, 1))) * factor
    poses = TimedPoses(seconds, positions, turned.as_quat(), body)
    without = TimedPoses(seconds, positions, turned.as_quat())
    for side, sides in (("estimate", (without, poses)), ("groundtruth", (poses, without))):
        found = velocities(*sides)
        assert [item.cause for item in found.seen] == ["twist_body"] * is_seen
        angle = np.radians(angle_deg)
        as_world = (factor * np.cos(angle) - 1.0) ** 2 + (factor * np.sin(angle)) ** 2
        if found.scores:
            assert found.scores == pytest.approx(
                {f"{side} as world": as_world, f"{side} as body": (1.0 - factor) ** 2}, abs=1e-12
            )
        for seen in found.seen:
            assert seen.values["side"] == side
            assert seen.values["off_percent"] == pytest.approx(100.0 * np.sqrt(as_world))
            turned_percent = pytest.approx(100.0 * (1.0 - factor), abs=1e-9)
            assert seen.values["turned_percent"] == turned_percent
