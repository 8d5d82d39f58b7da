"""Mistakes of users over DDS: a live run names those that an evaluation of its bag names."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from ros_bags import ODOM, POSE, messages_of, write_messages
from ros_processes import GROUNDTRUTH, ODOMETRY, Peer, evaluating, offline

from benchmarks.diagnosis_mistakes import MISTAKES
from benchmarks.diagnosis_runs import simulated
from trajeval_ros.cli.app import main
from trajeval_ros.diagnosis.causes import CAUSES

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros

# So long that the last look for hints sees 18 s twice.
DRONE = simulated(5000, "drone", "walk", 80.0)
# By topic: the mistake, what it is called, and what to type, as the node says it.
TOLD = {
    ODOMETRY: ("", "", ""),
    "/vio/millimetres": ("estimate in mm", "unit", "--correct unit"),
    "/vio/w_first": ("wxyz, estimate", "wxyz", "--correct wxyz"),
    "/vio/camera": ("marker", "body", "hand_eye:=auto"),
    "/vio/gps_time": ("clock +18 s", "clock_offset", "time_offset:=-18"),
}
# Receive times show clocks that differ by seconds; a remark about clocks has no hint beside it.
NOT_HINTED = {"", "clock_offset"}


def test_a_live_run_names_the_mistakes_that_its_recording_shows(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

    feed = messages_of(DRONE.truth, GROUNDTRUTH, POSE)
    arrived = DRONE.estimate.stamps.tolist()
    for topic, (mistake, *_) in TOLD.items():
        estimate = MISTAKES[mistake].make(DRONE).estimate if mistake else DRONE.estimate
        messages = messages_of(estimate, topic, ODOM)
        feed += [
            (*message[:2], logged, message[3])
            for message, logged in zip(messages, arrived, strict=True)
        ]
    bag, folder = tmp_path / "bag", tmp_path / "live"
    write_messages(bag, feed)
    heard = peer.hear("/diagnostics", DiagnosticArray)
    events = peer.hear("/evaluator/event", DiagnosticStatus, latched=True)
    recorded = offline(
        bag, tmp_path, GROUNDTRUTH, list(TOLD), "--gauge", "yaw", "--lengths", "none"
    )
    runs = {_source(item): item for item in recorded["runs"]}
    with evaluating(
        folder, environment, estimates=TOLD, gauge="yaw", lengths="none", window="10s"
    ) as live:
        peer.play(bag, dict.fromkeys((GROUNDTRUTH, *TOLD), 1), ["evaluator"], rate=3.0)
        peer.until(
            lambda: all(
                _hints(topic, events) == {cause} - NOT_HINTED
                and (status := _last_of(topic, heard)) is not None
                and option in status.message
                for topic, (_, cause, option) in TOLD.items()
            ),
            "the mistakes, and nothing else, are told",
        )
        assert live.end() == 0

    finished = tmp_path / "finished.json"
    assert main(["finish", str(folder), "--json", str(finished), "--quiet"]) == 0
    later = {_source(run): run for run in json.loads(finished.read_text())["runs"]}
    for topic, (_, cause, _) in TOLD.items():
        for run in (runs[topic], live.run_of(topic), later[topic]):
            assert _causes(run) == ([cause] if cause else []), run["diagnosis"]
        assert not cause or _last_of(topic, heard).level == DiagnosticStatus.WARN


def _source(run: Any) -> str:
    """Return the topic of a run, live or of a bag."""
    topic: str = run["estimate"]["source"].rpartition(":")[2]
    return topic


def _causes(run: Any) -> list[str]:
    return [diagnosi["cause"] for diagnosi in run["diagnosis"]]


def _values(status: Any) -> dict[str, str]:
    return {value.key: value.value for value in status.values}


def _is_about(topic: str, status: Any) -> bool:
    name: str = status.name
    return name.endswith(topic.strip("/").replace("/", "_"))


def _last_of(topic: str, heard: list[Any]) -> Any:
    """Return the newest status of an estimate; None before the first."""
    about = [item for array in heard for item in array.status if _is_about(topic, item)]
    return about[-1] if about else None


def _hints(topic: str, events: list[Any]) -> set[str]:
    """Return the causes that have been told and are not over."""
    standing: set[str] = set()
    for event in events:
        values = _values(event)
        if values.get("subject") not in CAUSES or not _is_about(topic, event):
            continue
        if event.message.startswith("no longer: "):
            standing.discard(values["subject"])
        else:
            standing.add(values["subject"])
    return standing
