"""Reading of recordings with tracks, and selection of keyframes, by their definitions."""

from __future__ import annotations

import dataclasses
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tracks_folders import LENSES, LEVER_ARM, PIXEL_NOISE, write_tracks_folder

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie, so3
from trajeval_ros.io.tracks.camera_file import read_camera
from trajeval_ros.io.tracks.tracks_folder import read_tracks_folder
from trajeval_ros.visual_inertial.covariance_tests import split_half_nees
from trajeval_ros.visual_inertial.inertial_errors import BiasNoise
from trajeval_ros.visual_inertial.keyframe_selection import KeyframeSelection, select
from trajeval_ros.visual_inertial.outliers import (
    CHI2_LIMIT,
    TRACKER_NOISE_PX,
    _is_good,
    _parallax,
    reject_outliers,
    triangulated,
)
from trajeval_ros.visual_inertial.preintegration import GRAVITY, ImuNoise
from trajeval_ros.visual_inertial.residual_groups import residual_groups, track_correlation
from trajeval_ros.visual_inertial.sensor_recording import (
    SAME_INSTANT_NS,
    SensorRecording,
    at_instants,
    one_instant_each,
)

IMU_NOISE = ImuNoise(1.7e-4, 2e-3)
BIAS_NOISE = BiasNoise(1e-5, 1e-4, 1e-3, 1e-2)


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tracks_folder(tmp_path_factory.mktemp("tracks") / "flight")


@pytest.fixture(scope="module")
def recording(flight: Path) -> SensorRecording:
    return read_tracks_folder(flight)


@pytest.fixture
def folder(tmp_path: Path, flight: Path) -> Path:
    return shutil.copytree(flight, tmp_path / "flight")


def selected(
    recording: SensorRecording,
    every: int = 3,
    most: int = 30,
    bias_noise: BiasNoise | None = None,
) -> KeyframeSelection:
    return select(recording, every, most, PIXEL_NOISE, IMU_NOISE, GRAVITY, bias_noise)


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
    for each in (found, recording):
        table = np.column_stack([each.image_of, each.track_of, each.pixels])
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
    assert "can't be read: is a directory" in refusal(folder)


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
    assert "imu.csv: empty; use the columns stamp_ns,wx" in refusal(folder)
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
    monkeypatch.setattr("trajeval_ros.io.tracks.tracks_folder._LARGEST", size - 1)
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


def with_samples(
    recording: SensorRecording, kept: np.ndarray, stamps: np.ndarray | None = None
) -> SensorRecording:
    """Return a recording with some samples of the IMU, at other times if given."""
    return dataclasses.replace(
        recording,
        imu_stamps=recording.imu_stamps[kept] if stamps is None else stamps,
        angular_velocities=recording.angular_velocities[kept],
        accelerations=recording.accelerations[kept],
    )


def test_keyframes_are_every_nth_image_that_both_cover(recording: SensorRecording) -> None:
    whole = selected(recording)
    count = len(recording.image_stamps)
    truth = recording.groundtruth
    assert truth.quaternions is not None
    assert truth.velocities is not None
    assert len(whole.truth.positions) == -(-count // 3)
    np.testing.assert_array_equal(whole.truth.positions, truth.positions[::3])
    np.testing.assert_array_equal(whole.truth.velocities, truth.velocities[::3])
    np.testing.assert_array_equal(whole.truth.rotations, lie.to_matrix(truth.quaternions[::3]))
    assert whole.notes == ()
    few = selected(recording, most=5)
    np.testing.assert_array_equal(few.truth.positions, truth.positions[:15:3])
    # An IMU that starts a microsecond after image 4 covers it, and one nanosecond later does not.
    stamps = recording.imu_stamps
    for late_ns, first in ((SAME_INSTANT_NS, 4), (SAME_INSTANT_NS + 1, 5)):
        moved = stamps[stamps >= recording.image_stamps[4]].copy()
        moved[0] += late_ns
        part = selected(with_samples(recording, stamps >= recording.image_stamps[4], moved), 3, 5)
        np.testing.assert_array_equal(
            part.truth.positions, truth.positions[first : first + 15 : 3]
        )
        assert part.notes == (
            f"images outside the time span of IMU or groundtruth, dropped: {first}",
        )
    for early_ns, last in ((SAME_INSTANT_NS, 40), (SAME_INSTANT_NS + 1, 39)):
        kept = stamps <= recording.image_stamps[40]
        moved = stamps[kept].copy()
        moved[-1] -= early_ns
        part = selected(with_samples(recording, kept, moved), 1, 100)
        np.testing.assert_array_equal(part.truth.positions, truth.positions[: last + 1])
        assert part.notes[-1].endswith(f"dropped: {count - 1 - last}")
    assert len(selected(recording, every=20).truth.positions) == 3
    with pytest.raises(InputError, match=r"only 2 keyframes \(47 of 47 images .*, one in 24"):
        selected(recording, every=24)


def test_observations_are_those_of_tracks_in_three_keyframes(recording: SensorRecording) -> None:
    found = selected(recording)
    frames = np.arange(0, len(recording.image_stamps), 3)
    seen: dict[int, list[tuple[int, int]]] = {}
    for row, (image, track) in enumerate(zip(recording.image_of, recording.track_of, strict=True)):
        if image in frames:
            seen.setdefault(int(track), []).append((int(image) // 3, row))
    long = {track: rows for track, rows in seen.items() if len(rows) >= 3}
    assert found.landmarks == len(long) < len(seen) or len(long) == len(seen)
    expected = {
        (keyframe, place): row
        for place, track in enumerate(sorted(long))
        for keyframe, row in long[track]
    }
    pairs = list(zip(found.keyframe_of.tolist(), found.landmark_of.tolist(), strict=True))
    assert set(pairs) == expected.keys()
    measured = recording.pixels[[expected[pair] for pair in pairs]]
    lens = recording.camera.lens
    plane = (found.pixels - found.camera.centre) / found.camera.focal_px
    again, derivative = lens.distorted(plane)
    np.testing.assert_allclose(again, measured, atol=1e-5)
    np.testing.assert_allclose(found.weights, derivative / found.camera.focal_px, rtol=1e-6)
    assert found.camera.focal_px == pytest.approx(np.sqrt(458.0 * 457.0))
    assert found.camera.noise_px == PIXEL_NOISE
    assert found.with_noise(0.7).camera.noise_px == 0.7


def test_kept_observations_leave_landmarks_with_three_views(recording: SensorRecording) -> None:
    found = selected(recording)
    views = np.bincount(found.landmark_of)
    lost = int(np.flatnonzero(views == 3)[0]) if (views == 3).any() else int(views.argmin())
    wanted = np.ones(len(found.pixels), dtype=bool)
    rows = np.flatnonzero(found.landmark_of == lost)
    wanted[rows[: len(rows) - 2]] = False  # two views of it are left
    part, left = found.kept(wanted)
    assert left.tolist() == [each for each in range(found.landmarks) if each != lost]
    assert part.landmarks == found.landmarks - 1
    others = found.landmark_of != lost
    np.testing.assert_array_equal(part.pixels, found.pixels[others])
    np.testing.assert_array_equal(part.weights, found.weights[others])
    np.testing.assert_array_equal(part.keyframe_of, found.keyframe_of[others])
    np.testing.assert_array_equal(left[part.landmark_of], found.landmark_of[others])


def test_the_imu_between_keyframes_agrees_with_groundtruth(recording: SensorRecording) -> None:
    found = selected(recording)
    assert found.preintegrated.durations_s == pytest.approx(
        np.full(len(found.truth.positions) - 1, 0.15)
    )
    turns = np.swapaxes(found.truth.rotations[:-1], 1, 2) @ found.truth.rotations[1:]
    off = so3.log(np.swapaxes(turns, 1, 2) @ found.preintegrated.rotations)
    assert np.abs(off).max() < 1e-3
    np.testing.assert_allclose(found.gravity_felt, GRAVITY, atol=0.02)
    assert found.drift_against_gyroscope_deg < 0.1
    turned = dataclasses.replace(
        recording,
        angular_velocities=recording.angular_velocities + np.array([0.0, 0.0, np.radians(1.0)]),
    )
    duration_s = float(found.preintegrated.durations_s.sum())
    assert selected(turned).drift_against_gyroscope_deg == pytest.approx(duration_s, rel=0.1)
    pushed = dataclasses.replace(recording, accelerations=recording.accelerations * 1.01)
    felt = selected(pushed).gravity_felt
    assert np.linalg.norm(felt) == pytest.approx(9.81 * 1.01, rel=5e-3)


def test_biases_are_those_of_their_time_or_their_mean(recording: SensorRecording) -> None:
    """A bias that rises with time is removed by interpolation, and its mean by the mean."""
    truth = recording.groundtruth
    assert truth.gyroscope_biases is not None
    rise = 0.2  # rad/s per second
    seconds = (truth.stamps - truth.stamps[0]) / 1e9
    sampled = (recording.imu_stamps - truth.stamps[0]) / 1e9
    axis = np.array([0.0, 0.0, rise])
    drifting = dataclasses.replace(
        recording,
        angular_velocities=recording.angular_velocities + np.outer(sampled, axis),
        groundtruth=dataclasses.replace(
            truth, gyroscope_biases=truth.gyroscope_biases + np.outer(seconds, axis)
        ),
    )
    plain, found = selected(recording), selected(drifting)
    np.testing.assert_allclose(
        found.preintegrated.rotations, plain.preintegrated.rotations, atol=1e-6
    )
    assert found.bias_noise is None
    assert found.truth.biases.shape == (len(found.truth.positions), 0)
    mean = selected(drifting, bias_noise=BIAS_NOISE)
    assert mean.bias_noise == BIAS_NOISE
    assert mean.truth.biases.shape == (len(found.truth.positions), 6)
    # The mean is over the keyframes' time, of which the last image may not be a part.
    middle = seconds[: 3 * (len(mean.truth.positions) - 1)].mean()
    centres = 0.15 * (np.arange(len(mean.truth.positions) - 1) + 0.5)
    off = so3.log(np.swapaxes(plain.preintegrated.rotations, 1, 2) @ mean.preintegrated.rotations)
    np.testing.assert_allclose(off[:, 2], 0.15 * rise * (centres - middle), atol=3e-4)


@pytest.mark.parametrize(("removed", "is_read"), [(19, True), (20, False)])
def test_a_gap_of_the_imu_is_refused(
    removed: int, is_read: bool, recording: SensorRecording
) -> None:
    """Samples are 5 ms apart, and a gap may last 0.1 s."""
    kept = np.ones(len(recording.imu_stamps), dtype=bool)
    kept[100 : 100 + removed] = False
    part = with_samples(recording, kept)
    if is_read:
        assert selected(part).preintegrated.durations_s == pytest.approx(np.full(15, 0.15))
        return
    said = rf"IMU gap of 0\.1\d s after {recording.imu_stamps[99]} ns; choose another part"
    with pytest.raises(InputError, match=said):
        selected(part)


def test_landmarks_are_where_their_rays_meet(recording: SensorRecording) -> None:
    found = selected(recording).with_noise(TRACKER_NOISE_PX)
    state = triangulated(found)
    assert state.positions is found.truth.positions
    errors = found.problem().residuals(state)[0] * TRACKER_NOISE_PX
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(PIXEL_NOISE, rel=0.1)
    angles = _parallax(found, state)
    centres = state.positions + state.rotations @ found.lever_arm
    for landmark in range(0, found.landmarks, 17):
        rays = (
            state.landmarks[landmark] - centres[found.keyframe_of[found.landmark_of == landmark]]
        )
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        widest = np.arccos(np.clip((rays @ rays.T).min(), -1.0, 1.0))
        assert angles[landmark] == pytest.approx(widest, abs=1e-7)
    # Good: within the limit, from 0.2 to 30 m, and with 1 degree of parallax.
    squares = np.square(errors / TRACKER_NOISE_PX).sum(axis=1)
    depths = found.problem().points(state)[:, 2]
    wide = np.degrees(angles) > 1.0
    expected = (squares <= CHI2_LIMIT) & (depths > 0.2) & (depths < 30.0) & wide[found.landmark_of]
    np.testing.assert_array_equal(_is_good(found, state, CHI2_LIMIT), expected)
    small = float(np.median(squares))
    assert np.count_nonzero(_is_good(found, state, small)) <= len(squares) / 2 + 1
    near = dataclasses.replace(state, landmarks=centres[0] + (state.landmarks - centres[0]) * 5.0)
    too_far = found.problem().points(near)[:, 2] >= 30.0
    assert too_far.any()
    assert not _is_good(found, near, np.inf)[too_far].any()


def test_planted_outliers_are_dropped_and_nothing_else(recording: SensorRecording) -> None:
    clean = reject_outliers(selected(recording))
    first = clean.rounds[0]
    assert clean.rounds[-1][1] == first[1]
    assert clean.within_3px == 1.0
    assert clean.median_px == pytest.approx(PIXEL_NOISE * 1.18, rel=0.25)
    assert clean.selection.camera.noise_px == PIXEL_NOISE
    wrong = dataclasses.replace(recording, pixels=recording.pixels.copy())
    rows = np.flatnonzero(recording.image_of % 3 == 0)[::40]
    wrong.pixels[rows] += [25.0, -10.0]
    found = reject_outliers(selected(wrong))
    assert found.rounds[0] == first
    assert first[0] - len(rows) - 5 <= found.rounds[-1][0] <= first[0] - len(rows)
    assert found.rounds[-1] == found.rounds[-2]
    # They also move their landmarks, by which other errors grow.
    assert 1.0 - 6 * len(rows) / first[0] < found.within_3px <= 1.0 - len(rows) / first[0]
    np.testing.assert_allclose(found.state.positions, clean.state.positions, atol=2e-3)
    # Smaller errors pass the first, coarse test, and are dropped until none are left.
    wrong.pixels[rows] += [-20.0, 6.0]
    slow = reject_outliers(selected(wrong))
    assert slow.rounds[1][0] > first[0] - len(rows)
    assert slow.rounds[-1] == slow.rounds[-2] < slow.rounds[1]
    assert slow.rounds[-1][0] > first[0] - 3 * len(rows)
    judged = slow.selection.with_noise(TRACKER_NOISE_PX)
    assert _is_good(judged, slow.state, 1.01 * CHI2_LIMIT).all()
    few = dataclasses.replace(recording, pixels=recording.pixels.copy())
    few.pixels[recording.track_of >= 49] += np.random.default_rng(0).uniform(
        50.0, 90.0, (int(np.count_nonzero(recording.track_of >= 49)), 2)
    )
    with pytest.raises(InputError, match=r"only \d+ of 150 tracks have three keyframes"):
        reject_outliers(selected(few))


@pytest.mark.parametrize("bias_noise", [None, BIAS_NOISE])
def test_redundancies_by_the_hat_matrix(
    bias_noise: BiasNoise | None, recording: SensorRecording
) -> None:
    """Of all residuals, with their Jacobian by differences."""
    whole = selected(recording, most=4, bias_noise=bias_noise)
    few, _ = whole.kept(whole.landmark_of < 15)
    problem, state = few.problem(), triangulated(few)

    def residuals(step: np.ndarray) -> list[np.ndarray]:
        moved = state.moved(step)
        inertial = problem.inertial(moved)[0]
        biases = np.concatenate([inertial[:, 9:].ravel(), problem.first_biases(moved)[0].ravel()])
        kinds = [inertial[:, begin : begin + 3].ravel() for begin in (0, 3, 6)]
        return [problem.residuals(moved)[0].ravel(), *kinds, biases]

    size = problem.width * problem.keyframes + 3 * problem.landmarks
    columns = [
        (np.concatenate(residuals(step)) - np.concatenate(residuals(-step))) / 2e-6
        for step in 1e-6 * np.eye(size)
    ]
    basis, singular, _ = np.linalg.svd(np.stack(columns, axis=1), full_matrices=False)
    used = np.square(basis[:, : size - 4]).sum(axis=1)  # four directions are undetermined
    assert singular[size - 4] < 1e-4 * singular[size - 5]
    parts = residuals(np.zeros(size))
    ends = np.cumsum([len(part) for part in parts])
    groups = residual_groups(problem, state)
    assert [group.name for group in groups] == [
        "pixels", "IMU rotation", "IMU velocity", "IMU position", "IMU biases",
    ][: len(groups)]  # fmt: skip
    assert len(groups) == (4 if bias_noise is None else 5)
    for group, part, share in zip(groups, parts, np.split(used, ends), strict=False):
        assert group.count == len(part)
        assert group.chi2 == pytest.approx(part @ part, rel=1e-9)
        assert group.redundancy == pytest.approx(len(part) - share.sum(), abs=1e-3)
        assert group.ratio == group.chi2 / group.redundancy


def test_correlation_along_tracks_by_its_definition(recording: SensorRecording) -> None:
    found = selected(recording)
    problem, state = found.problem(), triangulated(found)
    errors = problem.residuals(state)[0]
    at = {
        (int(keyframe), int(landmark)): error
        for keyframe, landmark, error in zip(
            problem.visibility.keyframe_of, problem.visibility.landmark_of, errors, strict=True
        )
    }
    expected = []
    for lag in (1, 4):
        pairs = [(error, at[key[0] + lag, key[1]]) for key, error in at.items()
                 if (key[0] + lag, key[1]) in at]  # fmt: skip
        one, other = (np.array(each) for each in zip(*pairs, strict=True))
        expected.append(np.vdot(one, other) / np.linalg.norm(one) / np.linalg.norm(other))
    np.testing.assert_allclose(track_correlation(problem, state, (1, 4)), expected, rtol=1e-9)
    assert np.isnan(track_correlation(problem, state, (problem.keyframes,))).all()


@pytest.mark.parametrize("landmarks", [39, 40])
def test_halves_of_landmarks_have_at_least_twenty(
    landmarks: int, recording: SensorRecording
) -> None:
    whole = selected(recording)
    few, _ = whole.kept(whole.landmark_of < landmarks)
    assert few.landmarks == landmarks
    generator = np.random.default_rng(1)
    if landmarks < 40:
        with pytest.raises(InputError, match=r"39 landmarks are too few .* at least 40 are"):
            split_half_nees(few, triangulated(few), 1, generator)
        return
    (nees,) = split_half_nees(few, triangulated(few), 1, generator)
    assert 0.5 < nees < 2.0


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
