"""The blocks of result.json about what is computed on request: `calibration`, `probabilistic`."""

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
    from trajeval_ros.likelihood.likelihood_assessment import LikelihoodAssessment
    from trajeval_ros.likelihood.observable_directions import GaugeScores

_AXES = ("x", "y", "z", "roll", "pitch", "yaw")


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


def probabilistic_json(assessment: LikelihoodAssessment) -> dict[str, Any]:
    """Return the block of one estimate; docs/result.md describes every field."""
    from trajeval_ros.likelihood.likelihood_assessment import TOLERANCE

    error, ate, noise = assessment.error, assessment.ate, assessment.continuous.samples.noise
    return {
        "model": assessment.continuous.model,
        "groundtruth_samples": len(assessment.continuous.samples),
        "groundtruth_noise": _noise(noise.position_m, noise.rotation_rad),
        "tolerance": _noise(TOLERANCE.position_m, TOLERANCE.rotation_rad),
        "ate": {
            "supported_m": ate.supported_m,
            "supported_share": ate.supported_share,
            "weighted_m": ate.weighted_m,
            "interval_95_m": None if ate.interval_m is None else list(ate.interval_m),
        },
        "log_likelihood": error.log_likelihood,
        "nll_per_pose": error.nll_per_pose,
        "method": error.method,
        "effective_share": error.effective_share,
        "chi2_per_dof": error.chi2_per_dof,
        "dof": error.dof,
        "per_axis": dict(zip(_AXES, error.per_axis.tolist(), strict=False)),
        "chain": None
        if assessment.gauge_scores is None
        else _gauge_scores(assessment.gauge_scores),
        "log_bayes_factors": assessment.log_bayes,
        "statements": list(assessment.statements),
    }


def probabilistic_columns(assessment: LikelihoodAssessment) -> dict[str, Any]:
    """Return the columns of an assessment of N pairs by name.

    Returns:
        `residuals` and `sigmas`, (N, 6), or (N, 3) for positions only, metres and radians;
        `mahalanobis2` and `supported` (N,).
    """
    error = assessment.error
    return {
        "residuals": error.residuals.at(error.mode.element),
        "mahalanobis2": error.mahalanobis2,
        "sigmas": np.sqrt(np.einsum("nii->ni", error.residuals.covariances)),
        "supported": assessment.ate.supported,
    }


def _noise(position_m: float, rotation_rad: float) -> dict[str, float]:
    return {"position_m": position_m, "rotation_deg": math.degrees(rotation_rad)}


def _gauge_scores(scores: GaugeScores) -> dict[str, Any]:
    scale, tilt = scores.scale, scores.tilt
    return {
        "log_likelihood_sim3": scores.sim3,
        "log_likelihood_se3": scores.se3,
        "log_likelihood_yaw": scores.yaw,
        "scale": None if scale is None else math.exp(scale.values[0]),
        "scale_z": None if scale is None else scale.z[0],
        "tilt_deg": [math.degrees(value) for value in tilt.values],
        "tilt_z": list(tilt.z),
    }
