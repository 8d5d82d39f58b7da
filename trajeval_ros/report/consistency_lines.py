"""The results of consistency and integrity tests as lines of text and table rows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.formatting.numbers import NOTHING, four_digits, percent

if TYPE_CHECKING:
    from trajeval_ros.consistency.consistency_result import Consistency
    from trajeval_ros.consistency.integrity import Integrity

INTEGRITY_WORDS = ("estimate", "integrity")
INTEGRITY_NUMBERS = (
    *("alert limit", "level (median)", "error (median)", "available", "nominal", "misleading"),
    *("hazardous", "95 % of hazardous", "over level", "inflation", "time to alert", "missed"),
)


def consistency_lines(name: str, consistency: Consistency) -> list[str]:
    """Return the result of a consistency test as lines."""
    lines = [
        "",
        f"{name}: {consistency.verdict}; covariances from {consistency.covariance_source}, gauge "
        f"{consistency.gauge.value}",
        f"  {consistency.statement}",
    ]
    joint, per_pose = consistency.joint, consistency.per_pose
    if joint is not None:
        low, high = joint.band_95
        lines.append(
            f"  joint NEES / dof {joint.nees / joint.dof:.3f} (95 % interval of consistent runs: "
            f"{low:.3f} to {high:.3f}; {joint.dof} dof)"
        )
    if per_pose is not None:
        # Errors of one run are correlated: the interval needs a known number of effective dof.
        band = ""
        if per_pose.band_95 is not None and per_pose.effective_dof is not None:
            low, high = per_pose.band_95
            band = (
                f" (95 % interval of consistent runs: {low:.2f} to {high:.2f}; "
                f"{per_pose.effective_dof:.1f} effective of {6 * per_pose.poses} dof)"
            )
        limit = ""
        if per_pose.limit_95 is not None:
            limit = f" (95 % of consistent runs: below {per_pose.limit_95:.2f})"
        position, rotation = per_pose.position, per_pose.rotation
        moved, rotation_axes = consistency.axes
        lines += [
            f"  NEES / {moved + rotation_axes} of single poses: mean {per_pose.mean:.3f}{band}, "
            f"largest {per_pose.max:.3f}{limit}",
            f"  NEES / {rotation_axes} of orientations: mean {rotation.mean:.3f}, largest "
            f"{rotation.max:.3f}",
            f"  NEES / {moved} of positions: mean {position.mean:.3f}, largest {position.max:.3f}",
        ]
        if consistency.exactness == "as published":
            lines.append(
                f"  NEES as printed by ov_eval: mean_ori = {3.0 * rotation.mean:.3f} | mean_pos "
                f"= {3.0 * position.mean:.3f}"
            )
    return lines


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
