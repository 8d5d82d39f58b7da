"""The plan of a comparison: all runs that exist, and missing ones."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.geometry.time_span import TimeSpan
from trajeval_ros.io.text.hints import NO_HINTS, TextHints
from trajeval_ros.pipeline.request import Request

Name = tuple[str, str, str]


@dataclass(frozen=True)
class PlannedRun:
    """One run of an algorithm, which may be missing.

    Attributes:
        algorithm: Name of the estimator.
        sequence: Name of the recording.
        trial: Name of the repetition; "" if there is only one.
        groundtruth: SOURCE of the groundtruth.
        estimate: SOURCE of the estimate.
        missing: Why it has no files; "" if it has.
        time_span: The time span to evaluate, by a file of its folder; None for all.
        hints: Columns and frame rate of the estimate's text file.
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
        """Algorithm, sequence and trial, separated by spaces."""
        return " ".join(filter(None, (self.algorithm, self.sequence, self.trial)))


@dataclass(frozen=True)
class Plan:
    """A comparison before its evaluation.

    Attributes:
        title: Title of the report.
        runs: All runs by algorithm, sequence and trial, including missing ones.
        request: The evaluation of every run.
        common_time_span: Whether to evaluate only the time that all runs of a sequence cover.
    """

    title: str
    runs: tuple[PlannedRun, ...]
    request: Request
    common_time_span: bool = False

    def request_of(self, run: PlannedRun) -> Request:
        """Return the evaluation of a run, with its own time span unless the request has one."""
        if run.time_span is None or self.request.time_span is not None:
            return self.request
        return dataclasses.replace(self.request, time_span=run.time_span)

    @property
    def settings(self) -> dict[str, Any]:
        """All settings that the numbers depend on."""
        request, protocol = self.request, self.request.protocol
        rule, selection = protocol.association, protocol.selection
        continuous = rule.method == "continuous"
        return {
            "protocol": protocol.name,
            "gauge": protocol.gauge.value,
            "modality": protocol.modality,
            "align_states": "all" if protocol.align_states is None else protocol.align_states,
            "align_with": protocol.align_with,
            "apply": protocol.apply,
            "align_weights": protocol.align_weights,
            "association": rule.method,
            "max_time_difference": rule.max_time_difference_s,
            "max_gap": rule.max_gap_s,
            "time_offset": rule.time_offset_s,
            "continuous_model": rule.model if continuous else None,
            "groundtruth_noise": dataclasses.asdict(rule.noise) if continuous else None,
            "in_order": protocol.in_order,
            "ate_form": protocol.ate_form,
            "re_form": protocol.re_form,
            "lengths": [str(length) for length in protocol.lengths],
            "selection": str(selection),
            "lever_m": None if protocol.lever_m is None else list(protocol.lever_m),
            "calibrate_time_offset": request.calibration.offset,
            "hand_eye": _hand_eye(request.calibration),
            "covariance": request.covariances.source,
            "rotation_covariance_frame": request.covariances.rotation_frame,
            "covariance_groundtruth_noise": request.covariances.groundtruth_noise,
            "integrity": None
            if request.integrity is None
            else dataclasses.asdict(request.integrity),
            "mends": dataclasses.asdict(request.mends) if request.mends.anything else None,
            "common_time_span": self.common_time_span,
        }


def _hand_eye(calibration: CalibrationRequest) -> str | list[float]:
    known = calibration.known
    if known is not None:
        return [*known.rotation_xyzw.tolist(), *known.lever_m.tolist()]
    return "auto" if calibration.hand_eye else "none"


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

    Args:
        algorithms: In the order of the tables.
        estimates: SOURCE by algorithm, sequence and trial.
        groundtruths: Returns the SOURCE for algorithm and sequence; "" if there is none.
        where: Returns the expected path of a missing run.
        sequences: All expected sequences; by default those of the estimates.
        trials: All expected trials of algorithms with trials; by default those of the estimates.
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
    """Return names in natural order: trial 2 before trial 10."""

    def key(name: str) -> list[tuple[bool, int, str]]:
        pieces = re.findall(r"[0-9]+|[^0-9]+", name)
        return [(False, int(each), "") if each.isdecimal() else (True, 0, each) for each in pieces]

    return sorted(names, key=key)
