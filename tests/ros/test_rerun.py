"""The live picture: what is published is what is drawn, and no trouble stops the node."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fix_runs import fix_messages, fixes_of
from recorded_runs import pairs_of
from ros_bags import ODOM, messages_of, write_messages
from ros_processes import (
    GROUNDTRUTH,
    ODOMETRY,
    Peer,
    evaluating,
    listening,
    parameters,
    play_without_loss,
    replay,
    run_evaluator,
)
from waiting import PATIENCE_S

from trajeval_ros.formatting.install_command import extra_command
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.simulation.drifting_odometry import simulate

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytest.importorskip("rerun", reason="rerun-sdk is missing; `make test-ros` has it")

from rrd import Rrd

pytestmark = pytest.mark.ros

NAME = "vio_odometry"
FLOAT, VECTOR = "std_msgs/msg/Float64", "geometry_msgs/msg/Vector3Stamped"
# The number at a byte of a message: a vector without a frame begins at byte 20.
NUMBERS = {
    "position_error": ("position_error", FLOAT, 4),
    "rotation_error": ("rotation_error", FLOAT, 4),
    "ate_position": ("stamped/ate/position", VECTOR, 20),
    "ate_rotation": ("stamped/ate/rotation", VECTOR, 20),
}


def value_of(payload: bytes, byte: int) -> float:
    return float(np.frombuffer(payload[byte:], dtype="<f8", count=1)[0])


def test_drawn_numbers_are_the_published_ones(
    flights: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    topics = {f"/evaluator/{NAME}/{topic}": kind for topic, kind, _ in NUMBERS.values()}
    length = f"/evaluator/{NAME}/stamped/relative_error/length_8m/position"
    # The picture has ten errors per second of stamps at most. An update takes 0.2 s of stamps, and
    # more than 0.1 s on a machine on which the replay is slower.
    options = {"gauge": "yaw", "rerun": "file", "publish_rate": 10.0}
    with (
        listening({**topics, length: VECTOR}, environment, tmp_path) as received,
        evaluating(tmp_path / "out", environment, **options) as evaluator,
    ):
        replay(flights / "mcap", environment, "--rate", 2)
        assert evaluator.end() == 0
        assert "Rerun" not in evaluator.printed
    picture = Rrd(tmp_path / "out" / "run.rrd")
    for item, (topic, _, byte) in NUMBERS.items():
        _, drawn = picture.numbers(f"metrics/{item}/{NAME}")
        payloads = received[f"/evaluator/{NAME}/{topic}"]
        published = [value_of(payload, byte) for payload in payloads]
        assert len(published) > 10
        # A listener may be found late. The rotation errors of the first alignment are not drawn.
        # After a pause of the node, errors between two published ones are drawn, too.
        places = [drawn.tolist().index(value) for value in published if value in drawn]
        assert len(places) > 0.8 * len(published)
        assert places == sorted(places)
        assert (
            item.endswith("rotation") or item == "rotation_error" or len(places) == len(published)
        )
        assert places[0] < 0.5 * len(drawn)
    # Of relative errors the picture has five a second at most.
    _, drawn = picture.numbers(f"metrics/relative_error/{NAME}/8m")
    assert len(drawn) > 10
    heard = np.isin(drawn, [value_of(payload, 20) for payload in received[length]])
    missed = int(heard.argmax())
    assert heard[missed:].all()
    assert missed < 0.5 * len(drawn)
    _, half_axes = picture.rows(f"world/estimate/{NAME}/covariance", "Ellipsoids3D:half_sizes")
    assert all(np.isfinite(half_axis).all() for half_axis in half_axes)


def test_fixes_are_on_the_map(peer: Peer, environment: dict[str, str], tmp_path: Path) -> None:
    pytest.importorskip("sensor_msgs")
    flight = simulate(6, 20.0)
    groundtruth = flight.groundtruth[::80]  # 2.5 Hz
    fixes = fixes_of(groundtruth.stamps, groundtruth.positions)
    bag = tmp_path / "bag"
    sent = [*fix_messages(fixes, GROUNDTRUTH), *messages_of(flight.estimate, ODOMETRY, ODOM)]
    write_messages(bag, sent)
    nodes = {"evaluator": {"rerun": "file", "lengths": "4"}}
    done = play_without_loss(bag, peer, environment, tmp_path, nodes, rate=4.0)["evaluator"]
    picture = Rrd(done.folder / "run.rrd")
    _, points = picture.rows("map/fixes", "GeoPoints:positions")
    assert fixes.reading.fixes is not None
    np.testing.assert_array_equal(points[-1], fixes.reading.fixes.places[:, :2])
    _, tracks = picture.rows(f"map/estimate/{NAME}", "GeoLineStrings:line_strings")
    assert sum(map(len, tracks[-1])) > 0.8 * len(fixes)


def test_a_second_loop_of_a_bag_is_drawn(
    flights: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    folder = tmp_path / "out"
    with evaluating(folder, environment, gauge="yaw", rerun="file") as evaluator:
        replay(flights / "mcap", environment, "--rate", 5)
        replay(flights / "mcap", environment, "--rate", 5, "--end", 12)
        evaluator.wait_for(f"new results in {tmp_path / 'out_2'}")
        assert evaluator.end() == 0
    folder = tmp_path / "out_2"
    picture, pairs = Rrd(folder / "run.rrd"), pairs_of(folder, NAME)
    groundtruth = read_trajectory(f"{flights / 'mcap'}:{GROUNDTRUTH}")
    frame = f"world/estimate/{NAME}"
    for entity, positions in (
        ("world/groundtruth", groundtruth.positions[groundtruth.seconds < 12.0]),
        (frame, pairs.estimate.positions),
    ):
        stamps, poses = picture.rows(f"{entity}/pose", "Transform3D:translation")
        assert (np.diff(stamps) > 0).all()
        # The second picture shows the second loop alone.
        assert np.linalg.norm(poses[-1][0] - positions[-1]) < 1.0
        path = np.concatenate(picture.path(entity, int(stamps[-1])))
        distances = np.linalg.norm(path[:, None] - positions, axis=2)
        assert distances.min(axis=1).max() < 1e-4
        assert distances.min(axis=0).max() < 1.0


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (
            "connect:http://127.0.0.1:9",
            "is not the URL of a viewer; write it as in connect:rerun+",
        ),
        ("flie", "rerun must be none, file, serve, serve:PORT, serve:ADDRESS:PORT or connect:"),
    ],
)
def test_a_wrong_value_stops_the_node(
    value: str, message: str, environment: dict[str, str], tmp_path: Path
) -> None:
    topics = {"groundtruth_topic": GROUNDTRUTH, "estimate_topics": [ODOMETRY]}
    values = parameters(**topics, output=str(tmp_path / "out"), rerun=value)
    done = run_evaluator(environment, *values)
    assert done.returncode == 2
    assert done.stderr.count(message) == 1
    assert not (tmp_path / "out").exists()


def test_the_node_runs_on_without_the_picture(
    flights: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with evaluating(tmp_path / "out", environment, rerun=f"serve:{port}") as evaluator:
            replay(flights / "mcap", environment, "--rate", 9)
            assert evaluator.end() == 0
    text = f"Rerun can't use port {port}: address already in use; choose"
    assert evaluator.printed.count(text) == 1
    assert evaluator.result["runs"][0]["association"]["pairs"] > 300
    assert (tmp_path / "out" / "run.rrd").exists()


def test_the_node_runs_on_packages_of_ubuntu_and_names_the_extra_for_rerun(
    flights: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    missing = (
        "rerun", "click", "rich_click", "rosbags", "mcap", "lz4", "zstandard", "jinja2", "pyarrow",
    )  # fmt: skip
    code = (
        f"import sys; sys.modules.update(dict.fromkeys({missing})); "
        "from trajeval_ros.__main__ import ros_evaluator; sys.exit(ros_evaluator())"
    )
    values = {
        "groundtruth_topic": GROUNDTRUTH,
        "estimate_topics": [ODOMETRY],
        "output": str(tmp_path / "out"),
        "rerun": "file",
    }
    with subprocess.Popen(
        [sys.executable, "-c", code, *parameters(**values)],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            replay(flights / "mcap", environment, "--rate", 9)
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=PATIENCE_S)
        finally:
            process.kill()
    assert process.returncode == 0
    assert err.count(extra_command("rerun")) == 1
    assert "Traceback" not in err
    assert (tmp_path / "out" / "result.json").exists()


def test_reset_begins_another_picture(
    flights: Path, environment: dict[str, str], tmp_path: Path, peer: Any
) -> None:
    from std_srvs.srv import Trigger

    with evaluating(tmp_path / "out", environment, gauge="yaw", rerun="file") as evaluator:
        replay(flights / "mcap", environment, "--rate", 9)
        assert peer.ask("/evaluator/reset", Trigger).success
        replay(flights / "mcap", environment, "--rate", 9)
        assert evaluator.end() == 0
    first, second = (tmp_path / name / "run.rrd" for name in ("out", "out_2"))
    for item in (first, second):
        stamps, _ = Rrd(item).numbers(f"metrics/position_error/{NAME}")
        assert len(stamps) > 10


def test_the_address_of_a_served_picture_is_told(
    environment: dict[str, str], port: int, tmp_path: Path
) -> None:
    with evaluating(tmp_path / "out", environment, rerun=f"serve:{port}") as evaluator:
        evaluator.wait_for(f"rerun --connect rerun+http://127.0.0.1:{port}/proxy")
        evaluator.end()
