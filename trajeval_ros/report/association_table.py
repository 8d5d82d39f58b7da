"""Associations of one estimate side by side, for a terminal or a pipe."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trajeval_ros.formatting.numbers import NOTHING, four_digits, whole_percent
from trajeval_ros.report.console import add_rows, new_table

if TYPE_CHECKING:
    from rich.table import Table

    from trajeval_ros.likelihood.association_study import AssociationComparison


def association_table(comparison: AssociationComparison) -> Table:
    """Return a row for the truth and one for each association."""
    true = comparison.true_ate_m
    table = new_table(
        f"{comparison.name}: position ATE by association",
        ["association"],
        ["ATE [m]", "by the accurate groundtruth", "of poses", "approx. 95 % [m]"],
    )
    rows = [["all groundtruth (accurate)", four_digits(true), "1", "", ""]]
    for each in comparison.reported:
        ratio = interval = NOTHING
        if each.ate_m is not None and true > 0.0:
            ratio = four_digits(each.ate_m / true)
        if each.interval_m is not None:
            interval = " to ".join(map(four_digits, each.interval_m))
        ate = NOTHING if each.ate_m is None else four_digits(each.ate_m)
        rows.append([each.association, ate, ratio, whole_percent(each.share), interval])
    add_rows(table, rows)
    return table
