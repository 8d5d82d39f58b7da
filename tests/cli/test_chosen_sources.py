"""`trajeval RECORDING`: sources and sensors by likely roles, stated, or two commands."""

from __future__ import annotations

import dataclasses
import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_bags import TYPES, header, write
from ros_bags import POSE, messages_of

from trajeval_ros.cli.app import main
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.describe import Description, TrajectorySummary, recognised
from trajeval_ros.io.roles import likely_evaluations
from trajeval_ros.simulation.drifting_odometry import simulate

IMU, IMAGE, CLOUD = "sensor_msgs/msg/Imu", "sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2"
ODOM = "nav_msgs/msg/Odometry"
LEFT, RIGHT, DEPTH = ("/left/image_raw", IMAGE), ("/right/image_raw", IMAGE), ("/depth", IMAGE)
INERTIAL, POINTS = ("/imu", IMU), ("/points", CLOUD)
TRUTH = ("/mocap/pose", POSE)
GROUNDTRUTHS = ("/mocap/pose", "/ground_truth", "/vicon/pose")
FLIGHT = simulate(seed=2, duration_s=12.0)


def sensor(kind: str, stamp: int) -> Any:
    """Return a message without data; only its type matters."""
    message, zeros, none = TYPES[kind], np.zeros(9), np.zeros(0, dtype=np.uint8)
    if kind == IMU:
        vector = TYPES["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
        rotation = TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        return message(header(stamp), rotation, zeros, vector, zeros, vector, zeros)
    if kind == IMAGE:
        return message(header(stamp), 0, 0, "mono8", 0, 0, none)
    return message(header(stamp), 0, 0, [], False, 0, 0, none, True)


def bag(folder: Path, *topics: tuple[str, str], estimate: Trajectory = FLIGHT.estimate) -> Path:
    """Write a bag: groundtruth of /mocap and names alike, estimates of other poses, sensors."""
    messages: list[Any] = []
    truth = FLIGHT.groundtruth[::20]
    for name, kind in topics:
        if kind in (POSE, ODOM):
            is_truth = any(word in name for word in ("truth", "mocap", "vicon"))
            source: Trajectory = truth if is_truth else estimate
            messages += messages_of(source, name, kind, frame=name.strip("/").partition("/")[0])
        else:
            stamps = truth.stamps[::50].tolist()
            messages += [(name, kind, stamp, sensor(kind, stamp)) for stamp in stamps]
    return write(folder / "run", sorted(messages, key=lambda message: message[2]))


CASES = {
    "vio": ([TRUTH, ("/vio/odometry", ODOM), INERTIAL, LEFT], "stereo-inertial"),
    "vins": ([TRUTH, ("/vins_estimator/odometry", ODOM), INERTIAL, LEFT], "stereo-inertial"),
    "rko_lio": ([TRUTH, ("/rko_lio/odom", ODOM), INERTIAL, POINTS], "lidar-inertial"),
    "kiss": ([TRUTH, ("/kiss/odometry", ODOM), POINTS], "lidar"),
    "small_gicp": ([TRUTH, ("/small_gicp/odometry", ODOM)], "lidar"),
    "rtabmap": ([TRUTH, ("/rtabmap/odom", ODOM), LEFT, DEPTH], "rgbd"),
    "robot_localization": ([TRUTH, ("/odometry/filtered", ODOM), INERTIAL], "wheel"),
    "wheels": ([TRUTH, ("/wheel/odom", ODOM), INERTIAL], "wheel"),
    "isaac": ([TRUTH, ("/visual_slam/tracking/odometry", ODOM)], "stereo-inertial"),
    "zed": ([TRUTH, ("/zed/zed_node/odom", ODOM)], "stereo-inertial"),
    "mono": ([TRUTH, ("/orb_slam3/pose", POSE), LEFT], "mono"),
    "stereo": ([TRUTH, ("/orb_slam3/pose", POSE), LEFT, RIGHT], "stereo"),
    "rgbd": ([TRUTH, ("/orb_slam3/pose", POSE), LEFT, DEPTH], "rgbd"),
    "inertial": ([TRUTH, ("/orb_slam3/pose", POSE), LEFT, INERTIAL], "mono-inertial"),
    "lidar": ([TRUTH, ("/estimator/pose", POSE), POINTS], "lidar"),
    "lidar_inertial": ([TRUTH, ("/estimator/pose", POSE), POINTS, INERTIAL], "lidar-inertial"),
    "unknown": ([TRUTH, ("/estimator/pose", POSE)], ""),
    "cameras_and_lidar": ([TRUTH, ("/estimator/pose", POSE), LEFT, POINTS], ""),
    "ground_truth": ([("/ground_truth", POSE), ("/vicon/pose", POSE), ("/vio/o", ODOM)],
        "stereo-inertial"),
    "two_estimates": ([TRUTH, ("/vio/a", ODOM), ("/okvis/b", ODOM)], "stereo-inertial"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_a_recording_alone_is_evaluated_and_every_choice_is_stated(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    topics, modality = CASES[case]
    recording, saved, again = bag(tmp_path, *topics), tmp_path / "a.json", tmp_path / "b.json"
    assert main([str(recording), f"--json={saved}"]) == 0
    printed = capsys.readouterr()
    assert f"groundtruth {topics[0][0]}: by its name" in printed.err
    assert "change it with -g" in printed.err
    assert "--modality" in printed.err
    (command,) = [line for line in printed.out.splitlines() if line.startswith("repeat: ")]
    words = shlex.split(command.removeprefix("repeat: trajeval "))
    assert (f"--modality {modality}" in command) == bool(modality)
    assert main([*[word for word in words if "json" not in word], f"--json={again}"]) == 0
    first, second = (json.loads(path.read_text()) for path in (saved, again))
    assert [run["ate"] for run in first["runs"]] == [run["ate"] for run in second["runs"]]
    assert len(first["runs"]) == sum(
        kind in (POSE, ODOM) for name, kind in topics if name not in GROUNDTRUTHS
    )


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize(
    ("topics", "count"),
    [
        ([("/mocap/pose", POSE), ("/vicon/pose", POSE), ("/vio/odometry", ODOM)], 2),
        ([TRUTH, ("/vio/odometry", ODOM), ("/wheel/odom", ODOM)], 2),
        ([("/a", POSE), ("/b", POSE)], 2),
    ],
)
def test_equally_likely_choices_are_listed_and_none_is_evaluated(
    topics: list[tuple[str, str]], count: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = bag(tmp_path, *topics)
    assert main([str(recording), "--output", str(tmp_path / "out")]) == 2
    printed = capsys.readouterr()
    commands = printed.out.splitlines()
    assert len(commands) == count
    assert f"{count} likely evaluations" in printed.err
    assert not (tmp_path / "out").exists()
    for command in commands:
        assert main(shlex.split(command)[1:]) == 0


@pytest.mark.parametrize(
    ("topics", "sentence"),
    [
        ([("/vio/odometry", ODOM)], "has no likely groundtruth; name it: trajeval evaluate -g"),
        ([TRUTH], "has no two likely sides; list its topics: trajeval info"),
        ([INERTIAL], "has no two likely sides"),
    ],
)
def test_a_recording_without_a_side_is_refused(
    topics: list[tuple[str, str]],
    sentence: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["evaluate", str(bag(tmp_path, *topics))]) == 2
    assert sentence in capsys.readouterr().err


@pytest.mark.parametrize("words", [["{}"], ["evaluate", "{}"]])
@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("missing.mcap", "", "missing.mcap does not exist; check the path"),
        ("pointer.mcap", "version https://git-lfs.github.com/spec/v1\n", "a pointer of Git LFS"),
    ],
)
def test_a_recording_that_cannot_be_read_alone_says_why(
    name: str,
    content: str,
    reason: str,
    words: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if content:
        (tmp_path / name).write_text(content)
    assert main([word.format(tmp_path / name) for word in words]) == 2
    assert reason in capsys.readouterr().err


def test_missing_text_files_are_no_verbs(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["missing.txt", "estimate.txt"]) == 2
    assert "missing.txt does not exist" in capsys.readouterr().err


def test_a_folder_of_text_files_is_evaluated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    for name, side in (("groundtruth", FLIGHT.groundtruth[::20]), ("vio", FLIGHT.estimate)):
        rows = np.column_stack([side.stamps / 1e9, side.positions, side.quaternions])
        np.savetxt(folder / f"{name}.txt", rows, fmt="%.9f")
    assert main([str(folder)]) == 0
    assert "groundtruth groundtruth.txt: by its name" in capsys.readouterr().err


def test_runs_of_a_folder_are_not_mixed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for run in ("first", "second"):
        bag(tmp_path / "all" / run, TRUTH, ("/vio/odometry", ODOM))
    assert main([str(tmp_path / "all")]) == 2
    commands = [shlex.split(line) for line in capsys.readouterr().out.splitlines()]
    assert len(commands) == 2
    for _, _, _, groundtruth, _, estimate, *_ in commands:
        assert groundtruth.rpartition(":")[0] == estimate.rpartition(":")[0]


def test_options_of_one_system_are_not_proposed_for_others(tmp_path: Path) -> None:
    truth = TrajectorySummary("run:/mocap/pose", POSE, 10, could_be="groundtruth")
    system = recognised(ODOM, "/ov_msckf/odomimu", "global", "imu")
    openvins = TrajectorySummary("run:/ov_msckf/odomimu", ODOM, 10, system=system)
    other = TrajectorySummary("run:/vio/odometry", ODOM, 10)
    for estimates, has_options in (((openvins,), True), ((openvins, other), False)):
        (likely,) = likely_evaluations(Description(tmp_path, (truth, *estimates)))
        assert len(likely.estimates) == len(estimates)
        assert ("--covariance message" in likely.command()) == has_options


def test_a_gauge_of_the_user_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = bag(tmp_path, TRUTH, ("/vio/odometry", ODOM), ("/wheel/odom", ODOM))
    assert main([str(recording), "--gauge", "se3"]) == 0
    printed = capsys.readouterr()
    assert "--modality" not in printed.out.splitlines()[-1]
    assert printed.out.splitlines()[-1].endswith("--gauge se3")
    assert "sensors" not in printed.err


@pytest.mark.parametrize(
    "options", [[], ["--lengths", "4"], ["--strict"], ["--covariance", "message"]]
)
def test_the_result_is_that_of_the_repeating_command(
    options: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    growth = np.linspace(0.5, 2.0, len(FLIGHT.estimate))
    covariances = growth[:, None, None] * np.diag([0.01, 0.01, 0.04, 1e-4, 1e-4, 4e-4])
    estimate = dataclasses.replace(FLIGHT.estimate, covariances=covariances)
    topics = TRUTH, ("/vio/odometry", ODOM), ("/okvis/odometry", ODOM), INERTIAL
    recording = bag(tmp_path, *topics, estimate=estimate)
    assert main([str(recording), "--json", str(tmp_path / "one.json"), *options]) == 0
    command = capsys.readouterr().out.partition("repeat: ")[2].splitlines()[0]
    _, *words = shlex.split(command)
    words[words.index(str(tmp_path / "one.json"))] = str(tmp_path / "other.json")
    assert main(words) == 0
    one, other = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("one", "other"))
    remarks = one["groundtruth"]["remarks"]
    one["groundtruth"]["remarks"] = [item for item in remarks if item["code"] != "assumed"]
    assert one == other


@pytest.mark.parametrize("options", [[], ["--strict"]])
def test_a_recording_is_read_once(
    options: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from trajeval_ros.io.bags import topic_readers

    passes = []
    reading = topic_readers.read_topics

    def counted(*arguments: Any) -> None:
        passes.append(arguments)
        reading(*arguments)

    for module in ("topic_readers", "topics"):
        monkeypatch.setattr(f"trajeval_ros.io.bags.{module}.read_topics", counted)
    recording = bag(tmp_path, TRUTH, ("/vio/odometry", ODOM), INERTIAL)
    assert main([str(recording), *options]) == 0
    assert len(passes) == 1 + len(options)


def test_a_folder_of_many_runs_is_for_a_comparison(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in range(21):
        (tmp_path / f"run_{number}.txt").write_text("1 0 0 0 0 0 0 1\n2 1 0 0 0 0 0 1\n")
    assert main([str(tmp_path)]) == 2
    text = capsys.readouterr().err
    assert "21 sources" in text
    assert f"trajeval compare {tmp_path}" in text
