"""Likelihoods and the ATE against uncertain groundtruth, for a terminal or a pipe."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.report.numbers import number
from trajeval_ros.report.tables import new_table

if TYPE_CHECKING:
    from rich.table import Table

    from trajeval_ros.likelihood.assessment import Assessment

_NUMBERS = (
    "ATE supported [m]",
    "of poses",
    "approx. 95 % [m]",
    "ATE weighted [m]",
    "NLL/pose [nats]",
    "chi2/dof",
    "scale z",
    "tilt z",
)


def probabilistic_table(assessments: Mapping[str, Assessment]) -> Table:
    """Return a row for each estimate, by name."""
    first = next(iter(assessments.values()))
    noise = first.continuous.samples.noise
    table = new_table(
        f"Against continuous groundtruth, model {first.continuous.model}, noise "
        f"{noise.position_m:g} m"
    )
    table.add_column("estimate")
    for heading in _NUMBERS:
        table.add_column(heading, justify="right")
    if len(assessments) > 1:
        table.add_column("log Bayes factor, best rival", justify="right")
    for name, assessment in assessments.items():
        table.add_row(name, *_cells(assessment), *_against_rivals(assessment, len(assessments)))
    return table


def probabilistic_lines(assessments: Mapping[str, Assessment]) -> list[str]:
    """Return what a reader must know: what all estimates share once, the rest by name."""
    told = [dict.fromkeys(each.statements) for each in assessments.values()]
    shared = [line for line in told[0] if all(line in each for each in told)]
    lines = [f"  {line}" for line in shared]
    for name, statements in zip(assessments, told, strict=True):
        lines += [f"  {name}: {line}" for line in statements if line not in shared]
    return lines


def _cells(assessment: Assessment) -> list[str]:
    ate, scores = assessment.ate, assessment.gauge_scores
    interval = "-"
    if ate.interval_m is not None:
        interval = f"{number(ate.interval_m[0])} to {number(ate.interval_m[1])}"
    scale = tilt = "-"
    # What the sensors don't observe is no error: frames may be tilted, and a camera has no scale.
    gauge = assessment.error.residuals.gauge
    if scores is not None and scores.scale is not None and gauge is not Gauge.SIM3:
        scale = f"{scores.scale.z[0]:+.1f}"
    if scores is not None and gauge is Gauge.YAW:
        tilt = ", ".join(f"{z:+.1f}" for z in scores.tilt.z)
    return [
        "-" if ate.supported_m is None else number(ate.supported_m),
        f"{100.0 * ate.supported_share:.0f} %",
        interval,
        number(ate.weighted_m),
        f"{assessment.error.nll_per_pose:.2f}",
        f"{assessment.error.chi2_per_dof:.3g}",
        scale,
        tilt,
    ]


def _against_rivals(assessment: Assessment, estimates: int) -> list[str]:
    if estimates < 2:
        return []
    if not assessment.log_bayes:
        return ["-"]
    return [f"{min(assessment.log_bayes.values()):+.1f}"]
