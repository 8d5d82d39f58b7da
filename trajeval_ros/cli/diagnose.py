"""`trajeval diagnose`: tests of a pair of trajectories for common mistakes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from trajeval_ros.cli import options
from trajeval_ros.cli.progress import progress
from trajeval_ros.cli.source_names import names_of
from trajeval_ros.diagnosis.evaluation_diagnosis import diagnose_evaluation, diagnose_sides
from trajeval_ros.diagnosis.findings import Diagnosis
from trajeval_ros.exceptions import SettingsError, TrajevalError
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.json_file import json_text
from trajeval_ros.io.requests.request_words import AUTO, request_from
from trajeval_ros.io.results.diagnosis_json import diagnosis_json
from trajeval_ros.io.sources import read_many
from trajeval_ros.io.writing import write_text
from trajeval_ros.metrics.evaluation import evaluate
from trajeval_ros.metrics.protocol import Protocol


def diagnose(
    groundtruth: Annotated[
        str, typer.Argument(metavar="GROUNDTRUTH", help="Source, as for `trajeval evaluate`.")
    ],
    estimate: Annotated[
        str, typer.Argument(metavar="ESTIMATE", help="Source, as for `trajeval evaluate`.")
    ],
    modality: options.ModalityOption = None,
    gauge: options.GaugeOption = None,
    association: options.AssociationOption = None,
    max_gap: options.MaxGapOption = None,
    time_offset: options.TimeOffsetOption = None,
    up: options.UpOption = None,
    json: options.JsonOption = None,
) -> None:
    """Searches for mistakes that explain a bad or suspicious result.

    Prints every test with its statistics and its result, or the reason why it is not applicable
    (docs/diagnosis.md). Findings do not change any result. To correct a mistake, use --fix of
    trajeval evaluate.

        trajeval diagnose groundtruth.txt estimate.txt --modality stereo-inertial
    """
    if time_offset == AUTO:
        raise SettingsError(
            "--time-offset auto: diagnose estimates the clock offset anyway; remove it, or give "
            "seconds"
        )
    request = request_from(
        {
            "modality": modality,
            "gauge": gauge,
            "association": association,
            "max_gap": max_gap,
            "time_offset": time_offset,
            "up": up,
        }
    )
    sources = [groundtruth, estimate]
    with progress(f"reading {', '.join(names_of(sources))}") as advance:
        truth, other = read_many(sources, advance=advance, covariances=[False, True])
    request = request.for_trajectories(truth, [other])
    found, refused = _of(truth, other, request.protocol)
    if json is not None:
        text = json_text({"findings": diagnosis_json(found), "examined": _scores(found)}, indent=2)
        if json == "-":
            typer.echo(text)
            return
        write_text(Path(json), text, follow_link=True)
    _print(found, refused)


def _scores(found: Diagnosis) -> list[dict[str, Any]]:
    return [
        {
            "test": each.test,
            "scores": {
                name: value if math.isfinite(value) else None
                for name, value in each.scores.items()
            },
            "seen": [seen.cause for seen in each.seen],
            "why_not": each.why_not or None,
        }
        for each in found.examined
    ]


def _of(truth: Trajectory, estimate: Trajectory, protocol: Protocol) -> tuple[Diagnosis, str]:
    """Return the diagnosis, and the reason if an evaluation is not possible, else ""."""
    try:
        evaluation = evaluate(truth, estimate, protocol)
    except TrajevalError as error:
        return diagnose_sides(truth, estimate, protocol), str(error)
    return diagnose_evaluation(evaluation, truth, estimate), ""


def _print(found: Diagnosis, refused: str) -> None:
    from trajeval_ros.report.console import console
    from trajeval_ros.report.diagnosis_lines import explanation

    terminal = console()
    if refused:
        terminal.print(f"evaluation not possible: {refused}", soft_wrap=True)
    for each in found.findings:
        terminal.print(
            f"{each.cause} ({each.confidence}, explains {100.0 * each.explained:.0f} % of the "
            f"error): {each.text}",
            soft_wrap=True,
        )
    if not found.findings:
        terminal.print(
            "no mistake found; docs/diagnosis.md lists mistakes that recordings cannot reveal",
            soft_wrap=True,
        )
    terminal.print("\ntests, their results and statistics:")
    for line in explanation(found):
        terminal.print(f"  {line}", soft_wrap=True)
