"""The live watch gives what `trajeval watch` gives, by the bytes of a recording as they came."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, cycle, repeat
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from watched_flights import SECOND, all_sources, watched_bag

from trajeval_ros.cli.app import main
from trajeval_ros.formatting.remarks import Level, Remark
from trajeval_ros.ros.live_watch import LiveWatch, WatchedMessages, WatchReport
from trajeval_ros.ros.poses import PoseStream
from trajeval_ros.ros.subscriptions import ReceivedMessages
from trajeval_ros.ros.transform_stream import TransformStream
from trajeval_ros.watchdog.watch_alarms import WatchAlarm

PAIRS = {"pair.vio": "/vio", "pair.wheel": "/wheel"}
FAULTS_SEEN = ("jump 0.3 m", "yaw 1 deg/s")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Any, Any]]:
    """Messages of runs with faults, and what `trajeval watch` says of each run."""
    folder = tmp_path_factory.mktemp("runs")
    result = []
    for seed, fault in enumerate(FAULTS_SEEN, start=4):
        bag = watched_bag(folder, str(seed), seed, fault, correction_m=0.4)
        output = folder / f"{seed}.json"
        command = ["watch", *all_sources(bag, "/tf:map.odom")]
        assert main([*command, "--json", str(output), "--quiet"]) == 0
        result.append((recorded(bag), json.loads(output.read_text())))
    return result


def recorded(bag: Path) -> list[tuple[str, str, int, bytes]]:
    """Return topic, type, log time and bytes of all messages, in order of arrival."""
    with Reader(bag) as reader:
        return [
            (connection.topic, connection.msgtype, time, bytes(payload))
            for connection, time, payload in reader.messages()
        ]


def live_watch() -> LiveWatch:
    others = {source: PoseStream(topic) for source, topic in PAIRS.items()}
    others["map"] = TransformStream("/tf", "map", "odom")
    return LiveWatch(1.0, PoseStream("/odom"), others, has_imu=True)


def batch_of(messages: Sequence[tuple[str, str, int, bytes]], topic: str) -> Any:
    some = [message for message in messages if message[0] == topic]
    if not some:
        return []
    times = [item[2] for item in some]
    taken = ReceivedMessages([item[3] for item in some], times)
    return [(some[0][1], taken, np.array(times))]


def looks(
    watch: LiveWatch, messages: Sequence[tuple[str, str, int, bytes]], ticks_s: Iterable[float]
) -> Iterator[tuple[int, WatchReport]]:
    """Hand over messages tick by tick; yield the end of each tick, and what the watch reports."""
    begin, time = 0, messages[0][2]
    times = [message[2] for message in messages]
    for tick_s in ticks_s:
        time += int(tick_s * SECOND)
        end = int(np.searchsorted(times, time, side="right"))
        some = messages[begin:end]
        imu = [item[3] for item in some if item[0] == "/imu"]
        others = {source: batch_of(some, topic) for source, topic in PAIRS.items()}
        others["map"] = batch_of(some, "/tf")
        yield time, watch.look(WatchedMessages(batch_of(some, "/odom"), others, imu))
        begin = end
        if begin == len(messages):
            return


@pytest.mark.slow
@pytest.mark.parametrize(
    ("row", "ticks_s"),
    [(0, chain(repeat(1.0, 45), repeat(0.05))), (1, cycle((0.2, 7.0, 0.05, 1.0)))],
    ids=["one message", "any number"],
)
def test_alarms_are_those_of_the_recording_in_the_tick_of_their_message(
    row: int, ticks_s: Iterable[float], runs: list[tuple[Any, Any]]
) -> None:
    messages, offline = runs[row]
    watch = live_watch()
    alarms: dict[int, WatchAlarm] = {}
    begun: list[tuple[int, int, Remark]] = []
    before = messages[0][2]
    for time, report in looks(watch, messages, ticks_s):
        begun += [(before, time, remark) for remark in report.begun]
        alarms.update({id(alarm): alarm for alarm in watch.book.alarms})
        before = time
    origin = watch.watchdog.origin
    result = sorted(
        (alarm.signal, origin + round(alarm.begin_s * SECOND), alarm.is_over, alarm.peak)
        for alarm in alarms.values()
    )
    expected = sorted(
        (alarm["signal"], alarm["begin_ns"], alarm["is_over"], alarm["peak"])
        for alarm in offline["alarms"]
    )
    assert {"map_correction_m_1s"} <= {item[0] for item in expected}
    assert [item[0] for item in result] == [item[0] for item in expected]
    assert [item[2] for item in result] == [item[2] for item in expected]
    begins, peaks = (np.array([item[column] for item in result]) for column in (1, 3))
    np.testing.assert_allclose(begins, [item[1] for item in expected], rtol=0.0, atol=1)
    np.testing.assert_allclose(peaks, [item[3] for item in expected], rtol=1e-9)
    assert sorted(item.subject for *_, item in begun) == [item[0] for item in expected]
    first = min(offline["alarms"], key=lambda alarm: alarm["begin_ns"])
    before, time, remark = begun[0]
    assert remark.subject == first["signal"]
    assert before - SECOND // 20 <= int(remark.values["stamp_ns"]) <= time
    assert remark.values["limit"] == pytest.approx(first["limit"])
    assert remark.values["factor"] == 1.0
    report = watch.look(WatchedMessages())
    assert {item.subject for item in report.remarks} == {
        alarm["signal"] for alarm in offline["alarms"] if not alarm["is_over"]
    }


def test_before_the_arming_it_says_for_how_long_the_robot_has_moved(
    runs: list[tuple[Any, Any]],
) -> None:
    messages, _ = runs[0]
    *_, (_, report) = looks(live_watch(), messages[: len(messages) // 5], repeat(1.0))
    [remark] = report.remarks
    assert remark.level == Level.NOTE
    assert remark.text.startswith("arming: 1")
    assert remark.text.endswith("of 30 s of motion")


@pytest.mark.slow
def test_a_source_without_data_is_told_once(tmp_path: Path) -> None:
    messages = recorded(watched_bag(tmp_path, "long", 6, duration_s=100.0))
    alone = [message for message in messages if message[0] != "/imu"]
    reports = [report for _, report in looks(live_watch(), alone, repeat(1.0))]
    told = [item.text for report in reports for item in report.news]
    assert len([item for item in told if "no data of the IMU" in item]) == 1
    assert not any(report.begun for report in reports)
