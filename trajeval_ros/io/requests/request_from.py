"""Conversion of settings by name to a request: of options, YAML files and a node's parameters."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from trajeval_ros.calibration.calibration_request import CalibrationRequest
from trajeval_ros.consistency.covariance_request import CovarianceRequest, IntegrityRequest
from trajeval_ros.continuous_time.samples import Noise
from trajeval_ros.exceptions import InputError, SettingsError, require_one_of
from trajeval_ros.geometry.gauge import Gauge, gauge_for
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.trajectory_edits import TimeSpan
from trajeval_ros.io.checks import require_known
from trajeval_ros.io.requests.setting import ALL, AUTO, MESSAGE, NONE, parse_noise
from trajeval_ros.io.requests.settings_table import SETTINGS
from trajeval_ros.io.sources import parse_source
from trajeval_ros.metrics.association_rule import INTERPOLATING
from trajeval_ros.metrics.protocol import Protocol, protocol_named
from trajeval_ros.metrics.states_table import parse_first_states
from trajeval_ros.pipeline.request import Request

_CONTINUOUS = "continuous"
_PROTOCOL_FILES = (".yaml", ".yml")
_OPTION = re.compile(r"--([a-z]+(?:-[a-z]+)*)(?:[ =](?=([\w.+-]+)))?")


def request_from(settings: Mapping[str, Any]) -> Request:
    """Return the request for settings by name, as on the command line; None keeps the default.

    Raises:
        SettingsError: A setting is not valid, or contradicts another one.
        InputError: A file that a setting names can't be read or is not valid.
    """
    given = {name: value for name, value in settings.items() if value is not None}
    for name in given:
        require_one_of(name, SETTINGS, "setting")
    _require_together(given)
    plain = dict(given)
    name = plain.pop("protocol", "default")
    offset, hand_eye = plain.pop("time_offset", None), plain.pop("hand_eye", NONE)
    covariance = plain.pop("covariance", NONE)
    alert_limit, risk = plain.pop("alert_limit", None), plain.pop("risk", None)
    time_span = TimeSpan.parse(plain.pop("start", None), plain.pop("end", None))
    modality = given.get("modality")
    table = plain.pop("align_states") if _is_table(given.get("align_states")) else None
    calibration = _calibration(offset, hand_eye)
    of_protocol = {item: value for item, value in plain.items() if _is_of_protocol(item)}
    protocol = protocol_from(
        read_protocol(Path(name)) if is_protocol_file(name) else name,
        time_offset=None if offset == AUTO else offset,
        **of_protocol,
    )
    _require_effect(given, protocol)
    others = {
        path: value
        for item in plain.keys() - of_protocol.keys()
        for path, value in _changes(item, plain[item]).items()
    }
    is_continuous = protocol.association.method == _CONTINUOUS
    noise = None if is_continuous else plain.get("groundtruth_noise")
    covariances = _covariances(
        covariance,
        rotation_frame=others.pop("covariances.rotation_frame", None),
        groundtruth_noise=None if noise is None else parse_noise(noise),
    )
    request = Request(
        protocol,
        calibration,
        covariances,
        time_span=time_span,
        states_table=() if table is None else parse_first_states(table),
        integrity=None if alert_limit is None else _integrity(alert_limit, risk),
        gauge_is_default=name == "default"
        and "gauge" not in given
        and modality in (None, "lidar"),
        **{item: value for item, value in others.items() if "." not in item},
    )
    changed: Request = _replaced(
        request, {item: value for item, value in others.items() if "." in item}
    )
    return changed


def protocol_from(base: str | Protocol, **settings: Any) -> Protocol:
    """Return a protocol, given or named, with some settings replaced; None keeps a setting.

    Raises:
        SettingsError: An unknown value, or settings that exclude one another.
    """
    base = protocol_named(base) if isinstance(base, str) else base
    given = {name: value for name, value in settings.items() if value is not None}
    method = given.get("association", base.association.method)
    if "max_time_difference" in given and method in INTERPOLATING:
        raise SettingsError(
            f"association {method} interpolates and has no max time difference; use association "
            "nearest, or set a max gap"
        )
    noise = given.pop("groundtruth_noise", None)
    changes: dict[str, Any] = {}
    if method != _CONTINUOUS and "continuous_model" in given:
        raise SettingsError(f"--continuous-model needs --association continuous, not {method}")
    if method == _CONTINUOUS and noise is not None:
        position_m, rotation_deg = parse_noise(noise)
        changes["protocol.association.noise"] = Noise(position_m, math.radians(rotation_deg))
    if given.keys() & {"gauge", "modality"}:
        # The modality of the base is replaced together with its gauge.
        modality = given.pop("modality", None)
        changes["protocol.gauge"] = gauge_for(given.pop("gauge", None), modality, base.gauge)
        changes["protocol.modality"] = modality
    if "time_offset" in given:
        changes["protocol.association.time_offset_s"] = _seconds(given.pop("time_offset"))
    for name, value in given.items():
        changes |= _changes(name, value)
    # In one step: a setting can be valid only together with another one.
    protocol: Protocol = _replaced(
        base, {path.removeprefix("protocol."): value for path, value in changes.items()}
    )
    return protocol


def is_protocol_file(name: str) -> bool:
    """Return whether the name of a protocol is the name of a YAML file."""
    return name.endswith(_PROTOCOL_FILES)


def read_protocol(path: Path) -> Protocol:
    """Read a protocol from a YAML file: `base`, the protocol to start from, and settings by name.

    Its name is the name of the file without the suffix.

    Raises:
        InputError: The file can't be read, or a setting is unknown or not valid.
    """
    from trajeval_ros.io.yaml_file import read_mapping

    values = read_mapping(path, "protocol")
    known = [name for name in SETTINGS if _is_of_protocol(name) and name != "protocol"]
    require_known(values, ["base", *known], str(path))
    base = values.pop("base", "default")
    try:
        settings = {name: SETTINGS[name].of_yaml(value) for name, value in values.items()}
        named = dataclasses.replace(protocol_named(str(base)), name=path.stem)
        emptied = {name: None for name, value in settings.items() if value is None}
        changes = {SETTINGS[name].targets[0].removeprefix("protocol."): None for name in emptied}
        return protocol_from(_replaced(named, changes), **settings)
    except SettingsError as error:
        raise InputError(f"{path}: {in_names_of_settings(str(error))}") from error


def in_names_of_settings(
    text: str, assignment: str = ": ", known: Collection[str] = SETTINGS.keys()
) -> str:
    """Return a message with options replaced by names of settings, for files and parameters.

    `assignment`: what is written between a name and its value. `known`: names of settings; other
    options are unchanged.
    """

    def named(option: re.Match[str]) -> str:
        name = option[1].replace("-", "_")
        if name not in known or name not in SETTINGS:
            return option[0]
        word = option[2] or ""
        values = (AUTO, NONE, MESSAGE, *SETTINGS[name].choices)
        if word in values or re.match(r"[A-Z\d.+-]", word):
            return f"{name}{assignment}"
        return name + option[0].removeprefix(SETTINGS[name].option)

    return _OPTION.sub(named, text)


def known_hand_eye(text: str) -> HandEye:
    """Read T_B_M from numbers X,Y,Z,QX,QY,QZ,QW, a file, or BAG:/tf_static:BODY.MARKER.

    Raises:
        InputError: The file or bag can't be read, or does not contain the transform.
    """
    if (pose := HandEye.from_text(text)) is not None:
        return pose
    if text.count(":") >= 2 and not Path(text).exists():
        from trajeval_ros.io.bags.topics import read_hand_eye_of_bag

        source = parse_source(text)
        if source.frames is not None:
            return read_hand_eye_of_bag(source.path, source.topic, source.frames)
    from trajeval_ros.io.hand_eye_file import read_hand_eye

    return read_hand_eye(Path(text))


def _is_of_protocol(name: str) -> bool:
    return SETTINGS[name].targets[0].startswith("protocol.")


def _is_table(states: str | None) -> bool:
    return any(mark in (states or "") for mark in ",%")


def _changes(name: str, value: Any) -> dict[str, Any]:
    """Return the field that a setting sets, and its value."""
    setting = SETTINGS[name]
    return {setting.targets[0]: value if setting.parse is None else setting.parse(value)}


def _replaced(whole: Any, changes: Mapping[str, Any]) -> Any:
    """Return a dataclass with changed fields, by paths such as `association.time_offset_s`."""
    changed: dict[str, Any] = {}
    deeper: dict[str, dict[str, Any]] = {}
    for path, value in changes.items():
        first, _, rest = path.partition(".")
        if rest:
            deeper.setdefault(first, {})[rest] = value
        else:
            changed[first] = value
    changed |= {first: _replaced(getattr(whole, first), more) for first, more in deeper.items()}
    return dataclasses.replace(whole, **changed) if changed else whole


def _require_together(given: Mapping[str, Any]) -> None:
    """Refuse settings that exclude or need others, before a file is read."""
    if given.get("lever_arm", NONE) != NONE and given.get("hand_eye", NONE) != NONE:
        raise SettingsError("--lever-arm and --hand-eye exclude each other; give one of them")
    if "risk" in given and "alert_limit" not in given:
        raise SettingsError("--risk needs --alert-limit; add it")
    if given.get("as_available", NONE) == NONE:
        for name in given.keys() & {"deadline", "received", "receive_clock"}:
            if given[name] != SETTINGS[name].default:
                raise SettingsError(f"{SETTINGS[name].option} needs --as-available; add it")


def _require_effect(given: Mapping[str, Any], protocol: Protocol) -> None:
    """Refuse settings of a step that the protocol does not have."""
    alignment = (given.get("align_states", ALL), given.get("align_weights", NONE))
    if protocol.gauge is Gauge.NONE and alignment != (ALL, NONE):
        raise SettingsError(
            "--align-states and --align-weights need an alignment, and gauge none has none; "
            "remove them, or choose another gauge"
        )
    if not protocol.lengths and given.keys() & {"sub_trajectories", "re_form"}:
        raise SettingsError(
            "--sub-trajectories and --re-form are for relative errors, and no length is given; "
            "add --lengths"
        )
    is_tested = given.get("covariance", NONE) != NONE
    if (
        "groundtruth_noise" in given
        and not is_tested
        and protocol.association.method != _CONTINUOUS
    ):
        raise SettingsError(
            "--groundtruth-noise needs a consistency test or likelihoods; add --covariance "
            "message, --covariance FILE.npz or --association continuous"
        )


def _seconds(value: str | float) -> float:
    try:
        return float(value)
    except ValueError:
        raise SettingsError(
            f"--time-offset must be a number of seconds or auto, not {value!r}"
        ) from None


def _calibration(time_offset: str | float | None, hand_eye: str) -> CalibrationRequest:
    offset = time_offset == AUTO
    if hand_eye in (NONE, AUTO):
        return CalibrationRequest(offset=offset, hand_eye=hand_eye == AUTO)
    return CalibrationRequest(offset=offset, known=known_hand_eye(hand_eye), source=hand_eye)


def _integrity(alert_limit: str, risk: float | None) -> IntegrityRequest:
    """Return the request for limits in a text "0.5" (metres) or "0.5,2" (and degrees)."""
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
    return IntegrityRequest(metres, heading, IntegrityRequest.risk if risk is None else risk)


def _covariances(
    source: str, *, rotation_frame: str | None, groundtruth_noise: tuple[float, float] | None
) -> CovarianceRequest:
    frame = CovarianceRequest.rotation_frame if rotation_frame is None else rotation_frame
    if source in (NONE, MESSAGE):
        return CovarianceRequest(source, rotation_frame=frame, groundtruth_noise=groundtruth_noise)
    # Contradictory settings are reported before a file is read.
    CovarianceRequest(rotation_frame=frame, groundtruth_noise=groundtruth_noise)
    from trajeval_ros.io.covariance_file import read_joint_covariance

    joint = read_joint_covariance(Path(source))
    return CovarianceRequest("joint", joint, source, frame, groundtruth_noise=groundtruth_noise)
