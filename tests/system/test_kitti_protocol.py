"""The KITTI odometry devkit's rule, written out frame by frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from strategies import Array, make_groundtruth

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.source_info import SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.metrics.protocol import PROTOCOLS, metres
from trajeval_ros.pipeline.pipeline import evaluate

LENGTHS = (100, 200, 300, 400, 500, 600, 700, 800)


def poses_of(trajectory: Trajectory) -> Array:
    assert trajectory.rotations is not None
    poses = np.tile(np.eye(4), (len(trajectory), 1, 1))
    poses[:, :3, :3] = trajectory.rotations.as_matrix()
    poses[:, :3, 3] = trajectory.positions
    return poses


def devkit(truth: Array, estimate: Array) -> dict[int, list[tuple[float, float]]]:
    """Return (translation error, rotation error in rad) of each sequence by its length."""
    distance = [0.0]
    for before, after in pairwise(truth):
        distance.append(distance[-1] + float(np.linalg.norm(after[:3, 3] - before[:3, 3])))
    errors: dict[int, list[tuple[float, float]]] = {length: [] for length in LENGTHS}
    for first in range(0, len(truth), 10):
        for length in LENGTHS:
            last = next(
                (i for i in range(first, len(truth)) if distance[i] > distance[first] + length),
                None,
            )
            if last is None:
                continue
            true_step = np.linalg.inv(truth[first]) @ truth[last]
            step = np.linalg.inv(estimate[first]) @ estimate[last]
            error = np.linalg.inv(step) @ true_step
            cosine = 0.5 * (np.trace(error[:3, :3]) - 1.0)
            angle = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
            errors[length].append((float(np.linalg.norm(error[:3, 3])), angle))
    return errors


def matrices_of(path: Path) -> Array:
    rows = np.loadtxt(path).reshape(-1, 3, 4)
    last = np.tile([[[0.0, 0.0, 0.0, 1.0]]], (len(rows), 1, 1))
    return np.concatenate([rows, last], axis=1)


@pytest.fixture
def devkits_00(shared_data: Path) -> dict[int, list[tuple[float, float]]]:
    """What the devkit's rule gives for the matrices as they are in the files."""
    return devkit(
        *(matrices_of(shared_data / f"kitti/KITTI_00_{name}.txt") for name in ("gt", "ORB"))
    )


def test_relative_errors_are_the_devkits_on_sequence_00(
    recording: Callable[[str], Trajectory], devkits_00: dict[int, list[tuple[float, float]]]
) -> None:
    groundtruth = recording("kitti/KITTI_00_gt.txt")
    estimate = recording("kitti/KITTI_00_ORB.txt")
    result = evaluate(groundtruth, estimate, PROTOCOLS["kitti"])
    assert result.relative is not None
    assert [item.length_m for item in result.relative] == list(LENGTHS)
    for segments in result.relative:
        assert segments.length_m is not None
        theirs = np.array(devkits_00[int(segments.length_m)])
        assert len(segments.errors.ends) == len(theirs) > 0
        np.testing.assert_allclose(segments.errors.position_m, theirs[:, 0], rtol=1e-9)
        np.testing.assert_allclose(
            segments.errors.rotation_deg, np.degrees(theirs[:, 1]), rtol=1e-6, atol=1e-6
        )
        percent = segments.statistics["position_percent"]
        per_metre = segments.statistics["rotation_deg_per_m"]
        assert percent is not None
        assert per_metre is not None
        assert percent.mean == pytest.approx(100.0 * np.mean(theirs[:, 0]) / segments.length_m)
        rotation = np.degrees(np.mean(theirs[:, 1])) / segments.length_m
        assert per_metre.mean == pytest.approx(rotation, rel=1e-6)


def test_frames_pair_by_number_and_nothing_is_aligned() -> None:
    groundtruth = dataclasses.replace(make_groundtruth(1, 60), reading=SourceInfo(stamped=False))
    shifted = dataclasses.replace(
        groundtruth,
        positions=groundtruth.positions + [3.0, 0.0, 0.0],
        stamps=groundtruth.stamps + 7,
    )
    result = evaluate(groundtruth, shifted, PROTOCOLS["kitti"])
    assert PROTOCOLS["kitti"].gauge is Gauge.NONE
    assert len(result.association) == 60
    assert result.ate["position_m"] is not None
    assert result.ate["position_m"].min == pytest.approx(3.0)
    with pytest.raises(InputError, match="first of 13 columns"):
        evaluate(groundtruth, shifted[:59], PROTOCOLS["kitti"])


KITTI_ODOM_EVAL = "kitti_odom_eval/09_{}.txt"  # and what that tool says of them, 7dof


def test_frames_with_gaps_give_the_tools_numbers(recording: Callable[[str], Trajectory]) -> None:
    groundtruth, estimate = (
        recording(KITTI_ODOM_EVAL.format(name)) for name in ("groundtruth", "frame_index")
    )
    protocol = dataclasses.replace(PROTOCOLS["kitti"], gauge=Gauge.SIM3)
    result = evaluate(groundtruth, estimate, protocol)
    position, rotation = result.pooled["position_percent"], result.pooled["rotation_deg_per_m"]
    assert position is not None
    assert rotation is not None
    assert result.ate["position_m"] is not None
    assert position.count == rotation.count == 950
    # Its matrices of 6 digits are no rotations to 1e-6, and it turns all positions by the first.
    assert result.ate["position_m"].rmse == pytest.approx(8.386619, rel=1e-6)
    assert position.mean == pytest.approx(2.884113, abs=5e-7)
    assert 100.0 * rotation.mean == pytest.approx(0.249056, abs=5e-7)


def test_trajectories_without_matrices_have_those_of_their_rotations() -> None:
    groundtruth = dataclasses.replace(make_groundtruth(1, 60), reading=SourceInfo(stamped=False))
    estimate = dataclasses.replace(make_groundtruth(2, 60), reading=SourceInfo(stamped=False))
    errors = []
    for form in ("matrices", "se3"):
        protocol = dataclasses.replace(PROTOCOLS["kitti"], lengths=metres(1), re_form=form)
        result = evaluate(groundtruth, estimate, protocol)
        assert result.relative is not None
        errors.append(result.relative[0].errors)
    assert len(errors[0].starts) > 0
    np.testing.assert_allclose(errors[0].position_m, errors[1].position_m, rtol=1e-12)
    # Angles of degrees from their arc cosine: 16 roundings of it, divided by the angle.
    np.testing.assert_allclose(errors[0].rotation_deg, errors[1].rotation_deg, rtol=1e-9)


@pytest.fixture
def pose_rows() -> list[str]:
    poses = poses_of(make_groundtruth(1, 60))[:, :3].reshape(60, 12)
    return [" ".join(f"{number:.17g}" for number in row) for row in poses]


@pytest.mark.parametrize("beside", ["neither", "groundtruth", "estimate", "both"])
def test_frames_pair_by_their_numbers_with_times_beside_them_or_not(
    beside: str, pose_rows: list[str], tmp_path: Path
) -> None:
    groundtruth, estimate = tmp_path / "groundtruth.txt", tmp_path / "estimate.txt"
    groundtruth.write_text("\n".join(pose_rows), encoding="utf-8")
    frames = [frame for frame in range(3, 60) if frame % 7]
    rows = [f"{frame} {pose_rows[frame]}" for frame in frames]
    estimate.write_text("\n".join(rows), encoding="utf-8")
    times = "".join(f"{0.1 * frame:.9f}\n" for frame in range(60))
    for side in ("groundtruth", "estimate"):
        if beside in (side, "both"):
            (tmp_path / f"{side}_times.txt").write_text(times, encoding="utf-8")
    protocol = dataclasses.replace(PROTOCOLS["kitti"], lengths=metres(1))
    result = evaluate(*(read_trajectory(str(path)) for path in (groundtruth, estimate)), protocol)
    pairs = result.association
    assert pairs.groundtruth_rows is not None
    assert pairs.groundtruth_rows.tolist() == frames
    assert pairs.estimate_coverage == 1.0
    assert result.ate["position_m"] is not None
    assert result.ate["position_m"].max == 0.0
    assert result.relative is not None
    starts = pairs.groundtruth_rows[result.relative[0].errors.starts]
    ends = pairs.groundtruth_rows[result.relative[0].errors.ends]
    truth = read_trajectory(str(groundtruth))
    expected = [
        (start, end)
        for start in range(0, 60, 10)
        if (end := next((index for index in range(60) if far(truth, start, index)), 0)) in frames
        and start in frames
    ]
    assert list(zip(starts.tolist(), ends.tolist(), strict=True)) == expected != []


def far(truth: Trajectory, start: int, end: int) -> bool:
    return bool(truth.travelled[end] > truth.travelled[start] + 1.0)


def test_frames_without_groundtruth_are_counted(pose_rows: list[str], tmp_path: Path) -> None:
    groundtruth, estimate = tmp_path / "groundtruth.txt", tmp_path / "estimate.txt"
    groundtruth.write_text("\n".join(pose_rows[:50]), encoding="utf-8")
    rows = [f"{frame} {row}" for frame, row in enumerate(pose_rows)]
    estimate.write_text("\n".join(rows), encoding="utf-8")
    sides = [read_trajectory(str(path)) for path in (groundtruth, estimate)]
    result = evaluate(*sides, PROTOCOLS["kitti"])
    assert result.association.dropped == {"no_groundtruth_of_this_frame": 10}
    assert any("10 in frames without groundtruth" in warning for warning in result.warnings)


def test_rows_that_are_no_poses_move_no_other_row(pose_rows: list[str], tmp_path: Path) -> None:
    groundtruth, estimate = tmp_path / "groundtruth.txt", tmp_path / "estimate.txt"
    groundtruth.write_text("\n".join(pose_rows), encoding="utf-8")
    nothing = " ".join(["nan"] * 12)
    rows = [nothing if frame in (20, 21) else row for frame, row in enumerate(pose_rows)]
    estimate.write_text("\n".join(rows), encoding="utf-8")
    sides = [read_trajectory(str(path)) for path in (groundtruth, estimate)]
    ate = evaluate(*sides, PROTOCOLS["kitti"]).ate["position_m"]
    assert ate is not None
    assert (ate.count, ate.max) == (58, 0.0)


@pytest.mark.parametrize("frames", [[0, 1, 2, 2, 3], [0, 1, 3, 2, 4]])
def test_frames_that_repeat_or_go_back_are_refused(
    frames: list[int], pose_rows: list[str], tmp_path: Path
) -> None:
    path = tmp_path / "estimate.txt"
    rows = [f"{frame} {pose_rows[frame]}" for frame in frames]
    path.write_text("\n".join(rows), encoding="utf-8")
    estimate = read_trajectory(str(path))
    with pytest.raises(InputError, match=r"has frame 2 after frame [23]; sort the rows"):
        evaluate(make_groundtruth_of_frames(), estimate, PROTOCOLS["kitti"])


def make_groundtruth_of_frames() -> Trajectory:
    return dataclasses.replace(
        make_groundtruth(1, 60), reading=SourceInfo(stamped=False, frame_numbers=np.arange(60))
    )
