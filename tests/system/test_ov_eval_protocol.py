"""Protocol ov_eval: NEES of orientations and positions by covariances as they are published."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trajeval_ros.cli.app import main
from trajeval_ros.consistency.consistency_assessment import assess_consistency
from trajeval_ros.consistency.consistency_result import Consistency
from trajeval_ros.consistency.covariance_request import CovarianceRequest
from trajeval_ros.consistency.joint_covariance import JointCovariance
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.evaluation import evaluate
from trajeval_ros.metrics.protocol import PROTOCOLS, Protocol
from trajeval_ros.papers.flight import fly
from trajeval_ros.papers.scene import PROFILES

OURS = dataclasses.replace(PROTOCOLS["ov_eval"], lengths=())
IN_BODY = CovarianceRequest("message", rotation_frame="body")


@pytest.fixture(scope="module")
def flight() -> tuple[Trajectory, Trajectory]:
    """Return groundtruth, and an estimate with rotation covariances about the body's axes."""
    flown = fly(4, 6.0, PROFILES["euroc"])
    (odometry,) = flown.runs(1, 1)
    estimate = odometry.estimate
    random = np.random.default_rng(0)
    roots = random.normal(scale=0.01, size=(len(estimate), 6, 6))
    covariances = roots @ np.swapaxes(roots, 1, 2) + 1e-5 * np.eye(6)
    return flown.groundtruth, dataclasses.replace(estimate, covariances=covariances)


def by_definition(groundtruth: Trajectory, estimate: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Return NEES (N,) of orientations and positions: groundtruth moved into the estimate's frame.

    Pose by pose, from poses that are aligned over all positions by yaw and translation, with
    errors about the body's axes.
    """
    rows = np.searchsorted(groundtruth.stamps, estimate.stamps)
    truth, other = groundtruth.positions[rows], estimate.positions
    assert groundtruth.rotations is not None
    assert estimate.rotations is not None
    p, q = truth - truth.mean(axis=0), other - other.mean(axis=0)
    yaw = np.arctan2(np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]), np.sum(p[:, :2] * q[:, :2]))
    rotation = Rotation.from_euler("z", yaw)
    positions = rotation.apply(p) + other.mean(axis=0)
    rotations = rotation * groundtruth.rotations[rows]
    assert estimate.covariances is not None
    orientation, position = [], []
    for place in range(len(estimate)):
        error = (estimate.rotations[place].inv() * rotations[place]).as_rotvec()
        shift = positions[place] - other[place]
        covariance = estimate.covariances[place]
        orientation.append(error @ np.linalg.inv(covariance[3:, 3:]) @ error)
        position.append(shift @ np.linalg.inv(covariance[:3, :3]) @ shift)
    return np.array(orientation), np.array(position)


def judged(
    flight: tuple[Trajectory, Trajectory],
    protocol: Protocol,
    request: CovarianceRequest = IN_BODY,
) -> Consistency:
    return assess_consistency(evaluate(*flight, protocol), request)


def test_nees_of_orientations_and_positions(flight: tuple[Trajectory, Trajectory]) -> None:
    result = judged(flight, OURS)
    orientation, position = by_definition(*flight)
    assert result.pose_nees is not None
    assert result.per_pose is not None
    np.testing.assert_allclose(3.0 * result.pose_nees.rotation, orientation, rtol=1e-9)
    np.testing.assert_allclose(3.0 * result.pose_nees.position, position, rtol=1e-9)
    assert 3.0 * result.per_pose.rotation.mean == pytest.approx(orientation.mean(), rel=1e-9)
    assert 3.0 * result.per_pose.position.max == pytest.approx(position.max(), rel=1e-9)
    assert (result.exactness, result.verdict) == ("as published", "undecided")
    # What 95 % of honest runs do can't be said of covariances in another gauge.
    assert result.per_pose.limit_95 is None


def test_it_is_not_the_nees_of_the_alignments_gauge(
    flight: tuple[Trajectory, Trajectory],
) -> None:
    raw = judged(flight, OURS).per_pose
    bound = judged(flight, dataclasses.replace(OURS, nees_form="gauge")).per_pose
    assert raw is not None
    assert bound is not None
    assert bound.mean < 0.9 * raw.mean
    assert bound.limit_95 is not None


def test_frames_that_are_the_same_need_no_gauge(flight: tuple[Trajectory, Trajectory]) -> None:
    same = dataclasses.replace(OURS, gauge="none")
    raw = judged(flight, same)
    gauge = judged(flight, dataclasses.replace(same, nees_form="gauge"))
    assert raw.statement == gauge.statement
    assert raw.per_pose == gauge.per_pose
    assert raw.exactness == "exact"


def test_groundtruth_noise_adds_to_published_covariances(
    flight: tuple[Trajectory, Trajectory],
) -> None:
    noisy = dataclasses.replace(IN_BODY, groundtruth_noise=(0.05, 1.0))
    with_noise = judged(flight, OURS, noisy)
    without = judged(flight, OURS)
    added = np.diag([0.05**2] * 3 + [np.radians(1.0) ** 2] * 3)
    assert with_noise.covariances is not None
    np.testing.assert_allclose(with_noise.covariances, without.covariances + added, rtol=1e-12)


@pytest.mark.parametrize("gauge", ["none", "yaw", "se3"])
def test_parts_make_the_whole_where_they_are_uncorrelated(
    flight: tuple[Trajectory, Trajectory], gauge: str
) -> None:
    truth, estimate = flight
    apart = np.array(estimate.covariances)
    apart[:, :3, 3:] = apart[:, 3:, :3] = 0.0
    uncorrelated = dataclasses.replace(estimate, covariances=apart)
    nees = judged((truth, uncorrelated), dataclasses.replace(OURS, gauge=gauge)).pose_nees
    assert nees is not None
    np.testing.assert_allclose(2.0 * nees.pose, nees.position + nees.rotation, rtol=1e-9)


def test_a_joint_covariance_is_refused(flight: tuple[Trajectory, Trajectory]) -> None:
    truth, estimate = flight
    assert estimate.quaternions is not None
    joint = JointCovariance(
        estimate.stamps,
        estimate.positions,
        estimate.quaternions,
        block=6,
        covariance=np.eye(6 * len(estimate)),
    )
    with pytest.raises(SettingsError, match="use --covariance message"):
        judged((truth, estimate), OURS, CovarianceRequest("joint", joint, "joint.npz"))


def test_the_command_line_prints_what_ov_eval_prints(
    flight: tuple[Trajectory, Trajectory], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth, estimate = flight
    for name, side in (("truth", truth), ("estimate", estimate)):
        assert side.quaternions is not None
        rows = [side.stamps * 1e-9, *side.positions.T, *side.quaternions.T]
        if side.covariances is not None:
            upper = np.triu_indices(3)
            rows += [*side.covariances[:, 3:, 3:][:, upper[0], upper[1]].T]
            rows += [*side.covariances[:, :3, :3][:, upper[0], upper[1]].T]
        formats = ["%.9f"] + ["%.17g"] * (len(rows) - 1)
        np.savetxt(tmp_path / f"{name}.txt", np.column_stack(rows), fmt=formats)
    sides = ["-g", str(tmp_path / "truth.txt"), "-e", str(tmp_path / "estimate.txt")]
    # OpenVINS's files hold rotation covariances about the body's axes, which their reader knows.
    result = tmp_path / "result.json"
    words = ["--protocol", "ov_eval", "--covariance", "message", "--json", str(result)]
    assert main(["evaluate", *sides, *words]) == 0
    printed = capsys.readouterr().out
    (run,) = json.loads(result.read_text())["runs"]
    per_pose = run["consistency"]["per_pose"]
    orientation, position = (3.0 * per_pose[name]["mean"] for name in ("rotation", "position"))
    assert f"mean_ori = {orientation:.3f} | mean_pos = {position:.3f}" in printed
    assert "NEES / 3 of orientations" in printed
    expected = [item.mean() for item in by_definition(truth, estimate)]
    assert [orientation, position] == pytest.approx(expected, rel=1e-3)
