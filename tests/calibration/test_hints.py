"""Warnings that name a likely cause and the option that corrects it, and change no number."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from calibration_flights import Fault, fly
from calibration_recordings import RECORDINGS
from scipy.spatial.transform import Rotation

from trajeval_ros.calibration.calibrate import calibrate
from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.protocol import PROTOCOLS, Protocol
from trajeval_ros.pipeline.pipeline import evaluate, run
from trajeval_ros.pipeline.request import Request

YAW = Protocol(gauge=Gauge.YAW, lengths=())
CLOCKS, BODIES, ARRIVAL = (
    "the clocks of groundtruth and estimate probably differ",
    "estimate it with --hand-eye auto",
    "arrival times",
)
HINTS = (CLOCKS, BODIES, ARRIVAL)
Recording = Callable[[str], Trajectory]


def hints(evaluation: Evaluation) -> list[str]:
    return [warning for warning in evaluation.warnings if any(hint in warning for hint in HINTS)]


def without_rotations(trajectory: Trajectory) -> Trajectory:
    return dataclasses.replace(trajectory, quaternions=None)


@pytest.mark.parametrize("kind", ["drone", "car", "straight", "translating"])
@pytest.mark.parametrize("seed", range(3))
def test_a_right_pair_gets_no_hint(seed: int, kind: str) -> None:
    truth, estimate = fly(seed, 40.0, kind)
    assert not hints(evaluate(truth, estimate, YAW))
    assert not hints(evaluate(without_rotations(truth), estimate, YAW))


@pytest.mark.parametrize("name", RECORDINGS)
def test_recordings_get_no_hint(recording: Recording, name: str) -> None:
    truth, estimate = (recording(item) for item in RECORDINGS[name])
    for gauge in (Gauge.YAW, Gauge.SE3, Gauge.SIM3):
        assert not hints(evaluate(truth, estimate, dataclasses.replace(YAW, gauge=gauge)))


@pytest.mark.parametrize("trial", range(10))
@pytest.mark.parametrize("run", ["MH_01", "MH_05", "V2_03"])
def test_keyframes_get_no_hint(recording: Recording, run: str, trial: int) -> None:
    truth = recording(f"euroc/groundtruth/{run}.txt")
    estimate = recording(f"euroc/vislam_ba/{run}_trial{trial}.txt")
    assert not hints(evaluate(truth, estimate, YAW))


@pytest.mark.parametrize("stamps", [1, 2, 30])
def test_many_pairs_of_few_stamps_show_no_clock(stamps: int) -> None:
    # A burst of groundtruth about each estimated state; far more of these stand alone.
    burst = np.arange(-30, 31, dtype=np.int64) * 10**6
    times = np.arange(stamps, dtype=np.int64) * 10**9
    truth_times = (times[:, None] + burst).ravel()
    alone = np.arange(1, 61 * stamps + 10, dtype=np.int64) * 10**9 + times[-1]

    def moving(times: np.ndarray) -> Trajectory:
        seconds = times / 1e9
        positions = np.column_stack([np.sin(seconds), np.cos(0.7 * seconds), 0.1 * seconds])
        rotations = np.column_stack([0.0 * seconds, np.sin(seconds), seconds])
        return Trajectory(times, positions, Rotation.from_rotvec(rotations).as_quat())

    protocol = dataclasses.replace(
        YAW, gauge=Gauge.NONE, association=AssociationRule("evo", 0.05), in_order=False
    )
    result = evaluate(moving(truth_times), moving(np.concatenate([times, alone])), protocol)
    assert len(result.association) == 61 * stamps
    assert len(set(result.association.estimate.stamps.tolist())) == stamps
    assert not hints(result)


def test_clocks_apart_are_noticed_by_short_motions() -> None:
    truth, estimate = fly(1, 40.0, fault=Fault(0.1))
    (hint,) = hints(evaluate(truth, estimate, YAW))
    assert CLOCKS in hint
    assert "+100 ms" in hint
    assert "--time-offset 0.100" in hint
    rule = AssociationRule(time_offset_s=0.1)
    assert not hints(evaluate(truth, estimate, dataclasses.replace(YAW, association=rule)))


def test_a_run_that_is_too_short_to_calibrate_gets_a_number_and_no_advice_to_do_it() -> None:
    (hint,) = hints(evaluate(*fly(1, 9.0, fault=Fault(0.1), drift=0.1), YAW))
    assert "--time-offset 0.100" in hint
    assert "auto" not in hint
    assert not hints(evaluate(*fly(1, 7.0, fault=Fault(0.1), drift=0.1), YAW))


@pytest.mark.parametrize("name", ["default", "rpg", "evo"])
def test_another_body_is_noticed(name: str) -> None:
    truth, estimate = fly(1, 40.0, fault=Fault(0.0, 0.0, (0.6, -1.0, 1.5)))
    protocol = dataclasses.replace(PROTOCOLS[name], gauge=Gauge.YAW, lengths=())
    (hint,) = hints(evaluate(truth, estimate, protocol))
    assert BODIES in hint
    assert "rotation of 109 deg" in hint


@pytest.mark.parametrize(("duration_s", "causes"), [(20.0, ["body", "lever_arm"]), (40.0, [])])
def test_who_has_calibrated_is_not_told_to_calibrate(duration_s: float, causes: list[str]) -> None:
    fault = Fault(0.0, 0.0, (0.6, -1.0, 1.5), (0.3, 0.0, 0.3))
    truth, estimate = fly(1, duration_s, fault=fault)
    request = Request(protocol=YAW, calibration=CalibrationRequest(hand_eye=True))
    findings = run(truth, [estimate], request).runs[0].diagnosis.findings
    assert [item.cause for item in findings] == causes
    for finding in findings:
        assert "--hand-eye auto could not determine it" in finding.text
        assert finding.correction.keys() == {"hand_eye"}
        assert finding.advice.endswith("apply this pose, which fits short motions")
    if findings:
        assert findings[0].tried is not None
        assert findings[0].tried.after.rotation_deg == pytest.approx(0.5, abs=0.5)
    before = run(truth, [estimate], Request(protocol=YAW)).runs[0].diagnosis.findings
    (body,) = (item for item in before if item.cause == "body")
    pose = HandEye.from_text(body.correction["hand_eye"])
    assert pose is not None
    apart = Rotation.from_quat(pose.rotation_xyzw).inv()
    assert (apart * Rotation.from_rotvec(fault.rotation_vector)).magnitude() < np.radians(0.5)
    assert pose.lever_m == pytest.approx(fault.lever_m, abs=0.02)


@pytest.mark.parametrize(("deg", "hinted"), [(4.0, False), (7.0, True)])
def test_another_body_is_told_beyond_healthy_differences(deg: float, hinted: bool) -> None:
    rotation = np.radians(deg) * np.array([0.0, 0.6, 0.8])
    result = hints(evaluate(*fly(1, 40.0, fault=Fault(0.0, 0.0, rotation), drift=0.1), YAW))
    assert bool(result) is hinted
    assert all(BODIES in item and f"rotation of {deg:.0f} deg" in item for item in result)


def test_a_world_that_is_turned_is_no_other_body() -> None:
    truth, estimate = fly(1, 40.0)
    assert estimate.rotations is not None
    tilted = dataclasses.replace(estimate, positions=estimate.positions[:, [1, 0, 2]])
    assert not [hint for hint in hints(evaluate(truth, tilted, YAW)) if BODIES in hint]


@pytest.mark.parametrize("side", ["groundtruth", "estimate"])
def test_stamps_of_arrival_are_noticed(side: str) -> None:
    random = np.random.default_rng(0)
    truth, estimate = fly(1, 40.0)
    late = {"groundtruth": truth, "estimate": estimate}[side]
    step_s = float(np.median(np.diff(late.stamps))) * 1e-9
    delays = np.rint(1e9 * random.exponential(0.3 * step_s, len(late))).astype(np.int64)
    late = dataclasses.replace(late, stamps=np.sort(late.stamps + delays))
    pair = (late, estimate) if side == "groundtruth" else (truth, late)
    result = [hint for hint in hints(evaluate(*pair, YAW)) if ARRIVAL in hint]
    assert len(result) == 1
    assert f"the {side}'s timestamps are probably arrival times" in result[0]


def test_irregular_but_honest_stamps_are_no_arrivals() -> None:
    truth, estimate = fly(1, 60.0)
    kept = np.random.default_rng(1).random(len(truth)) < 0.2
    assert not hints(evaluate(truth[kept], estimate, YAW))


@pytest.mark.slow
def test_stamps_of_a_real_estimator_that_are_late(recording: Recording) -> None:
    # They are in a camera's axes, which their frames' names don't tell.
    truth, late, well = (
        dataclasses.replace(recording(f"bags/ROS_example.bag:/{name}"), up=UpAxis("-y"))
        for name in ("groundtruth", "S-PTAM", "ORB-SLAM")
    )
    (hint,) = hints(evaluate(truth, late, YAW))
    assert CLOCKS in hint
    assert not hints(evaluate(truth, well, YAW))
    result = calibrate(truth, late).offset
    assert result.is_significant
    assert result.value == pytest.approx([-0.18], abs=0.01)
