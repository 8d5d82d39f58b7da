"""Frames with any axis up: what is measured, live and recorded, options and pictures."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_feeding import feed
from live_runs import ESTIMATE, GROUNDTRUTH, Live
from ros_bags import POSE, messages_of, write_messages
from ros_processes import assert_same, offline
from scipy.spatial.transform import Rotation
from strategies import all_statistics, make_element, make_pair, moved, seeds
from upright_runs import OF_VERTICAL, axes, car, direction, erring, evaluated, standing, write_tum

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UP_AXES, Z_UP, UpAxis
from trajeval_ros.io.requests.setting import parse_up
from trajeval_ros.io.results.result_json import result_of
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.metrics.evaluation import evaluate_pairs
from trajeval_ros.metrics.protocol import PROTOCOLS, Protocol
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.pipeline.pipeline import evaluate, run
from trajeval_ros.pipeline.request import Request


def write_kitti(path: Path, trajectory: Trajectory) -> None:
    assert trajectory.rotations is not None
    matrices = np.dstack([trajectory.rotations.as_matrix(), trajectory.positions])
    np.savetxt(path, matrices.reshape(-1, 12), fmt="%.17g")


# The axis.


@pytest.mark.parametrize("axis", UP_AXES)
def test_turning_is_a_rotation_that_brings_the_axis_to_z(axis: str) -> None:
    up = UpAxis(axis)
    np.testing.assert_array_equal(up.matrix @ up.matrix.T, np.eye(3))
    assert np.linalg.det(up.matrix) == pytest.approx(1.0)
    np.testing.assert_array_equal(up.matrix @ direction(axis), [0.0, 0.0, 1.0])
    vectors = np.random.default_rng(0).normal(size=(5, 3))
    np.testing.assert_array_equal(up.to_z_up(vectors), vectors @ up.matrix.T)
    across, onward = (np.eye(3)[item] for item in up.level)
    np.testing.assert_array_equal(np.cross(across, onward), direction(axis))


def test_turning_leaves_what_it_was_given_as_it_was() -> None:
    vectors = np.array([[1.0, 2.0, 3.0]])
    UpAxis("-y").to_z_up(vectors)
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


@pytest.mark.slow
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
    result = all_statistics(
        evaluate(standing(truth, truth_axis), standing(estimate, estimate_axis), protocol)
    )
    assert result.keys() == expected.keys()
    for name, statistics in expected.items():
        mine = result[name]
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
        result = evaluate(standing(truth, axis), standing(estimate, axis), protocol).absolute
        assert result.yaw_deg == pytest.approx(4.0)
        assert result.tilt_deg == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
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
    [measured] = result["runs"]
    assert result["groundtruth"]["up"] == {"name": "-y", "origin": "given"}
    assert measured["estimate"]["up"] == {"name": "x", "origin": "given"}
    rotation = Rotation.from_quat(measured["alignment"]["rotation_xyzw"])
    aligned = rotation.apply(its.positions) + measured["alignment"]["translation_m"]
    errors = np.linalg.norm(aligned - truth.positions, axis=1)
    # The continuous groundtruth passes by its samples.
    near = 1e-4 if association == "continuous" else 1e-9
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(
        measured["ate"]["position_m"]["rmse"], rel=near
    )
    assert measured["ate"]["tilt_deg"]["rmse"] < 5.0


@pytest.mark.slow
def test_other_gauges_keep_every_digit_but_yaw_and_tilt() -> None:
    truth, estimate = standing(car(4), "-y"), standing(erring(car(4)), "-y")
    plain = [dataclasses.replace(item, up=UpAxis("z")) for item in (truth, estimate)]
    for gauge in ("none", "se3", "sim3"):
        protocol = Protocol(gauge=gauge)
        result, before = evaluate(truth, estimate, protocol), evaluate(*plain, protocol)
        np.testing.assert_array_equal(result.aligned.positions, before.aligned.positions)
        assert {name.endswith(OF_VERTICAL) for name in all_statistics(before)} == {True, False}
        for name, statistics in all_statistics(before).items():
            same = all_statistics(result)[name] == statistics
            assert same == (not name.endswith(OF_VERTICAL)), name


def test_frames_that_a_gauge_must_not_turn_are_told_apart() -> None:
    truth, estimate = standing(car(4), "-y"), standing(erring(car(4)), "-y")
    other = dataclasses.replace(estimate, up=UpAxis("z"))
    protocol = Protocol(gauge="none")
    assert not any(
        "can't align them" in warning for warning in evaluate(truth, estimate, protocol).warnings
    )
    text = evaluate(truth, other, protocol).warnings
    assert any(
        "the vertical axes differ, groundtruth -y (given)" in item and "can't align them" in item
        for item in text
    )


# Live.


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize("gauge", ["yaw", "se3"])
def test_a_live_run_of_optical_frames_is_the_recorded_one(tmp_path: Path, gauge: str) -> None:
    truth = standing(car(5, count=200), "-y")
    both = [
        *messages_of(truth, GROUNDTRUTH, POSE, "odom_optical"),
        *messages_of(erring(truth), ESTIMATE, POSE, "camera_optical_frame"),
    ]
    both.sort(key=lambda item: item[2])
    write_messages(tmp_path / "bag", both)
    live = Live(tmp_path / "live", POSE, gauge=gauge)
    live.feed(both)
    live.end()
    options = ("--gauge", gauge, "--lengths", "2,4")
    recorded = offline(tmp_path / "bag", tmp_path, GROUNDTRUTH, [ESTIMATE], *options)
    assert recorded["groundtruth"]["up"]["name"] == "-y"
    assert recorded["runs"][0]["ate"]["tilt_deg"]["rmse"] < 5.0
    assert_same(live.result, recorded)


def test_a_live_run_in_a_plane_can_be_given_another_up_axis(tmp_path: Path) -> None:
    both = [*messages_of(car(5), GROUNDTRUTH, POSE), *messages_of(erring(car(5)), ESTIMATE, POSE)]
    live = Live(tmp_path / "live", POSE, gauge="planar")
    live.feed(sorted(both, key=lambda item: item[2]))
    live.end()
    outcome = live.result["runs"][0]["ate"]["position_m"]
    result = tmp_path / "up.json"
    assert live.finish("--up=z", "--json", str(result)) == 0
    assert json.loads(result.read_text())["runs"][0]["ate"]["position_m"] == outcome


# Files, options and pictures.


def test_matrices_of_kitti_are_of_a_camera(tmp_path: Path) -> None:
    write_kitti(tmp_path / "truth.txt", standing(car(1), "-y"))
    write_kitti(tmp_path / "estimate.txt", standing(erring(car(1)), "-y"))
    write_tum(tmp_path / "tum.txt", car(1))
    assert read_trajectory(tmp_path / "truth.txt").up == UpAxis("-y", "KITTI's camera axes")
    assert read_trajectory(tmp_path / "tum.txt").up == Z_UP
    kitti = [read_trajectory(tmp_path / f"{item}.txt") for item in ("truth", "estimate")]
    protocol = dataclasses.replace(PROTOCOLS["kitti"], lengths=(10.0,))
    result = all_statistics(evaluate(kitti[0], kitti[1], protocol))
    level = dataclasses.replace(protocol, re_form="se3")
    expected = all_statistics(evaluate(car(1), erring(car(1)), level))
    for name in ("yaw_deg", "tilt_deg", "10m: yaw_deg", "10m: tilt_deg"):
        mine, other = result[name], expected[name]
        assert mine is not None
        assert other is not None
        assert mine.rmse == pytest.approx(other.rmse, rel=1e-6)


def test_the_option_says_what_is_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_tum(tmp_path / "truth.txt", standing(car(1), "y"))
    write_tum(tmp_path / "estimate.txt", erring(car(1)))
    assert evaluated(tmp_path, "--gauge", "yaw")[0] == 2
    assert "set --up=y,z or --up=-y,z; to keep it" in capsys.readouterr().err
    status, result = evaluated(tmp_path, "--gauge", "yaw", "--up", "y,z")
    assert status == 0
    assert result["runs"][0]["ate"]["position_m"]["rmse"] < 0.5
    text = capsys.readouterr()
    assert "vertical axes: groundtruth z (rotated from y, given), estimate z (given)" in text.out
    assert "evaluated in a frame with the axes z, x, y" in text.err
    status, result = evaluated(tmp_path)
    assert status == 0
    assert result["runs"][0]["ate"]["yaw_deg"] is None
    assert result["groundtruth"]["up"] == {"name": "z", "origin": "assumed"}
    assert "horizontal, vertical, yaw and tilt errors withheld" in capsys.readouterr().err
    assert evaluated(tmp_path, "--up", "q")[0] == 2
    assert "unknown up axis 'q'" in capsys.readouterr().err


@pytest.mark.slow
def test_a_comparison_has_the_same_word(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    style = tmp_path / "matplotlibrc"
    style.write_text("svg.fonttype: none\n")  # letters instead of their outlines
    monkeypatch.setenv("MATPLOTLIBRC", str(style))
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
    result = evaluate(truth, estimate, Protocol(lengths=()))
    [axes] = top_view([result], ["vio"]).axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "z [m]")
    line = next(item for item in axes.lines if item.get_label() == "groundtruth")
    drawn = np.asarray(line.get_xydata())
    np.testing.assert_allclose(drawn[0], truth.positions[0, [0, 2]])
    np.testing.assert_allclose(np.ptp(drawn, axis=0), np.ptp(truth.positions, axis=0)[[0, 2]])
    [axes] = side_view([result], ["vio"]).axes
    assert axes.get_ylabel() == "-y [m]"
    line = next(item for item in axes.lines if item.get_label() == "groundtruth")
    np.testing.assert_allclose(np.asarray(line.get_xydata())[0, 1], -truth.positions[0, 1])


@pytest.mark.slow
def test_rerun_stands_upright(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="pictures need the extra `rerun`")
    from rrd import Rrd

    from trajeval_ros.viewer.recorded_scene import write_recording

    # Rerun's numbers of the directions of x, y and z: UP 1, DOWN 2, RIGHT 3, LEFT 4, FORWARD 5,
    # BACK 6.
    for axis, place, way in (("z", 2, 1), ("-y", 1, 2), ("x", 0, 1)):
        truth, estimate = standing(car(1), axis), standing(erring(car(1)), axis)
        result = evaluate(truth, estimate, Protocol(lengths=()))
        write_recording(tmp_path / "run.rrd", [result])
        _, [view] = Rrd(tmp_path / "run.rrd").rows("world", "ViewCoordinates:xyz")
        assert np.ravel(view)[place] == way
