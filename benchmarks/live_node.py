"""CPU, losses and latency of the live node, over DDS from another process.

Usage: make bench-live; needs .venv-ros. Traffic stays on the loopback interface.
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
from pathlib import Path

HERE = Path(__file__).parent
SETTLE_S = 4.0
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


def cpu_s(pid: int) -> float:
    """Return the CPU seconds that a process has used, children apart."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(
    groundtruth_hz: int, odometry_hz: int, estimates: int, seconds: float
) -> dict[str, float]:
    """Return what one run of the node took: percent of a core, losses, latency."""
    variables = environment()
    topics = [f"/vio_{number}/odometry" for number in range(estimates)]
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "out"
        node = subprocess.Popen(
            [
                sys.executable, "-m", "trajeval_ros", "evaluator", "--ros-args",
                "-p", "groundtruth_topic:=/groundtruth/pose",
                "-p", f"estimate_topics:=[{','.join(topics)}]",
                "-p", f"output:={output}",
            ],
            env=variables, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        rates = [str(groundtruth_hz), str(odometry_hz), str(SETTLE_S + seconds + 1.0)]
        traffic = subprocess.Popen(
            [sys.executable, str(HERE / "publish_traffic.py"), *rates, *topics],
            env=variables, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        while not any(path.stat().st_size > 10_000 for path in output.glob("*.pairs")):
            time.sleep(0.05)
        time.sleep(SETTLE_S)
        before, begin = cpu_s(node.pid), time.monotonic()
        time.sleep(seconds)
        share = (cpu_s(node.pid) - before) / (time.monotonic() - begin)
        sent = [int(each) for each in traffic.communicate()[0].split()]
        time.sleep(0.5)
        node.send_signal(signal.SIGINT)
        node.wait()
        result = json.loads((output / "result.json").read_text())
    live = [run["live"] for run in result["runs"]]
    received = result["groundtruth"]["poses"] + result["runs"][0]["estimate"]["poses"]
    return {
        "cpu_percent": 100.0 * share,
        "lost": sum(sent) - received,
        "latency_p95_ms": 1e3 * max(each["latency_p95_s"] for each in live),
    }


def main() -> None:
    """Measure each load several times, and print the medians."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", default=3, type=int, help="the median counts")
    parser.add_argument("--seconds", default=15.0, type=float, help="measured, each time")
    options = parser.parse_args()
    print(f"load average {os.getloadavg()[0]:.2f} on {os.cpu_count()} cores")
    for groundtruth_hz, odometry_hz, estimates, limit in LOADS:
        found = [
            measure(groundtruth_hz, odometry_hz, estimates, options.seconds)
            for _ in range(options.runs)
        ]
        median = {key: statistics.median(each[key] for each in found) for key in found[0]}
        allowed = f" (of {limit:g})" if limit else ""
        print(
            f"groundtruth {groundtruth_hz} Hz, {estimates} x odometry {odometry_hz} Hz: "
            f"{median['cpu_percent']:.1f} %{allowed} of a core, "
            f"{max(each['lost'] for each in found):.0f} lost at most, "
            f"latency p95 {median['latency_p95_ms']:.1f} ms",
            flush=True,
        )


if __name__ == "__main__":
    main()
