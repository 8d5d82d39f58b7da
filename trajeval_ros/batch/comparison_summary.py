"""A summary of a comparison on disk."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from sys import intern
from typing import Any

from trajeval_ros.batch.finished_comparison import POOLED_FILE, RUNS
from trajeval_ros.batch.results_table import (
    ATE,
    AVAILABLE,
    CALIBRATION,
    CONSISTENCY,
    INTEGRITY,
    LIKELIHOOD,
    OK,
    POOLED,
    RE,
    ResultsTable,
    read_pooled,
)
from trajeval_ros.formatting.numbers import whole_percent
from trajeval_ros.geometry.valid_poses import GROUNDTRUTH_DROPPED, POSES_DROPPED

_NAMES = ("algorithm", "sequence", "trial")
_OF_A_RUN = (
    "status", "reason", "groundtruth_coverage", "common_span", "span_s", "pairs", "key",
    "warnings", "diagnosis",
)  # fmt: skip
_MOST_SPANS = 3  # common time spans that are listed
# Statistics of as-available numbers.
_AVAILABLE = {"position_m": "rmse", "age_error_m": "rmse", "age_s": "p95"}
# Errors of KITTI's ranking, means over all lengths: name, and title of the table.
KITTI = {"kitti_percent": "KITTI t_rel [%]", "kitti_deg_per_100m": "KITTI r_rel [deg/100 m]"}


@dataclass(frozen=True)
class Trial:
    """The summary of a run."""

    algorithm: str
    sequence: str
    trial: str  # name of the trial; "" if there is only one
    status: str  # `ok`, `failed` or `missing`
    reason: str  # why it has no numbers
    # Share of the groundtruth's duration that its pairs cover, in the common time span if one cut
    # the runs; 0.0 for a failed run.
    coverage: float
    pairs: int  # number of pairs; 0 for a failed run
    key: str  # key of its record
    # RMSE of the absolute errors by metric, and with protocol kitti the errors of its ranking.
    rmse: dict[str, float]
    # Results of calibration, consistency, integrity and likelihood, by metric.
    values: dict[str, float]
    warnings: tuple[str, ...]
    diagnosis: tuple[str, ...] = ()  # causes of the mistakes that it shows, the most severe first
    span_s: float = 0.0  # time from the first to the last pair, seconds
    common_span: float = 1.0  # share of the groundtruth's duration that the common time span has

    @property
    def name(self) -> str:
        """Name of the run: "vio MH_01 0"."""
        return " ".join(filter(None, (self.algorithm, self.sequence, self.trial)))

    @property
    def is_copy(self) -> bool:
        """Whether its estimate is the groundtruth."""
        return "identical" in self.diagnosis


@dataclass(frozen=True, eq=False)
class ComparisonSummary:
    """The results of a comparison."""

    title: str
    settings: dict[str, Any]  # settings that the numbers depend on
    trials: tuple[Trial, ...]  # all runs, including failed ones
    pooled: tuple[dict[str, Any], ...]  # rows of the statistics over trials

    @cached_property
    def algorithms(self) -> list[str]:
        """Names of the algorithms, in the order of the plan."""
        return list(dict.fromkeys(trial.algorithm for trial in self.trials))

    @cached_property
    def sequences(self) -> list[str]:
        """Names of the sequences, in the order of the plan."""
        return list(dict.fromkeys(trial.sequence for trial in self.trials))

    def of(self, algorithm: str, sequence: str | None = None) -> list[Trial]:
        """Return the runs of an algorithm, on one sequence or on all."""
        return self._by_place.get((algorithm, sequence), [])

    @cached_property
    def relative(self) -> dict[tuple[str, str, str, str], dict[str, Any]]:
        """Relative errors over trials, by algorithm, sequence, length and metric."""
        return {
            (row["algorithm"], row["sequence"], row["length"], row["metric"]): row
            for row in self.pooled
            if row["kind"] == RE
        }

    @cached_property
    def common_spans(self) -> str:
        """Common time spans: "149 s of MH_01 (82 % of its groundtruth)"; "" without any.

        Of more than three sequences, those with the smallest and the largest share.
        """
        if not self.settings["common_time_span"]:
            return ""
        by_length = sorted(self.trials, key=lambda trial: trial.span_s)  # failed runs have none
        longest = {item.sequence: item for item in by_length if item.span_s}
        named = [
            f"{item.span_s:.0f} s of {item.sequence} ({whole_percent(item.common_span)} of its "
            "groundtruth)"
            for item in sorted(longest.values(), key=lambda run: run.common_span)
        ]
        return ", ".join(named) if len(named) <= _MOST_SPANS else f"{named[0]} to {named[-1]}"

    @cached_property
    def _by_place(self) -> dict[tuple[str, str | None], list[Trial]]:
        trials: dict[tuple[str, str | None], list[Trial]] = defaultdict(list)
        for trial in self.trials:
            trials[trial.algorithm, trial.sequence].append(trial)
            trials[trial.algorithm, None].append(trial)
        return trials


def summary_of(folder: Path) -> ComparisonSummary:
    """Read the tables of a comparison; memory grows with the number of runs, not of rows."""
    rows = ResultsTable(folder / RUNS)
    rmse: dict[tuple[str, ...], dict[str, float]] = defaultdict(dict)
    values: dict[tuple[str, ...], dict[str, float]] = defaultdict(dict)
    kinds = [ATE, AVAILABLE, CALIBRATION, CONSISTENCY, INTEGRITY, LIKELIHOOD]
    if rows.settings["protocol"] == "kitti":
        kinds.append(POOLED)
    # Texts that occur in many rows are stored once.
    for row in rows.rows((*_NAMES, "kind", "metric", "rmse", "mean", "p95"), kind=kinds):
        run = tuple(intern(row[name]) for name in _NAMES)
        metric = intern(row["metric"])
        if row["kind"] == ATE:
            rmse[run][metric] = row["rmse"]
        elif metric == "position_percent":
            rmse[run]["kitti_percent"] = row["mean"]
        elif metric == "rotation_deg_per_m":
            rmse[run]["kitti_deg_per_100m"] = 100.0 * row["mean"]
        elif row["kind"] == AVAILABLE:
            column = _AVAILABLE.get(metric, "mean")
            values[run][intern(f"as_available_{metric}")] = row[column]
        else:
            values[run][metric] = row["mean"]
    trials = []
    for row in rows.distinct((*_NAMES, *_OF_A_RUN)):
        run = tuple(intern(row[name]) for name in _NAMES)
        trials.append(
            Trial(
                algorithm=run[0],
                sequence=run[1],
                trial=run[2],
                status=intern(row["status"]),
                reason=row["reason"] or "",
                coverage=row["groundtruth_coverage"] or 0.0,
                pairs=row["pairs"] or 0,
                key=row["key"] or "",
                rmse=rmse.get(run, {}),
                values=values.get(run, {}),
                warnings=tuple(map(intern, (row["warnings"] or "").splitlines())),
                diagnosis=tuple(map(intern, filter(None, (row["diagnosis"] or "").split(",")))),
                span_s=row["span_s"] or 0.0,
                common_span=row["common_span"] or 1.0,
            )
        )
    return ComparisonSummary(
        rows.title, rows.settings, tuple(trials), tuple(read_pooled(folder / POOLED_FILE))
    )


def dropped_poses(summary: ComparisonSummary) -> list[str]:
    """Return one line per run whose estimate lost poses, and per groundtruth that did."""
    lines = [(trial, line) for trial in summary.trials for line in trial.warnings]
    of_groundtruth = [
        f"{trial.sequence}: {line}" for trial, line in lines if GROUNDTRUTH_DROPPED in line
    ]
    of_estimates = [f"{trial.name}: {line}" for trial, line in lines if POSES_DROPPED in line]
    return [*dict.fromkeys(of_groundtruth), *of_estimates]  # runs share a groundtruth


def failures(summary: ComparisonSummary) -> list[str]:
    """Return one line per run without numbers."""
    return [
        f"{trial.name} {trial.status}: {trial.reason}"
        for trial in summary.trials
        if trial.status != OK
    ]
