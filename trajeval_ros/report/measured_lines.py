"""The examination of measured keyframes as lines of text and as numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from trajeval_ros.formatting.numbers import counted
from trajeval_ros.visual_inertial.examination import (
    GROUNDTRUTH_NOISES,
    LAGS,
    Examination,
    tilt_of,
)

_WHITE = 0.3  # correlation at the first lag up to which errors are called white
_GOOD_GROUNDTRUTH_DEG = 0.1


def measured_lines(name: str, examined: Examination) -> list[str]:
    """Return lines about data, rejection of outliers, residuals and covariance."""
    rejection, problem = examined.rejection, examined.scene.problem
    (before, landmarks), *_, (after, left) = rejection.rounds
    groups = ", ".join(
        f"{group.name} {group.ratio:.2f} ({group.redundancy:.1f})" for group in examined.groups
    )
    correlation = ", ".join(f"{value:.2f}" for value in examined.correlation)
    nees = "; ".join(
        f"{value:.3g} with {1e3 * p:g} mm, {phi:g} deg"
        for value, (p, phi, _) in zip(examined.nees, GROUNDTRUTH_NOISES, strict=True)
    )
    coloured = undecided = ""
    if examined.correlation[0] > _WHITE:
        coloured = ": a pixel noise from their chi-square is too small for the covariance"
    if examined.drift_deg > _GOOD_GROUNDTRUTH_DEG:
        undecided = ": groundtruth drifts, and the verdict depends on its assumed noise"
    lines = [
        f"{name}: {problem.keyframes} keyframes in {examined.duration_s:.2f} s",
        *(f"{note[0].upper()}{note[1:]}." for note in examined.notes),
        f"Gravity from groundtruth and IMU: {np.linalg.norm(examined.gravity):.3f} m/s^2, "
        f"{tilt_of(examined.gravity):.2f} deg from the vertical.",
        f"Reprojection at groundtruth: median {rejection.median_px:.2f} px, "
        f"{100 * rejection.within_3px:.1f} % within 3 px.",
        f"Without outliers: {after} of {before} observations, {left} of {landmarks} landmarks, "
        f"after {counted(len(rejection.rounds) - 1, 'round')}.",
        f"Chi-square over redundancy by group (redundancy): {groups}. The total is insensitive "
        "to the IMU.",
        f"Autocorrelation of the reprojection errors of a track: {correlation} at lags of "
        f"{', '.join(map(str, LAGS))} keyframes{coloured}.",
        f"NEES of the poses / dof by the assumed groundtruth noise: {nees}. Groundtruth and "
        f"gyroscope differ by {examined.drift_deg:.2f} deg from the first to the last "
        f"keyframe{undecided}.",
    ]
    if examined.biases_sigma.size:
        lines.append(
            "Biases of the last keyframe, relative to the mean of the groundtruth: gyroscope "
            f"{_with_sigmas(examined, slice(0, 3))} rad/s, accelerometer "
            f"{_with_sigmas(examined, slice(3, 6))} m/s^2."
        )
    if examined.split_half is not None:
        lines.append(
            "NEES / dof of the difference of two halves of the landmarks, without groundtruth: "
            f"{examined.split_half.mean():.2f} ({examined.split_half.min():.2f} to "
            f"{examined.split_half.max():.2f} in {counted(len(examined.split_half), 'split')})."
        )
    return lines


def _with_sigmas(examined: Examination, axes: slice) -> str:
    """Return the biases of the last keyframe with their standard deviations."""
    values = examined.rejection.state.biases[-1, axes]
    return ", ".join(
        f"{value:.2g} +- {sigma:.1g}"
        for value, sigma in zip(values, examined.biases_sigma[axes], strict=True)
    )


def measured_numbers(examined: Examination) -> dict[str, Any]:
    """Return the numbers for study.json."""
    rejection = examined.rejection
    return {
        "keyframes": examined.scene.problem.keyframes,
        "duration_s": examined.duration_s,
        "notes": list(examined.notes),
        "gravity_mps2": examined.gravity.tolist(),
        "gravity_tilt_deg": tilt_of(examined.gravity),
        "reprojection_at_groundtruth_px": rejection.median_px,
        "share_within_3px": rejection.within_3px,
        "rounds": [
            {"observations": observations, "landmarks": landmarks}
            for observations, landmarks in rejection.rounds
        ],
        "chi2_groups": [
            {
                "name": group.name,
                "count": group.count,
                "redundancy": group.redundancy,
                "chi2": group.chi2,
            }
            for group in examined.groups
        ],
        "track_correlation": {
            str(lag): float(value) if np.isfinite(value) else None
            for lag, value in zip(LAGS, examined.correlation, strict=True)
        },
        "groundtruth_against_gyroscope_deg": examined.drift_deg,
        "nees_per_dof": [
            {
                "position_noise_m": p,
                "rotation_noise_deg": phi,
                "velocity_noise_mps": v,
                "value": value,
            }
            for value, (p, phi, v) in zip(examined.nees, GROUNDTRUTH_NOISES, strict=True)
        ],
        "biases": examined.rejection.state.biases.tolist() if examined.biases_sigma.size else None,
        "biases_sigma": examined.biases_sigma.tolist() if examined.biases_sigma.size else None,
        "split_half_nees_per_dof": (
            None if examined.split_half is None else examined.split_half.tolist()
        ),
    }
