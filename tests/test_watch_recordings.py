"""The watchdog on real recordings: faults that are really there, and healthy halves."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import rankdata

from benchmarks.watch import WITH_FAULTS, Healthy, detections, healthy_alarms, learned
from benchmarks.watch_streams import streams
from trajeval_ros import Protocol, evaluate, read_trajectory
from trajeval_ros.io.watched_sources import read_watched
from trajeval_ros.watchdog.alarm_book import AlarmBook
from trajeval_ros.watchdog.limits import WatchLimits
from trajeval_ros.watchdog.recording import WatchedRun, watched

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not DATA.is_dir(), reason="the recordings are not here"),
]


@cache
def runs() -> dict[str, WatchedRun]:
    return streams(DATA)


@cache
def halves() -> tuple[Healthy, ...]:
    return tuple(learned(name, run) for name, run in runs().items() if name not in WITH_FAULTS)


def test_the_wrong_turn_of_v2_03_is_found_with_limits_of_mh_05() -> None:
    healthy, seen = watched(runs()["vio_mono/MH_05"]), watched(runs()["vio_mono/V2_03"])
    book = AlarmBook(WatchLimits.learned(healthy.signals, healthy.hours, {}, ""), 2.0)
    begins = {each.signal for each in book.add(seen.signals) if 73.0 <= each.begin_s <= 76.0}
    assert {"gyro_deg_1s", "gravity_deg_5s"} <= begins


def test_the_late_twist_of_the_husky_is_told_and_corrected() -> None:
    seen = watched(runs()["husky/odom"])
    assert any("the twist is 0.50 s later than the pose" in each for each in seen.notices)
    assert any("0.100 s behind the IMU's" in each for each in seen.notices)
    assert seen.signals["twist_m_1s"].values.max() < 0.08


def test_pairs_tell_where_s_ptam_is_wrong() -> None:
    run = runs()["ros_example/S-PTAM"]
    seen = watched(run)
    truth = read_trajectory(f"{DATA}/bags/ROS_example.bag:/groundtruth")
    found = evaluate(truth, run.estimate, Protocol(gauge="se3", lengths=("1s",)))
    assert found.segments is not None
    errors = found.segments[0].errors
    ends = found.association.estimate.stamps[errors.ends]
    seconds, values = seen.signals["pair_m_1s"]
    stamps = seen.origin + np.rint(seconds * 1e9).astype(np.int64)
    _, own, other = np.intersect1d(stamps, ends, return_indices=True)
    wrong = errors.position_m[other] > 0.3
    ranks = rankdata(values[own])
    count = np.count_nonzero(wrong)
    area = (ranks[wrong].sum() - count * (count + 1) / 2) / (count * (len(wrong) - count))
    assert count > 5
    assert area >= 0.98


def test_healthy_halves_have_few_alarms() -> None:
    found = {
        label: len(alarms) for label, (alarms, _) in healthy_alarms(list(halves()), 2.0).items()
    }
    # The one of poses alone is jump_deg at the landing of MH_01, as are those of the pair.
    assert found["only poses"] <= 1
    assert found["+ twist"] <= 1
    assert found["+ IMU"] == 0
    assert found["+ second estimate"] <= 4


def test_the_table_of_faults() -> None:
    found = detections(list(halves()), 2.0, onsets=2)

    def share_and_delay(fault: str, label: str) -> tuple[float, float]:
        delays = [np.inf if each is None else each for each in found[fault][label]]
        hits = np.isfinite(delays)
        return float(np.mean(hits)), float(np.median(np.array(delays)[hits]))

    for mps2, most_s in ((0.05, 5.4), (0.2, 2.8), (1, 1.7)):
        share, delay_s = share_and_delay(f"diverging {mps2:g} m/s2", "+ second estimate")
        assert share == 1.0
        assert delay_s <= most_s
    for fault in ("twist x 0.8", "twist x 0.95", "twist in world axes"):
        assert share_and_delay(fault, "+ twist")[0] == 1.0
        assert np.mean([each is not None for each in found[fault]["+ IMU"]]) <= 0.1
    for fault in ("freeze", "coasting, rotation alive", "coasting, rotation stopped"):
        for label in found[fault]:
            share, delay_s = share_and_delay(fault, label)
            assert share >= 0.9
            assert delay_s <= 1.0
    share, delay_s = share_and_delay("yaw 1 deg/s", "+ IMU")
    assert share == 1.0
    assert delay_s <= 3.1


def test_an_injected_relocalisation_is_found_among_corrections_of_amcl() -> None:
    nav2 = f"{DATA}/bags/nav2_turtlebot.mcap"
    run, _ = read_watched(f"{nav2}:/odom", corrections=f"{nav2}:/tf:map.odom")
    assert run.corrections is not None
    healthy = watched(run)
    assert 0.1 < healthy.signals["map_correction_m_1s"].values.max() < 0.2
    limits = WatchLimits.learned(healthy.signals, healthy.hours, {}, "")
    stamps = run.corrections.stamps
    onset = int(stamps[0] + 0.8 * (stamps[-1] - stamps[0]))
    positions = run.corrections.positions + np.outer(stamps >= onset, [0.5, 0.3, 0.0])
    moved = dataclasses.replace(run.corrections, positions=positions)
    seen = watched(dataclasses.replace(run, corrections=moved))
    alarms = AlarmBook(limits, 2.0).add(seen.signals)
    assert {each.signal for each in alarms} >= {"map_correction_m_1s"}
    begin_s = min(each.begin_s for each in alarms)
    assert 0.0 <= begin_s - (onset - seen.origin) / 1e9 < 0.5
