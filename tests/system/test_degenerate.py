"""Geometry that does not determine an alignment is said to, and never measured as if it did."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from strategies import (
    START,
    all_statistics,
    along_line,
    make_element,
    make_estimate,
    make_groundtruth,
    moved,
)

from trajeval_ros.exceptions import DegenerateGeometryError, InputError
from trajeval_ros.geometry.gauge import Gauge, Similarity
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.protocol import PROTOCOLS, Protocol
from trajeval_ros.metrics.sub_trajectories import Length
from trajeval_ros.pipeline.pipeline import evaluate

BASE = Protocol(lengths=(Length(2.0, "m"), Length(1.0, "s"), Length(20.0, "%")))
FREE = (Gauge.SE3, Gauge.SIM3)
TURNING = (Gauge.YAW, Gauge.PLANAR, *FREE)
DIRECTIONS = {"x": [1.0, 0.0, 0.0], "diagonal": [1.0, -2.0, 0.5], "vertical": [0.0, 0.0, 1.0]}
PATH = np.linspace(0.0, 30.0, 300)


def by(gauge: Gauge, **settings: Any) -> Protocol:
    return dataclasses.replace(BASE, gauge=gauge, **settings)


def disturbed(groundtruth: Trajectory, *, error_m: float = 0.0) -> Trajectory:
    random = np.random.default_rng(5)
    errors = random.normal(scale=1.0, size=groundtruth.positions.shape)
    return dataclasses.replace(groundtruth, positions=groundtruth.positions + error_m * errors)


def assert_rotation_withheld(result: Evaluation) -> None:
    for metric in ("rotation_deg", "yaw_deg", "tilt_deg", "velocity_mps"):
        assert result.ate[metric] is None, metric
    assert result.ate["position_m"] is not None
    assert "determine" in result.withheld or "disagree" in result.withheld
    assert any(result.withheld in warning for warning in result.warnings)


@pytest.mark.slow
@pytest.mark.parametrize("gauge", FREE)
@pytest.mark.parametrize("direction", list(DIRECTIONS))
@pytest.mark.parametrize("noise_m", [0.0, 1e-6])
@pytest.mark.parametrize("error_m", [0.0, 1e-6, 0.05])
@pytest.mark.parametrize("offset", [np.zeros(3), np.array([4.5e5, 5.2e6, 400.0])])
def test_a_straight_line_leaves_the_turn_about_itself_open(
    gauge: Gauge, direction: str, noise_m: float, error_m: float, offset: np.ndarray
) -> None:
    groundtruth = along_line(PATH, DIRECTIONS[direction], noise_m=noise_m)
    element = make_element(gauge, 3)
    estimate = moved(disturbed(groundtruth, error_m=error_m), element)
    world = Similarity(np.eye(3), offset)
    result = evaluate(moved(groundtruth, world), estimate, by(gauge))
    assert_rotation_withheld(result)
    assert "do not determine" in result.alignment.undetermined
    # The position error is determined all the same, and so are relative errors.
    assert result.ate["position_m"] is not None
    assert result.ate["position_m"].rmse < 2.0 * error_m + 3e-6
    assert result.relative is not None
    position = result.relative[0].statistics["position_m"]
    assert position is not None
    assert position.rmse < 4.0 * error_m + 1e-5


@pytest.mark.parametrize("gauge", FREE)
@pytest.mark.parametrize(("error_m", "is_known"), [(0.0, True), (0.05, False)])
def test_on_a_line_an_error_has_a_length_but_no_direction(
    gauge: Gauge, error_m: float, is_known: bool
) -> None:
    groundtruth = along_line(PATH, DIRECTIONS["diagonal"])
    result = evaluate(groundtruth, disturbed(groundtruth, error_m=error_m), by(gauge))
    assert result.ate["position_m"] is not None
    for metric in ("horizontal_m", "vertical_m"):
        assert (result.ate[metric] is not None) == is_known


@pytest.mark.parametrize("gauge", FREE)
def test_first_states_on_a_line_do_not_align_later_ones_off_it(gauge: Gauge) -> None:
    groundtruth = make_groundtruth(3, 40)
    positions = groundtruth.positions.copy()
    positions[:5] = positions[0] + np.outer(np.arange(5.0), DIRECTIONS["diagonal"])
    groundtruth = dataclasses.replace(groundtruth, positions=positions)
    estimate = disturbed(groundtruth, error_m=0.01)
    with pytest.raises(DegenerateGeometryError, match="the first 5 states do not determine"):
        evaluate(groundtruth, estimate, by(gauge, align_states=5))
    assert evaluate(groundtruth, estimate, by(gauge, align_states=8)).ate["position_m"]
    # A line throughout leaves no position open.
    line = along_line(PATH, DIRECTIONS["diagonal"])
    result = evaluate(line, disturbed(line, error_m=0.01), by(gauge, align_states=5))
    assert result.ate["position_m"] is not None


@pytest.mark.parametrize("gauge", [Gauge.YAW, Gauge.PLANAR])
@pytest.mark.parametrize("direction", ["x", "diagonal"])
@pytest.mark.parametrize("error_m", [0.0, 0.05])
def test_a_level_straight_line_determines_yaw(
    gauge: Gauge, direction: str, error_m: float
) -> None:
    groundtruth = along_line(PATH, DIRECTIONS[direction])
    estimate = moved(disturbed(groundtruth, error_m=error_m), make_element(gauge, 4))
    result = evaluate(groundtruth, estimate, by(gauge))
    assert result.alignment.undetermined == ""
    assert result.ate["yaw_deg"] is not None
    assert result.ate["yaw_deg"].max < 0.2 * error_m / 0.05 + 1e-6


@pytest.mark.parametrize("noise_m", [0.0, 1e-6])
def test_vertical_motion_does_not_determine_yaw(noise_m: float) -> None:
    groundtruth = along_line(PATH, DIRECTIONS["vertical"], noise_m=noise_m)
    estimate = moved(disturbed(groundtruth, error_m=0.01), make_element(Gauge.YAW, 4))
    assert_rotation_withheld(evaluate(groundtruth, estimate, by(Gauge.YAW)))
    # The first state's rotation does.
    result = evaluate(groundtruth, estimate, by(Gauge.YAW, align_states=1))
    assert result.ate["yaw_deg"] is not None
    assert result.ate["yaw_deg"].max < 1e-6


def test_vertical_motion_is_no_motion_on_a_plane() -> None:
    groundtruth = along_line(PATH, DIRECTIONS["vertical"])
    result = evaluate(groundtruth, groundtruth, by(Gauge.PLANAR))
    assert_rotation_withheld(result)
    assert result.ate["position_m"] is not None
    assert result.ate["position_m"].rmse == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("gauge", TURNING)
@pytest.mark.parametrize("who", ["groundtruth", "estimate", "both"])
@pytest.mark.parametrize("place", [np.zeros(3), np.array([4.5e5, 5.2e6, 400.0])])
def test_at_rest_errors_have_a_length_and_no_scale_or_rotation(
    gauge: Gauge, who: str, place: np.ndarray
) -> None:
    """The errors do not depend on the rotation: they are the distances to the mean."""
    walking = make_groundtruth(1, 50)
    resting = dataclasses.replace(walking, positions=np.tile(place, (50, 1)))
    groundtruth = resting if who in ("groundtruth", "both") else walking
    estimate = resting if who in ("estimate", "both") else walking
    if gauge is Gauge.SIM3:
        with pytest.raises(DegenerateGeometryError, match="does not move"):
            evaluate(groundtruth, estimate, by(gauge))
        return
    result = evaluate(groundtruth, estimate, by(gauge))
    assert_rotation_withheld(result)
    moving = walking.positions if who != "both" else resting.positions
    axes = slice(2 if gauge is Gauge.PLANAR else 3)
    spread = (moving - moving.mean(axis=0))[:, axes]
    expected = np.sqrt(np.mean(np.sum(spread**2, axis=1)))
    assert result.ate["position_m"] is not None
    assert result.ate["position_m"].rmse == pytest.approx(expected, rel=1e-9, abs=1e-8)


def test_a_robot_at_rest_is_of_no_other_run() -> None:
    resting = dataclasses.replace(
        make_groundtruth(1, 2000), positions=np.ones((2000, 3)), velocities=None
    )
    assert resting.quaternions is not None
    resting = dataclasses.replace(resting, quaternions=np.tile(resting.quaternions[0], (2000, 1)))
    assert resting.duration_s > 20.0
    noise = np.random.default_rng(2).normal(scale=3e-3, size=(2000, 3))
    estimate = dataclasses.replace(resting, positions=resting.positions + noise)
    result = evaluate(resting, estimate, by(Gauge.YAW))
    assert not [remark for remark in result.remarks if remark.code == "other_run"]
    assert not [warning for warning in result.warnings if "another run" in warning]


@pytest.mark.parametrize("gauge", TURNING)
def test_noise_at_rest_is_no_motion(gauge: Gauge) -> None:
    resting = dataclasses.replace(make_groundtruth(1, 200), positions=np.zeros((200, 3)))
    random = np.random.default_rng(2)
    noisy = [
        dataclasses.replace(resting, positions=random.normal(scale=1e-3, size=(200, 3)))
        for _ in range(2)
    ]
    assert_rotation_withheld(evaluate(noisy[0], noisy[1], by(gauge)))


@pytest.mark.parametrize("gauge", [Gauge.NONE, Gauge.TRANSLATION])
def test_no_motion_is_measured_where_nothing_turns(gauge: Gauge) -> None:
    resting = dataclasses.replace(make_groundtruth(1, 50), positions=np.ones((50, 3)))
    result = evaluate(resting, resting, by(gauge))
    assert result.ate["position_m"] is not None
    assert result.ate["position_m"].max == 0.0
    assert result.relative is not None
    assert [len(item.errors.ends) > 0 for item in result.relative] == [False, True, False]
    assert any("no sub-trajectories" in warning for warning in result.warnings)


@pytest.mark.parametrize("protocol", ["default", "rpg", "evo", "kitti"])
def test_a_path_of_millimetres_breaks_no_protocol(protocol: str) -> None:
    groundtruth = make_groundtruth(1, 50)
    tiny = moved(groundtruth, Similarity(np.eye(3), np.zeros(3), 1e-5))
    settings = dataclasses.replace(PROTOCOLS[protocol], gauge=Gauge.NONE)
    result = evaluate(tiny, tiny, settings)
    assert result.ate["position_m"] is not None
    for statistics in all_statistics(result).values():
        assert statistics is None or np.isfinite(statistics.rmse)


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("gauge", list(Gauge))
def test_few_states_are_aligned_refused_or_said_to_be_too_few(gauge: Gauge, count: int) -> None:
    groundtruth = make_groundtruth(6, count)
    estimate = moved(groundtruth, make_element(gauge, 7))
    if count < gauge.minimum_states:
        with pytest.raises(DegenerateGeometryError, match=f"at least {gauge.minimum_states}"):
            evaluate(groundtruth, estimate, by(gauge))
        return
    result = evaluate(groundtruth, estimate, by(gauge))
    assert result.ate["position_m"] is not None
    assert result.ate["position_m"].max < 1e-9
    for statistics in all_statistics(result).values():
        assert statistics is None or statistics.count <= count


@pytest.mark.parametrize("gauge", [Gauge.SE3, Gauge.SIM3, Gauge.YAW])
@pytest.mark.parametrize("states", [2, 3])
def test_few_first_states_are_held_to_the_same(gauge: Gauge, states: int) -> None:
    groundtruth = make_groundtruth(8)
    estimate = make_estimate(groundtruth, 9)
    if states < gauge.minimum_states:
        with pytest.raises(DegenerateGeometryError):
            evaluate(groundtruth, estimate, by(gauge, align_states=states))
        return
    result = evaluate(groundtruth, estimate, by(gauge, align_states=states))
    assert result.alignment.states_used == states


def test_more_states_asked_for_than_there_are_is_said() -> None:
    groundtruth = make_groundtruth(12, 50)
    result = evaluate(groundtruth, groundtruth, by(Gauge.SE3, align_states=80))
    assert result.alignment.states_used == 50
    assert any("fewer than the requested 80" in warning for warning in result.warnings)


@pytest.mark.slow
@pytest.mark.parametrize("gauge", TURNING)
@pytest.mark.parametrize("kind", ["noise", "walk"])
@pytest.mark.parametrize("seed", range(5))
def test_an_estimate_unlike_the_groundtruth_has_no_rotation_error(
    gauge: Gauge, kind: str, seed: int
) -> None:
    groundtruth = make_groundtruth(seed, 400)
    random = np.random.default_rng(100 + seed)
    other = random.normal(scale=3.0, size=(400, 3))
    if kind == "walk":
        other = make_groundtruth(seed + 50, 400, smooth=True).positions
    unrelated = dataclasses.replace(groundtruth, positions=other)
    assert_rotation_withheld(evaluate(groundtruth, unrelated, by(gauge)))


@pytest.mark.parametrize("gauge", FREE)
def test_a_gentle_curve_determines_what_a_line_does_not(gauge: Gauge) -> None:
    groundtruth = along_line(PATH, DIRECTIONS["x"])
    bent = groundtruth.positions + np.outer(0.5 * np.sin(PATH / 5.0), [0.0, 1.0, 0.3])
    groundtruth = dataclasses.replace(groundtruth, positions=bent)
    estimate = moved(disturbed(groundtruth, error_m=0.02), make_element(gauge, 13))
    result = evaluate(groundtruth, estimate, by(gauge))
    assert result.ate["rotation_deg"] is not None
    assert result.ate["rotation_deg"].max < 2.0


@pytest.mark.parametrize("growth", [0.8, 1.25])
def test_a_wrong_scale_does_not_hide_a_rotation_that_is_determined(growth: float) -> None:
    # A corridor with bends: a scale error leaves residuals along it, not to its side.
    groundtruth = along_line(np.linspace(0.0, 100.0, 500), DIRECTIONS["x"])
    bent = groundtruth.positions + np.outer(
        2.0 * np.sin(groundtruth.positions[:, 0] / 6.0), [0.0, 1.0, 0.0]
    )
    groundtruth = dataclasses.replace(groundtruth, positions=bent)
    estimate = moved(groundtruth, Similarity(np.eye(3), np.zeros(3), growth))
    result = evaluate(groundtruth, estimate, by(Gauge.SE3))
    assert result.ate["rotation_deg"] is not None
    assert result.ate["rotation_deg"].rmse < 1.0


@pytest.mark.parametrize("gauge", TURNING)
@pytest.mark.parametrize("side", ["groundtruth", "estimate"])
def test_positions_alone_have_position_errors_alone(gauge: Gauge, side: str) -> None:
    groundtruth = make_groundtruth(14)
    estimate = make_estimate(groundtruth, 15)
    if side == "groundtruth":
        groundtruth = dataclasses.replace(groundtruth, quaternions=None)
    else:
        estimate = dataclasses.replace(estimate, quaternions=None)
    result = evaluate(groundtruth, estimate, by(gauge))
    assert result.ate["position_m"] is not None
    assert result.ate["velocity_mps"] is not None
    for metric in ("rotation_deg", "yaw_deg", "tilt_deg"):
        assert result.ate[metric] is None
    if gauge in (Gauge.YAW, Gauge.PLANAR):  # what is fitted needs no orientation
        assert result.relative
        assert all(item.errors.rotation_deg is None for item in result.relative)
    else:
        assert result.relative is None
    assert any(f"no orientations in the {side}" in warning for warning in result.warnings)
    with pytest.raises(DegenerateGeometryError, match=r"orientations|does not determine a scale"):
        evaluate(groundtruth, estimate, by(gauge, align_states=1))


def test_the_tutorials_form_needs_rotations_on_both_sides() -> None:
    groundtruth = make_groundtruth(16)
    bare = dataclasses.replace(groundtruth, quaternions=None)
    with pytest.raises(InputError, match="plain"):
        evaluate(bare, groundtruth, by(Gauge.SE3, ate_form="tutorial"))


def test_the_tutorials_form_is_never_quietly_another_one() -> None:
    # Its position error depends on the rotation error, which a straight line leaves open.
    groundtruth = along_line(PATH, DIRECTIONS["diagonal"])
    estimate = disturbed(groundtruth, error_m=0.05)
    with pytest.raises((DegenerateGeometryError, InputError), match="plain"):
        evaluate(groundtruth, estimate, by(Gauge.SE3, ate_form="tutorial"))


def test_a_yaw_that_two_rotations_leave_open_is_refused() -> None:
    groundtruth = make_groundtruth(17)
    assert groundtruth.rotations is not None
    upside_down = dataclasses.replace(
        groundtruth,
        quaternions=(Rotation.from_rotvec([np.pi, 0.0, 0.0]) * groundtruth.rotations).as_quat(),
    )
    with pytest.raises(DegenerateGeometryError, match="vertical axes of both"):
        evaluate(groundtruth, upside_down, by(Gauge.YAW, align_states=1))


def test_a_world_that_is_not_level_is_noticed_under_a_yaw_alignment() -> None:
    groundtruth = make_groundtruth(18)
    tipped = moved(
        groundtruth,
        Similarity(Rotation.from_rotvec([0.6, 0.0, 0.0]).as_matrix(), np.zeros(3)),
    )
    # Without noise it would be the groundtruth itself, which is told instead.
    noise = np.random.default_rng(0).normal(0.0, 0.001, tipped.positions.shape)
    tipped = dataclasses.replace(tipped, positions=tipped.positions + noise)
    result = evaluate(groundtruth, tipped, by(Gauge.YAW))
    assert any("vertical axes" in warning for warning in result.warnings)


def test_a_placeholder_first_pose_is_noticed() -> None:
    groundtruth = make_groundtruth(19)
    assert groundtruth.rotations is not None
    quaternions = groundtruth.rotations.as_quat()
    quaternions[0] = (Rotation.from_rotvec([0.0, 1.8, 0.0]) * groundtruth.rotations[0]).as_quat()
    estimate = dataclasses.replace(groundtruth, quaternions=quaternions)
    result = evaluate(groundtruth, estimate, by(Gauge.SE3, align_states=1))
    assert any("placeholder" in warning for warning in result.warnings)
    fine = evaluate(groundtruth, groundtruth, by(Gauge.SE3, align_states=1))
    assert not any("placeholder" in warning for warning in fine.warnings)


def test_equal_stamps_throughout_are_one_state() -> None:
    groundtruth = make_groundtruth(20)
    stuck = dataclasses.replace(groundtruth, stamps=np.full(len(groundtruth), START + 10**9))
    with pytest.raises(InputError):
        evaluate(stuck, groundtruth, BASE)
    with pytest.raises(DegenerateGeometryError, match="found 1"):
        evaluate(groundtruth, stuck, BASE)
