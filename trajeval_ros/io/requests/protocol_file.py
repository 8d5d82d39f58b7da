"""Reading of a protocol, the rules of a benchmark, from a YAML file.

    base: uzh-fpv                      # a protocol to start from; default
    gauge: yaw
    align_states: all                  # or a number
    align_with: positions              # or poses
    apply: all                         # or scale
    association: {method: linear, max_time_difference_s: 0.02, max_gap_s: 0.5, time_offset_s: 0.0}
    re_form: fitted
    nees_form: gauge
    lengths: [40, 60, 80]              # metres; or [1s, 5s], [10%], none
    selection: {rule: nearest, every: 1, pairs: all, path: groundtruth, tolerance: 0.1}
    lever_m: [0.059, -0.00855, 0.1964]
    score: {bounds_m: [0.01, 0.1], points: [10, 1], best: 100, dimensions: 3}   # or knots_m
    recall: {bounds_m: [1, 5], dimensions: 2}

Settings that are missing are taken from `base`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry.gauge import gauge_for
from trajeval_ros.io.yaml_file import read_mapping, require_known
from trajeval_ros.metrics.association import AssociationRule
from trajeval_ros.metrics.named_protocols import protocol_named
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.metrics.score import KnotTable, PointTable, RecallRule
from trajeval_ros.metrics.settings import parse_states
from trajeval_ros.metrics.sub_trajectories import Selection
from trajeval_ros.metrics.sub_trajectory_length import parse_lengths

_SUFFIXES = (".yaml", ".yml")
_WORDS = ("align_with", "apply", "align_weights", "ate_form", "re_form", "nees_form")
_KNOWN = (
    *("base", "gauge", "modality", "align_states", "association", "in_order", "lengths"),
    *_WORDS,
    *("selection", "lever_m", "score", "recall"),
)


def is_protocol_file(name: str) -> bool:
    """Return whether the name of a protocol is the name of a YAML file."""
    return name.endswith(_SUFFIXES)


def read_protocol(path: Path) -> Protocol:
    """Read a protocol; its name is the name of the file without the suffix.

    Raises:
        InputError: The file can't be read, or a setting is unknown or not valid.
    """
    found = read_mapping(path, "protocol")
    require_known(found, _KNOWN, str(path))
    try:
        return _protocol(found, path.stem)
    except SettingsError as error:
        raise InputError(f"{path}: {error}") from error


def _protocol(found: Mapping[str, Any], name: str) -> Protocol:
    base = protocol_named(str(found.get("base", "default")))
    changes: dict[str, Any] = {"name": name}
    changes |= {word: _text(found[word], word) for word in _WORDS if word in found}
    if "gauge" in found or "modality" in found:
        gauge, modality = (
            _text(found[word], word) if word in found else None for word in ("gauge", "modality")
        )
        changes |= {"gauge": gauge_for(gauge, modality, base.gauge), "modality": modality}
    if "align_states" in found:
        changes["align_states"] = parse_states(str(found["align_states"]))
    if "in_order" in found:
        if not isinstance(found["in_order"], bool):
            raise SettingsError(f"in_order must be true or false, not {found['in_order']!r}")
        changes["in_order"] = found["in_order"]
    if "lengths" in found:
        lengths = found["lengths"]
        listed = lengths if isinstance(lengths, list) else [lengths]
        changes["lengths"] = parse_lengths(",".join(str(each) for each in listed))
    if "association" in found:
        changes["association"] = _replaced(base.association, found["association"], "association")
    if "selection" in found:
        changes["selection"] = _replaced(base.selection, found["selection"], "selection")
    if "lever_m" in found:
        lever = found["lever_m"]
        changes["lever_m"] = None if lever is None else _numbers(lever, "lever_m", 3)
    if "score" in found:
        changes["score"] = _score(found["score"])
    if "recall" in found:
        changes["recall"] = _recall(found["recall"])
    return dataclasses.replace(base, **changes)


def _replaced(
    base: AssociationRule | Selection, found: Any, where: str
) -> AssociationRule | Selection:
    """Return `base` with the settings in the mapping `found`.

    Raises:
        SettingsError: `found` is not a mapping, or a value has the wrong type.
        InputError: A setting is unknown.
    """
    if not isinstance(found, dict):
        raise SettingsError(f"{where} must be a mapping, not {found!r}")
    types = {
        field.name: type(value)
        for field in dataclasses.fields(base)
        if isinstance(value := getattr(base, field.name), (str, int, float))
    }
    require_known(found, types, where)
    for name, value in found.items():
        wanted = (int, float) if types[name] is float else types[name]
        if isinstance(value, bool) or not isinstance(value, wanted):
            raise SettingsError(f"{where}.{name} must be a {types[name].__name__}, not {value!r}")
    return dataclasses.replace(base, **found)


def _score(found: Any) -> PointTable | KnotTable | None:
    if found is None:
        return None
    if not isinstance(found, dict):
        raise SettingsError(f"score must be a mapping, not {found!r}")
    require_known(found, ("bounds_m", "knots_m", "points", "best", "dimensions"), "score")
    (best,) = _numbers([found.get("best", 100.0)], "score.best", 1)
    table, places = (KnotTable, "knots_m") if "knots_m" in found else (PointTable, "bounds_m")
    where, points = (_numbers(found.get(name), f"score.{name}") for name in (places, "points"))
    return table(where, points, best, _dimensions(found))


def _recall(found: Any) -> RecallRule | None:
    if found is None:
        return None
    if not isinstance(found, dict):
        raise SettingsError(f"recall must be a mapping, not {found!r}")
    require_known(found, ("bounds_m", "dimensions"), "recall")
    return RecallRule(_numbers(found.get("bounds_m"), "recall.bounds_m"), _dimensions(found))


def _dimensions(found: Mapping[str, Any]) -> int:
    return int(_numbers([found.get("dimensions", 3)], "dimensions", 1)[0])


def _numbers(value: Any, where: str, count: int | None = None) -> Any:
    numbers = isinstance(value, list) and all(
        isinstance(each, (int, float)) and not isinstance(each, bool) and abs(each) < 1e9
        for each in value
    )
    if not numbers or (count is not None and len(value) != count):
        what = "a list of numbers" if count is None else f"{count} numbers"
        raise SettingsError(f"{where} must be {what}, not {value!r}")
    return tuple(float(each) for each in value)


def _text(value: Any, where: str) -> str:
    if not isinstance(value, str):
        raise SettingsError(f"{where} must be a word, not {value!r}")
    return value
