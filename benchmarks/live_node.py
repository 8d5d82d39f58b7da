"""CPU, losses and latency of the live node, over DDS from another process.

Usage: make bench-live, or BENCH="--soak 2". Traffic stays on the loopback
interface.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.publish_traffic import MARKER_M
from trajeval_ros.geometry.valid_poses import add_counts, reasons

HERE = Path(__file__).parent
SETTLE_S = 4.0
ENOUGH = 10_000  # bytes of states, after which it is in full swing
SOAK_SPEED = 20.0
UNTIL_ENDED_S = 3600.0
# Groundtruth Hz, odometry Hz, estimates, busy processes; at most: milliseconds from stamp to
# published error (95th percentile), and seconds from one published ATE to the next.
FRESHNESS = (
    (200, 200, 1, 0, 60.0, 0.5),
    (1000, 1000, 1, 0, 120.0, 0.5),
    (200, 200, 1, 4, None, 0.5),
    (200, 200, 5, 4, None, 1.0),
)
# Groundtruth Hz, odometry Hz, number of estimates, and what of a core it may take.
LOADS = ((1000, 200, 1, 40.0), (200, 20, 1, 12.0), (200, 20, 4, None))


def environment() -> dict[str, str]:
    """Return what keeps the traffic on this machine."""
    return {
        **os.environ,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_DOMAIN_ID": os.environ.get("ROS_DOMAIN_ID", "93"),
        "ROS_HOME": tempfile.mkdtemp(prefix="ros_home_"),
        "PYTHONPATH": str(HERE.parent),
    }


def resident_mb(pid: int) -> float:
    """Return the resident memory of a process, without what it shares with others."""
    fields = Path(f"/proc/{pid}/statm").read_text().split()
    return (int(fields[1]) - int(fields[2])) * os.sysconf("SC_PAGE_SIZE") / 1e6


def cpu_s(pid: int) -> float:
    """Return the CPU seconds that a process has used, children apart."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def running(
    groundtruth_hz: float,
    topics: Mapping[str, float],
    seconds: float,
    speed: float = 1.0,
    rerun: str = "none",
    *,
    field: bool = False,
) -> Iterator[tuple[subprocess.Popen[str], subprocess.Popen[str], Path]]:
    """Run the node and its traffic; yield both, once states are stored, and the folder."""
    variables = environment()
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "out"
        more = _in_the_field(Path(folder)) if field else []
        node = subprocess.Popen(
            [
                sys.executable, "-m", "trajeval_ros", "evaluator", "--ros-args",
                "-p", "groundtruth_topic:=/groundtruth/pose",
                "-p", f"estimate_topics:=[{','.join(topics)}]",
                "-p", f"output:={output}",
                "-p", f"rerun:={rerun}",
                *more,
            ],
            env=variables, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        numbers = [str(item) for item in (groundtruth_hz, seconds, speed)]
        published = [f"{topic}@{hz}" for topic, hz in topics.items()]
        numbers = ["--field", *numbers] if field else numbers
        traffic = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.publish_traffic", *numbers, *published],
            env=variables, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            while not any(path.stat().st_size > ENOUGH for path in output.glob("*.states")):
                if node.poll() is not None or traffic.poll() is not None:
                    raise RuntimeError("the node or its traffic has ended early")
                time.sleep(0.05)
            yield node, traffic, output
        finally:
            for process in (traffic, node):
                process.kill()
                process.wait()


def measure(
    groundtruth_hz: int, odometry_hz: int, estimates: int, seconds: float, rerun: str
) -> dict[str, float]:
    """Return what one run of the node took: percent of a core, losses, latency, picture."""
    topics = dict.fromkeys((f"/vio_{index}/odometry" for index in range(estimates)), odometry_hz)
    length_s = SETTLE_S + seconds + 1.0
    with running(groundtruth_hz, topics, length_s, rerun=rerun) as (node, traffic, output):
        time.sleep(SETTLE_S)
        before, begin = cpu_s(node.pid), time.monotonic()
        time.sleep(seconds)
        share = (cpu_s(node.pid) - before) / (time.monotonic() - begin)
        sent = [int(word) for word in traffic.communicate()[0].split()]
        time.sleep(0.5)
        node.send_signal(signal.SIGINT)
        node.wait()
        result = json.loads((output / "result.json").read_text())
        picture = output / "run.rrd"
        size = picture.stat().st_size if picture.exists() else 0
    live = [run["live"] for run in result["runs"]]
    received = result["groundtruth"]["poses"] + result["runs"][0]["estimate"]["poses"]
    return {
        "cpu_percent": 100.0 * share,
        "lost": sum(sent[:2]) - received,
        "latency_p95_ms": 1e3 * max(item["latency_p95_s"] for item in live),
        "picture_kb_per_s": size / length_s / 1e3,
    }


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """Keep cores busy."""
    command = [sys.executable, "-c", "while True: pass"]
    running_ = [subprocess.Popen(command) for _ in range(processes)]
    try:
        yield
    finally:
        for item in running_:
            item.kill()
            item.wait()


def freshness(seconds: float) -> None:
    """Print how old published errors are, as another process receives them, and the CPU."""
    for groundtruth_hz, hz, estimates, processes, stamped_ms, ate_s in FRESHNESS:
        topics = dict.fromkeys((f"/vio_{index}/odometry" for index in range(estimates)), hz)
        names = [topic.strip("/").replace("/", "_") for topic in topics]
        command = [sys.executable, "-m", "benchmarks.listen_errors", str(seconds), *names]
        with (
            busy(processes),
            running(groundtruth_hz, topics, UNTIL_ENDED_S) as (node, _, _),
            subprocess.Popen(
                command, env=environment(), stdout=subprocess.PIPE, text=True
            ) as listener,
        ):
            before, begin = cpu_s(node.pid), time.monotonic()
            result = json.loads(listener.communicate()[0])
            share = (cpu_s(node.pid) - before) / (time.monotonic() - begin)
        limit = f" (limit {stamped_ms:g})" if stamped_ms else ""
        print(
            f"groundtruth {groundtruth_hz} Hz, {estimates} x odometry {hz} Hz, {processes} busy "
            f"processes: stamp to published error median {result['p50_ms']:.0f} ms, p95 "
            f"{result['p95_ms']:.0f} ms{limit}, largest {result['max_ms']:.0f} ms; ATE at most "
            f"{result['oldest_ate_s']:.2f} s old (limit {ate_s:g}); {100 * share:.1f} % of a core",
            flush=True,
        )


def _in_the_field(folder: Path) -> list[str]:
    """Return what of the node's parameters makes it do the most; a file is written for it."""
    marker = {
        "header": {"frame_id": "base_link"},
        "child_frame_id": "marker",
        "transform": {
            "translation": dict(zip("xyz", MARKER_M, strict=True)),
            "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        },
    }
    file = folder / "marker.yaml"
    file.write_text(json.dumps(marker))
    values = {
        "gauge": "yaw",
        "hand_eye": file,
        "covariance": "message",
        "groundtruth_noise": "'0.01,0.1'",
        "on_restart": "reset",
        "max_delay": 10.0 * SOAK_SPEED,  # of stamps
        "window": "60s",
    }
    return [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]


def result_of(folder: Path) -> Any:
    """Return the result of a run, which another process may still write."""
    file, until = folder / "result.json", time.monotonic() + 300.0
    while not file.exists() and time.monotonic() < until:
        time.sleep(0.5)
    return json.loads(file.read_text())


def soak(hours: float, speed: float) -> None:
    """Print the resident memory of a long run at every tenth of it, and what was lost.

    The run has all of the field: a marker body, covariances, restarts and two estimates.
    """
    seconds = 3600.0 * hours
    topics = {"/vio/odometry": 20.0, "/slam/odometry": 10.0}
    with running(200, topics, seconds, speed, field=True) as (node, traffic, output):
        begin, sizes = time.monotonic(), []
        for tenth in range(1, 11):
            time.sleep(max(0.0, begin + 0.098 * tenth * seconds / speed - time.monotonic()))
            sizes.append(resident_mb(node.pid))
            growth = 100.0 * (sizes[-1] / sizes[0] - 1.0)
            print(f"{10 * tenth} %: {sizes[-1]:.1f} MB, {growth:+.1f} %", flush=True)
        sent = [int(word) for word in traffic.communicate()[0].split()]
        time.sleep(2.0)
        node.send_signal(signal.SIGINT)
        node.wait()
        folders = sorted(output.parent.glob(f"{output.name}*"))
        runs = [run for folder in folders for run in result_of(folder)["runs"]]
    print(f"groundtruth: {sent[0]} messages, {runs[0]['live']['groundtruth_messages_lost']} lost")
    for topic, count in zip(topics, sent[1:], strict=True):
        own = [run for run in runs if run["estimate"]["source"] == topic]
        pairs = sum(run["association"]["pairs"] for run in own)
        dropped = add_counts(*(run["association"]["dropped"] for run in own))
        print(
            f"{topic}: {count} messages, {own[-1]['live']['messages_lost']} lost, {pairs} pairs "
            f"in {len(own)} runs, {reasons(dropped) or 'none'} dropped; position ATE up to "
            f"{max(run['ate']['position_m']['rmse'] for run in own):.4f} m"
        )
    print(f"load average {os.getloadavg()[0]:.1f}")


def main() -> None:
    """Measure each load several times, and print the medians."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", default=3, type=int, help="the median counts")
    parser.add_argument("--seconds", default=15.0, type=float, help="measured, each time")
    parser.add_argument(
        "--soak", type=float, metavar="HOURS", help="instead, the memory of so long a run at 20x"
    )
    parser.add_argument(
        "--rerun", default="none", help="the node's parameter: file draws a Rerun picture as well"
    )
    options = parser.parse_args()
    print(f"load average {os.getloadavg()[0]:.2f} on {os.cpu_count()} cores", flush=True)
    if options.soak:
        soak(options.soak, SOAK_SPEED)
        return
    for groundtruth_hz, odometry_hz, estimates, limit in LOADS:
        result = [
            measure(groundtruth_hz, odometry_hz, estimates, options.seconds, options.rerun)
            for _ in range(options.runs)
        ]
        median = {key: statistics.median(item[key] for item in result) for key in result[0]}
        allowed = f" (of {limit:g})" if limit else ""
        print(
            f"groundtruth {groundtruth_hz} Hz, {estimates} x odometry {odometry_hz} Hz: "
            f"{median['cpu_percent']:.1f} %{allowed} of a core, "
            f"{max(item['lost'] for item in result):.0f} lost at most, "
            f"latency p95 {median['latency_p95_ms']:.1f} ms, "
            f"picture {median['picture_kb_per_s']:.1f} kB/s",
            flush=True,
        )
    freshness(options.seconds)


if __name__ == "__main__":
    main()
