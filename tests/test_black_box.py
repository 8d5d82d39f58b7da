"""The black box: what is kept, what becomes a clip, and what a kill, a full disk and floods do."""

from __future__ import annotations

import errno
import json
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ros_bags import ODOM, POSE, messages_of
from waiting import until

from trajeval_ros import simulate
from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.io.bags import write_clip as clips
from trajeval_ros.io.bags.definition_texts import definition_text
from trajeval_ros.io.bags.write_clip import ClipTopic, write_clip
from trajeval_ros.io.live.clip_folder import ClipFolder
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.online.notices import WARN, Notice
from trajeval_ros.ros.black_box import BlackBoxSettings, ClipWriter
from trajeval_ros.ros.message_ring import MessageRing
from trajeval_ros.ros.parameter_table import PARAMETERS
from trajeval_ros.ros.subscriptions import ReceivedMessages

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
CAUSE = Notice("alarm", WARN, "pair_m_1s 1 m is over 0.1 m", "pair_m_1s", {"value": 1.0})


def settings(folder: Path, **changed: float) -> BlackBoxSettings:
    values = {
        "before_s": 3.0, "after_s": 1.0, "memory": 10_000_000, "disk": 10_000_000,
        "pause_s": 10.0, **changed,
    }  # fmt: skip
    return BlackBoxSettings(folder=folder, topics=(), **values)  # type: ignore[arg-type]


class Clock:
    def __init__(self) -> None:
        self.now_ns = START

    def __call__(self) -> int:
        return self.now_ns


def feed(writer: ClipWriter, clock: Clock, ticks: int) -> None:
    """Let ticks of 0.1 s pass, in each of which a pose arrives."""
    for _ in range(ticks):
        clock.now_ns += SECOND // 10
        [(_, _, _, payload)] = messages_of(FLIGHT[:1], "/vio", POSE)
        taken = ReceivedMessages([payload], [clock.now_ns])
        writer.ring.add("/vio", POSE, taken, is_latched=False)
        writer.renew()


FLIGHT = simulate(1, 20.0).estimate


def about_of(folder: Path) -> list[dict[str, object]]:
    return [json.loads(each.read_text()) for each in sorted(folder.glob("*/clip.json"))]


@given(
    st.lists(st.tuples(st.integers(0, 3), st.integers(1, 6), st.integers(0, 400)), max_size=60),
    st.integers(500, 20_000),
)
def test_a_ring_holds_the_newest_within_its_bounds(
    batches: list[tuple[int, int, int]], most: int
) -> None:
    ring = MessageRing(2.0, most)
    now, fed = START, []
    for topic, count, size in batches:
        now += SECOND // 10
        times = [now + place for place in range(count)]
        payloads = [bytes([place]) * size for place in range(count)]
        ring.add(f"/{topic}", POSE, ReceivedMessages(payloads, times), is_latched=topic == 0)
        ring.forget(now)
        fed += [(f"/{topic}", *each) for each in zip(times, payloads, strict=True)]
    latched = sum(len(each[2]) + 200 for each in fed if each[0] == "/0")
    assert ring.size <= most + latched
    found = ring.between(START, now + SECOND)
    kept = {
        (each.name, *row) for each in found for row in zip(each.times, each.payloads, strict=True)
    }
    assert kept <= set(fed)
    # What is kept of a topic is its newest part, without a hole.
    for each in found:
        own = [row for row in fed if row[0] == each.name]
        assert [row[1] for row in own[-len(each.times) :]] == list(each.times)
    if not ring.forgotten:
        young = [row for row in fed if row[1] >= now - 2 * SECOND]
        assert set(young) <= kept


def test_latched_messages_stay_and_stand_in_the_clip_however_old() -> None:
    ring = MessageRing(1.0, 10_000)
    ring.add("/tf_static", POSE, ReceivedMessages([b"static"], [START]), is_latched=True)
    ring.add("/vio", POSE, ReceivedMessages([b"old"], [START]), is_latched=False)
    ring.forget(START + 10 * SECOND)
    [topic] = ring.between(START + 9 * SECOND, START + 11 * SECOND)
    assert (topic.name, list(topic.payloads), topic.is_latched) == (
        "/tf_static",
        [b"static"],
        True,
    )


def clip(path: Path, also: Sequence[ClipTopic] = ()) -> None:
    flown = simulate(2, 20.0)
    topics = []
    for name, kind, source in (
        ("/truth", POSE, flown.groundtruth),
        ("/vio/odometry", ODOM, flown.estimate),
    ):
        _, _, times, payloads = zip(*messages_of(source, name, kind), strict=True)
        topics.append(ClipTopic(name, kind, times, payloads))
    write_clip(path, [*topics, *also], {"causes": []})


def test_info_and_evaluate_read_a_clip(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clip(tmp_path / "one")
    file = tmp_path / "one" / "clip.mcap"
    assert main(["info", str(file)]) == 0
    assert "/vio/odometry" in capsys.readouterr().out
    output = tmp_path / "result.json"
    sources = ["-g", f"{file}:/truth", "-e", f"{file}:/vio/odometry"]
    assert main(["evaluate", *sources, "--json", str(output), "--quiet"]) == 0
    assert json.loads(output.read_text())["runs"][0]["association"]["pairs"] > 100
    np.testing.assert_array_equal(
        read_trajectory(f"{file}:/truth").stamps, simulate(2, 20.0).groundtruth.stamps
    )
    about = json.loads((tmp_path / "one" / "clip.json").read_text())
    assert about["topics"]["/truth"]["type"] == POSE
    assert about["left_out"] == []


def test_a_type_that_nobody_defines_is_left_out_and_named(tmp_path: Path) -> None:
    unknown = ClipTopic("/radar", "radar_msgs/msg/Echo", [1], [b"\0"])
    clip(tmp_path / "one", [unknown])
    about = json.loads((tmp_path / "one" / "clip.json").read_text())
    assert about["left_out"] == [
        "/radar dropped: no installed package defines radar_msgs/msg/Echo"
    ]
    assert "/radar" not in about["topics"]


def test_a_type_is_defined_by_its_installed_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, text in (
        ("Echo", "std_msgs/Header header\nrange_msgs/Bin[] bins\n"),
        ("Lost", "range_msgs/Nowhere place\n"),
    ):
        path = tmp_path / "share" / "echo_msgs" / "msg" / f"{name}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    other = tmp_path / "other" / "share" / "range_msgs" / "msg" / "Bin.msg"
    other.parent.mkdir(parents=True)
    other.write_text("uint8 NEAR=1\nfloat32[2] limits\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path}:{tmp_path / 'other'}")
    text = definition_text("echo_msgs/msg/Echo") or ""
    assert "MSG: range_msgs/Bin" in text
    assert "float32[2] limits" in text
    assert "MSG: std_msgs/Header" in text
    assert definition_text("echo_msgs/msg/Lost") is None


def test_an_alarm_becomes_a_clip_of_what_was_before_and_after_it(tmp_path: Path) -> None:
    clock = Clock()
    writer = ClipWriter(settings(tmp_path), clock)
    feed(writer, clock, 60)
    alarm_ns = clock.now_ns
    seen = {"a": 1}
    writer.trigger(CAUSE, lambda: {"signals": dict(seen), "parameters": {"b": 2}})
    seen["a"] = 3  # what comes until the clip ends stands in it
    feed(writer, clock, 9)
    assert not list(tmp_path.glob("2*"))
    feed(writer, clock, 2)
    writer.renew(at_end=True)
    [about] = about_of(tmp_path)
    assert about["causes"] == [
        {"kind": "alarm", "level": WARN, "subject": "pair_m_1s", "text": CAUSE.text, "value": 1.0}
    ]
    assert (about["alarm_ns"], about["signals"], about["parameters"]) == (
        alarm_ns, {"a": 3}, {"b": 2},
    )  # fmt: skip
    topics = about["topics"]
    assert isinstance(topics, dict)
    vio = topics["/vio"]
    assert vio["messages"] == 41
    assert vio["first_ns"] == alarm_ns - 3 * SECOND
    assert vio["last_ns"] == alarm_ns + SECOND
    [(said, warn)] = writer.news
    assert not warn
    assert "clip of pair_m_1s is in" in said


def test_a_flood_of_alarms_makes_one_clip_and_is_counted(tmp_path: Path) -> None:
    clock = Clock()
    writer = ClipWriter(settings(tmp_path), clock)
    feed(writer, clock, 5)
    for _ in range(5):  # the clip waits for its last second: they join it
        writer.trigger(CAUSE, dict)
    feed(writer, clock, 12)
    for _ in range(100):  # sooner than the pause
        writer.trigger(CAUSE, dict)
    feed(writer, clock, 100)
    writer.trigger(CAUSE, dict)
    writer.renew(at_end=True)
    first, second = about_of(tmp_path)
    assert len(list(first["causes"])) == 5  # type: ignore[call-overload]
    assert (first["alarms_without_clip_before"], second["alarms_without_clip_before"]) == (0, 100)


def test_the_oldest_clips_go_when_the_folder_is_full(tmp_path: Path) -> None:
    clock = Clock()
    kept = tmp_path / "notes"
    kept.mkdir()
    writer = ClipWriter(settings(tmp_path, pause_s=0.0, disk=8_000), clock)
    for _ in range(6):
        feed(writer, clock, 20)
        writer.trigger(CAUSE, dict)
        feed(writer, clock, 11)
        writer.renew(at_end=True)
    clips_left = sorted(tmp_path.glob("2*"))
    sizes = [sum(file.stat().st_size for file in each.iterdir()) for each in clips_left]
    assert 1 <= len(clips_left) < 6
    assert sum(sizes) <= 8_000
    assert clips_left[-1].name.startswith("20231114T2213")
    assert any("the oldest went" in said for said, _ in writer.news)
    assert kept.is_dir()


def test_a_full_disk_is_one_sentence_and_the_next_clip_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock()
    writer = ClipWriter(settings(tmp_path, pause_s=0.0), clock)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(clips, "_write_messages", full)
        feed(writer, clock, 5)
        writer.trigger(CAUSE, dict)
        feed(writer, clock, 11)
        writer.renew(at_end=True)
    [(said, warn)] = writer.news
    assert warn
    assert said.endswith("can't be written: no space left on device")
    assert list(tmp_path.iterdir()) == []
    writer.trigger(CAUSE, dict)
    writer.renew(at_end=True)
    assert len(about_of(tmp_path)) == 1


WRITES = """
import sys
from pathlib import Path
from trajeval_ros.io.bags.write_clip import ClipTopic, write_clip
folder = Path(sys.argv[1])
payload = bytes(range(256)) * 400
topic = ClipTopic("/image", "sensor_msgs/msg/Image", range(400), [payload] * 400)
print("begins", flush=True)
number = 0
while True:
    number += 1
    write_clip(folder / f"20260101T000000.{number % 1000:03d}Z_kill", [topic], {})
"""


@pytest.mark.slow
def test_a_kill_while_writing_leaves_whole_clips_and_the_next_start_removes_the_rest(
    tmp_path: Path,
) -> None:
    left_over = 0
    generator = np.random.default_rng(0)
    for place in range(8):
        folder = tmp_path / str(place)
        folder.mkdir()
        with subprocess.Popen(
            [sys.executable, "-c", WRITES, str(folder)], stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            assert process.stdout.readline().strip() == "begins"
            until(lambda: list(folder.iterdir()), "it writes")  # noqa: B023
            time.sleep(generator.uniform(0.0, 0.3))
            process.send_signal(signal.SIGKILL)
        left_over += any(each.name.startswith(".") for each in folder.iterdir())
        ClipFolder(folder, 10**6, 10**12)
        for each in folder.iterdir():
            assert each.name.startswith("2026")
            assert sorted(file.name for file in each.iterdir()) == ["clip.json", "clip.mcap"]
            assert (
                json.loads((each / "clip.json").read_text())["topics"]["/image"]["messages"] == 400
            )
            assert main(["info", str(each / "clip.mcap")]) == 0
    assert left_over


DEFAULTS = {each.name: each.default for each in PARAMETERS} | {
    "groundtruth_topic": "/truth", "estimate_topics": ["/vio"], "black_box_topics": [],
}  # fmt: skip


@pytest.mark.parametrize("text", ["30", "30s", "0s+0s", "a+b", "30s-10s"])
def test_a_span_that_means_nothing_is_refused(text: str) -> None:
    with pytest.raises(SettingsError, match=r"as in 30s\+10s"):
        BlackBoxSettings.of({**DEFAULTS, "black_box": text})


def test_without_topics_it_keeps_those_that_the_node_listens_to() -> None:
    values = {**DEFAULTS, "black_box": "30s+10s", "imu_topic": "/imu"}
    found = BlackBoxSettings.of({**values, "groundtruth_topic": "/tf:map.base"})
    assert found is not None
    assert set(found.topics) == {"/vio", "/imu", "/tf", "/tf_static"}
    assert BlackBoxSettings.of({**values, "black_box": ""}) is None


def test_a_folder_that_cannot_be_made_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="can't be written: not a directory"):
        ClipWriter(settings(tmp_path / "file" / "clips"))


def test_a_missing_library_is_told_at_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clips, "find_spec", lambda name: None if name == "mcap" else name)
    with pytest.raises(InputError, match=r"a library that is not installed \(mcap\): "):
        BlackBoxSettings.of({**DEFAULTS, "black_box": "30s+10s"})
