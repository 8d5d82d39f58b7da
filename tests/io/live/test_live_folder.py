"""The folder of a live run: evaluated as a recording, with the settings of the run."""

from __future__ import annotations

import copy
import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from state_file_contents import (
    COUNT,
    DESCRIPTION,
    STATE,
    STEP_NS,
    columns,
    write_estimate,
    write_groundtruth,
)
from state_rows import trajectory

from trajeval_ros import Protocol, Trajectory, evaluate, run
from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.io.hand_eye_file import hand_eye_json
from trajeval_ros.io.live.live_folder import evaluate_folder
from trajeval_ros.io.live.state_file import GROUNDTRUTH, StateWriter, read_states
from trajeval_ros.io.requests.request_from import request_from
from trajeval_ros.io.requests.settings_table import settings_of
from trajeval_ros.metrics.as_available import AvailabilityRule
from trajeval_ros.metrics.stream_health import UNKNOWN
from trajeval_ros.pipeline.request import Request

POSE = HandEye.of(np.array([0.1, 0.2, 0.3]), np.array([0.4, 0.5, 0.6]))


def state_with(**changes: Any) -> dict[str, Any]:
    """Return a state; `estimate__frame=...` changes a value of a part."""
    state = copy.deepcopy(STATE)
    for name, value in changes.items():
        part, _, key = name.partition("__")
        if key:
            state[part][key] = value
        else:
            state[part] = value
    return state


def trajectories() -> list[Trajectory]:
    stamps, *sides = columns()
    return [Trajectory(stamps, side[:, :3], lie.normalized(side[:, 3:7])) for side in sides]


def test_states_are_evaluated_with_the_settings_of_the_run(tmp_path: Path) -> None:
    write_estimate(tmp_path / "vio.states")
    outcome = evaluate_folder(tmp_path)
    [result] = outcome.runs
    expected = evaluate(*trajectories(), Protocol(gauge="yaw", lengths=("2m", "4m")))
    assert result.evaluation.protocol.lengths == expected.protocol.lengths
    for name, statistics in expected.ate.items():
        mine = result.evaluation.ate[name]
        assert (mine is None) == (statistics is None)
        if mine is not None and statistics is not None:
            assert mine.rmse == pytest.approx(statistics.rmse, rel=1e-12)
    relative = result.evaluation.relative or ()
    assert [item.count for item in relative] == [item.count for item in expected.relative or ()]
    groundtruth, estimate = outcome.groundtruth, result.estimate
    assert (groundtruth.source, groundtruth.poses) == ("/truth", COUNT)
    assert (estimate.source, estimate.name, estimate.duration_s) == ("/vio", "vio", 9.95)
    assert (groundtruth.frame, groundtruth.child_frame) == ("map", "marker")
    assert (estimate.frame, estimate.child_frame) == ("odom", "base_link")
    assert result.live == STATE["live"]
    assert [remark.code for remark in result.evaluation.remarks if "live_run" in remark.code] == []


@pytest.mark.parametrize("later", [0, 1, 30])
@pytest.mark.parametrize("torn", [0, 1, 7])
def test_an_end_without_the_last_counts_is_told(tmp_path: Path, later: int, torn: int) -> None:
    path = write_estimate(tmp_path / "vio.states", at=COUNT - later)
    path.write_bytes(path.read_bytes() + b"x" * torn)
    [result] = evaluate_folder(tmp_path).runs
    text = {remark.code: remark.text for remark in result.evaluation.remarks}
    assert ("live_run_stopped" in text) == bool(later or torn)
    assert ("damaged_states" in text) == bool(torn)
    if later or torn:
        poses = "1 pose" if later == 1 else f"{later} poses"
        assert f"are from {poses} before the end" in text["live_run_stopped"]
    if torn:
        count = "1 byte" if torn == 1 else f"{torn} bytes"
        assert text["damaged_states"] == (
            f"vio.states is damaged or truncated: the last {count} can't be read"
        )


def test_estimates_are_in_the_order_of_their_configuration(tmp_path: Path) -> None:
    for name, place in (("a", 2), ("b", 0), ("c", 1)):
        write_estimate(tmp_path / f"{name}.states", place=place)
    (tmp_path / "d.states").write_bytes(b"nothing")
    StateWriter(tmp_path / "e.states", {**DESCRIPTION, "name": "e"}).close()
    result = evaluate_folder(tmp_path)
    assert [item.estimate.name for item in result.runs] == ["b", "c", "a"]
    assert [item.name for item in result.failed] == ["d", "e"]
    assert result.failed[1].reason == "e: no pose so far"
    codes = [finding.cause for finding in result.runs[1].diagnosis.findings]
    assert "same_estimate" in codes


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (None, "no live run in"),
        ("d.states", "is not a file of states"),
        ("d.pairs", "is of version 0.3, which recorded pairs; read it with that version"),
    ],
)
def test_what_is_no_run_is_one_sentence(tmp_path: Path, name: str | None, message: str) -> None:
    if name is not None:
        (tmp_path / name).write_bytes(b"nothing")
    if name == "d.states":
        write_groundtruth(tmp_path)
    with pytest.raises(InputError, match=message):
        evaluate_folder(tmp_path)


def test_a_frozen_alignment_is_that_of_its_states(tmp_path: Path) -> None:
    for aligned_by in (None, 40):
        folder = tmp_path / str(aligned_by)
        folder.mkdir()
        write_estimate(folder / "vio.states", state_with(aligned_by=aligned_by))
        result = evaluate_folder(folder).runs[0].evaluation
        assert result.protocol.align_states == aligned_by
        assert result.alignment.states_used == (aligned_by or COUNT)
    assert evaluate_folder(folder, None, "poses").runs[0].evaluation.protocol.align_with == "poses"


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"modality": "mono", "lengths": "none", "max_gap": 0.3},
        {"align_states": "10", "align_with": "poses", "gauge": "se3"},
        {"align_states": "1", "lengths": "2s,30f", "association": "linear"},
        {"lever_arm": "0.1,0,0.2"},
    ],
    ids=str,
)
def test_the_settings_of_the_node_are_those_of_the_evaluation(
    settings: dict[str, Any], tmp_path: Path
) -> None:
    request = request_from(settings)
    stored = json.loads(json.dumps(settings_of(request)))
    write_estimate(tmp_path / "vio.states", state_with(settings=stored))
    outcome = evaluate_folder(tmp_path)
    truth, estimate = trajectories()
    expected = run(truth, [estimate], dataclasses.replace(request, gauge_is_default=False))
    assert outcome.runs[0].evaluation.protocol == expected.runs[0].evaluation.protocol
    assert outcome.settings == settings_of(request)


def test_revised_poses_are_judged_and_the_causal_errors_kept(tmp_path: Path) -> None:
    write_estimate(tmp_path / "vio.states")
    causal = evaluate_folder(tmp_path).runs[0].evaluation.ate["position_m"]
    assert causal is not None
    stamps, truth, _ = columns()
    writer = StateWriter(tmp_path / "vio.revised", DESCRIPTION)
    writer.append(trajectory(stamps[10:60], truth[10:60]))
    writer.close()
    [result] = evaluate_folder(tmp_path).runs
    revised = result.evaluation.ate["position_m"]
    assert revised is not None
    assert revised.rmse < 1e-6 < causal.rmse
    assert result.live is not None
    assert result.live["causal_ate"]["position_m"]["rmse"] == causal.rmse
    assert result.live["messages_lost"] == 0
    assert (result.estimate.poses, result.estimate.duration_s) == (50, 49 * STEP_NS / 1e9)


@pytest.mark.parametrize("gauge", ["yaw", "planar"])
def test_up_axes_are_those_of_the_run_or_as_requested(tmp_path: Path, gauge: str) -> None:
    ups = [{"name": name, "origin": "stated"} for name in ("-y", "z")]
    state = state_with(groundtruth__up=ups[0], estimate__up=ups[1], settings__gauge=gauge)
    write_estimate(tmp_path / "vio.states", state)
    for up, expected in ((None, ["-y", "z"]), (("x", "-z"), ["x", "-z"])):
        result = evaluate_folder(tmp_path, Request(up=up))
        assert [result.groundtruth.up.name, result.runs[0].estimate.up.name] == expected
        assert result.runs[0].evaluation.protocol.gauge.value == gauge


def test_the_transform_of_the_run_is_applied_and_can_be_replaced(tmp_path: Path) -> None:
    body = {"T_body_marker": hand_eye_json(POSE), "source": "x.yaml"}
    write_estimate(tmp_path / "vio.states", state_with(hand_eye=body))
    other = CalibrationRequest(known=HandEye.of(None, np.array([1.0, 0.0, 0.0])))
    live = CalibrationRequest(known=POSE)
    for given, known in ((None, live), (Request(calibration=other), other)):
        [result] = evaluate_folder(tmp_path, given).runs
        request = Request(Protocol(gauge="yaw", lengths=("2m", "4m")), known)
        truth, estimate = trajectories()
        [expected] = run(truth, [estimate], request).runs
        assert result.calibrated is not None
        for name, statistics in expected.evaluation.ate.items():
            mine = result.evaluation.ate[name]
            assert (mine is None) == (statistics is None)
            assert (
                mine is None or statistics is None or mine.rmse == pytest.approx(statistics.rmse)
            )


def test_states_of_the_next_run_are_left_out(tmp_path: Path) -> None:
    stamps, *_ = columns()
    offset = state_with(until_ns=int(stamps[120]) + 1)
    write_estimate(tmp_path / "vio.states", offset)
    result = evaluate_folder(tmp_path).runs[0].evaluation.association
    assert result.estimate.stamps.tolist() == stamps[:121].tolist()
    assert result.coverage.covered == pytest.approx(120 / 121)


def test_rows_that_are_no_states_are_counted(tmp_path: Path) -> None:
    stamps, truth, estimate = columns()
    truth[3, :3], estimate[5, :3], estimate[7, :3] = np.nan, np.nan, np.nan
    for name, rows, description in (
        (GROUNDTRUTH, truth, {"source": "/truth", "name": "truth"}),
        ("vio.states", estimate, DESCRIPTION),
    ):
        writer = StateWriter(tmp_path / name, description)
        writer.append(Trajectory(stamps, rows[:, :3], lie.normalized(rows[:, 3:7])))
        writer.describe(STATE)
        writer.close()
    result = evaluate_folder(tmp_path).runs[0].evaluation
    assert len(result.association) == COUNT - 2
    assert result.estimate.reading.dropped == {"not_finite": 2}
    assert result.groundtruth.reading.dropped == {"not_finite": 1}


def test_identity_rotations_are_left_out_as_from_a_bag(tmp_path: Path) -> None:
    stamps, truth, _ = columns()
    truth[:, 3:7] = [0.0, 0.0, 0.0, 1.0]
    writer = StateWriter(tmp_path / GROUNDTRUTH, {"source": "/truth", "name": "truth"})
    writer.append(trajectory(stamps, truth))
    writer.close()
    write_estimate(tmp_path / "vio.states")
    result = evaluate_folder(tmp_path).runs[0].evaluation
    assert result.groundtruth.quaternions is None
    assert result.association.rule.method == "linear"


def test_settings_of_finish_are_used_where_it_has_some(tmp_path: Path) -> None:
    write_estimate(tmp_path / "vio.states", state_with(time_offset_s=0.05))
    [result] = evaluate_folder(tmp_path).runs
    assert result.evaluation.association.rule.time_offset_s == 0.05
    path = tmp_path / "vio.states"
    recorded = read_states(path)
    assert dataclasses.replace(recorded, later=0).state["time_offset_s"] == 0.05


@pytest.mark.parametrize("unknown", [0, 5, COUNT])
def test_poses_of_an_unknown_reception_are_not_available(tmp_path: Path, unknown: int) -> None:
    write_groundtruth(tmp_path)
    stamps, _, estimate = columns()
    arrived = stamps + STEP_NS // 5
    arrived[:unknown] = UNKNOWN
    writer = StateWriter(tmp_path / "vio.states", DESCRIPTION)
    writer.append(trajectory(stamps, estimate, arrived=arrived))
    writer.describe(STATE)
    writer.close()
    request = Request(available=AvailabilityRule("hold"))
    [result] = evaluate_folder(tmp_path, request).runs
    assert result.available is not None
    available = result.available.numbers
    assert len(result.evaluation.association) == COUNT
    if unknown == COUNT:
        assert "no receive times" in available.why_withheld
        return
    assert available.latency_s is not None
    assert available.latency_s.max == pytest.approx(STEP_NS / 5e9)


@pytest.mark.parametrize("name", [GROUNDTRUTH, "vio.revised"])
def test_poses_lost_to_damage_are_told(tmp_path: Path, name: str) -> None:
    """A file is read up to its first damage, wherever that is."""
    write_estimate(tmp_path / "vio.states")
    stamps, truth, estimate = columns()
    revised = StateWriter(tmp_path / "vio.revised", DESCRIPTION)
    (tmp_path / GROUNDTRUTH).unlink()
    reference = StateWriter(tmp_path / GROUNDTRUTH, {"source": "/truth", "name": "truth"})
    for writer, rows in ((revised, estimate), (reference, truth)):
        for some in (slice(0, 60), slice(60, None)):
            writer.append(trajectory(stamps[some], rows[some]))
        writer.close()
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(content[:-1])
    [result] = evaluate_folder(tmp_path).runs
    text = [item.text for item in result.evaluation.remarks if item.code == "damaged_states"]
    assert len(text) == 1
    assert f"{name} is damaged or truncated: the last " in text[0]


@pytest.mark.parametrize("torn", ["", "x"])
def test_a_groundtruth_without_poses_is_refused(tmp_path: Path, torn: str) -> None:
    write_estimate(tmp_path / "vio.states", state_with(settings__gauge="yaw"))
    path = tmp_path / GROUNDTRUTH
    path.unlink()
    StateWriter(path, {"source": "/truth", "name": "truth"}).close()
    path.write_bytes(path.read_bytes() + torn.encode())
    damage = "; groundtruth.states is damaged or truncated: the last 1 byte can't be read"
    with pytest.raises(InputError) as refused:
        evaluate_folder(tmp_path)
    assert str(refused.value) == f"/vio: no usable pose in truth{damage if torn else ''}"
