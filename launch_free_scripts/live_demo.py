#!/usr/bin/env python3
"""See it at work: a simulated flight, evaluated live over real DDS, drawn in Rerun.

    live_demo.py [FOLDER]

The evaluator is a process, the replay of the flight another. At the end the live result stands
beside that of the recording. `make demo` makes a Python that has rclpy; without one, as off Linux
on x86-64, the recording alone is evaluated.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

try:
    from trajeval_ros.exceptions import TrajevalError
    from trajeval_ros.viewer.screenshot import save_png
except ModuleNotFoundError as missing:
    print(f"{missing}; run `make demo`, which has what it takes", file=sys.stderr)
    sys.exit(2)

GROUNDTRUTH, ESTIMATE = "/groundtruth/pose", "/vio/odometry"
MODALITY = "stereo-inertial"
RATE = "5"
PATIENCE_S = 60.0
COMPARED: dict[str, tuple[Any, ...]] = {
    "pairs": ("association", "pairs"),
    "position ATE [m]": ("ate", "position_m", "rmse"),
    "rotation ATE [deg]": ("ate", "rotation_deg", "rmse"),
    "error after 40 m [%]": ("re", "segments", -1, "position_percent", "mean"),
}


def main() -> int:
    """Run all of it; returns the exit status."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "demo_output").resolve()
    bag, live, recorded = folder / "flight", folder / "live", folder / "recorded"
    for each in (live, recorded):
        shutil.rmtree(each, ignore_errors=True)
    heading("a flight, and an odometry that drifts")
    print(quietly("simulate", str(bag), "--overwrite").splitlines()[0])
    has_ros = find_spec("rclpy") is not None
    if has_ros:
        heading("live: the flight is replayed five times as fast as it was flown")
        evaluate_live(bag, live)
        heading("recorded: the same bag, evaluated at once")
    else:
        heading("recorded: there is no rclpy here, so nothing is evaluated live")
    options = ["--quiet"] if has_ros else []
    trajeval(
        "evaluate", "--groundtruth", f"{bag}:{GROUNDTRUTH}", "--estimate", f"{bag}:{ESTIMATE}",
        "--modality", MODALITY, "--output", str(recorded), *options,
    )  # fmt: skip
    if has_ros:
        compare(live / "result.json", recorded / "result.json")
    heading("is an estimator as sure as it should be? One that states its covariances")
    judge(folder / "certain_flight", folder / "certainty")
    return show((live if has_ros else recorded) / "run.rrd", folder)


def evaluate_live(bag: Path, live: Path) -> None:
    """Replay the bag to the node, and end with the node if it fails."""
    node = begin(
        "evaluator", "--ros-args",
        "-p", f"groundtruth_topic:={GROUNDTRUTH}",
        "-p", f"estimate_topics:=[{ESTIMATE}]",
        "-p", f"modality:={MODALITY}",
        "-p", f"output:={live}",
        "-p", "rerun:=file",
    )  # fmt: skip
    try:
        # Quietly: the terminal's last line is the node's.
        quietly("replay", str(bag), "--rate", RATE, "--wait-for-subscribers", "60")
        node.send_signal(signal.SIGINT)
        status = node.wait(PATIENCE_S)
    finally:
        node.kill()
    if status:
        sys.exit(status)


def compare(live: Path, recorded: Path) -> None:
    """Print numbers of both results, side by side."""
    runs = [json.loads(each.read_text())["runs"][0] for each in (live, recorded)]
    print(f"{'':20}{'live':>14}{'recorded':>14}")
    for label, path in COMPARED.items():
        values = [number(run, path) for run in runs]
        print(f"{label:20}" + "".join(f"{each:14.6g}" for each in values))


def number(run: dict[str, Any], path: tuple[Any, ...]) -> float:
    """Return a number of a run by its path."""
    value: Any = run
    for each in path:
        value = value[each]
    return float(value)


def judge(bag: Path, output: Path) -> None:
    """Evaluate a visual-inertial estimator, its covariance included."""
    quietly("simulate", str(bag), "--profile", "euroc", "--duration", "30", "--overwrite")
    trajeval(
        "evaluate", "--groundtruth", f"{bag}:{GROUNDTRUTH}", "--estimate", f"{bag}:{ESTIMATE}",
        "--modality", MODALITY, "--covariance", f"{bag}.npz", "--lengths", "none",
        "--output", str(output),
    )  # fmt: skip


def show(picture: Path, folder: Path) -> int:
    """Put picture and first screen where they are found, and say how to see more."""
    heading("picture")
    if not picture.exists():
        print("there is no picture: it has been said above what it lacks", file=sys.stderr)
        return 1
    shutil.copy(picture, folder / "run.rrd")
    try:
        save_png(picture, folder / "rerun.png")
        print(f"{folder / 'rerun.png'} is the first screen")
    except TrajevalError as error:
        print(f"there is no rerun.png: {error}", file=sys.stderr)
    print(f"to see it move: {sys.executable} -m trajeval_ros view {folder / 'run.rrd'}")
    return 0


def trajeval(*arguments: str) -> None:
    """Run a verb, and end with it if it fails."""
    status = begin(*arguments).wait()
    if status:
        sys.exit(status)


def quietly(*arguments: str) -> str:
    """Run a verb, and return what it would print; if it fails, print that and end."""
    process = begin(*arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    out, err = process.communicate()
    if process.returncode:
        sys.stderr.write(err)
        sys.exit(process.returncode)
    return str(out)


def begin(*arguments: str, **options: Any) -> subprocess.Popen[Any]:
    """Begin a verb in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        [sys.executable, "-m", "trajeval_ros", *arguments], env=environment, **options
    )


def heading(words: str) -> None:
    """Print a line that stands out."""
    print(f"\n--- {words}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
