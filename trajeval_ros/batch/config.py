"""A comparison as a user writes it down: a YAML file, or a folder of a known convention."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trajeval_ros.batch.conventions import runs_in_folder
from trajeval_ros.batch.patterns import Pattern
from trajeval_ros.batch.plan import Name, Plan, PlannedRun, all_runs
from trajeval_ros.exceptions import InputError
from trajeval_ros.io.protocol_file import is_protocol_file, read_protocol
from trajeval_ros.io.yaml_file import read_mapping, require_known
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.settings import protocol_from

# The words of `trajeval evaluate`, with _ for -, and what their values are.
_SETTINGS: dict[str, type] = {
    "gauge": str,
    "modality": str,
    "align_states": str,
    "association": str,
    "max_time_difference": float,
    "max_gap": float,
    "time_offset": float,
    "lengths": str,
    "ate_form": str,
    "re_form": str,
}
_KEYS = (
    "title", "folder", "groundtruth", "runs", "sequences", "trials", "common_time_span",
    "protocol", *_SETTINGS,
)  # fmt: skip


def plan_of(
    target: Path, settings: Mapping[str, Any], *, common_time_span: bool | None = None
) -> Plan:
    """Return what a YAML file or a folder asks to compare.

    Args:
        target: The file or folder.
        settings: Of the protocol, by the words of the command line; they override the file's.
        common_time_span: Likewise.

    Raises:
        InputError: It can't be read, says what nobody knows, or names no files.
        SettingsError: Settings that mean nothing.
    """
    if target.is_dir():
        runs = runs_in_folder(target)
        protocol = _protocol({}, settings)
        return Plan(target.resolve().name, runs, protocol, bool(common_time_span))
    if not target.exists():
        raise InputError(
            f"{target} does not exist; name a YAML file that says what to compare, or a folder of "
            "ov_eval's or rpg_trajectory_evaluation's layout"
        )
    config = read_mapping(target, "comparison")
    require_known(config, _KEYS, str(target))
    for key in ("groundtruth", "runs"):
        if key not in config:
            raise InputError(f"{target} has no {key!r}; it names the files that are compared")
    if common_time_span is None:
        common_time_span = _typed(config, "common_time_span", bool, target, default=False)
    return Plan(
        title=_typed(config, "title", str, target, default=target.stem),
        runs=_runs(config, target),
        protocol=_protocol(_settings(config, target), settings),
        common_time_span=bool(common_time_span),
    )


def _runs(config: Mapping[str, Any], target: Path) -> tuple[PlannedRun, ...]:
    folder = target.parent / _typed(config, "folder", str, target, default=".")
    patterns = config["runs"]
    if not isinstance(patterns, dict) or not patterns:
        raise InputError(
            f"{target}: runs must be a mapping of algorithms to patterns, as in "
            "{vio: vio/{sequence}.txt}"
        )
    truth = Pattern.parse(_typed(config, "groundtruth", str, target, default=""))
    if truth.has_trials:
        raise InputError(f"{target}: groundtruth is the same for all trials; leave out {{trial}}")
    algorithms = {
        str(name): Pattern.parse(_typed(patterns, name, str, target, default=""))
        for name in patterns
    }
    sequences = _names(config, "sequences", target)
    found = truth.find(folder)
    truth.require(found, folder)
    truths = {sequence: source for (sequence, _), source in found.items()}
    estimates: dict[Name, str] = {}
    for algorithm, pattern in algorithms.items():
        found = pattern.find(folder)
        if not sequences:  # else it is known which runs there should be
            pattern.require(found, folder)
        estimates |= {(algorithm, *run): source for run, source in found.items()}
    return all_runs(
        algorithms,
        estimates,
        lambda _, sequence: truths.get(sequence, ""),
        lambda name: algorithms[name[0]].path_of(folder, *name[1:]),
        sequences=sequences,
        trials=_names(config, "trials", target),
    )


def _settings(config: Mapping[str, Any], target: Path) -> dict[str, Any]:
    """Return the settings of a protocol as the command line would have them."""
    settings: dict[str, Any] = {}
    for key, kind in {"protocol": str, **_SETTINGS}.items():
        if key not in config:
            continue
        value = config[key]
        if key in ("lengths", "align_states") and isinstance(value, (list, int, float)):
            value = ",".join(map(str, value)) if isinstance(value, list) else str(value)
            value = value or "none"
        if key == "gauge" and value is None:  # YAML's null; `none` is a string to it
            value = "none"
        settings[key] = _typed({key: value}, key, kind, target)
    if is_protocol_file(settings.get("protocol", "")):
        settings["protocol"] = str(target.parent / settings["protocol"])
    return settings


def _protocol(written: Mapping[str, Any], said: Mapping[str, Any]) -> Protocol:
    """Return the protocol of a file's settings, and of what the command line says instead."""
    said = {key: value for key, value in said.items() if value is not None}
    if "gauge" in said or "modality" in said:
        written = {key: each for key, each in written.items() if key not in ("gauge", "modality")}
    given = {**dict.fromkeys(_SETTINGS), **written, **said}
    name = given.pop("protocol", "default")
    return protocol_from(read_protocol(Path(name)) if is_protocol_file(name) else name, **given)


def _names(config: Mapping[str, Any], key: str, target: Path) -> list[str]:
    value = config.get(key, [])
    if not isinstance(value, list):
        raise InputError(f"{target}: {key} must be a list of names, not {value!r}")
    for each in value:
        if not isinstance(each, str) and not (key == "trials" and type(each) is int):
            raise InputError(
                f"{target}: {each!r} of {key} is no text; write a name such as 00 in quotes"
            )
    names = [str(each) for each in value]
    twice = [name for name in dict.fromkeys(names) if names.count(name) > 1]
    if twice:
        raise InputError(f"{target}: {key} names {twice[0]} twice")
    return names


def _typed(
    config: Mapping[str, Any], key: str, kind: type, target: Path, *, default: Any = None
) -> Any:
    value = config.get(key, default)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, kind):
        what = {str: "a text", float: "a number", bool: "true or false"}[kind]
        raise InputError(f"{target}: {key} must be {what}, not {value!r}")
    return value
