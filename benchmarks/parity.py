"""Compares `trajeval evaluate` with evo_ape and evo_rpe, number by number, on new pairs.

The pairs are those of tests/data/parity, generated anew from a seed. The programs run as processes
on the same files. The exit status is 1 if a number differs by more than the tolerance.

Usage: make parity, or make parity SEED=1 for the pairs of that seed
"""

from __future__ import annotations

import argparse
import io
import json
import os
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.process import CommandFailedError, environment, run

REFERENCES = Path(__file__).parents[1] / "tests" / "data" / "parity" / "references.json"
TRAJEVAL = Path(sys.executable).parent / "trajeval"
STATISTICS = ("rmse", "mean", "median", "std", "min", "max")
OURS = {
    "trans_part": "position_m",
    "angle_deg": "rotation_deg",
    "full": "full",
    "point_distance": "distance_m",
}
UNITS = {"trans_part": "m ", "angle_deg": "deg ", "full": "full ", "point_distance": "m "}
BOTH = ("trans_part", "angle_deg")
POSITION = ("trans_part",)
# evo's options, those of evo_rpe with a length; ours, with lines of a protocol file; and the
# errors to compare.
CALLS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "": (("--gauge", "none"), BOTH),
    "-a": (("--gauge", "se3"), BOTH),
    "-as": (("--gauge", "sim3"), POSITION),
    "-s": (("--gauge", "sim3", "apply: scale"), POSITION),
    "--align_origin": (("--gauge", "se3", "--align-states", "1"), POSITION),
    "-d 5 -u f": (("--gauge", "none", "--lengths", "5f"), ("full",)),
    "-d 8 -u m": (("--gauge", "none", "--lengths", "8"), ("point_distance",)),
    "-d 5 -u d --all_pairs": (
        ("--gauge", "none", "--lengths", "5deg", "sub_trajectories: all"),
        ("angle_deg",),
    ),
}
COLUMNS = tuple((name, error) for name, (_, errors) in CALLS.items() for error in errors)
WITHHELD, BOTH_REFUSE, ONE_REFUSES = "withheld", "both refuse", "one refuses"
NOT_COMPARED = {WITHHELD: "- ", BOTH_REFUSE: "refused ", ONE_REFUSES: "refused!"}

Numbers = dict[str, float]


def program_of(options: str) -> str:
    """Return which of evo's programs has these options."""
    return "evo_rpe" if "-d" in options.split() else "evo_ape"


@dataclass(frozen=True)
class Difference:
    """The worst statistic of one error of one pair; `share` is of the tolerance."""

    pair: str
    options: str
    error: str
    statistic: str
    computed: float
    evos: float
    share: float

    def __str__(self) -> str:
        """Say it in one line."""
        return (
            f"{self.pair}, {program_of(self.options)} {self.options} -r {self.error}, "
            f"{self.statistic}: "
            f"{self.computed!r} here, {self.evos!r} by evo, {self.share:.2g} of the tolerance"
        )


@dataclass(frozen=True)
class Programs:
    """Both programs and where they work."""

    evo_ape: Path
    folder: Path
    environment: Mapping[str, str]

    def evo(self, files: Mapping[str, str], options: str, error: str) -> Numbers | str:
        """Return evo's statistics and number of pairs, or what it says where it refuses."""
        kind = "kitti" if files["groundtruth"].startswith("car_kitti") else "tum"
        with tempfile.TemporaryDirectory() as kept:
            archive = Path(kept, "result.zip")
            command = [
                *(str(self.evo_ape.with_name(program_of(options))), kind),
                *(*self._paths(files), *options.split()),
                *("-r", error, "--save_results", str(archive), "--no_warnings"),
            ]
            try:
                run(command, self.environment)
            except CommandFailedError as failed:
                return str(failed)
            with zipfile.ZipFile(archive) as result:
                numbers: Numbers = json.loads(result.read("stats.json"))
                errors = np.load(io.BytesIO(result.read("error_array.npy")))
        return {**numbers, "count": len(errors)}

    def computed(self, files: Mapping[str, str], options: str) -> dict[str, Any] | str:
        """Return our errors by metric, or what we say where we refuse."""
        groundtruth, estimate = self._paths(files)
        given = CALLS[options][0]
        in_file = [item for item in given if ": " in item]
        # Its name is the protocol's. Several calls run at a time.
        protocol = Path(tempfile.mkdtemp(dir=self.folder)) / "evo.yaml"
        gauge = given[given.index("--gauge") + 1]
        lines = ["base: evo", f"gauge: {gauge}", *in_file, ""]
        protocol.write_text("\n".join(lines), encoding="utf-8")
        command = [
            *(str(TRAJEVAL), "evaluate", "-g", groundtruth, "-e", estimate, "--quiet"),
            *("--protocol", str(protocol) if in_file else "evo", "--json", "-"),
            *(item for item in given if item not in in_file),
        ]
        try:
            output = run(command, self.environment).output
        except CommandFailedError as failed:
            return str(failed)
        run_found = json.loads(output)["runs"][0]
        errors: dict[str, Any] = run_found["ate"]
        if program_of(options) == "evo_rpe":
            (errors,) = run_found["re"]["segments"]
        return errors

    def _paths(self, files: Mapping[str, str]) -> tuple[str, str]:
        return str(self.folder / files["groundtruth"]), str(self.folder / files["estimate"])


def tolerance(pair: str, options: str, error: str, value: float) -> float:
    """Return by how much two correct programs may differ: see `Row.tolerance` of the tests."""
    usual = max(1e-8 * abs(value), 1e-10)
    if not error.startswith("angle") and pair.startswith("utm"):
        # A float64 step at 5e6 m is 9.3e-10 m. If the estimate has such coordinates, too, evo
        # rounds three products and three sums of each coordinate by at most half a step.
        return max(usual, 3**0.5 * 6 * 4.7e-10 if pair == "utm_both" else 3e-9)
    if pair == "straight_flat" and (error == "trans_part" or options == "-a"):
        # Straight to 1 cm over 240 m: so far positions determine the rotation about the line,
        # which moves poses that are 5 cm beside it.
        rotation = 16.0 * 2.0**-52 * (240.0**2 / 12.0) / 0.01**2
        return max(usual, 0.05 * rotation) if error == "trans_part" else np.degrees(rotation)
    if pair == "car_kitti" and options == "--align_origin":
        # evo turns all poses by the file's first matrices, which are rotations to 1e-9: 1 km from
        # the first pose that is 1e-6 m.
        return max(usual, 1e-6)
    if pair == "car_kitti" and options == "-d 5 -u f":
        return max(usual, 2e-9 * 15.0)  # the same, of steps of at most 15 m
    return usual


def compare(
    pair: str, column: tuple[str, str], computed: dict[str, Any] | str, evos: Numbers | str
) -> Difference | str:
    """Return the worst difference, or why there is none to tell."""
    options, error = column
    if isinstance(evos, str) and isinstance(computed, dict) and computed[OURS[error]] is None:
        return BOTH_REFUSE  # no two states are so far apart
    if isinstance(computed, str) or isinstance(evos, str):
        if isinstance(computed, str) and isinstance(evos, str):
            return BOTH_REFUSE
        refused = computed if isinstance(computed, str) else str(evos)
        return f"{ONE_REFUSES}: {refused}"
    mine = computed[OURS[error]]
    if mine is None:
        return WITHHELD
    if mine["count"] != evos["count"]:
        counts = float(mine["count"]), float(evos["count"])
        return Difference(pair, options, error, "number of pairs", *counts, float("inf"))
    return max(
        (
            Difference(
                *(pair, options, error, name, mine[name], evos[name]),
                abs(mine[name] - evos[name]) / tolerance(pair, options, error, evos[name]),
            )
            for name in STATISTICS
        ),
        key=lambda item: item.share,
    )


def compare_pair(
    programs: Programs, pair: str, files: Mapping[str, str]
) -> dict[tuple[str, str], Difference | str]:
    """Run both programs with all options on one pair."""
    result: dict[tuple[str, str], Difference | str] = {}
    for options, (_, errors) in CALLS.items():
        actual = programs.computed(files, options)
        for error in errors:
            evos = programs.evo(files, options, error)
            result[options, error] = compare(pair, (options, error), actual, evos)
    return result


def cell(outcome: Difference | str) -> str:
    """Return the difference, with a mark where it is more than the tolerance."""
    if isinstance(outcome, str):
        return NOT_COMPARED[outcome.partition(":")[0]]
    mark = " " if outcome.share <= 1.0 else "!"
    return f"{abs(outcome.computed - outcome.evos):.1e}{mark}"


def report(
    console: Console, results: Mapping[str, Mapping[tuple[str, str], Difference | str]]
) -> bool:
    """Print the table and the worst; return whether all is within the tolerance."""
    table = Table(box=box.SIMPLE_HEAD, padding=0, collapse_padding=True)
    table.add_column("pair", no_wrap=True, min_width=max(map(len, results)))
    for options, error in COLUMNS:
        heading = f"{options.removeprefix('--align_') or 'none'}\n{UNITS[error]}"
        table.add_column(heading, justify="right", no_wrap=True, min_width=9)
    for pair, result in results.items():
        table.add_row(pair, *(cell(result[column]) for column in COLUMNS))
    console.print("largest difference by pair and evo's options; ! too much, - withheld")
    console.print(table)
    flat = [(pair, item) for pair, result in results.items() for item in result.values()]
    differences = [item for _, item in flat if isinstance(item, Difference)]
    refusals = [
        f"{pair}: {item}"
        for pair, item in flat
        if isinstance(item, str) and item.startswith(ONE_REFUSES)
    ]
    withheld = sum(item == WITHHELD for _, item in flat)
    console.print(f"{len(differences)} sets of {len(STATISTICS)} statistics compared")
    console.print(f"{withheld} rotation errors withheld: on an exact line nothing determines them")
    console.print(f"worst: {max(differences, key=lambda difference: difference.share)}")
    wrong = [
        str(difference) for difference in differences if not difference.share <= 1.0
    ] + refusals
    for item in wrong:
        console.print(f"DIFFERS: {item}")
    return not wrong


def main() -> int:
    """Generate, run, compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--evo", required=True, type=Path, help="the program evo_ape")
    parser.add_argument("--seed", type=int, default=int(time.time()), help="of the pairs")
    options = parser.parse_args()
    console = Console(soft_wrap=True)
    console.print(f"seed {options.seed}; the same again: make parity SEED={options.seed}")
    pairs: dict[str, dict[str, str]] = json.loads(REFERENCES.read_text(encoding="utf-8"))["pairs"]
    # evo reads no KITTI file with 13 columns.
    pairs = {name: files for name, files in pairs.items() if not name.endswith("_frames")}
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as home:
        generator = [sys.executable, "-m", "benchmarks.parity_pairs", folder, str(options.seed)]
        subprocess.run(generator, check=True)
        alone = {**environment(Path(home)), "OPENBLAS_NUM_THREADS": "1"}
        programs = Programs(options.evo, Path(folder), alone)
        run([str(options.evo), "--help"], programs.environment)  # writes its settings
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            jobs = {
                name: pool.submit(compare_pair, programs, name, files)
                for name, files in pairs.items()
            }
            results = {name: job.result() for name, job in jobs.items()}
    return 0 if report(console, results) else 1


if __name__ == "__main__":
    sys.exit(main())
