"""What of a calibration is applied, counted and warned of, at its limits."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from trajeval_ros.calibration.apply import (
    Ate,
    Calibrated,
    _remarks,
    _require_body_known,
    _Significant,
)
from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.calibration.significance import Parameter, unobservable
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.marker import HandEye

KNOWN = HandEye(np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3))


def parameter(*value: float, status: str = "significant", seen: int | None = None) -> Parameter:
    size = len(value)
    reliability = np.zeros(size)
    reliability[: size if seen is None else seen] = 0.9
    width = np.full(size, 0.002)
    return Parameter(np.array(value), width, width, reliability, status, "")


def calibration(**changed: Parameter) -> Any:
    given = {
        "offset": parameter(0.02),
        "turn": parameter(0.1, 0.2, 0.3),
        "lever": parameter(1.0, 2.0, 3.0, seen=2),
    }
    return SimpleNamespace(**{**given, **changed}, remarks=())


def calibrated(**changed: Any) -> Calibrated:
    rule = SimpleNamespace(time_offset_s=0.0)
    evaluation: Any = SimpleNamespace(protocol=SimpleNamespace(association=rule))
    given: dict[str, Any] = {
        "evaluation": evaluation, "request": CalibrationRequest(offset=True, hand_eye=True),
        "calibration": calibration(), "estimated_from": "", "offset_applied": True,
        "rotation_applied": True, "lever_applied": True, "hand_eye": KNOWN, "of_marker": False,
        "before": Ate(1.0, None), "after": Ate(1.0, None), "if_applied": None,
    }  # fmt: skip
    return Calibrated(**{**given, **changed})


@pytest.mark.parametrize(
    ("changed", "count"),
    [
        ({}, 1 + 3 + 2),
        ({"offset_applied": False}, 5),
        ({"rotation_applied": False}, 3),
        ({"lever_applied": False}, 4),
        ({"request": CalibrationRequest(offset=True, known=KNOWN)}, 1),
        ({"calibration": None}, 0),
    ],
)
def test_parameters_are_counted_by_their_observable_directions(
    changed: dict[str, Any], count: int
) -> None:
    assert calibrated(**changed).parameters_applied == count


def test_a_known_transform_is_not_estimated() -> None:
    with pytest.raises(SettingsError, match="give only one"):
        CalibrationRequest(hand_eye=True, known=KNOWN)


@pytest.mark.parametrize(
    ("changed", "codes"),
    [
        ({"after": Ate(1.049, None)}, []),
        ({"after": Ate(1.051, None)}, ["calibration_worsens"]),
        ({"after": Ate(1.051, None), "before": None}, []),
        ({"after": Ate(1.051, None), "offset_applied": False}, ["calibration_worsens"]),
        ({"after": Ate(1.051, None), "offset_applied": False, "hand_eye": None}, []),
        ({"after": Ate(1.051, None), "hand_eye": None}, ["calibration_worsens"]),
        # Clocks that differ by more than two half widths of 2 ms.
        ({"request": CalibrationRequest(hand_eye=True)}, ["clock_offset_not_corrected"]),
        (
            {
                "request": CalibrationRequest(),
                "calibration": calibration(offset=parameter(-0.0041)),
            },
            ["clock_offset_not_corrected"],
        ),
        (
            {
                "request": CalibrationRequest(),
                "calibration": calibration(offset=parameter(0.0039)),
            },
            [],
        ),
        (
            {
                "request": CalibrationRequest(),
                "calibration": calibration(offset=parameter(0.02, status="insignificant")),
            },
            [],
        ),
        ({"calibration": None}, []),
    ],
)
def test_warnings_of_a_calibration(changed: dict[str, Any], codes: list[str]) -> None:
    found = _remarks(calibrated(**changed))
    assert [item.code for item in found] == codes


def test_clocks_are_compared_with_the_assumed_offset() -> None:
    some = calibrated(request=CalibrationRequest())
    some.evaluation.protocol.association.time_offset_s = 0.0165  # type: ignore[misc]
    assert _remarks(some) == []
    some.evaluation.protocol.association.time_offset_s = 0.0155  # type: ignore[misc]
    assert "differ by +4.5 ms" in _remarks(some)[0].text


def test_what_is_found_is_what_was_asked_for() -> None:
    everything = calibration(lever=parameter(1.0, 2.0, 3.0, status="insignificant"))
    found = _Significant.in_calibration(everything, CalibrationRequest(offset=True, hand_eye=True))
    assert (found.offset, found.turn, found.lever) == (
        everything.offset, everything.turn, everything.lever
    )  # fmt: skip
    used = found.significant()
    assert (used.offset, used.turn, used.lever) == (everything.offset, everything.turn, None)
    assert used.hand_eye is not None
    np.testing.assert_allclose(lie.rotation_vector(used.hand_eye.rotation_xyzw), [0.1, 0.2, 0.3])
    assert not used.hand_eye.lever_m.any()
    assert found.hand_eye is not None
    np.testing.assert_array_equal(found.hand_eye.lever_m, [1.0, 2.0, 3.0])
    clock = _Significant.in_calibration(everything, CalibrationRequest(offset=True))
    assert (clock.turn, clock.lever, clock.hand_eye) == (None, None, None)
    nothing = _Significant.in_calibration(
        calibration(turn=unobservable("")), CalibrationRequest(hand_eye=True)
    )
    assert (nothing.offset, nothing.turn) == (None, None)
    assert _Significant.in_calibration(None, CalibrationRequest(known=KNOWN)).hand_eye is KNOWN
    only = dataclasses.replace(found, turn=None)
    assert only.hand_eye is not None
    np.testing.assert_array_equal(only.hand_eye.rotation_xyzw, [0.0, 0.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("align_with", "hand_eye", "status", "refused"),
    [
        ("poses", True, "weak", True), ("poses", True, "unobservable", True),
        ("poses", True, "insignificant", False), ("poses", False, "weak", False),
        ("positions", True, "weak", False),
    ],
)  # fmt: skip
def test_alignments_by_poses_need_a_known_body(
    align_with: str, hand_eye: bool, status: str, refused: bool
) -> None:
    some = calibration(turn=parameter(0.1, 0.2, 0.3, status=status))
    protocol: Any = SimpleNamespace(align_with=align_with)
    wanted = CalibrationRequest(offset=True, hand_eye=hand_eye)
    if refused:
        with pytest.raises(InputError, match="can't estimate the rotation"):
            _require_body_known(some, protocol, wanted)
    else:
        _require_body_known(some, protocol, wanted)
