"""The evaluator's parameters: what they are called, what they mean, what they may be."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.gauge import MODALITIES, Gauge
from trajeval_ros.io.requests.request_words import parse_up
from trajeval_ros.metrics.settings import protocol_from
from trajeval_ros.online.alarms import LIMITED_QUANTITIES
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.pairing import Limits
from trajeval_ros.online.window import Window

if TYPE_CHECKING:
    from rclpy.node import Node

FROZEN = "frozen"
AUTO = "auto"


@dataclass(frozen=True)
class NodeParameter:
    """A parameter as it is declared.

    Attributes:
        name: Its name.
        default: Its value if nobody sets it; the type is the parameter's.
        description: What it means.
        range: The least and the greatest value of a number.
        is_live: Whether it may be set while the node runs.
    """

    name: str
    default: str | float | list[str]
    description: str
    range: tuple[float, float] | None = None
    is_live: bool = False


PARAMETERS = (
    NodeParameter(
        "groundtruth_topic",
        "",
        "Topic of the groundtruth: PoseStamped, PoseWithCovarianceStamped, TransformStamped, "
        "PointStamped or Odometry, or a transform as in /tf:map.base_link. Required.",
    ),
    NodeParameter(
        "estimate_topics",
        [""],
        "Topics of the estimates to be judged, side by side: the same types, or nav_msgs/Path. "
        "Required.",
    ),
    NodeParameter(
        "modality",
        "",
        f"The sensors, which decide what alignment may change: {', '.join(MODALITIES)}.",
    ),
    NodeParameter(
        "gauge",
        "",
        "What alignment may change, by name, instead of modality: "
        f"{', '.join(each.value for each in Gauge)} (se3 if neither is given).",
    ),
    NodeParameter(
        "align_states",
        "all",
        f"Align by all states so far, by the first N, or {FROZEN}: all, until they determine the "
        "alignment well, and then no more.",
    ),
    NodeParameter(
        "align_with",
        "positions",
        "What decides the alignment's rotation: positions, or poses to let orientations help, for "
        "paths that are nearly straight.",
    ),
    NodeParameter(
        "window",
        "30s",
        "What the published ATE is about: the newest 30s, 50m or 500 (pairs); 0 is the whole run. "
        "The results on disk are always about the whole run.",
        is_live=True,
    ),
    NodeParameter(
        "lengths",
        "8,16,24,32,40",
        "Sub-trajectory lengths of the relative error: 8,16 (metres), 1s,5s (seconds), 1f,10f "
        "(frames), 10%,20% (of the path, only in the results at the end) or none.",
        is_live=True,
    ),
    NodeParameter(
        "association",
        "linear",
        "How pairs are made. Live it can only be linear: the groundtruth is interpolated.",
    ),
    NodeParameter(
        "max_gap",
        0.5,
        "Never interpolate across a longer groundtruth gap, seconds.",
        (0.0, 3600.0),
    ),
    NodeParameter(
        "max_delay",
        10.0,
        "How much later than newer groundtruth an estimate may come and still be paired, seconds; "
        "0: as late as 500 000 groundtruth states reach back (44 MB for each estimate).",
        (0.0, 86400.0),
    ),
    NodeParameter(
        "time_offset",
        "0",
        f"Added to the estimates' stamps, seconds; or {AUTO}: estimated from the first minute, "
        "and applied to all of them if it is significant.",
    ),
    NodeParameter(
        "up",
        "",
        "The axis that points up in all frames (x, y, z, -x, -y, -z), or in the groundtruth's and "
        "the estimates', as in -y,z. Empty: -y for frames named *_optical and *_optical_frame, "
        "else z. YAML needs quotes for 'y'.",
    ),
    NodeParameter(
        "publish_rate",
        20.0,
        "How often messages are taken, evaluated, and errors published, Hz.",
        (1.0, 200.0),
        is_live=True,
    ),
    NodeParameter(
        "output",
        "",
        "Folder for what remains: pairs, result.json, figures. Empty: trajeval_DATE-TIME in the "
        "working directory.",
    ),
    NodeParameter(
        "autosave_period",
        30.0,
        "How often result.json is written, seconds; 0 only at the end.",
        (0.0, 86400.0),
        is_live=True,
    ),
    NodeParameter(
        "rerun",
        "none",
        "The Rerun picture: none; file (run.rrd in the output folder); serve or serve:PORT, for "
        "viewers on this machine that come and go, and the file; connect:URL, to a viewer that "
        "listens there, and the file. It needs rerun-sdk.",
    ),
    *(
        NodeParameter(
            f"{level}_{name}",
            0.0,
            f"Diagnostics {reports} when the largest {words} since the last status is above "
            f"this, {unit}; 0 never.",
            (0.0, 1e6),
            is_live=True,
        )
        for name, words, unit in LIMITED_QUANTITIES
        for level, reports in (("warn", "warn"), ("error", "report an error"))
    ),
    NodeParameter(
        "warn_coverage",
        0.9,
        "Diagnostics warn when a smaller share of the estimate's poses has groundtruth.",
        (0.0, 1.0),
        is_live=True,
    ),
    NodeParameter(
        "error_coverage",
        0.5,
        "Diagnostics report an error when a smaller share of the estimate's poses has "
        "groundtruth.",
        (0.0, 1.0),
        is_live=True,
    ),
)


def declare(node: Node) -> dict[str, Any]:
    """Declare all parameters and return their values.

    Raises:
        SettingsError: A value given at the start means nothing, or topics are missing.
    """
    from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor

    values = {}
    for each in PARAMETERS:
        # YAML takes `window: 500` for a number and `max_gap: 1` for an integer; both are meant
        # well, hence dynamic types.
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
        except Exception as error:  # of several kinds, without a base of their own
            said = " ".join(str(error).split())
            raise SettingsError(f"parameter {each.name} can't be set: {said}") from error
        values[each.name] = converted(each, declared.value)
    if not values["groundtruth_topic"] or not values["estimate_topics"]:
        raise SettingsError(
            "the parameters groundtruth_topic and estimate_topics must name topics, as in "
            "--ros-args -p groundtruth_topic:=/mocap/pose -p estimate_topics:=[/vio/odometry]"
        )
    return values


def converted(parameter: NodeParameter, value: Any) -> Any:
    """Return a value as the type that the parameter has, however YAML read it.

    Raises:
        SettingsError: It is of no such type, or outside of the parameter's range.
    """
    wanted, is_number = parameter.default, isinstance(value, int | float)
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
    """Return the settings as `protocol_from` takes them, and as the command line has them."""
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
        "lengths": values["lengths"],
        "ate_form": None,
        "re_form": None,
    }


def finds_offset(values: dict[str, Any]) -> bool:
    """Return whether the clocks' offset is to be estimated and applied."""
    return bool(values["time_offset"] == AUTO)


def _time_offset(text: str) -> float:
    try:
        return 0.0 if text == AUTO else float(text)
    except ValueError:
        raise SettingsError(
            f"parameter time_offset must be a number of seconds or {AUTO}, not {text!r}"
        ) from None


def settings_of(values: dict[str, Any]) -> OnlineSettings:
    """Return what the values ask for.

    Raises:
        SettingsError: They contradict each other, or mean nothing.
    """
    return OnlineSettings(
        protocol=protocol_from("default", **words_of(values)),
        window=Window.parse(values["window"]),
        freeze=values["align_states"] == FROZEN,
        limits=Limits(groundtruth_s=values["max_delay"] or math.inf),
        up=parse_up(values["up"]) if values["up"] else None,
    )
