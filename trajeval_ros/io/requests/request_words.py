"""Conversion of settings to a request: options, the file of a comparison, a node's parameters."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.consistency.covariance_request import CovarianceRequest
from trajeval_ros.diagnosis.mends import Mends
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.fix_selection import FixRule
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.geodesy import parse_datum
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.time_span import TimeSpan
from trajeval_ros.geometry.up_axis import UP_AXES, UpAxis
from trajeval_ros.io.requests.protocol_file import is_protocol_file, read_protocol
from trajeval_ros.io.sources import parse_source
from trajeval_ros.metrics.settings import protocol_from
from trajeval_ros.metrics.states_table import FirstStates, parse_first_states
from trajeval_ros.pipeline.request import Request

if TYPE_CHECKING:
    from trajeval_ros.consistency.integrity import IntegrityRequest
    from trajeval_ros.metrics.protocol import Protocol
    from trajeval_ros.watchdog.limits import WatchLimits

_LONGEST_LEVER_M = 1e3
AUTO, NONE, MESSAGE = "auto", "none", "message"

# Names and types of the settings. The options have the same names, with `-` instead of `_`.
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
    "lever_arm": str,
    "align_weights": str,
    "datum": str,
    "min_fix_status": int,
    "max_fix_sigma": float,
    "fix_correlation": float,
    "hand_eye": str,
    "continuous_model": str,
    "groundtruth_noise": str,
    "lengths": str,
    "pairs": str,
    "ate_form": str,
    "re_form": str,
    "covariance": str,
    "rotation_covariance_frame": str,
    "integrity": bool,
    "alert_limit": str,
    "risk": float,
    "up": str,
    "start": str,
    "end": str,
    "groundtruth_scale": float,
    "estimate_scale": float,
    "quaternion_order": str,
    "inverse": str,
    "estimate_axes": str,
    "clock_rate": float,
}


def request_from(words: Mapping[str, Any]) -> Request:
    """Return the request for settings; a missing one or None keeps the protocol's setting.

    Args:
        words: Settings by the names in `WORDS`, with values as on the command line. `watch_limits`
            (a path), `swap` and `fix` are also accepted; they apply to a single evaluation.

    Raises:
        SettingsError: A setting is not valid, or contradicts another one.
        InputError: A file that a setting names can't be read or is not valid.
    """
    given = {key: value for key, value in words.items() if value is not None}
    offset = given.pop("time_offset", None)
    calibration = _calibration(offset, given.pop("hand_eye", NONE))
    noise = given.pop("groundtruth_noise", None)
    noise = None if noise is None else parse_noise(noise)
    covariance = given.pop("covariance", NONE)
    frame = given.pop("rotation_covariance_frame", "world")
    lever = given.pop("lever_arm", None)
    if lever is not None and (calibration.hand_eye or calibration.known is not None):
        raise SettingsError("--lever-arm and --hand-eye exclude each other; give one of them")
    fixes = _fix_rule(given)
    integrity = _integrity(
        given.pop("integrity", False), given.pop("alert_limit", None), given.pop("risk", None)
    )
    watch_limits = given.pop("watch_limits", None)
    up = given.pop("up", None)
    fix = given.pop("fix", "")
    mends = Mends.of(given)
    for each in dataclasses.fields(mends):
        given.pop(each.name, None)
    time_span = TimeSpan.parse(given.pop("start", None), given.pop("end", None))
    table: tuple[FirstStates, ...] = ()
    if any(mark in str(given.get("align_states", "")) for mark in ",%"):
        table = parse_first_states(given.pop("align_states"))
    name = given.pop("protocol", "default")
    gauge_is_default = name == "default" and not given.keys() & {"gauge", "modality"}
    protocol = protocol_from(
        read_protocol(Path(name)) if is_protocol_file(name) else name,
        time_offset=None if offset == AUTO else _seconds(offset),
        groundtruth_noise=noise,
        lever_m=None if lever is None else parse_lever(lever),
        **given,
    )
    _require_effect(words, protocol)
    continuous = protocol.association.method == "continuous"
    if noise is not None and covariance == NONE and not continuous:
        raise SettingsError(
            "--groundtruth-noise needs a consistency test or likelihoods; add --covariance "
            "message, --covariance FILE.npz or --association continuous"
        )
    covariances = _covariances(covariance, frame, None if continuous else noise)
    return Request(
        protocol,
        calibration,
        covariances,
        time_span=time_span,
        up=None if up is None else parse_up(up),
        states_table=table,
        mends=mends,
        fix=fix,
        integrity=integrity,
        watch_limits=None if watch_limits is None else _limits(watch_limits),
        fixes=fixes,
        gauge_is_default=gauge_is_default,
    )


def _require_effect(words: Mapping[str, Any], protocol: Protocol) -> None:
    """Refuse settings of a step that the protocol does not have.

    Raises:
        SettingsError: Settings of the alignment with gauge none, or of relative errors without
            a length.
    """
    alignment = (words.get("align_states") or "all", words.get("align_weights") or NONE)
    if protocol.gauge is Gauge.NONE and alignment != ("all", NONE):
        raise SettingsError(
            "--align-states and --align-weights need an alignment, and gauge none has none; "
            "remove them, or choose another gauge"
        )
    if not protocol.lengths and (words.get("pairs") or words.get("re_form")):
        raise SettingsError(
            "--pairs and --re-form are for relative errors, and no length is given; add --lengths"
        )


def _limits(path: Path) -> WatchLimits:
    from trajeval_ros.io.requests.limits_file import read_limits

    return read_limits(path)


def _fix_rule(given: dict[str, Any]) -> FixRule:
    """Remove the settings of GNSS fixes from `given` and return them."""
    datum = given.pop("datum", None)
    words = {"min_status": "min_fix_status", "max_sigma_m": "max_fix_sigma"}
    words["correlation_s"] = "fix_correlation"
    return FixRule(
        datum=None if datum is None else parse_datum(datum),
        **{name: given.pop(word) for name, word in words.items() if word in given},
    )


def parse_lever(text: str) -> tuple[float, float, float]:
    """Return the lever arm in a text "0.4,0.2,1.0": metres, in the estimate's body frame.

    Raises:
        SettingsError: The text is not three numbers with absolute values below 1000 m.
    """
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not all(abs(each) < _LONGEST_LEVER_M for each in (x, y, z)):
        raise SettingsError(
            f"the lever arm {text!r} is not valid; give metres in the body frame, as in "
            "--lever-arm 0.4,0.2,1.0"
        )
    return x, y, z


def _integrity(
    wanted: bool, alert_limit: str | None, risk: float | None
) -> IntegrityRequest | None:
    if not wanted:
        if alert_limit is not None or risk is not None:
            raise SettingsError("--alert-limit and --risk need --integrity; add it")
        return None
    if alert_limit is None:
        raise SettingsError(
            "--integrity needs an alert limit; give metres, as in --alert-limit 0.5, or metres "
            "and degrees for the heading, as in --alert-limit 0.5,2"
        )
    return integrity_request(alert_limit, risk)


def integrity_request(alert_limit: str, risk: float | None) -> IntegrityRequest:
    """Return the request for protection levels and alert limits.

    Args:
        alert_limit: "0.5" in metres, or "0.5,2" in metres and in degrees of heading.
        risk: Probability that an error exceeds its protection level; None for the default.

    Raises:
        SettingsError: The limits or the risk are not valid.
    """
    from trajeval_ros.consistency.integrity import DEFAULT_RISK, IntegrityRequest

    try:
        metres, *degrees = (float(part) for part in alert_limit.split(","))
        if len(degrees) > 1:
            raise ValueError(alert_limit)
    except ValueError:
        raise SettingsError(
            f"the alert limit {alert_limit!r} is not valid; give metres, and degrees for the "
            "heading, as in 0.5,2"
        ) from None
    heading = degrees[0] if degrees else None
    return IntegrityRequest(metres, heading, DEFAULT_RISK if risk is None else risk)


def _calibration(time_offset: str | None, hand_eye: str) -> CalibrationRequest:
    offset = time_offset == AUTO
    if hand_eye in (NONE, AUTO):
        return CalibrationRequest(offset=offset, hand_eye=hand_eye == AUTO)
    return CalibrationRequest(offset=offset, known=known_hand_eye(hand_eye), source=hand_eye)


def known_hand_eye(text: str) -> HandEye:
    """Read T_B_M from a file, or from BAG:/tf_static:BODY.MARKER.

    Raises:
        InputError: The file or bag can't be read, or does not contain the transform.
    """
    if text.count(":") >= 2 and not Path(text).exists():
        from trajeval_ros.io.bags.topics import read_hand_eye_of_bag

        source = parse_source(text)
        if source.frames is not None:
            return read_hand_eye_of_bag(source.path, source.topic, source.frames)
    from trajeval_ros.io.requests.hand_eye_file import read_hand_eye

    return read_hand_eye(Path(text))


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
    # Contradictory settings are reported before a file is read.
    CovarianceRequest(rotation_frame=frame, groundtruth_noise=noise)
    from trajeval_ros.io.requests.covariance_file import read_joint_covariance

    return CovarianceRequest(
        "joint", read_joint_covariance(Path(source)), source, frame, groundtruth_noise=noise
    )


def parse_up(text: str) -> tuple[str, str]:
    """Return the up axes of the groundtruth and of the estimates in a text "-y" or "-y,z".

    Raises:
        SettingsError: The text is not one or two of `UP_AXES`.
    """
    axes = [each.strip() for each in text.split(",")]
    if len(axes) > 2:
        raise SettingsError(
            f"the vertical axes {text!r} are not valid; give one of {', '.join(UP_AXES)}, or one "
            "for the groundtruth and one for the estimates, as in --up=-y,z"
        )
    return UpAxis(axes[0]).name, UpAxis(axes[-1]).name


def parse_noise(text: str) -> tuple[float, float]:
    """Return the standard deviations in a text "0.002,0.1": metres and degrees.

    Raises:
        SettingsError: The text is not two finite numbers greater than zero.
    """
    try:
        position_m, rotation_deg = (float(part) for part in text.split(","))
    except ValueError:
        position_m = rotation_deg = math.nan
    if min(position_m, rotation_deg) <= 0.0:
        raise SettingsError(
            f"the groundtruth noise must be greater than zero, not {text}; give standard "
            "deviations in metres and degrees"
        )
    if not (position_m < math.inf and rotation_deg < math.inf):
        raise SettingsError(
            f"the groundtruth noise {text!r} is not valid; give standard deviations in metres "
            "and degrees, as in --groundtruth-noise 0.002,0.1"
        )
    return position_m, rotation_deg
