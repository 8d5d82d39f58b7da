"""The plan of a comparison: all runs that exist, and missing ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from trajeval_ros.formatting.numbers import natural_key
from trajeval_ros.geometry.trajectory_edits import TimeSpan
from trajeval_ros.io.requests.settings_table import settings_of
from trajeval_ros.io.text.hints import NO_SIDES, SideHints
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.pipeline.request import Request

Name = tuple[str, str, str]


@dataclass(frozen=True)
class PlannedRun:
    """One run of an algorithm, which may be missing."""

    algorithm: str  # name of the estimator
    sequence: str  # name of the recording
    trial: str  # name of the repetition; "" if there is only one
    groundtruth: str = ""  # SOURCE of the groundtruth
    estimate: str = ""  # SOURCE of the estimate
    missing: str = ""  # why it has no files; "" if it has
    # The time span to evaluate, by a file of its folder; None for all.
    time_span: TimeSpan | None = None
    hints: SideHints = NO_SIDES  # columns and frame rates of the text files of both sides

    @property
    def name(self) -> str:
        """Algorithm, sequence and trial, separated by spaces."""
        return " ".join(filter(None, (self.algorithm, self.sequence, self.trial)))


@dataclass(frozen=True)
class Plan:
    """A comparison before its evaluation."""

    title: str  # title of the report
    # All runs by algorithm, sequence and trial, including missing ones.
    runs: tuple[PlannedRun, ...]
    request: Request  # the evaluation of every run
    # Whether to evaluate only the time that all runs of a sequence cover.
    common_time_span: bool = False

    def request_of(self, run: PlannedRun) -> Request:
        """Return the evaluation of a run, with its own time span unless the request has one."""
        if run.time_span is None or self.request.time_span is not None:
            return self.request
        return dataclasses.replace(self.request, time_span=run.time_span)

    @property
    def settings(self) -> dict[str, Any]:
        """All settings that the numbers depend on, by name."""
        return {**settings_of(self.request), "common_time_span": self.common_time_span}


def association_of(settings: Mapping[str, Any]) -> AssociationRule:
    """Return the rule of the association in the settings of a plan or of a result."""
    return AssociationRule(
        settings["association"],
        settings["max_time_difference"],
        settings["max_gap"],
        model=settings["continuous_model"],
    )


def all_runs(
    algorithms: Iterable[str],
    estimates: Mapping[Name, str],
    groundtruths: Callable[[str, str], str],
    where: Callable[[Name], str],
    *,
    sequences: Iterable[str] = (),
    trials: Iterable[str] = (),
) -> tuple[PlannedRun, ...]:
    """Return the runs with files, and missing ones.

    An algorithm is expected to have every sequence of the other algorithms, and on it all of its
    trials on any sequence. Omitting missing runs would favour it.

    `algorithms`: in the order of the tables. `estimates`: SOURCE by algorithm, sequence and trial.
    `groundtruths`: returns the SOURCE for algorithm and sequence; "" if there is none. `where`:
    returns the expected path of a missing run. `sequences`, `trials`: all expected ones; by
    default those of the estimates.
    """
    names = natural({sequence for _, sequence, _ in estimates} | set(sequences))
    if sequences:
        names = natural(sequences)
    runs = []
    for algorithm in algorithms:
        known = {trial for item, _, trial in estimates if item == algorithm}
        expected = natural(trials) if trials and known != {""} else natural(known) or [""]
        for sequence in names:
            groundtruth = groundtruths(algorithm, sequence)
            for trial in expected:
                name = (algorithm, sequence, trial)
                estimate, missing = estimates.get(name, ""), ""
                if not estimate:
                    missing = f"{where(name)} does not exist"
                elif not groundtruth:
                    missing = f"no groundtruth of {sequence}"
                runs.append(PlannedRun(*name, groundtruth, estimate, missing))
    return tuple(runs)


def natural(names: Iterable[str]) -> list[str]:
    """Return names in natural order: trial 2 before trial 10."""
    return sorted(names, key=natural_key)
