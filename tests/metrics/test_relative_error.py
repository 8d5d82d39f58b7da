"""Absolute and relative errors against 4x4 matrices, pose by pose."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.spatial.transform import Rotation
from strategies import Array, make_element, make_estimate, make_groundtruth, seeds

from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics import relative_evaluation
from trajeval_ros.metrics.absolute_errors import absolute_errors
from trajeval_ros.metrics.protocol import PROTOCOLS, Protocol, metres
from trajeval_ros.metrics.relative_errors import relative_errors
from trajeval_ros.pipeline.pipeline import evaluate
from trajeval_ros.report.verdict_lines import verdict

PRECISE = 1e-10


def noisy_pair(seed: int, count: int = 40) -> tuple[Trajectory, Trajectory]:
    """Return paired states in different frames, with errors of all sizes."""
    truth = make_groundtruth(seed, count)
    random = np.random.default_rng(seed)
    assert truth.rotations is not None
    assert truth.velocities is not None
    sizes = 10.0 ** random.uniform(-3, 0.3, size=(count, 1))
    estimate = dataclasses.replace(
        truth,
        positions=truth.positions + random.normal(scale=0.3, size=(count, 3)),
        quaternions=(
            Rotation.from_rotvec(sizes * random.normal(size=(count, 3))) * truth.rotations
        ).as_quat(),
        velocities=truth.velocities + random.normal(scale=0.1, size=(count, 3)),
    )
    return truth, make_element(Gauge.SIM3, seed + 1, reach_m=10.0).trajectory(estimate)


def matrices(trajectory: Trajectory, scale: float = 1.0) -> Array:
    assert trajectory.rotations is not None
    poses = np.tile(np.eye(4), (len(trajectory), 1, 1))
    poses[:, :3, :3] = trajectory.rotations.as_matrix()
    poses[:, :3, 3] = scale * trajectory.positions
    return poses


def angle_of(rotation: Array) -> float:
    skew = np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
    return float(np.degrees(np.arctan2(np.linalg.norm(skew), np.trace(rotation) - 1.0)))


def yaw_of(rotation: Array) -> float:
    """Return the turn about z that is closest to a rotation."""
    sine, cosine = rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1]
    return float(np.degrees(np.abs(np.arctan2(sine, cosine))))


def tilt_of(rotation: Array) -> float:
    return float(np.degrees(np.arctan2(np.hypot(*rotation[:2, 2]), rotation[2, 2])))


def alignment_at(gauge: Gauge, form: str, truth: Array, estimate: Array) -> Array:
    """Return eq. (19), or (20), as a rotation."""
    between = truth[:3, :3] @ estimate[:3, :3].T
    if form in ("gauge", "tutorial") and gauge in (Gauge.YAW, Gauge.PLANAR):
        angle = np.arctan2(between[1, 0] - between[0, 1], between[0, 0] + between[1, 1])
        return Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
    return between


@pytest.mark.parametrize("gauge", list(Gauge))
@pytest.mark.parametrize("form", ["gauge", "se3", "tutorial", "euler"])
@settings(max_examples=6)
@given(seed=seeds)
def test_relative_errors_are_those_of_matrices(gauge: Gauge, form: str, seed: int) -> None:
    truth, estimate = noisy_pair(seed)
    random = np.random.default_rng(seed)
    scale = float(random.uniform(0.5, 2.0))
    starts, ends = np.sort(random.integers(0, 40, size=(2, 30)), axis=0)
    errors = relative_errors(truth, estimate, starts, ends, gauge, scale, form)
    assert truth.velocities is not None
    assert estimate.velocities is not None
    assert errors.tilt_deg is not None
    assert errors.velocity_mps is not None
    true_poses, poses = matrices(truth), matrices(estimate, scale)
    for k, (s, e) in enumerate(zip(starts, ends, strict=True)):
        align = np.eye(4)
        align[:3, :3] = alignment_at(gauge, form, true_poses[s], poses[s])
        align[:3, 3] = true_poses[s, :3, 3] - align[:3, :3] @ poses[s, :3, 3]
        end = align @ poses[e]
        velocity = scale * align[:3, :3] @ estimate.velocities[e]
        error = true_poses[e, :3, :3] @ end[:3, :3].T
        rotation = error if form == "tutorial" else np.eye(3)
        position = np.linalg.norm(true_poses[e, :3, 3] - rotation @ end[:3, 3])
        assert errors.position_m[k] == pytest.approx(position, abs=PRECISE)
        speed = np.linalg.norm(truth.velocities[e] - rotation @ velocity)
        assert errors.velocity_mps[k] == pytest.approx(speed, abs=PRECISE)
        assert errors.rotation_deg[k] == pytest.approx(angle_of(error), abs=1e-9)
        if form != "euler":
            assert errors.yaw_deg[k] == pytest.approx(yaw_of(error), abs=1e-9)
            assert errors.tilt_deg[k] == pytest.approx(tilt_of(error), abs=1e-9)


@pytest.mark.parametrize("form", ["se3", "euler"])
@settings(max_examples=10)
@given(seed=seeds)
def test_the_se3_form_is_the_error_of_relative_poses(form: str, seed: int) -> None:
    truth, estimate = noisy_pair(seed)
    starts = np.arange(0, 30)
    ends = starts + 10
    errors = relative_errors(truth, estimate, starts, ends, Gauge.SE3, 1.0, form)
    assert errors.tilt_deg is not None
    true_poses, poses = matrices(truth), matrices(estimate)
    for k, (s, e) in enumerate(zip(starts, ends, strict=True)):
        true_step = np.linalg.inv(true_poses[s]) @ true_poses[e]
        step = np.linalg.inv(poses[s]) @ poses[e]
        error = np.linalg.inv(true_step) @ step
        assert errors.position_m[k] == pytest.approx(np.linalg.norm(error[:3, 3]), abs=PRECISE)
        assert errors.rotation_deg[k] == pytest.approx(angle_of(error[:3, :3]), abs=1e-9)
        if form == "euler":  # the toolbox's, in the unaligned estimate's world
            world = poses[e, :3, :3] @ error[:3, :3] @ poses[e, :3, :3].T
            yaw = np.arctan2(world[1, 0], world[0, 0])
            pitch = np.arctan2(-world[2, 0], np.hypot(world[0, 0], world[1, 0]))
            roll = np.arctan2(world[2, 1], world[2, 2])
            assert errors.yaw_deg[k] == pytest.approx(np.degrees(abs(yaw)), abs=1e-8)
            tilt = np.degrees(np.hypot(pitch, roll))
            assert errors.tilt_deg[k] == pytest.approx(tilt, abs=1e-8)


@pytest.mark.parametrize("form", ["plain", "tutorial"])
@given(seed=seeds)
def test_absolute_errors_are_those_of_matrices(form: str, seed: int) -> None:
    truth, aligned = noisy_pair(seed)
    errors = absolute_errors(truth, aligned, form)
    assert truth.velocities is not None
    assert aligned.velocities is not None
    assert errors.rotation_deg is not None
    assert errors.yaw_deg is not None
    assert errors.tilt_deg is not None
    assert errors.velocity_mps is not None
    true_poses, poses = matrices(truth), matrices(aligned)
    for i in range(len(truth)):
        error = true_poses[i, :3, :3] @ poses[i, :3, :3].T
        rotation = error if form == "tutorial" else np.eye(3)
        position = np.linalg.norm(true_poses[i, :3, 3] - rotation @ poses[i, :3, 3])
        speed = np.linalg.norm(truth.velocities[i] - rotation @ aligned.velocities[i])
        assert errors.position_m[i] == pytest.approx(position, abs=PRECISE)
        assert errors.velocity_mps[i] == pytest.approx(speed, abs=PRECISE)
        assert errors.rotation_deg[i] == pytest.approx(angle_of(error), abs=1e-9)
        assert errors.yaw_deg[i] == pytest.approx(yaw_of(error), abs=1e-9)
        assert errors.tilt_deg[i] == pytest.approx(tilt_of(error), abs=1e-9)


def test_withheld_rotation_takes_all_that_depends_on_it() -> None:
    truth, aligned = noisy_pair(4)
    errors = absolute_errors(truth, aligned, rotation=False)
    assert errors.rotation_deg is errors.yaw_deg is errors.tilt_deg is None
    assert errors.velocity_mps is None
    assert errors.gyroscope_bias is not None


def test_a_share_of_the_path_is_of_the_matched_one_and_the_toolboxs_of_all_in_centimetres() -> (
    None
):
    truth = make_groundtruth(5, 200)
    estimate = make_estimate(truth, 6)[20:60]
    actual = evaluate(truth, estimate, Protocol(lengths="12.5%"))
    theirs = evaluate(truth, estimate, Protocol(lengths="12.5%", selection="toolbox"))
    assert actual.relative is not None
    assert theirs.relative is not None
    matched_m = actual.association.groundtruth.path_length_m
    assert actual.relative[0].length_m == pytest.approx(matched_m / 8.0)
    assert theirs.relative[0].length_m == np.floor(100.0 * truth.path_length_m / 8.0) / 100.0
    table = actual._repr_html_()
    assert "ATE" in table
    assert "RE 12.5%" in table


def test_errors_of_long_runs_are_measured_again(monkeypatch: pytest.MonkeyPatch) -> None:
    truth = make_groundtruth(5, 300)
    estimate = make_estimate(truth, 6)
    protocol = Protocol(lengths=metres(4, 10), gauge=Gauge.PLANAR)
    held = evaluate(truth, estimate, protocol)
    monkeypatch.setattr(relative_evaluation, "_MOST_HELD", 0)
    released = evaluate(truth, estimate, protocol)
    assert verdict(held) == verdict(released)
    assert held.pooled == released.pooled
    for one, other in zip(held.relative or (), released.relative or (), strict=True):
        assert one.held is not None
        assert other.held is None
        assert one.statistics == other.statistics
        worst = one.errors.starts[np.argmax(one.errors.position_m)]
        assert one.worst_start == other.worst_start == worst
        assert "errors" not in vars(other)  # the result lines need no second measurement
        assert other.count == len(other.errors.ends) > 0
        assert other.errors is other.errors
        for name, column in vars(one.errors).items():
            np.testing.assert_array_equal(column, getattr(other.errors, name))


@pytest.mark.slow
def test_absolute_errors_by_blocks_are_those_of_all_states_at_once() -> None:
    truth = make_groundtruth(7, 40_000)
    estimate = make_estimate(truth, 8)
    result = evaluate(truth, estimate, Protocol(lengths=()))
    pairs = result.association
    assert len(pairs) > 16_384
    whole = absolute_errors(pairs.groundtruth, result.aligned)
    for name, column in vars(whole).items():
        actual = getattr(result.absolute, name)
        if column is None:
            assert actual is None
        else:
            np.testing.assert_allclose(actual, column, rtol=0.0, atol=1e-11, err_msg=name)


@pytest.mark.parametrize("start_s", [0, 1_403_636_580])
def test_durations_at_the_limit_of_the_tolerance_count(start_s: int) -> None:
    """Keyframes at multiples of 50 ms: a third of the pairs lasts exactly 0.9 or 1.1 s."""
    random = np.random.default_rng(3)
    ticks = np.cumsum(random.choice([4, 7, 9, 11, 22], size=150))
    stamps = 10**9 * start_s + 13_560_000 + 50_000_000 * ticks.astype(np.int64)
    expected = []
    for row, tick in enumerate(ticks.tolist()):
        deviations = np.abs(ticks - tick - 20)
        if deviations.min() <= 2:
            expected.append((row, int(np.argmin(deviations))))
    assert sum(abs(ticks[end] - ticks[row] - 20) == 2 for row, end in expected) > 30
    truth = dataclasses.replace(make_groundtruth(3, 150), stamps=stamps)
    protocol = dataclasses.replace(PROTOCOLS["evo"], lengths="1s", gauge=Gauge.SE3)
    protocol = dataclasses.replace(
        protocol, selection=dataclasses.replace(protocol.selection, pairs="all")
    )
    (segment,) = evaluate(truth, truth, protocol).relative or ()
    result = zip(segment.errors.starts.tolist(), segment.errors.ends.tolist(), strict=True)
    assert list(result) == expected
