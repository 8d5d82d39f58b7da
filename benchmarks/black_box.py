"""What the black box takes of a core, and whether each alarm leaves a clip, kills included.

Usage: make bench-black-box. Traffic stays on the loopback interface: groundtruth at 1 kHz,
odometry at 200 Hz, and images of noise at 5 MB/s.
"""

from __future__ import annotations

import argparse
import json
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.live_node import cpu_s, environment
from trajeval_ros.io.bags.bag import Bag
from trajeval_ros.io.live.clip_folder import ClipFolder

if TYPE_CHECKING:
    from collections.abc import Iterator

TRUTH, ODOMETRY, IMAGE = "/groundtruth/pose", "/vio/odometry", "/camera/image"
TRAFFIC = ["1000", "3600", "1", f"{ODOMETRY}@200", f"{IMAGE}@20:250000"]
SETTLE_S = 5.0
BEFORE_S, AFTER_S = 1.0, 0.3


@contextmanager
def started(*command: str) -> Iterator[subprocess.Popen[str]]:
    """Run a module of this package's, and end it behind the block."""
    with subprocess.Popen(
        [sys.executable, "-m", *command],
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def node_share(folder: Path, seconds: float, *parameters: str) -> float:
    """Return what share of a core the node takes, in percent."""
    words = [
        f"groundtruth_topic:={TRUTH}", f"estimate_topics:=[{ODOMETRY}]",
        f"output:={folder / 'out'}", "autosave_period:=0.0", *parameters,
    ]  # fmt: skip
    options = [each for word in words for each in ("-p", word)]
    with (
        started("trajeval_ros", "evaluator", "--ros-args", *options) as node,
        started("benchmarks.publish_traffic", *TRAFFIC),
    ):
        time.sleep(SETTLE_S)
        before, begin = cpu_s(node.pid), time.monotonic()
        time.sleep(seconds)
        return 100.0 * (cpu_s(node.pid) - before) / (time.monotonic() - begin)


def compare_shares(runs: int, seconds: float) -> None:
    """Print the shares of the node with and without a black box, in turns."""
    kept = [
        "black_box:=30s+10s", f"black_box_topics:=[{TRUTH},{ODOMETRY},{IMAGE}]",
    ]  # fmt: skip
    found: list[tuple[float, float]] = []
    for _ in range(runs):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            plain = node_share(folder, seconds)
            boxed = node_share(folder, seconds, *kept, f"black_box_folder:={folder / 'clips'}")
            found.append((plain, boxed))
    more = statistics.median(boxed - plain for plain, boxed in found)
    print(
        f"node {statistics.median(each[0] for each in found):.1f} %, with black box "
        f"{statistics.median(each[1] for each in found):.1f} % of a core: {more:+.1f} points "
        f"(each: {', '.join(f'{b - a:+.1f}' for a, b in found)})",
        flush=True,
    )


def whole_clips(folder: Path) -> int:
    """Return how many clips can be read and hold messages of all topics, and check all."""
    count = 0
    for each in folder.glob("2*"):
        topics = json.loads((each / "clip.json").read_text())["topics"]
        assert topics.keys() == {TRUTH, ODOMETRY, IMAGE}, topics
        with Bag(each / "clip.mcap") as bag:
            read = {topic.name: topic.count for topic in bag.topics}
        assert read == {name: about["messages"] for name, about in topics.items()}, read
        count += 1
    return count


def count_clips(alarms: int) -> None:
    """Print how many of so many alarms left a clip, and what they took of a core."""
    with tempfile.TemporaryDirectory() as name, started("benchmarks.publish_traffic", *TRAFFIC):
        folder = Path(name)
        with started("benchmarks.black_box", "--alarming", name, "--alarms", str(alarms)) as box:
            said = box.communicate()[0].strip()
        assert box.returncode == 0
        print(f"{whole_clips(folder)} of {alarms} alarms left a whole clip; {said}", flush=True)


def kill(times: int) -> None:
    """Print what kills at random moments left."""
    whole = left_over = 0
    draw = random.Random(0)
    with started("benchmarks.publish_traffic", *TRAFFIC):
        for _ in range(times):
            with tempfile.TemporaryDirectory() as name:
                folder = Path(name)
                with started("benchmarks.black_box", "--alarming", name) as box:
                    while not list(folder.iterdir()):
                        time.sleep(0.001)
                    time.sleep(draw.uniform(0.0, 0.05))
                    box.send_signal(signal.SIGKILL)
                left_over += sum(each.name.startswith(".") for each in folder.iterdir())
                ClipFolder(folder, 10**6, 10**12)
                assert not [each for each in folder.iterdir() if each.name.startswith(".")]
                whole += whole_clips(folder)
    print(
        f"{times} kills: {whole} whole clips, {left_over} unfinished ones, which the next start "
        "removed",
        flush=True,
    )


def alarm(folder: Path, alarms: int) -> None:
    """Run a black box with an alarm after each clip; print what it took."""
    import rclpy

    from trajeval_ros.online.notices import ERROR, Notice
    from trajeval_ros.ros.black_box import BlackBox, BlackBoxSettings

    rclpy.init()
    node = rclpy.create_node("black_box", start_parameter_services=False)
    settings = BlackBoxSettings(
        BEFORE_S, AFTER_S, (TRUTH, ODOMETRY, IMAGE), folder, 256_000_000, 10**12, 0.0
    )
    box = BlackBox(node, settings, {})
    alarm_at = time.monotonic() + 3.0
    begin, wall = time.process_time(), time.monotonic()
    count = 0
    while count < alarms or time.monotonic() < alarm_at:
        box.match()
        box.tick()
        if count < alarms and time.monotonic() >= alarm_at:
            alarm_at = time.monotonic() + BEFORE_S + AFTER_S + 0.2
            box.trigger(Notice("alarm", ERROR, "an alarm", "test"), dict)
            count += 1
        time.sleep(0.05)
    box.conclude()
    share = 100.0 * (time.process_time() - begin) / (time.monotonic() - wall)
    print(f"a process that does nothing else took {share:.1f} % of a core, writing included")
    node.destroy_node()
    rclpy.try_shutdown()


def main() -> None:
    """Measure as asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", default=3, type=int, help="the median counts")
    parser.add_argument("--seconds", default=20.0, type=float, help="measured, each time")
    parser.add_argument("--alarms", default=100, type=int)
    parser.add_argument("--kills", default=20, type=int)
    parser.add_argument("--alarming", type=Path, help="instead, only alarms into this folder")
    options = parser.parse_args()
    if options.alarming:
        alarm(options.alarming, options.alarms)
        return
    compare_shares(options.runs, options.seconds)
    count_clips(options.alarms)
    kill(options.kills)


if __name__ == "__main__":
    main()
