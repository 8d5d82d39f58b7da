"""Discontinuities over the network: the same in status, log, event and result."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_bags import ODOM, POSE, Message, messages_of, write_messages
from ros_processes import Evaluator, Peer, assert_same, offline, play_without_loss

from trajeval_ros import simulate
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros

FAULT_S, FREEZE_S = 12.0, (12.0, 19.0)
GOOD, FROZEN, STEPPED = (f"/groundtruth/{name}" for name in ("good", "frozen", "stepped"))
STEADY, HELD, SMALL, LARGE, CLOCK, SLOW, NOISY = (
    f"/vio/{name}" for name in ("steady", "held", "small", "large", "clock", "slow", "noisy")
)
BEFORE_THE_FIRST_MESSAGE = " yet on "
# Groundtruth, estimate, kind, side, size, start of the sentence, and whether it ends.
ROWS = {
    "frozen_groundtruth": (
        FROZEN, STEADY, "frozen_position", "groundtruth", None,
        "the position of the groundtruth is frozen since ",
    ),
    "held_position": (
        GOOD, HELD, "frozen_position", "estimate", None,
        "the position of the estimate is frozen since ",
    ),
    "step_of_0.3_m": (GOOD, SMALL, "step", "estimate", 0.3, "the estimate jumped by 0."),
    "step_of_0.5_m": (GOOD, LARGE, "step", "estimate", 0.5, "the estimate jumped by 0."),
    "step_of_groundtruth": (
        STEPPED, STEADY, "step", "groundtruth", 0.5, "the groundtruth jumped by 0.",
    ),
    "clock_step": (
        GOOD, CLOCK, "clock_step", "estimate", 0.5, "the estimate's clock stepped by +0.",
    ),
}  # fmt: skip


def moved(source: Trajectory, by_m: float) -> Trajectory:
    positions = source.positions.copy()
    positions[source.seconds > FAULT_S] += by_m * np.array([0.6, 0.0, 0.8])
    return dataclasses.replace(source, positions=positions)


def frozen(source: Trajectory, *, rotates: bool) -> Trajectory:
    """Return a trajectory that repeats its position, or its whole pose, for some seconds."""
    seconds = source.seconds
    inside = (seconds > FREEZE_S[0]) & (seconds < FREEZE_S[1])
    rows = np.where(inside, inside.argmax(), np.arange(len(source)))
    rotated = source.quaternions if rotates else source.known_quaternions[rows]
    return dataclasses.replace(source, positions=source.positions[rows], quaternions=rotated)


def diverging(source: Trajectory) -> Trajectory:
    """Return a trajectory that accelerates by 0.1 m/s^2."""
    since_s = np.maximum(source.seconds - FAULT_S, 0.0)
    added = np.outer(0.05 * since_s**2, [0.6, 0.8, 0.0])
    return dataclasses.replace(source, positions=source.positions + added)


def held_with_noise(source: Trajectory) -> Trajectory:
    """Return a trajectory whose position stays within a millimetre."""
    positions, begin = source.positions.copy(), int(source.seconds.searchsorted(FAULT_S))
    noise = np.random.default_rng(1).normal(0.0, 0.001, positions[begin:].shape)
    positions[begin:] = positions[begin] + noise
    return dataclasses.replace(source, positions=positions)


def of_stepped_clock(source: Trajectory) -> list[Message]:
    """Return messages whose timestamps step forward, and whose times of the bag do not."""
    step_ns = round(0.5 * NANOSECONDS)
    stamps = source.stamps + step_ns * (source.seconds > FAULT_S)
    written = messages_of(dataclasses.replace(source, stamps=stamps), CLOCK, ODOM)
    return [
        (topic, kind, logged, payload)
        for (topic, kind, _, payload), logged in zip(written, source.stamps.tolist(), strict=True)
    ]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    flight = simulate(5, 26.0)
    truth, estimate = flight.groundtruth[::2], flight.estimate
    path = tmp_path_factory.mktemp("discontinuities") / "bag"
    messages = [
        *messages_of(truth, GOOD, POSE),
        *messages_of(frozen(truth, rotates=False), FROZEN, POSE),
        *messages_of(moved(truth, 0.5), STEPPED, POSE),
        *messages_of(estimate, STEADY, ODOM),
        *messages_of(frozen(estimate, rotates=True), HELD, ODOM),
        *messages_of(moved(estimate, -0.3), SMALL, ODOM),
        *messages_of(moved(estimate, 0.5), LARGE, ODOM),
        *messages_of(diverging(estimate), SLOW, ODOM),
        *messages_of(held_with_noise(estimate), NOISY, ODOM),
        *of_stepped_clock(estimate),
    ]
    write_messages(path, messages)
    return path


class Heard:
    """What the nodes published."""

    def __init__(self, nodes: dict[str, Evaluator], statuses: list[Any], events: Any) -> None:
        self.nodes, self.statuses, self.events = nodes, statuses, events

    def warnings_of(self, node: str, name: str) -> list[str]:
        """Return the texts of the statuses of an estimate that were no OK."""
        return [
            status.message
            for status in self.statuses
            if status.name == f"{node}: {name}"
            and status.level == b"\x01"
            and BEFORE_THE_FIRST_MESSAGE not in status.message
        ]

    def events_of(self, node: str, name: str) -> list[dict[str, str]]:
        """Return the values of the warnings about an estimate, with the sentence.

        A slow start-up is told, too: "no estimate yet on".  It is no fault of the data.
        """
        return [
            {"sentence": event.message, **{pair.key: pair.value for pair in event.values}}
            for event in self.events[node]
            if event.level == b"\x01"
            and event.name.endswith(name)
            and BEFORE_THE_FIRST_MESSAGE not in event.message
        ]


@pytest.fixture(scope="module")
def heard(
    bag: Path, peer: Peer, environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory
) -> Heard:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

    arrays = peer.hear("/diagnostics", DiagnosticArray)
    common = {"gauge": "yaw", "lengths": "8"}
    nodes = {
        "good": {
            **common, "groundtruth": GOOD,
            "estimates": [STEADY, HELD, SMALL, LARGE, CLOCK, SLOW, NOISY],
        },
        "frozen": {**common, "groundtruth": FROZEN, "estimates": [STEADY]},
        "stepped": {**common, "groundtruth": STEPPED, "estimates": [STEADY]},
    }  # fmt: skip
    events = {node: peer.hear(f"/{node}/event", DiagnosticStatus, latched=True) for node in nodes}
    folder = tmp_path_factory.mktemp("heard")
    done = play_without_loss(bag, peer, environment, folder, nodes, rate=1.0)
    return Heard(done, [status for array in arrays for status in array.status], events)


@pytest.mark.parametrize("row", list(ROWS))
def test_status_log_event_and_result_say_the_same(heard: Heard, row: str) -> None:
    groundtruth, topic, kind, side, size, sentence = ROWS[row]
    node, name = groundtruth.rsplit("/", 1)[1], topic.strip("/").replace("/", "_")
    [event] = [item for item in heard.events_of(node, name) if item["kind"] == kind]
    assert event["subject"] == side
    assert event["sentence"].startswith(sentence)
    assert f"{name}: {event['sentence']}" in heard.nodes[node].printed
    assert any(kind_words(kind, sentence) in text for text in heard.warnings_of(node, name))
    [recorded] = [
        item for item in heard.nodes[node].run_of(topic)["events"] if item["kind"] == kind
    ]
    assert recorded["side"] == side
    if size is not None:
        measured = recorded["s"] if kind == "clock_step" else recorded["m"]
        assert measured == pytest.approx(size, abs=0.06)
    else:
        assert float(event["s"]) < FREEZE_S[1] - FREEZE_S[0]  # it is reported while it lasts


@pytest.mark.parametrize("topic", [SLOW, NOISY])
def test_a_divergence_is_told_live_and_in_the_result(heard: Heard, topic: str) -> None:
    name, sentence = topic.strip("/").replace("/", "_"), "the estimate diverges from "
    told = [item for item in heard.statuses if item.name == f"good: {name}"]
    events = [item for item in heard.events["good"] if item.name.endswith(name)]
    for items in (told, events):  # a warning, or an error if it lasts 3 s and none is graver
        levels = [item.level for item in items if item.message.startswith(sentence)]
        assert levels
        assert set(levels) <= {b"\x01", b"\x02"}
        assert levels == sorted(levels)
    assert sentence in heard.nodes["good"].printed
    recorded = heard.nodes["good"].run_of(topic)
    [event] = [item for item in recorded["events"] if item["kind"] == "diverged"]
    assert (event["side"], event["certainty"]) == ("estimate", "sure")
    if topic == SLOW:  # it is not larger than a large drift: the result has no finding
        assert any(sentence in remark["text"] for remark in recorded["remarks"])
        return
    [finding] = recorded["diagnosis"]
    assert finding["cause"] == "diverged"
    assert finding["evidence"]["at_s"] == pytest.approx(FAULT_S, abs=6.0)


def kind_words(kind: str, sentence: str) -> str:
    """Return what the status says: the sentence of a condition, or the number of steps."""
    return "1 step of the " if kind == "step" else sentence


def test_nothing_else_is_reported(heard: Heard) -> None:
    """Neither of the steady estimate, nor beside the fault of another one."""
    assert heard.nodes["good"].run_of(STEADY)["events"] == []
    assert heard.warnings_of("good", "vio_steady") == []
    for name in ("small", "large", "clock"):
        told = heard.events_of("good", f"vio_{name}")
        assert {item["kind"] for item in told} <= {"step", "clock_step"}, told


def test_results_are_those_of_the_recording(heard: Heard, bag: Path, tmp_path: Path) -> None:
    topics = [STEADY, HELD, SMALL, LARGE, CLOCK, SLOW, NOISY]
    recorded = offline(bag, tmp_path, GOOD, topics, "--gauge", "yaw", "--lengths", "8")["runs"]
    for topic, expected in zip(topics, recorded, strict=True):
        live = heard.nodes["good"].run_of(topic)
        events = [
            [[event[name] for name in ("kind", "side", "t_ns")] for event in side["events"]]
            for side in (live, expected)
        ]
        assert events[0] == events[1], topic
        assert_same(live["ate"], expected["ate"], topic)
