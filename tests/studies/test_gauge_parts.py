"""Parts of the gauge study: errors of trials, limits of measured data, and what is written."""

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
from trajeval_ros.studies import examination, gauge_study
from trajeval_ros.studies.examination import MeasurementModel, examine, tilt_of
from trajeval_ros.studies.gauge_study import (
    GaugeStudy,
    _compared,
    _file_name,
    _swept,
    _transformed,
)
from trajeval_ros.studies.gauge_trials import SWEEP_WEIGHTS, Covariances, Trials, _columns, _errors
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
    own = state_of(
        yaw.apply(positions + off) + moved,
        yaw * errors * rotations,
        yaw.apply(velocities + off_velocity),
    )
    found = _errors(state_of(positions, rotations, velocities), own)
    expected = [np.sqrt(np.mean(np.sum(item**2, axis=1))) for item in (off, off_velocity)]
    assert found == pytest.approx((expected[0], np.sqrt(np.mean(angles**2)), expected[1]))


def test_trials_are_columns_and_their_time_is_the_median_per_solve() -> None:
    rows = [(0.1, 0.2, 0.3, 4.0, 8.0), (0.5, 0.6, 0.7, 2.0, 6.0), (0.8, 0.9, 1.0, 1.0, 20.0)]
    trials = _columns(rows)
    assert trials.position_m.tolist() == [0.1, 0.5, 0.8]
    assert trials.rotation_deg.tolist() == [0.2, 0.6, 0.9]
    assert trials.velocity_mps.tolist() == [0.3, 0.7, 1.0]
    assert trials.iterations.tolist() == [4.0, 2.0, 1.0]
    assert trials.seconds_per_iteration == 3.0  # of 2, 3 and 20


def test_the_difference_of_covariances_is_relative_to_that_of_fixation() -> None:
    fixed, transformed = np.diag([3.0, 4.0]), np.array([[3.0, 0.3], [0.4, 4.0]])
    assert Covariances(fixed, transformed, fixed).difference == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("sine random", "sine_random"),
        ("motion of MH_01/groundtruth", "MH_01_groundtruth"),
        ("tracks of a flight", "a_flight"),
    ],
)
def test_files_have_the_names_of_configurations(name: str, file: str) -> None:
    assert _file_name(name) == file


class Told:
    """A progress bar that keeps what it is told."""

    def __init__(self) -> None:
        self.titles: list[str] = []
        self.parts: list[tuple[int, int]] = []

    def __call__(self, title: str) -> Any:
        self.titles.append(title)
        return self

    def __enter__(self) -> Any:
        return lambda done, of: self.parts.append((done, of))

    def __exit__(self, *_: object) -> None:
        pass


def test_progress_counts_trials_and_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    nothing: Any = None

    def several(count: int) -> Any:
        return lambda scene, trials, advance, *_: [advance() for _ in range(count)]

    told = Told()
    monkeypatch.setattr(gauge_study, "compare_handlings", several(3))
    monkeypatch.setattr(gauge_study, "sweep", several(len(SWEEP_WEIGHTS)))
    _compared("sine", nothing, 3, told)
    assert told.parts == [(1, 3), (2, 3), (3, 3)]
    told.parts.clear()
    _swept("sine", nothing, 3, told)
    assert told.parts == [
        (index, len(SWEEP_WEIGHTS)) for index in range(1, len(SWEEP_WEIGHTS) + 1)
    ]
    told.parts.clear()
    made: list[tuple[int, bool]] = []

    def covariances(_: Any, trial: int, *, is_converged: bool) -> Any:
        made.append((trial, is_converged))
        return SimpleNamespace(difference=trial + 0.5 * is_converged)

    monkeypatch.setattr(gauge_study, "covariances", covariances)
    first, (stopped, converged) = _transformed("sine", nothing, 3, told)
    assert told.parts == [(1, 3), (2, 3), (3, 3)]
    assert told.titles == ["sine, 3 trials", "sine, prior weights", "sine, covariances"]
    assert made == [(trial, item) for trial in range(3) for item in (False, True)]
    assert [item.difference for item in first] == [0.0, 0.5]
    assert (stopped.tolist(), converged.tolist()) == ([0.0, 1.0, 2.0], [0.5, 1.5, 2.5])


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


@pytest.mark.parametrize(
    ("gravity", "drift_deg", "said"),
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
    gravity: Any, drift_deg: float, said: str, monkeypatch: pytest.MonkeyPatch
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
    if said:
        with pytest.raises(InputError, match=said.replace("^", r"\^").replace(".", r"\.")):
            examine(recording, model)
        return
    found = examine(recording, model)
    assert found.duration_s == 3.0
    assert found.notes == ("of the reader", "of the selection")


def test_tilt_is_the_angle_from_straight_down() -> None:
    for degrees in (0.0, 30.0, 90.0, 150.0):
        down = Rotation.from_rotvec(np.radians([0.6 * degrees, 0.8 * degrees, 0.0]))
        assert tilt_of(down.apply([0.0, 0.0, -9.81])) == pytest.approx(degrees, abs=1e-9)
