"""evo, run as a program: python adapters/run_evo.py [PATH/evo_ape] > evo.json.

It runs `evo_ape` and `evo_rpe` some 400 times, one second of CPU time each.
"""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import tempfile
import zipfile
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from common import Answers, absolute_alignments, cases, print_result

STATISTICS = ("rmse", "mean", "median", "max")
RELATIONS = {"position_m": "trans_part", "rotation_deg": "angle_deg"}
OPTIONS = {
    "none": [],
    "se3": ["-a"],
    "sim3": ["-as"],
    "se3_first_1": ["--align_origin"],
    "se3_first_10": ["-a", "--n_to_align", "10"],
    "nearest:none": ["--t_max_diff", "0.02"],
    "nearest:se3": ["--t_max_diff", "0.02", "-a"],
}
# 1 s are 16 steps of these cases.
RELATIVE = ["-d", "16", "-u", "f", "--all_pairs"]


def call(program: str, folder: Path, options: list[str], relation: str) -> Any:
    """Return evo's statistics with the number of errors and the scale, or what it printed."""
    with tempfile.TemporaryDirectory() as home:
        archive = Path(home, "result.zip")
        files = [str(folder / f"{side}.txt") for side in ("groundtruth", "estimate")]
        command = [program, "tum", *files, *options, "-r", relation]
        done = subprocess.run(
            [*command, "--save_results", str(archive), "--no_warnings"],
            env={**os.environ, "HOME": home, "MPLBACKEND": "agg"},
            capture_output=True,
            text=True,
        )
        if not archive.exists():
            return (done.stderr + done.stdout).strip().splitlines()[-1]
        with zipfile.ZipFile(archive) as result:
            statistics = json.loads(result.read("stats.json"))
            statistics["pairs"] = _rows(result.read("error_array.npy"))
            if "alignment_transformation_sim3.npy" in result.namelist():
                matrix = _floats(result.read("alignment_transformation_sim3.npy"))
                statistics["scale"] = sum(matrix[4 * i] ** 2 for i in range(3)) ** 0.5
            return statistics


def _floats(content: bytes) -> list[float]:
    """Return the numbers of a .npy file; numpy comes with evo."""
    import numpy

    return [float(item) for item in numpy.load(io.BytesIO(content)).ravel()]


def _rows(content: bytes) -> int:
    return len(_floats(content))


def answer(program: str, folder: Path, quantities: list[str]) -> Answers:
    """Return the numbers of one case."""
    answers: Answers = {}
    calls = [
        (kind, metric, program, OPTIONS[kind])
        for kind in sorted(absolute_alignments(quantities) & OPTIONS.keys())
        for metric in RELATIONS
    ]
    if quantities[0].startswith("relative"):
        rpe = program.replace("evo_ape", "evo_rpe")
        calls = [("relative", metric, rpe, RELATIVE) for metric in RELATIONS]
    for kind, metric, name, options in calls:
        found = call(name, folder, options, RELATIONS[metric])
        rule, _, alignment = kind.rpartition(":")
        prefix = f"{rule}:" if rule else ""
        for statistic in STATISTICS:
            value = found if isinstance(found, str) else found[statistic]
            if kind == "relative":
                answers[f"relative.{metric}.se3.1s.{statistic}"] = value
            else:
                answers[f"{prefix}{metric}.{alignment}.{statistic}"] = value
        if kind == "sim3":
            answers["scale.sim3"] = found if isinstance(found, str) else found.get("scale")
        if kind == "nearest:none":
            answers["nearest:pairs"] = found if isinstance(found, str) else found["pairs"]
    return {quantity: answers[quantity] for quantity in quantities if quantity in answers}


def main(program: str) -> None:
    """Run the cases, as many at a time as there are processors."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        made = {
            folder: pool.submit(answer, program, folder, quantities)
            for folder, quantities in cases()
        }
        try:
            name = version("evo")
        except PackageNotFoundError:
            name = ""
        print_result("evo", name, lambda folder, _: made[folder].result())


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else str(Path(sys.executable).with_name("evo_ape")))
