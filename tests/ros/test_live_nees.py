"""NEES while a run goes on, and of what it leaves: those of the recording."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from consistency_runs import with_growing_covariances
from examined_rigs import rig
from hypothesis import given, settings
from live_runs import ESTIMATE, GROUNDTRUTH, Live
from recorded_runs import pairs_of
from ros_bags import (
    ODOM,
    POSE,
    Message,
    messages_of,
    pose_message,
    write_messages,
)
from ros_processes import assert_same, offline
from state_rows import states, trajectory
from strategies import seeds
from uncertain_runs import MESSAGE, OPTIONS, sides

from trajeval_ros import CovarianceRequest
from trajeval_ros.calibration.groundtruth_quality.examine import examine
from trajeval_ros.consistency.covariance_request import IntegrityRequest
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.io.requests.request_from import protocol_from
from trajeval_ros.io.results.result_json import integrity_json
from trajeval_ros.online.alarms import LIMITED_QUANTITIES, AlarmLimits, MaxSinceLast, alarms
from trajeval_ros.online.error_topics import PROTECTION_LEVELS, integrity_numbers
from trajeval_ros.online.evaluator import OnlineEvaluator
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.ros.diagnostics import about_integrity


def messages(seed: int) -> list[Message]:
    groundtruth, estimate = sides(seed)
    both = [*messages_of(groundtruth, GROUNDTRUTH, POSE), *messages_of(estimate, ESTIMATE, ODOM)]
    return sorted(both, key=lambda item: item[2])


def played(folder: Path, feed: list[Message], batch: int, **words: Any) -> Live:
    live = Live(folder / "live", ODOM, covariances=MESSAGE, **words)
    for begin in range(0, len(feed), batch):
        live.feed(feed[begin : begin + batch])
    live.end()
    return live


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gauge", "states"), [("yaw", "1"), ("yaw", "all"), ("se3", "all"), ("planar", "all")]
)
@settings(max_examples=3)
@given(seed=seeds)
def test_live_nees_is_that_of_the_bag(
    tmp_path_factory: pytest.TempPathFactory, gauge: str, states: str, seed: int
) -> None:
    folder, feed = tmp_path_factory.mktemp("run"), messages(seed)
    write_messages(folder / "bag", feed)
    live = played(folder, feed, 17, gauge=gauge, align_states=states)
    words = ("--gauge", gauge, "--align-states", states, "--lengths", "2,4", *OPTIONS)
    expected = offline(folder / "bag", folder, GROUNDTRUTH, [ESTIMATE], *words)
    assert_same(live.result, expected)
    [run] = expected["runs"]
    snapshot = live.run.estimates[0].snapshot()
    assert snapshot.why_not_consistency == ""
    assert snapshot.nees is not None
    per_pose = run["consistency"]["per_pose"]
    assert snapshot.nees.mean == pytest.approx(per_pose["mean"], rel=1e-9)
    assert snapshot.nees.position.mean == pytest.approx(per_pose["position"]["mean"], rel=1e-9)
    assert snapshot.nees.rotation.mean == pytest.approx(per_pose["rotation"]["mean"], rel=1e-9)


@pytest.mark.slow
def test_live_nees_against_a_repaired_groundtruth_is_that_of_the_bag(tmp_path: Path) -> None:
    made = rig(2, turn_deg=(3.0, -2.0, 1.5))
    fits = examine(made.groundtruth, made.readings).fits
    assert fits is not None
    repaired = fits.repaired
    assert repaired.covariances is not None
    noise = np.random.default_rng(0).normal(0.0, 0.03, (len(repaired[::5]), 3))
    estimate = with_growing_covariances(repaired[::5])
    estimate = dataclasses.replace(estimate, positions=estimate.positions + noise)
    both = [*messages_of(repaired, GROUNDTRUTH, ODOM), *messages_of(estimate, ESTIMATE, ODOM)]
    feed = sorted(both, key=lambda item: item[2])
    write_messages(tmp_path / "bag", feed)
    live = played(tmp_path, feed, 17, groundtruth_kind=ODOM)
    words = ("--gauge", "yaw", "--lengths", "2,4", *OPTIONS)
    expected = offline(tmp_path / "bag", tmp_path, GROUNDTRUTH, [ESTIMATE], *words)
    assert_same(live.result, expected)
    assert expected["runs"][0]["consistency"]["per_pose"]["mean"] > 0.0


def test_live_integrity_is_that_of_the_bag_and_tells_of_hazards(tmp_path: Path) -> None:
    feed = messages(3)
    write_messages(tmp_path / "bag", feed)
    asked = IntegrityRequest(0.05, 5.0, 0.9)
    groundtruth, estimate = sides(3)
    evaluator = OnlineEvaluator(
        OnlineSettings(
            protocol_from("default", gauge="yaw", align_states="1", lengths="none"),
            covariances=MESSAGE,
            integrity=asked,
        )
    )
    evaluator.add_groundtruth(
        trajectory(groundtruth.stamps, states(groundtruth.positions, groundtruth.quaternions))
    )
    rows = states(estimate.positions, estimate.quaternions)
    assert estimate.covariances is not None
    wide = np.hstack([rows, estimate.covariances.reshape(-1, 36)])
    evaluator.add_estimate(trajectory(estimate.stamps, wide))
    evaluator.update(at_end=True)
    snapshot = evaluator.snapshot()
    options = ("--alert-limit", "0.05,5", "--risk", "0.9")
    words = ("--gauge", "yaw", "--align-states", "1", "--lengths", "none", *OPTIONS, *options)
    [run] = offline(tmp_path / "bag", tmp_path, GROUNDTRUTH, [ESTIMATE], *words)["runs"]
    assert snapshot.integrity is not None
    result = integrity_json(snapshot.integrity)
    assert result["risk"] == 0.9
    for live, recorded in zip(result["parts"], run["integrity"]["parts"], strict=True):
        assert live["areas"] == pytest.approx(recorded["areas"], abs=1e-9)
        for name in ("protection_level_median", "error_median", "inflation_999"):
            assert live[name] == pytest.approx(recorded[name], rel=1e-9)
    assert integrity_numbers(snapshot).keys() == set(PROTECTION_LEVELS.values())
    for remark in about_integrity(snapshot):
        values = remark.values
        is_hazard = values["level"] <= values["limit"] < values["value"]  # type: ignore[operator]
        assert remark.level == (Level.ERROR if is_hazard else Level.WARNING)
        assert ("hazardously" in remark.text) == is_hazard
    assert about_integrity(snapshot)


def test_an_alert_limit_without_covariances_is_refused() -> None:
    with pytest.raises(SettingsError, match="needs covariances"):
        OnlineSettings(protocol_from("default"), integrity=IntegrityRequest(0.5))


def test_what_comes_before_the_groundtruth_is_not_forgotten(tmp_path: Path) -> None:
    """NEES is exact in the gauge of the first pose, which must have been paired."""
    late = messages(4)
    begin = late[0][2] + 10**9
    late = [item for item in late if item[0] == ESTIMATE or item[2] >= begin]
    write_messages(tmp_path / "bag", late)
    live = played(tmp_path, late, 9, gauge="yaw", align_states="1")
    words = ("--gauge", "yaw", "--align-states", "1", "--lengths", "2,4", *OPTIONS)
    expected = offline(tmp_path / "bag", tmp_path, GROUNDTRUTH, [ESTIMATE], *words)
    assert expected["runs"][0]["consistency"]["exactness"] == "bound"
    assert_same(live.result, expected)


def test_finish_judges_what_was_kept_though_nobody_asked_live(tmp_path: Path) -> None:
    feed = messages(5)
    write_messages(tmp_path / "bag", feed)
    live = Live(tmp_path / "live", ODOM)
    live.feed(feed)
    live.end()
    assert live.result["runs"][0]["consistency"] is None
    file = tmp_path / "asked.json"
    assert live.finish("--json", str(file), *OPTIONS) == 0
    words = ("--gauge", "yaw", "--lengths", "2,4", *OPTIONS)
    expected = offline(tmp_path / "bag", tmp_path, GROUNDTRUTH, [ESTIMATE], *words)
    assert_same(json.loads(file.read_text()), expected)


@pytest.mark.parametrize(
    ("known", "why"), [((), "has no covariances"), ((0, 1), "some are all zero")]
)
def test_covariances_that_say_nothing_cost_nothing_but_nees(
    tmp_path: Path, known: tuple[int, ...], why: str
) -> None:
    groundtruth, estimate = sides(6)
    assert estimate.covariances is not None
    covariances = estimate.covariances.copy()
    covariances[[row for row in range(len(estimate)) if row % 4 not in known]] = 0.0
    estimate = dataclasses.replace(estimate, covariances=covariances)
    feed = [*messages_of(groundtruth, GROUNDTRUTH, POSE), *messages_of(estimate, ESTIMATE, ODOM)]
    live = played(tmp_path, sorted(feed, key=lambda item: item[2]), 20, gauge="yaw")
    assert why in live.run.estimates[0].snapshot().why_not_consistency
    [run] = live.result["runs"]
    assert run["consistency"] is None
    assert run["ate"]["position_m"]["count"] == run["association"]["pairs"] > 50
    assert any(
        "the consistency test is not possible" in remark["text"] and why in remark["text"]
        for remark in run["remarks"]
    )


def test_a_topic_may_change_to_a_type_with_covariances(tmp_path: Path) -> None:
    """The first half of its poses has none: then no NEES, and all pairs."""
    groundtruth, estimate = sides(7)
    wide = messages_of(estimate, ESTIMATE, ODOM)
    live = Live(tmp_path / "live", ODOM, covariances=MESSAGE)
    stream = live.estimate.stream
    assert estimate.quaternions is not None
    columns = estimate.stamps.tolist(), estimate.positions, estimate.quaternions
    plain = [pose_message(*item) for item in zip(*columns, strict=True)]
    middle = len(plain) // 2
    live.feed(messages_of(groundtruth, GROUNDTRUTH, POSE))
    live.estimate.kind = POSE
    live.feed([(ESTIMATE, POSE, 0, item) for item in plain[:middle]])
    live.estimate.kind = ODOM
    live.feed(wide[middle:])
    live.end()
    assert stream.status.poses == len(estimate)
    recorded = pairs_of(live.folder)
    assert recorded.estimate.covariances is not None
    text = recorded.estimate.covariances.any(axis=(1, 2))
    paired = np.searchsorted(estimate.stamps, recorded.estimate.stamps)
    np.testing.assert_array_equal(text, paired >= middle)


def test_alarms_have_limits_of_nees() -> None:
    evaluator = fed_evaluator()
    snapshot = evaluator.snapshot()
    assert snapshot.nees is not None
    peaks = MaxSinceLast()
    peaks.see_snapshot(snapshot)
    limits = {limited_quantity.name: AlarmLimits() for limited_quantity in LIMITED_QUANTITIES}
    limits["nees"] = AlarmLimits(snapshot.nees.mean / 2)
    [alarm] = alarms(peaks.take(), limits)
    assert (alarm.level, alarm.subject) == (Level.WARNING, "nees")
    expected = f"{snapshot.nees.mean:.4g} is over {limits['nees'].warn:.4g}"
    assert alarm.text == f"mean NEES of the window per degree of freedom {expected}"


def fed_evaluator() -> OnlineEvaluator:
    groundtruth, estimate = sides(9)
    protocol = protocol_from("default", gauge="yaw", lengths="none")
    evaluator = OnlineEvaluator(OnlineSettings(protocol, window="5s", covariances=MESSAGE))
    assert estimate.covariances is not None
    evaluator.add_groundtruth(
        trajectory(groundtruth.stamps, states(groundtruth.positions, groundtruth.quaternions))
    )
    own = states(estimate.positions, estimate.quaternions)
    rows = np.hstack([own, estimate.covariances.reshape(-1, 36)])
    evaluator.add_estimate(trajectory(estimate.stamps, rows))
    evaluator.update(at_end=True)
    return evaluator


def test_a_window_is_judged_as_a_run_of_its_own() -> None:
    evaluator = fed_evaluator()
    snapshot = evaluator.snapshot()
    assert snapshot.nees is not None
    assert snapshot.nees.poses == snapshot.window_pairs < snapshot.pairs


def test_a_joint_covariance_can_t_be_live() -> None:
    with pytest.raises(SettingsError, match="not supported live"):
        OnlineSettings(covariances=a_joint_request())


def a_joint_request() -> CovarianceRequest:
    from trajeval_ros.consistency.joint_covariance import JointCovariance

    joint = object.__new__(JointCovariance)  # which one doesn't matter
    return CovarianceRequest("joint", joint, "joint.npz")
