"""Messages that match the data: positions alone, points, 2-D headings and other bodies."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable

import numpy as np
import pytest

from trajeval_ros import AssociationRule, Protocol, Request, Trajectory, evaluate, run, simulate
from trajeval_ros.diagnosis.evaluation_tests import number_of_pairs
from trajeval_ros.diagnosis.findings import Diagnosis, Finding
from trajeval_ros.geometry import lie
from trajeval_ros.pipeline.evaluation_remarks import remarks_on
from trajeval_ros.report.verdict_lines import verdict

GROUNDTRUTH = simulate(seed=3, duration_s=40.0).groundtruth
ESTIMATE = GROUNDTRUTH[::10]


def points_of(count: int) -> Trajectory:
    rows = np.linspace(500, len(GROUNDTRUTH) - 500, count).astype(int)
    points = GROUNDTRUTH[rows]
    return dataclasses.replace(points, quaternions=None, velocities=None)


def findings(groundtruth: Trajectory, estimate: Trajectory) -> dict[str, str]:
    """Return the texts of the findings by cause."""
    request = Request(Protocol(gauge="se3", lengths=()))
    diagnosis = run(groundtruth, [estimate], request).runs[0].diagnosis
    return {finding.cause: finding.text for finding in diagnosis.findings}


@pytest.mark.parametrize("oriented", [True, False])
def test_steps_of_an_estimate_are_named(oriented: bool) -> None:
    positions = ESTIMATE.positions.copy()
    for row in (100, 250):
        positions[row:] += 2.0 * np.random.default_rng(row).normal(size=3)
    estimate = dataclasses.replace(ESTIMATE, positions=positions)
    if not oriented:
        estimate = dataclasses.replace(estimate, quaternions=None)
    text = findings(GROUNDTRUTH, estimate)["step"]
    assert text.startswith("the estimate jumped by ")
    assert text.endswith(": --on-restart split")
    assert " deg" not in text


def test_parts_that_are_too_short_to_align_are_stated() -> None:
    positions = ESTIMATE.positions.copy()
    for row in range(100, len(positions), 90):
        positions[row:] += 2.0 * np.random.default_rng(row).normal(size=3)
    text = findings(GROUNDTRUTH, dataclasses.replace(ESTIMATE, positions=positions))["step"]
    assert "(largest of 8)" in text
    assert text.endswith("the parts are too short for separate alignments")


def test_wrong_samples_of_the_groundtruth_are_no_jumps_of_the_estimate() -> None:
    """As in the motion capture of the Hilti challenge, 10 m and 100 deg away."""
    positions, quaternions = GROUNDTRUTH.positions.copy(), GROUNDTRUTH.quaternions
    assert quaternions is not None
    rows = [1500, 2200]
    positions[rows] += [0.0, 10.0, 0.0]
    quaternions = quaternions.copy()
    rotation = lie.from_rotation_vector(np.array([1.8, 0.0, 0.0]))
    quaternions[rows] = lie.multiply(quaternions[rows], rotation)
    wrong = dataclasses.replace(GROUNDTRUTH, positions=positions, quaternions=quaternions)
    text = findings(wrong, ESTIMATE)["groundtruth_outlier"]
    assert text.startswith("the groundtruth has an outlier of 10.00 m and 103 deg at ")
    assert "(largest of 2)" in text


def test_poses_of_two_publishers_in_one_file_are_named() -> None:
    protocol = Protocol(lengths=())
    noise = np.random.default_rng(0).normal(size=ESTIMATE.positions.shape)
    other = np.zeros_like(noise)
    other[1::2] = [3.0, -2.0, 0.5]
    for added, is_named in ((other + 0.01 * noise, True), (2.0 * noise, False)):
        estimate = dataclasses.replace(ESTIMATE, positions=ESTIMATE.positions + added)
        remarks = remarks_on(evaluate(GROUNDTRUTH, estimate, protocol), Diagnosis((), ()))
        text = [remark.text for remark in remarks if remark.code == "mixed_publishers"]
        assert len(text) == is_named
        assert all("messages of two publishers are probably mixed" in item for item in text)


def test_a_two_dimensional_heading_has_no_tilt() -> None:
    heading = lie.from_rotation_vector(
        np.outer(np.linspace(0.0, 2.0, len(ESTIMATE)), [0.0, 0.0, 1.0])
    )
    level = dataclasses.replace(ESTIMATE, quaternions=heading)
    protocol = Protocol(gauge="yaw", lengths=("5m",))
    result = evaluate(GROUNDTRUTH, level, protocol)
    assert result.ate["tilt_deg"] is None
    assert result.ate["yaw_deg"] is not None
    assert result.relative is not None
    assert result.relative[0].statistics["tilt_deg"] is None
    [text] = [warning for warning in result.warnings if "2-D headings" in warning]
    assert text.startswith("the orientations of the estimate are 2-D headings")
    assert "including tilt against 2-D headings" in verdict(result)[0]
    assert evaluate(level, level, protocol).ate["tilt_deg"] is not None
    # A robot on a floor has no tilt: that of its estimate is an error.
    assert evaluate(level, ESTIMATE, protocol).ate["tilt_deg"] is not None


def test_drift_is_withheld_with_rotations() -> None:
    """The alignment by positions differs from the orientations: another body."""
    estimate = ESTIMATE
    assert estimate.quaternions is not None
    other = lie.from_rotation_vector(np.array([0.0, 0.0, 1.2]))
    rotated = dataclasses.replace(
        estimate, quaternions=lie.multiply(estimate.quaternions, other[None])
    )
    for evaluated, withheld in ((rotated, True), (estimate, False)):
        protocol = Protocol(gauge="se3", lengths=("5m",))
        result = evaluate(GROUNDTRUTH, evaluated, protocol)
        assert bool(result.withheld) == withheld
        assert (result.drift is None) == withheld
        assert ("rotation and drift withheld" in verdict(result)[0]) == withheld
        assert (", drift " in verdict(result)[0]) != withheld


@pytest.mark.parametrize("method", ["nearest", "evo"])
def test_points_have_no_coverage_of_poses(method: str) -> None:
    points = points_of(8)
    rule = AssociationRule(method, max_time_difference_s=0.1)
    result = evaluate(points, ESTIMATE, Protocol(association=rule, lengths=()))
    assert points.kind == "points"
    assert result.association.estimate_coverage is None
    assert result.association.groundtruth_coverage == 1.0
    assert not result.association.dropped
    assert any("8 of 8 points (100 %)" in line for line in verdict(result))
    rule = AssociationRule(method, max_time_difference_s=1e-4)
    moved = dataclasses.replace(points, stamps=points.stamps + np.arange(8) % 2 * 2_000_000)
    result = evaluate(moved, ESTIMATE, Protocol(association=rule, lengths=(), gauge="none"))
    assert result.association.dropped == {"no_estimate_within_max_time_difference": 4}
    assert result.association.groundtruth_coverage == 0.5


def test_advice_for_points_that_are_all_paired_is_to_survey_more() -> None:
    points = points_of(5)
    rule = AssociationRule("nearest", max_time_difference_s=0.1)
    protocol = Protocol(association=rule, lengths=())
    result = evaluate(points, ESTIMATE, protocol)
    examined = number_of_pairs(protocol, result.association, points, ESTIMATE)
    text = Finding.of(examined.seen[0]).text
    assert text.endswith("; survey more points")
    assert "limit" not in text
    assert "--max" not in text
    few = evaluate(GROUNDTRUTH[:500:100], ESTIMATE, protocol)
    examined = number_of_pairs(protocol, few.association, few.groundtruth, few.estimate)
    assert "--max-time-difference" in Finding.of(examined.seen[0]).text


def test_points_have_the_hint_of_a_lever_arm_until_it_is_known() -> None:
    known = {"lever_m": (0.0, 0.0, 0.1)}
    positions = dataclasses.replace(ESTIMATE, quaternions=None)
    for truth, estimate, settings, is_said in (
        (points_of(20), ESTIMATE, {}, True),
        (points_of(20), ESTIMATE, known, False),
        (points_of(20), positions, {}, False),
        (GROUNDTRUTH, ESTIMATE, {}, False),
    ):
        request = Request(Protocol(lengths=(), **settings))
        remarks = run(truth, [estimate], request).runs[0].evaluation.remarks
        text = [remark.text for remark in remarks if remark.code == "lever_arm_not_given"]
        assert len(text) == is_said
        assert all("give the lever arm with --lever-arm" in item for item in text)


def test_a_prism_on_a_pole_has_the_hint_of_a_lever_arm(
    recording: Callable[[str], Trajectory],
) -> None:
    points, estimate = (recording(f"hilti_2021/Campus_2_{name}.txt") for name in ("prism", "hdl"))
    for lever, is_said in ((None, True), ((-0.006, -0.007, 0.273), False)):
        request = Request(Protocol(lengths=(), lever_m=lever))
        warnings = run(points, [estimate], request).runs[0].evaluation.warnings
        assert (
            any("position of a point, such as a prism" in warning for warning in warnings)
            == is_said
        )


def test_jumps_of_motion_capture_are_not_of_the_estimate(
    recording: Callable[[str], Trajectory],
) -> None:
    truth, estimate = (recording(f"hilti_2021/uzh_run2_{name}.txt") for name in ("mocap", "hdl"))
    text = findings(truth, estimate)["groundtruth_outlier"]
    assert re.match(r"the groundtruth has an outlier of 9\.9\d m and 98 deg at 23\.72 s", text)


@pytest.mark.parametrize("count", [1, 3, 40])
def test_wrong_samples_of_the_groundtruth_are_named(count: int) -> None:
    positions = GROUNDTRUTH.positions.copy()
    rows = np.random.default_rng(count).choice(np.arange(5, len(positions) - 5), count)
    positions[rows] += [30.0, 0.0, 0.0]
    wrong = dataclasses.replace(GROUNDTRUTH, positions=positions)
    estimate = dataclasses.replace(GROUNDTRUTH, positions=GROUNDTRUTH.positions + 0.01)
    causes = findings(wrong, estimate)
    assert "groundtruth_outlier" in causes
    assert not {"outlier", "step", "restart"} & causes.keys()


def test_a_frozen_estimate_is_no_jump_of_the_groundtruth() -> None:
    positions = ESTIMATE.positions.copy()
    positions[100:200] = positions[100]
    causes = findings(GROUNDTRUTH, dataclasses.replace(ESTIMATE, positions=positions))
    assert causes.keys() == {"frozen_position"}
