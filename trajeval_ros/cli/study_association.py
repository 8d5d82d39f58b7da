"""`trajeval study association`: association methods on degraded groundtruth."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from trajeval_ros.cli.command import verb
from trajeval_ros.cli.options import STUDY_ASSOCIATION, option, shared_options
from trajeval_ros.cli.programs import write_json
from trajeval_ros.cli.progress import read_shown, report_dropped
from trajeval_ros.continuous_time.samples import DEFAULT_MODEL, MODELS
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.io.requests.setting import two_numbers
from trajeval_ros.io.source_names import names_of

if TYPE_CHECKING:
    from trajeval_ros.geometry.trajectory import Trajectory
    from trajeval_ros.papers.association_study import AssociationComparison, Degradation


_DROPOUT_LENGTH = "1,2.5"


_PARAMETERS = (
    *shared_options(STUDY_ASSOCIATION),
    option("--modality", metavar="NAME", help="Sensors of the estimator."),
    option("--gauge", metavar="NAME", help="Gauge of the alignment. Default: se3."),
    option("--rate", kind=float, metavar="HZ", default=2.0,
        help="Rate of the degraded groundtruth, in Hz."),
    option("--dropouts", kind=int, metavar="N", default=3, help="Number of dropouts."),
    option("--dropout-length", metavar="MIN,MAX", default=_DROPOUT_LENGTH,
        help="Shortest and longest dropout, in seconds."),
    option("--groundtruth-noise", metavar="P,R", default="0.002,0.1",
        help="Standard deviations of the noise that is added to the degraded groundtruth: "
        "position (m), rotation (deg). The motion model uses the same values."),
    option("--continuous-model", metavar="NAME", default=DEFAULT_MODEL,
        help=f"Motion models for continuous groundtruth: {', '.join(MODELS)}."),
    option("--seed", kind=click.IntRange(min=0), default=0, help="Seed of noise and dropouts."),
)  # fmt: skip


@verb(*_PARAMETERS)
def study_association(
    groundtruth: str | None,
    estimate: Sequence[str],
    json: str | None,
    modality: str | None,
    gauge: str | None,
    rate: float,
    dropouts: int,
    dropout_length: str,
    groundtruth_noise: str,
    continuous_model: str,
    seed: int,
) -> None:
    """Compares association methods on groundtruth with a reduced rate and dropouts.

    Takes accurate groundtruth, such as motion capture, reduces its rate and adds dropouts. All
    association methods are evaluated on the degraded groundtruth, and compared with the accurate
    one:

        trajeval study association -g groundtruth.csv -e estimate.txt --rate 2
    """
    from trajeval_ros.io.requests.request_from import protocol_from
    from trajeval_ros.papers.association_study import Degradation, compare_associations

    if groundtruth is None or not estimate:
        raise SettingsError("groundtruth or estimate missing; give --groundtruth and --estimate")
    if not dropouts and dropout_length != _DROPOUT_LENGTH:
        raise SettingsError("--dropout-length needs dropouts; increase --dropouts, or remove it")
    shortest, longest = _durations(dropout_length)
    protocol = protocol_from(
        "default",
        gauge=gauge,
        modality=modality,
        association="continuous",
        continuous_model=continuous_model,
        groundtruth_noise=groundtruth_noise,
        lengths="none",
    )
    noise = protocol.association.noise
    degradation = Degradation(rate, dropouts, shortest, longest, noise, seed)
    sources = [groundtruth, *estimate]
    accurate, *estimates = read_shown(sources, names_of(sources))
    poor = degradation.of(accurate)
    comparisons = [compare_associations(accurate, poor, item, protocol) for item in estimates]
    if json != "-":
        _print(comparisons, degradation, poor)
    content: dict[str, Any] = {
        "degradation": dataclasses.asdict(degradation) | {"samples_left": len(poor)},
        "estimates": [dataclasses.asdict(comparison) for comparison in comparisons],
    }
    write_json(json, content)
    report_dropped([accurate, *estimates])


def _durations(text: str) -> tuple[float, float]:
    mistake = "give the shortest and the longest duration in seconds, as in 1,2.5"
    return two_numbers(text, f"--dropout-length {text!r} is not valid; {mistake}")


def _print(
    comparisons: list[AssociationComparison], degradation: Degradation, poor: Trajectory
) -> None:
    from trajeval_ros.papers.association_study import association_table
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
        for item in comparison.reported:
            if item.reason:
                terminal.print(f"  {item.association}: {item.reason}", soft_wrap=True)
    terminal.file.flush()
