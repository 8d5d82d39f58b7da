"""Simulates false alarms and power of the gates; prints the tables of docs/compare.md.

Trials are drawn with five kinds of spread, and with that of a real comparison's trials where one
is given. Every cell is a number of numbers, of trials on either side, and a spread.

Usage: python -m benchmarks.gates [--scale 0.1] [--real RUNS.parquet] [--workers 2]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import beta

from trajeval_ros.batch.gate_tests import FALSE_ALARMS, compare
from trajeval_ros.geometry.arrays import Floats

NUMBERS = (1, 5, 11, 33, 100)
TRIALS = (1, 2, 3, 5, 10, 20, 30)
SPREADS = ("5 %", "15 %", "30 %", "outliers", "mixed")
RELABELLINGS = 990
_CHUNK = 100


@dataclass(frozen=True)
class Change:
    """What differs between old and new trials.

    Attributes:
        margin: What may change.
        common: Change of all numbers.
        one: Change of the first number alone.
    """

    margin: float = 0.0
    common: float = 0.0
    one: float = 0.0


NOTHING = Change()
POWER = {
    "all +5 %, margin 0 %": Change(0.0, 0.05),
    "all +10 %, margin 5 %": Change(0.05, 0.10),
    "all +20 %, margin 5 %": Change(0.05, 0.20),
    "one +50 %, margin 5 %": Change(0.05, 0.0, 0.50),
}


@dataclass(frozen=True)
class Cell:
    """One simulation: so many comparisons, and how many gave an alarm."""

    numbers: int
    trials: int
    spread: str
    change: Change
    comparisons: int
    real: Floats | None = None

    def alarms(self) -> int:
        """Simulate; return the number of comparisons with an alarm."""
        change = (self.change.common, self.change.one, self.change.margin)
        seed = (self.numbers, self.trials, sum(self.spread.encode()),
                *(round(1000.0 * each) for each in change))  # fmt: skip
        random = np.random.default_rng(seed)
        found = 0
        for first in range(0, self.comparisons, _CHUNK):
            z = self._trials(random, min(_CHUNK, self.comparisons - first))
            sizes = [(self.trials, self.trials)] * self.numbers
            outcome = compare(list(z), sizes, count=RELABELLINGS, random=random)
            found += int((outcome.pooled | outcome.numbers.any(1)).sum())
        return found

    def _trials(self, random: np.random.Generator, comparisons: int) -> Floats:
        """Return logarithms (numbers, comparisons, trials), new ones less the margin."""
        shape = (self.numbers, comparisons, 2 * self.trials)
        z: Floats
        if self.spread == "outliers":
            z = random.normal(0.0, 0.2, shape) + np.log(5.0) * (random.random(shape) < 0.05)
        elif self.spread == "mixed":  # 5 to 50 % by number, with the tails of Student's t
            low, high = np.log(0.05), np.log(0.5)
            sigma = np.exp(random.uniform(low, high, (self.numbers, comparisons, 1)))
            z = sigma * random.standard_t(4, shape) / np.sqrt(2.0)
        elif self.real is not None and self.spread == "real":
            which = np.arange(self.numbers)[:, None, None] % len(self.real)
            drawn = self.real[which, random.integers(self.real.shape[1], size=shape)]
            noise = (
                0.25 * self.real.std() * random.standard_normal(shape)
            )  # so that none are equal
            z = (drawn + noise) / np.sqrt(1.0625)
        else:
            z = random.normal(0.0, float(self.spread.split()[0]) / 100.0, shape)
        new = z[:, :, self.trials :]
        new += np.log1p(self.change.common) - np.log1p(self.change.margin)
        new[0] += np.log1p(self.change.one)
        return z


def real_residuals(path: Path) -> Floats:
    """Return logarithms of a comparison's ATE, less their medians: (numbers, trials)."""
    from trajeval_ros.batch.results_table import ResultsTable

    rows = ResultsTable(path).select(
        ("algorithm", "sequence", "rmse"), status="ok", kind="ate", metric="position_m"
    )
    logs: dict[tuple[str, str], list[float]] = {}
    for row in rows:
        logs.setdefault((row["algorithm"], row["sequence"]), []).append(float(np.log(row["rmse"])))
    least = min(map(len, logs.values()))
    z = np.array([each[:least] for each in logs.values()])
    made: Floats = (z - np.median(z, axis=1, keepdims=True)) * np.sqrt(least / (least - 1.0))
    return made


def interval(alarms: int, comparisons: int, missed: float) -> tuple[float, float]:
    """Return Clopper and Pearson's interval of a share."""
    low = beta.ppf(missed / 2.0, alarms, comparisons - alarms + 1) if alarms else 0.0
    high = beta.ppf(1.0 - missed / 2.0, alarms + 1, comparisons - alarms)
    return float(low), float(high) if alarms < comparisons else 1.0


def null_cells(scale: float, spreads: Sequence[str], real: Floats | None) -> list[Cell]:
    """Return the cells without a change, at the margin's edge."""
    comparisons = {33: 1000, 100: 600}
    return [
        Cell(numbers, trials, spread, NOTHING, round(scale * comparisons.get(numbers, 2000)), real)
        for numbers in NUMBERS
        for trials in TRIALS
        for spread in spreads
    ]


def power_cells(scale: float) -> dict[tuple[str, int, int], Cell]:
    """Return the cells of changes, by their name, numbers and trials."""
    comparisons = {33: 300, 100: 200}
    return {
        (name, numbers, trials): Cell(
            numbers, trials, "15 %", change, round(scale * comparisons.get(numbers, 400))
        )
        for name, change in POWER.items()
        for numbers in NUMBERS
        for trials in TRIALS
    }


def run(cells: Iterable[Cell], workers: int) -> list[int]:
    """Simulate cells on some processes; return their alarms."""
    with ProcessPoolExecutor(workers) as pool:
        return list(pool.map(Cell.alarms, cells))


def print_table(first: str, rows: Iterable[tuple[str, Sequence[str]]]) -> None:
    """Print a Markdown table with a column for each number of trials."""
    print(f"\n| {first} | {' | '.join(map(str, TRIALS))} |\n|---|{len(TRIALS) * '---:|'}")
    for name, texts in rows:
        print(f"| {name} | {' | '.join(texts)} |", flush=True)


def main() -> None:
    """Print the false alarms of all cells, their table, and that of the power."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scale", type=float, default=1.0, help="of the number of comparisons")
    parser.add_argument("--real", type=Path, help="runs.parquet of a comparison with trials")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    real = None if given.real is None else real_residuals(given.real)
    spreads = SPREADS if real is None else (*SPREADS, "real")

    cells = null_cells(given.scale, spreads, real)
    alarms = run(cells, given.workers)
    total, all_alarms = sum(each.comparisons for each in cells), sum(alarms)
    low, high = interval(all_alarms, total, 0.05)
    print(f"{len(cells)} cells, {total} comparisons without a change: alarms in "
          f"{100 * all_alarms / total:.2f} % ({100 * low:.2f} to {100 * high:.2f} %)")  # fmt: skip
    above = [
        cell
        for cell, count in zip(cells, alarms, strict=True)
        if interval(count, cell.comparisons, 0.1 / len(cells))[0] > FALSE_ALARMS
    ]
    print(f"cells significantly above {100 * FALSE_ALARMS:g} %: {len(above)}")
    for cell in above:
        print(f"  {cell.numbers} numbers, {cell.trials} trials, {cell.spread}")
    shares = {
        (cell.numbers, cell.trials, cell.spread): 100.0 * count / cell.comparisons
        for cell, count in zip(cells, alarms, strict=True)
    }
    for what, reduce in (("mean", np.mean), ("highest", np.max)):
        print(f"\nAlarms without a change, {what} of the spreads, %")
        print_table("numbers, trials", [
            (str(numbers), [f"{reduce([shares[numbers, trials, each] for each in spreads]):.1f}"
                            for trials in TRIALS])
            for numbers in NUMBERS
        ])  # fmt: skip
    power = power_cells(given.scale)
    found = run(power.values(), given.workers)
    seen = {
        key: 100.0 * count / cell.comparisons
        for (key, cell), count in zip(power.items(), found, strict=True)
    }
    print("\nChanges that are noticed, spread 15 %, %")
    print_table("change, numbers, trials", [
        (f"{name}; {numbers}", [f"{seen[name, numbers, trials]:.0f}" for trials in TRIALS])
        for name in POWER
        for numbers in NUMBERS
    ])  # fmt: skip


if __name__ == "__main__":
    main()
