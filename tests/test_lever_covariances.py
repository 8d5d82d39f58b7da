"""Covariances about the body's axes where the estimate is moved: by a lever arm, or another up."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from marker_flights import MOUNTED, write_mounting
from ros_bags import ODOM, POINT
from test_live_marker import uncertain_messages
from test_live_nees import sides
from test_live_run import Live

from trajeval_ros import CovarianceRequest, Protocol, Request, Trajectory, run
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.live.pair_file import read_pairs
from trajeval_ros.io.requests.request_words import known_hand_eye
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.marker_rows import marker_rows
from trajeval_ros.online.state_rows import COVARIANCE, states
from trajeval_ros.ros.marker_body import MarkerBody

IN_BODY = CovarianceRequest("message", rotation_frame="body", groundtruth_noise=(0.01, 0.2))
LEVER_M = MOUNTED.lever_m


def rows_of(estimate: Trajectory) -> Floats:
    assert estimate.covariances is not None
    own = states(estimate.positions, estimate.quaternions)
    return np.hstack([own, estimate.covariances.reshape(-1, 36)])


def moved(frame: str, quaternion: Floats, errors: Floats) -> Floats:
    """Return how errors (N, 6) of a body's pose move a marker's position, and turn it: (N, 6)."""
    turn = lie.from_rotation_vector(errors[:, 3:])
    q = np.broadcast_to(quaternion, turn.shape)
    wrong = lie.multiply(turn, q) if frame == "world" else lie.multiply(q, turn)
    shift = lie.rotate(wrong, LEVER_M) - lie.rotate(q, LEVER_M)
    return np.hstack([errors[:, :3] + shift, errors[:, 3:]])


@pytest.mark.parametrize("frame", ["world", "body"])
def test_a_lever_arm_couples_position_and_rotation(frame: str) -> None:
    """By the derivative, and by the spread of many wrong poses."""
    _, estimate = sides(1)
    assert estimate.covariances is not None
    assert estimate.quaternions is not None
    found = marker_rows(rows_of(estimate), MOUNTED, frame)[:, COVARIANCE].reshape(-1, 6, 6)
    random, step = np.random.default_rng(0), 1e-6
    for row in (0, 30, 60):
        q, covariance = estimate.quaternions[row], estimate.covariances[row]
        ends = moved(frame, q, step * np.eye(6)), moved(frame, q, -step * np.eye(6))
        derivative = (ends[0] - ends[1]).T / (2.0 * step)
        expected = derivative @ covariance @ derivative.T
        np.testing.assert_allclose(found[row], expected, rtol=1e-7, atol=1e-9)
        small = 1e-2  # of the standard deviations, which are of radians
        drawn = small * random.multivariate_normal(np.zeros(6), covariance, 100_000)
        spread = np.cov(moved(frame, q, drawn).T) / small**2
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        assert np.abs((spread - found[row]) / scale).max() < 0.02


def test_bodies_axes_know_no_up() -> None:
    """The same flight in a world with -y up, offline and live, has the same NEES."""
    truth, estimate = sides(3)
    up = UpAxis("-y")
    other = [of_world(each, up) for each in (truth, estimate)]
    protocol = Protocol(gauge="yaw", lengths=())
    means = []
    for pair in ((truth, estimate), other):
        [found] = run(pair[0], pair[1:], Request(protocol, covariances=IN_BODY)).runs
        assert found.consistency is not None
        assert found.consistency.per_pose is not None
        means.append(found.consistency.per_pose.mean)
    assert means[0] == pytest.approx(means[1], rel=1e-9)
    settings = OnlineSettings(protocol, covariances=IN_BODY, up=("-y", "-y"))
    live = OnlineEvaluator(settings)
    live.add_groundtruth(other[0].stamps, states(other[0].positions, other[0].quaternions))
    live.add_estimate(other[1].stamps, rows_of(other[1]))
    live.update(at_end=True)
    snapshot = live.snapshot()
    assert snapshot.nees is not None, snapshot.why_not_consistency
    assert snapshot.nees.mean == pytest.approx(means[0], rel=1e-9)


def of_world(flight: Trajectory, up: UpAxis) -> Trajectory:
    """Return the flight in a world with another axis up; covariances of the body's axes stay."""
    back = up.matrix.T
    assert flight.quaternions is not None
    covariances = flight.covariances
    if covariances is not None:
        turn = np.eye(6)
        turn[:3, :3] = back
        covariances = turn @ covariances @ turn.T
    return dataclasses.replace(
        flight,
        positions=flight.positions @ back.T,
        quaternions=lie.multiply(lie.from_matrix(back), flight.quaternions),
        velocities=None,
        covariances=covariances,
        up=up,
    )


def test_a_live_run_moves_them_as_offline(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    feed, estimate = uncertain_messages(3, POINT)
    file = str(write_mounting(tmp_path))
    body = MarkerBody(file, known_hand_eye(file), rotation_frame="body")
    live = Live(
        tmp_path / "live",
        ODOM,
        body=body,
        truth_kind=POINT,
        covariances=IN_BODY,
        association="linear",
    )
    live.feed(feed)
    newest = live.run.estimates[0].uncertainty()
    live.end()
    recorded = read_pairs(live.folder / "vio.pairs")
    assert recorded.covariances is not None
    kept = np.hstack([recorded.estimate[:, :10], recorded.covariances.reshape(-1, 36)])
    offline = MOUNTED.of_marker(IN_BODY.about_world(estimate), 1.0)
    assert offline.covariances is not None
    rows = estimate.stamps.searchsorted(recorded.stamps)
    about_world = IN_BODY.about_world(
        dataclasses.replace(estimate[rows], covariances=kept[:, COVARIANCE].reshape(-1, 6, 6))
    )
    assert about_world.covariances is not None
    np.testing.assert_allclose(
        about_world.covariances, offline.covariances[rows], rtol=1e-9, atol=1e-12
    )
    assert newest is not None
    np.testing.assert_allclose(newest[2], offline.covariances[-1, :3, :3], rtol=1e-9)
    assert live.finish("--covariance", "message") == 2
    assert "to be about the body's axes; set rotation_covariance_frame" in capsys.readouterr().err
