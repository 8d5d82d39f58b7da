"""The type of a row in the table of settings, and the notations of values."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from trajeval_ros.continuous_time.samples import Noise
from trajeval_ros.exceptions import SettingsError
from trajeval_ros.geometry.geodesy import Datum
from trajeval_ros.geometry.up_axis import UP_AXES, UpAxis
from trajeval_ros.io.checks import require_known
from trajeval_ros.metrics.score import KnotTable, PointTable, RecallRule
from trajeval_ros.metrics.sub_trajectories import Length

if TYPE_CHECKING:
    from trajeval_ros.geometry.inertial import ImuNoise
    from trajeval_ros.pipeline.request import Request

AUTO, NONE, MESSAGE, ALL = "auto", "none", "message", "all"
INPUT, ALIGN, PAIR, GNSS, ERRORS, CONSISTENCY, AVAILABLE = (
    "Input", "Alignment", "Association", "GNSS fixes and surveyed points", "Errors", "Consistency",
    "As-available accuracy",
)  # fmt: skip
EVALUATE, COMPARE, FINISH, TRAJECTORY, NODE = (
    "evaluate", "compare", "finish", "trajectory", "evaluator",
)  # fmt: skip
WATCH_FACTORS = (0.1, 1000.0)  # range of the factor on the limits of a watch
_LONGEST_LEVER_M = 1e3
_KINDS = {str: "a text", float: "a number", int: "a whole number", bool: "true or false"}


@dataclass(frozen=True, kw_only=True)
class Setting:
    """A row of the table."""

    name: str  # key in YAML and parameter of the node; with `-` for `_` the option
    help: str  # meaning, values and unit; `{default}` is the default of the request
    kind: type = str  # type of the value as users write it; dict for a mapping, in YAML only
    # Fields of `Request`, as in `protocol.association.method`; () if it is not a part of it.
    target: tuple[str, ...] | str = ()
    parse: Callable[[Any], Any] | None = None  # converts the value to that of the field
    # Returns the value as users write it from a request; None to read the first target.
    read: Callable[[Request], Any] | None = None
    metavar: str = ""  # placeholder of the value in the help; empty for that of the kind
    panel: str = ""  # heading in the help
    verbs: tuple[str, ...] = ()  # verbs with this option; `NODE` for a parameter of the node
    is_common: bool = False  # whether the short help of a verb shows it
    is_repeatable: bool = False
    is_of_one_run: bool = False  # whether it is for a single evaluation, not for a comparison
    letter: str = ""  # short form of the option, as in `-g`
    value_if_alone: str = ""  # value of an option that is given without one
    choices: tuple[str, ...] = ()  # all values, for completion and the parameter's descriptor
    range: tuple[float, float] | None = None  # smallest and largest value of a parameter
    is_live: bool = False  # whether the node accepts a new value during the run
    node_help: str = ""  # meaning for the node, if it differs
    node_choices: tuple[str, ...] = ()  # all values for the node, if they differ
    # Default of the node, which also defines the parameter's type; None for the request's.
    node_default: str | float | bool | None = None

    @property
    def targets(self) -> tuple[str, ...]:
        """The fields of the request that it sets."""
        return (self.target,) if isinstance(self.target, str) else self.target

    @property
    def option(self) -> str:
        """The option on the command line."""
        return f"--{self.name.replace('_', '-')}"

    @property
    def default(self) -> Any:
        """The default as users write it: the value in an empty request."""
        return self.of(_empty_request())

    @property
    def text(self) -> str:
        """The help with its default."""
        if "{default}" not in self.help:
            return self.help
        return self.help.format(default=as_text(self.default))

    def of(self, request: Request) -> Any:
        """Return the value in a request as users write it, in types of JSON."""
        if self.read is not None:
            return self.read(request)
        value: Any = request
        for name in self.targets[0].split("."):
            value = getattr(value, name)
        return _plain(value)

    def of_yaml(self, value: Any) -> Any:
        """Return a value of a YAML file in the form of the command line.

        Lists are joined by commas, numbers become texts where one is expected, null is `none`.

        Raises:
            SettingsError: The type does not fit.
        """
        if self.kind is dict and (value is None or isinstance(value, dict)):
            return value
        if self.kind is str:
            if value is None or value == []:
                return NONE
            parts = value if isinstance(value, list) else [value]
            if not any(isinstance(part, (bool, dict, list)) for part in parts):
                return ",".join(map(str, parts))
        elif self.kind is float and type(value) is int:
            return float(value)
        elif type(value) is self.kind:
            return value
        what = _KINDS.get(self.kind, "a mapping")
        raise SettingsError(f"{self.name} must be {what}, not {value!r}")


@cache
def _empty_request() -> Request:
    from trajeval_ros.pipeline.request import Request

    return Request()


def as_text(value: Any) -> str:
    """Return a default as it is written on the command line."""
    if isinstance(value, list):
        return ",".join(map(as_text, value)) or NONE
    return f"{value:g}" if isinstance(value, float) else str(value).removesuffix("m")


def _plain(value: Any) -> Any:
    """Return a value in types of JSON, with names and lengths as users write them."""
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Length):
        return str(value)
    if isinstance(value, Noise):
        return [value.position_m, math.degrees(value.rotation_rad)]
    if isinstance(value, Datum):
        return value.coordinates.tolist()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {
            field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)
        }
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, (tuple, list)) else value


def parse_lever(text: str) -> tuple[float, float, float] | None:
    """Return the lever arm in a text "0.4,0.2,1.0": metres, in the estimate's body frame.

    Raises:
        SettingsError: The text is not three numbers with absolute values below 1000 m.
    """
    if text == NONE:
        return None
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not all(abs(item) < _LONGEST_LEVER_M for item in (x, y, z)):
        raise SettingsError(
            f"the lever arm {text!r} is not valid; give metres in the body frame, as in "
            "--lever-arm 0.4,0.2,1.0"
        )
    return x, y, z


def parse_up(text: str) -> tuple[str, str]:
    """Return the up axes of the groundtruth and of the estimates in a text "-y" or "-y,z".

    Raises:
        SettingsError: The text is not one or two of `UP_AXES`.
    """
    axes = [word.strip() for word in text.split(",")]
    if len(axes) > 2:
        raise SettingsError(
            f"the vertical axes {text!r} are not valid; give one of {', '.join(UP_AXES)}, or one "
            "for the groundtruth and one for the estimates, as in --up=-y,z"
        )
    return UpAxis(axes[0]).name, UpAxis(axes[-1]).name


def two_numbers(text: str, sentence: str) -> tuple[float, float]:
    """Return the numbers in a text "0.1,5"; raise SettingsError with a sentence for others."""
    try:
        one, other = map(float, text.split(","))
    except ValueError:
        raise SettingsError(sentence) from None
    return one, other


def parse_noise(text: str) -> tuple[float, float]:
    """Return the standard deviations in a text "0.002,0.1": metres and degrees.

    Raises:
        SettingsError: The text is not two finite numbers greater than zero.
    """
    sentence = (
        f"the groundtruth noise {text!r} is not valid; give standard deviations in metres "
        "and degrees, as in --groundtruth-noise 0.002,0.1"
    )
    position_m, rotation_deg = two_numbers(text, sentence)
    if min(position_m, rotation_deg) <= 0.0:
        raise SettingsError(
            f"the groundtruth noise must be greater than zero, not {text}; give standard "
            "deviations in metres and degrees"
        )
    if not (position_m < math.inf and rotation_deg < math.inf):
        raise SettingsError(sentence)
    return position_m, rotation_deg


def parse_imu_noise(text: str) -> ImuNoise:
    """Return the densities in a text "8e-4,2e-2": rad/s/sqrt(Hz), m/s^2/sqrt(Hz).

    Raises:
        SettingsError: The text is not two numbers in the range of sensors.
    """
    refusal = f"--imu-noise {text!r} is not valid; give two densities above zero, as in 8e-4,2e-2"
    gyroscope, accelerometer = two_numbers(text, refusal)
    if not (1e-6 <= gyroscope <= 1.0 and 1e-5 <= accelerometer <= 1e2):
        raise SettingsError(refusal)
    from trajeval_ros.geometry.inertial import ImuNoise

    return ImuNoise(gyroscope, accelerometer)


def parse_score(values: Mapping[str, Any] | None) -> PointTable | KnotTable | None:
    """Return the table of points in a mapping `{bounds_m or knots_m, points, best, dimensions}`.

    Raises:
        SettingsError: A value is not valid.
        InputError: A key is unknown.
    """
    if values is None:
        return None
    require_known(values, ("bounds_m", "knots_m", "points", "best", "dimensions"), "score")
    best = _number(values.get("best", PointTable.best), "score.best")
    table, places = (KnotTable, "knots_m") if "knots_m" in values else (PointTable, "bounds_m")
    where, points = (_numbers(values.get(name), f"score.{name}") for name in (places, "points"))
    return table(where, points, best, _dimensions(values))


def parse_recall(values: Mapping[str, Any] | None) -> RecallRule | None:
    """Return the rule in a mapping `{bounds_m, dimensions}`.

    Raises:
        SettingsError: A value is not valid.
        InputError: A key is unknown.
    """
    if values is None:
        return None
    require_known(values, ("bounds_m", "dimensions"), "recall")
    return RecallRule(_numbers(values.get("bounds_m"), "recall.bounds_m"), _dimensions(values))


def _dimensions(values: Mapping[str, Any]) -> int:
    return int(_number(values.get("dimensions", 3), "dimensions"))


def _numbers(value: Any, where: str) -> tuple[float, ...]:
    if not isinstance(value, list):
        raise SettingsError(f"{where} must be a list of numbers, not {value!r}")
    return tuple(_number(item, where) for item in value)


def _number(value: Any, where: str) -> float:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not (is_number and abs(value) < 1e9):
        raise SettingsError(f"{where} must be a number below 1e9, not {value!r}")
    return float(value)
