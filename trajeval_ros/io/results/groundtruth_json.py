"""The examination of a groundtruth as JSON (docs/groundtruth.md)."""

from __future__ import annotations

import dataclasses
from typing import Any

from trajeval_ros.calibration.groundtruth_quality.examine import ExaminedGroundtruth
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.hand_eye_file import hand_eye_json

SCHEMA = "trajeval-groundtruth/1"


def groundtruth_json(
    truth: str, imu: str | None, original: Trajectory, examined: ExaminedGroundtruth
) -> dict[str, Any]:
    """Return verdicts, fits and noise; `truth` and `imu` are the sources."""
    result: dict[str, Any] = {
        "schema": SCHEMA,
        "groundtruth": {"source": truth, "poses": len(original)},
        "imu": imu,
        "causes": [
            {**dataclasses.asdict(cause), "half_width_95": cause.half_width}
            for cause in examined.causes.values()
        ],
        "poses": dataclasses.asdict(examined.poses),
        "notes": list(examined.notes),
    }
    fits = examined.fits
    if fits is not None:
        rig, noise_m, noise_rad = fits.rig, fits.position_noise_m, fits.rotation_noise_rad
        biases = rig.biases.mean(axis=0).tolist()
        horizons = {
            name: {"values": fit.values.tolist(), "standard_deviations": fit.sigmas.tolist()}
            for name, fit in (("short", fits.short), ("long", fits.long))
        }
        result |= {
            "fits": {**horizons, "disagree": fits.disagree},
            "T_imu_marker": hand_eye_json(fits.hand_eye),
            "T_imu_marker_covariance": fits.hand_eye_covariance.tolist(),
            "clock": {"offset_s": rig.offset_s, "skew": rig.skew},
            "gravity_mps2": rig.gravity.tolist(),
            "biases": {"gyroscope_radps": biases[:3], "accelerometer_mps2": biases[3:]},
            "noise": {"position_m": noise_m, "rotation_rad": noise_rad},
            "residuals": dataclasses.asdict(fits.checks),
            "repaired": {"poses": len(fits.repaired), "covariances": "lower limits"},
        }
    return result
