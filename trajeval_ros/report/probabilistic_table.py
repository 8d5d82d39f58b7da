"""Likelihoods and the ATE against uncertain groundtruth, for a terminal or a pipe."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from trajeval_ros.formatting.numbers import NOTHING, four_digits, whole_percent
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.report.console import add_rows, new_table

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
    rivals = ["log Bayes factor, best competitor"] if len(assessments) > 1 else []
    table = new_table(
        f"Against continuous groundtruth, model {first.continuous.model}, noise "
        f"{noise.position_m:g} m",
        ["estimate"],
        [*_NUMBERS, *rivals],
    )
    for name, each in assessments.items():
        against = [_against_rivals(each)] if rivals else []
        add_rows(table, [[name, *_cells(each), *against]])
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
    interval = NOTHING
    if ate.interval_m is not None:
        interval = " to ".join(map(four_digits, ate.interval_m))
    scale = tilt = NOTHING
    # What the sensors don't observe is no error: frames may be tilted, and a camera has no scale.
    gauge = assessment.error.residuals.gauge
    if scores is not None and scores.scale is not None and gauge is not Gauge.SIM3:
        scale = f"{scores.scale.z[0]:+.1f}"
    if scores is not None and gauge is Gauge.YAW:
        tilt = ", ".join(f"{z:+.1f}" for z in scores.tilt.z)
    return [
        NOTHING if ate.supported_m is None else four_digits(ate.supported_m),
        whole_percent(ate.supported_share),
        interval,
        four_digits(ate.weighted_m),
        f"{assessment.error.nll_per_pose:.2f}",
        f"{assessment.error.chi2_per_dof:.3g}",
        scale,
        tilt,
    ]


def _against_rivals(assessment: Assessment) -> str:
    if not assessment.log_bayes:
        return NOTHING
    return f"{min(assessment.log_bayes.values()):+.1f}"
