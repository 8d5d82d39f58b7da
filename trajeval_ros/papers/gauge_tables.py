"""Tables II and III of the gauge paper with its values, and the examination of measured data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trajeval_ros.formatting.numbers import NOTHING, counted, one_digit
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.papers.examination import Examination, tilt_of
from trajeval_ros.papers.gauge_trials import Trials
from trajeval_ros.papers.solver import GaugeHandling
from trajeval_ros.report.console import Table

METRICS = {"position_m": "p [m]", "rotation_deg": "φ [deg]", "velocity_mps": "v [m/s]"}

# RMSE with gauge fixation and with a free gauge: p (m), phi (deg), v (m/s).
PAPER = {
    "sine plane": ((0.04141, 0.1084, 0.02182), (0.04141, 0.1084, 0.02183)),
    "arc plane": ((0.02328, 0.6987, 0.01303), (0.02329, 0.6987, 0.01303)),
    "rec plane": ((0.01772, 0.1668, 0.01496), (0.01774, 0.1668, 0.01495)),
    "sine random": ((0.03932, 0.0885, 0.01902), (0.03908, 0.0874, 0.01886)),
    "arc random": ((0.02680, 0.6895, 0.01167), (0.02678, 0.6895, 0.01166)),
    "rec random": ((0.02218, 0.1330, 0.009882), (0.02220, 0.1330, 0.009881)),
    "MH_01": ((0.06936, 0.07845, 0.03092), (0.06918, 0.07857, 0.03091)),
    "V1_01": ((0.07851, 0.4382, 0.04644), (0.07851, 0.4382, 0.04644)),
}
_PAPER_HANDLINGS = (GaugeHandling.FIXATION, GaugeHandling.FREE)
HEADINGS = (
    "configuration",
    *(handling.value for handling in GaugeHandling),
    *(f"paper, {handling.value}" for handling in _PAPER_HANDLINGS),
    f"iterations: {', '.join(handling.value for handling in GaugeHandling)}",
    "ms per iteration",
)
SWEEP_HEADINGS = ("weight", *METRICS.values(), "iterations")


def accuracy_rows(outcome: Mapping[str, Mapping[GaugeHandling, Trials]]) -> list[list[str]]:
    """Return a row per configuration: means over its trials, then the paper's values."""
    return [
        [
            name,
            *(
                " / ".join(f"{getattr(trials[handling], metric).mean():.5f}" for metric in METRICS)
                for handling in GaugeHandling
            ),
            *_paper(name),
            " / ".join(f"{trials[handling].iterations.mean():.2f}" for handling in GaugeHandling),
            " / ".join(
                f"{1e3 * trials[handling].seconds_per_iteration:.2f}" for handling in GaugeHandling
            ),
        ]
        for name, trials in outcome.items()
    ]


def sweep_rows(weights: Sequence[float], sweep: Sequence[Trials]) -> list[list[str]]:
    """Return a row per weight of the prior: means over its trials."""
    return [
        [
            one_digit(weight),
            *(f"{getattr(trials, metric).mean():.5f}" for metric in METRICS),
            f"{trials.iterations.mean():.2f}",
        ]
        for weight, trials in zip(weights, sweep, strict=True)
    ]


def percent_and_range(shares: Floats) -> str:
    """Return the median of shares (T,), and their range if there is more than one."""
    middle, low, high = 100.0 * np.array([np.median(shares), shares.min(), shares.max()])
    text = f"{middle:.2g} %"
    return text if len(shares) == 1 else f"{text} ({low:.2g} to {high:.2g} %)"


def _paper(name: str) -> list[str]:
    """Return the paper's values for a configuration, if it has any."""
    known = next((values for key, values in PAPER.items() if key.lower() in name.lower()), None)
    if known is None:
        return [NOTHING, NOTHING]
    return [" / ".join(f"{value:.4g}" for value in values) for values in known]


def accuracy_table(outcome: Mapping[str, Mapping[GaugeHandling, Trials]]) -> Table:
    """Return the table for a terminal: a row per configuration and gauge handling."""
    table = Table(
        "RMSE after alignment by the first keyframe, means over trials",
        ["configuration", "gauge"],
        [*METRICS.values(), "paper (p / φ / v)", "iterations", "ms each"],
    )
    for name, trials in outcome.items():
        paper = dict(zip(_PAPER_HANDLINGS, _paper(name), strict=True))
        for place, handling in enumerate(GaugeHandling):
            result = trials[handling]
            rmse = [f"{getattr(result, metric).mean():.5f}" for metric in METRICS]
            numbers = [
                paper.get(handling, ""),
                f"{result.iterations.mean():.2f}",
                f"{1e3 * result.seconds_per_iteration:.2f}",
            ]
            table.add(["" if place else name, handling.value, *rmse, *numbers])
        table.add_section()
    return table


def examination_lines(name: str, examined: Examination) -> list[str]:
    """Return lines about the data and the rejection of outliers."""
    rejection, problem = examined.rejection, examined.scene.problem
    (before, landmarks), *_, (after, left) = rejection.rounds
    return [
        f"{name}: {problem.keyframes} keyframes in {examined.duration_s:.2f} s",
        *(f"{note[0].upper()}{note[1:]}." for note in examined.notes),
        f"Gravity from groundtruth and IMU: {np.linalg.norm(examined.gravity):.3f} m/s^2, "
        f"{tilt_of(examined.gravity):.2f} deg from the vertical.",
        f"Reprojection at groundtruth: median {rejection.median_px:.2f} px, "
        f"{100 * rejection.within_3px:.1f} % within 3 px.",
        f"Without outliers: {after} of {before} observations, {left} of {landmarks} landmarks, "
        f"after {counted(len(rejection.rounds) - 1, 'round')}.",
        f"Groundtruth and gyroscope differ by {examined.drift_deg:.2f} deg from the first to the "
        "last keyframe.",
    ]


def examination_numbers(examined: Examination) -> dict[str, Any]:
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
        "groundtruth_against_gyroscope_deg": examined.drift_deg,
    }
