"""Associations of one estimate side by side, for a terminal or a pipe."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trajeval_ros.report.numbers import number
from trajeval_ros.report.tables import new_table

if TYPE_CHECKING:
    from rich.table import Table

    from trajeval_ros.likelihood.association_study import AssociationComparison


def association_table(comparison: AssociationComparison) -> Table:
    """Return a row for the truth and one for each association."""
    true = comparison.true_ate_m
    table = new_table(f"{comparison.name}: position ATE by association")
    table.add_column("association")
    for heading in ("ATE [m]", "by the true one", "of poses", "approx. 95 % [m]"):
        table.add_column(heading, justify="right")
    table.add_row("all groundtruth (the truth)", number(true), "1", "", "")
    for each in comparison.reported:
        ratio = interval = "-"
        if each.ate_m is not None and true > 0.0:
            ratio = number(each.ate_m / true)
        if each.interval_m is not None:
            interval = f"{number(each.interval_m[0])} to {number(each.interval_m[1])}"
        table.add_row(
            each.association,
            "-" if each.ate_m is None else number(each.ate_m),
            ratio,
            f"{100.0 * each.share:.0f} %",
            interval,
        )
    return table
