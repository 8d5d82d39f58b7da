"""Remarks of an assessment at their limits, and Bayes factors of common timestamps."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from trajeval_ros.continuous_time.continuous_trajectory import fit_trajectory
from trajeval_ros.continuous_time.samples import Belief
from trajeval_ros.geometry import se3
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.likelihood.correlated_groundtruth import (
    CorrelatedGroundtruth,
    joint_log_likelihood,
)
from trajeval_ros.likelihood.likelihood_assessment import (
    TOLERANCE,
    LikelihoodAssessment,
    with_bayes_factors,
)
from trajeval_ros.likelihood.marginal import generalised_absolute_error
from trajeval_ros.likelihood.residuals import Residuals
from trajeval_ros.likelihood.uncertain_ate import UncertainAte
from trajeval_ros.report.tables import _cells

SECOND = 1_000_000_000
COUNT = 20
CONTINUOUS = fit_trajectory(
    Trajectory(
        SECOND * np.arange(COUNT),
        np.column_stack([np.arange(COUNT), np.sin(np.arange(COUNT)), np.zeros(COUNT)]),
        np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1)),
    ),
    "wnoa",
)


def assessed(stamps: Any, seed: int, **changed: Any) -> LikelihoodAssessment:
    known = CONTINUOUS.at(np.asarray(stamps))
    belief = Belief(known.poses, known.covariances + 1e-3 * np.eye(6))
    errors = 0.02 * np.random.default_rng(seed).normal(size=(len(stamps), 6))
    residuals = Residuals(belief, known.poses @ se3.exp(errors), Gauge.YAW)
    supported = np.ones(len(stamps), dtype=bool)
    given: dict[str, Any] = {
        "continuous": CONTINUOUS, "stamps": np.asarray(stamps), "belief": belief,
        "error": generalised_absolute_error(residuals), "edges": None, "gauge_scores": None,
        "ate": UncertainAte(0.1, 0.1, supported, (0.0, 0.2)), "log_bayes": {}, "statements": (),
    }  # fmt: skip
    return LikelihoodAssessment(**{**given, **changed})


def test_bayes_factors_are_differences_of_joint_likelihoods() -> None:
    first = assessed(SECOND * np.arange(1, 15), 1)
    second = assessed(SECOND * np.arange(3, 18), 2)
    one, other = with_bayes_factors(["a", "b"], [first, second])
    assert set(one.log_bayes) == {"b"}
    assert set(other.log_bayes) == {"a"}
    common = SECOND * np.arange(3, 15)
    times = CONTINUOUS.samples.seconds(common)
    groundtruth = CorrelatedGroundtruth.of(CONTINUOUS.markov, times, TOLERANCE)
    scores = [
        joint_log_likelihood(
            groundtruth,
            item.error.residuals.estimate[rows],
            Gauge.YAW,
            item.error.mode.element,
        )
        for item, rows in ((first, slice(2, 14)), (second, slice(0, 12)))
    ]
    assert one.log_bayes["b"] == pytest.approx(scores[0] - scores[1], abs=1e-6)
    assert other.log_bayes["a"] == pytest.approx(scores[1] - scores[0], abs=1e-6)
    assert abs(scores[0] - scores[1]) > 0.1
    alone = with_bayes_factors(["a"], [first])
    assert alone[0].log_bayes == {}
    # Ten common timestamps are enough.
    for number in (9, 10):
        part = assessed(SECOND * np.arange(3, 3 + number), 3)
        both = with_bayes_factors(["a", "b"], [first, part])
        assert bool(both[0].log_bayes) == (number == 10)
        assert any("only 9 common" in statement for statement in both[1].statements) == (
            number == 9
        )


@pytest.mark.parametrize("gauge", [Gauge.SIM3, Gauge.SE3, Gauge.YAW])
def test_scale_and_tilt_are_errors_where_they_are_observed(gauge: Gauge) -> None:
    """A camera has no scale, and the frames of most gauges may be tilted."""
    stamps = SECOND * np.arange(1, 15)
    plain = assessed(stamps, 0)
    known = dataclasses.replace(
        plain.error, residuals=dataclasses.replace(plain.error.residuals, gauge=gauge)
    )
    scores = SimpleNamespace(
        scale=SimpleNamespace(z=[1.25]), tilt=SimpleNamespace(z=[-0.5, 2.0]), sim3=0.0
    )
    cases = (scores, SimpleNamespace(**{**vars(scores), "scale": None}), None)
    shown = [
        _cells(dataclasses.replace(plain, error=known, gauge_scores=case))[-2:] for case in cases
    ]
    tilt = "-0.5, +2.0" if gauge is Gauge.YAW else "-"
    assert shown == [["-" if gauge is Gauge.SIM3 else "+1.2", tilt], ["-", tilt], ["-", "-"]]
