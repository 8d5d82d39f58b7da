"""How far the continuous groundtruth is off on real recordings, and whether it says so.

Recordings at 100 to 300 Hz are decimated to a few Hz, with noise and dropouts of 1 to 3 s; the
poses left out are the truth.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from decimated import Decimated, decimated, score

from trajeval_ros.continuous_time.continuous_trajectory import fit_trajectory
from trajeval_ros.continuous_time.samples import DEFAULT_MODEL, Noise
from trajeval_ros.geometry.trajectory import Trajectory

RECORDINGS = {
    "V1_02": "euroc/groundtruth/V1_02_asl.csv",
    "fr2_desk": "tum/fr2_desk_groundtruth.txt",
    "MH_05": "euroc/groundtruth/MH_05.txt",
}
RATES_HZ = (1.0, 2.0, 5.0, 10.0)
NOISE = Noise()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 12, 13])
def test_coverage_and_error_on_recordings(
    recording: Callable[[str], Trajectory], seed: int
) -> None:
    coverage, ratios, easy = [], [], []
    for name, path in RECORDINGS.items():
        for rate in RATES_HZ:
            case = decimated(recording(path), rate, seed + round(100 * rate), NOISE)
            default, linear = (
                fit_trajectory(case.samples, model, NOISE) for model in (DEFAULT_MODEL, "linear")
            )
            coverage.append(score(default, case.truth).coverage)
            gaps = case.truth[case.in_gap]
            ratio = score(default, gaps).rmse_m / score(linear, gaps).rmse_m
            ratios.append(ratio)
            if name != "fr2_desk" and rate >= 2.0:
                easy.append(ratio)
    assert np.median(coverage) >= 0.82
    assert min(coverage) >= 0.55
    assert np.exp(np.mean(np.log(ratios))) <= 0.85
    assert np.exp(np.mean(np.log(easy))) <= 0.6


def test_default_is_calibrated_where_rules_are_not(
    recording: Callable[[str], Trajectory],
) -> None:
    case: Decimated = decimated(recording(RECORDINGS["V1_02"]), 5.0, 3, NOISE)
    scores = {
        model: score(fit_trajectory(case.samples, model, NOISE), case.truth)
        for model in (DEFAULT_MODEL, "linear", "nearest")
    }
    assert 0.3 < scores[DEFAULT_MODEL].nees_per_dof < 2.0
    assert scores[DEFAULT_MODEL].coverage > 0.8
    assert scores["linear"].coverage < 0.5
    assert scores["nearest"].nees_per_dof > 100.0
