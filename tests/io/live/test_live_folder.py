"""The folder of a live run: evaluated as its pairs are, with what the run did to its messages."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pair_file_contents import COUNT, DESCRIPTION, STATE, STEP_NS, columns

from trajeval_ros import Protocol, Trajectory, evaluate
from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.consistency.covariance_request import CovarianceRequest
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.io.hand_eye_file import hand_eye_json
from trajeval_ros.io.live.applied_hand_eye import AppliedHandEye
from trajeval_ros.io.live.live_folder import evaluate_folder, evaluate_pair_file
from trajeval_ros.io.live.pair_file import PairWriter, write_revised
from trajeval_ros.pipeline.request import Request

POSE = HandEye.of(np.array([0.1, 0.2, 0.3]), np.array([0.4, 0.5, 0.6]))
TRANSFORM = {"T_body_marker": hand_eye_json(POSE), "source": "x.yaml", "of_marker": False}


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


def write(
    path: Path, state: dict[str, Any] | None = None, at: int = COUNT, place: int = 0
) -> Path:
    """Write a pair file whose counts are those after `at` pairs."""
    stamps, truth, estimate = columns()
    writer = PairWriter(path, {**DESCRIPTION, "place": place})
    for rows, text in ((slice(0, at), state or STATE), (slice(at, None), None)):
        writer.append(stamps[rows], truth[rows], estimate[rows], text)
    writer.close()
    return path


def trajectories() -> list[Trajectory]:
    stamps, *sides = columns()
    return [Trajectory(stamps, each[:, :3], lie.normalized(each[:, 3:7])) for each in sides]


def test_a_pair_file_is_evaluated_with_its_own_protocol(tmp_path: Path) -> None:
    found = evaluate_pair_file(write(tmp_path / "vio.pairs"), Request(), None)
    expected = evaluate(*trajectories(), Protocol(gauge="yaw", lengths=("2m", "4m")))
    for name, statistics in expected.ate.items():
        mine = found.run.evaluation.ate[name]
        assert (mine is None) == (statistics is None)
        if mine is not None and statistics is not None:
            assert mine.rmse == pytest.approx(statistics.rmse, rel=1e-12)
    relative = found.run.evaluation.relative or ()
    assert [each.count for each in relative] == [each.count for each in expected.relative or ()]
    groundtruth, estimate = found.groundtruth, found.run.estimate
    assert (groundtruth.source, groundtruth.poses, groundtruth.path_length_m) == (
        *("/truth", COUNT, 20.0),
    )
    assert (estimate.source, estimate.name, estimate.duration_s) == ("/vio", "vio", 9.95)
    assert (groundtruth.frame, groundtruth.child_frame) == ("map", "marker")
    assert (estimate.frame, estimate.child_frame) == ("odom", "base_link")
    assert found.run.live == STATE["live"]
    assert [each.code for each in found.run.evaluation.remarks if "live_run" in each.code] == []


@pytest.mark.parametrize("later", [0, 1, 30])
@pytest.mark.parametrize("torn", [0, 1, 7])
def test_an_end_without_the_last_counts_is_told(tmp_path: Path, later: int, torn: int) -> None:
    path = write(tmp_path / "vio.pairs", at=COUNT - later)
    path.write_bytes(path.read_bytes() + b"x" * torn)
    found = evaluate_pair_file(path, Request(), None).run.evaluation.remarks
    said = {each.code: each.text for each in found}
    assert ("live_run_stopped" in said) == bool(later or torn)
    assert ("damaged_pairs" in said) == bool(torn)
    if later or torn:
        pairs = "1 pair" if later == 1 else f"{later} pairs"
        assert f"are from {pairs} before the end" in said["live_run_stopped"]
    if torn:
        count = "1 byte" if torn == 1 else f"{torn} bytes"
        assert said["damaged_pairs"] == (
            f"vio.pairs is damaged or truncated: the last {count} can't be read"
        )


def test_estimates_are_in_the_order_of_their_configuration(tmp_path: Path) -> None:
    for name, place in (("a", 2), ("b", 0), ("c", 1)):
        write(tmp_path / f"{name}.pairs", place=place)
    (tmp_path / "d.pairs").write_bytes(b"nothing")
    PairWriter(tmp_path / "e.pairs", DESCRIPTION).close()
    found = evaluate_folder(tmp_path)
    assert [each.estimate.name for each in found.runs] == ["b", "c", "a"]
    assert [each.name for each in found.failed] == ["d", "e"]
    assert found.failed[1].reason == "e: no pairs of estimate and groundtruth"
    other = tmp_path / "other"
    other.mkdir()
    with pytest.raises(InputError, match="no live run in"):
        evaluate_folder(other)
    (other / "d.pairs").write_bytes(b"nothing")
    with pytest.raises(InputError, match="is not a pair file"):
        evaluate_folder(other)


def test_a_frozen_alignment_is_that_of_its_states(tmp_path: Path) -> None:
    for aligned_by in (None, 40):
        path = write(tmp_path / f"{aligned_by}.pairs", state_with(aligned_by=aligned_by))
        found = evaluate_pair_file(path, Request(), None).run.evaluation
        assert found.protocol.align_states == aligned_by
        assert found.alignment.states_used == (aligned_by or COUNT)
    found = evaluate_pair_file(path, Request(), "poses").run.evaluation
    assert found.protocol.align_with == "poses"


def test_revised_poses_are_judged_and_the_causal_errors_kept(tmp_path: Path) -> None:
    path = write(tmp_path / "vio.pairs")
    causal = evaluate_pair_file(path, Request(), None).run.evaluation.ate["position_m"]
    assert causal is not None
    truth, _ = trajectories()
    assert truth.quaternions is not None
    write_revised(tmp_path / "vio.revised.npz", truth.stamps, truth.positions, truth.quaternions)
    found = evaluate_pair_file(path, Request(), None).run
    revised = found.evaluation.ate["position_m"]
    assert revised is not None
    assert revised.rmse < 1e-6 < causal.rmse
    assert found.live is not None
    assert found.live["causal_ate"]["position_m"]["rmse"] == causal.rmse
    assert found.live["messages_lost"] == 0
    assert found.estimate.duration_s == (COUNT - 1) * STEP_NS / 1e9


def test_up_axes_are_those_of_the_run_or_as_requested(tmp_path: Path) -> None:
    ups = [{"name": name, "origin": "stated"} for name in ("-y", "z")]
    state = state_with(groundtruth__up=ups[0], estimate__up=ups[1])
    path = write(tmp_path / "vio.pairs", state)
    for up, expected in ((None, ["-y", "z"]), (("x", "-z"), ["x", "-z"])):
        found = evaluate_pair_file(path, Request(up=up), None)
        assert [found.groundtruth.up.name, found.run.estimate.up.name] == expected
    planar = state_with(
        groundtruth__up=ups[0], estimate__up=ups[1], settings={"gauge": "planar", "lengths": "2"}
    )
    path = write(tmp_path / "flat.pairs", planar)
    evaluate_pair_file(path, Request(up=("-y", "z")), None)
    with pytest.raises(SettingsError, match="only the components perpendicular to -y"):
        evaluate_pair_file(path, Request(up=("z", "z")), None)


def test_a_transform_that_was_applied_is_described(tmp_path: Path) -> None:
    for of_marker, names in ((False, ("body", "base_link")), (True, ("marker", "tip"))):
        named = HandEye(POSE.rotation_xyzw, POSE.lever_m, "body", "tip")
        recorded = {**TRANSFORM, "T_body_marker": hand_eye_json(named), "of_marker": of_marker}
        path = write(tmp_path / f"{of_marker}.pairs", state_with(hand_eye=recorded))
        found = evaluate_pair_file(path, Request(), None)
        evaluation = found.run.evaluation
        assert found.run.calibrated is not None
        assert found.run.calibrated.was_live
        assert found.run.calibrated.of_marker == of_marker
        assert found.run.calibrated.wanted.source == "x.yaml"
        sides = evaluation.groundtruth, evaluation.estimate
        assert tuple(each.child_frame for each in sides) == names


def test_another_transform_is_refused() -> None:
    assert AppliedHandEye.in_state({}, "x") is None
    body = AppliedHandEye.in_state({"hand_eye": TRANSFORM}, "x")
    marker = AppliedHandEye.in_state({"hand_eye": {**TRANSFORM, "of_marker": True}}, "x")
    assert body is not None
    assert marker is not None
    assert (body.source, body.of_marker, marker.of_marker) == ("x.yaml", False, True)
    np.testing.assert_allclose(body.hand_eye.lever_m, POSE.lever_m)
    for calibration in (CalibrationRequest(hand_eye=True), CalibrationRequest(known=POSE)):
        with pytest.raises(SettingsError, match=r"has applied hand_eye x\.yaml"):
            body.require_no_other(Request(calibration=calibration), "world")
    offset = Request(calibration=CalibrationRequest(offset=True))
    body.require_no_other(offset, "world")
    message = Request(covariances=CovarianceRequest("message", rotation_frame="body"))
    for applied, request, frame, refused in (
        (marker, message, "world", True),
        (marker, message, "body", False),
        (body, message, "world", False),
        (marker, offset, "world", False),
    ):
        if refused:
            with pytest.raises(SettingsError, match="to be about the world's axes"):
                applied.require_no_other(request, frame)
        else:
            applied.require_no_other(request, frame)
    asked = CovarianceRequest("message", groundtruth_noise=(0.01, 1.0))
    assert marker.judging(asked) is asked
    assert body.judging(asked).marker_lever_m == asked.of_moved_groundtruth(POSE).marker_lever_m
