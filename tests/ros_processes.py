"""What tests between processes share: programs of this package as they run, and a peer of theirs.

The peer is a ROS node in the test's own process, for what needs an answer at once.
"""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from trajeval_ros.io.bags import Bag
from trajeval_ros.io.pacing import play
from trajeval_ros.io.playback import Playback, allowed_name
from trajeval_ros.ros.messages import message_class
from trajeval_ros.trajectory import NANOSECONDS

ROOT = Path(__file__).resolve().parent.parent
LISTENER = Path(__file__).with_name("ros_listener.py")
EVALUATOR = ROOT / "launch_free_scripts" / "run_evaluator.py"
STORE = get_typestore(Stores.ROS2_JAZZY)
TRUTH, ODOMETRY = "/groundtruth/pose", "/vio/odometry"
POSE, ODOM = "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Odometry"
POINT, PATH = "geometry_msgs/msg/PointStamped", "nav_msgs/msg/Path"
TYPES = {TRUTH: POSE, ODOMETRY: ODOM}
PATIENCE_S = 90

Received = dict[str, list[bytes]]
# Topic, type, log time in ns, payload.
Message = tuple[str, str, int, bytes]


@contextmanager
def listening(
    topics: Mapping[str, str], environment: dict[str, str], folder: Path
) -> Iterator[Received]:
    """Listen in another process; what it received is there after the block."""
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
            assert process.stdout.readline().strip() == "ready"
            yield received
            process.terminate()
            assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()
    for topic, payload in pickle.loads(output.read_bytes()):
        received[topic].append(payload)


def replay_command(bag: Path, *options: object) -> list[str]:
    waiting = ["--wait-for-subscribers", "60"]
    return [sys.executable, "-m", "trajeval_ros", "replay", str(bag), *waiting, *map(str, options)]


def replay(bag: Path, environment: dict[str, str], *options: object) -> str:
    done = subprocess.run(
        replay_command(bag, *options),
        env=environment,
        capture_output=True,
        text=True,
        timeout=2 * PATIENCE_S,
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
        self._log = folder.with_name(f"{folder.name}.log")
        with self._log.open("w") as log:
            self.process = subprocess.Popen(
                [sys.executable, str(EVALUATOR), *arguments],
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    @property
    def said(self) -> str:
        return self._log.read_text()

    def wait_for(self, text: str) -> None:
        """Wait until it says something that holds a text."""
        until(lambda: text in self.said or self.process.poll() is not None, text)
        assert text in self.said

    def end(self, ending: signal.Signals = signal.SIGINT) -> int:
        self.process.send_signal(ending)
        status = self.process.wait(PATIENCE_S)
        assert "Traceback" not in self.said, self.said
        return status

    @property
    def result(self) -> Any:
        return json.loads((self.folder / "result.json").read_text())

    def run_of(self, topic: str) -> Any:
        """Return the run of an estimate topic in the result."""
        [run] = [each for each in self.result["runs"] if each["estimate"]["source"] == topic]
        return run


@contextmanager
def evaluating(
    folder: Path,
    environment: dict[str, str],
    *arguments: str,
    estimates: Iterable[str] = (ODOMETRY,),
    groundtruth: str = TRUTH,
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


def until(condition: Callable[[], object], what: str, patience_s: float = PATIENCE_S) -> None:
    """Wait until something is so."""
    limit = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < limit, f"waited in vain: {what}"
        time.sleep(0.02)


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

    def until(
        self, condition: Callable[[], object], what: str, patience_s: float = PATIENCE_S
    ) -> None:
        """Spin until something is so."""
        limit = time.monotonic() + patience_s
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

    def play(self, bag: Path, subscribers: Mapping[str, int], rate: float) -> None:
        """Publish a bag as `trajeval replay` does, when topics have so many subscribers."""
        from rclpy.duration import Duration

        with Bag(bag) as opened:
            topics = [
                each.name for each in opened.topics if allowed_name(each.name) in subscribers
            ]
            playback = Playback(opened, lambda _: True, topics)
            publishers = {
                each: self.publisher(each.name, message_class(each.type))
                for each in playback.channels
            }
            for channel, publisher in publishers.items():
                count = subscribers[channel.name]
                self.until(
                    lambda: publisher.get_subscription_count() == count,  # noqa: B023
                    f"{count} subscribers of {channel.name}",
                )
            play(
                playback.messages(),
                playback.begin_ns,
                rate,
                publish=lambda channel, payload: publishers[channel].publish(payload),
                tick=lambda _: None,
                is_stopped=lambda: False,
            )
        for publisher in publishers.values():
            assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE_S))
            self.node.destroy_publisher(publisher)


def _quality(*, reliable: bool = True, latched: bool = False) -> Any:
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    return QoSProfile(
        depth=5000,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def pose_message(
    stamp: int, position: Sequence[float], quaternion: Sequence[float], frame: str = "world"
) -> bytes:
    return _serialised(POSE, _pose_stamped(stamp, position, quaternion, frame))


def point_message(stamp: int, position: Sequence[float], frame: str = "world") -> bytes:
    types = STORE.types
    point = types["geometry_msgs/msg/Point"](*position)
    return _serialised(POINT, types[POINT](_header(stamp, frame), point))


def path_message(
    stamps: Sequence[int],
    positions: Sequence[Sequence[float]],
    quaternions: Sequence[Sequence[float]],
    frame: str = "map",
) -> bytes:
    poses = [
        _pose_stamped(*each, frame) for each in zip(stamps, positions, quaternions, strict=True)
    ]
    return _serialised(PATH, STORE.types[PATH](_header(stamps[-1], frame), poses))


def odometry_message(
    stamp: int,
    position: Sequence[float],
    quaternion: Sequence[float],
    body_velocity: Sequence[float] = (0.0, 0.0, 0.0),
) -> bytes:
    types = STORE.types
    Vector3 = types["geometry_msgs/msg/Vector3"]
    nothing = np.zeros(36)
    pose = types["geometry_msgs/msg/PoseWithCovariance"](_pose(position, quaternion), nothing)
    twist = types["geometry_msgs/msg/Twist"](Vector3(*body_velocity), Vector3(0.0, 0.0, 0.0))
    twist = types["geometry_msgs/msg/TwistWithCovariance"](twist, nothing)
    return _serialised(ODOM, types[ODOM](_header(stamp, "odom"), "base_link", pose, twist))


def _serialised(kind: str, message: Any) -> bytes:
    return bytes(STORE.serialize_cdr(message, kind))


def _pose_stamped(
    stamp: int, position: Sequence[float], quaternion: Sequence[float], frame: str
) -> Any:
    return STORE.types[POSE](_header(stamp, frame), _pose(position, quaternion))


def _pose(position: Sequence[float], quaternion: Sequence[float]) -> Any:
    types = STORE.types
    turn = types["geometry_msgs/msg/Quaternion"](*map(float, quaternion))
    place = types["geometry_msgs/msg/Point"](*map(float, position))
    return types["geometry_msgs/msg/Pose"](place, turn)


def _header(stamp: int, frame: str) -> Any:
    types = STORE.types
    time = types["builtin_interfaces/msg/Time"](*divmod(int(stamp), NANOSECONDS))
    return types["std_msgs/msg/Header"](time, frame)


def write_messages(path: Path, messages: Sequence[Message]) -> None:
    """Write a bag of messages in any order."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, log_time, payload in sorted(messages, key=lambda each: each[2]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], log_time, payload)


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
        done = _play(bag, peer, environment, folder / f"rate_{rate:g}", nodes, rate)
        lost = [
            run["live"]["messages_lost"] + run["live"]["groundtruth_messages_lost"]
            for each in done.values()
            for run in each.result["runs"]
        ]
        if not any(lost):
            return done
        assert rate > 1.0, f"messages are lost at rate {rate}: {lost}"
        rate /= 3.0


def _play(
    bag: Path,
    peer: Peer,
    environment: dict[str, str],
    folder: Path,
    nodes: Mapping[str, Mapping[str, Any]],
    rate: float,
) -> dict[str, Evaluator]:
    folder.mkdir(parents=True)
    running: dict[str, Evaluator] = {}
    with ExitStack() as stack:
        for name, values in nodes.items():
            node = evaluating(folder / name, environment, "-r", f"__node:={name}", **values)
            running[name] = stack.enter_context(node)
        topics = Counter(
            topic
            for values in nodes.values()
            for topic in (values.get("groundtruth", TRUTH), *values.get("estimates", (ODOMETRY,)))
        )
        peer.play(bag, topics, rate)
        for each in running.values():
            each.process.send_signal(signal.SIGINT)
        for each in running.values():
            assert each.process.wait(PATIENCE_S) == 0, each.said
            assert "Traceback" not in each.said, each.said
    return running
