"""The calibration of an estimate as lines of text."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trajeval_ros.calibration.significance import CHANCE
from trajeval_ros.formatting.numbers import counted, with_unit

if TYPE_CHECKING:
    from trajeval_ros.calibration.apply import Ate, Calibrated
    from trajeval_ros.calibration.significance import Parameter

_STATUSES = {"insignificant": "not significant", "weak": "inconclusive"}
# Least relative increase of the position ATE that is explained; it is printed to four digits.
_GROWN = 1.001


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
