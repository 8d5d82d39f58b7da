"""Scans in a live picture: where the estimate places them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trajeval_ros.geometry.trajectory import NANOSECONDS

pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")

from trajeval_ros.viewer.live_path import LiveRecording
from trajeval_ros.viewer.live_pictures import LiveScans
from trajeval_ros.viewer.scene_entities import EstimateEntities

ENTITY = "world/estimate/vio/points"


class Kept(LiveRecording):
    """A recording that keeps what is drawn."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[tuple[int, str, np.ndarray]] = []
        self.declared = 0

    def log(self, stamp: int, entity: str, row: Any) -> None:
        points = row.positions.as_arrow_array().flatten().to_numpy().reshape(-1, 3)
        self.rows.append((stamp, entity, points))

    def send(self, *_: object) -> None:
        self.declared += 1


def poses(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    stamps = NANOSECONDS + np.arange(count) * 50_000_000
    rotations = Rotation.random(count, random_state=seed).as_quat()
    return stamps, np.hstack([generator.normal(size=(count, 3)), rotations])


def placed(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    return Rotation.from_quat(pose[3:]).apply(points) + pose[:3]


@pytest.mark.parametrize("batches", [[8], [1, 2, 5], [3, 5]])
def test_scans_are_at_the_nearest_pose_however_pairs_arrive(batches: list[int]) -> None:
    recording = Kept()
    scans = LiveScans(EstimateEntities("vio", 0), recording)
    stamps, rows = poses(3, 8)
    points = np.random.default_rng(4).normal(size=(7, 3))
    # Nearer to the pose before it, nearer to the one after it, and at a pose.
    times = [stamps[1] + 10_000_000, stamps[3] - 10_000_000, stamps[6]]
    for time in times:
        scans.add(int(time), points)
    begin = 0
    for size in batches:
        scans.place(stamps[begin : begin + size], rows[begin : begin + size])
        begin += size
    assert [(stamp, entity) for stamp, entity, _ in recording.rows] == [
        (time, ENTITY) for time in times
    ]
    for (_, _, drawn), place in zip(recording.rows, (1, 3, 6), strict=True):
        np.testing.assert_allclose(drawn, placed(rows[place], points), atol=1e-5)
    assert recording.declared == 1


def test_a_scan_that_arrives_after_later_poses_is_at_its_own() -> None:
    recording = Kept()
    scans = LiveScans(EstimateEntities("vio", 0), recording)
    stamps, rows = poses(7, 8)
    points = np.ones((1, 3))
    scans.place(stamps[:4], rows[:4])
    scans.add(int(stamps[1]), points)
    scans.place(stamps[4:], rows[4:])
    [(_, _, drawn)] = recording.rows
    np.testing.assert_allclose(drawn, placed(rows[1], points), atol=1e-5)


def test_scans_wait_for_poses_and_are_dropped_in_gaps() -> None:
    recording = Kept()
    scans = LiveScans(EstimateEntities("vio", 0), recording)
    stamps, rows = poses(5, 2)
    points = np.ones((1, 3))
    scans.add(int(stamps[1]), points)
    scans.place(stamps[:1], rows[:1])
    assert recording.rows == []
    scans.place(stamps[1:], rows[1:])
    assert len(recording.rows) == 1
    scans.add(int(stamps[1]) + NANOSECONDS // 2, points)
    scans.place(stamps[1:] + NANOSECONDS, rows[1:])
    assert len(recording.rows) == 1


def test_waiting_scans_are_bounded_and_the_newest_ones() -> None:
    recording = Kept()
    scans = LiveScans(EstimateEntities("vio", 0), recording)
    for second in range(1, 1000):
        scans.add(second * NANOSECONDS, np.full((1, 3), float(second)))
    stamps = np.arange(1, 1001) * NANOSECONDS
    scans.place(stamps, np.tile([0.0, 0, 0, 0, 0, 0, 1], (1000, 1)))
    drawn = [stamp // NANOSECONDS for stamp, _, _ in recording.rows]
    assert drawn == list(range(1000 - len(drawn), 1000))
    assert len(drawn) == 60


def test_style_is_declared_again_on_a_new_recording_only_if_there_are_scans() -> None:
    recording = Kept()
    scans = LiveScans(EstimateEntities("vio", 0), recording)
    scans.declare()
    assert recording.declared == 0
    stamps, rows = poses(1, 1)
    scans.add(int(stamps[0]), np.ones((1, 3)))
    scans.place(stamps, rows)
    scans.declare()
    assert recording.declared == 2
