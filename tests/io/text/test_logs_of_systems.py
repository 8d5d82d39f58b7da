"""Text logs in the layouts of named systems: the poses that were written are read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.io.text.hints import SideHints

COUNT = 40
TURNS = Rotation.random(COUNT, random_state=3)
POSITIONS = np.random.default_rng(4).normal(size=(COUNT, 3))
TIMES = 1_700_000_000.0 + 0.5 * np.arange(COUNT)
XYZW = TURNS.as_quat()
WXYZ = XYZW[:, [3, 0, 1, 2]]


def write(path: Path, rows: Sequence[str]) -> Path:
    path.write_text("\n".join(rows) + "\n")
    return path


def check(outcome: Trajectory, times: Sequence[float] | None = None, atol: float = 1e-6) -> None:
    expected = TIMES if times is None else np.array(times)
    np.testing.assert_allclose(outcome.stamps / 1e9, expected, atol=1e-6, rtol=0)
    np.testing.assert_allclose(outcome.positions, POSITIONS, rtol=0, atol=atol)
    assert outcome.rotations is not None
    # Half of a last digit in four components, and twice that as an angle.
    assert (outcome.rotations * TURNS.inv()).magnitude().max() < 4.0 * atol


def numbers(values: np.ndarray, sign: str = " ") -> str:
    return sign.join(f"{value:.7f}" for value in values)


@pytest.mark.parametrize("digits", [0, 6])
@pytest.mark.parametrize("with_velocity", [False, True])
def test_a_comma_at_the_end_is_of_vins(tmp_path: Path, digits: int, with_velocity: bool) -> None:
    """The quaternion has w first in every unit of time."""
    times = np.round(TIMES + 0.001, digits)
    more = [np.ones(3)] if with_velocity else []
    rows = [
        f"{time:.{digits}f},{numbers(np.concatenate([p, q, *more]), ',')},"
        for time, p, q in zip(times, POSITIONS, WXYZ, strict=True)
    ]
    kept = slice(0, None, 2) if digits == 0 else slice(None)  # whole seconds repeat
    result = read_trajectory(write(tmp_path / "vio.csv", rows[kept]))
    np.testing.assert_allclose(result.positions, POSITIONS[kept], atol=1e-6)
    assert result.rotations is not None
    assert (result.rotations * TURNS[kept].inv()).magnitude().max() < 1e-5
    assert (result.velocities is not None) == with_velocity


def test_the_log_of_fast_lio_has_rotation_vectors(tmp_path: Path) -> None:
    rest = np.zeros(3), [1.0, 2.0, 3.0], np.zeros(12)
    rows = [
        f"{0.1 * row:.6f} {numbers(np.concatenate([v, p, *rest]))} \r"
        for row, (v, p) in enumerate(zip(TURNS.as_rotvec(), POSITIONS, strict=True))
    ]
    result = read_trajectory(write(tmp_path / "pos_log.txt", rows))
    check(result, (0.1 * np.arange(COUNT)).tolist())
    assert result.velocities is not None
    np.testing.assert_array_equal(result.velocities[0], [1.0, 2.0, 3.0])
    assert "log of FAST-LIO" in "; ".join(result.reading.messages(Level.NOTE))


def test_angles_of_point_lio_are_no_rotation_vectors(tmp_path: Path) -> None:
    """Its log has as many columns; angles together can be longer than pi."""
    angles = np.tile([1.0, 0.2, 3.1], (COUNT, 1))
    rows = [
        f"{0.1 * row:.6f} {numbers(np.concatenate([v, p, np.zeros(18)]))} \r"
        for row, (v, p) in enumerate(zip(angles, POSITIONS, strict=True))
    ]
    path = write(tmp_path / "pos_log.txt", rows)
    with pytest.raises(InputError, match="those of Point-LIO are angles: --columns '") as refused:
        read_trajectory(path)
    columns = str(refused.value).partition("--columns '")[2].rstrip("'")
    result = read_trajectory(path, hints=SideHints.of(columns, None).estimate)
    assert result.rotations is not None
    np.testing.assert_allclose(result.rotations[0].as_euler("xyz"), angles[0], atol=1e-5)


def test_an_id_in_the_last_column(tmp_path: Path) -> None:
    rows = [
        f"{time:.6f} {numbers(np.concatenate([p, q]))} {2 * row + 1}"
        for row, (time, p, q) in enumerate(zip(TIMES, POSITIONS, XYZW, strict=True))
    ]
    check(read_trajectory(write(tmp_path / "poses.txt", rows)))
    rows[3] = f"{rows[3].rpartition(' ')[0]} 2.5"
    with pytest.raises(InputError, match="unknown layout with 9 columns"):
        read_trajectory(write(tmp_path / "poses.txt", rows))


@pytest.mark.parametrize("name", ["times.txt", "slam_times.txt"])
def test_frame_numbers_use_the_times_in_the_folder(tmp_path: Path, name: str) -> None:
    rows = [
        f"{3 * row:.8f} {numbers(np.concatenate([p, q]))}"
        for row, (p, q) in enumerate(zip(POSITIONS, XYZW, strict=True))
    ]
    path = write(tmp_path / "slam.txt", rows)
    with pytest.raises(InputError, match=r"steps of 3.*--columns 't_ms x y z"):
        read_trajectory(path)  # without times
    every = 1_700_000_000.0 + np.arange(3 * COUNT) / 6.0
    write(tmp_path / name, [f"{time:.9f}" for time in every])
    result = read_trajectory(path)
    check(result)
    notes = "; ".join(result.reading.messages(Level.NOTE))
    assert f"timestamps read from {tmp_path / name}" in notes


def test_times_in_the_folder_are_not_of_a_file_with_timestamps(tmp_path: Path) -> None:
    rows = [
        f"{time:.6f} {numbers(np.concatenate([p, q]))}"
        for time, p, q in zip(TIMES, POSITIONS, XYZW, strict=True)
    ]
    write(tmp_path / "times.txt", [f"{index}" for index in range(COUNT)])
    check(read_trajectory(write(tmp_path / "slam.txt", rows)))


def test_frame_numbers_of_an_array_use_the_times_in_the_folder(tmp_path: Path) -> None:
    np.save(tmp_path / "poses.npy", np.column_stack([POSITIONS, XYZW]).astype(np.float32))
    np.save(tmp_path / "tstamps.npy", 3.0 * np.arange(COUNT))
    every = 1_700_000_000.0 + np.arange(3 * COUNT) / 6.0
    write(tmp_path / "times.txt", [f"{time:.9f}" for time in every])
    result = read_trajectory(tmp_path / "poses.npy")
    check(result)
    assert "float32" in "; ".join(result.reading.messages(Level.NOTE))


def columns(*parts: object, digits: int) -> list[str]:
    """Return one text per row from arrays (N, ...), or from constants of all rows."""
    arrays = [np.broadcast_to(part, (COUNT, np.shape(part)[-1])) for part in parts]
    return [" ".join(f"{item:.{digits}f}" for item in row) for row in np.hstack(arrays)]


MATRICES = np.concatenate([TURNS.as_matrix(), POSITIONS[:, :, None]], axis=2)
POSE, PLACE = columns(POSITIONS, XYZW, digits=6), columns(POSITIONS, digits=6)
STATE = columns(XYZW, POSITIONS, np.ones(3), np.zeros(6), digits=6)
CAMERA = columns(
    [458.654, 457.296, 367.215, 248.375], np.zeros(4), [0, 0, 0, 1], [0.01, 0.02, 0.03], digits=6
)
VARIANCES = columns([1e-4, 0, 0, 1e-4, 0, 1e-4, 0.01, 0, 0, 0.01, 0, 0.01], digits=10)
# By file: the rows that the program writes, and the largest rounding of a number.
FILES = {
    "state_estimate.txt": (
        ["# timestamp(s) q p v bg ba cam_imu_dt num_cam cam0_k cam0_d cam0_rot cam0_trans"]
        + [f"{t:.5f} {s} 0.0000000 1 {c} " for t, s, c in zip(TIMES, STATE, CAMERA, strict=True)],
        1e-6,
    ),
    "recorder.txt": (
        [
            "# timestamp(s) tx ty tz qx qy qz qw Pr11 Pr12 Pr13 Pr22 Pr23 Pr33 "
            "Pt11 Pt12 Pt13 Pt22 Pt23 Pt33"
        ]
        + [f"{t:.5f} {p} {v}" for t, p, v in zip(TIMES, POSE, VARIANCES, strict=True)],
        1e-6,
    ),
    "CameraTrajectory.txt": ([f"{t:.6f} {p}" for t, p in zip(TIMES, POSE, strict=True)], 1e-6),
    "CameraTrajectoryEuRoC.txt": (
        [f"{1e9 * t:.6f} {p}" for t, p in zip(TIMES, POSE, strict=True)],
        1e-6,
    ),
    "scans_poses_tum.txt": (columns(TIMES[:, None], POSITIONS, XYZW, digits=4), 1e-4),
    "rtabmap_10.txt": (
        ["#timestamp x y z qx qy qz qw"]
        + [f"{t:f} {p}" for t, p in zip(TIMES, POSE, strict=True)],
        1e-6,
    ),
    "rtabmap_11.txt": (
        ["#timestamp x y z qx qy qz qw id"]
        + [f"{t:f} {p} {row}" for row, (t, p) in enumerate(zip(TIMES, POSE, strict=True), 1)],
        1e-6,
    ),
}


@pytest.mark.parametrize("name", FILES)
def test_files_of_systems_hold_the_poses_that_were_written(tmp_path: Path, name: str) -> None:
    rows, atol = FILES[name]
    result = read_trajectory(write(tmp_path / name, rows))
    check(result, atol=atol)
    assert (result.covariances is not None) == (name == "recorder.txt")
    assert (result.velocities is not None) == (name == "state_estimate.txt")


@pytest.mark.parametrize("name", ["scans_poses.npy", "scans_poses_kitti.txt"])
def test_poses_without_times_have_those_of_their_rate(tmp_path: Path, name: str) -> None:
    """Files of KISS-ICP, and export format 0 of rtabmap."""
    path = tmp_path / name
    if path.suffix == ".npy":
        whole = np.tile(np.eye(4), (COUNT, 1, 1))
        whole[:, :3] = MATRICES
        np.save(path, whole)
    else:
        np.savetxt(path, MATRICES.reshape(COUNT, 12))
    result = read_trajectory(path, hints=SideHints.of(None, 10.0).estimate)
    check(result, (0.1 * np.arange(COUNT)).tolist())
    assert result.up.name == ("z" if path.suffix == ".npy" else "-y")


def test_poses_of_droid_slam_are_inverse(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inverse = TURNS.inv()
    poses = np.column_stack([-inverse.apply(POSITIONS), inverse.as_quat()])
    np.save(tmp_path / "poses.npy", poses.astype(np.float32))
    np.save(tmp_path / "tstamps.npy", TIMES)
    monkeypatch.chdir(tmp_path)
    assert main(["trajectory", "poses.npy", "--inverse", "poses", "--save-as", "tum"]) == 0
    check(read_trajectory("poses.txt"))
