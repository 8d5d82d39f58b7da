"""The live watch gives what `trajeval watch` gives, by the bytes of a recording as they came."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
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
    watch: LiveWatch,
    messages: Sequence[tuple[str, str, int, bytes]],
    tick_s: Callable[[], float],
    seen: Callable[[WatchReport], object],
) -> None:
    """Hand over messages tick by tick."""
    begin, time = 0, messages[0][2]
    times = [message[2] for message in messages]
    while begin < len(messages):
        time += int(tick_s() * SECOND)
        end = int(np.searchsorted(times, time, side="right"))
        some = messages[begin:end]
        imu = [item[3] for item in some if item[0] == "/imu"]
        others = {source: batch_of(some, topic) for source, topic in PAIRS.items()}
        others["map"] = batch_of(some, "/tf")
        seen(watch.look(WatchedMessages(batch_of(some, "/odom"), others, imu)))
        begin = end


# Without shrinking, which takes minutes.
@pytest.mark.slow
@settings(max_examples=4, deadline=None, phases=(Phase.generate,))
@given(data=st.data())
def test_alarms_of_any_ticks_are_those_of_the_recording(
    runs: list[tuple[Any, Any]], data: st.DataObject
) -> None:
    messages, offline = runs[data.draw(st.integers(0, len(runs) - 1))]
    ticks = data.draw(st.lists(st.sampled_from([0.05, 0.2, 1.0, 7.0]), min_size=1, max_size=5))
    watch = live_watch()
    alarms: dict[int, WatchAlarm] = {}
    begun: list[Remark] = []

    def see(report: WatchReport) -> None:
        begun.extend(report.begun)
        alarms.update({id(alarm): alarm for alarm in watch.book.alarms})

    rotation = iter(range(10**9))
    looks(watch, messages, lambda: ticks[next(rotation) % len(ticks)], see)
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
    assert sorted(item.subject for item in begun) == [item[0] for item in expected]


@pytest.mark.slow
def test_an_alarm_is_told_in_the_tick_of_its_message_with_its_factor(
    runs: list[tuple[Any, Any]],
) -> None:
    messages, offline = runs[0]
    first = min(offline["alarms"], key=lambda alarm: alarm["begin_ns"])
    watch = live_watch()
    tick_ns, now = SECOND // 20, [messages[0][2]]
    told: list[tuple[int, Remark]] = []

    def see(report: WatchReport) -> None:
        now[0] += tick_ns
        told.extend((now[0], item) for item in report.begun)

    looks(watch, messages, lambda: 0.05, see)
    time, remark = told[0]
    assert remark.subject == first["signal"]
    assert 0 <= time - int(remark.values["stamp_ns"]) <= 2 * tick_ns
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
    watch = live_watch()
    reports: list[WatchReport] = []
    looks(watch, messages[: len(messages) // 5], lambda: 1.0, reports.append)
    [remark] = reports[-1].remarks
    assert remark.level == Level.NOTE
    assert remark.text.startswith("arming: 1")
    assert remark.text.endswith("of 30 s of motion")


@pytest.mark.slow
def test_a_source_without_data_is_told_once(tmp_path: Path) -> None:
    messages = recorded(watched_bag(tmp_path, "long", 6, duration_s=100.0))
    alone = [message for message in messages if message[0] != "/imu"]
    watch = live_watch()
    reports: list[WatchReport] = []
    looks(watch, alone, partial(float, 1.0), reports.append)
    told = [item.text for report in reports for item in report.news]
    assert len([item for item in told if "no data of the IMU" in item]) == 1
    assert not any(report.begun for report in reports)
