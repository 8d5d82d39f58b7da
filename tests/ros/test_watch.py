"""The watch over DDS: a fault in what one process publishes is an alarm of another's."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_processes import Peer, evaluating, parameters, run_evaluator
from watched_flights import all_sources, watched_bag

from trajeval_ros.cli.app import main

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytest.importorskip("sensor_msgs", reason="sensor_msgs is missing; `make ros-environment` has it")
pytestmark = pytest.mark.ros

RATE = 9.0
WATCHED = {
    "estimates": ["/odom"], "watch_with": ["/vio", "/wheel"], "imu_topic": "/imu",
    "map_to_odom": "/map_to_odom",
}  # fmt: skip
HEARD = {"/odom": 1, "/vio": 1, "/wheel": 1, "/imu": 1, "/map_to_odom": 1}


@pytest.fixture(scope="module")
def diverging(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    return watched_bag(folder, "bag", 4, "diverging 1 m/s2", correction_m=0.4)


@pytest.fixture(scope="module")
def offline(diverging: Path) -> Any:
    """What `trajeval watch` says of the run."""
    path = diverging.with_name("watch.json")
    command = ["watch", *all_sources(diverging), "--quiet"]
    assert main([*command, "--json", str(path)]) == 0
    return json.loads(path.read_text())


def values_of(status: Any) -> dict[str, str]:
    return {value.key: value.value for value in status.values}


def alarms_of(events: list[Any]) -> dict[str, int]:
    """Return when each signal's first alarm began, by the events."""
    result: dict[str, int] = {}
    for event in events:
        values = values_of(event)
        if values["kind"] == "alarm" and event.level != b"\0":
            result.setdefault(values["subject"], int(values["stamp_ns"]))
    return result


def test_an_injected_fault_is_the_alarm_that_the_recording_has(
    peer: Peer,
    environment: dict[str, str],
    diverging: Path,
    offline: Any,
    tmp_path: Path,
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

    expected: dict[str, int] = {}
    for alarm in sorted(offline["alarms"], key=lambda outcome: outcome["begin_ns"]):
        expected.setdefault(alarm["signal"], alarm["begin_ns"])
    assert {
        "pair_percent_5s.vio",
        "pair_percent_5s.wheel",
        "map_correction_m_1s",
    } <= expected.keys()
    events = peer.hear("/evaluator/event", DiagnosticStatus, latched=True)
    diagnostics = peer.hear("/diagnostics", DiagnosticArray)
    values: dict[str, Any] = {**WATCHED, "groundtruth": "", "watch_factor": 1.0}
    with evaluating(tmp_path / "out", environment, **values) as evaluator:
        peer.play(diverging, HEARD, ["evaluator"], RATE)
        peer.until(lambda: alarms_of(events).keys() >= expected.keys(), "all alarms")
        peer.until(
            lambda: any(
                item.name == "evaluator: odom watch" and item.level == b"\2"
                for array in diagnostics
                for item in array.status
            ),
            "diagnostics have the error",
        )
        assert evaluator.end() == 0
    assert not (tmp_path / "out").exists()
    outcome = alarms_of(events)
    assert outcome.keys() == expected.keys()
    np.testing.assert_allclose(
        [outcome[item] for item in expected], list(expected.values()), rtol=0.0, atol=1
    )
    [first, *_] = [event for event in events if values_of(event)["kind"] == "alarm"]
    assert float(values_of(first)["factor"]) == 1.0
    status = [item for array in diagnostics for item in array.status][-1]
    assert "pair_percent_5s" in status.message
    assert float(values_of(status)["factor"]) == 1.0


def test_it_watches_beside_an_evaluation(
    peer: Peer, environment: dict[str, str], diverging: Path, tmp_path: Path
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

    events = peer.hear("/evaluator/event", DiagnosticStatus, latched=True)
    diagnostics = peer.hear("/diagnostics", DiagnosticArray)
    values: dict[str, Any] = {**WATCHED, "groundtruth": "/groundtruth", "watch_factor": 1.0}
    with evaluating(tmp_path / "out", environment, **values) as evaluator:
        peer.play(diverging, {**HEARD, "/odom": 2, "/groundtruth": 1}, ["evaluator"], RATE)
        peer.until(
            lambda: "pair_percent_5s.vio" in alarms_of(events), "an alarm of pair_percent_5s.vio"
        )
        peer.until(
            lambda: any(
                {item.name for item in array.status}
                >= {"evaluator: odom", "evaluator: odom watch"}
                for array in diagnostics
            ),
            "both statuses",
        )
        assert evaluator.end() == 0
    assert evaluator.run_of("/odom")["ate"]["position_m"]["rmse"] > 0.0


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({"imu_topic": "/imu"}, "parameter imu_topic needs the parameter watch_factor"),
        ({"rerun_points": "/points"}, "parameter rerun_points needs the parameters rerun and"),
        (
            {"rerun": "file", "rerun_points": "/a", "groundtruth_topic": "", "watch_factor": 1.0},
            "parameter rerun_points needs the parameters rerun and groundtruth_topic",
        ),
        ({"groundtruth_topic": ""}, "without groundtruth, set watch_factor:=1.0"),
        ({"watch_factor": -1.0}, "watch_factor"),
    ],
)
def test_what_it_lacks_is_one_sentence(
    values: dict[str, Any],
    complaint: str,
    environment: dict[str, str],
    tmp_path: Path,
) -> None:
    values = {"groundtruth_topic": "/groundtruth", "estimate_topics": ["/odom"], **values}
    output = tmp_path / "out"
    done = run_evaluator(environment, *parameters(output=str(output), **values))
    assert done.returncode == 2, done.stderr
    [text] = [line for line in done.stderr.splitlines() if line.startswith("trajeval: ")]
    assert complaint in text
    assert "Traceback" not in done.stderr
    assert not output.exists()


@pytest.mark.parametrize("has_room", [True, False])
def test_an_alarm_calls_the_snapshot_service_once(
    peer: Peer, environment: dict[str, str], diverging: Path, tmp_path: Path, *, has_room: bool
) -> None:
    services = pytest.importorskip(
        "rosbag2_interfaces.srv",
        reason="rosbag2_interfaces is missing; `make test-ros` builds it with a compiler",
    )
    calls: list[Any] = []

    def take(request: Any, response: Any) -> Any:
        calls.append(request)
        response.success = has_room
        return response

    service = peer.node.create_service(services.Snapshot, "/recorder/snapshot", take)
    values: dict[str, Any] = {
        "groundtruth": "/groundtruth", "estimates": ["/odom"], "limits_position_error_m": 5.0,
        "limits_rotation_error_deg": 0.001, "snapshot_service": "/recorder/snapshot",
    }  # fmt: skip
    with evaluating(tmp_path / "out", environment, **values) as evaluator:
        peer.play(diverging, {"/odom": 1, "/groundtruth": 1}, ["evaluator"], RATE)
        answer = "snapshot taken by " if has_room else "no snapshot: "
        text = f"{answer}/recorder/snapshot"
        peer.until(lambda: text in evaluator.printed, text)
        assert evaluator.end() == 0
    peer.node.destroy_service(service)
    assert len(calls) == 1


def test_a_snapshot_service_that_is_not_there_is_one_sentence(
    peer: Peer, environment: dict[str, str], diverging: Path, tmp_path: Path
) -> None:
    pytest.importorskip("rosbag2_interfaces")
    values: dict[str, Any] = {
        "groundtruth": "/groundtruth", "estimates": ["/odom"], "limits_position_error_m": 5.0,
        "snapshot_service": "/recorder/snapshot",
    }  # fmt: skip
    with evaluating(tmp_path / "out", environment, **values) as evaluator:
        peer.play(diverging, {"/odom": 1, "/groundtruth": 1}, ["evaluator"], RATE)
        evaluator.wait_for("no snapshot: no service /recorder/snapshot; start ros2 bag record")
        assert evaluator.end() == 0
