"""Test of the up axis by the motion: what is believed, doubted and withheld."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_runs import ESTIMATE, GROUNDTRUTH, Live
from ros_bags import POSE, messages_of
from scipy.spatial.transform import Rotation
from strategies import all_statistics, along_line, seeds
from upright_runs import OF_VERTICAL, car, erring, standing

from trajeval_ros import CalibrationRequest
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.geometry.vertical_axis import up_axis_doubt, vertical_axis_of
from trajeval_ros.io.requests.request_from import protocol_from
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.metrics.premises import Premise
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.pipeline.pipeline import evaluate, run
from trajeval_ros.pipeline.request import Request
from trajeval_ros.simulation.drifting_odometry import simulate


def rotated(trajectory: Trajectory, angle_deg: float) -> Trajectory:
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
    assert up_axis_doubt(car(seed, slope_deg=slope_deg)) == ""


@pytest.mark.parametrize("seed", range(10))
def test_flights_walls_lines_and_sheer_positions_are_believed(seed: int) -> None:
    flight = simulate(seed=seed, duration_s=40.0)
    straight = along_line(np.linspace(0.0, 80.0, 400), [1.0, 0.4, 0.0], noise_m=0.02)
    sideways = standing(car(seed, count=30), "-y", states_axis=False)  # it has hardly turned
    for item in (flight.groundtruth, on_a_wall(seed), straight, sideways):
        assert up_axis_doubt(item) == ""
    assert (
        up_axis_doubt(
            dataclasses.replace(standing(car(seed), "x", states_axis=False), quaternions=None)
        )
        == ""
    )


@settings(max_examples=60)
@given(seed=seeds, axis=st.sampled_from(["x", "-x", "y", "-y"]), slope_deg=st.floats(-15.0, 15.0))
def test_a_vehicle_across_another_axis_is_doubted(seed: int, axis: str, slope_deg: float) -> None:
    truth = standing(car(seed, slope_deg=slope_deg), axis, states_axis=False)
    assert f"--up=-{axis[-1]} or --up={axis[-1]};" in up_axis_doubt(truth)
    assert (
        up_axis_doubt(dataclasses.replace(truth, up=UpAxis("z"))) == ""
    )  # whoever says so knows it
    assert up_axis_doubt(dataclasses.replace(truth, up=UpAxis(axis, "frame x_optical"))) == ""


def test_an_estimate_that_turns_about_z_keeps_its_axis() -> None:
    truth = standing(car(1), "y", states_axis=False)
    assert "set --up=y,z or --up=-y,z;" in up_axis_doubt(truth, car(1))
    assert "set --up=-y or --up=y;" in up_axis_doubt(truth, truth)
    positions = dataclasses.replace(car(1), quaternions=None)
    assert "set --up=-y or --up=y;" in up_axis_doubt(truth, positions)
    with pytest.raises(InputError, match="set --up=y,z or"):
        evaluate(truth, car(1), Protocol(gauge="yaw"))


def test_a_wrong_up_axis_and_other_times_are_one_sentence() -> None:
    truth = standing(car(1), "y", states_axis=False)
    later = dataclasses.replace(car(1), stamps=car(1).stamps + 10**18)
    request = Request(Protocol(gauge="yaw"), CalibrationRequest(offset=True))
    with pytest.raises(InputError, match="needs the vertical axis"):
        run(truth, [later], request)


def circling(
    count: int = 400, *, heading: float = np.pi, roll_deg: float = 0.0, height_m: float = 0.0
) -> Trajectory:
    """Return rounds of 1 m x 2 m with headings up to a limit, rolls and heights by turns."""
    angles = np.linspace(-np.pi, np.pi, count)
    by_turns = np.where(np.arange(count) % 2, 1.0, -1.0)
    places = np.column_stack([np.cos(angles), 2.0 * np.sin(angles), height_m * by_turns])
    rotations = np.column_stack([heading / np.pi * angles, roll_deg * np.pi / 180.0 * by_turns])
    stamps = 10**18 + np.arange(count, dtype=np.int64) * 100_000_000
    return Trajectory(stamps, places, Rotation.from_euler("ZX", rotations).as_quat())


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
    axis = vertical_axis_of(inside.positions, inside.quaternions)
    assert axis is not None
    np.testing.assert_allclose(np.abs(axis), [0.0, 0.0, 1.0], atol=0.06)
    assert vertical_axis_of(outside.positions, outside.quaternions) is None


def test_a_format_is_doubted_as_well() -> None:
    truth = dataclasses.replace(car(1), up=UpAxis("-y", "KITTI's camera axes"))
    assert "-y (KITTI's camera axes) is probably not the vertical axis" in up_axis_doubt(truth)
    assert "the z axis; set --up=-z or --up=z;" in up_axis_doubt(truth)


def test_a_frame_that_leans_has_no_axis_to_name() -> None:
    assert "which is not an axis" in up_axis_doubt(rotated(car(1), 52.0))


@pytest.mark.slow
@pytest.mark.parametrize("protocol", ["default", "rpg", "evo", "kitti"])
def test_yaw_and_tilt_are_withheld_and_nothing_else(protocol: str) -> None:
    truth = standing(car(1, count=1500), "-y", states_axis=False)
    rule = protocol_from(protocol, lengths="5,10")
    doubted = evaluate(truth, erring(truth), rule)
    believed = evaluate(dataclasses.replace(truth, up=UpAxis("z")), erring(truth), rule)
    assert any(
        "horizontal, vertical, yaw and tilt errors withheld" in warning
        for warning in doubted.warnings
    )
    assert not any("withheld" in warning for warning in believed.warnings)
    for name, statistics in all_statistics(believed).items():
        of_vertical = name.endswith(OF_VERTICAL)
        printed_by_the_toolbox = protocol == "rpg" and ": " in name
        withheld = of_vertical and not printed_by_the_toolbox
        assert all_statistics(doubted)[name] == (None if withheld else statistics), name
    assert "yaw_deg" not in doubted.to_columns()


@pytest.mark.parametrize("gauge", ["yaw", "planar"])
def test_no_alignment_about_what_is_not_up(gauge: str) -> None:
    truth = standing(car(1), "-y", states_axis=False)
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
    truth = standing(car(5), "-y", states_axis=False)
    both = [*messages_of(truth, GROUNDTRUTH, POSE), *messages_of(erring(truth), ESTIMATE, POSE)]
    both.sort(key=lambda item: item[2])
    live = Live(tmp_path / "live", POSE, gauge="se3")
    live.feed(both[:20])
    [estimate] = live.run.estimates
    assert Premise.UP_AXIS not in estimate.snapshot().doubts.reasons
    live.feed(both[20:])
    snapshot = estimate.snapshot()
    assert "is probably not the vertical axis" in snapshot.doubts.reasons[Premise.UP_AXIS]
    assert snapshot.ate["yaw_deg"] is snapshot.ate["tilt_deg"] is None
    assert snapshot.ate["rotation_deg"] is not None
    live.end()
    [result] = live.result["runs"]
    assert result["ate"]["yaw_deg"] is None
    assert live.finish("--up=-y", "--json", str(tmp_path / "up.json")) == 0
    text = json.loads((tmp_path / "up.json").read_text())
    assert text["groundtruth"]["up"] == {"name": "-y", "origin": "given"}
    assert text["runs"][0]["ate"]["yaw_deg"]["rmse"] < 5.0


@pytest.mark.parametrize("name", ["kitti/KITTI_00_gt.txt", "kitti_odom_eval/09_groundtruth.txt"])
def test_recordings_of_a_car_are_right_as_cameras_and_doubted_as_maps(
    shared_data: Path, name: str
) -> None:
    truth = read_trajectory(shared_data / name)
    assert truth.up.name == "-y"
    assert up_axis_doubt(truth) == ""
    assert "--up=-y or --up=y" in up_axis_doubt(dataclasses.replace(truth, up=Z_UP))


def test_a_recording_in_camera_axes_that_nobody_declared_is_doubted(shared_data: Path) -> None:
    truth = read_trajectory(f"{shared_data}/bags/ROS_example.bag:groundtruth")
    assert truth.up == Z_UP
    assert "the y axis; set --up=-y or --up=y;" in up_axis_doubt(truth)


RIGHT = (
    "euroc/groundtruth/MH_01.txt", "euroc/groundtruth/MH_05.txt",
    "euroc/groundtruth/V1_02_asl.csv", "euroc/groundtruth/V2_03.txt",
    "tum/fr2_desk_groundtruth.txt", "hilti_2021/uzh_run2_mocap.txt",
    "hilti_2021/Campus_2_hdl.txt",
)  # fmt: skip


@pytest.mark.parametrize("name", RIGHT)
def test_recordings_with_z_up_are_believed(shared_data: Path, name: str) -> None:
    assert up_axis_doubt(read_trajectory(shared_data / name).in_order()) == ""
