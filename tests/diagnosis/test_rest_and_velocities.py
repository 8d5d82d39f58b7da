"""Sides at rest, and velocities of another frame."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trajeval_ros.diagnosis.column_tests import standing_still, velocities
from trajeval_ros.diagnosis.input_pair import TimedPoses


def pair_of(groundtruth: TimedPoses, estimate: TimedPoses, *, by_time: bool = True) -> Any:
    return SimpleNamespace(
        poses={"estimate": estimate, "groundtruth": groundtruth},
        has_enough=min(len(groundtruth), len(estimate)) >= 12,
        in_order=(groundtruth, estimate),
        by_time=by_time,
    )


@pytest.mark.parametrize(
    ("moved", "still", "count", "is_seen"),
    [
        (1.0, 0.0, 20, True),
        (0.1, 0.0, 20, False),
        (1.0, 0.0, 5, False),
        (100.0, 1e-4, 20, True),
        (100.0, 0.1, 20, False),
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
    result = standing_still(pair_of(**{side: poses[1], other: poses[0]}))
    assert result.scores == pytest.approx({f"{side} path": still, f"{other} path": moved})
    assert [item.cause for item in result.seen] == ["stands_still"] * is_seen
    for seen in result.seen:
        assert seen.values == {
            "side": side,
            "other": other,
            "path_m": result.scores[f"{other} path"],
        }


@pytest.mark.parametrize(
    ("count", "step_s", "angle_deg", "factor", "is_seen"),
    [
        (40, 0.1, 90.0, 1.0, True),
        (6, 0.1, 90.0, 1.0, False),
        (40, 1.0, 90.0, 1.0, False),
        (40, 0.1, 10.0, 1.0, False),
        (40, 0.1, 90.0, 0.9, True),
        (40, 0.1, 90.0, 0.3, False),
    ],
)
def test_velocities_of_the_body_are_told_by_their_difference_from_the_positions(
    count: int, step_s: float, angle_deg: float, factor: float, *, is_seen: bool
) -> None:
    seconds = step_s * np.arange(count)
    rotated = Rotation.from_rotvec(np.radians([[0.0, 0.0, angle_deg]] * count))
    velocity = np.array([2.0, 0.0, 0.0])
    positions = np.outer(seconds, velocity)
    body = rotated.inv().apply(np.tile(velocity, (count, 1))) * factor
    poses = TimedPoses(seconds, positions, rotated.as_quat(), body)
    without = TimedPoses(seconds, positions, rotated.as_quat())
    for side, sides in (("estimate", (without, poses)), ("groundtruth", (poses, without))):
        result = velocities(*sides)
        assert [item.cause for item in result.seen] == ["twist_body"] * is_seen
        angle = np.radians(angle_deg)
        as_world = (factor * np.cos(angle) - 1.0) ** 2 + (factor * np.sin(angle)) ** 2
        if result.scores:
            assert result.scores == pytest.approx(
                {f"{side} as world": as_world, f"{side} as body": (1.0 - factor) ** 2}, abs=1e-12
            )
        for seen in result.seen:
            assert seen.values["side"] == side
            assert seen.values["off_percent"] == pytest.approx(100.0 * np.sqrt(as_world))
            turned_percent = pytest.approx(100.0 * (1.0 - factor), abs=1e-9)
            assert seen.values["turned_percent"] == turned_percent
