"""Compares ways of reading poses out of bags, each in a process of its own.

Every round runs each reader once, one after the other. Medians and their ratios go to the
terminal, and to bags.json beside the generated bags, which take 7 GB at scale 1. A second table
says what 1, 2 and 4 sources of one bag cost.

Usage: make bench BENCH="--only bags --scale 0.1 --runs 3"
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.bag_readers import OURS, READERS
from benchmarks.process import environment, run

HERE = Path(__file__).parent
SUFFIXES = (".mcap", ".db3", ".bag")
SOURCES = ("1", "2", "4")
Figures = dict[str, float]


def compare_readers(path: Path, runs: int) -> dict[str, Figures]:
    """Return the medians of each reader's figures; all must have read the same."""
    names = [name for name in READERS if path.suffix == ".mcap" or not name.startswith("mcap")]
    figures = measure(path, names, runs)
    sums = [figure["sum_x"] for figure in figures.values()]
    if max(sums) - min(sums) > 1e-6:
        raise SystemExit(f"{path.name}: the readers disagree")
    return figures


def measure(path: Path, names: Sequence[str], runs: int) -> dict[str, Figures]:
    """Return the medians of each reader's figures."""
    figures: dict[str, list[Figures]] = {name: [] for name in names}
    with tempfile.TemporaryDirectory() as home:
        for _ in range(runs):
            for name in names:
                command = [sys.executable, "-m", "benchmarks.bag_readers", name, str(path)]
                figures[name].append(json.loads(run(command, environment(Path(home))).output))
    return {
        name: {key: median(item[key] for item in several) for key in several[0]}
        for name, several in figures.items()
    }


def main() -> None:
    """Measure all bags, print the figures, keep them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scale", default=1.0, type=float, help="size of the bags")
    parser.add_argument("--runs", default=3, type=int, help="rounds; the median counts")
    parser.add_argument("--data", default=HERE / "data" / "bags", type=Path)
    options = parser.parse_args()
    folder = options.data / f"{options.scale:g}"
    subprocess.run(
        [sys.executable, "-m", "benchmarks.bag_files", str(folder), str(options.scale)], check=True
    )
    bags = [path for path in sorted(folder.glob("*.*")) if path.suffix in SUFFIXES]
    results = {}
    readers = Table("bag", "reader", box=box.SIMPLE_HEAD)
    sources = Table("bag", "sources", box=box.SIMPLE_HEAD)
    for table in (readers, sources):
        for heading in ("poses", "CPU s", "x", "read MB", "of file", "peak MB"):
            table.add_column(heading, justify="right")
    for path in bags:
        if path.name.startswith("flight"):
            results[path.name] = figures = measure(path, SOURCES, options.runs)
            add_rows(sources, path, figures, SOURCES[0])
        else:
            results[path.name] = figures = compare_readers(path, options.runs)
            add_rows(readers, path, figures, OURS)
    Console(width=100).print(readers, sources)
    (folder / "bags.json").write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


def add_rows(table: Table, path: Path, figures: dict[str, Figures], unit: str) -> None:
    """Lay out what the readers of a bag cost, in multiples of what one of them does."""
    for name, figure in figures.items():
        ratio = figure["cpu_s"] / figures[unit]["cpu_s"]
        table.add_row(
            path.name,
            name,
            f"{figure['poses']:.0f}",
            f"{figure['cpu_s']:.3f}",
            "" if name == unit else f"{ratio:.2f}",
            f"{figure['read_mb']:.0f}",
            f"{1e8 * figure['read_mb'] / path.stat().st_size:.1f} %",
            f"{figure['peak_mb']:.0f}",
        )


if __name__ == "__main__":
    main()
