"""Protocols of benchmarks: UZH-FPV's sub-trajectories, Hilti's points, and files of one's own."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paths import ROOT
from scipy.spatial.transform import Rotation
from strategies import (
    Pair,
    assert_same_numbers,
    make_element,
    make_groundtruth,
    make_pair,
    moved,
    pairs,
    seeds,
)

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.requests.request_from import read_protocol
from trajeval_ros.metrics.alignment import align
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.protocol import PROTOCOLS, Protocol, metres
from trajeval_ros.metrics.relative_errors import align_spans
from trajeval_ros.metrics.score import PointTable
from trajeval_ros.metrics.sub_trajectories import Length, Selection
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.pipeline.pipeline import evaluate

HILTI = PROTOCOLS["hilti-2023"]
UZH = PROTOCOLS["uzh-fpv"]


def shorter(protocol: Protocol) -> Protocol:
    return dataclasses.replace(protocol, lengths=metres(5, 10))


@given(pair=pairs(), seed=seeds)
def test_spans_are_aligned_as_each_by_itself(pair: Pair, seed: int) -> None:
    random = np.random.default_rng(seed)
    count = min(len(pair.estimate), len(pair.groundtruth))
    p, q = pair.groundtruth.positions[:count], pair.estimate.positions[:count]
    starts = random.integers(0, count - 12, 6)
    ends = np.minimum(starts + random.integers(5, count, 6), count - 1)
    rotations, mean_p, mean_q = align_spans(p, q, starts, ends)
    assert len(starts) > 0
    for row, (start, end) in enumerate(zip(starts, ends, strict=True)):
        alone = align(Gauge.YAW, p[start : end + 1], q[start : end + 1]).similarity
        assert np.allclose(Rotation.from_quat(rotations[row]).as_matrix(), alone.rotation)
        assert np.allclose(alone.positions(mean_q[row]), mean_p[row], atol=1e-9)


@pytest.mark.slow
@given(pair=pairs(), seed=seeds)
def test_fitted_errors_don_t_depend_on_the_estimate_s_frame(pair: Pair, seed: int) -> None:
    element = make_element(Gauge.YAW, seed)
    before = evaluate(pair.groundtruth, pair.estimate, shorter(UZH))
    after = evaluate(pair.groundtruth, moved(pair.estimate, element), shorter(UZH))
    assert_same_numbers(before, after, relative=1e-7, absolute=1e-7)


def test_fitted_errors_are_those_of_the_rule_written_out() -> None:
    pair = make_pair(3, 160, smooth=True)
    result = evaluate(pair.groundtruth, pair.estimate, shorter(UZH))
    assert result.relative is not None
    truth, estimate = result.association.groundtruth, result.association.estimate
    assert truth.rotations is not None
    assert estimate.rotations is not None
    for segment in result.relative:
        errors = segment.errors
        assert len(errors.ends) > 10
        for row, (start, end) in enumerate(zip(errors.starts, errors.ends, strict=True)):
            span = slice(start, end + 1)
            alone = align(Gauge.YAW, truth.positions[span], estimate.positions[span]).similarity
            there = alone.positions(estimate.positions[end])
            expected_m = np.linalg.norm(truth.positions[end] - there)
            assert errors.position_m[row] == pytest.approx(expected_m, abs=1e-9)
            rotated = Rotation.from_matrix(alone.rotation) * estimate.rotations[int(end)]
            between = truth.rotations[int(end)] * rotated.inv()
            expected_deg = np.degrees(between.magnitude())
            assert errors.rotation_deg[row] == pytest.approx(expected_deg, abs=1e-6)


def test_uzh_fpv_is_what_its_organisers_say() -> None:
    assert [str(length) for length in UZH.lengths] == ["40m", "60m", "80m", "100m", "120m"]
    assert UZH.gauge is Gauge.YAW
    with pytest.raises(SettingsError, match="use gauge yaw, or RE form gauge"):
        dataclasses.replace(UZH, gauge=Gauge.SE3)


def surveyed(seed: int = 0, count: int = 8) -> tuple[Trajectory, Trajectory, np.ndarray]:
    """Return control points, a trajectory that stands on each with its tip, and the errors."""
    random = np.random.default_rng(seed)
    start = 1_675_087_000_000_000_000
    stamps = start + np.arange(count, dtype=np.int64) * 60_000_000_000
    points = random.uniform(-20.0, 20.0, (count, 3))
    control = Trajectory(stamps, points, Rotation.identity(count).as_quat())
    dense = start + np.arange((count - 1) * 600 + 1, dtype=np.int64) * 100_000_000
    rotations = Rotation.random(len(dense), random_state=seed)
    world = Rotation.random(random_state=seed + 1)
    tips = np.column_stack([np.interp(dense, stamps, points[:, axis]) for axis in range(3)])
    positions = world.apply(tips) - (world * rotations).apply(np.asarray(HILTI.lever_m))
    return control, Trajectory(dense, positions, (world * rotations).as_quat()), points


def test_hilti_s_lever_arm_and_alignment() -> None:
    control, estimate, _ = surveyed()
    result = evaluate(control, estimate, HILTI)
    assert result.ate["position_m"] is not None
    assert result.ate["position_m"].max < 1e-9
    assert result.score is not None
    assert result.score.value == pytest.approx(100.0)
    without = evaluate(control, estimate, dataclasses.replace(HILTI, lever_m=None))
    assert without.ate["position_m"] is not None
    assert without.ate["position_m"].rmse > 0.05


def test_missing_points_score_nothing() -> None:
    control, estimate, _ = surveyed()
    # The estimate begins 2.1 s after the fourth point.
    late = estimate[estimate.stamps > control.stamps[3] + 2_050_000_000]
    result = evaluate(control, late, HILTI)
    assert result.score is not None
    assert (result.score.references, result.score.missing) == (8, 4)
    assert result.score.value == pytest.approx(50.0)
    assert "4 points without an estimate, scored 0" in result.warnings


@given(seed=seeds, visited=st.sets(st.integers(0, 11), min_size=1, max_size=3))
@pytest.mark.parametrize("method", ["evo", "nearest"])
def test_a_point_with_several_poses_counts_once_by_the_nearest(
    method: str, seed: int, visited: set[int]
) -> None:
    random = np.random.default_rng(seed)
    times = np.arange(12, dtype=np.int64) * 60_000_000_000
    control = Trajectory(times, random.uniform(-20.0, 20.0, (12, 3)))
    # Three poses at each are fewer than the points; only the nearest in time is on the spot.
    points = np.repeat(sorted(visited), 3)
    late_s = np.tile(random.permutation([-0.3, 0.1, 0.5]), len(visited))
    positions = control.positions[points] + np.where(late_s == 0.1, 0.0, 1.0)[:, None]
    stamps = control.stamps[points] + np.round(late_s * 1e9).astype(np.int64)
    protocol = dataclasses.replace(
        HILTI,
        gauge=Gauge.NONE,
        lever_m=None,
        association=dataclasses.replace(HILTI.association, method=method),
    )
    result = evaluate(control, Trajectory(stamps, positions), protocol).score
    assert result is not None
    assert (result.counts[0], result.missing) == (len(visited), 12 - len(visited))
    assert sum(result.counts) == len(visited)
    assert result.value == pytest.approx(100.0 * len(visited) / 12)


def test_a_score_is_by_points_and_not_by_what_is_between_them() -> None:
    assert dataclasses.replace(HILTI, association=AssociationRule("index")).score is not None
    for method in ("linear", "continuous"):
        with pytest.raises(SettingsError, match=f"not association {method}"):
            dataclasses.replace(HILTI, association=AssociationRule(method))


@pytest.mark.parametrize(
    ("error_m", "points"),
    [
        (0.0, 20),
        (0.00499, 20),
        (0.005, 10),
        (0.00999, 10),
        (0.01, 6),
        (0.03, 5),
        (0.06, 3),
        (0.1, 1),
        (0.3999, 1),
        (0.4, 0),
        (5.0, 0),
    ],
)
def test_hilti_s_table(error_m: float, points: int) -> None:
    assert HILTI.score is not None
    score = HILTI.score.score(np.array([error_m]), 1)
    assert score.value == pytest.approx(5.0 * points)
    assert sum(score.counts) == 1
    # evaluation-2023 divides the sum of points by a fifth of their number: the same.
    assert HILTI.score.score(np.array([error_m, 1.0]), 4).value == pytest.approx(points / (4 / 5))


def test_a_lever_arm_needs_orientations() -> None:
    control, estimate, _ = surveyed()
    with pytest.raises(InputError, match="has no orientations, which a lever arm needs"):
        evaluate(control, dataclasses.replace(estimate, quaternions=None), HILTI)


@given(seed=seeds, lever=st.tuples(*[st.floats(-2.0, 2.0)] * 3))
@pytest.mark.parametrize("gauge", [Gauge.NONE, Gauge.YAW, Gauge.PLANAR, Gauge.SE3])
def test_a_lever_arm_on_a_tilting_body_leaves_no_error(
    gauge: Gauge, seed: int, lever: tuple[float, float, float]
) -> None:
    estimate = make_groundtruth(seed)
    assert estimate.rotations is not None
    tips = estimate.positions + estimate.rotations.apply(lever)
    truth = dataclasses.replace(estimate, positions=tips, quaternions=None, velocities=None)
    result = evaluate(truth, estimate, Protocol(gauge=gauge, lever_m=lever, lengths=()))
    assert result.ate["position_m"] is not None
    assert result.ate["position_m"].max < 1e-9


def test_a_file_is_a_protocol(tmp_path: Path) -> None:
    file = tmp_path / "ours.yaml"
    file.write_text("base: uzh-fpv\n")
    assert read_protocol(file) == dataclasses.replace(UZH, name="ours")
    file.write_text(
        "base: hilti-2023\n"
        "gauge: yaw\n"
        "align_states: 5\n"
        "association: nearest\n"
        "max_time_difference: 1\n"
        "in_order: true\n"
        "lengths: [8, 1s, 10%]\n"
        "sub_trajectory_rule: first-past\n"
        "sub_trajectory_step: 10\n"
        "lever_arm: [0, 0.1, 0.2]\n"
        "score: {bounds_m: [0.01, 0.1], points: [10, 1], best: 200}\n"
    )
    assert read_protocol(file) == Protocol(
        name="ours",
        gauge=Gauge.YAW,
        align_states=5,
        association=AssociationRule("nearest", max_time_difference_s=1),
        lengths=(Length(8.0, "m"), Length(1.0, "s"), Length(10.0, "%")),
        selection=Selection("first-past", 10),
        lever_m=(0.0, 0.1, 0.2),
        score=PointTable((0.01, 0.1), (10.0, 1.0), 200.0),
    )


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("base: uzh\n", "unknown protocol 'uzh'"),
        ("gaug: yaw\n", "has an unknown key 'gaug'; did you mean gauge?"),
        ("gauge: 4dof\n", "unknown gauge '4dof'"),
        ("gauge: yaw\nmodality: mono\n", "modality mono means gauge sim3"),
        ("re_form: best\n", "unknown RE form 'best'"),
        ("re_form: fitted\n", "use gauge yaw"),
        ("lengths: 3x\n", "'3x' is not a length"),
        ("lengths: [8, 8]\n", "a length is given twice"),
        ("align_states: few\n", "align states must be all or a number"),
        pytest.param(
            f"align_states: '{'9' * 5000}'\n", "align states must be all", id="many digits"
        ),
        ("max_gap: soon\n", "max_gap must be a number, not 'soon'"),
        ("association: {method: linear}\n", "association must be a text"),
        ("max_gap: -1\n", "max_gap must be greater than 0"),
        ("sub_trajectory_rule: last\n", "unknown selection rule 'last'"),
        ("sub_trajectory_step: 0\n", "must be at least 1, not 0"),
        ("in_order: maybe\n", "in_order must be true or false"),
        ("lever_arm: [1, 2]\n", "lever arm '1,2' is not valid"),
        ("lever_arm: [1, 2, .nan]\n", "lever arm '1,2,nan' is not valid"),
        ("score: {bounds_m: [0.1], points: []}\n", "one number of points per bound"),
        ("score: {bounds_m: [0.1]}\n", "score.points must be a list of numbers, not None"),
        ("score: {bounds_m: [1.0e9], points: [1]}\n", "score.bounds_m must be a number below 1e9"),
        (
            "score: {bounds_m: [1], points: [1], best: x}\n",
            "score.best must be a number below 1e9, not 'x'",
        ),
        ("ate_form: 3\n", "unknown ATE form '3'"),
        ("- uzh-fpv\n", "has no protocol"),
    ],
)
def test_files_that_mean_nothing_are_refused(tmp_path: Path, text: str, sentence: str) -> None:
    file = tmp_path / "ours.yaml"
    file.write_text(text)
    with pytest.raises((InputError, SettingsError)) as caught:
        read_protocol(file)
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_large_bounds_of_a_score_are_accepted(tmp_path: Path) -> None:
    file = tmp_path / "ours.yaml"
    file.write_text("association: nearest\nscore: {bounds_m: [1, 9.9e8], points: [2, 1]}\n")
    score = read_protocol(file).score
    assert score is not None
    assert score.bounds_m == (1.0, 9.9e8)


def tum(path: Path, trajectory: Trajectory) -> str:
    quaternions = trajectory.quaternions
    assert quaternions is not None
    rows = zip(trajectory.stamps.tolist(), trajectory.positions, quaternions, strict=True)
    lines = [
        f"{stamp // 10**9}.{stamp % 10**9:09d} " + " ".join(f"{x:.9f}" for x in (*p, *q))
        for stamp, p, q in rows
    ]
    path.write_text("\n".join(lines) + "\n")
    return str(path)


def test_the_command_line_scores(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    control, estimate, _ = surveyed()
    files = ["-g", tum(tmp_path / "points.txt", control), "-e", tum(tmp_path / "x.txt", estimate)]
    assert main(["evaluate", *files, "--protocol", "hilti-2023"]) == 0
    assert "score 100 of 100 for 8 points: 8 under 0.005 m" in capsys.readouterr().out
    site3 = tmp_path / "site3.yaml"
    site3.write_text(
        "base: hilti-2023\nscore: {bounds_m: [0.005, 0.01, 0.03, 0.06, 0.1, 0.4], "
        "points: [20, 10, 6, 5, 3, 1], best: 200}\n"
    )
    assert main(["evaluate", *files, "--protocol", str(site3), "--json", "-"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["runs"][0]["score"]["value"] == pytest.approx(200.0)
    assert result["provenance"]["protocol"] == "site3"
    assert result["provenance"]["settings"]["lever_arm"] == [0.059, -0.00855, 0.1964]
    hand_eye = ["--hand-eye", "auto"]
    assert main(["evaluate", *files, "--protocol", "hilti-2023", *hand_eye]) == 2
    assert "already defines a lever arm" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["nowhere.yaml", "nowhere"])
def test_a_protocol_that_isn_t_there(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "-g", "a", "-e", "b", "--protocol", name]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


@given(st.lists(st.floats(0.0, 1.0), max_size=20), st.integers(0, 5))
def test_scores_are_between_nothing_and_the_best(errors: list[float], missing: int) -> None:
    assert HILTI.score is not None
    references = len(errors) + missing
    if references:
        score = HILTI.score.score(np.array(errors), references)
        assert 0.0 <= score.value <= score.best
        assert sum(score.counts) + score.missing == references


def test_the_file_in_the_documentation_is_one(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "protocols.md").read_text(encoding="utf-8")
    file = tmp_path / "ours.yaml"
    file.write_text(text.split("```yaml\n")[1].split("```")[0])
    assert read_protocol(file).lever_m == (0.1, 0.0, -0.02)


@pytest.mark.parametrize("name", ["uzh-fpv", "hilti-2023"])
def test_what_needs_the_whole_recording_is_refused_live(name: str) -> None:
    rule = AssociationRule("groundtruth-stamps")
    with pytest.raises(SettingsError, match="evaluate the recorded run"):
        OnlineSettings(dataclasses.replace(PROTOCOLS[name], association=rule))
