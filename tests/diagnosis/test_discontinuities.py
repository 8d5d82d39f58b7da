"""What is reported about discontinuities: the table of situations, options, result and texts."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paths import SHARED

from trajeval_ros import (
    AssociationRule,
    Protocol,
    Request,
    Trajectory,
    read_trajectory,
    run,
    simulate,
)
from trajeval_ros.cli.app import main
from trajeval_ros.diagnosis.findings import Diagnosis
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.source_info import ReceiveTimes
from trajeval_ros.metrics.discontinuities.handling import DiscontinuityRule
from trajeval_ros.metrics.discontinuities.parts import together_m
from trajeval_ros.pipeline.outcome import RunOutcome

FIELD_CASES = SHARED / "data/field_cases"
needs_cases = pytest.mark.skipif(not FIELD_CASES.is_dir(), reason="the recordings are absent")
PROTOCOL = Protocol(gauge="se3", lengths=())
FLIGHT = simulate(seed=21, duration_s=60.0)
GROUNDTRUTH, ESTIMATE = FLIGHT.groundtruth, FLIGHT.estimate
FIRST_NS = int(GROUNDTRUTH.stamps[0])


def outcome(groundtruth: Trajectory, estimate: Trajectory, **settings: Any) -> RunOutcome:
    return run(groundtruth, [estimate], Request(PROTOCOL, **settings)).runs[0]


def texts(diagnosis: Diagnosis) -> dict[str, str]:
    return {finding.cause: finding.text for finding in diagnosis.findings}


def rows(trajectory: Trajectory, begin_s: float, end_s: float = math.inf) -> np.ndarray:
    seconds = (trajectory.stamps - FIRST_NS) / 1e9
    return (seconds >= begin_s) & (seconds < end_s)


def moved(trajectory: Trajectory, chosen: np.ndarray, metres: float) -> Trajectory:
    positions = trajectory.positions.copy()
    positions[chosen] += metres * np.array([0.6, -0.8, 0.0])
    return dataclasses.replace(trajectory, positions=positions)


def restarted(gap_s: float) -> Trajectory:
    """Return the estimate with a restart at its first pose at 30 s, after a gap."""
    assert ESTIMATE.quaternions is not None
    later = np.flatnonzero(rows(ESTIMATE, 30.0))
    positions, quaternions = ESTIMATE.positions.copy(), ESTIMATE.quaternions.copy()
    first = quaternions[later[0]].copy()
    back = lie.multiply(quaternions[0], lie.conjugate(first))
    apart = positions[later] - positions[later[0]]
    back_of_each = np.broadcast_to(back, (len(later), 4))
    positions[later] = lie.rotate(back_of_each, apart) + positions[0]
    quaternions[later] = lie.multiply(back_of_each, quaternions[later])
    changed = dataclasses.replace(
        ESTIMATE, positions=positions, quaternions=quaternions, velocities=None
    )
    return changed[~rows(ESTIMATE, 30.0 - gap_s, 30.0)]


def test_a_small_step_beside_a_restart_is_no_cause() -> None:
    groundtruth = moved(GROUNDTRUTH, rows(GROUNDTRUTH, 45.0), 0.1)
    result = outcome(groundtruth, restarted(0.0))
    kinds = {(event.kind, event.side) for event in result.evaluation.events}
    assert kinds == {("restart", "estimate"), ("step", "groundtruth")}
    assert list(texts(result.diagnosis)) == ["restart"]


def flipped(trajectory: Trajectory, chosen: np.ndarray) -> Trajectory:
    quaternions = trajectory.known_quaternions.copy()
    quaternions[chosen] = lie.multiply(quaternions[chosen], np.array([[1.0, 0.0, 0.0, 0.0]]))
    return dataclasses.replace(trajectory, quaternions=quaternions)


def held(
    trajectory: Trajectory, chosen: np.ndarray, names: tuple[str, ...] = ("positions",)
) -> Trajectory:
    """Return a trajectory that repeats columns of its pose."""
    columns = {name: getattr(trajectory, name).copy() for name in names}
    for values in columns.values():
        values[chosen] = values[chosen.argmax()]
    return dataclasses.replace(trajectory, velocities=None, **columns)


def stepped(trajectory: Trajectory, seconds: float, *, received: bool = True) -> Trajectory:
    """Return a trajectory whose clock steps at 30 s, perhaps with receive times."""
    stamps, reading = trajectory.stamps.copy(), trajectory.reading
    if received:
        delays = np.random.default_rng(1).exponential(3e6, len(stamps)).astype(np.int64)
        times = np.maximum.accumulate(stamps + delays)
        reading = dataclasses.replace(reading, receive_times=ReceiveTimes(times))
    stamps[rows(trajectory, 30.0)] += round(seconds * 1e9)
    return dataclasses.replace(trajectory, stamps=stamps, reading=reading)


def diverging(begin_s: float, mps2: float) -> Trajectory:
    since_s = np.maximum((ESTIMATE.stamps - FIRST_NS) / 1e9 - begin_s, 0.0)
    positions = ESTIMATE.positions + np.outer(0.5 * mps2 * since_s**2, [0.6, 0.8, 0.0])
    return dataclasses.replace(ESTIMATE, positions=positions, velocities=None)


ONE_POSE = np.arange(len(ESTIMATE)) == 600
NEAREST = int(np.abs(GROUNDTRUTH.stamps - ESTIMATE.stamps[600]).argmin())
ONE_SAMPLE = np.arange(len(GROUNDTRUTH)) == NEAREST
POSE = "positions", "quaternions"
# Groundtruth, estimate; cause, the event of it, and words of the sentence. None: no finding.
SITUATIONS: dict[str, tuple[Trajectory, Trajectory, str | None, tuple[str, str], str]] = {
    "one sample of the groundtruth is off": (
        moved(GROUNDTRUTH, ONE_SAMPLE, 30.0), ESTIMATE, "groundtruth_outlier",
        ("outlier", "groundtruth"), "the groundtruth has an outlier of",
    ),
    **{
        f"groundtruth steps by {metres} m": (
            moved(GROUNDTRUTH, rows(GROUNDTRUTH, 30.0), metres), ESTIMATE, "groundtruth_step",
            ("step", "groundtruth"), "the groundtruth jumped by",
        )
        for metres in (0.5, 2.0, 20.0)
    },
    "estimate steps": (
        GROUNDTRUTH, moved(ESTIMATE, rows(ESTIMATE, 30.0), 1.0), "step", ("step", "estimate"),
        "the estimate jumped by",
    ),
    "marker flips": (
        flipped(GROUNDTRUTH, rows(GROUNDTRUTH, 30.0, 31.0)), ESTIMATE, "groundtruth_flip",
        ("flip", "groundtruth"), "the groundtruth rotated by 1",
    ),
    "marker stays flipped": (
        flipped(GROUNDTRUTH, rows(GROUNDTRUTH, 30.0)), ESTIMATE, "groundtruth_flip_stays",
        ("flip_stays", "groundtruth"), "the groundtruth rotated by 1",
    ),
    "estimate flips": (
        GROUNDTRUTH, flipped(ESTIMATE, rows(ESTIMATE, 30.0, 31.0)), "flip", ("flip", "estimate"),
        "the estimate rotated by 1",
    ),
    **{
        f"restart in a gap of {gap_s} s": (
            GROUNDTRUTH, restarted(gap_s), "restart", ("restart", "estimate"),
            "the estimate restarted at its origin at",
        )
        for gap_s in (0.0, 0.4, 1.0, 4.0)
    },
    "one pose out and back": (
        GROUNDTRUTH, moved(ESTIMATE, ONE_POSE, 9.0), None, ("outlier", "estimate"),
        "1 outlier of the estimate of up to ",
    ),
    "position holds, rotation lives": (
        GROUNDTRUTH, held(ESTIMATE, rows(ESTIMATE, 30.0, 50.0)), "frozen_position",
        ("frozen_position", "estimate"), "the position of the estimate is frozen from 30.",
    ),
    "rotation holds, position lives": (
        GROUNDTRUTH, held(ESTIMATE, rows(ESTIMATE, 40.0), ("quaternions",)),
        "frozen_rotation", ("frozen_rotation", "estimate"),
        "the rotation of the estimate is frozen from 40.",
    ),
    "rotation holds for 10 s": (
        GROUNDTRUTH, held(ESTIMATE, rows(ESTIMATE, 25.0, 35.0), ("quaternions",)),
        "frozen_rotation", ("frozen_rotation", "estimate"),
        "the rotation of the estimate is frozen from 25.",
    ),
    "rotation of the groundtruth holds for 10 s": (
        held(GROUNDTRUTH, rows(GROUNDTRUTH, 25.0, 35.0), ("quaternions",)), ESTIMATE,
        "groundtruth_frozen_rotation", ("frozen_rotation", "groundtruth"),
        "the rotation of the groundtruth is frozen from 25.",
    ),
    "pose holds": (
        GROUNDTRUTH, held(ESTIMATE, rows(ESTIMATE, 30.0, 50.0), POSE), "frozen",
        ("frozen_position", "estimate"), "the estimate repeats its pose for ",
    ),
    "first pose holds": (
        GROUNDTRUTH, held(ESTIMATE, rows(ESTIMATE, -math.inf, 20.0), POSE), "frozen_at_start",
        ("frozen_position", "estimate"), "the estimate repeats its first pose for ",
    ),
    **{
        f"{side}'s clock steps by {seconds} s": (
            stepped(GROUNDTRUTH, seconds * (side == "groundtruth")),
            stepped(ESTIMATE, seconds * (side == "estimate")), "clock_step",
            ("clock_step", side), f"{side}'s clock stepped by ",
        )
        for side, seconds in (
            ("estimate", 3.0), ("estimate", 0.2), ("estimate", -10.0), ("groundtruth", -3.0),
        )
    },
    "clock steps back, order of the file": (
        GROUNDTRUTH, stepped(ESTIMATE, -4.0, received=False), "clock_step",
        ("clock_step", "estimate"), "the estimate's clock stepped by -4.",
    ),
    "both clocks step back": (
        stepped(GROUNDTRUTH, -10.0), stepped(ESTIMATE, -10.0), "both_clocks_step",
        ("clock_step", "both"), "both clocks stepped by -",
    ),
    "large divergence": (
        GROUNDTRUTH, diverging(30.0, 1.0), "diverged", ("diverged", "estimate"),
        "the estimate diverges from 3",
    ),
    "small divergence": (
        GROUNDTRUTH, diverging(30.0, 0.1), None, ("diverged", "estimate"),
        "the estimate diverges from 3",
    ),
}  # fmt: skip


@pytest.mark.parametrize("situation", SITUATIONS)
def test_a_situation_has_one_cause_and_its_event(situation: str) -> None:
    """What jumped, which side, and when: the finding or the note, and the events of the result."""
    groundtruth, estimate, cause, event, words = SITUATIONS[situation]
    result = outcome(groundtruth, estimate)
    assert [finding.cause for finding in result.diagnosis.findings] == [cause] * bool(cause)
    assert any(words in remark.text for remark in result.evaluation.remarks)
    assert event in [(item.kind, item.side) for item in result.evaluation.events]
    assert {item.side for item in result.evaluation.events} == {event[1]}


@needs_cases
@pytest.mark.parametrize("step", ["step_3.017", "step_0.417", "step_-10.017"])
def test_a_corrected_clock_gives_the_error_without_the_step(step: str) -> None:
    pair = [
        read_trajectory(f"{FIELD_CASES}/bags/{step}:{topic}")
        for topic in ("/mocap/pose", "/vio/odometry")
    ]
    corrected = outcome(pair[0], pair[1], correct="clock_step")
    position = corrected.evaluation.ate["position_m"]
    assert position is not None
    assert position.rmse == pytest.approx(0.0968, abs=5e-4)
    assert [finding.cause for finding in corrected.corrected] == ["clock_step"]
    assert not corrected.diagnosis.findings


def test_the_parts_beside_a_restart_have_their_own_errors() -> None:
    result = outcome(GROUNDTRUTH, restarted(1.0))
    whole = result.evaluation.ate["position_m"]
    assert whole is not None
    assert all(part.ate is not None and part.ate < whole.rmse for part in result.evaluation.parts)
    assert [part.pairs for part in result.evaluation.parts] == [
        int(np.count_nonzero(rows(result.evaluation.association.estimate, *span)))
        for span in ((-math.inf, 30.0), (30.0, math.inf))
    ]


def test_a_clock_step_back_in_file_order_is_corrected_without_receive_times() -> None:
    after = outcome(GROUNDTRUTH, stepped(ESTIMATE, -4.0, received=False), correct="suggested")
    assert np.allclose(after.evaluation.estimate.stamps, ESTIMATE.stamps, atol=60_000_000)


@pytest.mark.parametrize("step_s", [3.0, 0.5, -4.0])
def test_a_restart_with_another_clock_is_corrected_by_both_options(step_s: float) -> None:
    """Only the motion after a forward step shows it, and only separate alignments the error."""
    estimate = stepped(restarted(0.0), step_s, received=False)
    result = outcome(GROUNDTRUTH, estimate)
    kinds = [(event.kind, event.side) for event in result.evaluation.events]
    assert kinds == [("clock_step", "estimate"), ("restart", "estimate")]
    after = outcome(GROUNDTRUTH, estimate, correct="clock_step")
    together = together_m(after.evaluation.parts)
    assert together == pytest.approx(
        together_m(outcome(GROUNDTRUTH, restarted(0.0)).evaluation.parts), rel=0.1
    )
    ended = f"with --correct clock_step and --on-restart split {together:.4g} m"
    assert texts(result.diagnosis)["clock_step"].endswith(ended)


def test_a_rate_of_a_clock_is_corrected_if_the_errors_confirm_it() -> None:
    """It makes a small part of this error, as that of a step that looks like a rate."""
    seconds = (ESTIMATE.stamps - FIRST_NS) / 1e9
    positions = ESTIMATE.positions + np.outer(np.sin(seconds / 13.0), [1.2, 1.6, 0.0])
    stamps = ESTIMATE.stamps + np.round(2.5e6 * seconds).astype(np.int64)
    estimate = dataclasses.replace(ESTIMATE, positions=positions, stamps=stamps)
    estimate = held(estimate, rows(ESTIMATE, 50.0), POSE)
    assert {"frozen", "clock_drift"} <= texts(outcome(GROUNDTRUTH, estimate).diagnosis).keys()
    with pytest.raises(InputError, match="the errors do not confirm --correct clock_drift"):
        outcome(GROUNDTRUTH, estimate, correct="clock_drift")


def test_pairs_by_row_have_no_losses() -> None:
    """They have no times in which an estimate could be frozen."""
    truth = GROUNDTRUTH[::20]
    estimate = held(truth, rows(truth, 30.0), POSE)
    for method, causes in (("nearest", ["frozen"]), ("index", [])):
        protocol = Protocol(association=AssociationRule(method), lengths=())
        findings = run(truth, [estimate], Request(protocol)).runs[0].diagnosis.findings
        assert [item.cause for item in findings if item.cause.startswith("frozen")] == causes


def test_dropped_outliers_of_the_groundtruth_are_counted() -> None:
    wrong = moved(GROUNDTRUTH, rows(GROUNDTRUTH, 30.0, 30.1), 5.0)
    number = int(np.count_nonzero(rows(GROUNDTRUTH, 30.0, 30.1)))
    rule = DiscontinuityRule(drop_groundtruth_outliers=True)
    result = outcome(wrong, ESTIMATE, discontinuities=rule)
    assert len(result.evaluation.groundtruth) == len(GROUNDTRUTH) - number
    assert [remark.text for remark in result.evaluation.groundtruth.reading.remarks][-1] == (
        f"--drop-groundtruth-outliers: {number} poses dropped in 1 outlier of the groundtruth"
    )
    assert not result.diagnosis.findings


def test_a_correction_is_no_cut() -> None:
    """Half of the drift is taken back at once, as by a loop closure."""
    positions = ESTIMATE.positions.copy()
    seconds = (ESTIMATE.stamps - FIRST_NS) / 1e9
    positions += np.outer(np.where(seconds < 40.0, 0.05, 0.0) * seconds, [1.0, 0.0, 0.0])
    closed = dataclasses.replace(ESTIMATE, positions=positions, velocities=None)
    evaluation = outcome(GROUNDTRUTH, closed).evaluation
    assert [event.kind for event in evaluation.events] == ["correction"]
    assert evaluation.parts == ()


def test_steps_of_both_sides_at_once_are_undecided() -> None:
    """A correction of the estimate, and the groundtruth steps at that time: any side is wrong."""
    sides = (
        moved(GROUNDTRUTH, rows(GROUNDTRUTH, 30.0), 1.0),
        moved(ESTIMATE, rows(ESTIMATE, 30.0), 1.2),
    )
    evaluation = outcome(*sides).evaluation
    assert [(item.kind, item.side) for item in evaluation.events] == [("step", "undecided")]
    [text] = [item.text for item in evaluation.remarks if item.code == "discontinuities"]
    sizes = r"of up to 2\.\d+ m \((1|1\.0\d|0\.9\d+) m in the .*, 1\.[12]\d* m in the estimate's\)"
    expected = f"1 step of an undecided side {sizes}, at 30\\.\\d s; compare with a second source"
    assert re.fullmatch(expected, text)


def test_events_and_segments_are_in_the_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = []
    for name, trajectory in (("groundtruth", GROUNDTRUTH), ("vio", restarted(1.0))):
        columns = trajectory.stamps / 1e9, trajectory.positions, trajectory.quaternions
        np.savetxt(tmp_path / f"{name}.txt", np.column_stack(columns), fmt="%.9f")
        files.append(str(tmp_path / f"{name}.txt"))
    result = str(tmp_path / "result.json")
    shared = ["evaluate", *files, "--gauge", "se3", "--lengths", "none"]
    assert main([*shared, "--on-restart", "split", "--json", result]) == 0
    shown = capsys.readouterr().out.splitlines()
    measured = json.loads(Path(result).read_text())["runs"][0]
    (event,) = measured["events"]
    assert (event["kind"], event["side"], event["certainty"]) == ("restart", "estimate", "sure")
    assert event["gap_s"] == pytest.approx(1.0, abs=0.1)
    parts = measured["segments"]
    squares = sum(part["pairs"] * part["ate"] ** 2 for part in parts)
    together = math.sqrt(squares / sum(part["pairs"] for part in parts))
    assert measured["ate_of_segments_m"] == pytest.approx(together)
    assert f"(2 parts: {together:.4g}" in shown[0]
    assert any("2 parts between restarts and steps, 2 alignments" in line for line in shown)
    assert main(shared) == 0
    assert "parts:" not in capsys.readouterr().out.splitlines()[0]
    assert main([*shared, "--on-restart", "never"]) == 2
