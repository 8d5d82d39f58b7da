"""Parts of the gauge study: errors of trials, and data that are refused."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.preintegration import ImuNoise
from trajeval_ros.studies import examination
from trajeval_ros.studies.examination import MeasurementModel, examine
from trajeval_ros.studies.gauge_study import GaugeStudy
from trajeval_ros.studies.gauge_trials import SWEEP_WEIGHTS, Trials, _errors
from trajeval_ros.visual_inertial.solver import GaugeHandling
from trajeval_ros.visual_inertial.state import State


def state_of(positions: Floats, rotations: Rotation, velocities: Floats) -> State:
    return State.at(positions, rotations.as_matrix(), velocities, np.zeros((0, 3)))


def test_errors_are_left_after_yaw_and_position_of_the_first_keyframe() -> None:
    generator = np.random.default_rng(1)
    positions, velocities, off, off_velocity = generator.normal(size=(4, 6, 3))
    rotations = Rotation.random(6, random_state=2)
    angles = np.array([0.0, 3.0, 1.0, 2.0, 4.0, 5.0])
    errors = Rotation.from_rotvec(np.radians(np.outer(angles, [0.6, 0.0, -0.8])))
    off[0] = 0.0
    yaw, moved = Rotation.from_rotvec([0.0, 0.0, 0.7]), np.array([3.0, -2.0, 1.0])
    estimated = state_of(
        yaw.apply(positions + off) + moved,
        yaw * errors * rotations,
        yaw.apply(velocities + off_velocity),
    )
    result = _errors(state_of(positions, rotations, velocities), estimated)
    expected = [np.sqrt(np.mean(np.sum(item**2, axis=1))) for item in (off, off_velocity)]
    assert result == pytest.approx((expected[0], np.sqrt(np.mean(angles**2)), expected[1]))


@pytest.mark.parametrize(
    ("gravity", "drift_deg", "text"),
    [
        ((0.0, 0.0, -9.909), 2.9, ""),
        ((0.0, 0.0, -9.911), 2.9, "gravity from groundtruth and IMU is 9.911 m/s^2, 0.0 deg"),
        ((0.0, 0.0, -9.709), 2.9, "is 9.709 m/s^2"),
        ((9.81 * np.sin(np.radians(1.99)), 0.0, -9.81 * np.cos(np.radians(1.99))), 2.9, ""),
        (
            (0.0, 9.81 * np.sin(np.radians(2.01)), -9.81 * np.cos(np.radians(2.01))),
            2.9,
            "is 9.810 m/s^2, 2.0 deg from the vertical, expected 9.81 m/s^2",
        ),
        ((0.0, 0.0, -9.81), 3.1, "differ by 3.1 deg after 3.00 s"),
    ],
)
def test_measured_data_are_refused_beyond_their_tolerances(
    gravity: Any, drift_deg: float, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = SimpleNamespace(
        gravity_felt=np.array(gravity),
        drift_against_gyroscope_deg=drift_deg,
        preintegrated=SimpleNamespace(durations_s=np.array([1.0, 2.0])),
        notes=("of the selection",),
    )
    monkeypatch.setattr(examination, "select", lambda *_: whole)
    monkeypatch.setattr(examination, "reject_outliers", lambda given: given)
    monkeypatch.setattr(examination.MeasuredScene, "of", lambda given: given)
    recording: Any = SimpleNamespace(name="flight", notes=("of the reader",))
    model = MeasurementModel(1, 10, 1.0, ImuNoise(1e-3, 1e-2), 9.81)
    if text:
        with pytest.raises(InputError, match=text.replace("^", r"\^").replace(".", r"\.")):
            examine(recording, model)
        return
    result = examine(recording, model)
    assert result.duration_s == 3.0
    assert result.notes == ("of the reader", "of the selection")


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
