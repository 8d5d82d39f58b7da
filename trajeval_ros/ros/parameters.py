"""The values of the evaluator's parameters, and the settings made from them."""

from __future__ import annotations

import math
import re
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros.consistency.covariance_request import CovarianceRequest
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.fix_selection import FixRule
from trajeval_ros.geometry.geodesy import parse_datum
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.io.requests.request_words import (
    AUTO,
    NONE,
    integrity_request,
    known_hand_eye,
    parse_lever,
    parse_noise,
    parse_up,
)
from trajeval_ros.metrics.settings import protocol_from
from trajeval_ros.online.intake import Limits
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.window import Window
from trajeval_ros.ros.parameter_table import FROZEN, PARAMETERS, NodeParameter
from trajeval_ros.ros.segmentation import Segmentation

if TYPE_CHECKING:
    from rclpy.node import Node


_OF_WATCH = ("watch_with", "imu_topic", "map_to_odom")


def declare(node: Node) -> dict[str, Any]:
    """Declare all parameters and return their values.

    Raises:
        SettingsError: An initial value is invalid, or topics are missing.
    """
    from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor

    values = {}
    for each in PARAMETERS:
        # YAML reads `window: 500` as a number and `max_gap: 1` as an integer. Both are valid,
        # therefore types are dynamic.
        descriptor = ParameterDescriptor(
            description=each.description, read_only=not each.is_live, dynamic_typing=True
        )
        if each.range is not None:
            low, high = each.range
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=low, to_value=high, step=0.0)
            ]
        try:
            declared = node.declare_parameter(each.name, each.default, descriptor)
        except Exception as error:  # rclpy's exceptions here have no common base class
            said = " ".join(str(error).split())
            raise SettingsError(f"parameter {each.name} is not valid: {said}") from error
        values[each.name] = converted(each, declared.value)
    needed = ["estimate_topics"] if values["watch"] else ["groundtruth_topic", "estimate_topics"]
    if not all(values[each] for each in needed):
        raise SettingsError(
            "the parameters groundtruth_topic and estimate_topics are required; set them, as in "
            "--ros-args -p groundtruth_topic:=/mocap/pose -p estimate_topics:=[/vio/odometry]; "
            "without groundtruth, set watch to a file with limits"
        )
    if not values["watch"] and (alone := [each for each in _OF_WATCH if values[each]]):
        raise SettingsError(
            f"parameter {alone[0]} needs the parameter watch; set watch to a file with limits, "
            "which trajeval watch --learn writes"
        )
    return values


def about_unknown(node: Node) -> list[str]:
    """Return one sentence per parameter that is set but not declared, such as a typo."""
    names = [each.name for each in PARAMETERS]
    found = []
    for name in getattr(node, "_parameter_overrides", {}):
        if node.has_parameter(name) or name.startswith("qos_overrides."):
            continue
        near = get_close_matches(name, names, n=1)
        found.append(f"unknown parameter {name}" + (f"; did you mean {near[0]}?" if near else ""))
    return found


def converted(parameter: NodeParameter, value: Any) -> Any:
    """Return a value converted to the type of the parameter.

    Raises:
        SettingsError: The type does not fit, or the value is outside of the parameter's range.
    """
    wanted, is_number = parameter.default, isinstance(value, int | float)
    if isinstance(wanted, bool):
        if isinstance(value, bool):
            return value
        raise SettingsError(f"parameter {parameter.name} must be true or false, not {value!r}")
    if isinstance(value, bool) or value is None:
        raise SettingsError(f"parameter {parameter.name} can't be {value}")
    if isinstance(wanted, list) and isinstance(value, str | list):
        return [str(each) for each in ([value] if isinstance(value, str) else value) if each]
    if isinstance(wanted, str) and isinstance(value, str | int | float):
        return (
            np.format_float_positional(value, trim="-") if isinstance(value, float) else str(value)
        )
    if isinstance(wanted, float) and is_number:
        low, high = parameter.range or (float(value), float(value))
        if low <= value <= high:
            return float(value)
        raise SettingsError(
            f"parameter {parameter.name} must be from {low:g} to {high:g}, not {value:g}"
        )
    kind = {list: "a list of topics", str: "a text", float: "a number"}[type(wanted)]
    raise SettingsError(f"parameter {parameter.name} must be {kind}, not {value!r}")


def words_of(values: dict[str, Any]) -> dict[str, Any]:
    """Return the settings as arguments of `protocol_from`, like those of the command line."""
    states = values["align_states"]
    return {
        "gauge": values["gauge"] or None,
        "modality": values["modality"] or None,
        "align_states": "all" if states == FROZEN else states,
        "align_with": values["align_with"],
        "association": values["association"],
        "max_time_difference": None,
        "max_gap": values["max_gap"],
        "time_offset": _time_offset(values["time_offset"]),
        "lever_m": parse_lever(values["lever_arm"]) if values["lever_arm"] else None,
        "lengths": values["lengths"],
        "ate_form": None,
        "re_form": None,
    }


def fixes_of(values: dict[str, Any]) -> FixRule:
    """Return the rule for the GNSS fixes of the groundtruth.

    Raises:
        SettingsError: A value is not valid.
    """
    return FixRule(
        datum=parse_datum(values["datum"]) if values["datum"] else None,
        min_status=int(values["min_fix_status"]) or None,
        max_sigma_m=values["max_fix_sigma"] or None,
        correlation_s=values["fix_correlation"],
    )


def segmentation_of(values: dict[str, Any]) -> Segmentation:
    """Return the rules for new segments."""
    return Segmentation(values["on_time_jump"], values["on_restart"])


def finds_offset(values: dict[str, Any]) -> bool:
    """Return whether to estimate and apply the clock offset."""
    return bool(values["time_offset"] == AUTO)


def names_frames(hand_eye: str) -> bool:
    """Return whether the parameter hand_eye names two frames of static transforms."""
    return re.fullmatch(r"[\w/~]*tf_static:.*", hand_eye) is not None


def known_hand_eye_of(values: dict[str, Any]) -> HandEye | None:
    """Return the transform in the file that hand_eye names; None if it names no file.

    Raises:
        InputError: The file can't be read, or is no transform.
    """
    text = values["hand_eye"]
    return None if text in (NONE, AUTO) or names_frames(text) else known_hand_eye(text)


def _time_offset(text: str) -> float:
    try:
        return 0.0 if text == AUTO else float(text)
    except ValueError:
        raise SettingsError(
            f"parameter time_offset must be a number of seconds or {AUTO}, not {text!r}"
        ) from None


def settings_of(values: dict[str, Any]) -> OnlineSettings:
    """Return the settings of the evaluation.

    Raises:
        SettingsError: Values are invalid or contradict each other.
    """
    return OnlineSettings(
        protocol=protocol_from("default", **words_of(values)),
        window=Window.parse(values["window"]),
        freeze=values["align_states"] == FROZEN,
        limits=Limits(past_s=values["max_delay"] or math.inf),
        covariances=_covariances(values),
        integrity=integrity_request(values["alert_limit"], values["risk"])
        if values["alert_limit"]
        else None,
        up=parse_up(values["up"]) if values["up"] else None,
    )


def _covariances(values: dict[str, Any]) -> CovarianceRequest:
    source, noise = values["covariance"], values["groundtruth_noise"]
    if source not in ("none", "message"):
        raise SettingsError(f"parameter covariance must be none or message, not {source!r}")
    return CovarianceRequest(
        source,
        rotation_frame=values["rotation_covariance_frame"],
        groundtruth_noise=parse_noise(noise) if noise else None,
    )
