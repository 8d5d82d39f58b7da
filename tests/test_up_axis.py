"""Which axis is up: said, told by format or frame, doubted where the motion denies it."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from ros_bags import POSE, messages_of, write_messages
from ros_processes import assert_same, offline
from scipy.spatial.transform import Rotation
from strategies import all_statistics, along_line, make_element, make_pair, moved, seeds
from test_live_run import ESTIMATE, TRUTH, Live
from test_online import feed

from trajeval_ros.cli.app import main
from trajeval_ros.diagnosis.vertical import doubt_of, vertical_of
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UP_AXES, Z_UP, UpAxis
from trajeval_ros.io.requests.request_words import parse_up
from trajeval_ros.io.results.result_json import result_of
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.metrics.evaluation import evaluate_pairs
from trajeval_ros.metrics.named_protocols import PROTOCOLS
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.settings import protocol_from
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.pipeline.pipeline import evaluate, run
from trajeval_ros.pipeline.request import Request
from trajeval_ros.visual_inertial.drifting_odometry import simulate

Array = NDArray[np.float64]
axes = st.sampled_from(UP_AXES)

OF_VERTICAL = ("yaw_deg", "tilt_deg", "horizontal_m", "vertical_m")


def direction(axis: str) -> Array:
    unit: Array = (-1.0 if axis.startswith("-") else 1.0) * np.eye(3)["xyz".index(axis[-1])]
    return unit


def standing(trajectory: Trajectory, axis: str, *, said: bool = True) -> Trajectory:
    """Return a trajectory of a z-up world in one that has another axis up."""
    turn = Rotation.align_vectors([direction(axis)], [[0.0, 0.0, 1.0]])[0]
    assert trajectory.rotations is not None
    velocities = trajectory.velocities
    return dataclasses.replace(
        trajectory,
        positions=turn.apply(trajectory.positions),
        quaternions=(turn * trajectory.rotations).as_quat(),
        velocities=None if velocities is None else turn.apply(velocities),
        covariances=None,
        up=UpAxis(axis) if said else Z_UP,
    )


def car(seed: int, *, slope_deg: float = 0.0, count: int = 400) -> Trajectory:
    """Return a vehicle that drives round in a plane, in a world with z up."""
    random = np.random.default_rng(seed)
    rates = 0.3 + 0.4 * np.sin(np.linspace(0.0, 6.0, count) + random.uniform(0.0, 6.0))
    heading = random.uniform(-np.pi, np.pi) + np.cumsum(rates) * 0.1
    ahead = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(count)])
    bumps = random.normal(scale=0.02, size=(count, 2))
    turns = Rotation.from_euler("ZYX", np.column_stack([heading, bumps]))
    slope = Rotation.from_euler("X", slope_deg, degrees=True)
    height = 0.3 * np.sin(np.linspace(0.0, 9.0, count))
    places = np.cumsum(ahead, axis=0) + np.outer(height, [0.0, 0.0, 1.0])
    stamps = 10**18 + np.arange(count, dtype=np.int64) * 100_000_000
    return Trajectory(stamps, slope.apply(places), (slope * turns).as_quat())


def erring(truth: Trajectory, seed: int = 1) -> Trajectory:
    """Return an estimate of a trajectory, in its frame."""
    random = np.random.default_rng(seed)
    assert truth.rotations is not None
    wrong = Rotation.from_rotvec(random.normal(scale=0.03, size=(len(truth), 3)))
    return dataclasses.replace(
        truth,
        positions=truth.positions + random.normal(scale=0.2, size=truth.positions.shape),
        quaternions=(wrong * truth.rotations).as_quat(),
    )


def write_kitti(path: Path, trajectory: Trajectory) -> None:
    assert trajectory.rotations is not None
    matrices = np.dstack([trajectory.rotations.as_matrix(), trajectory.positions])
    np.savetxt(path, matrices.reshape(-1, 12), fmt="%.17g")


def write_tum(path: Path, trajectory: Trajectory) -> None:
    assert trajectory.quaternions is not None
    columns = [trajectory.stamps * 1e-9 % 1e6, trajectory.positions, trajectory.quaternions]
    np.savetxt(path, np.column_stack(columns), fmt="%.12f")


# The axis.


@pytest.mark.parametrize("axis", UP_AXES)
def test_turning_is_a_rotation_that_brings_the_axis_to_z(axis: str) -> None:
    up = UpAxis(axis)
    np.testing.assert_array_equal(up.matrix @ up.matrix.T, np.eye(3))
    assert np.linalg.det(up.matrix) == pytest.approx(1.0)
    np.testing.assert_array_equal(up.matrix @ direction(axis), [0.0, 0.0, 1.0])
    vectors = np.random.default_rng(0).normal(size=(5, 3))
    np.testing.assert_array_equal(up.turned(vectors), vectors @ up.matrix.T)
    across, onward = (np.eye(3)[each] for each in up.level)
    np.testing.assert_array_equal(np.cross(across, onward), direction(axis))


def test_turning_leaves_what_it_was_given_as_it_was() -> None:
    vectors = np.array([[1.0, 2.0, 3.0]])
    UpAxis("-y").turned(vectors)
    np.testing.assert_array_equal(vectors, [[1.0, 2.0, 3.0]])


@pytest.mark.parametrize(
    ("frame", "axis"),
    [("cam0_optical", "-y"), ("camera_optical_frame", "-y"), ("map", "z"), ("optical_map", "z")],
)
def test_a_frame_tells_by_its_name(frame: str, axis: str) -> None:
    assert UpAxis.of_frame(frame).name == axis


def test_words_for_both_sides() -> None:
    assert parse_up("-y") == ("-y", "-y")
    assert parse_up("-y,z") == ("-y", "z")
    for wrong in ("up", "", "z,z,z", "y,"):
        with pytest.raises(SettingsError, match=r"vertical axes|unknown up axis"):
            parse_up(wrong)
    with pytest.raises(SettingsError, match="unknown up axis 'w'"):
        Request(up=("z", "w"))
    with pytest.raises(SettingsError, match="unknown up axis 'w'"):
        OnlineSettings(up=("z", "w"))


# What is measured.


@settings(max_examples=40)
@given(
    seed=seeds,
    gauge=st.sampled_from([Gauge.YAW, Gauge.PLANAR, Gauge.SE3, Gauge.SIM3]),
    states=st.sampled_from([None, 1, 5]),
    form=st.sampled_from(["gauge", "se3", "tutorial"]),
    truth_axis=axes,
    estimate_axis=axes,
)
def test_errors_are_those_of_the_same_motion_in_a_world_with_z_up(
    seed: int, gauge: Gauge, states: int | None, form: str, truth_axis: str, estimate_axis: str
) -> None:
    if gauge.has_scale and states == 1:
        states = None
    pair = make_pair(seed, 120, smooth=True)
    protocol = Protocol(gauge=gauge, align_states=states, re_form=form, lengths=(2, 4))
    element = make_element(gauge, seed)
    estimate = moved(pair.estimate, element)
    if form == "tutorial":  # it depends on the origin
        estimate = pair.estimate
    # Truly up, whatever the motion is like.
    truth = dataclasses.replace(pair.groundtruth, up=UpAxis("z"))
    expected = all_statistics(evaluate(truth, estimate, protocol))
    found = all_statistics(
        evaluate(standing(truth, truth_axis), standing(estimate, estimate_axis), protocol)
    )
    assert found.keys() == expected.keys()
    for name, statistics in expected.items():
        mine = found[name]
        assert (mine is None) == (statistics is None), name
        if mine is not None and statistics is not None:
            assert dataclasses.astuple(mine) == pytest.approx(
                dataclasses.astuple(statistics), rel=1e-6, abs=1e-8
            ), name


def test_yaw_and_tilt_are_about_the_axis() -> None:
    truth = car(1)
    lean = Rotation.from_rotvec(np.radians([0.0, 0.0, 4.0]))
    assert truth.rotations is not None
    estimate = dataclasses.replace(truth, quaternions=(lean * truth.rotations).as_quat())
    protocol = Protocol(gauge="none", lengths=())
    for axis in UP_AXES:
        found = evaluate(standing(truth, axis), standing(estimate, axis), protocol).absolute
        assert found.yaw_deg == pytest.approx(4.0)
        assert found.tilt_deg == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("gauge", "association"),
    [(Gauge.YAW, "linear"), (Gauge.SE3, "linear"), (Gauge.SE3, "continuous")],
)
def test_the_result_aligns_the_files_own_axes(gauge: Gauge, association: str) -> None:
    truth = standing(car(2), "-y")
    its = standing(moved(erring(car(2)), make_element(Gauge.YAW, 3, reach_m=10.0)), "x")
    protocol = Protocol(gauge=gauge, lengths=(), association=association)
    outcome = run(truth, [its], Request(protocol))
    result = result_of(outcome)
    [found] = result["runs"]
    assert result["groundtruth"]["up"] == {"name": "-y", "origin": "given"}
    assert found["estimate"]["up"] == {"name": "x", "origin": "given"}
    turn = Rotation.from_quat(found["alignment"]["rotation_xyzw"])
    aligned = turn.apply(its.positions) + found["alignment"]["translation_m"]
    errors = np.linalg.norm(aligned - truth.positions, axis=1)
    # The continuous groundtruth passes by its samples.
    near = 1e-4 if association == "continuous" else 1e-9
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(
        found["ate"]["position_m"]["rmse"], rel=near
    )
    assert found["ate"]["tilt_deg"]["rmse"] < 5.0


def test_other_gauges_keep_every_digit_but_yaw_and_tilt() -> None:
    truth, estimate = standing(car(4), "-y"), standing(erring(car(4)), "-y")
    plain = [dataclasses.replace(each, up=UpAxis("z")) for each in (truth, estimate)]
    for gauge in ("none", "se3", "sim3"):
        protocol = Protocol(gauge=gauge)
        found, before = evaluate(truth, estimate, protocol), evaluate(*plain, protocol)
        np.testing.assert_array_equal(found.aligned.positions, before.aligned.positions)
        for name, statistics in all_statistics(before).items():
            same = all_statistics(found)[name] == statistics
            assert same == (not name.endswith(OF_VERTICAL)), name


def test_frames_that_a_gauge_must_not_turn_are_told_apart() -> None:
    truth, estimate = standing(car(4), "-y"), standing(erring(car(4)), "-y")
    other = dataclasses.replace(estimate, up=UpAxis("z"))
    protocol = Protocol(gauge="none")
    assert not any(
        "can't align them" in each for each in evaluate(truth, estimate, protocol).warnings
    )
    said = evaluate(truth, other, protocol).warnings
    assert any(
        "the vertical axes differ, groundtruth -y (given)" in each and "can't align them" in each
        for each in said
    )


# Live.


@settings(max_examples=15)
@given(
    seed=seeds,
    gauge=st.sampled_from([Gauge.YAW, Gauge.PLANAR, Gauge.SE3]),
    truth_axis=axes,
    estimate_axis=axes,
)
def test_live_is_offline_whatever_is_up(
    seed: int, gauge: Gauge, truth_axis: str, estimate_axis: str
) -> None:
    pair = make_pair(seed, 120, smooth=True)
    none = {"gyroscope_biases": None, "accelerometer_biases": None}
    truth = standing(dataclasses.replace(pair.groundtruth, **none), truth_axis)
    estimate = standing(dataclasses.replace(pair.estimate, **none), estimate_axis)
    protocol = Protocol(gauge=gauge, lengths=(2, 4))
    live = OnlineEvaluator(OnlineSettings(protocol, up=(truth_axis, estimate_axis)))
    feed(live, truth, estimate)
    recorded = evaluate(truth, estimate, protocol)
    paired = live.association()
    mine = all_statistics(evaluate_pairs(paired, paired.groundtruth, paired.estimate, protocol))
    snapshot = live.snapshot()
    for name, statistics in all_statistics(recorded).items():
        assert (mine[name] is None) == (statistics is None), name
        if statistics is not None:
            expected = dataclasses.astuple(statistics)
            assert dataclasses.astuple(mine[name]) == pytest.approx(expected, rel=1e-9, abs=1e-9)
        if name in ("yaw_deg", "position_m") and statistics is not None:
            shown = snapshot.ate[name]
            assert shown is not None
            assert shown.rmse == pytest.approx(statistics.rmse, rel=1e-9)
    if gauge is Gauge.PLANAR:
        return
    # The alignment that is published is of the frames' own axes.
    alignment = snapshot.alignment
    assert alignment is not None
    nearest = np.searchsorted(truth.stamps, estimate.stamps)
    aligned = alignment.similarity.positions(estimate.positions)
    assert np.linalg.norm(aligned - truth.positions[nearest], axis=1).mean() < 3.0


@pytest.mark.parametrize("gauge", ["yaw", "se3"])
def test_a_live_run_of_optical_frames_is_the_recorded_one(tmp_path: Path, gauge: str) -> None:
    truth = standing(car(5, count=200), "-y")
    both = [
        *messages_of(truth, TRUTH, POSE, "odom_optical"),
        *messages_of(erring(truth), ESTIMATE, POSE, "camera_optical_frame"),
    ]
    both.sort(key=lambda each: each[2])
    write_messages(tmp_path / "bag", both)
    live = Live(tmp_path / "live", POSE, gauge=gauge)
    live.feed(both)
    live.end()
    options = ("--gauge", gauge, "--lengths", "2,4")
    recorded = offline(tmp_path / "bag", tmp_path, TRUTH, [ESTIMATE], *options)
    assert recorded["groundtruth"]["up"]["name"] == "-y"
    assert recorded["runs"][0]["ate"]["tilt_deg"]["rmse"] < 5.0
    assert_same(live.result, recorded)


# What the motion denies.


def turned(trajectory: Trajectory, angle_deg: float) -> Trajectory:
    """Return a trajectory in a world that leans about x."""
    assert trajectory.rotations is not None
    lean = Rotation.from_euler("x", angle_deg, degrees=True)
    return dataclasses.replace(
        trajectory,
        positions=lean.apply(trajectory.positions),
        quaternions=(lean * trajectory.rotations).as_quat(),
    )


def on_a_wall(seed: int) -> Trajectory:
    """Return a drone that flies to and fro before a wall, and looks around."""
    random = np.random.default_rng(seed)
    time = np.linspace(0.0, 60.0, 600)
    places = np.column_stack(
        [8.0 * np.sin(time), 0.2 * np.sin(3.0 * time), 3.0 * np.cos(0.2 * time)]
    )
    angles = np.column_stack([2.0 * np.sin(0.5 * time), *random.normal(scale=0.05, size=(2, 600))])
    stamps = 10**18 + np.arange(600, dtype=np.int64) * 100_000_000
    return Trajectory(stamps, places, Rotation.from_euler("ZYX", angles).as_quat())


@settings(max_examples=60)
@given(seed=seeds, slope_deg=st.floats(-30.0, 30.0))
def test_a_vehicle_on_a_hill_is_believed(seed: int, slope_deg: float) -> None:
    assert doubt_of(car(seed, slope_deg=slope_deg)) == ""


@pytest.mark.parametrize("seed", range(10))
def test_flights_walls_lines_and_sheer_positions_are_believed(seed: int) -> None:
    flight = simulate(seed=seed, duration_s=40.0)
    straight = along_line(np.linspace(0.0, 80.0, 400), [1.0, 0.4, 0.0], noise_m=0.02)
    sideways = standing(car(seed, count=30), "-y", said=False)  # it has hardly turned
    for each in (flight.groundtruth, on_a_wall(seed), straight, sideways):
        assert doubt_of(each) == ""
    assert (
        doubt_of(dataclasses.replace(standing(car(seed), "x", said=False), quaternions=None)) == ""
    )


@settings(max_examples=60)
@given(seed=seeds, axis=st.sampled_from(["x", "-x", "y", "-y"]), slope_deg=st.floats(-15.0, 15.0))
def test_a_vehicle_across_another_axis_is_doubted(seed: int, axis: str, slope_deg: float) -> None:
    truth = standing(car(seed, slope_deg=slope_deg), axis, said=False)
    assert f"--up=-{axis[-1]} or --up={axis[-1]};" in doubt_of(truth)
    assert doubt_of(dataclasses.replace(truth, up=UpAxis("z"))) == ""  # whoever says so knows it
    assert doubt_of(dataclasses.replace(truth, up=UpAxis(axis, "frame x_optical"))) == ""


def circling(
    count: int = 400, *, heading: float = np.pi, roll_deg: float = 0.0, height_m: float = 0.0
) -> Trajectory:
    """Return rounds of 1 m x 2 m with headings up to a limit, rolls and heights by turns."""
    angles = np.linspace(-np.pi, np.pi, count)
    by_turns = np.where(np.arange(count) % 2, 1.0, -1.0)
    places = np.column_stack([np.cos(angles), 2.0 * np.sin(angles), height_m * by_turns])
    turns = np.column_stack([heading / np.pi * angles, roll_deg * np.pi / 180.0 * by_turns])
    stamps = 10**18 + np.arange(count, dtype=np.int64) * 100_000_000
    return Trajectory(stamps, places, Rotation.from_euler("ZX", turns).as_quat())


@pytest.mark.parametrize(
    ("inside", "outside"),
    [
        (circling(roll_deg=17.0), circling(roll_deg=19.5)),  # cos: 0.956, 0.943
        (circling(heading=1.71), circling(heading=1.61)),  # sin(a) / a: 0.579, 0.621
        (circling(height_m=0.33), circling(height_m=0.38)),  # of sqrt(0.5) m across: 0.47, 0.54
        (circling(20), circling(19)),
    ],
    ids=["held", "turned", "flat", "states"],
)
def test_what_motion_shows_a_vertical(inside: Trajectory, outside: Trajectory) -> None:
    assert inside.quaternions is not None
    assert outside.quaternions is not None
    axis = vertical_of(inside.positions, inside.quaternions)
    assert axis is not None
    np.testing.assert_allclose(np.abs(axis), [0.0, 0.0, 1.0], atol=0.06)
    assert vertical_of(outside.positions, outside.quaternions) is None


def test_from_what_angle_on_an_axis_is_doubted_and_another_named() -> None:
    assert doubt_of(turned(circling(), 44.5)) == ""
    assert "which is not an axis" in doubt_of(turned(circling(), 45.5))
    assert "which is not an axis" in doubt_of(turned(circling(), 69.5))
    assert "the y axis" in doubt_of(turned(circling(), 70.5))


def test_of_long_runs_twenty_thousand_states_are_looked_at() -> None:
    for count, is_seen in ((40_000, False), (20_000, True)):
        run = circling(count)
        assert run.quaternions is not None
        rolled = run.quaternions.copy()
        rolled[1::2] = circling(count, roll_deg=90.0).quaternions[1::2]  # type: ignore[index]
        assert (vertical_of(run.positions, rolled) is None) is is_seen


def test_a_format_is_doubted_as_well() -> None:
    truth = dataclasses.replace(car(1), up=UpAxis("-y", "KITTI's camera axes"))
    assert "-y (KITTI's camera axes) is probably not the vertical axis" in doubt_of(truth)
    assert "the z axis; set --up=-z or --up=z;" in doubt_of(truth)


def test_a_frame_that_leans_has_no_axis_to_name() -> None:
    assert "which is not an axis" in doubt_of(turned(car(1), 52.0))


@pytest.mark.parametrize("protocol", ["default", "rpg", "evo", "kitti"])
def test_yaw_and_tilt_are_withheld_and_nothing_else(protocol: str) -> None:
    truth = standing(car(1, count=1500), "-y", said=False)
    rule = protocol_from(protocol, lengths="5,10")
    doubted = evaluate(truth, erring(truth), rule)
    believed = evaluate(dataclasses.replace(truth, up=UpAxis("z")), erring(truth), rule)
    assert any(
        "yaw, tilt, horizontal and vertical errors withheld" in each for each in doubted.warnings
    )
    assert not any("withheld" in each for each in believed.warnings)
    for name, statistics in all_statistics(believed).items():
        of_vertical = name.endswith(OF_VERTICAL)
        printed_by_the_toolbox = protocol == "rpg" and ": " in name
        withheld = of_vertical and not printed_by_the_toolbox
        assert all_statistics(doubted)[name] == (None if withheld else statistics), name
    assert "yaw_deg" not in doubted.to_columns()


@pytest.mark.parametrize("gauge", ["yaw", "planar"])
def test_no_alignment_about_what_is_not_up(gauge: str) -> None:
    truth = standing(car(1), "-y", said=False)
    estimate = erring(truth)
    protocol = Protocol(gauge=gauge)
    for evaluated in (
        lambda: evaluate(truth, estimate, protocol),
        lambda: run(truth, [estimate], Request(protocol)),
    ):
        with pytest.raises(InputError, match=r"set --up=-y or --up=y"):
            evaluated()
    right = run(truth, [estimate], Request(protocol, up=("-y", "-y"))).runs[0].evaluation
    position = right.ate["position_m"]
    assert position is not None
    assert position.rmse < 0.5


def test_a_live_run_doubts_as_well(tmp_path: Path) -> None:
    truth = standing(car(5), "-y", said=False)
    both = [*messages_of(truth, TRUTH, POSE), *messages_of(erring(truth), ESTIMATE, POSE)]
    both.sort(key=lambda each: each[2])
    live = Live(tmp_path / "live", POSE, gauge="se3")
    live.feed(both[:20])
    [estimate] = live.run.estimates
    estimate.snapshot()
    assert estimate.doubt == ""
    live.feed(both[20:])
    snapshot = estimate.snapshot()
    assert estimate.evaluator.snapshot().ate["yaw_deg"] is not None
    assert "is probably not the vertical axis" in estimate.doubt
    assert snapshot.ate["yaw_deg"] is snapshot.ate["tilt_deg"] is None
    assert snapshot.ate["rotation_deg"] is not None
    live.end()
    [found] = live.result["runs"]
    assert found["ate"]["yaw_deg"] is None
    assert live.finish("--up=-y", "--json", str(tmp_path / "up.json")) == 0
    said = json.loads((tmp_path / "up.json").read_text())
    assert said["groundtruth"]["up"] == {"name": "-y", "origin": "given"}
    assert said["runs"][0]["ate"]["yaw_deg"]["rmse"] < 5.0


def test_a_live_run_in_a_plane_keeps_its_plane(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    both = [*messages_of(car(5), TRUTH, POSE), *messages_of(erring(car(5)), ESTIMATE, POSE)]
    live = Live(tmp_path / "live", POSE, gauge="planar")
    live.feed(sorted(both, key=lambda each: each[2]))
    live.end()
    assert live.finish("--up=-y") == 2
    assert "evaluate a bag" in capsys.readouterr().err


# Files, options and pictures.


def test_matrices_of_kitti_are_of_a_camera(tmp_path: Path) -> None:
    write_kitti(tmp_path / "truth.txt", standing(car(1), "-y"))
    write_kitti(tmp_path / "estimate.txt", standing(erring(car(1)), "-y"))
    write_tum(tmp_path / "tum.txt", car(1))
    assert read_trajectory(tmp_path / "truth.txt").up == UpAxis("-y", "KITTI's camera axes")
    assert read_trajectory(tmp_path / "tum.txt").up == Z_UP
    kitti = [read_trajectory(tmp_path / f"{each}.txt") for each in ("truth", "estimate")]
    protocol = dataclasses.replace(PROTOCOLS["kitti"], lengths=(10.0,))
    found = all_statistics(evaluate(kitti[0], kitti[1], protocol))
    level = dataclasses.replace(protocol, re_form="se3")
    expected = all_statistics(evaluate(car(1), erring(car(1)), level))
    for name in ("yaw_deg", "tilt_deg", "10m: yaw_deg", "10m: tilt_deg"):
        mine, other = found[name], expected[name]
        assert mine is not None
        assert other is not None
        assert mine.rmse == pytest.approx(other.rmse, rel=1e-6)


def evaluated(folder: Path, *options: str) -> tuple[int, Any]:
    arguments = ["evaluate", "-g", str(folder / "truth.txt"), "-e", str(folder / "estimate.txt")]
    file = folder / "result.json"
    file.unlink(missing_ok=True)
    status = main([*arguments, "--json", str(file), *options])
    return status, json.loads(file.read_text()) if file.exists() else None


def test_the_option_says_what_is_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_tum(tmp_path / "truth.txt", standing(car(1), "y"))
    write_tum(tmp_path / "estimate.txt", erring(car(1)))
    assert evaluated(tmp_path, "--gauge", "yaw")[0] == 2
    assert "set --up=-y or --up=y" in capsys.readouterr().err
    status, result = evaluated(tmp_path, "--gauge", "yaw", "--up", "y,z")
    assert status == 0
    assert result["runs"][0]["ate"]["position_m"]["rmse"] < 0.5
    said = capsys.readouterr()
    assert "vertical axes: groundtruth z (rotated from y, given), estimate z (given)" in said.out
    assert "evaluated in a frame with the axes z, x, y" in said.err
    status, result = evaluated(tmp_path)
    assert status == 0
    assert result["runs"][0]["ate"]["yaw_deg"] is None
    assert result["groundtruth"]["up"] == {"name": "z", "origin": "assumed"}
    assert "yaw, tilt, horizontal and vertical errors withheld" in capsys.readouterr().err
    assert evaluated(tmp_path, "--up", "q")[0] == 2
    assert "unknown up axis 'q'" in capsys.readouterr().err


def test_a_comparison_has_the_same_word(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    write_tum(tmp_path / "truth_a.txt", standing(car(1), "-y"))
    write_tum(tmp_path / "vio_a.txt", standing(erring(car(1)), "-y"))
    config = tmp_path / "config.yaml"
    config.write_text(
        "groundtruth: truth_{sequence}.txt\nruns: {vio: 'vio_{sequence}.txt'}\n"
        "gauge: yaw\nup: -y\nlengths: none\n"
    )
    assert main(["compare", str(config), "--output", str(tmp_path / "out"), "--quiet"]) == 0
    page = (tmp_path / "out" / "report.html").read_text()
    assert "z [m]" in page
    assert "y [m]" not in page


def test_pictures_look_down() -> None:
    pytest.importorskip("matplotlib", reason="figures need the extra `plot`")
    from trajeval_ros.report.trajectory_figure import side_view, top_view

    truth, estimate = standing(car(1), "-y"), standing(erring(car(1)), "-y")
    found = evaluate(truth, estimate, Protocol(lengths=()))
    [axes] = top_view([found], ["vio"]).axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "z [m]")
    line = next(each for each in axes.lines if each.get_label() == "groundtruth")
    drawn = np.asarray(line.get_xydata())
    np.testing.assert_allclose(drawn[0], truth.positions[0, [0, 2]])
    np.testing.assert_allclose(np.ptp(drawn, axis=0), np.ptp(truth.positions, axis=0)[[0, 2]])
    [axes] = side_view([found], ["vio"]).axes
    assert axes.get_ylabel() == "-y [m]"
    line = next(each for each in axes.lines if each.get_label() == "groundtruth")
    np.testing.assert_allclose(np.asarray(line.get_xydata())[0, 1], -truth.positions[0, 1])


def test_rerun_stands_upright(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="pictures need the extra `rerun`")
    from rrd import Rrd

    from trajeval_ros.viewer.recorded_scene import write_recording

    # Rerun's numbers of the directions of x, y and z: UP 1, DOWN 2, RIGHT 3, LEFT 4, FORWARD 5,
    # BACK 6.
    for axis, place, way in (("z", 2, 1), ("-y", 1, 2), ("x", 0, 1)):
        truth, estimate = standing(car(1), axis), standing(erring(car(1)), axis)
        found = evaluate(truth, estimate, Protocol(lengths=()))
        write_recording(tmp_path / "run.rrd", [found])
        _, [view] = Rrd(tmp_path / "run.rrd").rows("world", "ViewCoordinates:xyz")
        assert np.ravel(view)[place] == way


@pytest.mark.parametrize("name", ["kitti/KITTI_00_gt.txt", "kitti_odom_eval/09_groundtruth.txt"])
def test_recordings_of_a_car_are_right_as_cameras_and_doubted_as_maps(
    shared_data: Path, name: str
) -> None:
    truth = read_trajectory(shared_data / name)
    assert truth.up.name == "-y"
    assert doubt_of(truth) == ""
    assert "--up=-y or --up=y" in doubt_of(dataclasses.replace(truth, up=Z_UP))


def test_a_recording_in_camera_axes_that_nobody_declared_is_doubted(shared_data: Path) -> None:
    truth = read_trajectory(f"{shared_data}/bags/ROS_example.bag:groundtruth")
    assert truth.up == Z_UP
    assert "the y axis; set --up=-y or --up=y;" in doubt_of(truth)


RIGHT = (
    "euroc/groundtruth/MH_01.txt", "euroc/groundtruth/MH_05.txt",
    "euroc/groundtruth/V1_02_asl.csv", "euroc/groundtruth/V2_03.txt",
    "tum/fr2_desk_groundtruth.txt", "hilti_2021/uzh_run2_mocap.txt",
    "hilti_2021/Campus_2_hdl.txt",
)  # fmt: skip


@pytest.mark.parametrize("name", RIGHT)
def test_recordings_with_z_up_are_believed(shared_data: Path, name: str) -> None:
    assert doubt_of(read_trajectory(shared_data / name).in_order()) == ""
