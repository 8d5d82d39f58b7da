"""Parts of the gauge study: errors of trials, and data that are refused."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from trajeval_ros.papers.gauge_study import GaugeStudy
from trajeval_ros.papers.gauge_trials import SWEEP_WEIGHTS, Trials
from trajeval_ros.papers.solver import GaugeHandling


def study_of(threads: str) -> GaugeStudy:
    trials = Trials(*np.arange(1.0, 11.0).reshape(5, 2) / 100.0)
    names = ["sine plane", "sine random"]
    nothing: Any = None
    return GaugeStudy(
        profile="paper",
        trials=2,
        states=dict.fromkeys(names, nothing),
        compared={name: dict.fromkeys(GaugeHandling, trials) for name in names},
        sweeps={"sine plane": [trials] * len(SWEEP_WEIGHTS)},
        paths=[],
        covariances={"sine random": (nothing, nothing)},
        differences={"sine random": (np.array([1e-3, 3e-3]), np.array([1e-9, 2e-9]))},
        measured="",
        examined=None,
        blas_threads=threads,
    )


def test_a_study_is_written_with_its_conditions() -> None:
    study = study_of("1")
    numbers = study.numbers()
    assert numbers["sensors"] == {"sine plane": "simulated", "sine random": "simulated"}
    assert numbers["trials"] == 2
    assert numbers["blas_threads"] == "1"
    assert study_of("").numbers()["blas_threads"] is None
    assert numbers["configurations"]["sine plane"]["free"]["position_m"] == [0.01, 0.02]
    assert numbers["configurations"]["sine plane"]["free"]["seconds"] == [0.09, 0.1]
    assert numbers["prior_weight_sweep"]["weights"] == list(SWEEP_WEIGHTS)
    assert len(numbers["prior_weight_sweep"]["trials"]["sine plane"]) == len(SWEEP_WEIGHTS)
    assert numbers["covariance_difference"] == {
        "sine random": {"as_ceres_stops": [1e-3, 3e-3], "converged": [1e-9, 2e-9]}
    }
    assert numbers["examination"] is None
    assert study.lines() == []
    table = study.tables()
    assert "one linear algebra thread" in table
    assert "default number of linear algebra threads" in study_of("2").tables()
    assert "All sensors are simulated" in table
    assert "| sine random | 0.2 % (0.1 to 0.3 %) |" in table
    assert "Prior weight on" not in table
    assert table.endswith("|\n")
    both = {**study.sweeps, "arc of V1": study.sweeps["sine plane"]}
    figures = dataclasses.replace(study, sweeps=both).figures()
    titles = [figure.args[-1] for name, figure in figures.items() if name.startswith("prior_")]
    assert titles == [
        "sine plane, one trial, profile paper",
        "sine plane, profile paper, 2 trials",
        "arc of V1, 2 trials",
    ]
    measured = dataclasses.replace(study, measured="sine random")
    assert measured.sensors == "Sensors are simulated, except for sine random (measured)."
    assert measured.numbers()["sensors"]["sine random"] == "measured"
    assert measured.numbers()["sensors"]["sine plane"] == "simulated"
