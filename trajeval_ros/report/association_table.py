"""Table of several associations of one estimate."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trajeval_ros.formatting.numbers import NOTHING, four_digits, whole_percent
from trajeval_ros.report.console import add_rows, new_table

if TYPE_CHECKING:
    from rich.table import Table

    from trajeval_ros.likelihood.association_study import AssociationComparison


def association_table(comparison: AssociationComparison) -> Table:
    """Return a row for the accurate groundtruth and one per association."""
    true = comparison.true_ate_m
    table = new_table(
        f"{comparison.name}: position ATE by association",
        ["association"],
        ["ATE [m]", "by the accurate groundtruth", "of poses", "approx. 95 % [m]"],
    )
    rows = [["all groundtruth (accurate)", four_digits(true), "1", "", ""]]
    for reported in comparison.reported:
        ratio = interval = NOTHING
        if reported.ate_m is not None and true > 0.0:
            ratio = four_digits(reported.ate_m / true)
        if reported.interval_m is not None:
            interval = " to ".join(map(four_digits, reported.interval_m))
        ate = NOTHING if reported.ate_m is None else four_digits(reported.ate_m)
        rows.append([reported.association, ate, ratio, whole_percent(reported.share), interval])
    add_rows(table, rows)
    return table
