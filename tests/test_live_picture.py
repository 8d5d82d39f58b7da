"""The picture of a live run in segments: what is drawn is the segment that is evaluated."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from ros_bags import ODOM, POSE, Message, messages_of
from test_live_run import ESTIMATE, TRUTH, Live
from waiting import PATIENCE_S

from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.io.live.pair_file import read_pairs
from trajeval_ros.online.reports import Update
from trajeval_ros.online.state_rows import states
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.rerun_output import RerunOutput
from trajeval_ros.ros.segmentation import Segmentation
from trajeval_ros.viewer.live_scene import LiveScene
from trajeval_ros.visual_inertial.drifting_odometry import simulate

pytest.importorskip("rerun.chunk", reason="rerun-sdk is missing, the extra `rerun`")

import rerun
from rrd import Rrd

FRAME, GROUNDTRUTH = "world/estimate/vio", "world/groundtruth"
LOOP_S = 26.0
BATCH = 40  # messages that arrive together


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the picture as long to end as it takes on a machine that is busy."""
    monkeypatch.setattr("trajeval_ros.viewer.stream._PATIENCE_S", PATIENCE_S)


def loop(seed: int, until_s: float = LOOP_S) -> tuple[Trajectory, Trajectory]:
    """Return groundtruth and estimate of a flight's beginning; all flights have one start."""
    flight = simulate(seed, LOOP_S)
    truth, estimate = flight.groundtruth[::10], flight.estimate
    covariances = np.tile(0.01 * np.eye(6), (len(estimate), 1, 1))
    estimate = dataclasses.replace(estimate, covariances=covariances)
    end = truth.stamps[0] + round(until_s * NANOSECONDS)
    return truth[truth.stamps <= end], estimate[estimate.stamps <= end]


def feed_of(truth: Trajectory, estimate: Trajectory) -> list[Message]:
    both = [*messages_of(truth, TRUTH, POSE), *messages_of(estimate, ESTIMATE, ODOM)]
    return sorted(both, key=lambda each: each[2])


def drawn(
    folder: Path, feed: Sequence[Message], segmentation: Segmentation | None = None
) -> tuple[Rrd, list[float]]:
    """Draw a live run; return its picture and the published position errors."""
    live = Live(folder, ODOM, segmentation=segmentation)
    picture, published = RerunOutput("file", live.run, Gauge.YAW), []

    def publish(estimate: LiveEstimate, update: Update) -> None:
        picture.update(estimate, update)
        if update.position_m is not None:
            published.append(update.position_m)

    live.watch = publish
    for begin in range(0, len(feed), BATCH):
        live.feed(feed[begin : begin + BATCH])
        for estimate in live.run.estimates:
            picture.snapshot(estimate, estimate.snapshot(), None)
    assert picture.close() == []
    assert picture.dropped == 0
    live.end()
    return Rrd(folder / "run.rrd"), published


def test_a_loop_of_a_bag_is_drawn_as_it_is_evaluated(tmp_path: Path) -> None:
    first, second = loop(4), loop(5, 0.6 * LOOP_S)
    picture, published = drawn(tmp_path / "live", feed_of(*first) + feed_of(*second))
    pairs = read_pairs(tmp_path / "live" / "vio.2.pairs")
    # The newest time of the picture, which a viewer follows, shows the second loop alone.
    for entity, wanted in ((GROUNDTRUTH, second[0].positions), (FRAME, pairs.estimate[:, :3])):
        stamps, poses = picture.rows(f"{entity}/pose", "Transform3D:translation")
        np.testing.assert_allclose(poses[-1][0], wanted[-1], atol=1e-5)
        path = np.concatenate(picture.path(entity, int(stamps[-1])))
        distances = np.linalg.norm(path[:, None] - wanted, axis=2)
        assert distances.min(axis=1).max() < 1e-5
        assert distances.min(axis=0).max() < 0.6
    _, coloured = picture.strips(f"{FRAME}/by_error")
    points = np.concatenate(coloured[-1])
    distances = np.linalg.norm(points[:, None] - pairs.estimate[None, :, :3], axis=2)
    assert distances.min(axis=1).max() < 1e-5  # nothing of the first loop
    assert distances.min(axis=0).max() < 0.6  # all of the second
    _, values = picture.numbers("metrics/position_error/vio")
    assert values.tolist() == published
    # Earlier times show the first loop.
    path = np.concatenate(picture.path(GROUNDTRUTH, int(first[0].stamps[-1])))
    distances = np.linalg.norm(path[:, None] - first[0].positions, axis=2).min(axis=1)
    assert distances.max() < 1e-5


def test_times_of_a_second_loop_are_stated(tmp_path: Path) -> None:
    first, second = loop(4), loop(5, 0.6 * LOOP_S)
    picture, _ = drawn(tmp_path / "live", feed_of(*first) + feed_of(*second))
    _, texts = picture.rows("events", "TextLog:text")
    [said] = [each for (each,) in texts if "stepped back" in each]
    shift_s = int(said.split("timestamps + ")[1].split(" s")[0])
    stamps, _ = picture.rows(f"{GROUNDTRUTH}/pose", "Transform3D:translation")
    assert stamps[-1] - shift_s * NANOSECONDS == second[0].stamps[-1]
    assert (np.diff(stamps) > 0).all()
    assert np.diff(stamps).max() < 3 * NANOSECONDS
    # All of the estimate has the same times.
    for entity, component in (
        (f"{FRAME}/pose", "Transform3D:translation"),
        (f"{FRAME}/covariance", "Ellipsoids3D:half_sizes"),
        (f"{FRAME}/by_error", "LineStrips3D:strips"),
        (FRAME, "Transform3D:translation"),
        ("metrics/position_error/vio", "Scalars:scalars"),
        ("metrics/ate_position/vio", "Scalars:scalars"),
        ("metrics/relative_error/vio/4m", "Scalars:scalars"),
        ("events", "TextLog:text"),
    ):
        times, _ = picture.rows(entity, component)
        seconds = (stamps[-1] - times) / NANOSECONDS
        assert seconds.min() > -0.1  # the newest covariance may be ahead of the groundtruth
        assert np.count_nonzero(seconds < 0.6 * LOOP_S) > 1
        assert np.count_nonzero(seconds > 0.6 * LOOP_S) > 1


def test_jumps_and_late_pairs_of_a_previous_segment(tmp_path: Path) -> None:
    scene = LiveScene("drive", ["vio"], Gauge.YAW)
    recording = rerun.RecordingStream("trajeval", recording_id="late")
    recording.save(tmp_path / "late.rrd")
    scene.begin(recording)
    stamps = 10**18 + np.arange(50) * NANOSECONDS // 10
    rows = states(np.outer(np.arange(50.0), [0.1, 0.0, 0.0]))
    for epoch in range(2):
        scene.groundtruth(stamps, rows, epoch=epoch)
        scene.pairs("vio", stamps, rows, rows, (epoch, 1 + epoch))
    late = stamps[-1:] + NANOSECONDS
    scene.pairs("vio", late, rows[:1] + 7.0, rows[:1] + 7.0, (0, 1))
    scene.event("vio", int(stamps[-1]), "vio jumps")
    scene.leave()
    recording.flush()
    del recording
    picture = Rrd(tmp_path / "late.rrd")
    times, _ = picture.rows(f"{FRAME}/pose", "Transform3D:translation")
    assert len(times) == 2
    np.testing.assert_allclose(np.concatenate(picture.path(FRAME, times[-1])).max(), 4.9)
    said, texts = picture.rows("events", "TextLog:text")
    assert said[-1] == times[-1]
    assert "vio jumps" in texts[-1][0]


def test_a_restart_of_the_estimator_is_drawn_as_it_is_evaluated(tmp_path: Path) -> None:
    truth, estimate = loop(4)
    row = len(estimate) // 2
    moved = estimate.positions.copy()
    moved[row:] += [30.0, -20.0, 10.0]
    feed = feed_of(truth, dataclasses.replace(estimate, positions=moved))
    restarts = Segmentation(on_restart="segment")
    picture, _ = drawn(tmp_path / "live", feed, restarts)
    _, coloured = picture.strips(f"{FRAME}/by_error")
    points = np.concatenate(coloured[-1])
    distances = np.linalg.norm(points[:, None] - moved[None, row:], axis=2).min(axis=1)
    assert distances.max() < 1e-5
    assert [] in coloured  # the colours of the first segment disappear at once
    # Times did not step back, so timestamps are drawn as they are.
    stamps, _ = picture.rows(f"{FRAME}/pose", "Transform3D:translation")
    assert stamps[-1] in estimate.stamps
