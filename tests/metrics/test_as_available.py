"""As-available accuracy: closed forms, laws, and reference numbers."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.paths import SHARED
from trajeval_ros.cli.app import main
from trajeval_ros.formatting.numbers import significant
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.gauge import Similarity
from trajeval_ros.geometry.source_info import ReceiveTimes, SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.metrics.as_available import (
    AsAvailable,
    Availability,
    AvailabilityRule,
    as_available,
)
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.evaluation import evaluate
from trajeval_ros.metrics.protocol import Protocol

SECOND = 10**9
IDENTITY = Similarity(np.eye(3), np.zeros(3))
REFERENCE = SHARED / "reference" / "as_available.json"
V, LATENCY_S, RATE_HZ = 1.5, 0.08, 20


def received(
    stamps: np.ndarray,
    positions: np.ndarray,
    quaternions: np.ndarray | None,
    times: np.ndarray,
    velocities: np.ndarray | None = None,
    rates: np.ndarray | None = None,
) -> Trajectory:
    reading = SourceInfo(receive_times=ReceiveTimes(times, body_rates=rates))
    return Trajectory(stamps, positions, quaternions, velocities=velocities, reading=reading)


def measured(groundtruth: Trajectory, estimate: Trajectory, motion: str = "hold") -> AsAvailable:
    result = as_available(
        groundtruth, estimate, IDENTITY, AvailabilityRule(motion), AssociationRule()
    )
    assert not result.numbers.why_withheld
    return result


def errors(outcome: AsAvailable) -> tuple[np.ndarray, np.ndarray]:
    """Return the as-available position errors (N, 3) and rotation vectors (N, 3)."""
    assert outcome.samples is not None
    assert outcome.samples.rotation is not None
    return outcome.samples.position.sum(axis=0), outcome.samples.rotation.sum(axis=0)


def line(stamps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    zero = np.zeros(len(stamps))
    positions = np.column_stack([V * stamps / SECOND, zero, zero])
    return positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps), 1))


def on_line(gap: tuple[float, float] | None = None) -> tuple[Trajectory, Trajectory]:
    """Return a straight drive, and its estimate with a latency, without messages in a gap."""
    fine = np.arange(0, 60 * SECOND, SECOND // 200)
    stamps = np.arange(0, 60 * SECOND, SECOND // RATE_HZ)
    if gap is not None:
        stamps = stamps[(stamps <= gap[0] * SECOND) | (stamps >= gap[1] * SECOND)]
    times = stamps + round(LATENCY_S * SECOND)
    velocities = np.tile([V, 0.0, 0.0], (len(stamps), 1))
    truth = Trajectory(fine, *line(fine))
    return truth, received(stamps, *line(stamps), times, velocities, np.zeros((len(stamps), 3)))


def test_held_pose_on_a_line_is_behind_by_speed_times_age() -> None:
    result = measured(*on_line())
    assert result.samples is not None
    phase_s = (result.samples.stamps - 80_000_000) % (SECOND // RATE_HZ) / SECOND
    expected = V * (LATENCY_S + phase_s)
    np.testing.assert_allclose(np.linalg.norm(errors(result)[0], axis=1), expected, atol=1e-12)
    late = result.samples.stamps > SECOND
    mean = np.linalg.norm(errors(result)[0], axis=1)[late].mean()
    assert mean == pytest.approx(V * (LATENCY_S + (1 / RATE_HZ - 0.01) / 2), abs=1e-9)


@pytest.mark.parametrize("lacks", ["rates", "a rate", "velocities", "motion"])
def test_without_a_twist_the_numbers_of_its_prediction_are_withheld(lacks: str) -> None:
    truth, estimate = on_line()
    receive_times, velocities = estimate.reading.receive_times, estimate.velocities
    assert receive_times is not None
    assert receive_times.body_rates is not None
    assert velocities is not None
    rates: np.ndarray | None = receive_times.body_rates
    if lacks == "rates":
        rates = None
    elif lacks == "a rate":
        receive_times.body_rates[7, 1] = np.nan
    reading = SourceInfo(receive_times=dataclasses.replace(receive_times, body_rates=rates))
    moving = {"velocities": None, "motion": np.zeros_like(velocities)}.get(lacks, velocities)
    estimate = dataclasses.replace(estimate, velocities=moving, reading=reading)
    numbers = as_available(
        truth, estimate, IDENTITY, AvailabilityRule("twist"), AssociationRule()
    ).numbers
    assert numbers.why_withheld == "the messages have no twist; use --as-available constant"
    assert numbers.position_m is None
    assert measured(truth, estimate, "constant").numbers.position_m is not None


def test_every_message_has_a_latency_and_all_but_the_first_an_interval() -> None:
    truth, estimate = on_line()
    stamps = estimate.stamps[:5] + np.array([0, 0, 0, 20_000_000, 0])
    late_s = np.array([0.11, 0.02, 0.03, 0.04, 0.05])
    times = stamps + np.round(late_s * SECOND).astype(np.int64)
    numbers = measured(truth, received(stamps, *line(stamps), times)).numbers
    assert numbers.latency_s is not None
    assert numbers.interval_s is not None
    # The first message arrives after the second one, which is newer; nobody ever has it.
    assert (numbers.late_messages, numbers.latency_s.count, numbers.interval_s.count) == (1, 4, 3)
    assert numbers.latency_s.mean == pytest.approx(late_s[1:].mean())
    assert numbers.interval_s.max == pytest.approx(0.07)
    assert numbers.time_to_first_pose_s == pytest.approx(0.07)


def test_dropout_is_counted_beyond_two_usual_intervals() -> None:
    result = measured(*on_line((20.0, 22.0)))
    assert result.samples is not None
    assert result.numbers.position_m is not None
    assert result.numbers.position_m.max == pytest.approx(V * (2.0 + 0.08 - 0.01), abs=1e-9)
    dropout = np.linalg.norm(result.samples.position[2], axis=1)
    assert dropout.max() == pytest.approx(V * (2.0 - 2 / 20 - 0.01), abs=1e-9)
    assert result.numbers.dropouts is not None
    assert dataclasses.astuple(result.numbers.dropouts) == (1, 2.0, 2.0)
    assert result.numbers.missed_deadlines is not None
    assert result.numbers.missed_deadlines.longest_s == pytest.approx(2.0 + 0.08 - 0.1, abs=0.011)


TURN, RADIUS = 0.75, 2.0


def circle(stamps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    angle = TURN * stamps / SECOND
    zero = np.zeros(len(stamps))
    positions = np.column_stack([RADIUS * np.sin(angle), RADIUS * (1 - np.cos(angle)), zero])
    rotated = lie.from_rotation_vector(np.column_stack([zero, zero, angle]))
    return positions, rotated


def on_circle(turn: float = TURN) -> tuple[Trajectory, Trajectory]:
    # Groundtruth at 100 Hz has a state at every age, so nothing is interpolated.
    fine = np.arange(0, 30 * SECOND, SECOND // 100)
    stamps = np.arange(0, 30 * SECOND, SECOND // 10)
    times = stamps + 130_000_000
    positions, rotated = circle(stamps)
    forwards = np.tile([RADIUS * TURN, 0.0, 0.0], (len(stamps), 1))
    rates = np.tile([0.0, 0.0, turn], (len(stamps), 1))
    velocities = lie.rotate(rotated, forwards)
    truth = Trajectory(fine, *circle(fine))
    return truth, received(stamps, positions, rotated, times, velocities, rates)


@pytest.mark.parametrize("motion", ["constant", "twist"])
def test_prediction_on_a_circle_has_no_error(motion: str) -> None:
    result = measured(*on_circle(), motion)
    assert result.samples is not None
    second = result.samples.rows > 0
    for error in errors(result):
        assert np.abs(error[second]).max() < 1e-12


def test_velocity_without_turn_leaves_the_circle() -> None:
    result = measured(*on_circle(turn=0.0), "twist")
    assert result.samples is not None
    angle = TURN * result.samples.age / SECOND
    expected = RADIUS * np.hypot(np.cos(angle) - 1, np.sin(angle) - angle)
    np.testing.assert_allclose(np.linalg.norm(errors(result)[0], axis=1), expected, atol=1e-12)


def rough(seed: int, count: int = 900) -> tuple[Trajectory, Trajectory]:
    """Return a flight in Unix time with gamma latencies, late messages and a dropout of 3 s."""
    random = np.random.default_rng(seed)
    begin = 1_600_000_000 * SECOND
    fine = begin + np.arange(0, 40 * SECOND, SECOND // 100)
    x = (fine - begin) / SECOND
    places = np.column_stack([3 * np.sin(0.7 * x), 2 * np.sin(1.1 * x), 0.3 * x])
    rotations = lie.from_rotation_vector(
        np.column_stack([0.3 * np.sin(x), 0.2 * np.sin(0.9 * x), 0.8 * np.sin(0.5 * x)])
    )
    truth = Trajectory(fine, places, rotations)
    every = np.arange(begin, begin + 39 * SECOND, SECOND // 30)
    stamps = np.sort(random.choice(every, count, replace=False))
    stamps = stamps[(stamps < begin + 15 * SECOND) | (stamps > begin + 18 * SECOND)]
    times = stamps + (random.gamma(2.0, 0.06, len(stamps)) * SECOND).astype(np.int64)
    states, _ = truth.at(stamps, 0.5)
    assert states.quaternions is not None
    walk = np.cumsum(random.normal(0, 0.003, (len(stamps), 3)), axis=0)
    tilt = lie.from_rotation_vector(np.cumsum(random.normal(0, 5e-4, (len(stamps), 3)), axis=0))
    quaternions = lie.multiply(tilt, states.quaternions)
    return truth, received(stamps, states.positions + walk, quaternions, times)


@pytest.mark.slow
@given(st.integers(0, 10**6), st.sampled_from(["hold", "constant"]))
def test_parts_shares_and_ages_add_up(seed: int, motion: str) -> None:
    truth, estimate = rough(seed)
    result = measured(truth, estimate, motion)
    samples, numbers = result.samples, result.numbers
    assert samples is not None
    messages = samples.messages
    assert numbers.parts is not None
    assert numbers.late_messages
    assert (samples.ages >= 0).all()
    np.testing.assert_array_equal(samples.age, samples.stamps - messages.stamps[samples.rows])
    # The error of the newest pose, computed directly.
    states, _ = truth.at(samples.stamps, 0.5)
    if motion == "hold":
        direct = states.positions - messages.positions[samples.rows]
        np.testing.assert_allclose(samples.position.sum(axis=0), direct, atol=1e-12)
    for share in ("share", "share_deg"):
        assert sum(getattr(part, share) for part in numbers.parts.values()) == pytest.approx(1.0)


@pytest.mark.slow
@given(st.integers(0, 10**6))
def test_no_later_message_is_older_and_none_is_used_before_its_reception(seed: int) -> None:
    truth, estimate = rough(seed)
    result = measured(truth, estimate)
    assert result.samples is not None
    receive_times = estimate.reading.receive_times
    assert receive_times is not None
    for stamp, age in zip(result.samples.stamps[::97], result.samples.age[::97], strict=True):
        had = receive_times.times <= stamp
        assert stamp - age == estimate.stamps[had].max()


@pytest.mark.slow
@given(st.integers(0, 10**6), st.integers(-50, 50))
def test_wrong_timestamps_do_not_change_the_held_error(seed: int, shift_ms: int) -> None:
    truth, estimate = rough(seed)
    wrong = dataclasses.replace(estimate, stamps=estimate.stamps - shift_ms * 10**6)
    rule = AvailabilityRule("hold")
    one, other = (
        as_available(truth, item, IDENTITY, rule, AssociationRule()) for item in (estimate, wrong)
    )
    if other.samples is None:  # then messages were received before their timestamps
        assert other.numbers.clock is not None
        assert other.numbers.clock.verdict == "impossible"
        return
    assert one.samples is not None
    _, first, second = np.intersect1d(
        one.samples.stamps, other.samples.stamps, return_indices=True
    )
    np.testing.assert_array_equal(
        one.samples.age[first] + shift_ms * 10**6, other.samples.age[second]
    )
    np.testing.assert_allclose(errors(one)[0][first], errors(other)[0][second], atol=1e-12)


def test_corrected_pose_acts_from_its_reception_and_keeps_the_age_of_its_pose() -> None:
    truth, _ = on_line()
    stamps = np.array([1, 1, 2]) * SECOND  # the second one is a correction of the first pose
    times = np.array([1_100, 1_500, 2_100]) * 10**6
    corrected = np.array([500, 1_500, 1_500]) * 10**6
    positions = np.column_stack([[1.0, 5.0, 6.0], np.zeros((3, 2))])
    reading = SourceInfo(receive_times=ReceiveTimes(times, corrected=corrected))
    result = measured(truth, Trajectory(stamps, positions, reading=reading))
    samples = result.samples
    assert samples is not None
    error = samples.position.sum(axis=0)[:, 0]
    at = {round(stamp / 10**6): row for row, stamp in enumerate(samples.stamps.tolist())}
    for ms, place in ((1_490, 1.0), (1_500, 5.0), (2_090, 5.0), (2_100, 6.0)):
        assert error[at[ms]] == pytest.approx(V * ms / 1000 - place)
    assert samples.age[at[1_500]] == 500 * 10**6
    assert result.numbers.corrections is not None
    ages = result.numbers.corrections["age_s"]
    assert ages is not None
    assert ages.min == 0.0


def numbers_of(numbers: Availability) -> dict[str, Any]:
    """Return the numbers by the names of the reference."""
    result = dataclasses.asdict(numbers)
    assert numbers.parts is not None
    return {
        "samples": numbers.samples,
        "late": numbers.late_messages,
        "without_groundtruth": numbers.without_groundtruth,
        "none_yet_s": numbers.time_to_first_pose_s,
        "position_m": result["position_m"],
        "rotation_deg": result["rotation_deg"],
        "moved_m": result["age_error_m"],
        "turned_deg": result["age_error_deg"],
        "age_s": result["age_s"],
        "available_share": numbers.available_percent / 100.0,
        "parts_rmse_m": {name: part.rmse_m for name, part in numbers.parts.items()},
        "parts_share": {name: part.share for name, part in numbers.parts.items()},
        "rotation_parts_share": {name: part.share_deg for name, part in numbers.parts.items()},
    }


def assert_equal(outcome: Any, expected: Any, name: str, tolerance: float) -> None:
    if isinstance(expected, dict):
        for key, value in expected.items():
            assert_equal(outcome[key], value, f"{name}.{key}", tolerance)
    else:
        assert outcome == pytest.approx(expected, rel=tolerance, abs=tolerance), name


def formula(stamps: np.ndarray, case: dict[str, Any]) -> np.ndarray:
    """Return the receive times that the reference states."""
    rows = np.arange(len(stamps))
    late = np.where(rows % case["every"] == case["every"] - 1, 300_000_000, 0)
    return stamps + case["base_ns"] + case["step_ns"] * (7919 * rows % 1000) + late


def cases() -> list[dict[str, Any]]:
    return json.loads(REFERENCE.read_text())["portable"]["cases"] if REFERENCE.exists() else []


@pytest.mark.parametrize("case", cases(), ids=lambda case: f"{case['pair']}-{case['motion']}")
def test_reference(case: dict[str, Any]) -> None:
    name = {"plain_stamps": "stamp_order"}.get(case["pair"], case["pair"])
    folder = SHARED / "portable" / "pairs" / name
    truth, estimate = (read_trajectory(folder / f"{side}.txt") for side in ("gt", "est"))
    reading = dataclasses.replace(
        estimate.reading, receive_times=ReceiveTimes(formula(estimate.stamps, case))
    )
    estimate = dataclasses.replace(estimate, reading=reading)
    evaluation = evaluate(truth, estimate, Protocol(modality="stereo", lengths=()))
    result = as_available(
        evaluation.groundtruth,
        evaluation.estimate,
        evaluation.alignment.similarity,
        AvailabilityRule(case["motion"]),
        AssociationRule(),
    )
    numbers = numbers_of(result.numbers)
    expected = {name: case[name] for name in numbers}
    assert_equal(numbers, expected, case["pair"], 1e-9)
    assert result.samples is not None
    assert result.samples.stamps[[0, -1]].tolist() == [case["first_t_ns"], case["last_t_ns"]]


def delayed(estimate: Trajectory, latency_s: float) -> Trajectory:
    times = estimate.stamps + round(latency_s * SECOND)
    reading = dataclasses.replace(estimate.reading, receive_times=ReceiveTimes(times))
    return dataclasses.replace(estimate, reading=reading)


def both_errors(truth: Trajectory, estimate: Trajectory) -> tuple[float, float]:
    """Return the ATE and the as-available rmse in the yaw gauge, metres."""
    evaluation = evaluate(truth, estimate, Protocol(gauge="yaw", lengths=()))
    result = as_available(
        evaluation.groundtruth,
        evaluation.estimate,
        evaluation.alignment.similarity,
        AvailabilityRule("hold"),
        AssociationRule(),
    )
    ate, available = evaluation.ate["position_m"], result.numbers.position_m
    assert ate is not None
    assert available is not None
    return ate.rmse, available.rmse


@pytest.mark.slow
def test_latency_changes_the_order_of_two_real_estimates(shared_data: Path) -> None:
    folder = shared_data / "euroc"
    truth = read_trajectory(folder / "groundtruth" / "MH_01.txt")
    slow = read_trajectory(folder / "vins_mono" / "MH_01.csv")
    fast = read_trajectory(folder / "vio_mono" / "MH_01.txt")[5:]  # after placeholders
    slow_at, slow_available = both_errors(truth, delayed(slow, 0.14))
    fast_at, fast_available = both_errors(truth, delayed(fast, 0.015))
    assert slow_at < fast_at
    assert slow_available > fast_available
    assert (slow_at, fast_at) == pytest.approx((0.2057, 0.2101), abs=2e-4)
    assert slow_available == pytest.approx(0.213985938143, rel=2e-3)
    assert fast_available == pytest.approx(0.209836823632, rel=2e-3)


def test_keyframes_change_the_order_without_any_latency(shared_data: Path) -> None:
    folder = shared_data / "euroc"
    truth = read_trajectory(folder / "groundtruth" / "MH_05.txt")
    keyframes = read_trajectory(folder / "vislam_ba" / "MH_05_trial0.txt")
    fast = read_trajectory(folder / "vio_mono" / "MH_05.txt")[5:]
    at, available = both_errors(truth, delayed(keyframes, 1e-4))
    fast_at, fast_available = both_errors(truth, delayed(fast, 1e-4))
    assert at < fast_at
    assert available > fast_available
    assert (at, available) == pytest.approx((0.163, 1.606), rel=5e-3)
    assert (fast_at, fast_available) == pytest.approx((0.2145, 0.2107), rel=5e-3)


def test_a_figure_shows_errors_ages_and_latencies() -> None:
    pytest.importorskip("matplotlib", reason="figures need the extra `plot`")
    from trajeval_ros.report.available_figure import as_available_figure

    truth, estimate = on_line(gap=(40.0, 41.0))
    result = measured(truth, estimate)
    figure = as_available_figure(evaluate(truth, estimate, Protocol(gauge="none")), result)
    upper, detail, lower, right = figure.axes
    assert result.samples is not None
    _, drawn = (line.get_ydata() for line in upper.get_lines())
    # An age error of a straight drive is its speed times the age, largest at the gap's end.
    assert np.max(drawn) == pytest.approx(V * result.samples.age.max() / SECOND, rel=1e-6)
    shown = np.concatenate([line.get_xdata() for line in detail.get_lines()])
    assert shown.min() <= 41.0 <= shown.max()
    assert np.ptp(shown) <= 10.0
    age, deadline = (np.asarray(line.get_ydata()) for line in lower.get_lines())
    np.testing.assert_allclose(age, result.samples.age / SECOND)
    assert set(deadline) == {result.numbers.deadline_s}
    assert sum(bar.get_height() for bar in right.patches) == len(estimate)
    assert right.get_title(loc="left") == "median 0.08 s, 95 % 0.08 s"


def test_a_final_silence_is_a_dropout(shared_data: Path) -> None:
    folder = shared_data / "field_cases" / "as_available"
    columns = "t x y z qx qy qz qw received"
    sides = [str(folder / name) for name in ("g2.txt", "e2.txt")]
    options = ["--columns", columns, "--as-available", "hold", "--gauge", "none", "--json", "-"]
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert main(["evaluate", *sides, *options]) == 0
        assert main(["evaluate", *sides, *options[:-2]]) == 0
    lines = printed.getvalue().splitlines()
    end = lines.index("}") + 1
    [run] = json.loads("\n".join(lines[:end]))["runs"]
    dropouts = run["as_available"]["dropouts"]
    assert dropouts["count"] == 1
    assert 29.5 < dropouts["longest_s"] < 30.5
    [stream] = [line for line in lines[end:] if "arrival after timestamp" in line]
    assert stream.endswith("longest gap between messages 0.05 s")
    [age] = [line for line in lines[end:] if "pose age" in line]
    assert f"1 dropout (longest {significant(dropouts['longest_s'], 3)} s)" in age
