"""What an examination of measured keyframes says, in sentences and as numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from trajeval_ros.visual_inertial.examination import (
    GROUNDTRUTH_NOISES,
    LAGS,
    Examination,
    tilt_of,
)

_WHITE = 0.3  # correlation at the first lag, up to which errors are said to be white
_GOOD_GROUNDTRUTH_DEG = 0.1


def measured_lines(name: str, examined: Examination) -> list[str]:
    """Return the sentences: data, rejection, residuals, covariance."""
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
        coloured = ": a pixel noise from their chi-square would be too small for the covariance"
    if examined.drift_deg > _GOOD_GROUNDTRUTH_DEG:
        undecided = ": groundtruth drifts, and the verdict is a choice of its noise"
    lines = [
        f"{name}: {problem.keyframes} keyframes in {examined.duration_s:.2f} s",
        *(f"{note[0].upper()}{note[1:]}." for note in examined.notes),
        f"Gravity by groundtruth and IMU: {np.linalg.norm(examined.gravity):.3f} m/s^2, "
        f"{tilt_of(examined.gravity):.2f} deg from the vertical.",
        f"Reprojection at groundtruth: median {rejection.median_px:.2f} px, "
        f"{100 * rejection.within_3px:.1f} % within 3 px.",
        f"Without outliers: {after} of {before} observations, {left} of {landmarks} landmarks, "
        f"after {len(rejection.rounds) - 1} rounds.",
        f"Chi-square over redundancy by group (redundancy): {groups}. The total says nothing of "
        "the IMU.",
        f"Reprojection errors of a track correlate by {correlation} at lags of "
        f"{', '.join(map(str, LAGS))} keyframes{coloured}.",
        f"NEES of the poses / dof by the noise of groundtruth that is assumed: {nees}. "
        f"Groundtruth and gyroscope differ by {examined.drift_deg:.2f} deg from first to last "
        f"keyframe{undecided}.",
    ]
    if examined.split_half is not None:
        lines.append(
            f"NEES / dof of the difference of two halves of the landmarks, without groundtruth: "
            f"{examined.split_half.mean():.2f} ({examined.split_half.min():.2f} to "
            f"{examined.split_half.max():.2f} in {len(examined.split_half)} splits)."
        )
    return lines


def measured_numbers(examined: Examination) -> dict[str, Any]:
    """Return the same for study.json."""
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
        "split_half_nees_per_dof": (
            None if examined.split_half is None else examined.split_half.tolist()
        ),
    }
