"""Integrity as table rows and lines of text."""

from __future__ import annotations

import numpy as np

from trajeval_ros.consistency.integrity import Integrity
from trajeval_ros.formatting.numbers import NOTHING, four_digits, percent

INTEGRITY_WORDS = ("estimate", "integrity")
INTEGRITY_NUMBERS = (
    *("alert limit", "level (median)", "error (median)", "available", "nominal", "misleading"),
    *("hazardous", "95 % of hazardous", "over level", "inflation", "time to alert", "missed"),
)


def integrity_rows(name: str, integrity: Integrity) -> list[tuple[str, ...]]:
    """Return a row per part of the pose."""
    rows: list[tuple[str, ...]] = []
    for part in integrity.parts:
        low, high = part.hazardous_95
        median = part.time_to_alert.median
        episodes = part.time_to_alert.missed + len(part.time_to_alert.seconds)
        level, error = (float(np.median(values)) for values in (part.levels, part.errors))
        rows.append(
            (
                name,
                part.part,
                f"{part.alert_limit:g} {part.unit}",
                f"{four_digits(level)} {part.unit}",
                f"{four_digits(error)} {part.unit}",
                percent(part.availability),
                percent(part.areas["nominal"]),
                percent(part.areas["misleading"]),
                percent(part.areas["hazardous"]),
                f"{100.0 * low:.1f} to {100.0 * high:.1f} %",
                percent(1.0 - part.bounded),
                f"{part.inflation:.3g}",
                NOTHING if median is None else f"{median:.2f} s",
                f"{part.time_to_alert.missed} of {episodes}",
            )
        )
    return rows


def integrity_lines(name: str, integrity: Integrity) -> list[str]:
    """Return the definition of the numbers and their limitations."""
    effective = min(part.effective for part in integrity.parts)
    lines = [
        f"{name}: protection levels from the largest axis of the covariance, at risk "
        f"{integrity.risk:g}; effective number of independent poses: {effective:.0f}, which "
        f"can confirm a risk below {min(3.0 / effective, 1.0):.2g} (95 %)"
    ]
    if integrity.exactness == "bound":
        lines.append(
            "  levels are upper bounds (cross-covariances are unknown): hazardous poses are "
            "confirmed, their absence is not"
        )
    return lines
