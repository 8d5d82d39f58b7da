"""`evaluate --time-offset auto --hand-eye auto|FILE`: applied if it is there, and said."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibration_flights import Fault, fly
from scipy.spatial.transform import Rotation

from trajeval_ros.calibration.apply import evaluate_calibrated
from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import DegenerateGeometryError, NoMatchError
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.io.results.requested_json import calibration_json
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.pipeline.pipeline import evaluate
from trajeval_ros.report.requested_lines import calibration_lines

FAULT = Fault(0.1, 0.0, (0.6, -1.0, 1.5), (0.1, -0.05, 0.2))
LEVER_M = np.array(FAULT.lever_m)
YAW = Protocol(gauge=Gauge.YAW, lengths=())
AUTO = CalibrationRequest(offset=True, hand_eye=True)


def write_tum(path: Path, trajectory: Trajectory) -> Path:
    quaternions = trajectory.quaternions
    if quaternions is None:
        quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (len(trajectory), 1))
    rows = zip(trajectory.stamps.tolist(), trajectory.positions, quaternions, strict=True)
    lines = [
        f"{stamp // 10**9}.{stamp % 10**9:09d} " + " ".join(f"{x:.9f}" for x in (*p, *q))
        for stamp, p, q in rows
    ]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture(scope="module")
def pair() -> tuple[Trajectory, Trajectory]:
    return fly(1, 90.0, fault=FAULT)


@pytest.fixture(scope="module")
def files(
    pair: tuple[Trajectory, Trajectory], tmp_path_factory: pytest.TempPathFactory
) -> list[str]:
    folder = tmp_path_factory.mktemp("marker")
    truth, estimate = pair
    return [
        "evaluate",
        "-g",
        str(write_tum(folder / "mocap.txt", truth[::4])),
        "-e",
        str(write_tum(folder / "vio.txt", estimate)),
        "--gauge",
        "yaw",
        "--lengths",
        "none",
    ]


def run_of(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    assert main([*arguments, "--json", "-"]) == 0
    run: dict[str, Any] = json.loads(capsys.readouterr().out)["runs"][0]
    return run


def test_a_marker_and_its_clock_are_found_and_applied(
    files: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    run = run_of([*files, "--time-offset", "auto", "--hand-eye", "auto"], capsys)
    result = run["calibration"]
    offset, hand_eye = result["time_offset"], result["hand_eye"]
    assert offset["applied"]
    assert offset["status"] == "significant"
    assert abs(offset["value_s"] - 0.1) < offset["half_width_95_s"]
    assert run["association"]["time_offset_s"] == offset["value_s"]
    rotation = Rotation.from_quat(hand_eye["rotation"]["xyzw"])
    true = Rotation.from_rotvec(FAULT.rotation_vector)
    assert np.degrees((true.inv() * rotation).magnitude()) < 0.2
    assert hand_eye["rotation"]["applied"]
    assert hand_eye["lever_arm"]["applied"]
    lever_m = np.array(hand_eye["lever_arm"]["value_m"])
    assert (np.abs(lever_m - FAULT.lever_m) < hand_eye["lever_arm"]["half_width_95_m"]).all()
    assert result["errors_of"] == "body"
    assert result["parameters_applied"] == 7
    assert result["ate"]["after"]["position_m"] == run["ate"]["position_m"]["rmse"]
    assert result["ate"]["after"]["position_m"] < 0.7 * result["ate"]["before"]["position_m"]
    assert result["ate"]["before"]["rotation_deg"] > 100.0
    assert result["ate"]["after"]["rotation_deg"] < 3.0


@pytest.mark.parametrize(("time_offset_s", "codes"), [(0.0, 1), (0.1, 0)])
def test_a_clock_that_is_not_corrected_is_told(
    pair: tuple[Trajectory, Trajectory], time_offset_s: float, codes: int
) -> None:
    protocol = dataclasses.replace(YAW, association=AssociationRule(time_offset_s=time_offset_s))
    calibrated = evaluate_calibrated(*pair, protocol, CalibrationRequest(hand_eye=True))
    told = [
        item for item in calibrated.evaluation.remarks if item.code == "clock_offset_not_corrected"
    ]
    assert len(told) == codes
    assert all("by +100" in item.text and "--time-offset auto" in item.text for item in told)


@pytest.mark.parametrize("pairs", [0, 1, 2, 5])
def test_clocks_that_overlap_by_a_pair_or_two_are_brought_together(pairs: int) -> None:
    truth, estimate = fly(5, 60.0)
    # The estimate's first stamps are the groundtruth's last, by its own clock.
    apart_ns = int(truth.stamps[-1] - estimate.stamps[0]) - round((pairs - 1) * 0.05 * 1e9)
    apart = dataclasses.replace(estimate, stamps=estimate.stamps + apart_ns)
    result = evaluate_calibrated(truth, apart, YAW, CalibrationRequest(offset=True))
    assert result.offset_applied
    assert result.calibration is not None
    assert result.calibration.offset.value == pytest.approx([-apart_ns / 1e9], abs=5e-3)
    assert (result.before is None) == (pairs < YAW.gauge.minimum_states)
    text = "before, too few pairs for an alignment" in calibration_lines("", result)[-1]
    assert text == (result.before is None)


@pytest.mark.slow
def test_nothing_is_calibrated_unless_asked_for(
    files: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    run = run_of(files, capsys)
    assert run["calibration"] is None
    assert run["association"]["time_offset_s"] == 0.0
    assert run["ate"]["rotation_deg"]["rmse"] > 100.0


def test_the_terminal_says_what_was_done(
    files: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*files, "--time-offset", "auto", "--hand-eye", "auto"]) == 0
    out = capsys.readouterr().out
    assert "clock offset   +100." in out or "clock offset   +99." in out
    assert "from rotations" in out
    assert out.count("significant, applied") == 3
    assert "ATE of the body" in out
    assert "before" in out


def test_a_right_calibration_is_left_alone() -> None:
    truth, estimate = fly(3, 90.0)
    plain = evaluate(truth, estimate, YAW)
    result = evaluate_calibrated(truth, estimate, YAW, AUTO)
    assert not result.offset_applied
    assert result.hand_eye is None
    assert result.after == result.before
    assert result.evaluation.ate == plain.ate
    assert result.if_applied is not None
    assert result.if_applied.position_m == pytest.approx(result.after.position_m, rel=0.03)


@pytest.mark.parametrize("gauge", [Gauge.YAW, Gauge.SE3, Gauge.SIM3])
def test_positions_alone_have_the_estimate_moved_to_the_marker(gauge: Gauge) -> None:
    truth, estimate = fly(1, 90.0, fault=dataclasses.replace(FAULT, offset_s=0.0), scale=2.0)
    if not gauge.has_scale:
        estimate = dataclasses.replace(estimate, positions=2.0 * estimate.positions)
    truth = dataclasses.replace(truth, quaternions=None)
    protocol = dataclasses.replace(YAW, gauge=gauge)
    result = evaluate_calibrated(truth, estimate, protocol, AUTO)
    assert result.of_marker
    assert result.lever_applied
    assert not result.rotation_applied
    assert result.before is not None
    assert result.after.position_m < 0.8 * result.before.position_m
    known = CalibrationRequest(known=HandEye.of(None, np.array(FAULT.lever_m)), source="x.yaml")
    given = evaluate_calibrated(truth, estimate, protocol, known)
    assert given.after.position_m == pytest.approx(result.after.position_m, rel=0.05)


@pytest.mark.slow
def test_a_lever_arm_along_the_only_axis_is_not_said_to_be_known() -> None:
    times = np.arange(0.0, 120.0, 0.02)
    random = np.random.default_rng(0)
    body = np.column_stack(
        [
            3.0 * np.sin(0.7 * times) + np.sin(1.9 * times),
            2.0 * np.cos(0.9 * times),
            np.sin(1.3 * times),
        ]
    )
    yaw = 1.5 * np.sin(0.5 * times) + 0.8 * np.sin(2.1 * times)
    rotated = Rotation.from_rotvec(np.outer(yaw, [0.0, 0.0, 1.0]))
    shaken = Rotation.from_rotvec(random.normal(0.0, 1e-3, body.shape))
    stamps = np.rint(times * 1e9).astype(np.int64)
    drift = np.cumsum(random.normal(0.0, 2e-4, body.shape), axis=0)
    marker = body + rotated.apply(FAULT.lever_m) + random.normal(0.0, 1e-3, body.shape)
    result = evaluate_calibrated(
        Trajectory(stamps, marker, (rotated * shaken).as_quat()),
        Trajectory(stamps, body + drift, rotated.as_quat()),
        YAW,
        CalibrationRequest(hand_eye=True),
    )
    assert result.lever_applied
    assert not result.rotation_applied
    assert result.parameters_applied == 2
    written = calibration_json(result)["hand_eye"]["lever_arm"]
    for name in ("sigma_m", "half_width_95_m"):
        assert None not in written[name][:2]
        assert written[name][2] is None
    assert written["value_m"] == pytest.approx([*LEVER_M[:2], 0.0], abs=2e-3)
    (line,) = (
        calibration_line
        for calibration_line in calibration_lines("", result)
        if "lever arm" in calibration_line
    )
    assert re.search(r"m \+- 0\.000\d+ 0\.000\d+ \? \(95 %\)", line)


def swinging(extent_m: float, scale: float) -> tuple[Trajectory, Trajectory]:
    """Return exact positions of a marker, and poses of its body in a unit of `scale` metres."""
    times = np.arange(0.0, 60.0, 0.05)
    body = extent_m * np.column_stack(
        [np.sin(0.2 * times), 0.8 * np.cos(0.17 * times), 0.2 * np.sin(0.31 * times)]
    )
    angles = np.column_stack([0.2 * times, 0.1 * np.sin(times), 0.1 * np.cos(times)])
    rotated = Rotation.from_euler("ZYX", angles)
    stamps = np.rint(times * 1e9).astype(np.int64)
    truth = Trajectory(stamps, body + rotated.apply(FAULT.lever_m))
    return truth, Trajectory(stamps, body / scale, rotated.as_quat())


SIM3 = dataclasses.replace(YAW, gauge=Gauge.SIM3)
LEVER = HandEye.of(None, LEVER_M)


@pytest.mark.parametrize("extent_m", [0.3, 4.0, 50.0])
@pytest.mark.parametrize("scale", [1e-3, 0.05, 1.0, 1.3, 10.0, 500.0])
def test_a_lever_arm_in_metres_fits_an_estimate_of_any_unit(extent_m: float, scale: float) -> None:
    truth, estimate = swinging(extent_m, scale)
    result = evaluate_calibrated(
        truth, estimate, SIM3, CalibrationRequest(known=LEVER, source="x.yaml")
    )
    assert result.after.position_m < 1e-9
    assert result.evaluation.alignment.similarity.scale == pytest.approx(scale, rel=1e-9)


def test_the_marker_is_moved_by_the_alignment_s_own_scale() -> None:
    truth, estimate = swinging(2.0, 7.0)
    noise = np.random.default_rng(0).normal(0.0, 0.02, (len(estimate), 3))
    estimate = dataclasses.replace(estimate, positions=estimate.positions + noise)
    result = evaluate_calibrated(
        truth, estimate, SIM3, CalibrationRequest(known=LEVER, source="x.yaml")
    )
    scale = result.evaluation.alignment.similarity.scale
    again = evaluate(truth, LEVER.of_marker(estimate, scale), SIM3)
    assert again.alignment.similarity.scale == pytest.approx(scale, rel=1e-9)


def test_a_body_that_hardly_moves_has_no_scale_beside_its_lever_arm() -> None:
    truth, estimate = swinging(1.0, 1.0)
    assert estimate.rotations is not None
    # The marker rests but for its noise, and the body swings about it.
    noise = np.random.default_rng(0).normal(0.0, 1e-3, (len(estimate), 3))
    truth = dataclasses.replace(truth, positions=noise)
    about = dataclasses.replace(estimate, positions=-estimate.rotations.apply(FAULT.lever_m))
    with pytest.raises(
        DegenerateGeometryError, match="no scale of the estimate is compatible with"
    ):
        evaluate_calibrated(truth, about, SIM3, CalibrationRequest(known=LEVER, source="x.yaml"))


@pytest.mark.slow
def test_all_estimates_share_the_first_one_s_calibration(
    files: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    again = [*files, "-e", files[4], "--time-offset", "auto"]
    assert main([*again, "--json", "-"]) == 0
    first, second = json.loads(capsys.readouterr().out)["runs"]
    assert first["calibration"] == second["calibration"]
    assert second["calibration"]["estimated_from"] == first["estimate"]["name"]


def transform(path: Path, *, body: str = "imu", marker: str = "marker") -> str:
    quaternion = Rotation.from_rotvec(FAULT.rotation_vector).as_quat().tolist()
    x, y, z = np.asarray(FAULT.lever_m).tolist()
    rx, ry, rz, rw = quaternion
    path.write_text(
        f"header: {{stamp: {{sec: 0, nanosec: 0}}, frame_id: {body}}}\n"
        f"child_frame_id: {marker}\n"
        "transform:\n"
        f"  translation: {{x: {x}, y: {y}, z: {z}}}\n"
        f"  rotation: {{x: {rx}, y: {ry}, z: {rz}, w: {rw}}}\n"
        "---\n"
    )
    return str(path)


def test_a_transform_of_a_file_is_applied_as_given(
    files: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = transform(tmp_path / "marker.yaml")
    run = run_of([*files, "--time-offset", "auto", "--hand-eye", file], capsys)
    result = run["calibration"]
    assert result["hand_eye"]["source"] == file
    assert result["parameters_applied"] == 1
    assert result["T_body_marker"]["header"]["frame_id"] == "imu"
    assert result["T_body_marker"]["transform"]["translation"]["x"] == 0.1
    assert run["ate"]["rotation_deg"]["rmse"] < 3.0
    # JSON is YAML: what a result holds can be given to the next run.
    again = tmp_path / "again.yaml"
    again.write_text(json.dumps(result["T_body_marker"]))
    repeated = run_of(
        [*files, "--time-offset", str(result["time_offset"]["value_s"]), "--hand-eye", str(again)],
        capsys,
    )
    assert repeated["ate"] == run["ate"]


def test_moving_there_and_back_changes_nothing(pair: tuple[Trajectory, Trajectory]) -> None:
    truth, _ = pair
    hand_eye = HandEye.of(np.array([0.3, 0.2, -1.0]), np.array([0.3, 0.1, -0.2]))
    there = hand_eye.of_body(truth)
    back = hand_eye.inverse().of_body(there)
    assert np.allclose(back.positions, truth.positions, atol=1e-12)
    assert back.rotations is not None
    assert truth.rotations is not None
    assert (back.rotations.inv() * truth.rotations).magnitude().max() < 1e-12


def test_velocities_of_another_point_are_left_out(pair: tuple[Trajectory, Trajectory]) -> None:
    truth, _ = pair
    moving = dataclasses.replace(truth, velocities=np.ones((len(truth), 3)))
    arm, rotation = np.array([0.1, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    assert HandEye.of(rotation, arm).of_body(moving).velocities is None
    assert HandEye.of(rotation, None).of_body(moving).velocities is not None


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("a: [", "is not valid YAML in line"),
        ("- 1\n- 2\n", "has no transform; write a mapping"),
        ("", "has no transform"),
        ("transfrom: {}\n", "has an unknown key 'transfrom'; did you mean transform?"),
        ("child_frame_id: marker\n", "transform is missing or not a mapping"),
        ("!!python/object/apply:os.system ['true']\n", "is not valid YAML"),
        ("a: 1\na: 2\n", "is not valid YAML"),
        ("\x00", "is not valid YAML"),
        (
            "transform: {translation: {x: 0, y: 0, z: 0}, rotation: {x: 0, y: 0, z: 0, w: 0}}",
            "has length 0 and is not a unit quaternion",
        ),
        (
            "transform: {translation: {x: .nan, y: 0, z: 0}, rotation: {x: 0, y: 0, z: 0, w: 1}}",
            "transform.translation.x must be a number",
        ),
        (
            "transform: {translation: {x: 0, y: 0}, rotation: {x: 0, y: 0, z: 0, w: 1}}",
            "transform.translation.z must be a number, not None",
        ),
        (
            f"transform: {{translation: {{x: 1{'0' * 400}, y: 0, z: 0}}, "
            "rotation: {x: 0, y: 0, z: 0, w: 1}}",
            "has an integer of more than 64 bits",
        ),
    ],
)
def test_files_that_hold_no_transform_are_refused(
    files: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, sentence: str
) -> None:
    file = tmp_path / "marker.yaml"
    file.write_text(text)
    assert main([*files, "--hand-eye", str(file)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert sentence in lines[0]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--time-offset", "soon"], "a number of seconds or auto, not 'soon'"),
        (["--time-offset", "nan"], "the time offset must be within"),
        (["--hand-eye", "nowhere.yaml"], "nowhere.yaml can't be read"),
    ],
)
def test_words_that_mean_nothing_are_refused(
    files: list[str], capsys: pytest.CaptureFixture[str], options: list[str], sentence: str
) -> None:
    assert main([*files, *options]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert sentence in lines[0]


def test_the_inverse_of_what_is_needed_is_refused(pair: tuple[Trajectory, Trajectory]) -> None:
    truth, estimate = (
        dataclasses.replace(item, child_frame=name)
        for item, name in zip(pair, ("marker", "imu"), strict=True)
    )
    hand_eye = HandEye.of(None, np.array([0.1, 0.0, 0.0]))
    wrong = dataclasses.replace(hand_eye, body="marker", marker="imu")
    with pytest.raises(Exception, match="give its inverse, with frame_id imu"):
        evaluate_calibrated(truth, estimate, YAW, CalibrationRequest(known=wrong, source="x"))
    right = dataclasses.replace(hand_eye, body="imu", marker="marker")
    result = evaluate_calibrated(truth, estimate, YAW, CalibrationRequest(known=right, source="x"))
    assert result.evaluation.groundtruth.child_frame == "imu"


@pytest.mark.slow
def test_a_simulated_marker_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = tmp_path / "flight"
    assert main(["simulate", str(bag), "--marker", "--duration", "60"]) == 0
    assert "--time-offset auto --hand-eye auto" in capsys.readouterr().out
    sources = ["-g", f"{bag}:/groundtruth/pose", "-e", f"{bag}:/vio/odometry"]
    options = ["--gauge", "yaw", "--time-offset", "auto", "--hand-eye", "auto"]
    run = run_of(["evaluate", *sources, *options], capsys)
    assert run["calibration"]["time_offset"]["applied"]
    assert run["calibration"]["hand_eye"]["rotation"]["applied"]
    assert run["ate"]["rotation_deg"]["rmse"] < 2.0
    assert main(["simulate", str(tmp_path / "other"), "--marker", "--profile", "euroc"]) == 2


def test_another_clock_without_a_single_match_is_told_why() -> None:
    """A periodic flight matches at several offsets: the message says that `auto` was tried."""
    flight = circle_for(40.0)
    later = dataclasses.replace(flight, stamps=flight.stamps + 1_700_000_000 * NANOSECONDS)
    with pytest.raises(NoMatchError, match=r"auto finds no offset: .* the motion is"):
        evaluate_calibrated(later, flight, Protocol(), CalibrationRequest(offset=True))


def circle_for(seconds: float) -> Trajectory:
    times = np.arange(0.0, seconds, 0.05)
    angles = np.sin(2.0 * times)
    rotations = np.column_stack(
        [np.zeros((len(times), 2)), np.sin(angles / 2), np.cos(angles / 2)]
    )
    places = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(times))])
    return Trajectory((times * NANOSECONDS).astype(np.int64), places, rotations)
