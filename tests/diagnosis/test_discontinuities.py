"""What is reported about discontinuities: the table of situations, options, result and texts."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paths import SHARED

from trajeval_ros import Protocol, Request, Trajectory, read_trajectory, run, simulate
from trajeval_ros.cli.app import main
from trajeval_ros.diagnosis.findings import Diagnosis
from trajeval_ros.geometry import lie
from trajeval_ros.metrics.discontinuities.handling import DiscontinuityRule
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


@needs_cases
@pytest.mark.parametrize(
    ("groundtruth", "estimate", "cause", "words"),
    [
        ("attack/g_one_outlier.txt", "attack/e.txt", "groundtruth_outlier",
         ("an outlier of 30.00 m at 59.95 s", "with --drop-groundtruth-outliers 0.1703 m")),
        ("attack/g.txt", "attack/e_frozen_position.txt", "frozen_position",
         ("position of the estimate is frozen from 80.0 s for 39.95 s", "moves 20.05 m")),
        ("bags/flip_one:/mocap/pose", "bags/flip_one:/ekf/odom", "groundtruth_flip",
         ("the groundtruth rotated by 119 deg at 14.98 s",)),
        ("bags/flip_runs:/mocap/pose", "bags/flip_runs:/ekf/odom", "groundtruth_flip",
         ("the groundtruth rotated by 180 deg", "(largest of 3)")),
        ("bags/gt_swap:/ft_gt_swap/mocap/pose", "bags/gt_swap:/ft_gt_swap/vio/odometry",
         "groundtruth_flip_stays", ("the groundtruth rotated by 180 deg at 14.99 s",)),
        ("bags/restart_groundtruth.txt", "bags/restart_gap_0.4s.txt", "restart",
         ("restarted at its origin at 75.00 s, in a gap of 0.5 s: 7.18 m and 20 deg",
          "0.07633 m (75 s), 0.06635 m (45 s), together 0.07274 m: --on-restart split")),
        ("bags/restart_groundtruth.txt", "bags/restart_gap_2s.txt", "restart",
         ("restarted at its origin at 90.00 s, in a gap of 2.0 s",)),
        ("bags/step_3.017:/mocap/pose", "bags/step_3.017:/vio/odometry", "clock_step",
         ("estimate's clock stepped by +3.017 s at 59.95 s; the receive times did not",)),
        ("bags/step_0.417:/mocap/pose", "bags/step_0.417:/vio/odometry", "clock_step",
         ("estimate's clock stepped by +0.417 s",)),
        ("bags/step_-10.017:/mocap/pose", "bags/step_-10.017:/vio/odometry", "clock_step",
         ("estimate's clock stepped by -10.017 s",)),
        ("bags/bothstep_-10.017:/mocap/pose", "bags/bothstep_-10.017:/vio/odometry",
         "both_clocks_step", ("both clocks stepped by -10.017 s", "these are two runs")),
    ],
)  # fmt: skip
def test_inputs_that_people_report_get_one_finding(
    groundtruth: str, estimate: str, cause: str, words: tuple[str, ...]
) -> None:
    pair = [read_trajectory(str(FIELD_CASES / name)) for name in (groundtruth, estimate)]
    findings = texts(outcome(pair[0], pair[1]).diagnosis)
    assert list(findings) == [cause]
    for part in words:
        assert part in findings[cause]


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


@pytest.mark.parametrize("metres", [0.5, 2.0, 20.0])
def test_a_step_of_the_groundtruth_is_one_of_the_groundtruth(metres: float) -> None:
    stepped = moved(GROUNDTRUTH, rows(GROUNDTRUTH, 30.0), metres)
    assert list(texts(outcome(stepped, ESTIMATE).diagnosis)) == ["groundtruth_step"]


@pytest.mark.parametrize("gap_s", [0.0, 1.0, 4.0])
def test_a_restart_is_one_of_the_estimate(gap_s: float) -> None:
    result = outcome(GROUNDTRUTH, restarted(gap_s))
    assert list(texts(result.diagnosis)) == ["restart"]
    whole = result.evaluation.ate["position_m"]
    assert whole is not None
    assert all(part.ate is not None and part.ate < whole.rmse for part in result.evaluation.parts)
    assert [part.pairs for part in result.evaluation.parts] == [
        int(np.count_nonzero(rows(result.evaluation.association.estimate, *span)))
        for span in ((-math.inf, 30.0), (30.0, math.inf))
    ]


def test_one_estimated_pose_out_and_back_is_no_restart() -> None:
    wrong = moved(
        ESTIMATE, rows(ESTIMATE, 30.0, 30.0 + 1.5 * ESTIMATE.duration_s / len(ESTIMATE)), 9.0
    )
    assert list(texts(outcome(GROUNDTRUTH, wrong).diagnosis)) == ["outlier"]


def test_clock_steps_back_in_file_order_are_corrected_without_receive_times() -> None:
    stamps = ESTIMATE.stamps.copy()
    stamps[rows(ESTIMATE, 30.0)] -= 4_000_000_000
    stepped = dataclasses.replace(ESTIMATE, stamps=stamps)
    before = outcome(GROUNDTRUTH, stepped)
    assert list(texts(before.diagnosis)) == ["clock_step"]
    after = outcome(GROUNDTRUTH, stepped, correct="suggested").evaluation
    assert np.array_equal(after.estimate.stamps[[0, -1]], ESTIMATE.stamps[[0, -1]]) or np.allclose(
        after.estimate.stamps, ESTIMATE.stamps, atol=60_000_000
    )


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
    found = json.loads(Path(result).read_text())["runs"][0]
    (event,) = found["events"]
    assert (event["kind"], event["side"], event["certainty"]) == ("restart", "estimate", "sure")
    assert event["gap_s"] == pytest.approx(1.0, abs=0.1)
    parts = found["segments"]
    squares = sum(part["pairs"] * part["ate"] ** 2 for part in parts)
    together = math.sqrt(squares / sum(part["pairs"] for part in parts))
    assert found["ate_of_segments_m"] == pytest.approx(together)
    assert f"(2 parts: {together:.4g}" in shown[0]
    assert any("2 parts between restarts and steps, 2 alignments" in line for line in shown)
    assert main(shared) == 0
    assert "parts:" not in capsys.readouterr().out.splitlines()[0]
    assert main([*shared, "--on-restart", "never"]) == 2
