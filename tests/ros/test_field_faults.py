"""Faults of robots in the field, over the network, with nodes as they run."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_bags import ODOM, POSE, Message, messages_of, write_messages
from ros_processes import GROUNDTRUTH, ODOMETRY, Evaluator, Peer, evaluating, play_to_nodes

from trajeval_ros import simulate
from trajeval_ros.cli.app import main
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros

FAULT_S = 12.0
WARNING = b"\x01"


def played_to_nodes(
    bag: Path,
    peer: Peer,
    environment: dict[str, str],
    folder: Path,
    sides: dict[str, tuple[str, str]],
    **values: Any,
) -> tuple[dict[str, Evaluator], dict[str, list[Any]]]:
    """Play a bag to one node per pair of topics; return the nodes and their warnings."""
    from diagnostic_msgs.msg import DiagnosticStatus

    events = {name: peer.hear(f"/{name}/event", DiagnosticStatus, latched=True) for name in sides}
    options = {
        name: {
            "groundtruth": groundtruth, "estimates": [estimate], "gauge": "yaw",
            "lengths": "none", **values,
        }
        for name, (groundtruth, estimate) in sides.items()
    }  # fmt: skip
    nodes = play_to_nodes(bag, peer, environment, folder, options, rate=2.0)
    return nodes, {name: warnings_in(heard) for name, heard in events.items()}


def warnings_in(events: list[Any]) -> list[dict[str, str]]:
    """Return the values and sentences of warnings, but for those of a slow start-up."""
    return [
        {"sentence": event.message, **{pair.key: pair.value for pair in event.values}}
        for event in events
        if event.level >= WARNING
        and " yet on " not in event.message
        and not event.message.startswith("no longer")
    ]


def with_stepped_clock(source: Trajectory, topic: str, kind: str, step_s: float) -> list[Message]:
    """Return messages whose timestamps step, and whose times of the bag do not."""
    stamps = source.stamps + round(step_s * NANOSECONDS) * (source.seconds > FAULT_S)
    step = np.flatnonzero(source.seconds > FAULT_S)[0]
    written = []
    for part in (slice(step), slice(step, None)):
        states = dataclasses.replace(source[part], stamps=stamps[part])
        for message, logged in zip(
            messages_of(states, topic, kind), source.stamps[part].tolist(), strict=True
        ):
            written.append((*message[:2], logged, message[3]))
    return written


def test_a_step_of_both_clocks_is_no_fault(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    flight = simulate(5, 26.0)
    truth = flight.groundtruth[::2]
    sides = {name: (f"/groundtruth/{name}", f"/vio/{name}") for name in ("back", "forward")}
    messages: list[Message] = []
    for (groundtruth, estimate), step_s in zip(sides.values(), (-5.0, 5.0), strict=True):
        messages += with_stepped_clock(truth, groundtruth, POSE, step_s)
        messages += with_stepped_clock(flight.estimate, estimate, ODOM, step_s)
    write_messages(tmp_path / "bag", messages)
    nodes, warnings = played_to_nodes(
        tmp_path / "bag", peer, environment, tmp_path / "live", sides
    )
    told = [item for heard in warnings.values() for item in heard if "clock" in item["kind"]]
    assert told == []
    # A step back begins another run. A step forward is a pause of both sides.
    assert (tmp_path / "live" / "back_2" / "result.json").exists()
    assert "time of /groundtruth/back stepped back by" in nodes["back"].printed or (
        "time of /vio/back stepped back by" in nodes["back"].printed
    )
    assert not (tmp_path / "live" / "forward_2").exists()
    [run] = nodes["forward"].result["runs"]
    assert run["association"]["pairs"] > 0.9 * len(flight.estimate)
    [step] = [event for event in run["events"] if event["kind"] == "clock_step"]
    assert step["side"] == "both"
    assert step["s"] == pytest.approx(5.0, abs=0.1)


def test_a_marker_that_flips_ends_neither_the_node_nor_its_results(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    """The motion contradicts every clock offset and every pose of the marker."""
    flight = simulate(5, 45.0)
    truth = flight.groundtruth[::4]
    assert truth.quaternions is not None
    flip = np.array([0.0, 1.0, 0.0, 0.0])  # 180 deg about y
    flipped = lie.multiply(truth.quaternions, flip[None])
    rotations = np.where((truth.seconds > FAULT_S)[:, None], flipped, truth.quaternions)
    flips = dataclasses.replace(truth, quaternions=rotations)
    bag = tmp_path / "bag"
    messages = messages_of(flips, GROUNDTRUTH, POSE)
    write_messages(bag, [*messages, *messages_of(flight.estimate, ODOMETRY, ODOM)])
    sides = {"flips": (GROUNDTRUTH, ODOMETRY)}
    nodes, _ = played_to_nodes(
        bag, peer, environment, tmp_path / "live", sides, time_offset="auto", hand_eye="auto"
    )
    [run] = nodes["flips"].result["runs"]
    assert run["association"]["pairs"] > 0.9 * len(flight.estimate)  # none was left undrained
    codes = {remark["code"]: remark["text"] for remark in run["remarks"]}
    assert "time offset" in codes["clock_offset"]
    assert "failed" not in codes["clock_offset"]
    # What the node wrote at its end, `trajeval finish` writes again, into the same folder.
    folder = nodes["flips"].folder
    written = {path.name for path in folder.iterdir()}
    for name in ("result.json", "errors.npz"):
        (folder / name).unlink()
    assert main(["finish", str(folder), "--quiet"]) == 0
    assert {path.name for path in folder.iterdir()} == written


def test_a_lost_estimate_has_no_hints(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    flight = simulate(5, 40.0)
    truth, estimate = flight.groundtruth[::4], flight.estimate
    rows = np.where(
        estimate.seconds > FAULT_S,
        np.flatnonzero(estimate.seconds > FAULT_S)[0],
        np.arange(len(estimate)),
    )
    frozen = dataclasses.replace(
        estimate,
        positions=estimate.positions[rows],
        quaternions=estimate.known_quaternions[rows],
        velocities=None,
    )
    diverged = estimate.positions.copy()
    later = np.maximum(estimate.seconds - FAULT_S, 0.0)[:, None]
    diverged += 0.5 * later**2 * np.array([0.6, 0.8, 0.0])
    bag = tmp_path / "bag"
    written = messages_of(truth, GROUNDTRUTH, POSE)
    for topic, states in (
        ("/vio/frozen", frozen),
        ("/vio/diverged", dataclasses.replace(estimate, positions=diverged)),
    ):
        written += messages_of(states, topic, ODOM)
    write_messages(bag, written)
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

    arrays = peer.hear("/diagnostics", DiagnosticArray)
    events = peer.hear("/evaluator/event", DiagnosticStatus, latched=True)
    estimates = ["/vio/frozen", "/vio/diverged"]
    with evaluating(
        tmp_path / "live", environment, estimates=estimates, gauge="yaw", lengths="none"
    ) as live:
        topics = {GROUNDTRUTH: 1, **dict.fromkeys(estimates, 1)}
        peer.play(bag, topics, ["evaluator"], rate=1.0)
        assert live.end() == 0
    told = warnings_in(events)
    assert {item["kind"] for item in told}  # the losses
    # That positions determine the alignment poorly is said before the fault.
    hints = [item for item in told if item["kind"] in ("hint", "clock")]
    assert [item["sentence"] for item in hints if item.get("subject") != "alignment"] == []
    texts = [item.message for array in arrays for item in array.status if item.level >= WARNING]
    assert [text for text in texts if "set time_offset" in text or "Euler" in text] == []
