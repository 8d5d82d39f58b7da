"""The picture of a live run in segments: what is drawn is the segment that is evaluated."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from live_runs import ESTIMATE, GROUNDTRUTH, Live
from recorded_runs import pairs_of
from ros_bags import ODOM, POSE, Message, messages_of
from waiting import PATIENCE_S

from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.online.reports import Update
from trajeval_ros.ros.live_estimate import LiveEstimate
from trajeval_ros.ros.live_run import LiveRun
from trajeval_ros.ros.rerun_output import RerunOutput
from trajeval_ros.simulation.drifting_odometry import simulate

pytest.importorskip("rerun.chunk", reason="rerun-sdk is missing, the extra `rerun`")

from rrd import Rrd

FRAME, GROUNDTRUTH_ENTITY = "world/estimate/vio", "world/groundtruth"
LOOP_S = 26.0
BATCH = 40  # messages that arrive together


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the picture as long to end as it takes on a machine that is busy."""
    monkeypatch.setattr("trajeval_ros.viewer.stream._PATIENCE_S", PATIENCE_S)


def loop(seed: int, until_s: float = LOOP_S) -> tuple[Trajectory, Trajectory]:
    """Return groundtruth and estimate of a flight's beginning; all flights have one start."""
    flight = simulate(seed, LOOP_S)
    groundtruth, estimate = flight.groundtruth[::10], flight.estimate
    covariances = np.tile(0.01 * np.eye(6), (len(estimate), 1, 1))
    estimate = dataclasses.replace(estimate, covariances=covariances)
    end = groundtruth.stamps[0] + round(until_s * NANOSECONDS)
    return groundtruth[groundtruth.stamps <= end], estimate[estimate.stamps <= end]


def feed_of(groundtruth: Trajectory, estimate: Trajectory) -> list[Message]:
    both = [*messages_of(groundtruth, GROUNDTRUTH, POSE), *messages_of(estimate, ESTIMATE, ODOM)]
    return sorted(both, key=lambda item: item[2])


def drawn(
    folder: Path, feed: Sequence[Message], *, at_restarts: bool = False
) -> tuple[Live, list[Rrd], list[float]]:
    """Draw live runs; return them, their pictures, and the newest run's position errors."""
    live = Live(folder, ODOM, at_restarts=at_restarts)
    pictures, published = {live.run: RerunOutput("file", live.run, Gauge.YAW)}, list[float]()

    def begin_run(ended: LiveRun, begun: LiveRun) -> None:
        pictures[begun] = RerunOutput("file", begun, Gauge.YAW, pictures[ended])
        published.clear()

    def close(run: LiveRun, troubles: list[str]) -> None:
        assert troubles == []
        pictures.pop(run).end()

    def publish(estimate: LiveEstimate, update: Update) -> None:
        pictures[live.run].update(estimate, update)
        if update.position_m is not None:
            published.append(update.position_m)

    live.runs.on_begun, live.runs.on_closed = begin_run, close
    live.on_update = publish
    for begin in range(0, len(feed), BATCH):
        live.feed(feed[begin : begin + BATCH])
        for estimate in live.run.estimates:
            pictures[live.run].snapshot(estimate, estimate.snapshot(), None)
    live.runs.conclude(np.zeros_like)
    [picture] = pictures.values()
    assert picture.close() == []
    assert picture.dropped == 0
    live.end()
    return live, [Rrd(item / "run.rrd") for item in live.folders], published


def assert_drawn(
    picture: Rrd,
    estimate: Floats,
    groundtruth: Floats | None = None,
    more: Sequence[Floats] = (),
) -> None:
    """Assert that the paths at the newest time are those, (N, 3), and the colours.

    The picture may have `more` poses of the estimate.
    """
    for entity, expected in ((FRAME, estimate), (GROUNDTRUTH_ENTITY, groundtruth)):
        if expected is None:
            continue
        stamps, _ = picture.rows(f"{entity}/pose", "Transform3D:translation")
        path = np.concatenate(picture.path(entity, int(stamps[-1])))
        distances = np.linalg.norm(path[:, None] - np.concatenate([expected, *more]), axis=2)
        assert distances.min(axis=1).max() < 1e-5
        assert distances[:, : len(expected)].min(axis=0).max() < 0.6
    _, coloured = picture.strips(f"{FRAME}/by_error")
    points = np.concatenate(coloured[-1])
    distances = np.linalg.norm(points[:, None] - np.concatenate([estimate, *more]), axis=2)
    assert distances.min(axis=1).max() < 1e-5
    assert distances[:, : len(estimate)].min(axis=0).max() < 0.6


@pytest.mark.slow
def test_each_loop_of_a_bag_is_drawn_in_its_folder(tmp_path: Path) -> None:
    loops = loop(4), loop(5, 0.6 * LOOP_S)
    feed = feed_of(*loops[0]) + feed_of(*loops[1])
    live, pictures, published = drawn(tmp_path / "live", feed)
    for folder, picture, (groundtruth, _) in zip(live.folders, pictures, loops, strict=True):
        pairs = pairs_of(folder)
        assert_drawn(picture, pairs.estimate.positions, groundtruth.positions)
    _, values = pictures[1].numbers("metrics/position_error/vio")
    # Messages arrive seldom and many at once: errors between two published ones are drawn, too.
    places = [values.tolist().index(item) for item in published]
    assert places == sorted(places)
    assert len(values) > 3 * len(published)


@pytest.mark.slow
def test_a_restart_of_the_estimator_is_drawn_as_it_is_evaluated(tmp_path: Path) -> None:
    groundtruth, estimate = loop(4)
    row = len(estimate) // 2
    moved = estimate.positions.copy()
    moved[row:] += [30.0, -20.0, 10.0]
    feed = feed_of(groundtruth, dataclasses.replace(estimate, positions=moved))
    _, (first, second), _ = drawn(tmp_path / "live", feed, at_restarts=True)
    # Both pictures have the groundtruth that arrived during the run. Until the restart is found,
    # the first one also has the poses after it.
    assert_drawn(first, moved[:row], more=[moved[row:]])
    assert_drawn(second, moved[row:])
