"""The `calibration` block of result.json."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.io.hand_eye_file import hand_eye_json

if TYPE_CHECKING:
    from trajeval_ros.calibration.apply import Calibrated
    from trajeval_ros.calibration.calibrate import Calibration
    from trajeval_ros.calibration.significance import Parameter


def calibration_json(calibrated: Calibrated) -> dict[str, Any]:
    """Return the estimated parameters, whether and why they are applied, and the resulting ATE.

    docs/result.md describes the fields. The units are in their names.
    """
    request, calibration = calibrated.request, calibrated.calibration
    hand_eye = calibrated.hand_eye
    return {
        "estimated_from": None if calibration is None else calibrated.estimated_from,
        "time_offset": _offset(calibrated) if request.offset else None,
        "hand_eye": _hand_eye(calibrated)
        if request.hand_eye or request.known is not None
        else None,
        "T_body_marker": None if hand_eye is None else hand_eye_json(hand_eye),
        "errors_of": "marker" if calibrated.of_marker else "body",
        "parameters_fitted": 0 if calibration is None else calibration.fitted,
        "parameters_applied": calibrated.parameters_applied,
        "blocks": None if calibration is None else calibration.blocks,
        "increments": None if calibration is None else calibration.pairs,
        "horizon_s": None if calibration is None else calibration.horizon_s,
        "ate": {
            name: None if item is None else dataclasses.asdict(item)
            for name, item in (
                ("before", calibrated.before),
                ("after", calibrated.after),
                ("if_applied", calibrated.if_applied),
            )
        },
    }


def _offset(calibrated: Calibrated) -> dict[str, Any]:
    calibration = calibrated.calibration
    assert calibration is not None
    guess, offset = calibration.guess, calibration.offset
    value, sigma, half_width = (
        None if column is None else float(column[0])
        for column in (offset.value, offset.sigma, offset.half_width_95)
    )
    return {
        "value_s": value,
        "sigma_s": sigma,
        "half_width_95_s": half_width,
        **_verdict(offset, calibrated.offset_applied),
        "correlation": {
            "signal": guess.signal,
            "offset_s": guess.offset_s,
            "peak": guess.peak,
            "second": guess.second,
            "peak_to_sidelobe": guess.peak_to_sidelobe,
            "overlap_s": guess.overlap_s,
        },
        "by_rotations": _row(calibration, "rotation"),
        "by_positions": _row(calibration, "position"),
    }


def _row(calibration: Calibration, kind: str) -> dict[str, float] | None:
    if kind not in calibration.rows:
        return None
    value, sigma = calibration.rows[kind]
    return {"value_s": value, "sigma_s": sigma}


def _hand_eye(calibrated: Calibrated) -> dict[str, Any]:
    if calibrated.request.known is not None:
        return {"source": calibrated.request.source, "rotation": None, "lever_arm": None}
    calibration = calibrated.calibration
    assert calibration is not None
    rotation, lever = calibration.rotation, calibration.lever
    return {
        "source": "auto",
        "rotation": {
            "xyzw": None
            if rotation.value is None
            else lie.from_rotation_vector(rotation.value).tolist(),
            "angle_deg": None
            if rotation.value is None
            else float(np.degrees(np.linalg.norm(rotation.value))),
            "sigma_deg": None if rotation.sigma is None else np.degrees(rotation.sigma).tolist(),
            "half_width_95_deg": None
            if rotation.half_width_95 is None
            else np.degrees(rotation.half_width_95).tolist(),
            **_verdict(rotation, calibrated.rotation_applied),
        },
        "lever_arm": {
            "value_m": _list(lever.value),
            "sigma_m": _list(lever.sigma),
            "half_width_95_m": _list(lever.half_width_95),
            **_verdict(lever, calibrated.lever_applied),
        },
    }


def _verdict(parameter: Parameter, applied: bool) -> dict[str, Any]:
    return {
        "reliability": parameter.reliability.tolist(),
        "chance": parameter.chance,
        "status": parameter.status,
        "reason": parameter.reason,
        "applied": applied,
    }


def _list(column: Floats | None) -> list[float | None] | None:
    """Return the components as a list, None for NaN; None without a column."""
    if column is None:
        return None
    return [None if math.isnan(item) else item for item in column.tolist()]
