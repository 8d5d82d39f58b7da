"""States that readers found become a trajectory with remarks, and a summary with key figures."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.io.bags.test_pose_rules import poses
from trajeval_ros import evaluate
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.source_info import SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.pose_columns import PoseColumns
from trajeval_ros.io.bags.topics import trajectory_of_columns
from trajeval_ros.io.describe import LONG_GAP_S, summarize

SECOND = 10**9
POSE = "geometry_msgs/msg/PoseStamped"


def made(columns: PoseColumns, **more: Any) -> Trajectory:
    return trajectory_of_columns("run:/a", "/a", POSE, columns, (), **more)


def later(columns: PoseColumns) -> PoseColumns:
    """Return poses whose timestamps are not zero."""
    return columns.replaced(stamps=columns.stamps + SECOND)


def test_columns_without_information_are_left_out() -> None:
    columns = later(poses())
    zeros = np.zeros((6, 3))
    for velocities, is_kept in (
        (zeros, False),
        (np.full((6, 3), np.nan), False),
        (zeros + [[0.0, 1.0, 0.0]], True),
    ):
        result = made(columns.replaced(velocities=velocities))
        assert (result.velocities is not None) == is_kept
    covariances = np.zeros((6, 6, 6))
    assert made(columns.replaced(covariances=covariances)).covariances is None
    assert made(columns.replaced(covariances=covariances * np.nan)).covariances is None
    covariances[4, 2, 2] = 1.0
    assert made(columns.replaced(covariances=covariances)).covariances is not None
    identities = np.tile([0.0, 0.0, 0.0, 1.0], (6, 1))
    result = made(columns.replaced(quaternions=identities, velocities=zeros + 1.0))
    assert result.quaternions is result.velocities is None
    assert result.reading.has_identity_rotations
    points = made(columns.replaced(quaternions=None))
    assert points.quaternions is points.velocities is None
    assert not points.reading.has_identity_rotations


def test_an_isolated_timestamp_is_dropped_and_told() -> None:
    columns = later(poses(12))
    columns = columns.replaced(stamps=columns.stamps.copy() // 10)
    columns.stamps[4] += 10**6 * SECOND
    result = made(columns)
    assert len(result) == 11
    assert result.reading.dropped == {"lone_stamp": 1}
    assert [remark.code for remark in result.reading.remarks] == ["lone_stamp"]


@pytest.mark.parametrize(
    ("changes", "why", "text"),
    [
        ({}, "", "run:/a has no poses"),
        ({}, "x is damaged", "run:/a has no poses: x is damaged"),
        ({"undecodable": 3}, "x", "has no poses: none of its 3 messages can be decoded"),
        ({"dropped": {"zero_stamp": 2}}, "x", "has no poses: 2 with timestamp zero"),
    ],
)
def test_a_topic_without_poses(changes: dict[str, Any], why: str, text: str) -> None:
    with pytest.raises(InputError, match=text):
        made(poses().rows_of(np.zeros(6, dtype=bool)).replaced(**changes), why=why)


def test_poses_that_are_all_invalid_are_refused_with_counts() -> None:
    columns = later(poses(undecodable=2)).replaced(positions=np.full((6, 3), np.nan))
    with pytest.raises(InputError, match=r"pose in 6 messages \(2 undecodable, 6 not_finite"):
        made(columns)


def fixes(names: list[str], count: int = 6) -> PoseColumns:
    places = np.column_stack(
        [np.full(count, 47.0), 8.0 + 1e-5 * np.arange(count), np.zeros(count)]
    )
    frames = [(row, name, "") for row, name in enumerate(names)]
    quality = np.zeros((count, 11))
    return later(poses(count)).replaced(positions=places, fix_quality=quality, frames=frames)


@pytest.mark.parametrize(
    ("names", "text"),
    [
        (["gps"], None),
        (["gps", "gnss"], "frame_id changes from gps to gnss"),
        (["gps", "gnss", "gps"], ""),
        (["a", "b", "c"], ""),
    ],
)
def test_fixes_are_of_one_receiver(names: list[str], text: str | None) -> None:
    if text == "":
        with pytest.raises(InputError, match="has fixes of several receivers"):
            made(fixes(names))
        return
    result = made(fixes(names))
    assert result.child_frame == names[0]
    assert result.reading.fixes is not None
    told = [remark.text for remark in result.reading.remarks if remark.code == "frame_changed"]
    assert told == ([] if text is None else [text])


def line(stamps_s: list[float], places: list[float], **reading: Any) -> Trajectory:
    positions = np.zeros((len(places), 3))
    positions[:, 1] = places
    stamps = np.round(np.array(stamps_s) * SECOND).astype(np.int64)
    return Trajectory(stamps, positions, reading=SourceInfo(**reading))


def test_key_figures_of_a_trajectory() -> None:
    assert LONG_GAP_S == 0.5
    result = summarize("x", line([10.0, 10.1, 10.2, 10.7, 11.3], [0.0, 0.1, 0.4, 0.5, 1.0]))
    assert (result.poses, result.gaps) == (5, 1)
    assert (result.first_ns, result.last_ns) == (10 * SECOND, 11_300_000_000)
    assert result.rate_hz == pytest.approx(1.0 / 0.3)
    assert result.path_length_m == pytest.approx(1.0)
    assert result.mean_speed_mps == pytest.approx(1.0 / 1.3)
    assert result.largest_speed_mps == pytest.approx(3.0)
    assert result.longest_gap_s == pytest.approx(0.6)
    assert (result.holds, result.remarks, result.could_be) == ((), (), "estimate or groundtruth")


def test_what_is_neither_table_nor_array_is_refused() -> None:
    side = line([1.0, 2.0, 3.0], [0.0, 1.0, 2.0])
    for other in (SimpleNamespace(columns=()), SimpleNamespace(to_numpy=None), 3, [1.0]):
        with pytest.raises(InputError, match="the estimate is of type"):
            evaluate(side, other)  # type: ignore[arg-type]
