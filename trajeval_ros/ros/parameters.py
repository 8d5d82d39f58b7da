"""The values of the evaluator's parameters, and the settings made from them."""

from __future__ import annotations

import math
import re
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros.exceptions import SettingsError, require_one_of
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.io.requests.request_from import (
    in_names_of_settings,
    known_hand_eye,
    request_from,
)
from trajeval_ros.io.requests.setting import ALL, AUTO, NODE, NONE
from trajeval_ros.io.requests.settings_table import FROZEN, SETTINGS
from trajeval_ros.online.alarms import LIMITED_QUANTITIES, AlarmLimits
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.state_buffer import BufferLimits
from trajeval_ros.online.window import Window
from trajeval_ros.pipeline.request import Request
from trajeval_ros.ros.parameter_table import PARAMETERS, NodeParameter

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
    for parameter in PARAMETERS:
        # YAML reads `window: 500` as a number and `deadline: 1` as an integer. Both are valid,
        # therefore types are dynamic.
        descriptor = ParameterDescriptor(
            description=parameter.description,
            additional_constraints=f"one of {', '.join(parameter.choices)}"
            if parameter.choices
            else "",
            read_only=not parameter.is_live,
            dynamic_typing=True,
        )
        if parameter.range is not None and isinstance(parameter.default, float):
            low, high = parameter.range
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=low, to_value=high, step=0.0)
            ]
        try:
            declared = node.declare_parameter(parameter.name, parameter.default, descriptor)
        except Exception as error:  # rclpy's exceptions here have no common base class
            reason = " ".join(str(error).split())
            raise SettingsError(f"parameter {parameter.name} is not valid: {reason}") from error
        values[parameter.name] = converted(parameter, declared.value)
    needed = (
        ["estimate_topics"] if values["watch_factor"] else ["groundtruth_topic", "estimate_topics"]
    )
    if not all(values[item] for item in needed):
        raise SettingsError(
            "the parameters groundtruth_topic and estimate_topics are required; set them, as in "
            "--ros-args -p groundtruth_topic:=/mocap/pose -p estimate_topics:=[/vio/odometry]; "
            "without groundtruth, set watch_factor:=1.0"
        )
    if values["rerun_points"] and (values["rerun"] == NONE or not values["groundtruth_topic"]):
        raise SettingsError(
            "parameter rerun_points needs the parameters rerun and groundtruth_topic; set them, "
            "as in rerun:=file"
        )
    if not values["watch_factor"] and (alone := [item for item in _OF_WATCH if values[item]]):
        raise SettingsError(
            f"parameter {alone[0]} needs the parameter watch_factor; set it, as in "
            "watch_factor:=1.0"
        )
    return values


def about_unknown(node: Node) -> list[str]:
    """Return one sentence per parameter that is set but not declared, such as a typo."""
    names = [parameter.name for parameter in PARAMETERS]
    problems = []
    for name in getattr(node, "_parameter_overrides", {}):
        if node.has_parameter(name):
            continue
        if name.startswith("qos_overrides."):
            problems.append(
                f"parameter {name} has no effect: a subscription has the reliability and "
                "durability that all publishers of its topic offer"
            )
            continue
        near = get_close_matches(name, names, n=1)
        problems.append(
            f"unknown parameter {name}" + (f"; did you mean {near[0]}?" if near else "")
        )
    return problems


def converted(parameter: NodeParameter, value: Any) -> Any:
    """Return a value of the parameter's type; a SettingsError if type or range do not fit."""
    default, name = parameter.default, parameter.name
    if isinstance(default, bool):
        if isinstance(value, bool):
            return value
        raise SettingsError(f"parameter {name} must be true or false, not {value!r}")
    if isinstance(value, bool) or value is None:
        choices = f"; use one of {', '.join(parameter.choices)}" if parameter.choices else ""
        raise SettingsError(
            f"parameter {name} can't be {str(value).lower()}, which is also the meaning of yes, "
            f"no, on and off in YAML{choices}"
        )
    if isinstance(default, float) and isinstance(value, int | float):
        low, high = parameter.range or (float(value), float(value))
        if low <= value <= high:
            return float(value)
        raise SettingsError(f"parameter {name} must be from {low:g} to {high:g}, not {value:g}")
    if isinstance(default, list) and isinstance(value, str | list):
        return [str(item) for item in ([value] if isinstance(value, str) else value) if item]
    if isinstance(default, str) and isinstance(value, str | int | float):
        if isinstance(value, float):
            value = np.format_float_positional(value, trim="-")
        if parameter.choices and str(value) not in ("", *parameter.choices):
            require_one_of(str(value), parameter.choices, f"value of parameter {name}")
        return str(value)
    kind = {list: "a list of topics", str: "a text", float: "a number"}[type(default)]
    raise SettingsError(f"parameter {name} must be {kind}, not {value!r}")


def request_of(values: dict[str, Any]) -> Request:
    """Return the request that the parameters state, without a known pose of the marker.

    Raises:
        SettingsError: Values are invalid or contradict each other.
    """
    settings = _settings_of(values)
    if settings["hand_eye"] != AUTO:
        del settings["hand_eye"]
    try:
        return request_from(settings)
    except SettingsError as error:
        raise SettingsError(in_names_of_settings(str(error), ":=")) from error


def _settings_of(values: dict[str, Any]) -> dict[str, Any]:
    """Return the settings of a request by name; empty and 0 are no values."""
    settings = {
        name: None if values[name] == "" else values[name]
        for name, setting in SETTINGS.items()
        if NODE in setting.verbs
    }
    for name in ("min_fix_status", "max_fix_sigma"):
        settings[name] = settings[name] or None
    if settings["min_fix_status"]:
        settings["min_fix_status"] = int(settings["min_fix_status"])
    if settings["align_states"] == FROZEN:
        settings["align_states"] = ALL
    if settings["alert_limit"] is None:
        settings["risk"] = None
    return settings


def alarm_limits_of(values: dict[str, Any]) -> dict[str, AlarmLimits]:
    """Return the limits for alarms by name of the quantity, or raise a SettingsError."""
    names = [
        *(limited_quantity.name for limited_quantity in LIMITED_QUANTITIES),
        "rate_hz",
        "coverage",
    ]
    return {name: AlarmLimits.parse(values[f"limits_{name}"], f"limits_{name}") for name in names}


def metadata_of(values: dict[str, Any]) -> dict[str, str]:
    """Return the facts about the run by name; a fact without one raises a SettingsError."""
    facts = {}
    for item in values["metadata"]:
        name, equals, value = item.partition("=")
        if not name.strip() or not equals:
            raise SettingsError(
                f"parameter metadata must be facts as in operator=Ann, not {item!r}"
            )
        facts[name.strip()] = value.strip()
    return facts


def names_frames(hand_eye: str) -> bool:
    """Return whether the parameter hand_eye names two frames of static transforms."""
    return re.fullmatch(r"[\w/~]*tf_static:.*", hand_eye) is not None


def known_hand_eye_of(values: dict[str, Any]) -> HandEye | None:
    """Return the transform in the file that hand_eye names; None if it names no file."""
    text = values["hand_eye"]
    return None if text in (NONE, AUTO) or names_frames(text) else known_hand_eye(text)


def settings_of(values: dict[str, Any]) -> OnlineSettings:
    """Return the settings of the evaluation; refuses contradictions with a SettingsError."""
    request = request_of(values)
    return OnlineSettings(
        protocol=request.protocol,
        window=Window.parse(values["window"]),
        freeze=values["align_states"] == FROZEN,
        limits=BufferLimits(past_s=values["max_delay"] or math.inf),
        covariances=request.covariances,
        integrity=request.integrity,
        up=request.up,
        available=request.available,
    )
