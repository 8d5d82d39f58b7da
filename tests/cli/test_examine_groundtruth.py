"""`trajeval groundtruth`: table, files, the repaired groundtruth in an evaluation, bad input."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from examined_rigs import rig

from trajeval_ros import simulate
from trajeval_ros.cli.app import main
from trajeval_ros.geometry import lie
from trajeval_ros.io.bags.write_bag import write_bag
from trajeval_ros.io.sources import read_trajectory


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = rig(2, turn_deg=(3.0, -2.0, 1.5), offset_s=0.012)
    path = tmp_path_factory.mktemp("rig") / "run"
    pose = "geometry_msgs/msg/PoseStamped"
    write_bag(path, {"/mocap": (made.groundtruth, pose)}, inertial={"/imu": made.readings})
    return path


@pytest.mark.slow
def test_a_groundtruth_is_repaired_and_evaluated_against(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib", reason="figures need the extra `plot`")
    pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")
    from rrd import Rrd

    output, picture = tmp_path / "out", tmp_path / "g.rrd"
    files = ["--json", str(tmp_path / "g.json"), "--figure", str(tmp_path / "g.png")]
    command = ["groundtruth", f"{bag}:/mocap", "--imu", f"{bag}:/imu", *files]
    saving = ["--save-as", "mcap", "--output", str(output), "--rrd", str(picture)]
    assert main([*command, *saving]) == 0
    text = capsys.readouterr().out
    assert "is rotated by 3.9" in text
    assert "covariances are lower limits" in text
    result = json.loads((tmp_path / "g.json").read_text())
    assert result["schema"] == "trajeval-groundtruth/1"
    by_name = {cause["name"]: cause for cause in result["causes"]}
    assert by_name["body_rotation"]["verdict"] == "significant"
    assert by_name["clock_offset"]["value"] == pytest.approx(12.0, abs=2.2)
    assert result["clock"]["offset_s"] == pytest.approx(0.012, abs=2.2e-3)
    assert (tmp_path / "g.png").read_bytes().startswith(b"\x89PNG")
    assert {"world/groundtruth/path/past", "metrics/position_error/repaired"} <= Rrd(
        picture
    ).entities
    repaired = read_trajectory(f"{output}/groundtruth.mcap:/groundtruth")
    assert len(repaired) == result["repaired"]["poses"]
    evaluated = [
        "evaluate", "-g", f"{output}/groundtruth.mcap:/groundtruth",
        "-e", f"{output}/groundtruth.mcap:/groundtruth", "--gauge", "se3", "--lengths", "none",
        "--covariance", "message", "--groundtruth-noise", "0.001,0.05",
        "--json", str(tmp_path / "e.json"), "--quiet",
    ]  # fmt: skip
    assert main(evaluated) == 0
    assert json.loads((tmp_path / "e.json").read_text())["runs"][0]["consistency"]


@pytest.mark.slow
def test_positions_alone_are_repaired(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib", reason="figures need the extra `plot`")
    made = rig(2, lever_m=(0.05, -0.03, 0.02))
    truth, prism = made.groundtruth, tmp_path / "prism.txt"
    np.savetxt(prism, np.column_stack([truth.stamps / 1e9, truth.positions]), fmt="%.9f")
    write_bag(tmp_path / "run", {}, inertial={"/imu": made.readings})
    command = ["groundtruth", str(prism), "--imu", f"{tmp_path}/run:/imu", "--save-as", "tum"]
    files = ["--json", str(tmp_path / "g.json"), "--figure", str(tmp_path / "g.svg")]
    assert main([*command, *files, "--output", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert "refers to a point 6" in text
    assert "Noise of a pose per axis: 0.5 mm." in text
    assert "body rotation        unobservable" in text
    result = json.loads((tmp_path / "g.json").read_text())
    assert result["noise"]["rotation_rad"] is None
    assert (tmp_path / "g.svg").is_file()
    assert read_trajectory(str(tmp_path / "groundtruth.txt")).quaternions is not None


@pytest.mark.slow
def test_velocities_and_biases_are_saved(bag: Path, tmp_path: Path) -> None:
    command = ["groundtruth", f"{bag}:/mocap", "--imu", f"{bag}:/imu", "--imu-noise", "1e-3,2e-2"]
    assert main([*command, "--save-as", "euroc", "--output", str(tmp_path), "--quiet"]) == 0
    repaired = read_trajectory(str(tmp_path / "groundtruth.csv"))
    assert repaired.velocities is not None
    assert repaired.gyroscope_biases is not None
    assert np.abs(repaired.gyroscope_biases).max() < 0.1


def test_poses_alone_as_json(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["groundtruth", f"{bag}:/mocap", "--json", "-"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["imu"] is None
    assert "fits" not in result
    assert main(["groundtruth", f"{bag}:/mocap"]) == 0
    assert "No cause of errors is significant." in capsys.readouterr().out


def test_bad_input_is_one_sentence(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth, imu = f"{bag}:/mocap", ["--imu", f"{bag}:/imu"]
    for arguments, sentence in (
        (["--figure", "a.png"], "need --imu; add it"),
        ([*imu, "--imu-noise", "1"], "give two densities"),
        ([*imu, "--imu-noise", "nan,1"], "give two densities"),
        ([*imu, "--output", "folder"], "--output needs --save-as"),
        ([*imu, "--save-as", "excel"], "excel"),
        (["--imu", truth], "IMU messages are on /imu"),
        ([*imu, "--time-offset", "900"], "and the examination needs 20 s"),
        ([*imu, "--time-offset", "nan"], "the time offset is nan s; give a finite number"),
    ):
        assert main(["groundtruth", truth, *arguments]) == 2
        text = capsys.readouterr()
        assert not text.out
        assert text.err.count("\n") == 1
        assert sentence in text.err


def test_outliers_and_flips_are_found_without_an_imu(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flight = simulate(seed=4, duration_s=40.0).groundtruth
    positions, quaternions = flight.positions.copy(), flight.known_quaternions.copy()
    positions[2000] += [0.0, 30.0, 0.0]
    quaternions[3000:3010] = lie.multiply(quaternions[3000:3010], np.array([[1.0, 0, 0, 0]]))
    path = tmp_path / "mocap.txt"
    columns = [flight.stamps[:, None] / 1e9, positions, quaternions]
    np.savetxt(path, np.hstack(columns), fmt=["%.9f"] + ["%.17g"] * 7)
    assert main(["groundtruth", str(path)]) == 0
    shown = capsys.readouterr().out
    at_s = [(flight.stamps[row - 1] - flight.stamps[0]) / 1e9 for row in (2000, 3000)]
    drop = "evaluate with --drop-groundtruth-outliers."
    assert f"1 outlier of 30.00 m at {at_s[0]:.2f} s; {drop}" in shown
    assert f"1 flip of 180 deg at {at_s[1]:.2f} s; {drop}" in shown
    assert main(["groundtruth", str(path), "--json", "-"]) == 0
    causes = {cause["name"]: cause for cause in json.loads(capsys.readouterr().out)["causes"]}
    assert causes["flips"]["verdict"] == causes["outliers"]["verdict"] == "significant"
    assert causes["steps"]["verdict"] == "insignificant"
