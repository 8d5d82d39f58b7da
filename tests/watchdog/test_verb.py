"""`trajeval watch`: alarms, the factor, and bad input in one sentence."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from watched_flights import SECOND, watched_bag, watched_sources

from trajeval_ros import simulate
from trajeval_ros.cli.app import main
from trajeval_ros.io.bags.encode_messages import encode_imu
from trajeval_ros.io.bags.rate_messages import decode_rates, read_rates
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.simulation.odometry_faults import FAULTS
from trajeval_ros.simulation.simulated_sensors import imu_readings


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return watched_bag(tmp_path_factory.mktemp("good"), "good", 3)


@pytest.mark.slow
def test_alarms_have_times_and_the_factor(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = watched_bag(tmp_path, "bad", 3, "yaw 1 deg/s")
    command = ["watch", *watched_sources(bad), "--json", str(tmp_path / "w.json")]
    pytest.importorskip("matplotlib", reason="figures need the extra `plot`")
    assert main([*command, "--fail-on", "alarm", "--figure", str(tmp_path / "w.png")]) == 1
    text = capsys.readouterr().out
    assert "gyro_deg_20s" in text
    assert "factor: 1. If this run is healthy, use --factor " in text
    result = json.loads((tmp_path / "w.json").read_text())
    assert result["schema"] == "trajeval-watch/3"
    assert result["factor"] == 1.0
    begin = min(alarm["begin_ns"] for alarm in result["alarms"])
    onset = 1_700_000_050 * SECOND
    assert 0 <= begin - onset < 6 * SECOND
    assert (tmp_path / "w.png").read_bytes().startswith(b"\x89PNG")
    assert main([*command, "--quiet"]) == 0
    assert main(["watch", *watched_sources(good), "--fail-on", "alarm"]) == 0


@pytest.mark.slow
def test_the_printed_factor_makes_a_run_healthy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A user calls a run with large differences healthy: one number adapts all limits."""
    bad = watched_bag(tmp_path, "bad", 3, "yaw 1 deg/s")
    assert main(["watch", *watched_sources(bad)]) == 0
    needed = capsys.readouterr().out.split("--factor ")[1].split()[0]
    command = ["watch", *watched_sources(bad), "--factor", needed, "--fail-on", "alarm"]
    assert main(command) == 0
    text = capsys.readouterr().out
    assert f"factor: {needed}" in text
    assert "use --factor" not in text
    assert "fewer than" in text


def test_json_alone_on_stdout(good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["watch", *watched_sources(good), "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["alarms"] == []


def fails(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["watch", *arguments]) == 2
    text = capsys.readouterr()
    assert not text.out
    assert text.err.count("\n") == 1
    return text.err


def test_values_that_are_not_valid(good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    odom = f"{good}:/odom"
    assert "--factor must be from 0.1" in fails([odom, "--factor", "nan"], capsys)
    assert "one of alarm, error" in fails([odom, "--fail-on", "warning"], capsys)


def test_sources_that_are_none(good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base = [f"{good}:/odom"]
    assert "IMU messages are on /imu" in fails([*base, "--imu", f"{good}:/vio"], capsys)
    assert "has type nav_msgs/msg/Odometry, not sensor_msgs/msg/Imu" in fails(
        [*base, "--imu", f"{good}:/odom"], capsys
    )
    assert "is not a topic of a bag" in fails([*base, "--imu", str(good)], capsys)
    assert "has no topic /nothing" in fails([*base, "--imu", f"{good}:/nothing"], capsys)


def test_no_motion(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    still = tmp_path / "still.txt"
    rows = [f"{i * 0.1:.1f} 0 0 0 0 0 {0.001 * (i % 2)} 1" for i in range(3000)]
    still.write_text("\n".join(rows) + "\n")
    assert "only 0 s of motion" in fails([str(still)], capsys)


def test_imu_messages_are_read_as_they_were_written(good: Path) -> None:
    expected = imu_readings(simulate(3, 75.0).groundtruth, 3)
    result = read_rates(good, "/imu")
    assert expected.accelerations is not None
    assert result.accelerations is not None
    np.testing.assert_array_equal(result.stamps, expected.stamps)
    np.testing.assert_array_equal(result.rates, expected.rates)
    np.testing.assert_array_equal(result.accelerations, expected.accelerations)
    assert result.frame == "base_link"


def test_imu_messages_that_cannot_be_used_are_counted() -> None:
    rates, force = np.zeros((3, 3)), np.zeros((3, 3))
    rates[1, 0] = np.nan
    rows = encode_imu(np.arange(3) * SECOND, rates, force, "imu")
    result = decode_rates([*map(bytes, rows), b"\0\1"])
    assert len(result) == 2
    assert result.undecodable == 2


def test_imu_messages_are_those_of_ros(good: Path) -> None:
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    readings = read_rates(good, "/imu")
    assert readings.accelerations is not None
    rows = encode_imu(readings.stamps[:1], readings.rates[:1], readings.accelerations[:1], "imu")
    message = store.deserialize_cdr(bytes(rows[0]), "sensor_msgs/msg/Imu")
    assert message.header.frame_id == "imu"  # type: ignore[attr-defined]
    assert message.angular_velocity.y == readings.rates[0, 1]  # type: ignore[attr-defined]
    assert message.linear_acceleration.z == readings.accelerations[0, 2]  # type: ignore[attr-defined]
    assert message.orientation_covariance[0] == -1.0  # type: ignore[attr-defined]


@pytest.mark.slow
def test_the_picture_has_the_path_the_signals_and_the_alarms(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")
    from rrd import Rrd

    bad = watched_bag(tmp_path, "bad", 4, "diverging 1 m/s2")
    picture, output = tmp_path / "watch.rrd", tmp_path / "watch.json"
    command = ["watch", *watched_sources(bad), "--quiet"]
    assert main([*command, "--rrd", str(picture), "--json", str(output)]) == 0
    drawn, result = Rrd(picture), json.loads(output.read_text())
    signals = {item["name"]: item for item in result["signals"]}
    assert {f"watch/pair/{name}" for name in signals if name.startswith("pair")} <= drawn.entities
    stamps, ratios = drawn.numbers("watch/pair/pair_percent_5s")
    signal = signals["pair_percent_5s"]
    assert ratios.max() == pytest.approx(signal["largest"] / signal["limit"])
    assert stamps[ratios.argmax()] == signal["stamp_ns"]
    _, limit = drawn.numbers("watch/imu/limit")
    assert limit.tolist() == [1.0, 1.0]
    times, message = drawn.rows("events", "TextLog:text")
    _, levels = drawn.rows("events", "TextLog:level")
    for [text], [level] in zip(message, levels, strict=True):
        assert (level == "WARN") is text.startswith(("error: ", "warning: "))
    told = dict(zip([str(item[0]) for item in message], times.tolist(), strict=True))
    for alarm in result["alarms"]:
        [time] = [
            at for text, at in told.items() if f"{alarm['level']}: {alarm['signal']} " in text
        ]
        assert time == alarm["begin_ns"]
    ends, strips = drawn.strips("world/watched/path")
    assert ends[-1] == read_trajectory(f"{bad}:/odom").stamps[-1]
    assert sum(map(len, strips)) > 100


@pytest.mark.slow
def test_faults_of_simulated_flights_are_alarms(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The way of docs/watchdog.md: a healthy flight has only its tracking loss as an alarm."""

    def flown(name: str, *options: str) -> list[str]:
        bag = tmp_path / name
        assert main(["simulate", str(bag), "--duration", "90", *options]) == 0
        return ["watch", f"{bag}:/vio/odometry", "--imu", f"{bag}:/imu"]

    output = tmp_path / "watch.json"
    judged = ["--fail-on", "alarm", "--json", str(output), "--quiet"]
    for seed in ("1", "2"):
        assert main([*flown(f"healthy{seed}", "--seed", seed), *judged]) == 1
        assert {alarm["signal"] for alarm in json.loads(output.read_text())["alarms"]} == {"gap"}
    for fault in FAULTS:
        command = flown(fault, "--seed", "2", "--fault", fault)
        assert "; from 60 s on" in capsys.readouterr().out
        assert main([*command, *judged]) == 1
        alarms = json.loads(output.read_text())["alarms"]
        begins = [alarm["begin_ns"] for alarm in alarms if alarm["signal"] != "gap"]
        onset = read_trajectory(f"{tmp_path}/healthy1:/vio/odometry").stamps[0] + 60 * SECOND
        assert 0 <= min(begins) - onset < 10 * SECOND
    assert main(["simulate", str(tmp_path / "no"), "--fault", "flood"]) == 2
    assert f"must be one of {', '.join(FAULTS)}" in capsys.readouterr().err
    assert main(["simulate", str(tmp_path / "no"), "--fault", "yaw", "--profile", "euroc"]) == 2
    assert "--fault need the drift model" in capsys.readouterr().err
