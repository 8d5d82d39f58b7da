"""`make demo-real`: real lidar odometry, evaluated live and recorded. Only the lidar is simulated.

    python -m examples.lidar_odometry.demo FOLDER [--seconds 60] [--estimators NAME ...]

With ROS 2, every estimator is a node next to the live evaluator, and the live results are compared
with those of the recorded bag. Without ROS 2, the odometry runs in this process.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from examples.lidar_odometry.odometry import in_one_process
from examples.lidar_odometry.sensor import GROUNDTRUTH_TOPIC, sweeps_in
from examples.lidar_odometry.world import LONGEST_S, Flight
from trajeval_ros.exceptions import InputError, TrajevalError

LIMITS_M = {"small_gicp": 0.02, "kiss_icp": 0.08}  # of the position ATE of 60 s
AGREEMENT = 1e-9
_PATIENCE_S = 300.0
# What a demo writes; `live_2` is that of a clock that stepped back.
_EARLIER = re.compile(r"bag|live(_\d+)?|recorded|rerun\.png")
_SHOWN = {
    "pairs": ("association", "pairs"),
    "position ATE [m]": ("ate", "position_m", "rmse"),
    "rotation ATE [deg]": ("ate", "rotation_deg", "rmse"),
}


def run(folder: Path, estimators: Sequence[str], seconds: float, *, is_real_time: bool) -> None:
    """Run the demo.

    Raises:
        InputError: A scan is not answered, an error is above its limit, or live and recorded
            results differ.
    """
    remove_existing(folder)
    chosen = [estimator for estimator in estimators if is_there(estimator)]
    for estimator in estimators:
        if estimator not in chosen:
            print(f"{estimator} is left out: it has no wheel for this machine")
    if not chosen:
        raise InputError(f"none of {', '.join(estimators)} is installed")
    bag, live, recorded = folder / "bag", folder / "live", folder / "recorded"
    topics = [topic_of(item) for item in chosen]
    has_ros = find_spec("rclpy") is not None
    if has_ros:
        pace = "in real time" if is_real_time else "in lockstep"
        print(f"\n--- Evaluate {' and '.join(chosen)} live, {pace}", flush=True)
        counts = evaluate_live(folder, chosen, seconds, is_real_time=is_real_time)
        for topic in topics:
            print(f"{topic}: {counts[topic]} poses for {sweeps_in(seconds)} scans")
    else:
        print("\n--- Run the odometry in this process (rclpy is not installed)", flush=True)
        write_without_ros(bag, chosen, seconds)
    print("\n--- Evaluate the recording", flush=True)
    sources = each_with("--estimate", [f"{bag}:{topic}" for topic in topics])
    # With ROS, the evaluator has printed the tables and drawn the picture.
    more = ["--quiet"] if has_ros else ["--rrd", str(recorded / "run.rrd")]
    trajeval(
        "evaluate", "--groundtruth", f"{bag}:{GROUNDTRUTH_TOPIC}", *sources,
        "--modality", "lidar", "--output", recorded, *more,
    )  # fmt: skip
    folders = [live, recorded] if has_ros else [recorded]
    results = [json.loads((item / "result.json").read_text("utf-8")) for item in folders]
    if has_ros:
        for line in table(*results):
            print(line)
    print("\n--- Draw the picture", flush=True)
    picture = folder / "rerun.png"
    shown = live if has_ros else recorded
    drawn = trajeval("view", shown / "run.rrd", "--screenshot", picture, is_required=False)
    print(f"picture:   {picture if drawn else 'none'}")
    print(f"recording: {shown / 'run.rrd'}")
    print(f"next, show it in 3D:\n  {sys.executable} -m trajeval_ros view {shown / 'run.rrd'}")
    check(results[-1], is_real_time=is_real_time)
    if has_ros and (apart := difference(*results)) > AGREEMENT:
        raise InputError(f"live and recorded results differ by {apart:.3g}, more than {AGREEMENT}")


def is_there(estimator: str) -> bool:
    """Return whether an estimator is installed, or a file."""
    return Path(estimator).suffix == ".py" or find_spec(estimator) is not None


def topic_of(estimator: str) -> str:
    """Return the topic of an estimator's odometry."""
    return f"/{Path(estimator).stem}"


def remove_existing(folder: Path) -> None:
    """Remove the results of an earlier demo, and nothing else."""
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        if not _EARLIER.fullmatch(path.name):
            raise InputError(f"{folder} contains {path.name}; choose another folder")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)


def evaluate_live(
    folder: Path, estimators: Sequence[str], seconds: float, *, is_real_time: bool
) -> Mapping[str, int]:
    """Run lidar, estimators and evaluator, and record; return the numbers of messages."""
    topics = [topic_of(estimator) for estimator in estimators]
    words = [
        f"groundtruth_topic:={GROUNDTRUTH_TOPIC}",
        f"estimate_topics:=[{','.join(topics)}]",
        "modality:=lidar",
        f"output:={json.dumps(str(folder / 'live'))}",
        "rerun:=file",
        f"rerun_points:={topics[0]}/points",
    ]
    with ExitStack() as stack:
        evaluator = stack.enter_context(
            process("trajeval_ros", "evaluator", "--ros-args", *each_with("-p", words))
        )
        # Its subscribers are the lidar, the evaluator and the recorder.
        nodes = [
            stack.enter_context(
                process("examples.lidar_odometry.odometry", estimator, "--subscribers", "3")
            )
            for estimator in estimators
        ]
        pace = ["--real-time"] if is_real_time else []
        running = [*zip(estimators, nodes, strict=True), ("the evaluator", evaluator)]
        lidar = stack.enter_context(
            process(
                "examples.lidar_odometry.sensor", str(seconds), *topics, *pace,
                stdout=subprocess.PIPE,
            )
        )  # fmt: skip
        counts = record(folder / "bag", topics, lidar)
        for name, item in running:
            item.send_signal(signal.SIGINT)
            if item.wait(_PATIENCE_S):
                raise InputError(f"{name} exited with status {item.returncode}")
    return counts


def each_with(option: str, values: Sequence[str]) -> list[str]:
    """Return values with an option before each."""
    return [word for value in values for word in (option, value)]


@contextmanager
def process(module: str, *arguments: str, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """Run a module in a process that ends with the block."""
    command = [sys.executable, "-m", module, *arguments]
    with subprocess.Popen(command, text=True, **options) as started:
        try:
            yield started
        finally:
            started.kill()


def record(bag: Path, topics: Sequence[str], lidar: subprocess.Popen[str]) -> Mapping[str, int]:
    """Record groundtruth and odometry until the lidar has ended; return numbers of messages."""
    import rclpy
    from geometry_msgs.msg import PoseStamped
    from nav_msgs.msg import Odometry
    from rclpy.qos import QoSProfile
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    from trajeval_ros.ros.lifetime import ros

    store = get_typestore(Stores.ROS2_JAZZY)
    counts: dict[str, int] = {}
    with ros() as stop, Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        node = rclpy.create_node("recorder")

        def subscribe(topic: str, kind: Any, name: str) -> None:
            connection = writer.add_connection(topic, name, typestore=store)
            counts[topic] = 0

            def write(payload: bytes) -> None:
                counts[topic] += 1
                writer.write(connection, time.time_ns(), payload)

            node.create_subscription(kind, topic, write, QoSProfile(depth=5000), raw=True)

        subscribe(GROUNDTRUTH_TOPIC, PoseStamped, "geometry_msgs/msg/PoseStamped")
        for topic in topics:
            subscribe(topic, Odometry, "nav_msgs/msg/Odometry")
        while lidar.poll() is None and not stop.is_asked_for:
            rclpy.spin_once(node, timeout_sec=0.05)
        if lidar.returncode != 0 or lidar.stdout is None:
            # The lidar has printed the reason.
            raise InputError("the lidar did not publish the whole flight")
        expected = json.loads(lidar.stdout.read())
        end = time.monotonic() + _PATIENCE_S
        while any(counts[topic] < expected[topic] for topic in counts):
            if time.monotonic() > end:
                raise InputError("the recorder has lost messages; run the demo again")
            rclpy.spin_once(node, timeout_sec=0.05)
        node.destroy_node()
    return counts


def write_without_ros(bag: Path, estimators: Sequence[str], seconds: float) -> None:
    """Write a bag with the groundtruth, and with odometry that runs in this process."""
    from trajeval_ros.io.bags.write_bag import ODOMETRY, POSE_STAMPED, write_bag

    flight, sweeps = Flight(), sweeps_in(seconds)
    odometry = {
        topic_of(estimator): (in_one_process(estimator, sweeps, flight), ODOMETRY)
        for estimator in estimators
    }
    seen = flight.groundtruth[: round(seconds * 200)]
    write_bag(bag, {GROUNDTRUTH_TOPIC: (seen, POSE_STAMPED), **odometry})


def table(live: dict[str, Any], recorded: dict[str, Any]) -> list[str]:
    """Return lines that compare both results."""
    lines = [f"{'':34}{'live':>12}{'recorded':>12}"]
    for runs in zip(live["runs"], recorded["runs"], strict=True):
        for label, path in _SHOWN.items():
            values = []
            for value in runs:
                for key in path:
                    value = value[key]
                values.append(f"{value:12.6g}")
            lines.append(f"{name_of(runs[0]):14}{label:20}" + "".join(values))
    apart = difference(live, recorded)
    lines.append(f"largest difference of all errors: {apart:.2g}")
    return lines


def name_of(run: dict[str, Any]) -> str:
    """Return the name of an estimator from its result."""
    return str(run["estimate"]["name"])


def check(result: dict[str, Any], *, is_real_time: bool) -> None:
    """Raise InputError if an error is above its limit; in real time, the load decides."""
    for item in result["runs"]:
        name, ate_m = name_of(item), item["ate"]["position_m"]["rmse"]
        limit_m = LIMITS_M.get(name)
        if limit_m is not None and ate_m > limit_m and not is_real_time:
            raise InputError(f"{name}: position ATE {ate_m:.3f} m, more than {limit_m} m")


def difference(live: Any, recorded: Any) -> float:
    """Return the largest difference of the errors of two results."""
    apart = 0.0
    for mine, other in zip(live["runs"], recorded["runs"], strict=True):
        for part in ("ate", "re", "alignment"):
            numbers, others = dict(leaves(mine[part])), dict(leaves(other[part]))
            if numbers.keys() != others.keys():
                return float("inf")
            apart = max([apart, *(abs(numbers[key] - others[key]) for key in numbers)])
    return apart


def leaves(tree: Any, at: str = "") -> Iterator[tuple[str, float]]:
    """Return all numbers of a tree, with their places."""
    if isinstance(tree, dict | list):
        for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
            yield from leaves(value, f"{at}.{key}")
    elif isinstance(tree, int | float):
        yield at, float(tree)


def trajeval(*arguments: str | Path, is_required: bool = True) -> bool:
    """Run a command of the package; return whether it succeeded."""
    command = [sys.executable, "-m", "trajeval_ros", *map(str, arguments)]
    done = subprocess.run(command, check=False).returncode == 0
    if is_required and not done:
        raise InputError(f"trajeval {arguments[0]} failed")
    return done


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Evaluates real lidar odometry.")
    parser.add_argument("folder", type=Path, help="output folder: new, or of an earlier demo")
    parser.add_argument("--seconds", type=float, default=60.0, help="duration of the flight")
    parser.add_argument("--real-time", action="store_true", help="publish by the clock")
    parser.add_argument(
        "--estimators",
        nargs="+",
        default=["small_gicp", "kiss_icp"],
        help="small_gicp, kiss_icp, or Python files with a class Estimator",
    )
    known = parser.parse_args()
    if not 5.0 <= known.seconds <= LONGEST_S:
        parser.error(f"--seconds must be from 5 to {LONGEST_S:g}")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        run(known.folder, known.estimators, known.seconds, is_real_time=known.real_time)
    except TrajevalError as error:
        parser.exit(2, f"demo-real: {error}\n")
