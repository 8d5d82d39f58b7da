"""`trajeval evaluate --mcap`: errors as ROS 2 messages, by the topics of the live evaluator."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from mcap.writer import Writer
from recorded_errors import Recorded, read_recording
from state_rows import states, trajectory
from strategies import make_pair, seeds

from trajeval_ros import Protocol, Request, run
from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import warning
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.results.error_recording import write_error_recording
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings

TRUTH, ODOMETRY = "/groundtruth/pose", "/vio/odometry"
ROOT = "/evaluator/vio_odometry"


@pytest.fixture(scope="module")
def evaluated(flights: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the evaluation of a flight whose clocks are told to be apart."""
    folder = tmp_path_factory.mktemp("evaluated")
    output = ["--output", str(folder / "result")]
    with pytest.MonkeyPatch.context() as patch:  # figures take most of the time
        patch.setattr("trajeval_ros.report.figures.outcome_drawings", lambda _: {})
        assert evaluate(flights, folder, "--time-offset", "0.001", *output) == 0
    return folder


@pytest.fixture(scope="module")
def recorded(evaluated: Path) -> dict[str, Recorded]:
    return read_recording(evaluated / "errors.mcap")


def evaluate(flights: Path, folder: Path, *more: str) -> int:
    bag = flights / "mcap"
    sources = ["-g", f"{bag}:{TRUTH}", "-e", f"{bag}:{ODOMETRY}", "--gauge", "yaw", "--quiet"]
    output = ["--mcap", str(folder / "errors.mcap"), "--lengths", "8,2.5s,10%"]
    return main(["evaluate", *sources, *output, *more])


@pytest.fixture(scope="module")
def archive(evaluated: Path) -> dict[str, np.ndarray]:
    with np.load(evaluated / "result" / "errors.npz") as file:
        return dict(file)


@pytest.fixture(scope="module")
def result(evaluated: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((evaluated / "result" / "result.json").read_text())
    return loaded


@pytest.mark.slow
def test_errors_have_the_stamps_of_the_estimate_s_messages(
    recorded: dict[str, Recorded], archive: dict[str, np.ndarray], flights: Path
) -> None:
    in_bag = set(read_trajectory(f"{flights / 'mcap'}:{ODOMETRY}").stamps.tolist())
    for name in ("position", "rotation", "attitude", "heading"):
        topic = recorded[f"{ROOT}/stamped/{name}_error"]
        assert topic.type == "geometry_msgs/msg/Vector3Stamped"
        assert topic.stamps == topic.times
        assert set(topic.times) <= in_bag
        assert topic.times == (archive["vio_odometry.stamps"] - 1_000_000).tolist()
        assert {message.header.frame_id for message in topic.messages} == {"world"}


def test_vectors_are_as_long_as_the_errors(
    recorded: dict[str, Recorded], archive: dict[str, np.ndarray]
) -> None:
    attitude = recorded[f"{ROOT}/stamped/attitude_error"].vectors
    lengths = {
        "position_m": recorded[f"{ROOT}/stamped/position_error"].vectors,
        "rotation_deg": recorded[f"{ROOT}/stamped/rotation_error"].vectors,
        "yaw_deg": attitude[:, 2:],
        "tilt_deg": attitude[:, :2],
    }
    for name, vectors in lengths.items():
        expected = archive[f"vio_odometry.{name}"]
        assert np.linalg.norm(vectors, axis=1) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    heading = np.linalg.norm(recorded[f"{ROOT}/stamped/heading_error"].vectors, axis=1)
    assert heading == pytest.approx(archive["vio_odometry.position_m"], rel=1e-9)


def test_numbers_are_those_of_the_archive(
    recorded: dict[str, Recorded], archive: dict[str, np.ndarray]
) -> None:
    for topic, name in (
        ("position_error", "position_m"),
        ("rotation_error", "rotation_deg"),
        ("tilt_error", "tilt_deg"),
    ):
        expected = archive[f"vio_odometry.{name}"]
        assert recorded[f"{ROOT}/{topic}"].type == "std_msgs/msg/Float64"
        assert len(expected)
        assert recorded[f"{ROOT}/{topic}"].numbers == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_relative_errors_are_those_of_the_archive(
    recorded: dict[str, Recorded], archive: dict[str, np.ndarray]
) -> None:
    for topic, name in (
        ("length_8m", "8m"),
        ("length_2_5s", "2.5s"),
        ("length_10_percent", "10%"),
    ):
        for part, metric in (("position", "position_m"), ("rotation", "rotation_deg")):
            errors = recorded[f"{ROOT}/stamped/relative_error/{topic}/{part}"]
            expected = archive[f"vio_odometry.{name}.{metric}"]
            assert len(expected)
            assert errors.type == "geometry_msgs/msg/Vector3Stamped"
            assert errors.vectors[:, 0] == pytest.approx(expected, rel=1e-9, abs=1e-9)
            ends = archive[f"vio_odometry.{name}.ends"]
            stamps = archive["vio_odometry.stamps"][ends] - 1_000_000
            assert errors.stamps == errors.times == stamps.tolist()


def test_statistics_are_those_of_the_result(
    recorded: dict[str, Recorded], result: dict[str, Any]
) -> None:
    [run_] = result["runs"]
    times = recorded[f"{ROOT}/position_error"].times
    for part, metric in (("position", "position_m"), ("rotation", "rotation_deg")):
        ate = recorded[f"{ROOT}/stamped/ate/{part}"]
        assert ate.vectors.tolist() == [[run_["ate"][metric]["rmse"], 0.0, 0.0]] * 2
        assert ate.times == [times[0], times[-1]]
    [message] = recorded["/diagnostics"].messages
    [status] = message.status
    values = {value.key: value.value for value in status.values}
    assert status.name == "evaluator: vio_odometry"
    assert recorded["/diagnostics"].stamps == [times[-1]]
    assert int(values["pairs"]) == run_["association"]["pairs"]
    assert values["estimate"].endswith(ODOMETRY)
    assert float(values["ATE position, whole run [m]"]) == pytest.approx(
        run_["ate"]["position_m"]["rmse"], rel=1e-5
    )
    mean = run_["re"]["segments"][0]["position_m"]["mean"]
    assert float(values["RE 8m, mean [m]"]) == pytest.approx(mean, rel=1e-5)


def test_warnings_are_the_status(tmp_path: Path) -> None:
    pair = make_pair(3, 100, smooth=True)
    outcome = run(pair.groundtruth, [pair.estimate])
    warned = dataclasses.replace(
        outcome.runs[0].evaluation,
        remarks=tuple(warning("rain", name) for name in ("it rains", "a lot")),
    )
    outcome = dataclasses.replace(
        outcome, runs=(dataclasses.replace(outcome.runs[0], evaluation=warned),)
    )
    write_error_recording(tmp_path / "errors.mcap", outcome)
    [message] = read_recording(tmp_path / "errors.mcap")["/diagnostics"].messages
    assert (message.status[0].level, message.status[0].message) == (1, "it rains; a lot")


def test_the_alignment_moves_the_estimate_onto_the_aligned_path(
    recorded: dict[str, Recorded], result: dict[str, Any]
) -> None:
    [transform], [run_] = recorded[f"{ROOT}/alignment"].messages, result["runs"]
    moved = transform.transform.translation
    assert [moved.x, moved.y, moved.z] == run_["alignment"]["translation_m"]
    assert (transform.header.frame_id, transform.child_frame_id) == ("world", "odom")
    paths = [recorded[f"{ROOT}/{name}_path"].messages[0] for name in ("aligned", "groundtruth")]
    places = [
        np.array([[p.pose.position.x, p.pose.position.y, p.pose.position.z] for p in path.poses])
        for path in paths
    ]
    errors = recorded[f"{ROOT}/stamped/position_error"].vectors
    assert len(errors) == len(places[0])  # as many as a trail keeps
    assert places[1] - places[0] == pytest.approx(errors, abs=1e-12)


@pytest.mark.slow
@settings(max_examples=5)  # a reading of schemas each
@given(seeds)
def test_live_errors_under_the_last_alignment_are_the_recorded_ones(
    tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    pair, protocol = make_pair(seed, 100, smooth=True), Protocol(gauge="yaw", lengths=())
    path = tmp_path_factory.mktemp("live") / "errors.mcap"
    write_error_recording(path, run(pair.groundtruth, [pair.estimate], Request(protocol)))
    topics = read_recording(path)
    live = OnlineEvaluator(OnlineSettings(protocol))
    for add, side in (
        (live.add_groundtruth, pair.groundtruth),
        (live.add_estimate, pair.estimate),
    ):
        add(trajectory(side.stamps, states(side.positions, side.quaternions, side.velocities)))
    [errors] = live.update(at_end=True).errors  # all at once: under the alignment of all
    for name, expected in (
        ("position", errors.position),
        ("rotation", errors.rotation_vector_deg),
        ("velocity", errors.velocity),
        ("attitude", errors.attitude_deg),
        ("heading", errors.along_cross_vertical),
    ):
        [topic] = [item for item in topics if item.endswith(f"/stamped/{name}_error")]
        assert topics[topic].vectors == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("gauge", ["yaw", "planar", "se3"])
def test_vectors_are_about_the_groundtruth_frame_s_own_axes(gauge: str, tmp_path: Path) -> None:
    pair, up = make_pair(5, 100, smooth=True), UpAxis("-y")
    rotation = Similarity(up.matrix.T, np.zeros(3))
    lying = [
        dataclasses.replace(rotation.trajectory(item), up=up)
        for item in (pair.groundtruth, pair.estimate)
    ]
    vectors = {}
    for name, sides in (("own", (pair.groundtruth, pair.estimate)), ("turned", tuple(lying))):
        request = Request(Protocol(gauge=gauge, lengths=()))
        write_error_recording(tmp_path / name, run(sides[0], [sides[1]], request))
        topics = read_recording(tmp_path / name)
        vectors[name] = {item[-14:]: topics[item].vectors for item in topics if "stamped" in item}
    for topic in ("position_error", "rotation_error", "velocity_error"):
        own = vectors["own"][topic]
        assert len(own)
        assert vectors["turned"][topic] == pytest.approx(own @ up.matrix, abs=1e-9)
    heading = vectors["own"]["/heading_error"]  # about the body's heading, not the frame
    assert vectors["turned"]["/heading_error"] == pytest.approx(heading, abs=1e-9)


@pytest.mark.slow
def test_two_evaluations_give_the_same_bytes(flights: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        assert evaluate(flights, tmp_path / name) == 0
    first, second = (tmp_path / name / "errors.mcap" for name in ("a", "b"))
    assert first.read_bytes() == second.read_bytes()


def test_estimates_that_would_be_called_alike_have_topics_of_their_own(tmp_path: Path) -> None:
    pair = make_pair(1, 100, smooth=True)
    estimates = [dataclasses.replace(pair.estimate, name=name) for name in ("a b", "a-b", "3")]
    outcome = run(pair.groundtruth, estimates)
    write_error_recording(tmp_path / "errors.mcap", outcome)
    topics = read_recording(tmp_path / "errors.mcap")
    parts = {topic.split("/")[2] for topic in topics if topic.startswith("/evaluator")}
    assert parts == {"a_b_1", "a_b_2", "topic_3"}
    [message] = topics["/diagnostics"].messages
    assert [item.name for item in message.status] == [
        "evaluator: a_b_1",
        "evaluator: a_b_2",
        "evaluator: topic_3",
    ]


def test_positions_alone_are_recorded_without_rotations(tmp_path: Path) -> None:
    pair = make_pair(2, 100, smooth=True)
    truth = dataclasses.replace(pair.groundtruth, quaternions=None)
    write_error_recording(tmp_path / "errors.mcap", run(truth, [pair.estimate]))
    topics = read_recording(tmp_path / "errors.mcap")
    [root] = {"/".join(topic.split("/")[:3]) for topic in topics if topic.startswith("/evaluator")}
    assert len(topics[f"{root}/stamped/position_error"].messages)
    assert not topics[f"{root}/stamped/rotation_error"].messages
    assert f"{root}/rotation_error" not in topics


def test_what_cannot_be_finished_leaves_what_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    pair, path = make_pair(1, 100, smooth=True), tmp_path / "errors.mcap"
    outcome = run(pair.groundtruth, [pair.estimate])
    write_error_recording(path, outcome)
    before = path.read_bytes()
    monkeypatch.setattr(Writer, "finish", full)
    with pytest.raises(InputError, match="no space left"):
        write_error_recording(path, outcome)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def shifted(trajectory: Trajectory, by_ns: int) -> Trajectory:
    return dataclasses.replace(trajectory, stamps=trajectory.stamps + by_ns)


@pytest.mark.parametrize("by_s", [-2_000_000_000, 1_000_000_000])
def test_stamps_that_ros_cannot_hold_are_refused(by_s: int, tmp_path: Path) -> None:
    pair = make_pair(1, 100, smooth=True)
    sides = (shifted(item, by_s * NANOSECONDS) for item in (pair.groundtruth, pair.estimate))
    truth, estimate = sides
    with pytest.raises(InputError, match="before 1970 or after 2038"):
        write_error_recording(tmp_path / "errors.mcap", run(truth, [estimate]))
    assert not list(tmp_path.iterdir())


def test_an_input_is_not_written_over(flights: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = next((flights / "mcap").glob("*.mcap"))
    sources = ["-g", f"{bag}:{TRUTH}", "-e", f"{bag}:{ODOMETRY}"]
    assert main(["evaluate", *sources, "--mcap", str(bag)]) == 2
    assert "is also an input" in capsys.readouterr().err


def test_unknown_rotations_stand_as_identities(tmp_path: Path) -> None:
    pair = make_pair(2, 100, smooth=True)
    estimate = dataclasses.replace(pair.estimate, quaternions=None)
    write_error_recording(tmp_path / "errors.mcap", run(pair.groundtruth, [estimate]))
    topics = read_recording(tmp_path / "errors.mcap")
    [path] = [topic for topic in topics if topic.endswith("aligned_path")]
    rotated = topics[path].messages[0].poses[0].pose.orientation
    [alignment] = [topic for topic in topics if topic.endswith("/alignment")]
    rotation = topics[alignment].messages[0].transform.rotation
    both = [[item.x, item.y, item.z, item.w] for item in (rotated, rotation)]
    assert np.abs(lie.multiply(*np.array(both)[:, None])).shape == (1, 4)
    assert both[0] == pytest.approx(both[1], abs=1e-12)
