"""The watchdog on real recordings: faults that are really there, and healthy halves."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from paths import SHARED
from scipy.stats import rankdata

from benchmarks import watch
from benchmarks.watch import NOT_HEALTHY, Healthy, detections, halved, health_of
from benchmarks.watch_motions import MOTIONS, simulated
from benchmarks.watch_streams import streams
from trajeval_ros import Protocol, evaluate, read_trajectory
from trajeval_ros.io.watched_sources import read_watched
from trajeval_ros.watchdog.recording import WatchedRun, watched
from trajeval_ros.watchdog.watch_alarms import AlarmBook

DATA = SHARED / "data"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not DATA.is_dir(), reason="the recordings are not here"),
]


@cache
def runs() -> dict[str, WatchedRun]:
    return streams(DATA)


@cache
def halves() -> tuple[Healthy, ...]:
    names = ("vio_mono/MH_01", "vins_mono/MH_01", "openvins/MH_01", "husky/odom")
    return tuple(halved(name, runs()[name], 1.0) for name in names)


def test_the_wrong_turn_of_v2_03_is_found() -> None:
    seen = watched(runs()["vio_mono/V2_03"])
    begins = {item.signal: item.begin_s for item in AlarmBook().add(seen.signals)}
    assert 73.0 <= begins["gyro_deg_1s"] <= 76.0


def test_healthy_recordings_have_no_alarm() -> None:
    healthy = {name: run for name, run in runs().items() if name not in NOT_HEALTHY}
    assert len(healthy) >= 4
    for name, run in healthy.items():
        result = health_of(watched(run), 1.0)
        assert result.episodes == 0, (name, result)
        assert max(result.largest.values()) < 0.95


@pytest.mark.parametrize("motion", MOTIONS)
def test_healthy_motions_have_no_alarm(motion: str) -> None:
    result = health_of(watched(simulated(motion, 9700, 300.0)), 1.0)
    assert result.episodes == 0, result


def test_the_late_twist_of_the_husky_is_told_and_corrected() -> None:
    seen = watched(runs()["husky/odom"])
    assert any("the twist is 0.50 s later than the pose" in notice for notice in seen.notices)
    assert any("0.100 s behind the IMU's" in notice for notice in seen.notices)
    assert seen.signals["twist_m_5s"].values.max() < 0.1


def test_pairs_tell_where_s_ptam_is_wrong() -> None:
    run = runs()["ros_example/S-PTAM"]
    seen = watched(run)
    truth = read_trajectory(f"{DATA}/bags/ROS_example.bag:/groundtruth")
    result = evaluate(truth, run.estimate, Protocol(gauge="se3", lengths=("5s",)))
    assert result.relative is not None
    errors = result.relative[0].errors
    ends = result.association.estimate.stamps[errors.ends]
    seconds, values = seen.signals["pair_percent_5s"]
    stamps = seen.origin + np.rint(seconds * 1e9).astype(np.int64)
    _, own, other = np.intersect1d(stamps, ends, return_indices=True)
    wrong = errors.position_m[other] > 0.5
    ranks = rankdata(values[own])
    count = np.count_nonzero(wrong)
    area = (ranks[wrong].sum() - count * (count + 1) / 2) / (count * (len(wrong) - count))
    assert count > 5
    assert area >= 0.85


TESTED = (
    *(f"diverging {mps2:g} m/s2" for mps2 in (0.05, 0.2, 1.0)), "yaw 1 deg/s",
    *("twist x 0.8", "twist x 0.95", "twist in world axes"),
    *("freeze", "coasting, rotation alive", "coasting, rotation stopped"),
)  # fmt: skip


def test_the_table_of_faults(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watch, "FAULTS", {fault: watch.FAULTS[fault] for fault in TESTED})
    result = detections(list(halves()), 1.0, onsets=2)

    def share_and_delay(fault: str, label: str) -> tuple[float, float]:
        delays = [np.inf if item is None else item for item in result[fault][label]]
        hits = np.isfinite(delays)
        return float(np.mean(hits)), float(np.median(np.array(delays)[hits]))

    for mps2, most_s in ((0.05, 11.0), (0.2, 4.0), (1, 2.5)):
        share, delay_s = share_and_delay(f"diverging {mps2:g} m/s2", "+ second estimate")
        assert share == 1.0
        assert delay_s <= most_s
    for fault in ("twist x 0.8", "twist x 0.95", "twist in world axes"):
        assert share_and_delay(fault, "+ twist")[0] == 1.0
        assert np.mean([item is not None for item in result[fault]["+ IMU"]]) <= 0.1
    for fault in ("freeze", "coasting, rotation alive", "coasting, rotation stopped"):
        for label in result[fault]:
            share, delay_s = share_and_delay(fault, label)
            assert share >= 0.9
            assert delay_s <= 1.0
    share, delay_s = share_and_delay("yaw 1 deg/s", "+ IMU")
    assert share == 1.0
    assert delay_s <= 6.0


def test_an_injected_relocalisation_is_found_among_corrections_of_amcl() -> None:
    nav2 = f"{DATA}/bags/nav2_turtlebot.mcap"
    run = read_watched(f"{nav2}:/odom", corrections=f"{nav2}:/tf:map.odom")
    assert run.corrections is not None
    healthy = watched(run)
    assert 0.1 < healthy.signals["map_correction_m_1s"].values.max() < 0.2
    stamps = run.corrections.stamps
    onset = int(stamps[0] + 0.8 * (stamps[-1] - stamps[0]))
    positions = run.corrections.positions + np.outer(stamps >= onset, [0.5, 0.3, 0.0])
    moved = dataclasses.replace(run.corrections, positions=positions)
    seen = watched(dataclasses.replace(run, corrections=moved))
    alarms = AlarmBook().add(seen.signals)
    [begin_s] = [alarm.begin_s for alarm in alarms if alarm.signal == "map_correction_m_1s"]
    assert 0.0 <= begin_s - (onset - seen.origin) / 1e9 < 0.5
