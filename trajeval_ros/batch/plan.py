"""What is to be compared: every run that there is, and every one that should be."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from trajeval_ros.geometry.time_span import TimeSpan
from trajeval_ros.io.text.hints import NO_HINTS, TextHints
from trajeval_ros.pipeline.request import Request

Name = tuple[str, str, str]


@dataclass(frozen=True)
class PlannedRun:
    """One run of an algorithm, which may be missing.

    Attributes:
        algorithm: What made the estimate.
        sequence: What it ran on.
        trial: Which of several runs on it, "" if there is but one.
        groundtruth: SOURCE of the groundtruth.
        estimate: SOURCE of the estimate.
        missing: Why it can't be evaluated; "" of a run whose files are there.
        time_span: The part of it that its folder says is to be evaluated; None for all.
        hints: What is known of the estimate's text file beyond what is in it.
    """

    algorithm: str
    sequence: str
    trial: str
    groundtruth: str = ""
    estimate: str = ""
    missing: str = ""
    time_span: TimeSpan | None = None
    hints: TextHints = NO_HINTS

    @property
    def name(self) -> str:
        """Algorithm, sequence and trial in one."""
        return " ".join(filter(None, (self.algorithm, self.sequence, self.trial)))


@dataclass(frozen=True)
class Plan:
    """A comparison that is to be made.

    Attributes:
        title: What a report calls it.
        runs: By algorithm, sequence and trial, the missing ones included.
        request: What is computed of each.
        common_time_span: Evaluate only the time that all runs of a sequence have.
    """

    title: str
    runs: tuple[PlannedRun, ...]
    request: Request
    common_time_span: bool = False

    def request_of(self, run: PlannedRun) -> Request:
        """Return what is computed of a run: its own time span, unless the request has one."""
        if run.time_span is None or self.request.time_span is not None:
            return self.request
        return dataclasses.replace(self.request, time_span=run.time_span)


def all_runs(
    algorithms: Iterable[str],
    estimates: Mapping[Name, str],
    groundtruths: Callable[[str, str], str],
    where: Callable[[Name], str],
    *,
    sequences: Iterable[str] = (),
    trials: Iterable[str] = (),
) -> tuple[PlannedRun, ...]:
    """Return the runs that were found, and those that are missing beside them.

    An algorithm is expected to have run on each sequence that any other one ran on, as often as
    on any of its own sequences: leaving out what failed would flatter it.

    Args:
        algorithms: In the order that tables list them.
        estimates: SOURCE by algorithm, sequence and trial.
        groundtruths: SOURCE by algorithm and sequence; "" where there is none.
        where: Where the file of a missing run was looked for.
        sequences: All that there should be; by default those that were found.
        trials: Of algorithms with trials, all that there should be; likewise.
    """
    names = natural({sequence for _, sequence, _ in estimates} | set(sequences))
    if sequences:
        names = natural(sequences)
    runs = []
    for algorithm in algorithms:
        own = {trial for each, _, trial in estimates if each == algorithm}
        expected = natural(trials) if trials and own != {""} else natural(own) or [""]
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
    """Return names in the order of people: trial 2 before trial 10."""

    def key(name: str) -> list[tuple[bool, int, str]]:
        pieces = re.findall(r"[0-9]+|[^0-9]+", name)
        return [(False, int(each), "") if each.isdecimal() else (True, 0, each) for each in pieces]

    return sorted(names, key=key)
