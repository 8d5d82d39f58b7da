"""A live run whose groundtruth is of a marker: what is applied live is what is applied offline."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_runs import COUNT, ESTIMATE, GROUNDTRUTH, Live, batches
from marker_flights import MOUNTED, of_marker, write_mounting
from recorded_runs import pairs_of
from ros_bags import ODOM, POINT, POSE, Message, messages_of, write_messages
from ros_processes import assert_same, offline
from strategies import make_pair, seeds
from uncertain_marker_runs import uncertain_messages
from uncertain_runs import MESSAGE
from uncertain_runs import OPTIONS as JUDGED

from trajeval_ros import simulate
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.requests.request_from import known_hand_eye
from trajeval_ros.ros import live_runs
from trajeval_ros.ros.marker_body import MarkerBody

OPTIONS = ("--gauge", "yaw", "--lengths", "2,4")


def marker_messages(seed: int, groundtruth_kind: str = POSE) -> list[Message]:
    pair = make_pair(seed, COUNT, smooth=True)
    # Without noise, steps are so even that rounding decides where sub-trajectories end.
    noise = np.random.default_rng(seed).normal(scale=1e-3, size=(len(pair.groundtruth), 3))
    groundtruth = dataclasses.replace(
        pair.groundtruth, positions=pair.groundtruth.positions + noise
    )
    both = [
        *messages_of(of_marker(groundtruth), GROUNDTRUTH, groundtruth_kind),
        *messages_of(pair.estimate, ESTIMATE, ODOM),
    ]
    return sorted(both, key=lambda item: item[2])


@pytest.mark.slow
@pytest.mark.parametrize("groundtruth_kind", [POSE, POINT, ODOM])
@settings(max_examples=3)
@given(seed=seeds, cuts=st.lists(st.integers(0, COUNT), max_size=10), late=st.integers(0, 20))
def test_a_marker_is_applied_as_offline(
    tmp_path_factory: pytest.TempPathFactory,
    groundtruth_kind: str,
    seed: int,
    cuts: list[int],
    late: int,
) -> None:
    folder = tmp_path_factory.mktemp("run")
    feed, file = marker_messages(seed, groundtruth_kind), str(write_mounting(folder))
    write_messages(folder / "bag", feed)
    body = MarkerBody(file, known_hand_eye(file))
    live = Live(folder / "live", ODOM, body=body, groundtruth_kind=groundtruth_kind)
    arriving = sorted(feed, key=lambda item: item[2] - (item[0] == GROUNDTRUTH) * late * 10**8)
    for batch in batches(arriving, cuts):
        live.feed(batch)
    live.end()
    result = live.result
    expected = offline(
        folder / "bag", folder, GROUNDTRUTH, [ESTIMATE], *OPTIONS, "--hand-eye", file
    )
    for run in expected["runs"]:  # live, nobody pairs the marker that is not the body
        run["calibration"]["ate"]["before"] = None
    assert_same(result, expected)
    assert result["runs"][0]["calibration"]["errors_of"] == (
        "marker" if groundtruth_kind == POINT else "body"
    )


def test_another_marker_pose_can_be_applied_after_the_run(tmp_path: Path) -> None:
    file = str(write_mounting(tmp_path))
    live = Live(tmp_path / "live", ODOM, body=MarkerBody(file, known_hand_eye(file)))
    live.feed(marker_messages(4))
    live.end()
    own, result = live.result, tmp_path / "again.json"
    for hand_eye in (file, "none", "auto"):
        assert live.finish("--hand-eye", hand_eye, "--json", str(result)) == 0
        [run], [known] = json.loads(result.read_text())["runs"], own["runs"]
        if hand_eye == "auto":
            assert run["calibration"] != known["calibration"]
        else:
            assert_same(run["ate"], known["ate"])


@pytest.mark.slow
@settings(max_examples=3)
@given(seed=seeds)
def test_covariances_are_judged_as_offline(
    tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    folder = tmp_path_factory.mktemp("run")
    feed, _ = uncertain_messages(seed, POSE)
    file = str(write_mounting(folder))
    write_messages(folder / "bag", feed)
    body = MarkerBody(file, known_hand_eye(file))
    live = Live(folder / "live", ODOM, body=body, covariances=MESSAGE)
    live.feed(feed)
    live.end()
    options = (*OPTIONS, "--hand-eye", file, *JUDGED)
    expected = offline(folder / "bag", folder, GROUNDTRUTH, [ESTIMATE], *options)
    [run] = expected["runs"]
    run["calibration"]["ate"]["before"] = None
    assert_same(live.result, expected)
    snapshot = live.run.estimates[0].snapshot()
    assert snapshot.nees is not None, snapshot.why_not_consistency
    assert snapshot.nees.mean == pytest.approx(run["consistency"]["per_pose"]["mean"], rel=1e-9)


def test_covariances_are_of_the_markers_position(tmp_path: Path) -> None:
    feed, estimate = uncertain_messages(3, POINT)
    file = str(write_mounting(tmp_path))
    body = MarkerBody(file, known_hand_eye(file))
    # Between states there are no covariances.
    live = Live(
        tmp_path / "live",
        ODOM,
        body=body,
        groundtruth_kind=POINT,
        covariances=MESSAGE,
        association="linear",
    )
    live.feed(feed)
    live.end()
    recorded = pairs_of(live.folder)
    rows = estimate.stamps.searchsorted(recorded.estimate.stamps)
    expected = MOUNTED.of_marker(estimate[rows], 1.0)
    assert expected.covariances is not None
    assert recorded.estimate.covariances is not None
    np.testing.assert_allclose(
        recorded.estimate.covariances, expected.covariances, rtol=1e-9, atol=1e-12
    )
    newest = live.run.estimates[0].uncertainty()
    last = MOUNTED.of_marker(estimate[-1:], 1.0)
    assert newest is not None
    assert last.covariances is not None
    np.testing.assert_allclose(newest[1], last.positions[0], rtol=1e-12)
    np.testing.assert_allclose(newest[2], last.covariances[0, :3, :3], rtol=1e-9, atol=1e-12)
    assert "has no orientations" in live.run.estimates[0].snapshot().why_not_consistency


@pytest.mark.slow
@pytest.mark.parametrize("groundtruth_kind", [POSE, POINT])
def test_each_loop_has_the_marker_of_the_first(tmp_path: Path, groundtruth_kind: str) -> None:
    file = str(write_mounting(tmp_path))
    loops = [marker_messages(seed, groundtruth_kind) for seed in (5, 6)]
    body = MarkerBody(file, known_hand_eye(file))
    live = Live(tmp_path / "live", ODOM, body=body, groundtruth_kind=groundtruth_kind)
    for message in (item for loop in loops for item in loop):
        live.feed([message])
    live.end()
    for number, (result, loop) in enumerate(zip(live.results, loops, strict=True)):
        [run], folder = result["runs"], tmp_path / str(number)
        folder.mkdir()
        write_messages(folder / "bag", loop)
        options = (*OPTIONS, "--hand-eye", file)
        [expected] = offline(folder / "bag", folder, GROUNDTRUTH, [ESTIMATE], *options)["runs"]
        expected["calibration"]["ate"]["before"] = None
        assert_same(run, expected)


@pytest.mark.slow
def test_a_restart_keeps_the_marker(tmp_path: Path) -> None:
    """States that wait for the next run are moved already, and not again."""
    file = str(write_mounting(tmp_path))
    pair = make_pair(7, COUNT, smooth=True)
    positions = pair.estimate.positions.copy()
    positions[COUNT // 4 :] += [30.0, -20.0, 10.0]
    estimate = dataclasses.replace(pair.estimate, positions=positions)

    def ates(groundtruth: Trajectory, name: str, body: MarkerBody | None) -> list[float]:
        both = [
            *messages_of(groundtruth, GROUNDTRUTH, POSE),
            *messages_of(estimate, ESTIMATE, ODOM),
        ]
        feed = sorted(both, key=lambda item: item[2])
        live = Live(tmp_path / name, ODOM, body=body, at_restarts=True)
        for batch in batches(feed, range(0, len(feed), 13)):
            live.feed(batch)
        live.end()
        return [result["runs"][0]["ate"]["position_m"]["rmse"] for result in live.results]

    of_body = ates(pair.groundtruth, "body", None)
    moved = ates(of_marker(pair.groundtruth), "marker", MarkerBody(file, known_hand_eye(file)))
    assert len(of_body) == 2
    # The groundtruth is interpolated as the marker's here, and as the body's there.
    assert moved == pytest.approx(of_body, rel=1e-6)


@pytest.mark.slow
def test_groundtruth_that_serves_two_runs_is_moved_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_runs, "FOLLOWS_WITHIN_S", 0.0)
    file = str(write_mounting(tmp_path))
    pair = make_pair(51, COUNT, smooth=True)
    stamps = pair.estimate.stamps.copy()
    stamps[COUNT // 4 :] -= 2 * 10**9  # the estimate's clock is set back
    sent = messages_of(dataclasses.replace(pair.estimate, stamps=stamps), ESTIMATE, ODOM)
    times = pair.estimate.stamps.tolist()
    arriving = [(*item[:2], at, item[3]) for item, at in zip(sent, times, strict=True)]
    groundtruth = messages_of(of_marker(pair.groundtruth), GROUNDTRUTH, POSE)
    live = Live(tmp_path / "live", ODOM, body=MarkerBody(file, known_hand_eye(file)))
    for message in sorted([*groundtruth, *arriving], key=lambda item: item[2]):
        live.feed([message])
    live.end()
    recorded = pairs_of(live.folders[1])
    rows = pair.groundtruth.stamps.searchsorted(recorded.estimate.stamps)
    rows = rows.clip(1, len(pair.groundtruth) - 1)
    around = pair.groundtruth.positions[[rows - 1, rows]]
    reach = np.linalg.norm(around[1] - around[0], axis=1)
    apart = np.linalg.norm(around - recorded.groundtruth.positions, axis=2).min(axis=0)
    assert len(recorded.estimate.stamps) > 0.9 * (len(stamps) - COUNT // 4)
    assert (apart <= reach + 1e-9).all()


@pytest.mark.slow
def test_a_lever_arm_waits_for_the_scale(tmp_path: Path) -> None:
    file = str(write_mounting(tmp_path))
    body = MarkerBody(file, known_hand_eye(file))
    live = Live(tmp_path / "live", ODOM, body=body, groundtruth_kind=POINT, gauge="sim3")
    live.feed(marker_messages(1, POINT))
    live.end()
    [run] = live.result["runs"]
    assert run["calibration"] is None
    [told] = [remark["text"] for remark in run["remarks"] if "not applied" in remark["text"]]
    assert "trajeval finish FOLDER --hand-eye FILE" in told
    assert live.finish("--hand-eye", file) == 0


@pytest.mark.slow
def test_auto_estimates_the_marker_first_and_applies_it_to_all(tmp_path: Path) -> None:
    flight = simulate(seed=4, duration_s=70.0)
    feed = sorted(
        [
            *messages_of(of_marker(flight.groundtruth), GROUNDTRUTH, POSE),
            *messages_of(flight.estimate, ESTIMATE, ODOM),
        ],
        key=lambda message: message[2],
    )
    live = Live(tmp_path / "live", ODOM, body=MarkerBody("auto"))
    for batch in batches(feed, range(0, len(feed), 200)):
        live.feed(batch)
        if live.run.holds:
            assert "hand_eye auto" in live.run.start.waits_for
            assert live.run.estimates[0].evaluator.pairs == 0
    live.end()
    [run] = live.result["runs"]
    applied = live.run.body.hand_eye
    assert applied is not None
    apart = lie.multiply(lie.conjugate(applied.rotation_xyzw), MOUNTED.rotation_xyzw)
    assert np.degrees(lie.angle(apart)) < 1.0
    assert run["association"]["pairs"] > 0.95 * len(flight.estimate)  # the held ones included
    assert run["ate"]["rotation_deg"]["rmse"] < 3.0
    [told] = [
        remark["text"] for remark in run["remarks"] if "marker pose: rotation 9" in remark["text"]
    ]
    assert ("no lever arm (" in told) == (not applied.lever_m.any())


@pytest.mark.slow
def test_a_loop_of_less_than_a_minute_tells_the_marker_of_all_loops(tmp_path: Path) -> None:
    flight = simulate(seed=4, duration_s=50.0)
    both = [
        *messages_of(of_marker(flight.groundtruth), GROUNDTRUTH, POSE),
        *messages_of(flight.estimate, ESTIMATE, ODOM),
    ]
    loop = sorted(both, key=lambda item: item[2])
    live = Live(tmp_path / "live", ODOM, body=MarkerBody("auto"))
    for batch in batches([*loop, *loop], range(0, 2 * len(loop), 200)):
        live.feed(batch)
    live.end()
    assert live.run.body.hand_eye is not None, live.run.body.why_not
    runs = [result["runs"][0] for result in live.results]
    assert [run["association"]["pairs"] for run in runs] == [runs[0]["association"]["pairs"]] * 2
    assert all(run["ate"]["rotation_deg"]["rmse"] < 3.0 for run in runs)


def test_a_marker_that_nobody_can_see_is_told(tmp_path: Path) -> None:
    pair = make_pair(2, COUNT, smooth=True)  # too short to calibrate
    feed = [
        *messages_of(of_marker(pair.groundtruth), GROUNDTRUTH, POSE),
        *messages_of(pair.estimate, ESTIMATE, ODOM),
    ]
    live = Live(tmp_path / "live", ODOM, body=MarkerBody("auto"))
    live.feed(feed)
    live.end()
    [run] = live.result["runs"]
    assert run["calibration"] is None
    assert any("hand_eye auto not applied: " in remark["text"] for remark in run["remarks"])
    assert np.isfinite(run["ate"]["position_m"]["rmse"])
