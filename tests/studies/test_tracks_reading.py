"""Reading of recordings with tracks: files, calibrations, and what is refused."""

from __future__ import annotations

import dataclasses
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tracks_folders import LENSES, LEVER_ARM

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import so3
from trajeval_ros.studies.sensor_recording import (
    SensorRecording,
    at_instants,
    one_instant_each,
)
from trajeval_ros.studies.tracks_folder import read_camera, read_tracks_folder


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
    found = read_tracks_folder(folder)
    np.testing.assert_array_equal(found.groundtruth.stamps, recording.groundtruth.stamps)
    np.testing.assert_array_equal(found.image_stamps, recording.image_stamps)
    tables = []
    for item in (found, recording):
        table = np.column_stack([item.image_of, item.track_of, item.pixels])
        tables.append(table[np.lexsort(table.T[1::-1])])
    np.testing.assert_array_equal(*tables)


@pytest.mark.parametrize("name", ["imu.csv", "tracks.csv", "groundtruth.csv"])
def test_comments_are_no_rows(name: str, folder: Path, recording: SensorRecording) -> None:
    edit(folder / name, lambda text: text.replace("\n", "\n# a, comment\n", 5) + "# end")
    found = read_tracks_folder(folder)
    np.testing.assert_array_equal(found.pixels, recording.pixels)
    np.testing.assert_array_equal(found.accelerations, recording.accelerations)
    np.testing.assert_array_equal(found.groundtruth.stamps, recording.groundtruth.stamps)
    edit(folder / name, lambda text: text.replace("# end", "1,2"))
    if name != "groundtruth.csv":
        rows = len((folder / name).read_text().splitlines())
        assert f"{name}, line {rows}: " in refusal(folder)


@pytest.mark.parametrize("name", ["imu.csv", "tracks.csv", "groundtruth.csv", "camera.yaml"])
def test_files_that_cannot_be_read(name: str, folder: Path) -> None:
    (folder / name).unlink()
    (folder / name).symlink_to("nowhere")
    assert "can't be read: no such file" in refusal(folder)
    (folder / name).unlink()
    (folder / name).mkdir()
    assert "director" in refusal(folder)


@pytest.mark.parametrize("name", ["1e300", str(2**53 + 2), "-1e300", "0.5", "0.7"])
def test_names_of_tracks_are_exact(name: str, folder: Path) -> None:
    edit(folder / "tracks.csv", lambda text: text.replace(",0,", f",{name},"))
    assert "must be whole numbers up to 9007199254740992" in refusal(folder)
    edit(folder / "tracks.csv", lambda text: text.replace(f",{name},", f",{2**53},"))
    assert read_tracks_folder(folder).track_of.max() == 2**53


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
    found = read_tracks_folder(folder)
    assert found.groundtruth.gyroscope_biases is None
    assert found.notes == (
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


def test_files_of_this_package_come_before_those_of_euroc(folder: Path) -> None:
    other = folder / "mav0" / "imu0"
    other.mkdir(parents=True)
    (other / "data.csv").write_text("not read")
    assert len(read_tracks_folder(folder).imu_stamps) > 100
    (folder / "imu.csv").unlink()
    assert "not read" not in refusal(folder)
    (folder / "tracks_b.csv").write_text("")
    (folder / "imu.csv").write_text("")
    assert "more than one file of tracks (tracks.csv, tracks_b.csv)" in refusal(folder)
    assert "is not a folder" in refusal(folder / "imu.csv")


def test_a_file_that_is_too_large(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    size = (folder / "imu.csv").stat().st_size
    monkeypatch.setattr("trajeval_ros.io.text.sensor_table._LARGEST", size - 1)
    assert "imu.csv is too large; use a part of the recording" in refusal(folder)


@pytest.mark.parametrize(
    ("pattern", "by", "said"),
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
def test_calibrations_that_are_not_valid(pattern: str, by: str, said: str, folder: Path) -> None:
    path = folder / "camera.yaml"
    edit(path, lambda text: re.sub(pattern, by, text))
    with pytest.raises(InputError, match=re.escape(said)):
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


def test_instants_less_than_a_microsecond_apart_are_one() -> None:
    stamps = np.array([5000, 1000, 2000, 2001, 5000, 4001])
    instants, places = one_instant_each(stamps)
    # Each stamp is compared with the one before it.
    assert instants.tolist() == [1000, 4001]
    assert places.tolist() == [1, 0, 0, 0, 1, 1]
    instants, places = one_instant_each(np.array([1000, 2001, 3002]))
    assert instants.tolist() == [1000, 2001, 3002]
    known = np.array([0, 10_000, 20_000])
    at = np.array([-1000, 999, 10_000, 9_100, 10_900, 21_000])
    assert at_instants(known, at, "fix").tolist() == [0, 0, 1, 1, 1, 2]
    with pytest.raises(
        InputError, match=r"2 of 3 keyframes have no fix: at 15000 ns .* 0\.005 ms"
    ):
        at_instants(known, np.array([11_001, 15_000, 0]), "fix")


def test_a_singular_lens_is_not_inverted() -> None:
    lens = dataclasses.replace(
        LENSES["radial-tangential"], coefficients=np.array([-1.0 / 3.0, 0.0, 0.0, 0.0])
    )
    # The radius r - r^3 / 3 is largest at r = 1; beyond it the model folds back.
    edge = lens.centre_px + lens.focal_px * [2.0 / 3.0, 0.0]
    plane, _ = lens.undistorted(np.array([edge - [1e-3, 0.0], edge + [1e-3, 0.0]]))
    assert np.isfinite(plane[0]).all()
    assert 0.99 < plane[0, 0] < 1.0
    assert np.isnan(plane[1]).all()
