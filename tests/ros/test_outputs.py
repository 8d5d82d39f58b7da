"""What the evaluator publishes and answers, heard and asked by another process."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_runs import path_messages
from recorded_errors import read_recording
from recorded_runs import pairs_of
from ros_bags import POSE, messages_of, write_messages
from ros_processes import (
    GROUNDTRUTH,
    ODOMETRY,
    Evaluator,
    Peer,
    assert_same,
    evaluating,
    offline,
    replay,
)
from strategies import make_pair
from waiting import until

from trajeval_ros.cli.app import main
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.ros.message_types import message_class

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros

NUMBERS = ("position_error", "rotation_error")
ATE, ATE_ROTATION = "stamped/ate/position", "stamped/ate/rotation"
RELATIVE = "stamped/relative_error"
STREAM = ("rate", "jitter", "largest_gap", "arrival")
ANGLES = ("yaw_error", "tilt_error")
VECTORS = ("position_error", "rotation_error", "attitude_error", "heading_error")
NAME = "vio_odometry"


@dataclass
class Heard:
    """A run that a peer has followed.

    Attributes:
        evaluator: The evaluator, which has ended.
        bag: What was played.
        numbers: Values by topic, as they came.
        messages: Other messages by topic.
        saved: What ~/save and ~/reset answered, and the results at that time.
        set: Results of setting parameters, by name.
        published: Types of all topics about the estimate.
    """

    evaluator: Evaluator
    bag: Path
    numbers: dict[str, list[float]]
    messages: dict[str, list[Any]]
    saved: dict[str, Any]
    set: dict[str, Any]
    published: dict[str, str]


def values_of(status: Any) -> dict[str, str]:
    return {value.key: value.value for value in status.values}


def kinds_of(events: list[Any]) -> list[str]:
    return [values_of(event)["kind"] for event in events]


def newest_ns(message: Any) -> int:
    """Return the stamp of a message, and of the last pose of a path."""
    stamp = (message.poses[-1] if getattr(message, "poses", ()) else message).header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


@pytest.fixture(scope="module")
def heard(
    flights: Path,
    peer: Peer,
    environment: dict[str, str],
    tmp_path_factory: pytest.TempPathFactory,
) -> Heard:
    """Follow a run with simulated time, a parameter file and a remapped topic."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
    from geometry_msgs.msg import TransformStamped, Vector3Stamped
    from nav_msgs.msg import Path as PathMessage
    from std_msgs.msg import Float64
    from std_srvs.srv import Trigger

    bag, folder = flights / "mcap", tmp_path_factory.mktemp("heard")
    floats = {item: peer.hear(f"/judge/{NAME}/{item}", Float64) for item in (*NUMBERS, *ANGLES)}
    streams = [f"stream/{side}/{item}" for side in (NAME, "groundtruth_pose") for item in STREAM]
    floats |= {stream: peer.hear(f"/judge/{stream}", Float64) for stream in streams}
    kinds = {
        "alignment": TransformStamped,
        "aligned_path": PathMessage,
        "groundtruth_path": PathMessage,
    }
    messages = {
        item: peer.hear(f"/judge/{NAME}/{item}", kind, latched=True)
        for item, kind in kinds.items()
    }
    lengths = [
        f"{RELATIVE}/length_{length}/{part}"
        for length in ("8m", "2_5s")
        for part in ("position", "rotation")
    ]
    errors = (f"stamped/{item}" for item in (*VECTORS, "velocity_error"))
    for error in (*errors, ATE, ATE_ROTATION, *lengths):
        messages[error] = peer.hear(f"/judge/{NAME}/{error}", Vector3Stamped)
    messages["diagnostics"] = peer.hear("/diagnostics", DiagnosticArray)
    file = folder / "judge.yaml"
    file.write_text(
        "/**:\n  ros__parameters:\n    window: 10s\n    gauge: yaw\n    lengths: 8\n"
        "    max_gap: 1\n    publish_rate: 20\n    autosave_period: 0\n    use_sim_time: true\n"
    )
    arguments = ["--params-file", str(file), "-r", "__node:=judge", "-r", "/odom:=/vio/odometry"]
    with evaluating(
        folder / "out",
        environment,
        *arguments,
        estimates=["/odom"],
        limits_position_error_m="0.001,0",
    ) as evaluator:
        saved = {"too early": peer.ask("/judge/save", Trigger)}
        results = {
            "live": peer.set("/judge", window="0", lengths="8,2.5s", publish_rate=40.0),
            "integer": peer.set("/judge", publish_rate=30),
            "read-only": peer.set("/judge", gauge="sim3"),
            "nonsense": peer.set("/judge", window="abc"),
            "beyond": peer.set("/judge", publish_rate=1e4),
        }
        replay(bag, environment, "--rate", 8)
        saved["saved"] = peer.ask("/judge/save", Trigger)
        saved["result"] = evaluator.result
        # What is published may be heard long after the answer that all is saved.
        [run] = saved["result"]["runs"]
        last_ns = int(pairs_of(evaluator.folder, NAME).estimate.stamps[-1])
        for item in (*(f"stamped/{vector}" for vector in VECTORS), *kinds):
            peer.until(
                lambda: messages[item] and newest_ns(messages[item][-1]) == last_ns,  # noqa: B023
                f"{item} of the last pair",
            )
        rmse_m = run["ate"]["position_m"]["rmse"]
        peer.until(
            lambda: (
                messages[ATE] and messages[ATE][-1].vector.x == pytest.approx(rmse_m, rel=1e-9)
            ),
            "the last ATE is published",
        )
        pairs = str(run["association"]["pairs"])
        peer.until(
            lambda: (
                (told := messages["diagnostics"])
                and told[-1].status
                and values_of(told[-1].status[0])["pairs"] == pairs
            ),
            "diagnostics of the last pair",
        )
        published = {
            topic: types[0]
            for topic, types in peer.node.get_topic_names_and_types()
            if topic.startswith(f"/judge/{NAME}/")
        }
        first = {item: [number.data for number in of] for item, of in floats.items()}
        messages = {item: list(of) for item, of in messages.items()}
        # Who comes late hears what has been.
        messages["event"] = peer.hear("/judge/event", DiagnosticStatus, latched=True)
        peer.until(lambda: "alarm" in kinds_of(messages["event"]), "an alarm is an event")
        saved["reset"] = peer.ask("/judge/reset", Trigger)
        peer.until(lambda: "restart" in kinds_of(messages["event"]), "a reset is an event")
        replay(bag, environment, "--rate", 8, "--end", 12)
        saved["after reset"] = peer.ask("/judge/save", Trigger)
        assert evaluator.end() == 0
    return Heard(evaluator, bag, first, messages, saved, results, published)


def test_the_last_published_ate_is_that_of_the_result(heard: Heard) -> None:
    [run] = heard.saved["result"]["runs"]
    ate = heard.messages[ATE][-1]
    assert ate.vector.x == pytest.approx(run["ate"]["position_m"]["rmse"], rel=1e-9)
    rotation = heard.messages[ATE_ROTATION][-1].vector.x
    assert rotation == pytest.approx(run["ate"]["rotation_deg"]["rmse"], rel=1e-9)
    assert newest_ns(ate) == newest_ns(heard.messages["stamped/position_error"][-1])
    assert newest_ns(heard.messages[ATE][0]) < newest_ns(ate)
    assert all(np.isfinite(heard.numbers[number]).all() for number in NUMBERS)
    # The alignment at the time was of fewer states, so errors differ, but not by their size.
    assert 0.0 < np.median(heard.numbers["position_error"]) < run["ate"]["position_m"]["max"]
    assert len(heard.numbers["position_error"]) > 20


def test_the_health_of_both_streams_is_published_and_in_the_result(heard: Heard) -> None:
    [run] = heard.saved["result"]["runs"]
    groundtruth = read_trajectory(f"{heard.bag}:{GROUNDTRUTH}")
    for name, side, trajectory in (
        (NAME, "estimate", read_trajectory(f"{heard.bag}:{ODOMETRY}")),
        ("groundtruth_pose", "groundtruth", groundtruth),
    ):
        published = {item: heard.numbers[f"stream/{name}/{item}"] for item in STREAM}
        stream, steps_s = run["live"]["streams"][side], np.diff(trajectory.stamps) * 1e-9
        assert stream["messages"] == len(trajectory.stamps)
        assert stream["rate_hz"] == pytest.approx(1.0 / steps_s.mean(), rel=1e-6)
        assert stream["jitter_s"] == pytest.approx(steps_s.std(), abs=1e-6)
        assert stream["largest_gap_s"] == pytest.approx(steps_s.max(), abs=1e-9)
        assert published["rate"][-1] == pytest.approx(stream["rate_hz"], rel=0.2)
        # The bag is played at rate 8, and both are in simulated time.
        assert stream["arrival_p50_s"] <= stream["arrival_p95_s"] <= stream["arrival_max_s"]
        assert abs(stream["arrival_p50_s"]) < 2.0


def test_relative_errors_are_published_as_sub_trajectories_end(heard: Heard) -> None:
    [run] = heard.saved["result"]["runs"]
    for segment, topic in zip(run["re"]["segments"], ("length_8m", "length_2_5s"), strict=True):
        for part, metric in (("position", "position_m"), ("rotation", "rotation_deg")):
            published = heard.messages[f"{RELATIVE}/{topic}/{part}"]
            assert 5 < len(published) <= segment["pairs"]
            stamps = [newest_ns(message) for message in published]
            assert stamps == sorted(stamps)
            values = [message.vector.x for message in published]
            assert min(values) >= segment[metric]["min"] * (1 - 1e-9)
            assert max(values) <= segment[metric]["max"] * (1 + 1e-9)


def test_the_alignment_moves_the_estimate_onto_the_groundtruth(heard: Heard) -> None:
    [run], transform = heard.saved["result"]["runs"], heard.messages["alignment"][-1]
    moved, rotated = transform.transform.translation, transform.transform.rotation
    alignment = run["alignment"]
    assert [moved.x, moved.y, moved.z] == pytest.approx(alignment["translation_m"], abs=0.05)
    quaternion = np.array([rotated.x, rotated.y, rotated.z, rotated.w])
    assert abs(quaternion @ alignment["rotation_xyzw"]) == pytest.approx(1.0, abs=1e-4)
    assert transform.header.frame_id == heard.saved["result"]["groundtruth"]["frame"]
    assert transform.child_frame_id == run["estimate"]["frame"]


def test_paths_lie_on_each_other(heard: Heard) -> None:
    [run] = heard.saved["result"]["runs"]
    aligned, groundtruth = (
        heard.messages[name][-1] for name in ("aligned_path", "groundtruth_path")
    )
    assert aligned.header.frame_id == groundtruth.header.frame_id
    assert 100 < len(aligned.poses) == len(groundtruth.poses) <= 2001
    places = [
        np.array([[p.pose.position.x, p.pose.position.y, p.pose.position.z] for p in path.poses])
        for path in (aligned, groundtruth)
    ]
    errors = np.linalg.norm(places[0] - places[1], axis=1)
    assert errors.max() < 2.0 * run["ate"]["position_m"]["max"]
    stamps = [
        pose.header.stamp.sec * 10**9 + pose.header.stamp.nanosec for pose in groundtruth.poses
    ]
    assert stamps == sorted(stamps)


def test_diagnostics_tell_how_it_goes(heard: Heard) -> None:
    statuses = [
        diagnostic.status[0] for diagnostic in heard.messages["diagnostics"] if diagnostic.status
    ]
    assert {status.name for status in statuses} == {f"judge: {NAME}"}
    assert {status.hardware_id for status in statuses} == {"robot"}
    last = statuses[-1]
    values = {value.key: value.value for value in last.values}
    [run] = heard.saved["result"]["runs"]
    assert int(values["pairs"]) == run["association"]["pairs"]
    assert values["messages lost"] == values["groundtruth messages lost"] == "0"
    assert values["estimate"] == ODOMETRY
    assert float(values["ATE position, whole run [m]"]) == pytest.approx(
        run["ate"]["position_m"]["rmse"], rel=1e-5
    )
    alarms = {status.message for status in statuses if "is over 0.001 m" in status.message}
    assert alarms
    assert len(alarms) <= 3  # not another text every second
    # In simulated time arrival and stamp are of one clock, which is why there is a risk to tell.
    assert abs(float(values["arrival after stamp, p50 [s]"])) < 2.0
    assert "sync risk [m]" in values


def test_an_alarm_is_an_event_with_its_numbers(heard: Heard) -> None:
    [alarm, *_] = [
        message for message in heard.messages["event"] if values_of(message)["kind"] == "alarm"
    ]
    values = values_of(alarm)
    assert alarm.name == f"judge: {NAME}"
    assert alarm.level == b"\x01"
    assert values["subject"] == "position_error_m"
    assert float(values["value"]) > float(values["limit"]) == 0.001
    assert int(values["stamp_ns"]) > 0
    assert alarm.message.startswith("position error ")
    assert alarm.message.endswith(" m is over 0.001 m")


def test_every_pair_has_an_error_with_the_stamp_of_its_estimate(heard: Heard) -> None:
    [run] = heard.saved["result"]["runs"]
    stamps_in_bag = read_trajectory(f"{heard.bag}:{ODOMETRY}").stamps.tolist()
    vectors = {}
    for vector in VECTORS:
        messages = heard.messages[f"stamped/{vector}"]
        stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages]
        assert 0.9 * run["association"]["pairs"] < len(stamps) <= run["association"]["pairs"]
        assert stamps == sorted(set(stamps) & set(stamps_in_bag))
        assert {m.header.frame_id for m in messages} == {
            heard.saved["result"]["groundtruth"]["frame"]
        }
        vectors[vector] = np.array([[m.vector.x, m.vector.y, m.vector.z] for m in messages])
    lengths = {vector: np.linalg.norm(vectors[vector], axis=1) for vector in VECTORS}
    attitude = vectors["attitude_error"]
    # The plain numbers are those of the newest pair of each tick.
    for name, of_pairs in (
        ("position_error", lengths["position_error"]),
        ("position_error", lengths["heading_error"]),
        ("rotation_error", lengths["rotation_error"]),
        ("yaw_error", attitude[:, 2]),
        ("tilt_error", np.hypot(attitude[:, 0], attitude[:, 1])),
    ):
        numbers = np.array(heard.numbers[name])
        assert len(numbers) > 20
        nearest = np.abs(numbers[:, None] - of_pairs[None]).min(axis=1)
        assert nearest.max() < 1e-9
    # This groundtruth is of poses alone.
    assert heard.messages["stamped/velocity_error"] == []


def test_harmless_parameters_can_be_set_and_others_cannot(heard: Heard) -> None:
    assert all(item.successful for item in heard.set["live"])
    assert heard.set["integer"][0].successful
    assert not heard.set["read-only"][0].successful
    assert "read-only" in heard.set["read-only"][0].reason
    assert not heard.set["nonsense"][0].successful
    assert "'abc' is not valid" in heard.set["nonsense"][0].reason
    assert not heard.set["beyond"][0].successful
    assert "publish_rate out of range" in heard.set["beyond"][0].reason


def test_save_answers_when_it_is_written(heard: Heard, tmp_path: Path) -> None:
    assert not heard.saved["too early"].success
    assert "no pair" in heard.saved["too early"].message
    assert heard.saved["saved"].success
    assert heard.saved["saved"].message == str(heard.evaluator.folder / "result.json")
    options = ["--gauge", "yaw", "--lengths", "8,2.5s", "--max-gap", "1"]
    expected = offline(heard.bag, tmp_path, GROUNDTRUTH, [ODOMETRY], *options)
    saved = heard.saved["result"]
    # What comes after the last groundtruth is decided at the end.
    assert_same(saved, expected)


def test_reset_begins_anew_and_leaves_what_was(heard: Heard) -> None:
    assert heard.saved["reset"].success
    anew = heard.evaluator.folder.with_name("out_2")
    assert str(anew) in heard.saved["reset"].message
    assert heard.saved["after reset"].message == str(anew / "result.json")
    later = json.loads((anew / "result.json").read_text())
    [run] = later["runs"]
    assert 180 < run["association"]["pairs"] < 260
    assert run["events"] == []
    until(lambda: (heard.evaluator.folder / "errors.npz").exists(), "the first run is finished")
    assert_same(heard.evaluator.result, heard.saved["result"])


def test_a_recording_of_errors_has_the_topics_and_types_of_the_node(
    heard: Heard, tmp_path: Path
) -> None:
    path = tmp_path / "errors.mcap"
    sources = ["-g", f"{heard.bag}:{GROUNDTRUTH}", "-e", f"{heard.bag}:{ODOMETRY}"]
    options = ["--gauge", "yaw", "--lengths", "8,2.5s", "--max-gap", "1", "--quiet"]
    assert main(["evaluate", *sources, *options, "--mcap", str(path)]) == 0
    recorded = read_recording(path)
    types = {topic.replace("/evaluator/", "/judge/"): of.type for topic, of in recorded.items()}
    published = {**heard.published, "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray"}
    assert types == published
    # What rclpy makes of the bytes is what is in them, and the last published is what it ends at.
    for topic, of in recorded.items():
        for payload, expected in list(zip(of.payloads, of.messages, strict=True))[:5]:
            from rclpy.serialization import deserialize_message

            message = deserialize_message(payload, message_class(of.type))
            assert plain(message) == plain(expected), topic
    last = recorded[f"/evaluator/{NAME}/{ATE}"].vectors[-1]
    assert heard.messages[ATE][-1].vector.x == pytest.approx(last[0], rel=1e-9)
    [told] = recorded["/diagnostics"].messages
    live = [
        diagnostic.status[0] for diagnostic in heard.messages["diagnostics"] if diagnostic.status
    ][-1]
    assert {value.key for value in told.status[0].values} <= set(values_of(live))


def plain(message: Any) -> Any:
    """Return the fields of a message of rclpy or rosbags."""
    if isinstance(message, bytes):
        return message[0]
    names: list[str] = []
    if hasattr(message, "get_fields_and_field_types"):
        names = list(message.get_fields_and_field_types())
    elif dataclasses.is_dataclass(message):  # with the type's constants
        names = [field.name for field in dataclasses.fields(message) if field.name.islower()]
    if names:
        return {name: plain(getattr(message, name)) for name in names if name[0] != "_"}
    return [plain(item) for item in message] if isinstance(message, list) else message


def test_the_newest_path_is_published_as_it_is_evaluated(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from geometry_msgs.msg import TransformStamped, Vector3Stamped
    from nav_msgs.msg import Path as PathMessage
    from std_srvs.srv import Trigger

    pair, bag = make_pair(3, 160, smooth=True), tmp_path / "bag"
    groundtruth = messages_of(pair.groundtruth, GROUNDTRUTH, POSE)
    write_messages(bag, [*groundtruth, *path_messages(pair.estimate, 7)])
    base = "/evaluator/vio/revised"
    lengths = (f"{RELATIVE}/length_2m/position", f"{RELATIVE}/length_2m/rotation")
    topics = (ATE, ATE_ROTATION, *lengths)
    vectors = {item: peer.hear(f"{base}/{item}", Vector3Stamped, latched=True) for item in topics}
    paths = peer.hear(f"{base}/aligned_path", PathMessage, latched=True)
    alignments = peer.hear(f"{base}/alignment", TransformStamped, latched=True)
    options = {"estimates": ["/vio"], "gauge": "yaw", "lengths": "2,4"}
    with evaluating(tmp_path / "out", environment, **options) as evaluator:
        replay(bag, environment, "--rate", 4)
        peer.until(lambda: vectors[lengths[-1]], "the newest path is evaluated")
        assert peer.ask("/evaluator/save", Trigger).success
        run = evaluator.run_of("/vio")
        segment = run["re"]["segments"][0]
        metrics = ("position_m", "rotation_deg")
        rmse = [of[metric]["rmse"] for of in (run["ate"], segment) for metric in metrics]
        for topic, expected in zip(topics, rmse, strict=True):
            peer.until(
                lambda: (
                    vectors[topic]  # noqa: B023
                    and vectors[topic][-1].vector.x == pytest.approx(expected, rel=1e-9)  # noqa: B023
                ),
                f"{topic} of the newest path",
            )
        pairs = run["association"]["pairs"]
        peer.until(lambda: paths and len(paths[-1].poses) == pairs, "the newest path, aligned")
        last_ns = newest_ns(paths[-1])
        peer.until(
            lambda: alignments and newest_ns(alignments[-1]) == last_ns, "the newest alignment"
        )
        assert evaluator.end() == 0
    moved = alignments[-1].transform.translation
    assert [moved.x, moved.y, moved.z] == pytest.approx(run["alignment"]["translation_m"])
    causal = run["live"]["causal_ate"]["position_m"]["rmse"]
    assert causal > 1.5 * vectors[ATE][-1].vector.x
