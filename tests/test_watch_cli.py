"""`trajeval watch`: learning limits, alarms, and bad input in one sentence."""

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
from trajeval_ros.io.requests.limits_file import read_limits
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.visual_inertial.odometry_faults import FAULTS
from trajeval_ros.visual_inertial.simulated_imu import readings_of


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return watched_bag(tmp_path_factory.mktemp("good"), "good", 3)


@pytest.fixture(scope="module")
def limits(good: Path) -> Path:
    path = good.parent / "limits.yaml"
    command = [
        "watch",
        *watched_sources(good),
        "--learn",
        str(path),
        "-g",
        f"{good}:/truth",
        "--quiet",
    ]
    assert main(command) == 0
    return path


def test_limits_say_what_they_are_of(good: Path, limits: Path) -> None:
    found = read_limits(limits)
    assert found.sources["imu"] == f"{good}:/imu"
    assert found.checked == "checked against groundtruth"
    assert found.hours == pytest.approx(45.0 / 3600.0, rel=0.02)
    assert found.healthy["pair_m_1s"].largest > found.healthy["pair_m_1s"].typical > 0.0


def test_a_run_that_nobody_checked_is_said(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["watch", f"{good}:/odom", "--learn", str(tmp_path / "limits.yaml")]) == 0
    said = capsys.readouterr().out
    assert "not checked for health" in said
    assert "no IMU: yaw drift and clock slip not detected" in said


def test_alarms_have_times_and_evidence(
    good: Path, limits: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = watched_bag(tmp_path, "bad", 3, "yaw 1 deg/s")
    command = [
        "watch",
        *watched_sources(bad),
        "--limits",
        str(limits),
        "--json",
        str(tmp_path / "w.json"),
    ]
    pytest.importorskip("matplotlib", reason="figures need the extra `plot`")
    assert main([*command, "--fail-on", "alarm", "--figure", str(tmp_path / "w.png")]) == 1
    said = capsys.readouterr().out
    assert "gyro_deg_5s" in said
    assert "false alarms in similar runs are fewer than" in said
    assert "per hour (95 %" in said
    found = json.loads((tmp_path / "w.json").read_text())
    assert found["schema"] == "trajeval-watch/1"
    begin = min(alarm["begin_ns"] for alarm in found["alarms"])
    onset = 1_700_000_050 * SECOND
    assert 0 <= begin - onset < 6 * SECOND
    assert found["evidence"]["checked"] == "checked against groundtruth"
    assert found["evidence"]["most_false_alarms_per_hour"] == pytest.approx(240.0, rel=0.02)
    assert (tmp_path / "w.png").read_bytes().startswith(b"\x89PNG")
    assert main([*command, "--quiet"]) == 0
    assert (
        main(["watch", *watched_sources(good), "--limits", str(limits), "--fail-on", "alarm"]) == 0
    )


def test_json_alone_on_stdout(
    good: Path, limits: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["watch", *watched_sources(good), "--limits", str(limits), "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["alarms"] == []


def fails(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["watch", *arguments]) == 2
    said = capsys.readouterr()
    assert not said.out
    assert said.err.count("\n") == 1
    return said.err


def test_options_that_contradict_each_other(
    good: Path, limits: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    odom = f"{good}:/odom"
    assert "give either --limits FILE, or --learn FILE" in fails([odom], capsys)
    both = [odom, "--limits", str(limits), "--learn", str(limits)]
    assert "give either --limits FILE, or --learn FILE" in fails(both, capsys)
    truth = [odom, "--limits", str(limits), "-g", f"{good}:/truth"]
    assert "use trajeval evaluate" in fails(truth, capsys)
    assert "--factor must be" in fails([odom, "--limits", str(limits), "--factor", "nan"], capsys)
    wrong = [odom, "--limits", str(limits), "--fail-on", "warning"]
    assert "one of alarm, error" in fails(wrong, capsys)


def test_sources_that_are_none(
    good: Path, limits: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    base = [f"{good}:/odom", "--limits", str(limits)]
    assert "IMU messages are on /imu" in fails([*base, "--imu", f"{good}:/vio"], capsys)
    assert "is odometry, not an IMU" in fails([*base, "--imu", f"{good}:/odom"], capsys)
    assert "is not a topic of a bag" in fails([*base, "--imu", str(good)], capsys)
    assert "has no topic /nothing" in fails([*base, "--imu", f"{good}:/nothing"], capsys)


def test_limits_of_other_sources_are_refused(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "limits.yaml"
    assert main(["watch", f"{good}:/odom", "--learn", str(path), "--quiet"]) == 0
    said = fails([*watched_sources(good), "--limits", str(path)], capsys)
    assert "learned without the second estimate, which this run has" in said


def test_limits_of_another_robot_are_refused(
    good: Path, limits: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = []
    for line in limits.read_text().splitlines():
        name, _, rest = line.partition(": {largest: ")
        if rest:
            largest, _, typical = rest.partition(", typical: ")
            typical = typical.partition("}")[0]
            line = f"{name}: {{largest: {20 * float(largest)}, typical: {20 * float(typical)}}}"
        lines.append(line)
    other = tmp_path / "other.yaml"
    other.write_text("\n".join(lines))
    said = fails([*watched_sources(good), "--limits", str(other)], capsys)
    assert "of another robot or estimator" in said


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "has no limits"),
        ("a: 1\n", "is not a file with limits"),
        ("schema: trajeval-limits/9\n", "has schema trajeval-limits/9"),
        ("schema: trajeval-limits/1\nhealthy: {}\n", "has no evidence"),
        (
            "schema: trajeval-limits/1\nevidence: {hours: 0.0}\nhealthy: {jump_m: 1}\n",
            "has no healthy hours",
        ),
        (
            "schema: trajeval-limits/1\nevidence: {hours: 1.0}\nhealthy: {jump: 1}\n",
            "did you mean jump_m?",
        ),
        (
            "schema: trajeval-limits/1\nevidence: {hours: 1.0}\nhealthy: {jump_m: 1}\n",
            "jump_m must be {largest: VALUE, typical: VALUE}",
        ),
        (
            "schema: trajeval-limits/1\nevidence: {hours: .nan}\nhealthy: {jump_m: 1}\n",
            "hours must be a number from 0 to",
        ),
        (
            f"schema: trajeval-limits/1\nevidence: {{hours: {10**400}}}\nhealthy: {{jump_m: 1}}\n",
            "hours must be a number from 0 to",
        ),
        (
            "schema: trajeval-limits/1\nevidence: {hours: 1.0, sources: [imu]}\n"
            "healthy: {jump_m: {largest: 1, typical: 1}}\n",
            "has no sources",
        ),
    ],
)
def test_files_that_hold_no_limits(
    text: str, said: str, good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "limits.yaml"
    path.write_text(text)
    assert said in fails([f"{good}:/odom", "--limits", str(path)], capsys)


def test_no_motion(limits: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    still = tmp_path / "still.txt"
    rows = [f"{i * 0.1:.1f} 0 0 0 0 0 {0.001 * (i % 2)} 1" for i in range(3000)]
    still.write_text("\n".join(rows) + "\n")
    said = fails([str(still), "--limits", str(limits)], capsys)
    assert "only 0 s of motion" in said


def test_an_unhealthy_run_teaches_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = watched_bag(tmp_path, "bad", 4, "diverging 1 m/s2")
    path = tmp_path / "limits.yaml"
    said = fails([f"{bad}:/odom", "--learn", str(path), "-g", f"{bad}:/truth"], capsys)
    assert "is not a healthy run" in said
    assert not path.exists()


def test_imu_messages_are_read_as_they_were_written(good: Path) -> None:
    expected = readings_of(simulate(3, 75.0).groundtruth, 3)
    found = read_rates(good, "/imu")
    assert expected.accelerations is not None
    assert found.accelerations is not None
    np.testing.assert_array_equal(found.stamps, expected.stamps)
    np.testing.assert_array_equal(found.rates, expected.rates)
    np.testing.assert_array_equal(found.accelerations, expected.accelerations)
    assert found.frame == "base_link"


def test_imu_messages_that_cannot_be_used_are_counted() -> None:
    rates, force = np.zeros((3, 3)), np.zeros((3, 3))
    rates[1, 0] = np.nan
    rows = encode_imu(np.arange(3) * SECOND, rates, force, "imu")
    found = decode_rates([*map(bytes, rows), b"\0\1"], "sensor_msgs/msg/Imu")
    assert len(found) == 2
    assert found.undecodable == 2


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
def test_the_picture_has_the_path_the_signals_and_the_alarms(limits: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")
    from rrd import Rrd

    bad = watched_bag(tmp_path, "bad", 4, "diverging 1 m/s2")
    picture, output = tmp_path / "watch.rrd", tmp_path / "watch.json"
    command = ["watch", *watched_sources(bad), "--limits", str(limits), "--quiet"]
    assert main([*command, "--rrd", str(picture), "--json", str(output)]) == 0
    drawn, found = Rrd(picture), json.loads(output.read_text())
    signals = {each["name"]: each for each in found["signals"]}
    assert {f"watch/pair/{name}" for name in signals if name.startswith("pair")} <= drawn.entities
    stamps, ratios = drawn.numbers("watch/pair/pair_m_1s")
    signal = signals["pair_m_1s"]
    assert ratios.max() == pytest.approx(signal["largest"] / signal["limit"])
    assert stamps[ratios.argmax()] == signal["stamp_ns"]
    _, limit = drawn.numbers("watch/imu/limit")
    assert limit.tolist() == [1.0, 1.0]
    times, said = drawn.rows("events", "TextLog:text")
    told = dict(zip([str(each[0]) for each in said], times.tolist(), strict=True))
    for alarm in found["alarms"]:
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
    """The way of docs/watchdog.md: learn from one simulated flight, and watch others."""

    def flown(name: str, *options: str) -> list[str]:
        bag = tmp_path / name
        assert main(["simulate", str(bag), "--duration", "90", *options]) == 0
        return ["watch", f"{bag}:/vio/odometry", "--imu", f"{bag}:/imu"]

    limits, output = tmp_path / "limits.yaml", tmp_path / "watch.json"
    good = flown("good", "--seed", "1")
    assert main([*good, "--learn", str(limits), "-g", f"{tmp_path}/good:/groundtruth/pose"]) == 0
    judged = ["--limits", str(limits), "--fail-on", "alarm", "--json", str(output), "--quiet"]
    assert main([*flown("healthy", "--seed", "2"), *judged]) == 0
    for fault in FAULTS:
        command = flown(fault, "--seed", "2", "--fault", fault)
        assert "; from 60 s on" in capsys.readouterr().out
        assert main([*command, *judged]) == 1
        begins = [each["begin_ns"] for each in json.loads(output.read_text())["alarms"]]
        onset = read_trajectory(f"{tmp_path}/good:/vio/odometry").stamps[0] + 60 * SECOND
        assert 0 <= min(begins) - onset < 5 * SECOND
    assert main(["simulate", str(tmp_path / "no"), "--fault", "flood"]) == 2
    assert f"must be one of {', '.join(FAULTS)}" in capsys.readouterr().err
    assert main(["simulate", str(tmp_path / "no"), "--fault", "yaw", "--profile", "euroc"]) == 2
    assert "--fault need the drift model" in capsys.readouterr().err
