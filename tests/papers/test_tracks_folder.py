"""Folders of feature tracks: formats that are read, and what is refused in one sentence."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tracks_folders import (
    ACCELEROMETER_BIAS,
    GYROSCOPE_BIAS,
    LENSES,
    LEVER_ARM,
    PIXEL_NOISE,
    write_tracks_folder,
)

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.inertial import GRAVITY, ImuNoise
from trajeval_ros.papers.examination import Examination, MeasurementModel, examine
from trajeval_ros.papers.gauge_trials import compare_handlings, covariances
from trajeval_ros.papers.keyframe_selection import select
from trajeval_ros.papers.sensor_recording import Lens
from trajeval_ros.papers.solver import GaugeHandling
from trajeval_ros.papers.tracks_folder import read_tracks_folder

EUROC_NOISE = ImuNoise(1.7e-4, 2e-3)


def _examined(folder: Path, **changes: object) -> Examination:
    model = MeasurementModel(3, 30, PIXEL_NOISE, EUROC_NOISE, 9.81)
    return examine(read_tracks_folder(folder), MeasurementModel(**{**vars(model), **changes}))


@pytest.fixture
def folder(tmp_path: Path, tracks_flight: Path) -> Path:
    return shutil.copytree(tracks_flight, tmp_path / "flight")


def _edit(path: Path, change: Callable[[str], str]) -> None:
    path.write_text(change(path.read_text()))


def _moved(row: str, nanoseconds: int) -> str:
    stamp, rest = row.split(",", 1)
    return f"{int(stamp) + nanoseconds},{rest}"


def _plus(row: str, shift: np.ndarray) -> str:
    """Return an IMU's row with another acceleration."""
    *rest, x, y, z = row.split(",")
    forces = np.array([float(x), float(y), float(z)]) + shift
    return ",".join([*rest, *(f"{force:.12g}" for force in forces)])


def _rows(text: str, change: Callable[[str], str]) -> str:
    head, *rows = text.splitlines()
    return "\n".join([head, *(change(row) for row in rows)]) + "\n"


@pytest.mark.parametrize("name", LENSES)
def test_a_lens_and_its_inverse(name: str) -> None:
    lens = LENSES[name]
    generator = np.random.default_rng(1)
    plane = generator.uniform(-0.75, 0.75, (200, 2))
    pixels, derivative = lens.distorted(plane)
    back, there = lens.undistorted(pixels)
    np.testing.assert_allclose(back, plane, atol=1e-9)
    np.testing.assert_allclose(there, derivative, rtol=1e-6, atol=1e-6)
    step = 1e-6
    for axis in range(2):
        unit = step * np.eye(2)[axis]
        numeric = (lens.distorted(plane + unit)[0] - lens.distorted(plane - unit)[0]) / (2 * step)
        np.testing.assert_allclose(derivative[:, :, axis], numeric, atol=1e-4)


def test_lenses_by_their_definitions() -> None:
    focal, centre = np.array([100.0, 200.0]), np.array([10.0, 20.0])
    plain = Lens(focal, centre, "radial-tangential", np.zeros(4))
    np.testing.assert_allclose(plain.distorted(np.array([[0.5, -0.5]]))[0], [[60.0, -80.0]])
    # x (1 + k1 r^2 + k2 r^4) + 2 p1 x y + p2 (r^2 + 2 x^2), with x = .3, y = .4.
    bent = Lens(focal, centre, "radial-tangential", np.array([0.1, 0.2, 0.01, 0.02]))
    x = 0.3 * (1 + 0.025 + 0.0125) + 0.0024 + 0.02 * 0.43
    y = 0.4 * (1 + 0.025 + 0.0125) + 0.01 * 0.57 + 2 * 0.02 * 0.12
    expected = [[10.0 + 100.0 * x, 20.0 + 200.0 * y]]
    np.testing.assert_allclose(bent.distorted(np.array([[0.3, 0.4]]))[0], expected)
    # The distance from the centre is f theta (1 + k1 theta^2 + ...), here at 45 degrees.
    fish = Lens(focal, centre, "equidistant", np.array([0.1, 0.2, 0.3, 0.4]))
    angle = np.pi / 4
    powers = angle ** np.array([2, 4, 6, 8])
    distance = angle * (1 + powers @ [0.1, 0.2, 0.3, 0.4])
    result = fish.distorted(np.array([[1.0, 0.0], [0.0, 0.0]]))[0]
    np.testing.assert_allclose(result, [[10.0 + 100.0 * distance, 20.0], [10.0, 20.0]], atol=1e-9)


def test_pixels_beyond_the_lens_are_not_inverted() -> None:
    # Without k2, nothing is farther from the centre than 0.7274 focal lengths.
    lens = Lens(np.full(2, 400.0), np.zeros(2), "radial-tangential", np.array([-0.28, 0, 0, 0]))
    plane, _ = lens.undistorted(np.array([[290.0, 0.0], [292.0, 0.0]]))
    assert np.isfinite(plane[0]).all()
    assert np.isnan(plane[1]).all()


@pytest.mark.parametrize("distortion", LENSES)
def test_a_simulated_flight_is_estimated_as_well_as_its_noise_allows(
    tmp_path: Path, distortion: str
) -> None:
    folder = write_tracks_folder(tmp_path / "flight", distortion)
    examined = _examined(folder)
    recording = read_tracks_folder(folder)
    np.testing.assert_allclose(recording.camera.lever_arm, LEVER_ARM)
    assert recording.groundtruth.gyroscope_biases is not None
    np.testing.assert_allclose(recording.groundtruth.gyroscope_biases[0], GYROSCOPE_BIAS)
    assert recording.groundtruth.accelerometer_biases is not None
    np.testing.assert_allclose(recording.groundtruth.accelerometer_biases[0], ACCELEROMETER_BIAS)
    assert examined.notes == ()
    np.testing.assert_allclose(examined.gravity, [0.0, 0.0, -9.81], atol=0.02)
    assert examined.rejection.rounds[-1][1] == 150
    errors = compare_handlings(examined.scene, 2, lambda: None)
    assert errors[GaugeHandling.FREE].position_m.mean() < 2e-3
    assert covariances(examined.scene, 0, is_converged=True).difference < 1e-8


@pytest.mark.slow
def test_keyframes_between_samples_are_estimated_as_well(folder: Path) -> None:
    """Steps of their own lead from a keyframe to the IMU's next sample."""
    aligned = _examined(folder)
    # The same motion, sampled by an IMU whose clock ticks 1.9 ms later.
    rows = [row.split(",") for row in (folder / "imu.csv").read_text().splitlines()[1:]]
    stamps = np.array([int(row[0]) for row in rows])
    values = np.array([[float(word) for word in row[1:]] for row in rows])
    # Before its first sample there is an image, which goes.
    between = stamps[:-1] + 1_900_000
    share = 1_900_000 / 5_000_000
    shifted = (1.0 - share) * values[:-1] + share * values[1:]
    lines = [
        ",".join([str(stamp), *(f"{value:.12g}" for value in row)])
        for stamp, row in zip(between, shifted, strict=True)
    ]
    (folder / "imu.csv").write_text("#stamp,w,w,w,a,a,a\n" + "\n".join(lines) + "\n")
    uneven = _examined(folder, every=1, keyframes=46)
    assert "images outside the time span of IMU or groundtruth, dropped: 1" in uneven.notes
    np.testing.assert_allclose(uneven.gravity, aligned.gravity, atol=0.02)
    assert (
        compare_handlings(uneven.scene, 1, lambda: None)[GaugeHandling.FREE].position_m[0] < 2e-3
    )


def test_eurocs_own_layout(tmp_path: Path, folder: Path) -> None:
    euroc = tmp_path / "V1_01_easy" / "mav0"
    for name, place in (
        ("imu.csv", "imu0/data.csv"),
        ("groundtruth.csv", "state_groundtruth_estimate0/data.csv"),
        ("tracks.csv", "cam0/tracks.csv"),
        ("camera.yaml", "cam0/sensor.yaml"),
    ):
        (euroc / place).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).rename(euroc / place)
    head = "%YAML:1.0\n#General sensor definitions.\nsensor_type: camera\n"
    _edit(euroc / "cam0" / "sensor.yaml", lambda text: head + text)
    recording = read_tracks_folder(euroc.parent)
    assert recording.name == "V1_01_easy"
    assert len(recording.image_stamps) == 47


def test_stamps_that_differ_by_nanoseconds_are_joined(folder: Path) -> None:
    plain = _examined(folder)
    _edit(folder / "tracks.csv", lambda text: _rows(text, lambda row: _moved(row, 200)))
    moved = _examined(folder)
    assert moved.notes == ("keyframes with timestamps less than 1 us from the groundtruth: 16",)
    head, first, *rows = (folder / "tracks.csv").read_text().splitlines()
    text = "\n".join([head, _moved(first, -256), *rows]) + "\n"
    (folder / "tracks.csv").write_text(text)
    joined = _examined(folder)
    assert joined.notes[0].endswith("merged into one image: 1")
    for item in (moved, joined):
        assert item.rejection.rounds == plain.rejection.rounds


def test_velocity_and_biases_that_are_missing_are_said(folder: Path) -> None:
    def without(columns: int) -> Callable[[str], str]:
        return lambda text: "\n".join(
            ",".join(row.split(",")[:columns]) for row in text.splitlines()
        )

    _edit(folder / "groundtruth.csv", without(8))
    recording = read_tracks_folder(folder)
    assert recording.groundtruth.velocities is not None
    speeds = np.linalg.norm(recording.groundtruth.velocities[1:-1], axis=1)
    assert 1.5 < speeds.min() < speeds.max() < 2.5
    assert recording.notes == (
        "no velocity in groundtruth: positions differentiated",
        "no biases of both sensors in groundtruth: IMU used without correction",
    )
    # An accelerometer's bias of 0.23 m/s^2 shows in gravity, a gyroscope's in the attitude.
    with pytest.raises(InputError, match="check the expected value, biases"):
        _examined(folder)
    _edit(
        folder / "imu.csv",
        lambda text: _rows(text, lambda row: _plus(row, -ACCELEROMETER_BIAS)),
    )
    with pytest.raises(InputError, match="check the gyroscope's biases"):
        _examined(folder)


def test_what_the_lens_cannot_show_is_left_out_and_counted(folder: Path) -> None:
    _replaced("camera.yaml", "-0.28, 0.07", "-0.28, 0.0")(folder)
    whole = select(read_tracks_folder(folder), 3, 30, PIXEL_NOISE, EUROC_NOISE, GRAVITY)
    (note,) = whole.notes
    assert re.fullmatch(
        r"observations without invertible distortion, dropped: \d+ of 2\d\d\d", note
    )
    assert np.isfinite(whole.pixels).all()


def _without(path: str, line: str) -> Callable[[Path], None]:
    return lambda folder: _edit(
        folder / path,
        lambda text: "".join(item for item in text.splitlines(True) if line not in item),
    )


def _replaced(path: str, pattern: str, by: str) -> Callable[[Path], None]:
    return lambda folder: _edit(folder / path, lambda text: re.sub(pattern, by, text, count=1))


def _later(path: str, nanoseconds: int) -> Callable[[Path], None]:
    return lambda folder: _edit(
        folder / path, lambda text: _rows(text, lambda row: _moved(row, nanoseconds))
    )


def _thinned(folder: Path) -> None:
    """Keep every tenth track."""
    _edit(
        folder / "tracks.csv",
        lambda text: "\n".join(
            row for row in text.splitlines() if row[0] == "#" or int(row.split(",")[1]) % 10 == 0
        ),
    )


def _silent(folder: Path) -> None:
    """Remove a fifth of a second of the IMU."""
    head, *rows = (folder / "imu.csv").read_text().splitlines()
    (folder / "imu.csv").write_text("\n".join([head, *rows[:100], *rows[140:]]) + "\n")


def _copied(folder: Path) -> None:
    (folder / "imu_2.csv").write_text((folder / "imu.csv").read_text())


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda folder: (folder / "imu.csv").unlink(), "has no file of IMU samples"),
        (_copied, "has more than one file of IMU samples"),
        (_without("camera.yaml", "T_BS"), "has no T_BS"),
        (_replaced("camera.yaml", r"T_BS: \[[^,]*, ", "T_BS: ["), "T_BS must be 16 numbers"),
        (_replaced("camera.yaml", "radial-tangential", "fov"), "distortion_model 'fov' is not"),
        (_replaced("camera.yaml", "radial-tangential", "[fov]"), r"distortion_model \['fov'\] is"),
        (_replaced("camera.yaml", "pinhole", "omni"), "camera_model 'omni'"),
        (
            _replaced("camera.yaml", r"intrinsics: \[[^,]*", f"intrinsics: [{10**400}"),
            "64 bits",
        ),
        (_without("camera.yaml", "resolution"), "resolution must be 2 numbers"),
        (_replaced("tracks.csv", r"\n(\d+),0,", r"\n\1,1,"), "track 1 is 2 times in the image"),
        (_replaced("tracks.csv", r"\n(\d+),0,", r"\n\1,0.5,"), "must be whole numbers"),
        (_replaced("tracks.csv", r",0,[^,\n]*", ",0,nan"), "row 1 is not finite"),
        (_replaced("imu.csv", r"\n(\d+),[^,]*,", r"\n\1,"), "7 columns expected, found 6"),
        (_later("tracks.csv", 2_500_000), "have no groundtruth: at"),
        (_later("imu.csv", 3_600_000_000_000), "0 of 47 images are within the time span of IMU"),
        (_silent, "IMU gap of 0.20 s"),
        (_thinned, "only 15 of 15 tracks"),
    ],
)
def test_what_cannot_be_used_is_refused(
    folder: Path, spoil: Callable[[Path], object], message: str
) -> None:
    spoil(folder)
    with pytest.raises(InputError, match=message) as refusal:
        _examined(folder)
    assert "\n" not in str(refusal.value)
