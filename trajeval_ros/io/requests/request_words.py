"""From words to a request: what the command line, a comparison's file and a node are told."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.consistency.covariance_request import CovarianceRequest
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.time_span import TimeSpan
from trajeval_ros.geometry.up_axis import UP_AXES, UpAxis
from trajeval_ros.io.requests.protocol_file import is_protocol_file, read_protocol
from trajeval_ros.metrics.settings import protocol_from
from trajeval_ros.metrics.states_table import FirstStates, parse_first_states
from trajeval_ros.pipeline import Request

AUTO, NONE, MESSAGE = "auto", "none", "message"

# The words, and what their values are. `_` stands where the command line has `-`.
WORDS: dict[str, type] = {
    "protocol": str,
    "gauge": str,
    "modality": str,
    "align_states": str,
    "align_with": str,
    "apply": str,
    "association": str,
    "max_time_difference": float,
    "max_gap": float,
    "time_offset": str,
    "hand_eye": str,
    "continuous_model": str,
    "groundtruth_noise": str,
    "lengths": str,
    "pairs": str,
    "ate_form": str,
    "re_form": str,
    "covariance": str,
    "rotation_covariance_frame": str,
    "up": str,
    "start": str,
    "end": str,
}


def request_from(words: Mapping[str, Any]) -> Request:
    """Return what words ask for; a word that is missing or None leaves the protocol's setting.

    Args:
        words: By the names of `WORDS`, as texts that the command line takes.

    Raises:
        SettingsError: Words that mean nothing, or nothing together.
        InputError: A file that they name can't be read.
    """
    given = {key: value for key, value in words.items() if value is not None}
    offset = given.pop("time_offset", None)
    calibration = _calibration(offset, given.pop("hand_eye", NONE))
    noise = given.pop("groundtruth_noise", None)
    noise = None if noise is None else parse_noise(noise)
    covariance = given.pop("covariance", NONE)
    frame = given.pop("rotation_covariance_frame", "world")
    up = given.pop("up", None)
    time_span = TimeSpan.parse(given.pop("start", None), given.pop("end", None))
    table: tuple[FirstStates, ...] = ()
    if any(mark in str(given.get("align_states", "")) for mark in ",%"):
        table = parse_first_states(given.pop("align_states"))
    name = given.pop("protocol", "default")
    protocol = protocol_from(
        read_protocol(Path(name)) if is_protocol_file(name) else name,
        time_offset=None if offset == AUTO else _seconds(offset),
        groundtruth_noise=noise,
        **given,
    )
    continuous = protocol.association.method == "continuous"
    if noise is not None and covariance == NONE and not continuous:
        raise SettingsError(
            "--groundtruth-noise is for likelihoods and for the consistency of covariances; "
            "add --covariance message, --covariance FILE.npz or --association continuous"
        )
    covariances = _covariances(covariance, frame, None if continuous else noise)
    return Request(
        protocol,
        calibration,
        covariances,
        time_span=time_span,
        up=None if up is None else parse_up(up),
        states_table=table,
    )


def _calibration(time_offset: str | None, hand_eye: str) -> CalibrationRequest:
    offset = time_offset == AUTO
    if hand_eye in (NONE, AUTO):
        return CalibrationRequest(offset=offset, hand_eye=hand_eye == AUTO)
    from trajeval_ros.io.requests.hand_eye_file import read_hand_eye

    return CalibrationRequest(offset=offset, known=read_hand_eye(Path(hand_eye)), source=hand_eye)


def _seconds(text: str | float | None) -> float | None:
    if text is None:
        return None
    try:
        return float(text)
    except ValueError:
        raise SettingsError(
            f"--time-offset must be a number of seconds or auto, not {text!r}"
        ) from None


def _covariances(source: str, frame: str, noise: tuple[float, float] | None) -> CovarianceRequest:
    if source in (NONE, MESSAGE):
        return CovarianceRequest(source, rotation_frame=frame, groundtruth_noise=noise)
    # Words that contradict each other are told before a file is read.
    CovarianceRequest(rotation_frame=frame, groundtruth_noise=noise)
    from trajeval_ros.io.requests.covariance_file import read_joint_covariance

    return CovarianceRequest(
        "joint", read_joint_covariance(Path(source)), source, frame, groundtruth_noise=noise
    )


def parse_up(text: str) -> tuple[str, str]:
    """Read "-y", or "-y,z": the up axes of the groundtruth and of the estimates.

    Raises:
        SettingsError: It is neither.
    """
    axes = [each.strip() for each in text.split(",")]
    if len(axes) > 2:
        raise SettingsError(
            f"can't read the up axes {text!r}; write one of {', '.join(UP_AXES)}, or the "
            "groundtruth's and the estimates', as in --up=-y,z"
        )
    return UpAxis(axes[0]).name, UpAxis(axes[-1]).name


def parse_noise(text: str) -> tuple[float, float]:
    """Read "0.002,0.1": metres and degrees.

    Raises:
        SettingsError: It isn't two numbers above zero.
    """
    try:
        position_m, rotation_deg = (float(part) for part in text.split(","))
    except ValueError:
        position_m = rotation_deg = math.nan
    if min(position_m, rotation_deg) <= 0.0:
        raise SettingsError(
            f"the groundtruth noise must be above zero, not {text}: against groundtruth that is "
            "exactly right, every error is infinitely unlikely"
        )
    if not (position_m < math.inf and rotation_deg < math.inf):
        raise SettingsError(
            f"can't read the groundtruth noise {text!r}; write standard deviations in metres and "
            "degrees, as in --groundtruth-noise 0.002,0.1"
        )
    return position_m, rotation_deg
