"""Blocks of results: every number is written under its own name, in its unit."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from unittest import mock

import numpy as np
import pytest

from trajeval_ros.calibration.apply import Ate
from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.calibration.clock_offset import OffsetGuess
from trajeval_ros.calibration.significance import Parameter
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.io.results import result_folder
from trajeval_ros.io.results.calibration_json import calibration_json
from trajeval_ros.io.results.probabilistic_json import _gauge_scores as gauge_scores_json
from trajeval_ros.io.results.result_json import integrity_json
from trajeval_ros.io.results.watch_json import watch_json
from trajeval_ros.metrics.columns import columns_of, component_columns
from trajeval_ros.metrics.discontinuities.events import Event

FAKE: Any = SimpleNamespace


def parameter(first: float, *, is_known: bool = True) -> Parameter:
    values = first + np.arange(3.0)
    known = (values, values / 10.0, values / 5.0) if is_known else (None, None, None)
    return Parameter(*known, np.array([0.5, first]), "weak", f"reason {first}", first / 100.0)


def calibrated(**changes: Any) -> Any:
    calibration = FAKE(
        guess=OffsetGuess(0.1, 0.2, 0.3, 0.4, "speed", 0.5),
        offset=parameter(1.0),
        turn=parameter(2.0),
        lever=parameter(3.0),
        rows={"rotation": (0.6, 0.7)},
        fitted=7,
        blocks=8,
        pairs=9,
        horizon_s=1.5,
    )
    full = {
        "request": CalibrationRequest(offset=True, hand_eye=True),
        "calibration": calibration,
        "estimated_from": "vio",
        "offset_applied": True,
        "rotation_applied": False,
        "lever_applied": True,
        "hand_eye": HandEye.of(None, np.array([0.1, 0.2, 0.3])),
        "of_marker": True,
        "before": Ate(1.0, 2.0),
        "after": Ate(3.0, 4.0),
        "if_applied": None,
        "parameters_applied": 4,
    }
    return FAKE(**{**full, **changes})


def test_a_calibration_is_written_with_its_verdicts() -> None:
    found = calibration_json(calibrated())
    offset, hand_eye = found.pop("time_offset"), found.pop("hand_eye")
    pose = found.pop("T_body_marker")
    assert pose["transform"]["translation"] == {"x": 0.1, "y": 0.2, "z": 0.3}
    ate = found.pop("ate")
    assert list(ate["before"].values()) == [1.0, 2.0]
    assert list(ate["after"].values()) == [3.0, 4.0]
    assert ate["if_applied"] is None
    assert found == {
        "estimated_from": "vio",
        "errors_of": "marker",
        "parameters_fitted": 7,
        "parameters_applied": 4,
        "blocks": 8,
        "increments": 9,
        "horizon_s": 1.5,
    }
    assert offset == {
        "value_s": 1.0,
        "sigma_s": 0.1,
        "half_width_95_s": 0.2,
        "reliability": [0.5, 1.0],
        "chance": 0.01,
        "status": "weak",
        "reason": "reason 1.0",
        "applied": True,
        "correlation": {
            "signal": "speed",
            "offset_s": 0.1,
            "peak": 0.2,
            "second": 0.3,
            "peak_to_sidelobe": 0.4,
            "overlap_s": 0.5,
        },
        "by_rotations": {"value_s": 0.6, "sigma_s": 0.7},
        "by_positions": None,
    }
    turn, lever = hand_eye["rotation"], hand_eye["lever_arm"]
    assert hand_eye["source"] == "auto"
    vector = np.array([2.0, 3.0, 4.0])
    angle = float(np.linalg.norm(vector))
    np.testing.assert_allclose(
        turn["xyzw"], [*(np.sin(angle / 2) * vector / angle), np.cos(angle / 2)], rtol=1e-14
    )
    assert turn["angle_deg"] == pytest.approx(math.degrees(angle))
    np.testing.assert_allclose(turn["sigma_deg"], np.degrees(vector / 10.0))
    np.testing.assert_allclose(turn["half_width_95_deg"], np.degrees(vector / 5.0))
    assert (turn["applied"], lever["applied"]) == (False, True)
    assert (turn["chance"], lever["chance"]) == (0.02, 0.03)
    assert lever["value_m"] == [3.0, 4.0, 5.0]
    np.testing.assert_allclose(lever["sigma_m"], [0.3, 0.4, 0.5])
    np.testing.assert_allclose(lever["half_width_95_m"], [0.6, 0.8, 1.0])


def test_what_is_unknown_of_a_calibration_is_null() -> None:
    unknown = parameter(2.0, is_known=False)
    nan = parameter(3.0)
    nan.sigma[1] = np.nan  # type: ignore[index]
    lacking = calibrated(of_marker=False)
    lacking.calibration.offset = lacking.calibration.turn = unknown
    lacking.calibration.lever = nan
    found = calibration_json(lacking)
    assert found["errors_of"] == "body"
    offset, turn = found["time_offset"], found["hand_eye"]["rotation"]
    assert offset["value_s"] is offset["sigma_s"] is offset["half_width_95_s"] is None
    for name in ("xyzw", "angle_deg", "sigma_deg", "half_width_95_deg"):
        assert turn[name] is None
    assert found["hand_eye"]["lever_arm"]["sigma_m"] == [pytest.approx(0.3), None, 0.5]
    lacking.calibration.lever = unknown
    assert calibration_json(lacking)["hand_eye"]["lever_arm"]["value_m"] is None


def test_a_transform_that_was_given_has_no_fit() -> None:
    known = CalibrationRequest(known=HandEye.of(None, None), source="x.yaml")
    found = calibration_json(
        calibrated(request=known, calibration=None, parameters_applied=0, if_applied=Ate(5.0, 6.0))
    )
    assert found["hand_eye"] == {"source": "x.yaml", "rotation": None, "lever_arm": None}
    for name in ("estimated_from", "time_offset", "blocks", "increments", "horizon_s"):
        assert found[name] is None
    assert found["parameters_fitted"] == 0
    assert list(found["ate"]["if_applied"].values()) == [5.0, 6.0]
    only = calibration_json(calibrated(request=CalibrationRequest(offset=True), hand_eye=None))
    assert only["hand_eye"] is only["T_body_marker"] is None
    other = calibration_json(calibrated(request=CalibrationRequest(hand_eye=True)))
    assert other["time_offset"] is None


def test_integrity_is_written_by_part() -> None:
    parts = [
        FAKE(
            part=name,
            unit="m",
            alert_limit=first,
            areas={"nominal": first},
            episodes={"hazardous": 3},
            availability=first / 10.0,
            bounded=0.9,
            inflation=1.5,
            effective=77.0,
            hazardous_95=(0.1, 0.2),
            time_to_alert=FAKE(median=0.5, worst=2.5, seconds=[1.0, 2.0, 3.0], missed=2),
            errors=np.array([1.0, 5.0, 2.0]),
            levels=np.array([3.0, 4.0, 9.0]),
        )
        for name, first in (("horizontal", 0.5), ("vertical", 0.75))
    ]
    found = integrity_json(FAKE(risk=1e-3, exactness="exact", parts=parts))
    assert (found["risk"], found["exactness"]) == (1e-3, "exact")
    assert [part["part"] for part in found["parts"]] == ["horizontal", "vertical"]
    assert found["parts"][1] == {
        "part": "vertical",
        "unit": "m",
        "alert_limit": 0.75,
        "areas": {"nominal": 0.75},
        "episodes": {"hazardous": 3},
        "availability": 0.075,
        "bounded": 0.9,
        "inflation_999": 1.5,
        "effective_number": 77.0,
        "hazardous_95": [0.1, 0.2],
        "time_to_alert": {"median_s": 0.5, "worst_s": 2.5, "episodes": 5, "missed": 2},
        "error_median": 2.0,
        "protection_level_median": 4.0,
    }


def test_likelihoods_of_gauges_are_written_with_their_directions() -> None:
    scale = FAKE(values=[math.log(1.25)], z=[2.5])
    tilt = FAKE(values=[math.radians(3.0), math.radians(-4.0)], z=(0.5, 1.5))
    scores: Any = FAKE(sim3=1.0, se3=2.0, yaw=3.0, scale=scale, tilt=tilt)
    found = gauge_scores_json(scores)
    assert found["tilt_deg"] == [pytest.approx(3.0), pytest.approx(-4.0)]
    assert found["tilt_z"] == [0.5, 1.5]
    likelihoods = [found[f"log_likelihood_{name}"] for name in ("sim3", "se3", "yaw")]
    assert likelihoods == [1.0, 2.0, 3.0]
    assert (found["scale"], found["scale_z"]) == (pytest.approx(1.25), 2.5)
    scores.scale = None
    found = gauge_scores_json(scores)
    assert found["scale"] is found["scale_z"] is None


def test_a_watch_is_written_with_times_of_the_recording() -> None:
    names = "rate", "gap"
    known: Any = {
        "step_m": (np.array([1.0, 2.5, 4.0]), np.array([0.1, 0.9, 0.3])),
        "nothing": (np.zeros(0), np.zeros(0)),
    }
    alarms = [
        FAKE(signal=item, begin_s=1.25, last_s=3.0, is_over=over, peak=7.0, peak_s=2.0, limit=5.0)
        for item, over in zip(names, (True, False), strict=True)
    ]
    book = FAKE(
        factor=1.5,
        limit=lambda name: {"step_m": 0.5}[name],
        is_error=lambda alarm: alarm.signal == "gap",
        alarms=alarms,
    )
    event = Event("step", "estimate", 10**18, 10**18 + 1, m=0.3, ratio=7.0)
    seen = FAKE(
        origin=10**18, armed_s=0.5, end_s=9.5, signals=known, notices=("a", "b"), events=(event,)
    )
    with pytest.MonkeyPatch.context() as patch:
        unit = "trajeval_ros.io.results.watch_json.signal_of"
        patch.setattr(unit, lambda _: FAKE(unit="m"))
        found = watch_json("vio", cast("Any", seen), cast("Any", book))
    assert found.pop("signals") == [
        {"name": "step_m", "unit": "m", "largest": 0.9, "stamp_ns": 10**18 + 2_500_000_000,
         "limit": 0.5}
    ]  # fmt: skip
    written = found.pop("alarms")
    assert [item["level"] for item in written] == ["warning", "error"]
    assert written[0] == {
        "signal": "rate",
        "level": "warning",
        "begin_ns": 10**18 + 1_250_000_000,
        "last_ns": 10**18 + 3_000_000_000,
        "is_over": True,
        "peak": 7.0,
        "peak_ns": 10**18 + 2_000_000_000,
        "limit": 5.0,
    }
    assert found.pop("events") == [
        {"kind": "step", "t_ns": 10**18, "end_ns": 10**18 + 1, "m": 0.3, "deg": 0.0, "s": 0.0,
         "certainty": "likely", "ratio": 7.0, "gap_s": 0.0}
    ]  # fmt: skip
    assert found == {
        "schema": "trajeval-watch/3",
        "estimate": "vio",
        "armed_ns": 10**18 + 500_000_000,
        "judged_s": 9.0,
        "factor": 1.5,
        "notices": ["a", "b"],
    }


def test_vectors_are_split_into_named_components() -> None:
    rng = np.random.default_rng(0)
    columns = {
        "stamps": np.arange(4),
        "position_world_m": rng.normal(size=(4, 3)),
        "rotation_world_deg": rng.normal(size=(4, 3)),
        "aligned_quaternions": rng.normal(size=(4, 4)),
        "consistency.errors": rng.normal(size=(4, 6)),
    }
    found = component_columns(columns)
    ends = {
        "position_world_m": "xyz",
        "rotation_world_deg": ("roll", "pitch", "yaw"),
        "aligned_quaternions": "xyzw",
        "consistency.errors": ("x", "y", "z", "roll", "pitch", "yaw"),
    }
    names = [f"{name.replace('.', '_')}_{end}" for name, item in ends.items() for end in item]
    assert list(found) == ["stamps", *names]
    for name, item in ends.items():
        for at, end in enumerate(item):
            np.testing.assert_array_equal(
                found[f"{name.replace('.', '_')}_{end}"], columns[name][:, at]
            )
    assert columns_of(Ate(1.0, None)) == {"position_m": 1.0}


def test_results_are_written_to_a_new_folder(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "folder"
    written = {"a.npz": lambda path: path.write_bytes(b"a"), "b": lambda path: path.touch()}
    for number in range(2):  # files of the same names are replaced
        with (
            mock.patch.object(result_folder, "error_files", return_value=written),
            mock.patch.object(result_folder, "result_of", return_value={"number": number}),
        ):
            path = result_folder.write_result(FAKE(), folder)
        assert path == folder / "result.json"
        assert path.read_text() == f'{{\n  "number": {number}\n}}\n'
        assert {item.name for item in folder.iterdir()} == {"a.npz", "b", "result.json"}
        (folder / result_folder.TABLE).touch()  # of another run
