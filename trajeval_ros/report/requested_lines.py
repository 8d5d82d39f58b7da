"""The lines about what is computed on request: calibration, consistency, as-available errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.calibration.significance import CHANCE
from trajeval_ros.formatting.numbers import (
    NOTHING,
    counted,
    four_digits,
    percent,
    significant,
    with_unit,
)
from trajeval_ros.metrics.as_available import Availability, Spans
from trajeval_ros.metrics.statistics import Statistics
from trajeval_ros.metrics.stream_health import StreamHealth

if TYPE_CHECKING:
    from trajeval_ros.calibration.apply import Ate, Calibrated
    from trajeval_ros.calibration.significance import Parameter
    from trajeval_ros.consistency.consistency_result import Consistency
    from trajeval_ros.consistency.integrity import Integrity

_STATUSES = {"insignificant": "not significant", "weak": "inconclusive"}
# Least relative increase of the position ATE that is explained; it is printed to four digits.
_GROWN = 1.001
INTEGRITY_WORDS = ("estimate", "integrity")
INTEGRITY_NUMBERS = (
    *("alert limit", "level (median)", "error (median)", "available", "nominal", "misleading"),
    *("hazardous", "95 % of hazardous", "over level", "inflation", "time to alert", "missed"),
)
_CLOCKS = {"log": "log times", "publish": "publish times"}


def calibration_lines(name: str, calibrated: Calibrated) -> list[str]:
    """Return the parameters, whether they were applied and why, and the ATE before and after."""
    calibration, request = calibrated.calibration, calibrated.request
    lines = ["", f"{name}: calibration" + _source(name, calibrated)]
    if calibration is not None and request.offset:
        offset = calibration.offset
        text = _quantity(offset, 1e3, "ms", "{:+.1f}")
        rows = [
            f"from {kind}s {1e3 * calibration.rows[kind][0]:+.1f} ms"
            for kind in ("rotation", "position")
            if kind in calibration.rows
        ]
        text += f" ({', '.join(rows)})" if rows and offset.value is not None else ""
        lines.append(_line("clock offset", text, offset, calibrated.offset_applied))
    if calibration is not None and request.hand_eye:
        rotation, lever = calibration.rotation, calibration.lever
        text = "unknown"
        if rotation.value is not None and rotation.half_width_95 is not None:
            width = float(np.degrees(rotation.half_width_95.max()))
            text = f"{np.degrees(np.linalg.norm(rotation.value)):.2f} deg +- {width:.2g} (95 %)"
        lines.append(_line("body rotation", text, rotation, calibrated.rotation_applied))
        text = _quantity(lever, 1.0, "m", "{:.3f}")
        lines.append(_line("lever arm", text, lever, calibrated.lever_applied))
    if request.known is not None:
        arm = " ".join(f"{component:.4g}" for component in request.known.lever_m)
        lines.append(f"  hand-eye       lever arm {arm} m, from {request.source}: applied")
    lines.append("  " + _ate(calibrated))
    return lines + _growth(calibrated)


def _source(name: str, calibrated: Calibrated) -> str:
    """Return a remark if the calibration is from another estimate."""
    if calibrated.calibration is None or calibrated.estimated_from == name:
        return ""
    return f" from {calibrated.estimated_from}, applied to all estimates"


def _line(label: str, text: str, parameter: Parameter, applied: bool) -> str:
    verdict = "applied" if applied else "not applied"
    if parameter.value is None:
        return f"  {label:<14} {verdict}: {parameter.reason}"
    status = _STATUSES.get(parameter.status, parameter.status)
    if parameter.status == "insignificant" and parameter.reason.startswith("p "):
        # The test is stricter than the 95 % interval, which may exclude zero.
        status += f" (required: p < {CHANCE:g})"
    return f"  {label:<14} {text}: {status}, {verdict}; {parameter.reason}"


def _quantity(parameter: Parameter, factor: float, unit: str, form: str) -> str:
    """Return value and 95 % interval of a parameter in a unit, `factor` times its own."""
    if parameter.value is None or parameter.half_width_95 is None:
        return "unknown"
    value = " ".join(form.format(factor * component) for component in parameter.value)
    widths = factor * parameter.half_width_95
    if np.isnan(widths).any():
        width = " ".join("?" if np.isnan(width) else f"{width:.2g}" for width in widths)
    else:
        width = f"{widths.max():.2g}"
    return f"{value} {unit} +- {width} (95 %)"


def _ate(calibrated: Calibrated) -> str:
    """Return the ATE with and without the calibration, and the number of applied parameters."""
    before, after, anyway = calibrated.before, calibrated.after, calibrated.if_applied
    of_whom = "marker" if calibrated.of_marker else "body"
    text = f"ATE of the {of_whom}: {_both(after)}"
    if before is None:
        text += "; before, too few pairs for an alignment"
    elif calibrated.offset_applied or calibrated.hand_eye is not None:
        text += f"; before {_both(before)}"
    if anyway is not None:
        text += f"; with all parameters applied {_both(anyway)}"
    if calibrated.calibration is not None:
        text += (
            f"; {calibrated.parameters_applied} of {calibrated.calibration.fitted} parameters "
            "applied; standard deviations from "
            f"{counted(calibrated.calibration.blocks, 'time block')}"
        )
    return text


def _growth(calibrated: Calibrated) -> list[str]:
    """Return an explanation if the calibration has increased the position ATE."""
    before, after, anyway = calibrated.before, calibrated.after, calibrated.if_applied
    if calibrated.calibration is None or before is None:
        return []
    if not calibrated.parameters_applied or after.position_m <= _GROWN * before.position_m:
        return []
    grown = 100.0 * (after.position_m / before.position_m - 1.0)
    text = (
        f"  the position ATE increases by {grown:.2g} %: the calibration minimises motion errors "
        "over about 1 s, not the ATE, and errors of clock, lever arm and drift can cancel "
        "without it"
    )
    missing = calibrated.request.hand_eye and not calibrated.lever_applied
    if missing and anyway is not None and anyway.position_m < before.position_m:
        text += f"; with the lever arm, which is not applied, it is {anyway.position_m:.4g} m"
    return [text]


def _both(ate: Ate) -> str:
    """Return position and rotation ATE as a text."""
    rotation_text = "" if ate.rotation_deg is None else f" {with_unit(ate.rotation_deg, 'deg')}"
    return f"{with_unit(ate.position_m, 'm')}{rotation_text}"


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


def stream_line(stream: StreamHealth) -> str:
    """Return the line about arrivals, missed messages and gaps of a stream; "" if none."""
    parts = []
    if stream.arrival_p50_s is not None and stream.arrival_p95_s is not None:
        median, p95, most = (
            significant(item or 0.0, 3)
            for item in (stream.arrival_p50_s, stream.arrival_p95_s, stream.arrival_max_s)
        )
        parts.append(f"arrival after timestamp {median} s median, {p95} s p95, {most} s max")
    if stream.missed:
        parts.append(f"{stream.missed} of {stream.messages + stream.missed} messages missed")
    if stream.largest_gap_s is not None and parts:
        parts.append(f"longest gap between messages {significant(stream.largest_gap_s, 3)} s")
    return f"  {'; '.join(parts)}" if parts else ""


def available_lines(numbers: Availability, ate_m: float) -> list[str]:
    """Return the lines about the as-available accuracy, next to the ATE; none if withheld."""
    position, age, parts = numbers.position_m, numbers.age_s, numbers.parts
    moved, latency = numbers.age_error_m, numbers.latency_s
    if position is None or age is None or parts is None or moved is None or latency is None:
        return []
    assert numbers.dropouts is not None
    by = _CLOCKS.get(numbers.received, "receive times")
    shares = ", ".join(
        f"{name} {four_digits(part.rmse_m)} m ({100.0 * part.share:.0f} %)"
        for name, part in parts.items()
    )
    is_relative = numbers.clock is not None and numbers.clock.offset_s is None
    above = " above the fastest message" if is_relative else ""
    lines = [
        f"  as available {four_digits(position.rmse)} m rmse, {four_digits(position.p95)} m p95"
        f"{_degrees(numbers.rotation_deg)} ({numbers.motion}, {numbers.rate_hz} Hz, {by}, "
        f"alignment as above; ATE {four_digits(ate_m)} m)",
        f"    age error  {four_digits(moved.rmse)} m{_degrees(numbers.age_error_deg)}; error by "
        f"part: {shares}",
        f"    pose age   {significant(age.mean, 3)} s mean, {significant(age.p95, 3)} s p95; "
        f"latency{above} {significant(latency.median, 3)} s median; "
        f"{numbers.available_percent:.1f} % of the time within {numbers.deadline_s:g} s; "
        f"{counted(numbers.dropouts.count, 'dropout')}{_longest(numbers.dropouts)}, "
        f"{counted(numbers.late_messages or 0, 'late message')}",
    ]
    corrected = numbers.corrections and numbers.corrections["age_s"]
    if corrected:
        lines[-1] += f"; newest correction {significant(corrected.median, 3)} s old (median)"
    if numbers.recording_s is not None:
        median, most = (significant(item, 2) for item in numbers.recording_s)
        lines[-1] += f"; transport and recording took {median} s median, {most} s max"
    return lines


def _degrees(statistics: Statistics | None) -> str:
    return "" if statistics is None else f", {four_digits(statistics.rmse)} deg"


def _longest(spans: Spans) -> str:
    """Return the longest of spans as text; empty without any."""
    return f" (longest {significant(spans.longest_s, 3)} s)" if spans.count else ""
