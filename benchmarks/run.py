"""Compares `trajeval evaluate` with evo, process by process, and times what evo has no like of.

Every round runs each command once, one after the other, so that what else the machine does
strikes all of them. Medians and their ratios go to the terminal and to results.json.

Usage: make bench BENCH="--sizes 10000,100000 --runs 3", or BENCH="--only online"
(or evo, limit, continuous, estimator, or bags, of which --scale 0.1 makes a tenth of 7 GB)
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.pair_paths import pair_paths
from benchmarks.process import KERNEL, Cost, environment, median_cost, run

HERE = Path(__file__).parent
BIN = Path(sys.executable).parent
SMALL = 1_000
PARTS = ("evo", "limit", "online", "continuous", "bags", "estimator")
CONTINUOUS = tuple(
    (work, count)
    for work in ("matern", "wnoa", "wnoj", "likelihood")
    for count in (10_000, 100_000)
)
TRAJEVAL = "trajeval"
EVO_POSITION = "evo_ape -a"
EVO_BOTH = "evo_ape -a, and angle"
BARE = "bare script"

Environment = Mapping[str, str]
Job = Callable[[Environment], Cost]


class DisagreementError(Exception):
    """Two programs that should compute the same number don't."""


@dataclass(frozen=True)
class Row:
    """A line of the result.

    Attributes:
        work: What was done, on how many poses.
        who: Which program did it.
        cost: Medians over the rounds.
        cpu_ratio: Its CPU time over ours on the same work; None for our own line.
        memory_ratio: Its peak memory over ours.
    """

    work: str
    who: str
    cost: Cost
    cpu_ratio: float | None = None
    memory_ratio: float | None = None


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--evo", required=True, type=Path, help="the program evo_ape")
    parser.add_argument("--oracles", required=True, type=Path, help="python that has GTSAM")
    parser.add_argument("--sizes", default="10000,100000,1000000", help="poses of the pairs")
    parser.add_argument("--runs", default=3, type=int, help="rounds; the median counts")
    parser.add_argument("--only", choices=PARTS, help="one part; all by default")
    parser.add_argument("--scale", default=1.0, type=float, help="size of the bags")
    parser.add_argument("--messages", default=1_000_000, type=int, help="of a live run")
    parser.add_argument("--data", default=HERE / "data", type=Path, help="for generated files")
    parser.add_argument("--results", default=HERE / "results.json", type=Path)
    return parser.parse_args()


def generate(folder: Path, count: int) -> tuple[Path, Path]:
    """Write a pair in a process of its own, so that this one stays small."""
    subprocess.run(
        [sys.executable, "-m", "benchmarks.tum_pairs", str(folder), str(count)], check=True
    )
    return pair_paths(folder, count)


def trajeval(groundtruth: Path, estimate: Path) -> Job:
    """Return our evaluation: position and rotation errors in one go."""
    command = [
        *(str(BIN / "trajeval"), "evaluate"),
        *("--groundtruth", str(groundtruth), "--estimate", str(estimate)),
        *("--protocol", "evo", "--gauge", "se3", "--lengths", "none", "--quiet", "--json", "-"),
    ]
    return lambda env: run(command, env)


def evo_position(evo_ape: Path, groundtruth: Path, estimate: Path) -> Job:
    """Return evo's evaluation of positions."""
    command = [str(evo_ape), "tum", str(groundtruth), str(estimate), "-a"]
    return lambda env: run(command, env)


def evo_both(evo_ape: Path, groundtruth: Path, estimate: Path) -> Job:
    """Return the two runs of evo that give positions and rotations."""
    position = evo_position(evo_ape, groundtruth, estimate)
    rotation = [str(evo_ape), "tum", str(groundtruth), str(estimate), "-a", "-r", "angle_deg"]
    return lambda env: position(env) + run(rotation, env)


def interleave(jobs: Mapping[str, Job], runs: int, env: Environment) -> dict[str, Cost]:
    """Run all jobs in turn, so many rounds; return each one's medians."""
    costs: dict[str, list[Cost]] = {name: [] for name in jobs}
    for _ in range(runs):
        for name, job in jobs.items():
            costs[name].append(job(env))
    return {name: median_cost(cost) for name, cost in costs.items()}


def check_agreement(computed: Cost, evos: Cost) -> None:
    """Make sure that both computed the same: a fast wrong answer is worth nothing."""
    ate = json.loads(computed.output)["runs"][0]["ate"]
    our_rmse = [ate["position_m"]["rmse"], ate["rotation_deg"]["rmse"]]
    evo_rmse = [float(item) for item in re.findall(r"^\s*rmse\s+(\S+)", evos.output, re.MULTILINE)]
    same = len(evo_rmse) == len(our_rmse) and all(
        abs(mine - theirs) <= 2e-6 for mine, theirs in zip(our_rmse, evo_rmse, strict=True)
    )
    if not same:  # evo prints six decimals
        raise DisagreementError(f"rmse of position and rotation: {our_rmse}, evo {evo_rmse}")


def compare_with_evo(options: argparse.Namespace, count: int, env: Environment) -> list[Row]:
    """Compare whole processes on a pair of so many poses."""
    pair = generate(options.data, count)
    costs = interleave(
        {
            TRAJEVAL: trajeval(*pair),
            EVO_POSITION: evo_position(options.evo, *pair),
            EVO_BOTH: evo_both(options.evo, *pair),
        },
        options.runs,
        env,
    )
    actual = costs[TRAJEVAL]
    check_agreement(actual, costs[EVO_BOTH])
    return rows_beside(f"ATE, {count // 1000}k poses", TRAJEVAL, costs)


def compare_startup(options: argparse.Namespace, env: Environment) -> list[Row]:
    """Compare the evaluation of a small pair with bare imports."""
    pair = generate(options.data, SMALL)
    imports = [sys.executable, "-c", "import numpy, scipy.spatial.transform"]
    costs = interleave(
        {"imports alone": lambda env: run(imports, env), TRAJEVAL: trajeval(*pair)},
        max(options.runs, 7),
        env,
    )
    return rows_beside(f"start, {SMALL // 1000}k poses", "imports alone", costs)


def compare_with_limit(options: argparse.Namespace, count: int, env: Environment) -> list[Row]:
    """Compare with a script that does nothing but compute the two numbers."""
    pair = generate(options.data, count)
    bare = [sys.executable, str(HERE / "limit.py"), *map(str, pair)]
    costs = interleave(
        {BARE: lambda env: run(bare, env), TRAJEVAL: trajeval(*pair)}, options.runs, env
    )
    ate = json.loads(costs[TRAJEVAL].output)["runs"][0]["ate"]
    for metric, theirs in json.loads(costs[BARE].output).items():
        actual = ate[metric]["rmse"]
        if abs(actual - theirs) > 1e-9 * theirs:
            raise DisagreementError(f"rmse of {metric}: {actual}, bare script {theirs}")
    return rows_beside(f"ATE, {count // 1000}k poses", BARE, costs)


def rows_beside(work: str, reference: str, costs: Mapping[str, Cost]) -> list[Row]:
    """Return a row for each, with ratios to one of them."""
    base = costs[reference]
    return [
        Row(work, who, cost)
        if who == reference
        else Row(work, who, cost, cost.cpu_s / base.cpu_s, cost.peak_mib / base.peak_mib)
        for who, cost in costs.items()
    ]


def relative_error_seconds(runs: int, env: Environment) -> dict[str, float]:
    """Time relative errors of five lengths inside a process; seconds by number of poses."""
    command = [sys.executable, "-m", "benchmarks.relative_error", str(max(runs, 7))]
    seconds: dict[str, float] = json.loads(run(command, env).output)
    return seconds


def online_costs(messages: int, env: Environment) -> list[dict[str, Any]]:
    """Time the live evaluator on so many messages, by window and rate of updates."""
    command = [sys.executable, "-m", "benchmarks.online", str(messages)]
    costs: list[dict[str, Any]] = json.loads(run(command, env).output)
    return costs


def evo_version(evo_ape: Path) -> str:
    """Ask evo's own environment which release it is."""
    code = "from importlib.metadata import version; print(version('evo'))"
    python = evo_ape.parent / "python"
    asked = subprocess.run([python, "-c", code], check=True, capture_output=True, text=True)
    return asked.stdout.strip()


def as_table(rows: list[Row]) -> Table:
    """Lay the rows out for the terminal."""
    table = Table("work", "program", box=box.SIMPLE_HEAD)
    for heading in ("CPU s", "x", "wall s", "peak MiB", "x"):
        table.add_column(heading, justify="right")
    for row in rows:
        table.add_row(
            row.work,
            row.who,
            f"{row.cost.cpu_s:.2f}",
            "" if row.cpu_ratio is None else f"{row.cpu_ratio:.2f}",
            f"{row.cost.wall_s:.2f}",
            f"{row.cost.peak_mib:.0f}",
            "" if row.memory_ratio is None else f"{row.memory_ratio:.2f}",
        )
    return table


def online_table(costs: list[dict[str, Any]]) -> Table:
    """Lay out what the live evaluator costs."""
    marks = list(costs[0]["us_per_message"])
    title = "live evaluator alone: messages per CPU second, CPU us per message"
    table = Table("window", "updates", title=title, box=box.SIMPLE_HEAD)
    for heading in ("msg/s", "quiet", *(f"us at {int(mark) // 1000}k" for mark in marks)):
        table.add_column(heading, justify="right")
    for row in costs:
        at_marks = [f"{row['us_per_message'][mark]:.1f}" for mark in marks]
        window = "whole run" if row["window"] == "0" else row["window"]
        rates = f"{row['messages_per_s']:.0f}", f"{row['quiet_messages_per_s']:.0f}"
        table.add_row(window, row["updates"], *rates, *at_marks)
    return table


def as_json(row: Row) -> dict[str, object]:
    """Return a row for results.json."""
    return {
        "work": row.work,
        "program": row.who,
        "cpu_s": row.cost.cpu_s,
        "wall_s": row.cost.wall_s,
        "peak_mib": row.cost.peak_mib,
        "cpu_ratio": row.cpu_ratio,
        "memory_ratio": row.memory_ratio,
    }


def evo_part(options: argparse.Namespace, env: Environment, console: Console) -> dict[str, Any]:
    """Compare with evo, and time what it has no counterpart of."""
    rows: list[Row] = []
    evo_position(options.evo, *generate(options.data, SMALL))(env)  # writes its settings
    rows += compare_startup(options, env)
    for count in map(int, options.sizes.split(",")):
        rows += compare_with_evo(options, count, env)
    relative = relative_error_seconds(options.runs, env)
    console.print(as_table(rows))
    small, large = relative.values()
    for poses, seconds in relative.items():
        console.print(f"relative error, 5 lengths, {poses} poses, in process: {seconds:.3f} CPU s")
    console.print(f"twice the poses take {large / small:.2f} times as long")
    return {"processes": [as_json(row) for row in rows], "relative_error_cpu_s": relative}


def limit_part(options: argparse.Namespace, env: Environment, console: Console) -> dict[str, Any]:
    """Measure how far an evaluation is from the least that it can cost."""
    sizes = [SMALL, *map(int, options.sizes.split(","))]
    rows = [row for count in sizes for row in compare_with_limit(options, count, env)]
    console.print(as_table(rows))
    console.print("goal: at most 2 times the CPU time of the bare script at 1000k")
    return {"limit": [as_json(row) for row in rows]}


def online_part(options: argparse.Namespace, env: Environment, console: Console) -> dict[str, Any]:
    """Time the live evaluator."""
    costs = online_costs(options.messages, env)
    console.print(online_table(costs))
    return {"online": costs}


def continuous_part(
    options: argparse.Namespace, env: Environment, console: Console
) -> dict[str, Any]:
    """Time continuous groundtruth and likelihoods, each in a process of its own."""
    jobs = {f"{work}, {count // 1000}k": _continuous(work, count) for work, count in CONTINUOUS}
    costs = interleave(jobs, options.runs, {**env, "OPENBLAS_NUM_THREADS": "1"})
    table = Table("work", "CPU s inside", "peak MiB", box=box.SIMPLE_HEAD)
    result: dict[str, Any] = {}
    for work, cost in costs.items():
        inside = json.loads(cost.output)
        result[work] = inside | {"peak_mib": cost.peak_mib}
        seconds = ", ".join(f"{name[:-2]} {value:.2f}" for name, value in inside.items())
        table.add_row(work, seconds, f"{cost.peak_mib:.0f}")
    console.print(table)
    return {"continuous": result}


def _continuous(work: str, count: int) -> Job:
    command = [sys.executable, "-m", "benchmarks.continuous", work, str(count)]
    return lambda env: run(command, env)


def bags_part(options: argparse.Namespace) -> dict[str, Any]:
    """Compare readers of bags, in the peers' environment."""
    folder = options.data / "bags"
    sizes = ["--scale", str(options.scale), "--runs", str(options.runs), "--data", str(folder)]
    subprocess.run([options.evo.parent / "python", "-m", "benchmarks.bags", *sizes], check=True)
    kept = folder / f"{options.scale:g}" / "bags.json"
    return {"bags": json.loads(kept.read_text(encoding="utf-8"))}


def estimator_part(
    options: argparse.Namespace, env: Environment, console: Console
) -> dict[str, Any]:
    """Compare an iteration of the visual-inertial estimator with GTSAM's, in its environment."""
    command = [str(options.oracles), "-m", "benchmarks.estimators", str(options.runs)]
    result = json.loads(run(command, {**env, "OPENBLAS_NUM_THREADS": "1"}).output)
    table = Table("keyframes", "visibility", box=box.SIMPLE_HEAD, title="CPU ms per iteration")
    for heading in ("observations", "computed", "GTSAM", "x"):
        table.add_column(heading, justify="right")
    for row in result["rows"]:
        table.add_row(
            str(row["keyframes"]),
            row["visibility"],
            str(row["observations"]),
            f"{row['ours_ms']:.1f}",
            f"{row['gtsam_ms']:.1f} ({row['ordering']})",
            f"{row['ratio']:.2f}",
        )
    console.print(table)
    return {"estimator": result}


def main() -> None:
    """Measure everything, print it, keep it."""
    options = arguments()
    console = Console()
    results: dict[str, Any] = {
        "machine": {
            "cpus": os.cpu_count(),
            "kernel": os.environ.get(KERNEL, "its own"),
            "load_before": os.getloadavg(),
            "python": platform.python_version(),
            "numpy": version("numpy"),
            "scipy": version("scipy"),
            "trajeval-ros": version("trajeval-ros"),
            "evo": evo_version(options.evo),
            "runs": options.runs,
        }
    }
    with tempfile.TemporaryDirectory() as home:
        env = environment(Path(home))
        parts = PARTS if options.only is None else (options.only,)
        if "evo" in parts:
            results |= evo_part(options, env, console)
        if "limit" in parts:
            results |= limit_part(options, env, console)
        if "online" in parts:
            results |= online_part(options, env, console)
        if "continuous" in parts:
            results |= continuous_part(options, env, console)
        if "bags" in parts:
            results |= bags_part(options)
        if "estimator" in parts:
            results |= estimator_part(options, env, console)
    console.print(", ".join(f"{name} {value}" for name, value in results["machine"].items()))
    options.results.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
