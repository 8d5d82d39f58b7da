"""receive times from bags and text, and what `trajeval evaluate` makes of them."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from ros_bags import ODOM, messages_of, path_message, transforms_message

from trajeval_ros import Trajectory, simulate
from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.source_info import ReceiveTimes, SourceInfo
from trajeval_ros.io.bags.write_bag import write_bag
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.io.text.hints import TextHints
from trajeval_ros.metrics.stream_health import health_of

FLIGHT = simulate(seed=2, duration_s=20.0)
SECOND = 10**9
LIDAR = Path("real_estimators") / "lidar"


def write_mcap(
    path: Path, messages: list[tuple[str, str, int, int, bytes]], *, chunked: bool = True
) -> Path:
    """Write topic, type, log time, publish time and payload; types are known to the reader."""
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=chunked)
        writer.start("ros2")
        channels: dict[str, int] = {}
        for topic, kind, logged, published, payload in messages:
            if topic not in channels:
                schema = writer.register_schema(kind, "ros2msg", b"")
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], logged, payload, published)
        writer.finish()
    return path


@pytest.mark.parametrize("chunked", [True, False])
def test_publish_times_are_used_where_they_differ(tmp_path: Path, chunked: bool) -> None:
    random = np.random.default_rng(1)
    sent = messages_of(FLIGHT.estimate, "/vio", ODOM)
    delays = (random.uniform(0.01, 0.02, (2, len(sent))) * SECOND).astype(int).cumsum(axis=0)
    rows = [
        (topic, kind, stamp + int(logged), stamp + int(published), payload)
        for (topic, kind, stamp, payload), published, logged in zip(sent, *delays, strict=True)
    ]
    path = write_mcap(tmp_path / "run.mcap", rows, chunked=chunked)
    for received, by, which in (("", "publish", 0), ("publish", "publish", 0), ("log", "log", 1)):
        receive_times = read_trajectory(path, received=received).reading.receive_times
        assert receive_times is not None
        assert receive_times.by == by
        np.testing.assert_array_equal(receive_times.times, FLIGHT.estimate.stamps + delays[which])
        assert (receive_times.body_rates is not None) == bool(received)
    auto = read_trajectory(path, received="auto").reading.receive_times
    assert auto is not None
    assert auto.recording_s is not None
    later_s = (delays[1] - delays[0]) / SECOND
    assert auto.recording_s == pytest.approx((np.median(later_s), later_s.max()))


def test_equal_or_missing_publish_times_are_log_times(tmp_path: Path) -> None:
    sent = messages_of(FLIGHT.estimate, "/vio", ODOM)
    for published in (None, 0):
        rows = [
            (topic, kind, at + 5, at + 5 if published is None else published, payload)
            for topic, kind, at, payload in sent
        ]
        receive_times = read_trajectory(
            write_mcap(tmp_path / "run.mcap", rows)
        ).reading.receive_times
        assert receive_times is not None
        assert (receive_times.by, receive_times.recording_s) == ("log", None)
        np.testing.assert_array_equal(receive_times.times, FLIGHT.estimate.stamps + 5)


def test_of_a_path_the_last_pose_of_every_message_was_received(tmp_path: Path) -> None:
    estimate = FLIGHT.estimate[:60]
    assert estimate.quaternions is not None
    stamps, rows = estimate.stamps.tolist(), []
    for end in range(20, 61, 20):
        # Every message moves the whole path by another metre.
        positions = estimate.positions[:end] + [end / 20.0, 0.0, 0.0]
        payload = path_message(stamps[:end], positions, estimate.quaternions[:end])
        at = stamps[end - 1] + 40_000_000
        rows.append(("/slam", "nav_msgs/msg/Path", at, at, payload))
    path = write_mcap(tmp_path / "run.mcap", rows)
    assert read_trajectory(path).reading.as_received is None
    read = read_trajectory(path, received="auto")
    assert len(read) == 60
    received = read.reading.as_received
    assert received is not None
    assert received.stamps.tolist() == [stamps[19], stamps[39], stamps[59]]
    expected = estimate.positions[[19, 39, 59], 0] + [1.0, 2.0, 3.0]
    np.testing.assert_allclose(received.positions[:, 0], expected, atol=1e-12)
    receive_times = received.reading.receive_times
    assert receive_times is not None
    np.testing.assert_array_equal(receive_times.times, received.stamps + 40_000_000)


def test_a_correction_acts_from_its_reception_whatever_its_timestamp(tmp_path: Path) -> None:
    rotation = (0.0, 0.0, 0.0, 1.0)
    ms = 10**6

    def moved(parent: str, child: str, stamp: int, at: int, x: float) -> Any:
        payload = transforms_message((parent, child, stamp * ms, (x, 0.0, 0.0), rotation))
        return ("/tf", "tf2_msgs/msg/TFMessage", at * ms, at * ms, payload)

    begin = 100_000
    rows = [moved("odom", "base", begin + 50 * n, begin + 50 * n + 5, 0.1 * n) for n in range(60)]
    # Dated a second into the future, as AMCL does; the second one moves the map by 1 m.
    rows += [moved("map", "odom", begin + 1000, begin + 10, 10.0)]
    rows += [moved("map", "odom", begin + 2000, begin + 1020, 11.0)]
    rows += [moved("map", "odom", begin + 2900, begin + 1900, 11.0)]
    path = write_mcap(tmp_path / "run.mcap", sorted(rows, key=lambda item: item[2]))
    received = read_trajectory(f"{path}:/tf:map.base", received="auto").reading.as_received
    assert received is not None
    receive_times = received.reading.receive_times
    assert receive_times is not None
    assert receive_times.corrected is not None
    for at, x, stamp, corrected in (
        (begin + 10, 10.0, begin, begin + 10),
        (begin + 1005, 12.0, begin + 1000, begin + 10),
        (begin + 1020, 13.0, begin + 1000, begin + 1020),
        (begin + 1055, 13.1, begin + 1050, begin + 1020),
    ):
        row = int(receive_times.times.searchsorted(at * ms))
        assert receive_times.times[row] == at * ms
        assert received.positions[row, 0] == pytest.approx(x)
        assert received.stamps[row] == stamp * ms
        assert receive_times.corrected[row] == corrected * ms


@pytest.mark.parametrize(
    ("frames", "message"), [("a.b", "a and b are static"), ("a.x", "/tf:a.x: unknown frame x")]
)
def test_transforms_without_poses_are_one_sentence_as_without_receive_times(
    frames: str, message: str, tmp_path: Path
) -> None:
    payload = transforms_message(("a", "b", SECOND, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))
    row = ("/tf_static", "tf2_msgs/msg/TFMessage", SECOND, SECOND, payload)
    path = write_mcap(tmp_path / "run.mcap", [row, ("/tf", *row[1:4], transforms_message())])
    for received in ("", "auto"):
        with pytest.raises(InputError, match=message):
            read_trajectory(f"{path}:/tf:{frames}", received=received)


@pytest.mark.parametrize(
    ("scale", "unit"), [(1e-9, "t_s"), (1.0, "t_ns"), (1e-6, "t_ms"), (1e-9, "t")]
)
def test_column_received_is_in_the_unit_of_the_timestamps(
    tmp_path: Path, scale: float, unit: str
) -> None:
    stamps = 1_700_000_000 * SECOND + np.arange(50) * 50_000_000
    times = stamps + 37_123_000
    digits = 9 if scale == 1e-9 else 6 if scale == 1e-6 else 0
    lines = [
        f"{stamp * scale:.{digits}f} {at * scale:.{digits}f} {row} 0 0"
        for row, (stamp, at) in enumerate(zip(stamps.tolist(), times.tolist(), strict=True))
    ]
    file = tmp_path / "run.txt"
    file.write_text("\n".join(lines) + "\n")
    read = read_trajectory(file, hints=TextHints((unit, "received", "x", "y", "z")))
    receive_times = read.reading.receive_times
    assert receive_times is not None
    # A microsecond is exact for times in seconds; so are whole nanoseconds up to float64.
    assert np.abs(receive_times.times - times).max() <= 1000


def test_header_names_the_column_received(tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    file.write_text("t,x,y,z,received\n1.0,0,0,0,1.25\n2.0,1,0,0,2.5\n")
    receive_times = read_trajectory(file).reading.receive_times
    assert receive_times is not None
    assert receive_times.times.tolist() == [1_250_000_000, 2_500_000_000]
    file.write_text("t,x,y,z,received\n1.0,0,0,0,nan\n2.0,1,0,0,2.5\n")
    with pytest.raises(InputError, match="row 1 has no number in column received"):
        read_trajectory(file)
    rows = [f"{row}000000000,{row},0,0,{row}000000001\n" for row in range(6, 18)]
    rows[2] = "8000000000,8,0,0,9300000000000000000\n"
    file.write_text("t_ns,x,y,z,received\n" + "".join(rows))
    with pytest.raises(
        InputError, match="row 3 has a time after the year 2262 in column received"
    ):
        read_trajectory(file)


def test_written_receptions_are_read_back(tmp_path: Path) -> None:
    bag, folder = tmp_path / "run", tmp_path / "text"
    stamps = 1_700_000_000 * SECOND + np.arange(50) * 50_000_000
    delays = np.random.default_rng(0).integers(1_000, 300_000, 50) * 1000
    reading = SourceInfo(source="run:/vio", receive_times=ReceiveTimes(stamps + delays))
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (50, 1))
    written = Trajectory(stamps, np.ones((50, 3)), rotations, reading=reading)
    write_bag(bag, {"/vio": (written, "geometry_msgs/msg/PoseStamped")})
    assert main(["trajectory", f"{bag}:/vio", "--save-as", "euroc", "--output", str(folder)]) == 0
    [file] = folder.iterdir()
    receive_times = read_trajectory(file).in_order().reading.receive_times
    assert receive_times is not None
    assert receive_times.times.tolist() == (stamps + delays).tolist()


def csv_latencies(folder: Path, name: str) -> tuple[np.ndarray, np.ndarray]:
    with (folder / f"{name}_latency.csv").open() as file:
        rows = list(csv.DictReader(file))
    stamps = np.array([int(row["stamp_ns"]) for row in rows])
    return stamps, np.array([int(row["published_ns"]) for row in rows])


@pytest.mark.parametrize(
    ("recording", "name", "messages", "missed", "median_s"),
    [
        ("real_time", "small_gicp", 397, 3, 0.0309),
        ("overload", "rko_lio", 569, 31, 21.2),
        ("overload", "kiss_icp", 78, 519, 7.5),
        ("overload", "small_gicp", 544, 56, 21.5),
    ],
)
def test_arrivals_of_real_estimators(
    shared_data: Path, recording: str, name: str, messages: int, missed: int, median_s: float
) -> None:
    folder = shared_data / LIDAR / recording
    read = read_trajectory(f"{folder / 'bag'}:/{name}/odometry")
    receive_times = read.reading.receive_times
    assert receive_times is not None
    health = health_of(read.stamps, receive_times.times)
    assert (health.messages, health.missed) == (messages, missed)
    assert health.arrival_p50_s == pytest.approx(median_s, rel=5e-3)
    # The estimator's own times of publication differ by the way to the recorder.
    stamps, published = csv_latencies(folder, name)
    _, mine, own = np.intersect1d(read.stamps, stamps, return_indices=True)
    assert len(mine) == messages
    if recording == "real_time":
        way_s = (receive_times.times[mine] - published[own]) / SECOND
        assert abs(np.median(way_s)) < 1e-3


def evaluated(folder: Path, *arguments: str) -> Any:
    file = folder / "result.json"
    assert main(["evaluate", *arguments, "--quiet", "--json", str(file)]) == 0
    return json.loads(file.read_text())["runs"]


def test_evaluate_states_arrivals_gaps_and_missed_messages(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = shared_data / LIDAR / "real_time" / "bag"
    sources = f"{bag}:/groundtruth/pose", f"{bag}:/small_gicp/odometry"
    [run] = evaluated(tmp_path, *sources, "--modality", "lidar")
    stream = run["stream"]
    assert (stream["messages"], stream["missed"], stream["largest_gap_s"]) == (397, 3, 0.2)
    assert stream["arrival_p95_s"] == pytest.approx(0.252, abs=1e-3)
    assert stream["arrival_max_s"] == pytest.approx(0.647, abs=1e-3)
    assert run["as_available"] is None
    assert main(["evaluate", *sources, "--modality", "lidar"]) == 0
    text = "arrival after timestamp 0.0309 s median, 0.252 s p95, 0.647 s max; 3 of 400 messages"
    assert text in capsys.readouterr().out


@pytest.mark.slow
def test_wheel_odometry_of_a_real_robot(shared_data: Path, tmp_path: Path) -> None:
    bag = shared_data / "gnss" / "husky_outdoor.bag"
    sources = f"{bag}:/fix", f"{bag}:/husky_velocity_controller/odom"
    for motion, expected_m in (("hold", 0.0639), ("twist", 0.0383), ("constant", 0.0393)):
        [run] = evaluated(tmp_path, *sources, "--modality", "wheel", "--as-available", motion)
        result = run["as_available"]
        assert result["age_error_m"]["rmse"] == pytest.approx(expected_m, abs=1e-4)
        assert result["age_s"]["mean"] == pytest.approx(0.0505, abs=1e-4)
        assert result["available_percent"] == pytest.approx(99.0, abs=0.1)
        assert result["clock"]["verdict"] == "ok"


def test_processing_times_change_the_order_of_two_real_estimators(
    shared_data: Path, tmp_path: Path
) -> None:
    """GTSAM's smoother is the more accurate one, and falls behind the camera (docs)."""
    bag = shared_data / "real_estimators" / "v1_01" / "bag"
    names = ("/gtsam/odometry", "/openvins/odometry")
    sources = f"{bag}:/groundtruth/pose", *(f"{bag}:{name}" for name in names)
    runs = evaluated(tmp_path, *sources, "--gauge", "none", "--as-available")
    ates = [run["ate"]["position_m"]["rmse"] for run in runs]
    available = [run["as_available"]["position_m"]["rmse"] for run in runs]
    assert ates == pytest.approx([0.0239, 0.0269], abs=5e-5)
    assert available == pytest.approx([0.470, 0.0822], rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bag", "truth", "estimate", "verdict"),
    [
        ("ROS_example.bag", "groundtruth", "ORB-SLAM", "copied"),
        ("nav2_turtlebot.mcap", "/odom", "/amcl_pose", "epochs"),
    ],
)
def test_clocks_that_can_not_be_compared_withhold_the_numbers(
    shared_data: Path, tmp_path: Path, bag: str, truth: str, estimate: str, verdict: str
) -> None:
    path = shared_data / "bags" / bag
    sources = f"{path}:{truth}", f"{path}:{estimate}"
    [run] = evaluated(tmp_path, *sources, "--gauge", "se3", "--as-available")
    result = run["as_available"]
    assert result["clock"]["verdict"] == verdict
    assert result["position_m"] is None
    assert [remark["code"] for remark in run["remarks"]].count("receive_clock") == 1
    assert run["ate"]["position_m"]["rmse"] > 0.0
    assert run["stream"]["arrival_p50_s"] is None
    [again] = evaluated(tmp_path, *sources, "--gauge", "se3")
    assert again["ate"] == run["ate"]


def test_all_other_numbers_are_the_same_with_and_without_the_option(tmp_path: Path) -> None:
    rows = [
        (topic, kind, at + 30_000_000, at + 30_000_000, payload)
        for topic, side in (
            ("/groundtruth", FLIGHT.groundtruth[::8]),
            ("/vio", FLIGHT.estimate[::2]),
        )
        for topic, kind, at, payload in messages_of(side, topic, ODOM)
    ]
    path = write_mcap(tmp_path / "run.mcap", sorted(rows, key=lambda row: row[2]))
    sources = f"{path}:/groundtruth", f"{path}:/vio", "--gauge", "yaw"
    [without], [with_it] = (
        evaluated(tmp_path, *sources, *item) for item in ((), ("--as-available",))
    )
    assert with_it.pop("as_available")["position_m"]["rmse"] > 0.0
    assert without.pop("as_available") is None
    assert without == with_it


def test_text_without_receptions_withholds_the_numbers(tmp_path: Path) -> None:
    truth, estimate = (tmp_path / name for name in ("truth.txt", "estimate.txt"))
    for file, side in ((truth, FLIGHT.groundtruth), (estimate, FLIGHT.estimate)):
        assert side.quaternions is not None
        rows = np.column_stack([side.stamps / SECOND, side.positions, side.quaternions])
        np.savetxt(file, rows, fmt="%.9f")
    [run] = evaluated(tmp_path, str(truth), str(estimate), "--as-available", "hold")
    assert "no receive times" in run["as_available"]["why_withheld"]
    assert run["stream"] is None
