"""What a comparison left on disk, in brief."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from trajeval_ros.batch.comparison import POOLED, RUNS
from trajeval_ros.batch.pooling import read_pooled
from trajeval_ros.batch.results_table import (
    ATE,
    CALIBRATION,
    CONSISTENCY,
    LIKELIHOOD,
    OK,
    ResultsTable,
)

_NAMES = ("algorithm", "sequence", "trial")


@dataclass(frozen=True)
class Trial:
    """A run in brief.

    Attributes:
        algorithm, sequence, trial: Which.
        status: `ok`, `failed` or `missing`.
        reason: Why there are no numbers.
        coverage: Share of the groundtruth's time that its pairs cover, 0.0 of a failed run.
        pairs: Their number, 0 of a failed run.
        key: Of its record.
        rmse: Of the absolute errors, by metric.
        values: What was calibrated, and how errors fit covariances and groundtruth, by metric.
        warnings: What a reader of its numbers must know.
    """

    algorithm: str
    sequence: str
    trial: str
    status: str
    reason: str
    coverage: float
    pairs: int
    key: str
    rmse: dict[str, float]
    values: dict[str, float]
    warnings: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class ComparisonSummary:
    """What a comparison says.

    Attributes:
        title: Of the comparison.
        settings: That the numbers depend on.
        trials: All runs, the failed ones included.
        pooled: ResultsTable of statistics over trials.
    """

    title: str
    settings: dict[str, Any]
    trials: tuple[Trial, ...]
    pooled: tuple[dict[str, Any], ...]

    @cached_property
    def algorithms(self) -> list[str]:
        """In the order of the plan."""
        return list(dict.fromkeys(trial.algorithm for trial in self.trials))

    @cached_property
    def sequences(self) -> list[str]:
        """In the order of the plan."""
        return list(dict.fromkeys(trial.sequence for trial in self.trials))

    def of(self, algorithm: str, sequence: str | None = None) -> list[Trial]:
        """Return the runs of an algorithm, on one sequence or on all."""
        return self._by_place.get((algorithm, sequence), [])

    @cached_property
    def _by_place(self) -> dict[tuple[str, str | None], list[Trial]]:
        found: dict[tuple[str, str | None], list[Trial]] = defaultdict(list)
        for trial in self.trials:
            found[trial.algorithm, trial.sequence].append(trial)
            found[trial.algorithm, None].append(trial)
        return found


def summary_of(folder: Path) -> ComparisonSummary:
    """Read what a comparison left.

    Raises:
        InputError: Its table can't be read.
    """
    rows = ResultsTable(folder / RUNS)
    names = (
        *_NAMES, "status", "reason", "own_groundtruth_coverage", "pairs", "key", "warnings"
    )  # fmt: skip
    each: dict[tuple[str, ...], dict[str, Any]] = {}
    rmse: dict[tuple[str, ...], dict[str, float]] = defaultdict(dict)
    values: dict[tuple[str, ...], dict[str, float]] = defaultdict(dict)
    for row in rows.select((*names, "kind", "metric", "rmse", "mean")):
        run = tuple(row[name] for name in _NAMES)
        each.setdefault(run, row)
        if row["kind"] == ATE:
            rmse[run][row["metric"]] = row["rmse"]
        elif row["kind"] in (CALIBRATION, CONSISTENCY, LIKELIHOOD):
            values[run][row["metric"]] = row["mean"]
    trials = tuple(
        Trial(
            algorithm=row["algorithm"],
            sequence=row["sequence"],
            trial=row["trial"],
            status=row["status"],
            reason=row["reason"] or "",
            coverage=row["own_groundtruth_coverage"] or 0.0,
            pairs=row["pairs"] or 0,
            key=row["key"] or "",
            rmse=rmse[run],
            values=values[run],
            warnings=tuple((row["warnings"] or "").splitlines()),
        )
        for run, row in each.items()
    )
    return ComparisonSummary(
        rows.title, rows.settings, trials, tuple(read_pooled(folder / POOLED))
    )


def failures(summary: ComparisonSummary) -> list[str]:
    """Return a line for each run without numbers."""
    return [
        f"{' '.join(filter(None, (each.algorithm, each.sequence, each.trial)))} "
        f"{each.status}: {each.reason}"
        for each in summary.trials
        if each.status != OK
    ]
