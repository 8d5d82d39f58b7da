"""Covariances about the body's axes where the estimate is moved: by a lever arm, or another up."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse
from live_runs import ESTIMATE, GROUNDTRUTH, Live
from marker_flights import MOUNTED, of_marker, write_mounting
from ros_bags import ODOM, POINT, POSE, messages_of
from state_rows import states, trajectory
from uncertain_marker_runs import uncertain_messages
from uncertain_runs import sides

from trajeval_ros import CovarianceRequest, Protocol, Request, Trajectory, run
from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.consistency.consistency_result import Consistency
from trajeval_ros.consistency.joint_covariance import JointCovariance
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.requests.request_from import known_hand_eye
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_frames import at_marker
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.ros.marker_body import MarkerBody

IN_BODY = CovarianceRequest("message", rotation_frame="body", groundtruth_noise=(0.01, 0.2))
LEVER_M = MOUNTED.lever_m


def rows_of(estimate: Trajectory) -> Floats:
    assert estimate.covariances is not None
    own = states(estimate.positions, estimate.quaternions)
    return np.hstack([own, estimate.covariances.reshape(-1, 36)])


def moved(frame: str, quaternion: Floats, errors: Floats) -> Floats:
    """Return how errors (N, 6) of a body's pose move a marker's position, and turn it: (N, 6)."""
    rotation = lie.from_rotation_vector(errors[:, 3:])
    q = np.broadcast_to(quaternion, rotation.shape)
    wrong = lie.multiply(rotation, q) if frame == "world" else lie.multiply(q, rotation)
    shift = lie.rotate(wrong, LEVER_M) - lie.rotate(q, LEVER_M)
    return np.hstack([errors[:, :3] + shift, errors[:, 3:]])


@pytest.mark.parametrize("frame", ["world", "body"])
def test_a_lever_arm_couples_position_and_rotation(frame: str) -> None:
    """By the derivative, and by the spread of many wrong poses."""
    _, estimate = sides(1)
    assert estimate.covariances is not None
    assert estimate.quaternions is not None
    result = at_marker(estimate, MOUNTED, frame).covariances
    assert result is not None
    random, step = np.random.default_rng(0), 1e-6
    for row in (0, 30, 60):
        q, covariance = estimate.quaternions[row], estimate.covariances[row]
        ends = moved(frame, q, step * np.eye(6)), moved(frame, q, -step * np.eye(6))
        derivative = (ends[0] - ends[1]).T / (2.0 * step)
        expected = derivative @ covariance @ derivative.T
        np.testing.assert_allclose(result[row], expected, rtol=1e-7, atol=1e-9)
        small = 1e-2  # of the standard deviations, which are of radians
        drawn = small * random.multivariate_normal(np.zeros(6), covariance, 100_000)
        spread = np.cov(moved(frame, q, drawn).T) / small**2
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        assert np.abs((spread - result[row]) / scale).max() < 0.02


def test_bodies_axes_know_no_up() -> None:
    """The same flight in a world with -y up, offline and live, has the same NEES."""
    truth, estimate = sides(3)
    up = UpAxis("-y")
    other = [of_world(item, up) for item in (truth, estimate)]
    protocol = Protocol(gauge="yaw", lengths=())
    means = []
    for pair in ((truth, estimate), other):
        [result] = run(pair[0], pair[1:], Request(protocol, covariances=IN_BODY)).runs
        assert result.consistency is not None
        assert result.consistency.per_pose is not None
        means.append(result.consistency.per_pose.mean)
    assert means[0] == pytest.approx(means[1], rel=1e-9)
    settings = OnlineSettings(protocol, covariances=IN_BODY, up=("-y", "-y"))
    live = OnlineEvaluator(settings)
    live.add_groundtruth(
        trajectory(other[0].stamps, states(other[0].positions, other[0].quaternions))
    )
    live.add_estimate(trajectory(other[1].stamps, rows_of(other[1])))
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
        rotation = np.eye(6)
        rotation[:3, :3] = back
        covariances = rotation @ covariances @ rotation.T
    return dataclasses.replace(
        flight,
        positions=flight.positions @ back.T,
        quaternions=lie.multiply(lie.from_matrix(back), flight.quaternions),
        velocities=None,
        covariances=covariances,
        up=up,
    )


def test_a_live_run_moves_them_as_offline(tmp_path: Path) -> None:
    feed, estimate = uncertain_messages(3, POINT)
    file = str(write_mounting(tmp_path))
    body = MarkerBody(file, known_hand_eye(file), rotation_frame="body")
    live = Live(
        tmp_path / "live",
        ODOM,
        body=body,
        groundtruth_kind=POINT,
        covariances=IN_BODY,
        association="linear",
    )
    live.feed(feed)
    newest = live.run.estimates[0].uncertainty()
    live.end()
    offline = MOUNTED.of_marker(IN_BODY.about_world(estimate), 1.0)
    assert offline.covariances is not None
    assert newest is not None
    np.testing.assert_allclose(newest[2], offline.covariances[-1, :3, :3], rtol=1e-9)


NOISE = 0.002, 0.5


def marked(seed: int, count: int) -> tuple[Trajectory, Trajectory]:
    """Return noisy groundtruth of the marker, and a nearly perfect estimate of the body."""
    random = np.random.default_rng(seed)
    body = Trajectory(
        np.arange(1, count + 1) * 10**7,
        np.cumsum(random.normal(size=(count, 3)), axis=0),
        lie.from_rotation_vector(random.normal(size=(count, 3))),
    )
    marker = of_marker(body)
    assert marker.quaternions is not None
    rotations = lie.from_rotation_vector(np.radians(NOISE[1]) * random.normal(size=(count, 3)))
    noisy = dataclasses.replace(
        marker,
        positions=marker.positions + NOISE[0] * random.normal(size=(count, 3)),
        quaternions=lie.multiply(rotations, marker.quaternions),
    )
    small = np.diag([1e-5**2] * 3 + [1e-5**2] * 3)
    return noisy, dataclasses.replace(
        body, covariances=np.linspace(1.0, 1.001, count)[:, None, None] * small
    )


def judged(sides: tuple[Trajectory, Trajectory], request: CovarianceRequest) -> Consistency:
    calibration = CalibrationRequest(known=MOUNTED)
    protocol = Protocol(gauge="none", lengths=())
    request_ = Request(protocol, covariances=request, calibration=calibration)
    [result] = run(sides[0], sides[1:], request_).runs
    assert result.consistency is not None
    return result.consistency


def test_noise_of_the_marker_s_rotation_moves_the_body() -> None:
    count = 20_000
    result = judged(marked(5, count), CovarianceRequest("message", groundtruth_noise=NOISE))
    assert result.per_pose is not None
    # NEES of N independent poses is chi-square with 6 N degrees of freedom: five deviations.
    assert result.per_pose.mean == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / (6 * count)))
    assert result.covariances is not None
    assert result.errors is not None
    spread = np.cov(result.errors[:, :3].T).trace()
    variance = 3.0 * NOISE[0] ** 2 + 2.0 * np.radians(NOISE[1]) ** 2 * LEVER_M @ LEVER_M
    assert spread == pytest.approx(variance, rel=0.03)
    np.testing.assert_allclose(
        result.covariances[:, :3, :3].trace(axis1=1, axis2=2),
        variance + 3e-10 * np.linspace(1.0, 1.001, count),
        rtol=1e-12,
    )


@pytest.mark.parametrize("kind", ["covariance", "information"])
def test_the_joint_nees_of_independent_poses_is_the_sum_of_theirs(kind: str) -> None:
    sides = marked(7, 25)
    estimate, size = sides[1], 6 * 25
    single = judged(sides, CovarianceRequest("message", groundtruth_noise=NOISE))
    assert estimate.quaternions is not None
    known: dict[str, Any] = {
        "covariance": 1e-10 * np.eye(size),
        "information": scipy.sparse.csr_matrix(1e10 * np.eye(size)),
    }
    joint = JointCovariance(
        estimate.stamps, estimate.positions, estimate.quaternions, 6, **{kind: known[kind]}
    )
    request = CovarianceRequest("joint", joint, "joint.npz", groundtruth_noise=NOISE)
    result = judged(sides, request)
    assert result.joint is not None
    assert single.per_pose is not None
    assert result.joint.nees == pytest.approx(size * single.per_pose.mean, rel=1e-6)


def test_finish_and_the_node_take_the_noise_at_the_marker(tmp_path: Path) -> None:
    sides = marked(6, 300)
    request = CovarianceRequest("message", groundtruth_noise=NOISE)
    expected = judged(sides, request)
    file = str(write_mounting(tmp_path))
    body = MarkerBody(file, known_hand_eye(file))
    live = Live(tmp_path / "live", ODOM, body=body, covariances=request, gauge="none")
    feed = [*messages_of(sides[0], GROUNDTRUTH, POSE), *messages_of(sides[1], ESTIMATE, ODOM)]
    live.feed(sorted(feed, key=lambda item: item[2]))
    live.end()
    seen = live.run.estimates[0].snapshot().nees
    assert seen is not None
    assert expected.per_pose is not None
    assert seen.mean == pytest.approx(expected.per_pose.mean, rel=1e-9)
    for options in ((), ("--covariance", "message", "--groundtruth-noise", "0.002,0.5")):
        again = tmp_path / "again.json"
        assert live.finish(*options, "--json", str(again)) == 0
        [result] = json.loads(again.read_text())["runs"]
        mean = result["consistency"]["per_pose"]["mean"]
        assert mean == pytest.approx(expected.per_pose.mean, rel=1e-9)
