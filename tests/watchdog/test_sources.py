"""The watchdog's sources: map corrections, several second estimates, and those that never come."""

from __future__ import annotations

import dataclasses
import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from watched_flights import SECOND, all_sources, flight, watched_bag

from benchmarks.watch_faults import FAULTS
from trajeval_ros import Trajectory
from trajeval_ros.cli.app import main
from trajeval_ros.geometry import lie
from trajeval_ros.io.watched_sources import read_watched
from trajeval_ros.watchdog.engine import Watchdog
from trajeval_ros.watchdog.recording import WatchedRun, watched
from trajeval_ros.watchdog.signals import joined, source_of
from trajeval_ros.watchdog.watch_alarms import AlarmBook


def test_corrections_are_of_the_robot_not_of_the_map_s_origin() -> None:
    run = flight()
    stamps = run.estimate.stamps[::4]
    late = stamps - stamps[0] >= 50 * SECOND
    turn_deg, moved = 2.0, np.array([0.3, -0.1, 0.0])
    rotations = np.outer(np.where(late, np.radians(turn_deg), 0.0), [0.0, 0.0, 1.0])
    corrections = Trajectory(stamps, late[:, None] * moved, lie.from_rotation_vector(rotations))
    result = watched(WatchedRun(run.estimate, corrections=corrections)).signals
    first = int(np.argmax(late))
    robot = run.estimate.positions[4 * first]
    expected = lie.rotate(lie.from_rotation_vector(rotations[first])[None], robot[None])[0]
    expected_m = np.linalg.norm(expected + moved - robot)
    seconds, values = result["map_correction_m_1s"]
    over = values > 1e-6
    assert values[over][0] == pytest.approx(expected_m, rel=1e-6)
    span = seconds[over]
    assert span[0] == pytest.approx((stamps[first] - run.estimate.stamps[0]) / SECOND)
    assert np.ptp(span) == pytest.approx(1.0, abs=0.25)
    angles = result["map_correction_deg_1s"].values
    np.testing.assert_allclose(angles, np.where(over, turn_deg, 0.0), atol=1e-4)


@pytest.mark.parametrize("stands_s", [0, 700])
@pytest.mark.parametrize("portions", [1, 7])
def test_a_transform_holds_until_the_next_one(portions: int, stands_s: int) -> None:
    """However long the robot stands before it moves."""
    flown = flight().estimate
    assert flown.quaternions is not None
    before = np.arange(flown.stamps[0] - stands_s * SECOND, flown.stamps[0], SECOND // 20)
    at = np.concatenate([np.zeros(len(before), dtype=int), np.arange(len(flown))])
    stamps = np.concatenate([before, flown.stamps])
    watchdog = Watchdog(int(flown.stamps[0]))
    sent = flown.stamps[0] + np.array([5 - stands_s, 52]) * SECOND + 30_000_000
    upright = np.tile([0.0, 0.0, 0.0, 1.0], (2, 1))
    parts = [watchdog.add_source("map", sent, np.array([[0.0, 0, 0], [0, 0.7, 0]]), upright)]
    for rows in np.array_split(np.arange(len(stamps)), portions):
        own = at[rows]
        states = Trajectory(stamps[rows], flown.positions[own], flown.quaternions[own])
        parts.append(watchdog.add_estimate(states))
    result = joined(parts)
    seconds, values = result["map_correction_m_1s"]
    np.testing.assert_allclose(seconds, [52.03])
    np.testing.assert_allclose(values, [0.7])


def test_transforms_that_come_late_are_judged_where_the_robot_was() -> None:
    estimate = flight().estimate
    stamps = estimate.stamps[0] + np.array([5000, 52_010, 52_020, 52_030]) * SECOND // 1000
    rotations = lie.from_rotation_vector(np.outer([0.0, 0.5, 1.0, 1.5], [0.0, 0.0, 1.0]))
    corrections = Trajectory(stamps, np.zeros((4, 3)), rotations)
    expected = watched(WatchedRun(estimate, corrections=corrections)).signals
    watchdog = Watchdog(int(estimate.stamps[0]))
    parts = [watchdog.add_estimate(estimate)]
    for row in range(4):
        one = slice(row, row + 1)
        parts.append(watchdog.add_source("map", stamps[one], np.zeros((1, 3)), rotations[one]))
    name = "map_correction_m_1s"
    values = joined(parts)[name].values
    assert len(values) == 3
    np.testing.assert_allclose(values, expected[name].values, rtol=1e-12)


@pytest.mark.slow
def test_alarms_of_several_pairs_tell_which_estimate_is_wrong() -> None:
    run = flight()
    vio = run.partners["pair"]
    generator = np.random.default_rng(9)
    walk = np.cumsum(generator.normal(0.0, 5e-4, vio.positions.shape), axis=0)
    wheel = dataclasses.replace(vio, positions=vio.positions + walk)
    both = {"pair.vio": vio, "pair.wheel": wheel}
    onset = int(run.estimate.stamps[0]) + 50 * SECOND

    def accused(**changed: object) -> set[str]:
        bad = dataclasses.replace(run, **{"partners": both, **changed})  # type: ignore[arg-type]
        alarms = AlarmBook().add(watched(bad).signals)
        return {source_of(alarm.signal) for alarm in alarms} & both.keys()

    fault = FAULTS["diverging 1 m/s2"]
    assert accused() == set()
    assert accused(estimate=fault(run.estimate, onset, generator)) == both.keys()
    assert accused(partners={**both, "pair.wheel": fault(wheel, onset, generator)}) == {
        "pair.wheel"
    }


@pytest.mark.slow
def test_a_source_that_never_comes_takes_no_memory() -> None:
    """An hour is watched in vain for a second estimate, an IMU and corrections."""
    sizes = []
    watchdog = Watchdog()
    for minute in range(60):
        stamps = minute * 60 * SECOND + np.arange(0, 60 * SECOND, SECOND // 20)
        seconds = stamps / SECOND
        places = np.stack([np.sin(seconds), np.cos(seconds), 0.0 * seconds], axis=1)
        upright = np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps), 1))
        watchdog.add_estimate(Trajectory(stamps, places, upright))
        sizes.append(len(pickle.dumps(watchdog)))
    assert max(sizes[20:]) <= 1.1 * max(sizes[:20])


@pytest.mark.slow
def test_a_wrong_correction_is_an_alarm_of_the_map_alone(tmp_path: Path) -> None:
    output = tmp_path / "watch.json"
    bad = watched_bag(tmp_path, "bad", 4, correction_m=0.4)
    for corrections in ("/map_to_odom", "/tf:map.odom"):
        command = ["watch", *all_sources(bad, corrections), "--json", str(output), "--quiet"]
        assert main([*command, "--fail-on", "alarm"]) == 1
        result = json.loads(output.read_text())
        [alarm] = result["alarms"]
        assert alarm["signal"] == "map_correction_m_1s"
        assert alarm["peak"] == pytest.approx(0.4, abs=0.01)
        assert 0 <= alarm["begin_ns"] - 1_700_000_060 * SECOND < SECOND // 5
        names = {signal["name"] for signal in result["signals"]}
        assert {"pair_deg_5s.vio", "pair_deg_5s.wheel", "map_correction_deg_1s"} <= names


def test_only_an_estimate_with_an_imu_has_covariances(tmp_path: Path) -> None:
    bag = watched_bag(tmp_path, "run", 3, duration_s=20.0, covariance=1e-4 * np.eye(6))
    with_imu = read_watched(f"{bag}:/odom", f"{bag}:/imu", {"pair": f"{bag}:/vio"})
    assert with_imu.estimate.covariances is not None
    assert read_watched(f"{bag}:/odom").estimate.covariances is None
