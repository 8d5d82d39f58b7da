"""Blocks of results: unknown calibrations, likelihoods of gauges, and the folder."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import pytest

from trajeval_ros.calibration.apply import Ate
from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.calibration.clock_offset import OffsetGuess
from trajeval_ros.calibration.significance import Parameter
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.io.results import result_folder
from trajeval_ros.io.results.requested_json import _gauge_scores as gauge_scores_json
from trajeval_ros.io.results.requested_json import calibration_json

FAKE: Any = SimpleNamespace


def parameter(first: float, *, is_known: bool = True) -> Parameter:
    values = first + np.arange(3.0)
    known = (values, values / 10.0, values / 5.0) if is_known else (None, None, None)
    return Parameter(*known, np.array([0.5, first]), "weak", f"reason {first}", first / 100.0)


def calibrated(**changes: Any) -> Any:
    calibration = FAKE(
        guess=OffsetGuess(0.1, 0.2, 0.3, 0.4, "speed", 0.5),
        offset=parameter(1.0),
        rotation=parameter(2.0),
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


def test_what_is_unknown_of_a_calibration_is_null() -> None:
    unknown = parameter(2.0, is_known=False)
    nan = parameter(3.0)
    nan.sigma[1] = np.nan  # type: ignore[index]
    lacking = calibrated(of_marker=False)
    lacking.calibration.offset = lacking.calibration.rotation = unknown
    lacking.calibration.lever = nan
    result = calibration_json(lacking)
    assert result["errors_of"] == "body"
    offset, rotation = result["time_offset"], result["hand_eye"]["rotation"]
    assert offset["value_s"] is offset["sigma_s"] is offset["half_width_95_s"] is None
    for name in ("xyzw", "angle_deg", "sigma_deg", "half_width_95_deg"):
        assert rotation[name] is None
    assert result["hand_eye"]["lever_arm"]["sigma_m"] == [pytest.approx(0.3), None, 0.5]
    lacking.calibration.lever = unknown
    assert calibration_json(lacking)["hand_eye"]["lever_arm"]["value_m"] is None


def test_likelihoods_of_gauges_are_written_with_their_directions() -> None:
    scale = FAKE(values=[math.log(1.25)], z=[2.5])
    tilt = FAKE(values=[math.radians(3.0), math.radians(-4.0)], z=(0.5, 1.5))
    scores: Any = FAKE(sim3=1.0, se3=2.0, yaw=3.0, scale=scale, tilt=tilt)
    result = gauge_scores_json(scores)
    assert result["tilt_deg"] == [pytest.approx(3.0), pytest.approx(-4.0)]
    assert result["tilt_z"] == [0.5, 1.5]
    likelihoods = [result[f"log_likelihood_{name}"] for name in ("sim3", "se3", "yaw")]
    assert likelihoods == [1.0, 2.0, 3.0]
    assert (result["scale"], result["scale_z"]) == (pytest.approx(1.25), 2.5)
    scores.scale = None
    result = gauge_scores_json(scores)
    assert result["scale"] is result["scale_z"] is None


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
