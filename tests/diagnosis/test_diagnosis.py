"""Findings are printed first and stored in result.json; corrections are options, and printed."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.diagnosis_mistakes import MISTAKES
from benchmarks.diagnosis_runs import Pair, simulated
from trajeval_ros import CalibrationRequest, Protocol, Request, Trajectory, run, simulate
from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry import so3
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.source_info import SourceInfo
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.protocol import protocol_named
from trajeval_ros.pipeline.diagnosing import diagnose
from trajeval_ros.pipeline.pipeline import evaluate

DRONE = simulated(5000, "drone", "walk", 60.0)


def written(trajectory: Trajectory, path: Path) -> str:
    assert trajectory.quaternions is not None
    columns = [trajectory.stamps / 1e9, trajectory.positions, trajectory.quaternions]
    np.savetxt(path, np.column_stack(columns), fmt="%.9f")
    return str(path)


def files(pair: Pair, folder: Path) -> list[str]:
    truth, estimate = folder / "groundtruth.txt", folder / "vio.txt"
    return ["-g", written(pair.truth, truth), "-e", written(pair.estimate, estimate)]


def test_the_finding_stands_under_the_headline_and_nowhere_else(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = MISTAKES["estimate in mm"].make(DRONE)
    result = tmp_path / "result.json"
    arguments = [*files(wrong, tmp_path), "--gauge", "yaw", "--json", str(result)]
    assert main(["evaluate", *arguments]) == 0
    shown = capsys.readouterr()
    lines = shown.out.splitlines()
    assert lines[0].startswith("vio: position error ")
    assert lines[1].startswith("  diagnosis: the estimate is in millimetres")
    assert re.search(
        r"to metres: ATE 4\d{3}\.\d m, with --correct unit 0\.7\d+ m, or trajeval trajectory "
        r"SOURCE --scale 0\.001$",
        lines[1],
    )
    assert "millimetres" not in shown.err
    assert "jumps" not in shown.err
    (outcome,) = json.loads(result.read_text())["runs"][0]["diagnosis"]
    assert outcome["cause"] == "unit"
    assert outcome["option"] == "--correct unit"
    assert outcome["evidence"]["scale"] == pytest.approx(1e-3, rel=0.05)
    assert outcome["before"]["position_m"] > 1000.0 * outcome["after"]["position_m"]


def test_a_correction_is_printed_with_the_errors_before_and_after(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = MISTAKES["estimate in mm"].make(DRONE)
    result = tmp_path / "result.json"
    arguments = [*files(wrong, tmp_path), "--gauge", "yaw", "--json", str(result)]
    assert main(["evaluate", *arguments, "--correct", "unit"]) == 0
    shown = capsys.readouterr()
    assert "  corrected with --correct unit: ATE " in shown.out
    assert "positions multiplied by 0.001" in shown.err
    read = json.loads(result.read_text())
    (corrected,) = read["runs"][0]["corrected"]
    assert corrected["cause"] == "unit"
    assert corrected["before"]["position_m"] > 100.0 * corrected["after"]["position_m"]
    assert corrected["after"]["position_m"] == read["runs"][0]["ate"]["position_m"]["rmse"]
    assert read["provenance"]["settings"]["correct"] == "unit"
    assert read["runs"][0]["diagnosis"] == []


def test_a_correction_by_an_option_names_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = MISTAKES["scale lost"].make(DRONE)
    assert main(["evaluate", *files(wrong, tmp_path), "--gauge", "yaw", "--correct", "scale"]) == 0
    assert "  corrected with --gauge sim3 (--correct): ATE " in capsys.readouterr().out


@pytest.mark.parametrize(
    "name",
    ["estimate in mm", "wxyz, estimate", "transposed rotations", "inverse, estimate", "mirrored"],
)
def test_a_converted_file_gives_the_same_numbers_as_the_correction(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    wrong = MISTAKES[name].make(DRONE)
    given = files(wrong, tmp_path)
    result = tmp_path / "result.json"
    ates = []
    conversion = ""
    for option in (["--correct", "suggested"], []):
        if not option:
            convert = ["trajectory", given[3], *conversion.split()]
            saved = ["--save-as", "tum", "--output", str(tmp_path / "converted"), "--quiet"]
            assert main([*convert, *saved]) == 0
            given[3] = str(tmp_path / "converted" / "vio.txt")
        arguments = [*given, "--gauge", "yaw", "--json", str(result), "--quiet"]
        assert main(["evaluate", *arguments, *option]) == 0
        outcome = json.loads(result.read_text())["runs"][0]
        ates.append([outcome["ate"][item]["rmse"] for item in ("position_m", "rotation_deg")])
        if option:
            (corrected,) = outcome["corrected"]
            assert corrected["option"] == f"--correct {corrected['cause']}"
            assert main(["evaluate", given[1], given[3], "--gauge", "yaw"]) == 0
            lines = capsys.readouterr().out.splitlines()
            line = next(line for line in lines if "diagnosis: " in line)
            conversion = line.partition("trajeval trajectory SOURCE ")[2]
            assert conversion
    assert ates[1] == pytest.approx(ates[0], rel=1e-6)


def test_nothing_is_corrected_without_a_request() -> None:
    wrong = MISTAKES["estimate in mm"].make(DRONE)
    result = run(wrong.truth, [wrong.estimate], Request(wrong.protocol)).runs[0]
    assert result.corrected == ()
    plain = run(DRONE.truth, [DRONE.estimate], Request(DRONE.protocol)).runs[0]
    assert result.diagnosis.suggested is not None
    assert plain.diagnosis.suggested is None


def test_a_correction_of_what_is_not_there_is_refused() -> None:
    request = Request(DRONE.protocol, correct="wxyz")
    with pytest.raises(InputError, match="wxyz not found"):
        run(DRONE.truth, [DRONE.estimate], request)
    with pytest.raises(SettingsError, match="cause to correct"):
        Request(correct="gremlins")
    suggested = dataclasses.replace(request, correct="suggested")
    assert run(DRONE.truth, [DRONE.estimate], suggested).runs[0].corrected == ()


def test_all_poses_twice_are_100_percent() -> None:
    twice = Trajectory(
        *(np.concatenate([item, item]) for item in (DRONE.estimate.stamps,
                                                    DRONE.estimate.positions))
    )  # fmt: skip
    result = run(DRONE.truth, [twice], Request(DRONE.protocol)).runs[0].diagnosis
    assert "100 % of the estimate's poses occur twice" in result.findings[0].text


@pytest.mark.parametrize(("every", "is_told"), [(3, True), (20, False)])
def test_many_unusable_poses_are_told(every: int, is_told: bool) -> None:
    positions = DRONE.estimate.positions.copy()
    positions[::every] = np.nan
    estimate = Trajectory.from_columns(
        DRONE.estimate.stamps, positions, DRONE.estimate.quaternions
    )
    (outcome,) = run(DRONE.truth, [estimate], Request(DRONE.protocol)).runs
    text = "33.3 % of the estimate's poses are not usable and were dropped: "
    text += f"{-(-len(positions) // 3)} not finite"
    assert any(warning.startswith(text) for warning in outcome.evaluation.warnings) == is_told
    # An estimate that is interpolated has no coverage, and its unusable poses are counted.
    rule = AssociationRule("groundtruth-stamps")
    request = Request(dataclasses.replace(DRONE.protocol, association=rule))
    (outcome,) = run(DRONE.truth, [estimate], request).runs
    assert outcome.evaluation.association.dropped["not_finite"] == -(-len(positions) // every)


def test_why_a_length_has_no_sub_trajectories_is_told() -> None:
    sparse = DRONE.estimate[::40]
    protocol = Protocol(gauge="yaw", lengths=("0.1s", "0.01m", "1000m", "500s"))
    (outcome,) = run(DRONE.truth, [sparse], Request(protocol)).runs
    step_s = float(np.median(np.diff(sparse.seconds)))
    text = [
        warning for warning in outcome.evaluation.warnings if warning.startswith("no sub-traj")
    ]
    assert text[0].startswith("no sub-trajectories of 1000 m, 500 s: the paired path has ")
    assert text[1].startswith(
        f"no sub-trajectories of 0.1 s, 0.01 m: pairs are {step_s:.2g} s and "
    )
    assert text[1].endswith("m apart (median); use longer sub-trajectories")


def test_a_correction_that_no_option_makes_is_refused() -> None:
    wrong = MISTAKES["duplicated"].make(DRONE)
    with pytest.raises(InputError, match="no option corrects the finding"):
        run(wrong.truth, [wrong.estimate], Request(wrong.protocol, correct="suggested"))


def test_hand_eye_refuses_poses_that_are_read_wrongly() -> None:
    wrong = MISTAKES["mirrored"].make(DRONE)
    request = Request(wrong.protocol, CalibrationRequest(hand_eye=True))
    with pytest.raises(InputError, match=r"left-handed.*--axes"):
        run(wrong.truth, [wrong.estimate], request)


def test_the_same_estimate_twice_is_told_once() -> None:
    outcome = run(DRONE.truth, [DRONE.estimate, DRONE.estimate], Request(DRONE.protocol))
    causes = [[finding.cause for finding in one.diagnosis.findings] for one in outcome.runs]
    assert causes == [[], ["same_estimate"]]
    assert "identical to" in outcome.runs[1].evaluation.warnings[0]


@pytest.mark.parametrize(
    ("truth", "estimate", "is_swapped"),
    [
        ("vio.txt", "groundtruth.txt", True),
        ("est.txt", "run/gt.csv", True),
        ("run.mcap:/odom", "run.mcap:/vicon/drone/pose", True),
        ("run.mcap:/odom", "run.mcap:/tf:map.mocap", True),
        ("s3://lab/poses.txt", "s3://lab/leica0.txt", True),
        ("gt.txt", "vio.txt", False),
        ("gt.txt", "mocap.txt", False),
        ("mav0/state_groundtruth_estimate0/data.csv", "reference.txt", False),
        ("MH_01.txt", "gt/vio.txt", False),
        ("MH_01.txt", "vicon_bags/run.mcap:/odom", False),
        ("V1_01.csv", "vicon_room1_01.txt", False),
        ("poses.txt", "orb_slam_gt_scale.txt", False),
        ("poses.txt", "gtsam.txt", False),
        ("", "groundtruth.txt", False),
        ("", "", False),
    ],
)
def test_swapped_sides_are_named_by_their_names(
    truth: str, estimate: str, is_swapped: bool
) -> None:
    sides = (
        dataclasses.replace(item, reading=SourceInfo(source))
        for item, source in ((DRONE.truth, truth), (DRONE.estimate, estimate))
    )
    assert ("swapped" in _causes(*sides, Protocol(gauge="yaw"))) == is_swapped


def _causes(truth: Trajectory, estimate: Trajectory, protocol: Protocol) -> list[str]:
    diagnosis = run(truth, [estimate], Request(protocol)).runs[0].diagnosis
    return [finding.cause for finding in diagnosis.findings]


@pytest.mark.parametrize("decimals", [3, 6, 16])
@pytest.mark.parametrize("protocol", ["default", "evo", "kitti"])
def test_a_copy_of_the_groundtruth_is_named(protocol: str, decimals: int) -> None:
    truth = dataclasses.replace(DRONE.truth, positions=DRONE.truth.positions + [4e5, 5e6, 100.0])
    copy = dataclasses.replace(truth, positions=truth.positions.round(decimals))
    by_index = protocol == "kitti"
    for estimate in (copy, copy if by_index else copy[7:-9:5]):
        result = run(truth, [estimate], Request(protocol_named(protocol))).runs[0].diagnosis
        assert result.findings[0].cause == "identical"
        assert "100 % of the positions" in result.findings[0].text
        assert ("in equal rows" in result.findings[0].text) == by_index


def test_a_copy_of_four_poses_is_named_and_a_body_at_rest_is_not() -> None:
    four = DRONE.truth[1000:2000:250]
    assert "identical" in _causes(four, four, Protocol(gauge="translation", lengths="none"))
    rest = dataclasses.replace(four, positions=np.zeros((4, 3)))
    assert "identical" not in _causes(rest, rest, Protocol(gauge="none", lengths="none"))


def test_a_moved_copy_is_named() -> None:
    truth = DRONE.truth
    rotation = so3.exp(np.array([0.1, -0.2, 2.0]))
    moved = dataclasses.replace(truth, positions=truth.positions @ rotation.T + [0.1, 0.2, 0.3])
    result = run(truth, [moved], Request(Protocol(gauge="yaw"))).runs[0].diagnosis.findings[0]
    assert result.cause == "identical"
    assert (
        "100 % of the positions at equal timestamps, after a rigid fit, are equal" in result.text
    )
    scaled = dataclasses.replace(truth, positions=truth.positions * 1.001)
    assert "identical" not in _causes(truth, scaled, Protocol(gauge="yaw"))


def test_a_good_estimate_is_no_copy() -> None:
    truth, random = DRONE.truth, np.random.default_rng(0)
    later = dataclasses.replace(truth, stamps=truth.stamps + 2_500_000)
    noise = 1e-4 * random.standard_normal(truth.positions.shape)
    noisy = dataclasses.replace(truth, positions=truth.positions + noise)
    for estimate in (later, noisy):
        for protocol in (Protocol(gauge="yaw"), protocol_named("evo")):
            assert "identical" not in _causes(truth, estimate, protocol)
    # Its first tenth is a copy, as of an estimator that groundtruth initialises.
    begun = np.where(np.arange(len(truth))[:, None] < len(truth) // 10, 0.0, noise)
    started = dataclasses.replace(truth, positions=truth.positions + begun)
    assert "identical" not in _causes(truth, started, Protocol(gauge="yaw"))


def test_frames_that_are_apart_are_told_where_nothing_aligns_them() -> None:
    flight = simulate(seed=1, duration_s=30.0)
    truth = flight.groundtruth
    estimate = dataclasses.replace(truth[::10], positions=truth.positions[::10] + [0.0, 0.0, 47.0])
    noise = np.random.default_rng(0).normal(0.0, 0.01, estimate.positions.shape)
    estimate = dataclasses.replace(estimate, positions=estimate.positions + noise)
    warning = evaluate(truth, estimate, Protocol(gauge="none")).warnings[0]
    assert "0.00, -47.00) m" in warning.replace("-0.00", "0.00")
    assert "geoid" in warning
    assert "--gauge translation" in warning


def test_the_tests_of_a_diagnosis_are_printed_on_request(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, truth, _, estimate = files(MISTAKES["mirrored"].make(DRONE), tmp_path)
    command = ["evaluate", truth, estimate, "--gauge", "yaw"]
    assert main([*command, "--diagnosis"]) == 0
    shown = capsys.readouterr().out
    assert "diagnosis: the axes of one side are left-handed" in shown
    tests = ("rounded stamps: no mistake", "clocks: no mistake (offset_s", "models: mirrored (")
    assert all(test in shown.partition("tests, their results")[2] for test in tests)
    assert main(command) == 0
    assert not any(test in capsys.readouterr().out for test in tests)


def test_the_diagnosis_helps_where_nothing_can_be_evaluated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    later = dataclasses.replace(DRONE.estimate, stamps=DRONE.estimate.stamps + 3600 * 10**9)
    _, truth, _, estimate = files(dataclasses.replace(DRONE, estimate=later), tmp_path)
    assert main(["evaluate", truth, estimate]) == 2
    shown = capsys.readouterr().err
    assert "(for a common start: -3600." in shown
    assert "--time-offset auto searches it" in shown
    assert main(["evaluate", truth, estimate, "--time-offset", "auto"]) == 0


@pytest.mark.slow
def test_a_comparison_marks_a_run_that_shows_a_mistake(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    from trajeval_ros.batch.compare_runs import compare
    from trajeval_ros.batch.summary_tables import matrices

    written(DRONE.truth, tmp_path / "hall.txt")
    copied = dataclasses.replace(DRONE, estimate=DRONE.truth)
    wrong = MISTAKES["wxyz, estimate"].make(DRONE)
    for name, pair in (("good", DRONE), ("bad", wrong), ("wrong", wrong), ("copy", copied)):
        (tmp_path / name).mkdir()
        written(pair.estimate, tmp_path / name / "hall.txt")
    config = tmp_path / "runs.yaml"
    config.write_text(
        "groundtruth: '{sequence}.txt'\nsequences: [hall]\ngauge: yaw\nlengths: '8'\n"
        "runs:\n  good: 'good/{sequence}.txt'\n  bad: 'bad/{sequence}.txt'\n"
        "  wrong: 'wrong/{sequence}.txt'\n  copy: 'copy/{sequence}.txt'\n"
    )
    summary = compare(config, tmp_path / "out", workers=1, report=False)
    assert {trial.algorithm: trial.diagnosis for trial in summary.trials} == {
        "good": (),
        "bad": ("wxyz",),
        "wrong": ("wxyz",),
        "copy": ("identical",),
    }
    table = next(matrix for matrix in matrices(summary) if matrix.name == "ate_rotation_deg")
    notes = {algorithm: cells[0].note for algorithm, cells in table.rows}
    assert notes == {"good": "", "bad": "§", "wrong": "§", "copy": "§"}
    assert "§ mistakes found (identical: copy hall; wxyz: bad hall and 1 more)" in table.caption
    assert "¶ not ranked: copy (is the groundtruth)." in table.caption
    for matrix in matrices(summary):
        ranked = {algorithm: cells[0].is_ranked for algorithm, cells in matrix.rows}
        assert ranked == {"good": True, "bad": True, "wrong": True, "copy": False}


@pytest.mark.parametrize(
    ("exchanged", "unit", "causes"),
    [
        (False, 1.0, []),
        (True, 1.0, ["covariance_order"]),
        (False, 180.0 / np.pi, ["covariance_degrees"]),
    ],
)
def test_covariances_in_another_order_or_unit(
    exchanged: bool, unit: float, causes: list[str]
) -> None:
    request = Request(dataclasses.replace(DRONE.protocol, gauge=Gauge.SE3))
    ate = run(DRONE.truth, [DRONE.estimate], request).runs[0].evaluation.ate
    position, rotation = ate["position_m"], ate["rotation_deg"]
    assert position is not None
    assert rotation is not None
    sigmas = np.repeat([position.median, unit * np.radians(rotation.median)], 3) / np.sqrt(3.0)
    sigmas = np.roll(sigmas, 3) if exchanged else sigmas
    covariances = np.linspace(1.0, 1.001, len(DRONE.estimate))[:, None, None] * np.diag(sigmas**2)
    told = dataclasses.replace(DRONE.estimate, covariances=covariances)
    result = run(DRONE.truth, [told], request).runs[0].diagnosis
    assert [finding.cause for finding in result.findings] == causes


@pytest.mark.parametrize(("kind", "seed"), [("handheld", 1), ("robot", 4)])
def test_the_offset_to_noisy_points_is_that_of_time_offset_auto(kind: str, seed: int) -> None:
    """Fixes of 2 cm ripple the correlation of a slow robot, which still matches at one offset."""
    pair, noise = simulated(seed, kind, "walk", 120.0), np.random.default_rng(seed)
    points = dataclasses.replace(pair.truth[::20], quaternions=None)
    positions = points.positions + noise.normal(0.0, 0.02, points.positions.shape)
    points = dataclasses.replace(points, positions=positions)
    late = dataclasses.replace(pair.estimate, stamps=pair.estimate.stamps + 1_290_000_000)
    protocol = dataclasses.replace(pair.protocol, association=AssociationRule(max_gap_s=0.5))
    finding = diagnose(points, late, Request(protocol))[0].suggested
    assert finding is not None
    assert finding.cause == "clock_offset"
    by_auto = Request(protocol, calibration=CalibrationRequest(offset=True))
    calibrated = run(points, [late], by_auto).runs[0].calibrated
    assert calibrated is not None
    assert calibrated.calibration is not None
    offset = calibrated.calibration.offset.value
    assert offset is not None
    assert offset[0] == pytest.approx(-1.29, abs=0.02)
    assert finding.evidence["offset_s"] == pytest.approx(offset[0], abs=0.02)
