"""Simulates false alarms and power of the gates; prints the tables of docs/compare.md.

A cell is a number of trials on both sides, a number of sequences, a spread of the trials, and a
number of metrics in one family. Every comparison has its own relabellings.

Usage: python -m benchmarks.gates [--scale 0.1] [--seed 0] [--real RUNS.parquet]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import beta

from trajeval_ros.batch.gates import FALSE_ALARMS
from trajeval_ros.batch.permutation_tests import PermutationTest, Sample
from trajeval_ros.geometry.arrays import Floats

TRIALS = (1, 2, 3, 5, 10)
SEQUENCES = (1, 3, 11, 33)
SPREADS = ("15 %", "mixed", "outliers", "two levels", "Cauchy", "real")
FAMILIES = {1: SPREADS, 3: ("outliers", "two levels", "real"), 11: ("outliers", "real")}
RELABELLINGS = 999  # the gates use 9999; the tests are exact for both
MARGIN = 0.05


@dataclass(frozen=True)
class Cell:
    """One simulation.

    Attributes:
        trials: Trials on both sides.
        sequences: Number of sequences.
        spread: Name of the distribution of the trials.
        metrics: Number of gates in the family.
        comparisons: Number of simulated comparisons.
        common: Relative change of all sequences; the margin is 5 % if anything changes.
        one: Relative change of the first sequence alone.
        seed: Seed of trials and relabellings.
    """

    trials: int
    sequences: int
    spread: str
    metrics: int = 1
    comparisons: int = 300
    common: float = 0.0
    one: float = 0.0
    seed: int = 0

    def alarms(self, real: Floats | None = None) -> int:
        """Simulate; return the number of comparisons with an alarm.

        Args:
            real: Logarithms of real errors for the spread `real`, (sequences, trials, metrics).
        """
        key = (self.trials, self.sequences, self.metrics, sum(self.spread.encode()),
               round(1e3 * self.common), round(1e3 * self.one), self.seed)  # fmt: skip
        random = np.random.default_rng(key)
        margin = MARGIN if self.common or self.one else 0.0
        margins = np.full(self.metrics, np.log1p(margin))
        return sum(self._alarm(random, margins, real) for _ in range(self.comparisons))

    def _alarm(self, random: np.random.Generator, margins: Floats, real: Floats | None) -> bool:
        z = self._logarithms(random, real)
        z[:, self.trials :] += np.log1p(self.common)
        z[0, self.trials :] += np.log1p(self.one)
        samples = [Sample(*np.split(item, [self.trials])) for item in z]
        test = PermutationTest(samples, margins, FALSE_ALARMS, RELABELLINGS, random)
        result = test.worse
        together = (result.together <= result.level_together).any()
        return bool(together or (result.alone <= result.level_alone).any())

    def _logarithms(self, random: np.random.Generator, real: Floats | None) -> Floats:
        """Return logarithms of errors, (sequences, runs, metrics); correlation one half."""
        shape = (self.sequences, 2 * self.trials, self.metrics)
        if self.spread == "real" and real is not None:  # without replacement
            which = np.arange(self.sequences) % len(real)
            if self.sequences < len(real):
                which = random.integers(len(real), size=self.sequences)
            drawn = [random.permutation(real[item])[: shape[1], : self.metrics] for item in which]
            return np.array(drawn)
        z: Floats = random.normal(size=shape)
        if self.metrics > 1:
            z = np.sqrt(0.5) * (z + random.normal(size=(*shape[:2], 1)))
        if self.spread == "outliers":  # 5 % of the runs have five times the error
            z = 0.2 * z + np.log(5.0) * (random.random((*shape[:2], 1)) < 0.05)
        elif self.spread == "mixed":  # 5 to 50 % by sequence, with the tails of Student's t
            sigma = np.exp(random.uniform(np.log(0.05), np.log(0.5), (self.sequences, 1, 1)))
            z = sigma * z / np.sqrt(random.chisquare(4, (*shape[:2], 1)) / 2.0)
        elif self.spread == "Cauchy":  # without a mean and a variance
            z = 0.1 * random.standard_cauchy(shape)
        elif self.spread == "two levels":  # 30 % of the runs end at twice the error
            bad = random.random((*shape[:2], 1)) < 0.3
            if self.metrics > 1:
                bad = bad | (random.random(shape) < 0.05)
            z = np.log(2.0) * bad + np.round(0.002 * z, 3)
        else:
            z = float(self.spread.split()[0]) / 100.0 * z
        return z


def real_errors(path: Path) -> Floats:
    """Return logarithms of a comparison's ATE less their medians, (sequences, trials, 1)."""
    from trajeval_ros.batch.results_table import ResultsTable

    rows = ResultsTable(path).select(
        ("algorithm", "sequence", "rmse"), status="ok", kind="ate", metric="position_m"
    )
    logs: dict[tuple[str, str], list[float]] = {}
    for row in rows:
        logs.setdefault((row["algorithm"], row["sequence"]), []).append(float(np.log(row["rmse"])))
    least = min(map(len, logs.values()))
    z = np.array([log[:least] for log in logs.values()])
    made: Floats = (z - np.median(z, axis=1, keepdims=True))[:, :, None]
    return made


def null_cells(scale: float, seed: int, real: Floats | None) -> list[Cell]:
    """Return the cells without a change, at the margin's edge."""
    runs, metrics = (0, 0) if real is None else real.shape[1:]
    return [
        Cell(trials, sequences, spread, family, round(scale * 1000), seed=seed)
        for family, spreads in FAMILIES.items()
        for trials in TRIALS
        for sequences in SEQUENCES[: 4 if family < 11 else 3]
        for spread in spreads
        if spread != "real" or (2 * trials <= runs and family <= metrics)
    ]


def power_cells(scale: float, seed: int) -> dict[str, list[Cell]]:
    """Return the rows of cells with a change, by name."""
    designs = [
        (f"all +20 %, {spread}, {sequences}", spread, sequences, 0.20, 0.0)
        for spread in ("15 %", "outliers")
        for sequences in SEQUENCES
    ] + [
        (f"one +50 %, {spread}, {sequences}", spread, sequences, 0.0, 0.50)
        for spread in ("15 %", "outliers")
        for sequences in (3, 11)
    ]
    return {
        name: [
            Cell(trials, sequences, spread, 1, round(scale * 300), common, one, seed)
            for trials in TRIALS
        ]
        for name, spread, sequences, common, one in designs
    }


def interval(alarms: int, comparisons: int, missed: float) -> tuple[float, float]:
    """Return Clopper and Pearson's interval of a share."""
    low = beta.ppf(missed / 2.0, alarms, comparisons - alarms + 1) if alarms else 0.0
    high = beta.ppf(1.0 - missed / 2.0, alarms + 1, comparisons - alarms)
    return float(low), float(high) if alarms < comparisons else 1.0


def print_table(first: str, rows: Iterable[tuple[str, Sequence[str]]]) -> None:
    """Print a Markdown table with a column for each number of trials."""
    print(f"\n| {first} | {' | '.join(map(str, TRIALS))} |\n|---|{len(TRIALS) * '---:|'}")
    for name, texts in rows:
        print(f"| {name} | {' | '.join(texts)} |", flush=True)


def print_false_alarms(cells: Sequence[Cell], alarms: Sequence[int]) -> None:
    """Print the shares of all cells and of families, and those by spread and trials."""
    for family in (None, *FAMILIES):
        result = [(cell.comparisons, count) for cell, count in zip(cells, alarms, strict=True)
                 if family in (None, cell.metrics)]  # fmt: skip
        total, count = (sum(item) for item in zip(*result, strict=True))
        low, high = (100.0 * item for item in interval(count, total, 0.05))
        who = "all" if family is None else f"family of {family}"
        print(f"{who}: {len(result)} cells, {total} comparisons, alarms in "
              f"{100 * count / total:.2f} % ({low:.2f} to {high:.2f} %)")  # fmt: skip
    above = [cell for cell, count in zip(cells, alarms, strict=True)
             if interval(count, cell.comparisons, 0.1 / len(cells))[0] > FALSE_ALARMS]  # fmt: skip
    print(f"cells significantly above {100 * FALSE_ALARMS:g} %: {len(above)}", *above, sep="\n")
    shares: dict[tuple[str, int], list[float]] = {}
    for cell, count in zip(cells, alarms, strict=True):
        shares.setdefault((cell.spread, cell.trials), []).append(100.0 * count / cell.comparisons)
    for what, reduce in (("mean", np.mean), ("highest cell", np.max)):
        print(f"\nAlarms without a change, {what}, %")
        print_table("spread; trials", [
            (spread, [f"{reduce(shares[spread, trial]):.1f}" if (spread, trial) in shares else "-"
                      for trial in TRIALS])
            for spread in SPREADS
        ])  # fmt: skip


def main() -> None:
    """Print the false alarms of all cells, and the power."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scale", type=float, default=1.0, help="of the number of comparisons")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--real", type=Path, help="runs.parquet of a comparison with trials")
    given = parser.parse_args()
    real = None if given.real is None else real_errors(given.real)
    cells = null_cells(given.scale, given.seed, real)
    print_false_alarms(cells, [cell.alarms(real) for cell in cells])
    print("\nAlarms with a change, margin 5 %, %")
    print_table("change, spread, sequences; trials", (
        (name, [f"{100 * item.alarms() / item.comparisons:.0f}" for item in row])
        for name, row in power_cells(given.scale, given.seed).items()
    ))  # fmt: skip


if __name__ == "__main__":
    main()
