"""Hints while a run goes on, and the thread that looks for them."""

from __future__ import annotations

import dataclasses
import threading
from pathlib import Path

import numpy as np
import pytest
from live_runs import ESTIMATE, GROUNDTRUTH, Live
from marker_flights import MOUNTED, of_marker
from ros_bags import ODOM, POSE, TRANSFORMS, messages_of, transforms_message, write_messages
from waiting import until

from benchmarks.diagnosis_runs import simulated
from trajeval_ros import simulate
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level, Remark
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.requests.request_from import in_names_of_settings, known_hand_eye
from trajeval_ros.metrics.association import associate
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.online.alarms import LIMITED_QUANTITIES, AlarmLimits
from trajeval_ros.online.pairing import PairedStates
from trajeval_ros.online.state_buffer import NO_STATES
from trajeval_ros.ros.diagnostics import remarks_about
from trajeval_ros.ros.slow_evaluation import PARAMETER_NAMES, BackgroundTask, hints_about
from trajeval_ros.simulation.drifting_odometry import Simulation

LIMITS = {
    name: AlarmLimits()
    for name in (
        "coverage",
        "rate_hz",
        *(limited_quantity.name for limited_quantity in LIMITED_QUANTITIES),
    )
}


@pytest.fixture(scope="module")
def flight() -> Simulation:
    return simulate(seed=5, duration_s=30.0)


def hints(
    flight: Simulation, *, late_ns: int = 0, marker: bool = False, of_clocks: bool = True
) -> list[Remark]:
    groundtruth = of_marker(flight.groundtruth) if marker else flight.groundtruth
    estimate = dataclasses.replace(flight.estimate, stamps=flight.estimate.stamps + late_ns)
    bodies = ("marker", "base_link") if marker else ("base_link", "base_link")
    return hints_of(groundtruth, estimate, bodies, of_clocks=of_clocks)


def hints_of(
    groundtruth: Trajectory,
    estimate: Trajectory,
    bodies: tuple[str, str] = ("", ""),
    *,
    of_clocks: bool = True,
) -> list[Remark]:
    protocol = Protocol(gauge="yaw")
    result = associate(groundtruth, estimate, protocol.association)
    pairs = PairedStates(result.groundtruth, result.estimate)
    return hints_about(pairs, protocol, bodies, (), of_clocks=of_clocks)


def test_a_sound_run_has_no_hints(flight: Simulation) -> None:
    assert hints(flight) == []


def test_another_body_is_told_with_the_parameter(flight: Simulation) -> None:
    result = {hint.subject: hint for hint in hints(flight, marker=True)}
    assert result.keys() == {"frames", "body"}
    assert {item.level for item in result.values()} == {Level.WARNING}
    # The same pose as in a recorded evaluation, with the names of parameters.
    assert "with hand_eye:=0,0,0," in result["body"].text
    assert "of body 'marker' and the estimate of 'base_link'" in result["frames"].text


@pytest.mark.slow
@pytest.mark.parametrize("is_constant", [False, True])
def test_a_rotation_of_the_alignment_is_no_hint_in_the_first_seconds(
    flight: Simulation, tmp_path: Path, is_constant: bool
) -> None:
    """The first poses of KISS-ICP are 0.3 m off, until it knows the velocity."""
    estimate = flight.estimate[flight.estimate.seconds < 7.0]
    assert estimate.quaternions is not None
    if is_constant:
        rotation = lie.from_rotation_vector(np.radians([0.0, 0.0, 20.0]))
        estimate = dataclasses.replace(
            estimate, quaternions=lie.multiply(rotation, estimate.quaternions)
        )
    else:
        off = np.exp(-estimate.seconds / 0.5)[:, None] * [0.0, 0.3, 0.2]
        estimate = dataclasses.replace(estimate, positions=estimate.positions + off)
    live = Live(tmp_path / "live", ODOM)
    messages = messages_of(flight.groundtruth, GROUNDTRUTH, POSE)
    messages += messages_of(estimate, ESTIMATE, ODOM)
    messages.sort(key=lambda message: message[2])
    last, first = int(estimate.stamps[-1]), messages[0][2]
    seen: list[tuple[float, bool, bool]] = []  # when, whether it is misleading, whether told
    for row in range(0, len(messages), 20):
        part = messages[row : row + 20]
        if part[0][2] > last:
            break
        live.feed(part)
        [running] = live.run.estimates
        snapshot = running.snapshot()
        freedom = snapshot.alignment and snapshot.alignment.freedom
        remarks = remarks_about(live.run, running, snapshot, {}, LIMITS)
        told = any(remark.subject == "alignment" and remark.code == "hint" for remark in remarks)
        seen.append(((part[-1][2] - first) / 1e9, bool(freedom and freedom.misleading), told))
    live.end()
    assert any(misleading for at_s, misleading, _ in seen if at_s < 2.0)
    assert not any(told for at_s, _, told in seen if at_s < 5.0)
    assert any(told for *_, told in seen) == is_constant


def test_clocks_that_differ_are_told_unless_they_are_known(flight: Simulation) -> None:
    [clock] = hints(flight, late_ns=150_000_000)
    assert clock.subject == "small_clock_offset"
    assert "time_offset:=-0.15" in clock.text
    assert hints(flight, late_ns=150_000_000, of_clocks=False) == []


@pytest.mark.parametrize(
    ("apart_s", "duration_s", "told"),
    [(18, 30.0, set()), (18, 60.0, {"clock_offset"}), (-37, 60.0, set())],
)
def test_far_clocks_are_no_other_run(apart_s: int, duration_s: float, told: set[str]) -> None:
    """What clocks leave in common in the first minute can be too short to tell."""
    pair = simulated(9001, "drone", "walk", duration_s + abs(apart_s))
    late = dataclasses.replace(pair.estimate, stamps=pair.estimate.stamps + apart_s * 10**9)
    assert {hint.subject for hint in hints_of(pair.truth, late)} == told


def test_another_run_is_told_in_time() -> None:
    one, other = (simulated(seed, "drone", "walk", 80.0) for seed in (9001, 9002))
    [result] = hints_of(one.truth, other.estimate)
    assert result.subject == "other_run"


def test_mistakes_of_conventions_are_told_as_an_evaluation_tells_them(flight: Simulation) -> None:
    flight = dataclasses.replace(
        flight,
        estimate=dataclasses.replace(
            flight.estimate, positions=1000.0 * flight.estimate.positions
        ),
    )
    [result] = hints(flight)
    assert result.subject == "unit"
    # The node has no such parameter.
    assert "--correct unit" in result.text


def test_few_pairs_are_no_reason_for_a_hint() -> None:
    pairs = PairedStates(NO_STATES, NO_STATES)
    assert hints_about(pairs, Protocol(), ("", ""), (), of_clocks=True) == []


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("estimate it with --hand-eye auto", "estimate it with hand_eye:=auto"),
        ("(--hand-eye auto)", "(hand_eye:=auto)"),
        ("--time-offset -0.1", "time_offset:=-0.1"),
        ("--scale 0.001", "--scale 0.001"),
        ("are axes right (--up)?", "are axes right (up)?"),
        ("a well-kept -- dash", "a well-kept -- dash"),
    ],
)
def test_options_are_parameters_of_the_node(text: str, expected: str) -> None:
    assert in_names_of_settings(text, ":=", PARAMETER_NAMES) == expected


def test_nobody_waits_for_what_is_computed_beside() -> None:
    go_on, task = threading.Event(), BackgroundTask[int](most_share=1.0)
    task.start(lambda: 7 if go_on.wait() else 0)
    assert task.take() is None
    assert not task.is_due
    go_on.set()
    result: list[int] = []
    until(lambda: result or [result.append(item) for item in [task.take()] if item], "it is found")
    assert result == [7]
    assert task.take() is None
    until(lambda: task.is_due, "something else may be computed")
    task.close()


def test_a_computation_that_fails_ends_alone() -> None:
    task = BackgroundTask[int](most_share=1.0)
    task.start(lambda: 1 // 0)
    assert task.wait() is None
    assert "ZeroDivisionError" in task.trouble
    task.start(lambda: 7)
    assert task.wait() == 7
    assert not task.trouble
    task.close()


def test_a_bag_has_the_marker_among_its_static_transforms(tmp_path: Path) -> None:
    inner = ("base_link", "mount", 0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    back = MOUNTED.inverse()
    outer = ("marker", "mount", 0, back.lever_m, back.rotation_xyzw)
    messages = [
        ("/tf_static", TRANSFORMS, 10**9, transforms_message(item)) for item in (inner, outer)
    ]
    write_messages(tmp_path / "bag", messages)
    result = known_hand_eye(f"{tmp_path / 'bag'}:/tf_static:base_link.marker")
    assert result.lever_m == pytest.approx(MOUNTED.lever_m)
    assert abs(result.rotation_xyzw @ MOUNTED.rotation_xyzw) == pytest.approx(1.0)
    assert (result.body, result.marker) == ("base_link", "marker")
    with pytest.raises(InputError, match="unknown frame markr"):
        known_hand_eye(f"{tmp_path / 'bag'}:/tf_static:base_link.markr")
