"""Keyframes, observations, landmarks and outliers of recorded tracks, by their definitions."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from tracks_folders import PIXEL_NOISE

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie, so3
from trajeval_ros.geometry.inertial import GRAVITY, ImuNoise
from trajeval_ros.papers.examination import (
    CHI2_LIMIT,
    TRACKER_NOISE_PX,
    _is_good,
    _parallax,
    reject_outliers,
    triangulated,
)
from trajeval_ros.papers.keyframe_selection import KeyframeSelection, select
from trajeval_ros.papers.sensor_recording import SAME_INSTANT_NS, SensorRecording
from trajeval_ros.papers.tracks_folder import read_tracks_folder

IMU_NOISE = ImuNoise(1.7e-4, 2e-3)


@pytest.fixture(scope="module")
def recording(tracks_flight: Path) -> SensorRecording:
    return read_tracks_folder(tracks_flight)


def selected(recording: SensorRecording, every: int = 3, most: int = 30) -> KeyframeSelection:
    return select(recording, every, most, PIXEL_NOISE, IMU_NOISE, GRAVITY)


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
    assert len(whole.groundtruth.positions) == -(-count // 3)
    np.testing.assert_array_equal(whole.groundtruth.positions, truth.positions[::3])
    np.testing.assert_array_equal(whole.groundtruth.velocities, truth.velocities[::3])
    np.testing.assert_array_equal(
        whole.groundtruth.rotations, lie.to_matrix(truth.quaternions[::3])
    )
    assert whole.notes == ()
    few = selected(recording, most=5)
    np.testing.assert_array_equal(few.groundtruth.positions, truth.positions[:15:3])
    # An IMU that starts a microsecond after image 4 covers it, and one nanosecond later does not.
    stamps = recording.imu_stamps
    for late_ns, first in ((SAME_INSTANT_NS, 4), (SAME_INSTANT_NS + 1, 5)):
        moved = stamps[stamps >= recording.image_stamps[4]].copy()
        moved[0] += late_ns
        part = selected(with_samples(recording, stamps >= recording.image_stamps[4], moved), 3, 5)
        np.testing.assert_array_equal(
            part.groundtruth.positions, truth.positions[first : first + 15 : 3]
        )
        assert part.notes == (
            f"images outside the time span of IMU or groundtruth, dropped: {first}",
        )
    for early_ns, last in ((SAME_INSTANT_NS, 40), (SAME_INSTANT_NS + 1, 39)):
        kept = stamps <= recording.image_stamps[40]
        moved = stamps[kept].copy()
        moved[-1] -= early_ns
        part = selected(with_samples(recording, kept, moved), 1, 100)
        np.testing.assert_array_equal(part.groundtruth.positions, truth.positions[: last + 1])
        assert part.notes[-1].endswith(f"dropped: {count - 1 - last}")
    assert len(selected(recording, every=20).groundtruth.positions) == 3
    with pytest.raises(InputError, match=r"only 2 keyframes \(47 of 47 images .*, one in 24"):
        selected(recording, every=24)


def test_observations_are_those_of_tracks_in_three_keyframes(recording: SensorRecording) -> None:
    result = selected(recording)
    frames = np.arange(0, len(recording.image_stamps), 3)
    seen: dict[int, list[tuple[int, int]]] = {}
    for row, (image, track) in enumerate(zip(recording.image_of, recording.track_of, strict=True)):
        if image in frames:
            seen.setdefault(int(track), []).append((int(image) // 3, row))
    long = {track: rows for track, rows in seen.items() if len(rows) >= 3}
    assert result.landmarks == len(long) < len(seen) or len(long) == len(seen)
    expected = {
        (keyframe, place): row
        for place, track in enumerate(sorted(long))
        for keyframe, row in long[track]
    }
    pairs = list(zip(result.keyframe_of.tolist(), result.landmark_of.tolist(), strict=True))
    assert set(pairs) == expected.keys()
    measured = recording.pixels[[expected[pair] for pair in pairs]]
    lens = recording.camera.lens
    plane = (result.pixels - result.camera.centre) / result.camera.focal_px
    again, derivative = lens.distorted(plane)
    np.testing.assert_allclose(again, measured, atol=1e-5)
    np.testing.assert_allclose(result.weights, derivative / result.camera.focal_px, rtol=1e-6)
    assert result.camera.focal_px == pytest.approx(np.sqrt(458.0 * 457.0))
    assert result.camera.noise_px == PIXEL_NOISE
    assert result.with_noise(0.7).camera.noise_px == 0.7


def test_kept_observations_leave_landmarks_with_three_views(recording: SensorRecording) -> None:
    result = selected(recording)
    views = np.bincount(result.landmark_of)
    lost = int(np.flatnonzero(views == 3)[0]) if (views == 3).any() else int(views.argmin())
    expected = np.ones(len(result.pixels), dtype=bool)
    rows = np.flatnonzero(result.landmark_of == lost)
    expected[rows[: len(rows) - 2]] = False  # two views of it are left
    part, left = result.kept(expected)
    assert left.tolist() == [index for index in range(result.landmarks) if index != lost]
    assert part.landmarks == result.landmarks - 1
    others = result.landmark_of != lost
    np.testing.assert_array_equal(part.pixels, result.pixels[others])
    np.testing.assert_array_equal(part.weights, result.weights[others])
    np.testing.assert_array_equal(part.keyframe_of, result.keyframe_of[others])
    np.testing.assert_array_equal(left[part.landmark_of], result.landmark_of[others])


def test_the_imu_between_keyframes_agrees_with_groundtruth(recording: SensorRecording) -> None:
    result = selected(recording)
    assert result.preintegrated.durations_s == pytest.approx(
        np.full(len(result.groundtruth.positions) - 1, 0.15)
    )
    rotations = (
        np.swapaxes(result.groundtruth.rotations[:-1], 1, 2) @ result.groundtruth.rotations[1:]
    )
    off = so3.log(np.swapaxes(rotations, 1, 2) @ result.preintegrated.rotations)
    assert np.abs(off).max() < 1e-3
    np.testing.assert_allclose(result.gravity_felt, GRAVITY, atol=0.02)
    assert result.drift_against_gyroscope_deg < 0.1
    rotated = dataclasses.replace(
        recording,
        angular_velocities=recording.angular_velocities + np.array([0.0, 0.0, np.radians(1.0)]),
    )
    duration_s = float(result.preintegrated.durations_s.sum())
    assert selected(rotated).drift_against_gyroscope_deg == pytest.approx(duration_s, rel=0.1)
    pushed = dataclasses.replace(recording, accelerations=recording.accelerations * 1.01)
    felt = selected(pushed).gravity_felt
    assert np.linalg.norm(felt) == pytest.approx(9.81 * 1.01, rel=5e-3)


def test_biases_are_those_of_their_time(recording: SensorRecording) -> None:
    """A bias that rises with time is removed by interpolation."""
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
    plain, result = selected(recording), selected(drifting)
    np.testing.assert_allclose(
        result.preintegrated.rotations, plain.preintegrated.rotations, atol=1e-6
    )


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
    text = rf"IMU gap of 0\.1\d s after {recording.imu_stamps[99]} ns; choose another part"
    with pytest.raises(InputError, match=text):
        selected(part)


def test_landmarks_are_where_their_rays_meet(recording: SensorRecording) -> None:
    result = selected(recording).with_noise(TRACKER_NOISE_PX)
    state = triangulated(result)
    assert state.positions is result.groundtruth.positions
    errors = result.problem().residuals(state)[0] * TRACKER_NOISE_PX
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(PIXEL_NOISE, rel=0.1)
    angles = _parallax(result, state)
    centres = state.positions + state.rotations @ result.lever_arm
    for landmark in range(0, result.landmarks, 17):
        rays = (
            state.landmarks[landmark] - centres[result.keyframe_of[result.landmark_of == landmark]]
        )
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        widest = np.arccos(np.clip((rays @ rays.T).min(), -1.0, 1.0))
        assert angles[landmark] == pytest.approx(widest, abs=1e-7)
    # Good: within the limit, from 0.2 to 30 m, and with 1 degree of parallax.
    squares = np.square(errors / TRACKER_NOISE_PX).sum(axis=1)
    depths = result.problem().points(state)[:, 2]
    wide = np.degrees(angles) > 1.0
    expected = (
        (squares <= CHI2_LIMIT) & (depths > 0.2) & (depths < 30.0) & wide[result.landmark_of]
    )
    np.testing.assert_array_equal(_is_good(result, state, CHI2_LIMIT), expected)
    small = float(np.median(squares))
    assert np.count_nonzero(_is_good(result, state, small)) <= len(squares) / 2 + 1
    near = dataclasses.replace(state, landmarks=centres[0] + (state.landmarks - centres[0]) * 5.0)
    too_far = result.problem().points(near)[:, 2] >= 30.0
    assert too_far.any()
    assert not _is_good(result, near, np.inf)[too_far].any()


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
    result = reject_outliers(selected(wrong))
    assert result.rounds[0] == first
    assert first[0] - len(rows) - 5 <= result.rounds[-1][0] <= first[0] - len(rows)
    assert result.rounds[-1] == result.rounds[-2]
    # They also move their landmarks, by which other errors grow.
    assert 1.0 - 6 * len(rows) / first[0] < result.within_3px <= 1.0 - len(rows) / first[0]
    np.testing.assert_allclose(result.state.positions, clean.state.positions, atol=2e-3)
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
