"""Whether two trees of this package give equal numbers on real recordings, and what they cost.

python -m benchmarks.same_numbers DATA BEFORE [--tolerance 1e-12]

DATA has the recordings (euroc, tum, kitti, ...). BEFORE is a checkout, of a release for example.
Both trees run in this environment. Numbers in parts that only one tree writes are not compared.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import statistics
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.process import Cost, run

ROOT = Path(__file__).resolve().parents[1]
STEREO_INERTIAL = ["--modality", "stereo-inertial"]
COVARIANCES = "euroc/openvins/MH_01_with_covariance.csv"
# Keys whose values are of a tree or of a machine, not of the trajectories.
_SKIPPED = {"version", "schema", "created", "sha256", "provenance", "diagnosis", "findings"}


def evaluations() -> Iterator[tuple[str, str, list[str]]]:
    """Yield groundtruth, estimate and options of every evaluation; paths below DATA."""
    for sequence in ("MH_01", "MH_05", "V2_03"):
        truth = f"euroc/groundtruth/{sequence}.txt"
        for trial in range(10):
            yield truth, f"euroc/vislam_ba/{sequence}_trial{trial}.txt", STEREO_INERTIAL
        yield truth, f"euroc/vio_mono/{sequence}.txt", ["--modality", "mono-inertial"]
    truth, estimate = "euroc/groundtruth/MH_01.txt", "euroc/vislam_ba/MH_01_trial0.txt"
    for options in (
        ["--protocol", "evo"],
        ["--protocol", "rpg", *STEREO_INERTIAL],
        ["--protocol", "ov_eval"],
        ["--association", "nearest", *STEREO_INERTIAL],
        ["--association", "continuous", *STEREO_INERTIAL],
        ["--time-offset", "auto", "--hand-eye", "auto", *STEREO_INERTIAL],
        ["--align-states", "1,25%,all", *STEREO_INERTIAL],
        ["--lengths", "1s,10f,10%", *STEREO_INERTIAL],
        ["--gauge", "none"],
        ["--gauge", "sim3"],
    ):
        yield truth, estimate, options
    yield truth, "euroc/vins_mono/MH_01.csv", ["--modality", "mono-inertial"]
    yield truth, COVARIANCES, STEREO_INERTIAL
    first = ["--gauge", "yaw", "--align-states", "1"]
    yield truth, COVARIANCES, [*first, "--covariance", "message"]
    desk = "tum/fr2_desk_groundtruth.txt", "tum/fr2_desk_ORB.txt"
    yield *desk, ["--modality", "mono"]
    yield *desk, ["--modality", "rgbd"]
    loop = "kitti/KITTI_00_gt.txt", "kitti/KITTI_00_ORB.txt"
    yield *loop, ["--modality", "mono"]
    odometry = "kitti_odom_eval/09_groundtruth.txt", "kitti_odom_eval/09_full.txt"
    yield *odometry, ["--protocol", "kitti"]
    yield *odometry, ["--modality", "mono"]
    for name in ("hdl", "svo2"):
        yield "hilti_2021/Campus_2_prism.txt", f"hilti_2021/Campus_2_{name}.txt", []
    yield "hilti_2021/uzh_run2_mocap.txt", "hilti_2021/uzh_run2_hdl.txt", ["--modality", "lidar"]
    husky = "gnss/husky_outdoor.bag"
    wheels = f"{husky}:/husky_velocity_controller/odom"
    yield f"{husky}:/fix", wheels, ["--modality", "wheel"]
    yield f"{husky}:/fix", wheels, ["--gauge", "yaw", "--lever-arm", "0,0,1"]


def numbers(value: Any, path: str = "") -> Iterator[tuple[str, float | None]]:
    """Yield the paths and values of all numbers, also of those that are withheld."""
    if isinstance(value, dict):
        for key, part in value.items():
            if key not in _SKIPPED:
                yield from numbers(part, f"{path}/{key}")
    elif isinstance(value, list):
        for index, part in enumerate(value):
            yield from numbers(part, f"{path}/{index}")
    elif value is None or (isinstance(value, int | float) and not isinstance(value, bool)):
        yield path, value


def evaluated(tree: Path, data: Path, case: tuple[str, str, list[str]]) -> tuple[Cost, Any]:
    """Return what an evaluation by a tree cost, and its result; raise if it fails."""
    truth, estimate, options = case
    command = [sys.executable, "-m", "trajeval_ros", "evaluate", "--json", "-", *options]
    sources = ["-g", str(data / truth), "-e", str(data / estimate)]
    environment = {**os.environ, "PYTHONPATH": str(tree), "PYTHONSAFEPATH": "1"}
    cost = run([*command, *sources], environment)
    return cost, json.loads(cost.output)


def differences(before: Any, after: Any, tolerance: float) -> tuple[int, list[str]]:
    """Return how many numbers both have, and a line for every one that differs."""
    earlier, lines, common = dict(numbers(before)), [], 0
    for path, value in numbers(after):
        if path not in earlier:
            continue
        common, other = common + 1, earlier[path]
        equal = value == other
        if value is not None and other is not None:
            equal = math.isclose(value, other, rel_tol=tolerance, abs_tol=tolerance)
        if not equal:
            lines.append(f"    {path}: {other} before, {value} now")
    return common, lines


def main() -> int:
    """Print a line per evaluation and the numbers that differ; return 1 if any does."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", type=Path, metavar="DATA")
    parser.add_argument("before", type=Path, metavar="BEFORE")
    parser.add_argument("--tolerance", type=float, default=1e-12, help="relative, and in m or deg")
    options = parser.parse_args()
    ratios, failed, total = [], 0, 0
    for case in evaluations():
        (cost, old), (cost_now, new) = (
            evaluated(tree.resolve(), options.data.resolve(), case)
            for tree in (options.before, ROOT)
        )
        common, lines = differences(old["runs"], new["runs"], options.tolerance)
        ratios.append(cost_now.cpu_s / cost.cpu_s)
        failed, total = failed + bool(lines), total + common
        words = " ".join([Path(case[0]).name, Path(case[1]).name, *case[2]])
        print(f"{ratios[-1]:5.2f} CPU, {len(lines)} of {common} differ: {words}", flush=True)
        print("\n".join(lines[:5]) + "\n" * bool(lines), end="")
    print(
        f"{len(ratios)} evaluations, {total} numbers, {failed} evaluations differ; "
        f"CPU {statistics.median(ratios):.2f} (median), {max(ratios):.2f} at most"
    )
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
