"""`trajeval compare-association`: association methods on degraded groundtruth."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from trajeval_ros.cli.source_names import names_of
from trajeval_ros.continuous_time.models import DEFAULT_MODEL, MODELS
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.formatting.numbers import counted

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory
    from trajeval_ros.likelihood.association_study import AssociationComparison
    from trajeval_ros.likelihood.degradation import Degradation


_DROPOUT_LENGTH = "1,2.5"


def compare_association(
    groundtruth: Annotated[
        str,
        typer.Option(
            "--groundtruth",
            "-g",
            metavar="SOURCE",
            help="Accurate and dense groundtruth; see `trajeval evaluate`.",
        ),
    ],
    estimate: Annotated[
        list[str],
        typer.Option(
            "--estimate",
            "-e",
            metavar="SOURCE",
            help="Trajectory to evaluate. Repeat the option to compare several.",
        ),
    ],
    modality: Annotated[
        str | None, typer.Option(help="Sensors of the estimator; see `trajeval evaluate`.")
    ] = None,
    gauge: Annotated[
        str | None,
        typer.Option(help="Gauge of the alignment; see `trajeval evaluate`. Default: se3."),
    ] = None,
    rate: Annotated[
        float, typer.Option(metavar="HZ", help="Rate of the degraded groundtruth, in Hz.")
    ] = 2.0,
    dropouts: Annotated[int, typer.Option(metavar="N", help="Number of dropouts.")] = 3,
    dropout_length: Annotated[
        str, typer.Option(metavar="MIN,MAX", help="Shortest and longest dropout, in seconds.")
    ] = _DROPOUT_LENGTH,
    groundtruth_noise: Annotated[
        str,
        typer.Option(
            metavar="P,R",
            help="Standard deviations of the noise that is added to the degraded groundtruth: "
            "position (m), rotation (deg). The motion model uses the same values.",
        ),
    ] = "0.002,0.1",
    continuous_model: Annotated[
        str,
        typer.Option(
            metavar="NAME", help=f"Motion models for continuous groundtruth: {', '.join(MODELS)}."
        ),
    ] = DEFAULT_MODEL,
    seed: Annotated[int, typer.Option(min=0, help="Seed of noise and dropouts.")] = 0,
    json: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|-", help="JSON output file. With -, only the JSON is printed to stdout."
        ),
    ] = None,
) -> None:
    """Compares association methods on groundtruth with a reduced rate and dropouts.

    Takes accurate groundtruth, such as motion capture, reduces its rate and adds dropouts. All
    association methods are evaluated on the degraded groundtruth, and compared with the accurate
    one:

        trajeval compare-association -g groundtruth.csv -e estimate.txt --rate 2
    """
    from trajeval_ros.io.requests.request_words import parse_noise
    from trajeval_ros.likelihood.association_study import compare_associations
    from trajeval_ros.likelihood.degradation import Degradation
    from trajeval_ros.metrics.settings import protocol_from

    if not dropouts and dropout_length != _DROPOUT_LENGTH:
        raise SettingsError("--dropout-length needs dropouts; increase --dropouts, or remove it")
    shortest, longest = _durations(dropout_length)
    protocol = protocol_from(
        "default",
        gauge=gauge,
        modality=modality,
        association="continuous",
        continuous_model=continuous_model,
        groundtruth_noise=parse_noise(groundtruth_noise),
        lengths="none",
    )
    noise = protocol.association.noise
    degradation = Degradation(rate, dropouts, shortest, longest, noise, seed)
    truth, *estimates = _read([groundtruth, *estimate])
    poor = degradation.of(truth)
    comparisons = [compare_associations(truth, poor, each, protocol) for each in estimates]
    if json != "-":
        _print(comparisons, degradation, poor)
    if json is not None:
        _write(json, comparisons, degradation, poor)


def _durations(text: str) -> tuple[float, float]:
    try:
        shortest, longest = (float(part) for part in text.split(","))
    except ValueError:
        raise SettingsError(
            f"--dropout-length {text!r} is not valid; give the shortest and the longest duration "
            "in seconds, as in 1,2.5"
        ) from None
    return shortest, longest


def _read(sources: list[str]) -> list[Trajectory]:
    from trajeval_ros.cli.progress import progress
    from trajeval_ros.io.sources import read_trajectory

    found = []
    for source, name in zip(sources, names_of(sources), strict=True):
        with progress(f"reading {name}") as advance:
            read = read_trajectory(source, advance=advance)
        found.append(dataclasses.replace(read, name=name))
    return found


def _print(
    comparisons: list[AssociationComparison], degradation: Degradation, poor: Trajectory
) -> None:
    from trajeval_ros.report.association_table import association_table
    from trajeval_ros.report.console import console, show

    terminal = console()
    terminal.print(
        f"degraded groundtruth: {counted(len(poor), 'sample')} at {degradation.rate_hz:g} Hz, "
        f"{counted(degradation.dropouts, 'dropout')} of {degradation.shortest_s:g} to "
        f"{degradation.longest_s:g} s, noise {degradation.noise.position_m:g} m",
        soft_wrap=True,
    )
    for comparison in comparisons:
        terminal.print()
        show(terminal, association_table(comparison))
        for each in comparison.reported:
            if each.reason:
                terminal.print(f"  {each.association}: {each.reason}", soft_wrap=True)
    terminal.file.flush()


def _write(
    target: str,
    comparisons: list[AssociationComparison],
    degradation: Degradation,
    poor: Trajectory,
) -> None:
    from trajeval_ros.io.json_file import json_text
    from trajeval_ros.io.writing import write_text

    content: dict[str, Any] = {
        "degradation": dataclasses.asdict(degradation) | {"samples_left": len(poor)},
        "estimates": [dataclasses.asdict(each) for each in comparisons],
    }
    if target == "-":
        sys.stdout.write(json_text(content, indent=2))
    else:
        write_text(Path(target), json_text(content, indent=2), follow_link=True)
