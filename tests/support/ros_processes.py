"""What tests between processes share: programs of this package as they run, and a peer of theirs.

The peer is a ROS node in the test's own process, for what needs an answer at once.
"""

from __future__ import annotations

import json
import os
import pickle
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from paths import ROOT, SUPPORT
from ros_bags import ODOM, POSE
from waiting import PATIENCE_S, until

from trajeval_ros.cli.app import main
from trajeval_ros.io.bags.bag import Bag
from trajeval_ros.io.bags.playback import Playback, allowed_name, play
from trajeval_ros.ros.message_types import message_class

LISTENER = SUPPORT.joinpath("ros_listener.py")
EVALUATOR = ROOT / "launch_free_scripts" / "run_evaluator.py"
GROUNDTRUTH, ODOMETRY, IMU = "/groundtruth/pose", "/vio/odometry", "/imu"
TYPES = {GROUNDTRUTH: POSE, ODOMETRY: ODOM}
# What two results of the same run may differ in: where it came from.
# How much a mistake explains is of pairs alone live, and of all groundtruth in a recording.
# Corrections of a live run are tried on its pairs, those of a recording on all of it.
# Events of a live run are those of its pairs, those of a recording of all poses.
APART = {
    "source", "name", "inputs", "live", "stream", "evidence", "before", "after",
    "events", "segments", "ate_of_segments_m",
}  # fmt: skip
_TRIED = re.compile(r"(ATE )[\d.]+( \w+, with --[\w,=. -]+? )[\d.]+(?= m| deg)")

Received = dict[str, list[bytes]]


@contextmanager
def listening(
    topics: Mapping[str, str],
    environment: dict[str, str],
    folder: Path,
    begun: Callable[[subprocess.Popen[str]], object] = lambda _: None,
) -> Iterator[Received]:
    """Listen in another process; what it received is there after the block.

    `begun` is handed the process when it listens.
    """
    output = folder / "received.pickle"
    arguments = [f"{topic}={kind}" for topic, kind in topics.items()]
    received: Received = {topic: [] for topic in topics}
    with subprocess.Popen(
        [sys.executable, str(LISTENER), str(output), *arguments],
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            if process.stdout.readline().strip() != "ready":
                raise AssertionError(f"the listener ended with status {process.wait(PATIENCE_S)}")
            begun(process)
            yield received
            process.terminate()
            assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()
    for topic, payload in pickle.loads(output.read_bytes()):
        received[topic].append(payload)


def replay_command(bag: Path, *options: object) -> list[str]:
    waits = "--wait-for-subscribers"
    waiting = [] if waits in options else [waits, str(PATIENCE_S)]
    topics = [] if "--topic" in options else _without_imu(bag)
    command = [sys.executable, "-m", "trajeval_ros", "replay", str(bag)]
    return [*command, *waiting, *topics, *map(str, options)]


def _without_imu(bag: Path) -> list[str]:
    """Return options that leave out the IMU of a simulated flight, which nobody waits for."""
    with Bag(bag) as opened:
        names = [topic.name for topic in opened.topics]
    if IMU not in names:
        return []
    return [word for name in names if name != IMU for word in ("--topic", name)]


def replay(bag: Path, environment: dict[str, str], *options: object) -> str:
    done = subprocess.run(
        replay_command(bag, *options),
        env=environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout


def run_evaluator(
    environment: dict[str, str], *arguments: str
) -> subprocess.CompletedProcess[str]:
    """Run the evaluator with something that ends it by itself."""
    return subprocess.run(
        [sys.executable, str(EVALUATOR), *arguments],
        env=environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


def parameters(**values: object) -> list[str]:
    """Return parameters as ROS arguments; Python's lists and numbers are YAML."""
    words = ["--ros-args"]
    for name, value in values.items():
        words += ["-p", f"{name}:={json.dumps(value)}"]
    return words


class Evaluator:
    """The evaluator while it runs, and what it leaves.

    Attributes:
        process: Of the node.
        folder: Its output.
    """

    def __init__(self, folder: Path, arguments: list[str], environment: dict[str, str]) -> None:
        self.folder = folder
        # Not beside the folder, whose disk may be full.
        file, name = tempfile.mkstemp(".log", f"{folder.name}_", environment["ROS_HOME"])
        self._log = Path(name)
        with os.fdopen(file, "w") as log:
            self.process = subprocess.Popen(
                [sys.executable, str(EVALUATOR), *arguments],
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    @property
    def printed(self) -> str:
        return self._log.read_text()

    def wait_for(self, text: str) -> None:
        """Wait until it says something that holds a text."""
        until(lambda: text in self.printed or self.process.poll() is not None, text)
        assert text in self.printed

    def end(self, ending: signal.Signals = signal.SIGINT) -> int:
        self.process.send_signal(ending)
        status = self.process.wait(PATIENCE_S)
        assert "Traceback" not in self.printed, self.printed
        return status

    @property
    def result(self) -> Any:
        return json.loads((self.folder / "result.json").read_text())

    def run_of(self, topic: str) -> Any:
        """Return the run of an estimate topic in the result."""
        [run] = [item for item in self.result["runs"] if item["estimate"]["source"] == topic]
        return run


@contextmanager
def evaluating(
    folder: Path,
    environment: dict[str, str],
    *arguments: str,
    estimates: Iterable[str] = (ODOMETRY,),
    groundtruth: str = GROUNDTRUTH,
    **values: object,
) -> Iterator[Evaluator]:
    """Run the evaluator; a replay waits until it is up."""
    values = {"groundtruth_topic": groundtruth, "estimate_topics": list(estimates), **values}
    values["output"] = str(folder)
    evaluator = Evaluator(folder, [*parameters(**values), *arguments], environment)
    try:
        yield evaluator
    finally:
        evaluator.process.kill()
        evaluator.process.wait()


class Peer:
    """A ROS node in this process: it publishes, listens, and asks services."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        os.environ.update({key: environment[key] for key in environment if key.startswith("ROS_")})
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=int(environment["ROS_DOMAIN_ID"]))
        self.node = rclpy.create_node("peer", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def until(self, condition: Callable[[], object], what: str) -> None:
        """Spin until something is so."""
        limit = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < limit, f"waited in vain: {what}"
            self._executor.spin_once(timeout_sec=0.02)

    def hear(self, topic: str, kind: Any, *, latched: bool = False) -> list[Any]:
        """Subscribe; messages appear in the list while this node spins."""
        heard: list[Any] = []
        self.node.create_subscription(kind, topic, heard.append, _quality(latched=latched))
        return heard

    def publisher(
        self, topic: str, kind: Any, *, reliable: bool = True, latched: bool = False
    ) -> Any:
        return self.node.create_publisher(
            kind, topic, _quality(reliable=reliable, latched=latched)
        )

    def ask(self, service: str, kind: Any, request: Any = None) -> Any:
        """Call a service; returns its response."""
        client = self.node.create_client(kind, service)
        self.until(client.service_is_ready, f"there is {service}")
        future = client.call_async(kind.Request() if request is None else request)
        self.until(future.done, f"{service} answers")
        self.node.destroy_client(client)
        return future.result()

    def set(self, node: str, **values: object) -> list[Any]:
        """Set parameters of a node; returns a result for each."""
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        request = SetParameters.Request()
        request.parameters = [
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
        ]
        results: list[Any] = self.ask(f"{node}/set_parameters", SetParameters, request).results
        return results

    def play(
        self, bag: Path, subscribers: Mapping[str, int], nodes: Iterable[str], rate: float
    ) -> None:
        """Publish a bag as `trajeval replay` does, when topics have so many subscribers.

        The nodes that subscribe are asked something first: a node that answers has started, and
        takes messages. While it plays this node goes on to hear and to answer. Messages are
        acknowledged with Fast DDS's heartbeat, every three seconds: waiting for that is for the
        end.
        """
        from rcl_interfaces.srv import GetParameters
        from rclpy.duration import Duration

        with Bag(bag) as opened:
            topics = [
                topic.name for topic in opened.topics if allowed_name(topic.name) in subscribers
            ]
            playback = Playback(opened, lambda _: True, topics, with_clock=False)
            publishers = {
                item: self.publisher(item.name, message_class(item.type))
                for item in playback.channels
            }
            for channel, publisher in publishers.items():
                count = subscribers[channel.name]
                self.until(
                    lambda: publisher.get_subscription_count() == count,  # noqa: B023
                    f"{count} subscribers of {channel.name}",
                )
            for name in nodes:
                self.ask(f"/{name}/get_parameters", GetParameters)

            def publish(channel: Any, payload: bytes) -> float:
                publishers[channel].publish(payload)
                return 0.0

            play(
                playback.messages(),
                playback.begin_ns,
                rate,
                publish=publish,
                tick=lambda _: self._executor.spin_once(timeout_sec=0.0),
                is_stopped=lambda: False,
            )
            for item in publishers.values():
                assert item.wait_for_all_acked(Duration(seconds=PATIENCE_S))
        for publisher in publishers.values():
            self.node.destroy_publisher(publisher)


def _quality(*, reliable: bool = True, latched: bool = False) -> Any:
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    return QoSProfile(
        depth=5000,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def play_without_loss(
    bag: Path,
    peer: Peer,
    environment: dict[str, str],
    folder: Path,
    nodes: Mapping[str, Mapping[str, Any]],
    rate: float,
) -> dict[str, Evaluator]:
    """Play a bag to evaluators by name; once more and slower where a machine is too busy.

    Args:
        bag: What to play.
        peer: Plays it.
        environment: Of the processes.
        folder: For their output.
        nodes: Options of `evaluating`, by the name of the node.
        rate: To begin with.
    """
    while True:
        done = play_to_nodes(bag, peer, environment, folder / f"rate_{rate:g}", nodes, rate)
        lost = [_lost(run) for item in done.values() for run in item.result["runs"]]
        if not any(lost):
            return done
        assert rate > 1.0, f"messages are lost at rate {rate}: {lost}"
        rate /= 3.0


def _lost(run: Any) -> int:
    """Return how many messages of a run were lost, or came too late to be paired."""
    too_late = run["association"]["dropped"].get("too_late", 0)
    live = run["live"]
    return int(live["messages_lost"] + live["groundtruth_messages_lost"] + too_late)


def play_to_nodes(
    bag: Path,
    peer: Peer,
    environment: dict[str, str],
    folder: Path,
    nodes: Mapping[str, Mapping[str, Any]],
    rate: float,
) -> dict[str, Evaluator]:
    """Play a bag once to evaluators by name, and end them; arguments as of `play_without_loss`."""
    folder.mkdir(parents=True)
    running: dict[str, Evaluator] = {}
    with ExitStack() as stack:
        for name, values in nodes.items():
            node = evaluating(folder / name, environment, "-r", f"__node:={name}", **values)
            running[name] = stack.enter_context(node)
        topics = Counter(
            topic
            for values in nodes.values()
            for topic in (
                values.get("groundtruth", GROUNDTRUTH),
                *values.get("estimates", (ODOMETRY,)),
            )
        )
        peer.play(bag, topics, nodes, rate)
        for item in running.values():
            item.process.send_signal(signal.SIGINT)
        for item in running.values():
            assert item.process.wait(PATIENCE_S) == 0, item.printed
            assert "Traceback" not in item.printed, item.printed
    return running


def offline(bag: Path, folder: Path, groundtruth: str, estimates: list[str], *options: str) -> Any:
    """Return the result of `trajeval evaluate`, without remarks about the bag as a file."""
    arguments = ["evaluate", "--groundtruth", f"{bag}:{groundtruth}", "--quiet"]
    for estimate in estimates:
        arguments += ["--estimate", f"{bag}:{estimate}"]
    file = folder / "offline.json"
    assert main([*arguments, *options, "--json", str(file)]) == 0
    result = json.loads(file.read_text())
    for side in (
        result["groundtruth"],
        *result["runs"],
        *(run["estimate"] for run in result["runs"]),
    ):
        side["remarks"] = [
            remark
            for remark in side["remarks"]
            if "chunks were read in part" not in remark["text"]
        ]
    return result


def assert_same(live: Any, recorded: Any, where: str = "result") -> None:
    """Compare all there is: counts and words exactly, numbers to 1e-9 of their size."""
    if isinstance(recorded, dict):
        assert live.keys() == recorded.keys(), where
        for key in recorded.keys() - APART:
            assert_same(live[key], recorded[key], f"{where}.{key}")
    elif isinstance(recorded, list):
        assert len(live) == len(recorded), (where, live, recorded)
        for number, (mine, other) in enumerate(zip(live, recorded, strict=True)):
            assert_same(mine, other, f"{where}[{number}]")
    elif isinstance(recorded, float):
        # An error may be zero but for rounding, as that of a first state that was aligned.
        assert live == pytest.approx(recorded, rel=1e-9, abs=1e-12), where
    elif isinstance(recorded, str):
        assert _TRIED.sub(r"\1\2", live) == _TRIED.sub(r"\1\2", recorded), (where, live, recorded)
    else:
        assert live == recorded, where
