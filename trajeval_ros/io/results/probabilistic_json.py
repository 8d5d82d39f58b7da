"""The `probabilistic` block of result.json, and the columns for errors.npz."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from trajeval_ros.likelihood.likelihood_assessment import LikelihoodAssessment
    from trajeval_ros.likelihood.observable_directions import GaugeScores

_AXES = ("x", "y", "z", "roll", "pitch", "yaw")


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
