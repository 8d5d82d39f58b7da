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
from watched_flights import SECOND, all_sources, learned_limits, watched_bag

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.write_clip import ClipTopic, write_clip
from trajeval_ros.io.requests.limits_file import read_limits
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.online.notices import ERROR, OK, Notice
from trajeval_ros.ros.live_watch import LiveWatch, WatchedMessages, WatchReport
from trajeval_ros.ros.poses import PoseStream
from trajeval_ros.ros.subscriptions import ReceivedMessages
from trajeval_ros.ros.transform_stream import TransformStream
from trajeval_ros.watchdog.alarm_book import WatchAlarm
from trajeval_ros.watchdog.limits import WatchLimits
from trajeval_ros.watchdog.signals import source_of

PAIRS = {"pair.vio": "/vio", "pair.wheel": "/wheel"}
FAULTS_SEEN = ("jump 0.3 m", "yaw 1 deg/s")


@pytest.fixture(scope="module")
def limits(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return learned_limits(tmp_path_factory.mktemp("good"))


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory, limits: Path) -> list[tuple[Any, Any]]:
    """Messages of runs with faults, and what `trajeval watch` says of each run."""
    folder = tmp_path_factory.mktemp("runs")
    found = []
    for seed, fault in enumerate(FAULTS_SEEN, start=4):
        bag = watched_bag(folder, str(seed), seed, fault, correction_m=0.4)
        output = folder / f"{seed}.json"
        command = ["watch", *all_sources(bag, "/tf:map.odom"), "--limits", str(limits)]
        assert main([*command, "--json", str(output), "--quiet"]) == 0
        found.append((recorded(bag), json.loads(output.read_text())))
    return found


def recorded(bag: Path) -> list[tuple[str, str, int, bytes]]:
    """Return topic, type, log time and bytes of all messages, in order of arrival."""
    with Reader(bag) as reader:
        return [
            (connection.topic, connection.msgtype, time, bytes(payload))
            for connection, time, payload in reader.messages()
        ]


def live_watch(limits: WatchLimits, *, has_imu: bool = True) -> LiveWatch:
    others = {source: PoseStream(topic) for source, topic in PAIRS.items()}
    others["map"] = TransformStream("/tf", "map", "odom")
    return LiveWatch(limits, 2.0, PoseStream("/odom"), others, has_imu=has_imu)


def batch_of(messages: Sequence[tuple[str, str, int, bytes]], topic: str) -> Any:
    some = [each for each in messages if each[0] == topic]
    if not some:
        return []
    times = [each[2] for each in some]
    taken = ReceivedMessages([each[3] for each in some], times)
    return [(some[0][1], taken, np.array(times))]


def looks(
    watch: LiveWatch,
    messages: Sequence[tuple[str, str, int, bytes]],
    tick_s: Callable[[], float],
    seen: Callable[[WatchReport], object],
) -> None:
    """Hand over messages tick by tick."""
    begin, time = 0, messages[0][2]
    times = [each[2] for each in messages]
    while begin < len(messages):
        time += int(tick_s() * SECOND)
        end = int(np.searchsorted(times, time, side="right"))
        some = messages[begin:end]
        imu = [each[3] for each in some if each[0] == "/imu"]
        others = {source: batch_of(some, topic) for source, topic in PAIRS.items()}
        others["map"] = batch_of(some, "/tf")
        seen(watch.look(WatchedMessages(batch_of(some, "/odom"), others, imu)))
        begin = end


# Without shrinking, which takes minutes.
@pytest.mark.slow
@settings(max_examples=4, deadline=None, phases=(Phase.generate,))
@given(data=st.data())
def test_alarms_of_any_ticks_are_those_of_the_recording(
    runs: list[tuple[Any, Any]], limits: Path, data: st.DataObject
) -> None:
    messages, offline = runs[data.draw(st.integers(0, len(runs) - 1))]
    ticks = data.draw(st.lists(st.sampled_from([0.05, 0.2, 1.0, 7.0]), min_size=1, max_size=5))
    watch = live_watch(read_limits(limits))
    alarms: dict[int, WatchAlarm] = {}
    begun: list[Notice] = []

    def see(report: WatchReport) -> None:
        begun.extend(report.begun)
        alarms.update({id(each): each for each in watch.book.alarms})

    turn = iter(range(10**9))
    looks(watch, messages, lambda: ticks[next(turn) % len(ticks)], see)
    origin = watch.watchdog.origin
    found = sorted(
        (each.signal, origin + round(each.begin_s * SECOND), each.is_over, each.peak)
        for each in alarms.values()
    )
    expected = sorted(
        (each["signal"], each["begin_ns"], each["is_over"], each["peak"])
        for each in offline["alarms"]
    )
    assert {"map_correction_m_1s", "map_correction_m_20s"} <= {each[0] for each in expected}
    assert [each[0] for each in found] == [each[0] for each in expected]
    assert [each[2] for each in found] == [each[2] for each in expected]
    begins, peaks = (np.array([each[column] for each in found]) for column in (1, 3))
    np.testing.assert_allclose(begins, [each[1] for each in expected], rtol=0.0, atol=1)
    np.testing.assert_allclose(peaks, [each[3] for each in expected], rtol=1e-9)
    assert sorted(each.subject for each in begun) == [each[0] for each in expected]


@pytest.mark.slow
def test_an_alarm_is_told_in_the_tick_of_its_message_with_its_evidence(
    runs: list[tuple[Any, Any]], limits: Path
) -> None:
    messages, offline = runs[0]
    first = min(offline["alarms"], key=lambda each: each["begin_ns"])
    watch = live_watch(read_limits(limits))
    tick_ns, now = SECOND // 20, [messages[0][2]]
    told: list[tuple[int, Notice]] = []

    def see(report: WatchReport) -> None:
        now[0] += tick_ns
        told.extend((now[0], each) for each in report.begun)

    looks(watch, messages, lambda: 0.05, see)
    time, notice = told[0]
    assert notice.subject == first["signal"]
    assert 0 <= time - int(notice.values["stamp_ns"]) <= 2 * tick_ns
    assert notice.values["limit"] == pytest.approx(first["limit"])
    assert "(95 %, 3/hours)" in str(notice.values["evidence"])
    report = watch.look(WatchedMessages())
    assert {each.subject for each in report.notices} == {
        each["signal"] for each in offline["alarms"] if not each["is_over"]
    }


def test_before_the_arming_it_says_for_how_long_the_robot_has_moved(
    runs: list[tuple[Any, Any]], limits: Path
) -> None:
    messages, _ = runs[0]
    watch = live_watch(read_limits(limits))
    reports: list[WatchReport] = []
    looks(watch, messages[: len(messages) // 5], lambda: 1.0, reports.append)
    [notice] = reports[-1].notices
    assert notice.level == OK
    assert notice.text.startswith("arming: 1")
    assert notice.text.endswith("of 30 s of motion")


def test_limits_without_a_source_that_is_there_are_refused_at_once(limits: Path) -> None:
    known = read_limits(limits)
    healthy = {name: each for name, each in known.healthy.items() if source_of(name) != "imu"}
    alone = WatchLimits(healthy, known.hours)
    with pytest.raises(InputError, match="learned without the IMU"):
        live_watch(alone)
    live_watch(alone, has_imu=False)


@pytest.mark.slow
def test_limits_of_another_robot_are_refused_with_the_reason(tmp_path: Path, limits: Path) -> None:
    known = read_limits(limits)
    scaled = {
        name: type(each)(30.0 * each.largest, 30.0 * each.typical)
        for name, each in known.healthy.items()
    }
    messages = recorded(watched_bag(tmp_path, "long", 6, duration_s=100.0))
    watch = live_watch(WatchLimits(scaled, known.hours))
    reports: list[WatchReport] = []
    looks(watch, messages, partial(float, 1.0), reports.append)
    [notice] = reports[-1].notices
    assert notice.level == ERROR
    assert "the limits are probably of another robot or estimator" in notice.text
    healthy = live_watch(known)
    looks(healthy, messages, partial(float, 1.0), reports.append)
    assert not reports[-1].notices
    assert not reports[-1].begun


@pytest.mark.slow
def test_a_clip_shows_what_the_watch_saw(
    runs: list[tuple[Any, Any]],
    limits: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    messages, offline = runs[0]
    watch = live_watch(read_limits(limits))
    reports: list[WatchReport] = []
    looks(watch, messages, partial(float, 0.5), reports.append)
    causes = [each for report in reports for each in report.begun]
    about = {
        "causes": [{"subject": each.subject, **each.values} for each in causes],
        "signals": {"estimate": "/odom", **reports[-1].history},
    }
    _, kind, times, payloads = zip(*(each for each in messages if each[0] == "/odom"), strict=True)
    clip = tmp_path / "clip"
    write_clip(clip, [ClipTopic("/odom", kind[0], times, payloads)], about)
    output, picture = tmp_path / "watch.json", tmp_path / "clip.rrd"
    command = ["watch", str(clip), "--json", str(output)]
    assert main([*command, "--fail-on", "alarm"]) == 1
    assert "(95 %, 3/hours)" in capsys.readouterr().out
    found = json.loads(output.read_text())
    assert found["evidence"] == offline["evidence"]
    expected = {each["signal"]: each for each in offline["alarms"]}
    assert {each["signal"] for each in found["alarms"]} == expected.keys()
    for each in found["alarms"]:
        alarm = expected[each["signal"]]
        assert each["begin_ns"] == pytest.approx(alarm["begin_ns"], abs=1)
        assert each["peak"] == pytest.approx(alarm["peak"])
        assert each["limit"] == pytest.approx(alarm["limit"])
    assert main([*command, "--limits", str(limits)]) == 2
    assert "is a clip of the black box" in capsys.readouterr().err
    pytest.importorskip("rerun", reason="rerun-sdk is missing, the extra `rerun`")
    from rrd import Rrd

    assert main([*command, "--rrd", str(picture), "--quiet"]) == 0
    drawn = Rrd(picture)
    assert {"watch/pair/pair_m_1s.vio", "watch/map/map_correction_m_1s"} <= drawn.entities
    ends, _ = drawn.strips("world/watched/path")
    assert ends[-1] == read_trajectory(f"{clip}/clip.mcap:/odom").stamps[-1]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "is damaged"),
        ('{"schema": "trajeval-clip/9"}', "has schema trajeval-clip/9"),
        ('{"schema": "trajeval-clip/1", "signals": {}}', "its cause is a limit of the evaluation"),
        ('{"schema": "trajeval-clip/1", "signals": {"second_0_ns": 1}}', "is damaged"),
    ],
)
def test_a_folder_that_is_no_clip_of_a_watch(
    text: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "clip.json").write_text(text)
    assert main(["watch", str(tmp_path)]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert told.count("\n") == 1
