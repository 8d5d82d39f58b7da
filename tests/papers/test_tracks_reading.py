"""Reading of recordings with tracks: files, calibrations, and what is refused."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tracks_folders import LEVER_ARM

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import so3
from trajeval_ros.papers.sensor_recording import (
    SensorRecording,
)
from trajeval_ros.papers.tracks_folder import read_camera, read_tracks_folder


@pytest.fixture(scope="module")
def recording(tracks_flight: Path) -> SensorRecording:
    return read_tracks_folder(tracks_flight)


@pytest.fixture
def folder(tmp_path: Path, tracks_flight: Path) -> Path:
    return shutil.copytree(tracks_flight, tmp_path / "flight")


def edit(path: Path, change: Callable[[str], str]) -> None:
    path.write_text(change(path.read_text()))


def refusal(folder: Path) -> str:
    with pytest.raises(InputError) as refused:
        read_tracks_folder(folder)
    assert "\n" not in str(refused.value)
    return str(refused.value)


def test_the_order_of_rows_and_a_header_change_nothing(
    folder: Path, recording: SensorRecording
) -> None:
    generator = np.random.default_rng(1)
    for name in ("tracks.csv", "groundtruth.csv"):
        head, *rows = (folder / name).read_text().splitlines()
        kept = [head] if name == "groundtruth.csv" else []
        (folder / name).write_text("\n".join([*kept, *generator.permutation(rows)]) + "\n")
    result = read_tracks_folder(folder)
    np.testing.assert_array_equal(result.groundtruth.stamps, recording.groundtruth.stamps)
    np.testing.assert_array_equal(result.image_stamps, recording.image_stamps)
    tables = []
    for item in (result, recording):
        table = np.column_stack([item.image_of, item.track_of, item.pixels])
        tables.append(table[np.lexsort(table.T[1::-1])])
    np.testing.assert_array_equal(*tables)


@pytest.mark.parametrize("name", ["imu.csv", "tracks.csv", "groundtruth.csv", "camera.yaml"])
def test_files_that_cannot_be_read(name: str, folder: Path) -> None:
    (folder / name).unlink()
    (folder / name).symlink_to("nowhere")
    assert "can't be read: no such file" in refusal(folder)
    (folder / name).unlink()
    (folder / name).mkdir()
    assert "director" in refusal(folder)


def test_groundtruth_needs_three_poses_with_stamps(folder: Path) -> None:
    path = folder / "groundtruth.csv"
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, *rows[:3]]))
    assert len(read_tracks_folder(folder).groundtruth) == 3
    needs = "needs timestamps, positions and orientations of at least 3 poses"
    path.write_text("\n".join([head, *rows[:2]]))
    assert needs in refusal(folder)
    path.write_text("\n".join("1 0 0 1 0 1 0 2 0 0 1 3" for _ in range(9)))
    assert needs in refusal(folder)
    path.write_text("\n".join(",".join(row.split(",")[:4]) for row in rows))
    assert needs in refusal(folder)
    path.write_text("\n".join([head, rows[0], *rows]))
    assert "has repeated timestamps; remove the repeated rows" in refusal(folder)


def test_biases_of_one_sensor_are_not_used(folder: Path) -> None:
    edit(
        folder / "groundtruth.csv",
        lambda text: "\n".join(",".join(row.split(",")[:14]) for row in text.splitlines()),
    )
    result = read_tracks_folder(folder)
    assert result.groundtruth.gyroscope_biases is None
    assert result.notes == (
        "no biases of both sensors in groundtruth: IMU used without correction",
    )
    edit(
        folder / "groundtruth.csv",
        lambda text: "\n".join(",".join(row.split(",")[:8]) for row in text.splitlines()),
    )
    truth = read_tracks_folder(folder).groundtruth
    assert truth.velocities is not None
    middle = (truth.positions[2:] - truth.positions[:-2]) / 0.1
    np.testing.assert_allclose(truth.velocities[1:-1], middle, atol=1e-9)


def test_samples_of_the_imu_must_rise(folder: Path) -> None:
    head, *rows = (folder / "imu.csv").read_text().splitlines()
    for wrong in ([*rows[:5], rows[4], *rows[5:]], [*rows[:5], rows[6], rows[5], *rows[7:]]):
        (folder / "imu.csv").write_text("\n".join([head, *wrong]))
        stamp = wrong[4 if wrong[5] == wrong[4] else 5].partition(",")[0]
        assert f"the timestamp after {stamp} ns does not increase" in refusal(folder)
    (folder / "imu.csv").write_text("\n".join([head, rows[0]]))
    assert "imu.csv: empty; use the columns t_ns wx" in refusal(folder)
    (folder / "imu.csv").write_text("\n".join([head, *rows[:7], rows[7].replace(",", ",inf,", 1)]))
    assert "line 9: 7 columns expected, found 8" in refusal(folder)
    cells = rows[7].split(",")
    spoilt = ",".join([*cells[:-1], "inf"])
    (folder / "imu.csv").write_text("\n".join([head, *rows[:7], spoilt, *rows[8:]]))
    assert "row 8 is not finite" in refusal(folder)
    (folder / "imu.csv").write_text("\n".join([head, rows[0], spoilt]))
    assert "row 2 is not finite" in refusal(folder)


@pytest.mark.parametrize(
    ("pattern", "by", "message"),
    [
        (r"resolution: .*", "resolution: [752, 0]", "resolution must be from 1 to 65536 pixels"),
        (r"resolution: .*", "resolution: [0.5, 480]", "resolution must be from 1"),
        (r"resolution: .*", "resolution: [752, 70000]", "resolution must be from 1"),
        (r"resolution: .*", "resolution: [752, 480, 1]", "resolution must be 2 numbers"),
        (r"intrinsics: .*", "intrinsics: [458, -457, 0, 0]", "focal lengths must be greater"),
        (r"intrinsics: .*", "intrinsics: [.nan, 457, 0, 0]", "intrinsics must be 4 numbers"),
        (r"intrinsics: .*", "intrinsics: x", "intrinsics must be 4 numbers"),
        (r"intrinsics: .*", "intrinsics: [[1], [1, 2], 3]", "intrinsics must be 4 numbers"),
        (r"distortion_coefficients: .*", "distortion_coefficients: [0, 0, 0]", "must be 4 number"),
        (r", 1\.0\]\n", ", 1.1]\n", "is not a rigid transformation"),
        (r"0\.0, 0\.0, 0\.0, 1\.0\]\n", "0.0, 0.1, 0.0, 1.0]\n", "is not a rigid transformation"),
    ],
)
def test_calibrations_that_are_not_valid(
    pattern: str, by: str, message: str, folder: Path
) -> None:
    path = folder / "camera.yaml"
    edit(path, lambda text: re.sub(pattern, by, text))
    with pytest.raises(InputError, match=re.escape(message)):
        read_camera(path)


def test_a_calibration(folder: Path) -> None:
    path = folder / "camera.yaml"
    camera = read_camera(path)
    assert (camera.width, camera.height) == (752, 480)
    edit(path, lambda text: text.replace("[752, 480]", "[1, 65536]"))
    assert (read_camera(path).width, read_camera(path).height) == (1, 65536)
    assert camera.lens.focal_px.tolist() == [458.0, 457.0]
    assert camera.lens.centre_px.tolist() == [367.0, 248.0]
    np.testing.assert_allclose(camera.lever_arm, LEVER_ARM)
    text = path.read_text()
    for name, model in (("radtan", "radial-tangential"), ("plumb_bob", "radial-tangential"),
                        ("equi", "equidistant"), ("kannala-brandt", "equidistant")):  # fmt: skip
        path.write_text(re.sub("distortion_model: .*", f"distortion_model: {name}", text))
        assert read_camera(path).lens.distortion == model
    rows = np.eye(4)
    rows[:3, :3] = so3.exp(np.array([0.1, 0.2, 0.3]))
    rows[:3, 3] = 1.0, 2.0, 3.0
    for scale, is_good in ((1.0, True), (1.0004, True), (1.0006, False), (-1.0, False)):
        spoilt = rows.copy()
        spoilt[:3, :3] *= scale
        path.write_text(re.sub("T_BS: .*", f"T_BS: {{data: {spoilt.ravel().tolist()}}}", text))
        if is_good:
            np.testing.assert_array_equal(read_camera(path).rotation, spoilt[:3, :3])
        else:
            with pytest.raises(InputError, match="is not a rigid transformation"):
                read_camera(path)
