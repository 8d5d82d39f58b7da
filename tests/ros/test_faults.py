"""Faults around the evaluator: publishers that change, kills, signals, full disks, no data."""

from __future__ import annotations

import copy
import os
import re
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_bags import ODOM, POSE, messages_of, write_messages
from ros_processes import (
    GROUNDTRUTH,
    ODOMETRY,
    Evaluator,
    Peer,
    assert_same,
    evaluating,
    offline,
    parameters,
    play_without_loss,
    replay,
    replay_command,
)
from small_disk import mounted
from strategies import assert_same_numbers
from waiting import LOOK_EVERY_S, PATIENCE_S, until

from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.io.live.live_folder import evaluate_folder
from trajeval_ros.io.live.state_file import read_states, state_files
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.pipeline.pipeline import evaluate
from trajeval_ros.simulation.drifting_odometry import simulate

pytest.importorskip(
    "rclpy", reason="rclpy is missing; `make test-ros` has it", exc_type=ImportError
)
pytestmark = pytest.mark.ros


@pytest.fixture
def flight(flights: Path) -> Path:
    return flights / "mcap"


def poses_on_disk(evaluator: Evaluator) -> int:
    [file] = state_files(evaluator.folder)
    return len(read_states(file).states.stamps)


def publish(
    publishers: dict[str, Any], begin_s: float, seconds: float, *, dated: bool = True
) -> None:
    """Publish a groundtruth and an estimate, with its stamps or without, that circles with it."""
    from geometry_msgs.msg import PoseStamped

    for step in range(round(seconds * 100)):
        t = begin_s + step / 100.0
        message = PoseStamped()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(t * 1e9), 10**9)
        message.header.frame_id = "world"
        message.pose.orientation.w = 1.0
        place = message.pose.position
        place.x, place.y, place.z = 3.0 * np.cos(t / 3.0), 3.0 * np.sin(t / 3.0), np.sin(t)
        publishers["groundtruth"].publish(message)
        if step % 5 == 0:
            place.x += 0.1 * np.sin(2.0 * t)
            if not dated:
                message.header.stamp.sec = message.header.stamp.nanosec = 0
            publishers["estimate"].publish(message)


@contextmanager
def published(
    peer: Peer, groundtruth: str = GROUNDTRUTH, estimate: str = ODOMETRY, of: Any = None
) -> Iterator[dict[str, Any]]:
    """Yield what `publish` publishes with, once an evaluator listens; the estimate `of` a type."""
    from geometry_msgs.msg import PoseStamped

    publishers = {
        "groundtruth": peer.publisher(groundtruth, PoseStamped),
        "estimate": peer.publisher(estimate, of or PoseStamped),
    }
    try:
        for publisher in publishers.values():
            peer.until(
                lambda: publisher.get_subscription_count() == 1,  # noqa: B023
                "the evaluator has subscribed",
            )
        yield publishers
    finally:
        for publisher in publishers.values():
            peer.node.destroy_publisher(publisher)


# Of a publisher that is started again and again, and how the evaluator tells of it.
QUALITIES: list[tuple[dict[str, bool], str]] = [
    ({"reliable": True}, "reliable, volatile"),
    ({"reliable": False}, "best_effort, volatile"),
    ({"latched": True}, "reliable, transient_local"),
    ({"latched": False}, "reliable, volatile"),
]


def test_a_publisher_may_change_its_quality_of_service(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from geometry_msgs.msg import PoseStamped

    again = f"subscribed again to {ODOMETRY}: geometry_msgs/msg/PoseStamped, "
    with evaluating(tmp_path / "out", environment, gauge="se3", lengths="none") as evaluator:
        groundtruth = peer.publisher(GROUNDTRUTH, PoseStamped)
        for part, (quality, printed) in enumerate(QUALITIES):
            estimate = peer.publisher(ODOMETRY, PoseStamped, **quality)
            if part:
                evaluator.wait_for(f"{again}{printed}")
            peer.until(
                lambda: all(
                    item.get_subscription_count() == 1
                    for item in (groundtruth, estimate)  # noqa: B023
                ),
                "the evaluator has subscribed",
            )
            for second in range(2):  # what is best effort gets lost where it comes all at once
                begin_s = 1000.0 + 10.0 * part + second
                publish({"groundtruth": groundtruth, "estimate": estimate}, begin_s, 1.0)
                goal = 20 * (2 * part + second + 1) - 2 * (part + 1)
                until(lambda: poses_on_disk(evaluator) >= goal, f"{goal} pairs")  # noqa: B023
            peer.node.destroy_publisher(estimate)
        assert evaluator.end() == 0
        peer.node.destroy_publisher(groundtruth)
    assert evaluator.printed.count(again) == len(QUALITIES) - 1
    run = evaluator.run_of(ODOMETRY)
    assert run["association"]["pairs"] == 160
    assert run["live"]["messages_lost"] == 0
    assert 0.0 < run["ate"]["position_m"]["rmse"] < 0.1


def test_topics_that_are_exchanged_by_remapping_stay_so(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:

    exchanged = ["-r", f"{GROUNDTRUTH}:={ODOMETRY}", "-r", f"{ODOMETRY}:={GROUNDTRUTH}"]
    with (
        evaluating(tmp_path / "out", environment, *exchanged, lengths="none") as evaluator,
        published(peer, ODOMETRY, GROUNDTRUTH) as publishers,
    ):
        publish(publishers, 1000.0, 4.0)
        until(lambda: poses_on_disk(evaluator) >= 78, "pairs")
        assert evaluator.end() == 0
    groundtruth, run = evaluator.result["groundtruth"], evaluator.run_of(GROUNDTRUTH)
    assert (groundtruth["source"], groundtruth["poses"]) == (ODOMETRY, 400)
    assert run["estimate"]["poses"] == 80


def test_a_killed_evaluator_loses_nothing_that_it_has_paired(
    flight: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    # The dead are missed late; with names of their own nobody waits for them.
    names = [
        "--ros-args",
        "-r",
        f"{GROUNDTRUTH}:=/dead/groundtruth",
        "-r",
        f"{ODOMETRY}:=/dead/vio",
    ]
    values = {"groundtruth": "/dead/groundtruth", "estimates": ["/dead/vio"], "gauge": "yaw"}
    with (
        evaluating(
            tmp_path / "out", environment, lengths="8", autosave_period=1, **values
        ) as evaluator,
        subprocess.Popen(
            replay_command(flight, "--rate", 2, *names),
            env=environment,
            stdout=subprocess.DEVNULL,
        ) as player,
    ):
        until(
            lambda: (evaluator.folder / "result.json").exists() and poses_on_disk(evaluator) > 200,
            "it has saved by itself",
        )
        evaluator.process.kill()
        evaluator.process.wait(PATIENCE_S)
        player.send_signal(signal.SIGINT)
        assert player.wait(PATIENCE_S) == 0
    [autosaved] = evaluator.result["runs"]
    assert 10 < autosaved["association"]["pairs"] <= poses_on_disk(evaluator)
    [run] = evaluate_folder(evaluator.folder).runs
    pairs = run.evaluation.association
    # Poses may be on disk whose groundtruth was not received before the end.
    assert len(pairs) + pairs.dropped.get("after_groundtruth", 0) == poses_on_disk(evaluator)
    groundtruth, estimate = (
        read_trajectory(f"{flight}:{item}") for item in (GROUNDTRUTH, ODOMETRY)
    )
    paired = np.isin(estimate.stamps, pairs.estimate.stamps)
    assert np.count_nonzero(paired) == len(pairs)
    protocol = Protocol(gauge=Gauge.YAW, lengths=run.evaluation.protocol.lengths)
    assert_same_numbers(run.evaluation, evaluate(groundtruth, estimate[paired], protocol))


# The signal of a lost terminal, SIGHUP, has a test of its own.
@pytest.mark.parametrize("endings", [[signal.SIGINT, signal.SIGINT], [signal.SIGTERM]])
def test_a_signal_ends_it_with_everything_written(
    flight: Path, environment: dict[str, str], endings: list[signal.Signals], tmp_path: Path
) -> None:
    with evaluating(tmp_path / "out", environment, gauge="yaw", lengths="8") as evaluator:
        replay(flight, environment, "--rate", 10)
        *others, last = endings
        for other in others:
            evaluator.process.send_signal(other)
        assert evaluator.end(last) == 0
    expected = offline(
        flight, tmp_path, GROUNDTRUTH, [ODOMETRY], "--gauge", "yaw", "--lengths", "8"
    )
    assert_same(evaluator.result, expected)
    left = {path.name for path in evaluator.folder.iterdir()}
    assert {"result.json", "errors.npz", "vio_odometry.states"} <= left
    assert not {item for item in left if item.startswith(".")}


@contextmanager
def reading(terminal: int) -> Iterator[None]:
    """Take what is said to a terminal, so that it doesn't fill."""
    enough = threading.Event()

    def read() -> None:
        while not enough.is_set():
            if select.select([terminal], [], [], LOOK_EVERY_S)[0]:
                os.read(terminal, 65536)

    reader = threading.Thread(target=read)
    reader.start()
    try:
        yield
    finally:
        enough.set()
        reader.join()


def test_a_terminal_that_is_lost_leaves_results(
    flight: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    folder = tmp_path / "out"
    values = {
        "groundtruth_topic": GROUNDTRUTH,
        "estimate_topics": [ODOMETRY],
        "output": str(folder),
    }
    master, slave = os.openpty()
    # The first process of a session that opens a terminal is told when that is gone.
    code = (
        "import os, sys; os.close(os.open(sys.argv.pop(1), os.O_RDWR)); "
        "from trajeval_ros.__main__ import ros_evaluator; sys.exit(ros_evaluator())"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, os.ttyname(slave), *parameters(gauge="yaw", **values)],
        env=environment,
        stdin=slave,
        stdout=slave,
        stderr=slave,
        start_new_session=True,
    ) as process:
        os.close(slave)
        try:
            with reading(master):
                replay(flight, environment, "--rate", 10)
            os.close(master)
            assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()
    assert (folder / "result.json").exists()
    assert (folder / "errors.npz").exists()


def test_a_defect_is_told_and_what_was_paired_is_written(
    flight: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    # In every tick from some time on, and so in the last one too.
    (tmp_path / "sitecustomize.py").write_text(
        "from trajeval_ros.online.live_clock import OnlineClock\n"
        "def update(clock, *, at_end=False, waits=False):\n"
        "    return clock.span_s > 5.0 and 1 // 0\n"
        "OnlineClock.update = update\n"
    )
    spoiled = {**environment, "PYTHONPATH": f"{tmp_path}:{environment['PYTHONPATH']}"}
    with evaluating(tmp_path / "out", spoiled, gauge="yaw", lengths="8") as evaluator:
        replay(flight, environment, "--rate", 8)
        assert evaluator.process.wait(PATIENCE_S) == 1
    assert "ZeroDivisionError" in evaluator.printed
    association = evaluator.run_of(ODOMETRY)["association"]
    without_groundtruth = sum(association["dropped"].values())
    assert association["pairs"] + without_groundtruth == poses_on_disk(evaluator) > 50
    assert (evaluator.folder / "errors.npz").exists()


def test_a_reset_goes_on_receiving_and_tells_of_results_that_can_t_be_written(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from std_srvs.srv import Trigger

    with (
        evaluating(tmp_path / "out", environment, lengths="none") as evaluator,
        published(peer) as publishers,
    ):
        publish(publishers, 1000.0, 4.0)
        until(lambda: poses_on_disk(evaluator) >= 78, "pairs")
        (evaluator.folder / "errors.npz").mkdir()
        told = f"subscribed to {GROUNDTRUTH}"
        assert evaluator.printed.count(told) == 1
        answer = peer.ask("/evaluator/reset", Trigger)
        assert answer.success
        publish(publishers, 1000.0, 4.0)
        [begun] = state_files(Path(answer.message.rpartition(" ")[2]))
        until(lambda: len(read_states(begun).states.stamps) >= 78, "poses of the new run")
        assert evaluator.printed.count(told) == 1  # subscriptions last over all runs
        evaluator.wait_for(f"results can't be written to {evaluator.folder}: ")
        evaluator.end()


def test_without_groundtruth_there_is_no_result(
    flight: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    with evaluating(tmp_path / "out", environment, gauge="yaw") as evaluator:
        replay(flight, environment, "--rate", 20, "--topic", ODOMETRY, "--end", 10)
        evaluator.wait_for(f"no publisher on {GROUNDTRUTH}")
        assert evaluator.end() == 2
    told = [line for line in evaluator.printed.splitlines() if "no pairs of estimate" in line]
    assert len(told) == 1
    assert re.search(rf"0 poses on {GROUNDTRUTH}, 1\d\d poses on {ODOMETRY}", told[0])
    assert not (evaluator.folder / "result.json").exists()


def test_an_estimate_without_stamps_is_told_at_once_and_in_the_end(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray

    told = peer.hear("/diagnostics", DiagnosticArray)

    def newest() -> Any:
        return told[-1].status[0] if told and told[-1].status else None

    trouble = f"{ODOMETRY}: no message with a valid pose (with timestamp zero)"
    with (
        evaluating(tmp_path / "out", environment, lengths="none") as evaluator,
        published(peer) as publishers,
    ):
        publish(publishers, 1000.0, 4.0, dated=False)
        peer.until(lambda: newest() and trouble in newest().message, "diagnostics tell of it")
        values = {value.key: value.value for value in newest().values}
        assert newest().level == b"\x02"
        assert values["dropped"] == "80 with timestamp zero"
        assert evaluator.end() == 2
    assert evaluator.printed.count("no message with a valid pose") == 1
    assert (
        f"400 poses on {GROUNDTRUTH}, 0 poses on {ODOMETRY} (80 with timestamp zero)"
        in evaluator.printed
    )


def test_save_tells_why_a_path_can_t_be_written(
    peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from nav_msgs.msg import Path as PathMessage
    from std_srvs.srv import Trigger

    with (
        evaluating(tmp_path / "out", environment, lengths="none") as evaluator,
        published(peer, of=PathMessage) as publishers,
    ):
        slam = PathSender(publishers["estimate"])
        publish({**publishers, "estimate": slam}, 1000.0, 4.0)
        until(lambda: poses_on_disk(evaluator) >= 78, "pairs")
        (evaluator.folder / "vio_odometry.revised").mkdir()
        saved = peer.ask("/evaluator/save", Trigger)
        assert not saved.success
        assert "vio_odometry.revised can't be written: is a directory" in saved.message
        evaluator.end()


class PathSender:
    """Publishes poses as a path that grows."""

    def __init__(self, publisher: Any) -> None:
        from nav_msgs.msg import Path as PathMessage

        self.publisher, self._path = publisher, PathMessage()

    def publish(self, pose: Any) -> None:
        self._path.header = pose.header
        self._path.poses.append(copy.deepcopy(pose))
        self.publisher.publish(self._path)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    with mounted(tmp_path / "disk", "320k") as folder:
        yield folder


def test_a_full_disk_is_told_once_and_nothing_is_lost_when_there_is_room_again(
    flight: Path, peer: Peer, environment: dict[str, str], small_disk: Path, tmp_path: Path
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from std_srvs.srv import Trigger

    told = peer.hear("/diagnostics", DiagnosticArray)

    def levels() -> set[bytes]:
        return {status.level for array in told for status in array.status}

    with evaluating(
        small_disk / "out", environment, gauge="yaw", lengths="8", autosave_period=0
    ) as evaluator:
        replay(
            flight,
            environment,
            "--rate",
            10,
            "--topic",
            GROUNDTRUTH,
            "--topic",
            ODOMETRY,
            "--end",
            8,
        )
        assert peer.ask("/evaluator/save", Trigger).success
        earlier = evaluator.result
        replay(flight, environment, "--rate", 10, "--start", 8.0)
        evaluator.wait_for("results can't be written")
        saved = peer.ask("/evaluator/save", Trigger)
        assert not saved.success
        assert "no space left on device" in saved.message
        assert evaluator.result == earlier
        told.clear()  # of what was said before the disk was full
        peer.until(lambda: b"\x02" in levels(), "diagnostics tell of an error")
        assert evaluator.printed.count("results can't be written") == 1
        subprocess.run(["mount", "-o", "remount,size=16m", "tmpfs", str(small_disk)], check=True)
        peer.until(lambda: peer.ask("/evaluator/save", Trigger).success, "it is saved")
        evaluator.wait_for("no longer: results can't be written")
        assert evaluator.end() == 0
    expected = offline(
        flight, tmp_path, GROUNDTRUTH, [ODOMETRY], "--gauge", "yaw", "--lengths", "8"
    )
    assert_same(evaluator.result, expected)
    assert [path.name for path in small_disk.iterdir()] == ["out"]


@pytest.fixture(scope="module")
def late_flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag whose estimates came 12 s after their stamps."""
    flown = simulate(6, 30.0)
    late = [
        (topic, kind, stamp + 12 * 10**9, payload)
        for topic, kind, stamp, payload in messages_of(flown.estimate, ODOMETRY, ODOM)
    ]
    bag = tmp_path_factory.mktemp("late") / "bag"
    write_messages(bag, [*messages_of(flown.groundtruth[::2], GROUNDTRUTH, POSE), *late])
    return bag


def test_an_estimate_that_is_late_is_evaluated_as_offline(
    late_flight: Path, peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    nodes = {"patient": {"gauge": "yaw", "max_delay": 20}}
    played = play_without_loss(late_flight, peer, environment, tmp_path, nodes, rate=9.0)
    recorded = offline(late_flight, tmp_path, GROUNDTRUTH, [ODOMETRY], "--gauge", "yaw")
    assert_same(played["patient"].result, recorded)


def test_an_estimate_that_is_too_late_is_told(
    late_flight: Path, peer: Peer, environment: dict[str, str], tmp_path: Path
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray

    text = "dropped: later than the groundtruth buffer of 10 s (max_delay)"
    heard = peer.hear("/diagnostics", DiagnosticArray)
    with evaluating(tmp_path / "out", environment, gauge="yaw") as evaluator:
        replay(late_flight, environment, "--rate", 8)
        peer.until(
            lambda: any(text in item.message for array in heard for item in array.status),
            "diagnostics tell of it",
        )
        assert evaluator.end() == 0
    run = evaluator.run_of(ODOMETRY)
    # The result is of all poses that were received.
    assert run["association"]["pairs"] > 300
    assert "too_late" not in run["association"]["dropped"]
    assert not [remark for remark in run["remarks"] if text in remark["text"]]
