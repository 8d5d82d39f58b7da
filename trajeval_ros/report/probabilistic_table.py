"""Tables of likelihoods and of the ATE against uncertain groundtruth."""

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
    """Return a row per estimate."""
    first = next(iter(assessments.values()))
    noise = first.continuous.samples.noise
    rivals = ["log Bayes factor, best competitor"] if len(assessments) > 1 else []
    table = new_table(
        f"Against continuous groundtruth, model {first.continuous.model}, noise "
        f"{noise.position_m:g} m",
        ["estimate"],
        [*_NUMBERS, *rivals],
    )
    for name, assessment in assessments.items():
        against = [_against_rivals(assessment)] if rivals else []
        add_rows(table, [[name, *_cells(assessment), *against]])
    return table


def probabilistic_lines(assessments: Mapping[str, Assessment]) -> list[str]:
    """Return the remarks that all estimates share once, then the others with names."""
    remarks = [dict.fromkeys(assessment.statements) for assessment in assessments.values()]
    shared = [line for line in remarks[0] if all(line in own for own in remarks)]
    lines = [f"  {line}" for line in shared]
    for name, own in zip(assessments, remarks, strict=True):
        lines += [f"  {name}: {line}" for line in own if line not in shared]
    return lines


def _cells(assessment: Assessment) -> list[str]:
    """Return the numbers of an estimate as texts."""
    ate, scores = assessment.ate, assessment.gauge_scores
    interval = NOTHING
    if ate.interval_m is not None:
        interval = " to ".join(map(four_digits, ate.interval_m))
    scale = tilt = NOTHING
    # Unobservable quantities are no errors: frames can be tilted, and a camera has no scale.
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
    """Return the log Bayes factor against the best competitor."""
    if not assessment.log_bayes:
        return NOTHING
    return f"{min(assessment.log_bayes.values()):+.1f}"
