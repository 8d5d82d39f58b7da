"""Reading and writing of a watchdog's limits as a YAML file, which users can edit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.valid_poses import LARGEST
from trajeval_ros.io.schema import require_schema
from trajeval_ros.io.writing import write_text
from trajeval_ros.io.yaml_file import read_mapping, require_known
from trajeval_ros.watchdog.limits import HealthyValues, WatchLimits
from trajeval_ros.watchdog.signals import SIGNAL_NAMED, signal_of

SCHEMA = "trajeval-limits/1"
_SHORTEST_HOURS = 1e-6  # as few as the file shows
_KNOWN = ("schema", "evidence", "healthy")
_MEND = "learn limits with trajeval watch RUN --learn FILE"


def write_limits(path: Path, limits: WatchLimits) -> None:
    """Write limits, completely or not at all.

    Raises:
        InputError: The file can't be written.
    """
    lines = [
        "# Largest and typical values of a healthy run; a limit is twice the largest by default.",
        f"schema: {SCHEMA}",
        "evidence:",
        f"  hours: {limits.hours:.6f}",
        f"  checked: {json.dumps(limits.checked)}",
        "  sources:",
        *(f"    {name}: {json.dumps(source)}" for name, source in limits.sources.items()),
        "healthy:",
    ]
    for name, values in limits.healthy.items():
        unit = signal_of(name).unit
        lines.append(
            f"  {name}: {{largest: {values.largest:.6g}, typical: {values.typical:.6g}}}"
            + (f"  # {unit}" if unit else "")
        )
    write_text(path, "\n".join(lines) + "\n", follow_link=True)


def read_limits(path: Path) -> WatchLimits:
    """Read limits.

    Raises:
        InputError: The file can't be read, or its content is not valid.
    """
    return limits_in(read_mapping(path, "limits"), path)


def limits_mapping(limits: WatchLimits) -> dict[str, Any]:
    """Return limits as the mapping of a file with limits, for JSON."""
    return {
        "schema": SCHEMA,
        "evidence": {
            "hours": limits.hours, "checked": limits.checked, "sources": dict(limits.sources),
        },
        "healthy": {
            name: {"largest": each.largest, "typical": each.typical}
            for name, each in limits.healthy.items()
        },
    }  # fmt: skip


def limits_in(found: dict[str, Any], path: Path) -> WatchLimits:
    """Return the limits in the mapping of a file.

    Args:
        found: Mapping, as `limits_mapping` returns it.
        path: The file, for messages.

    Raises:
        InputError: The content is not valid.
    """
    require_schema(path, found.get("schema"), SCHEMA, "file with limits", _MEND)
    require_known(found, _KNOWN, str(path))
    evidence, healthy = (_mapping(path, found, name) for name in ("evidence", "healthy"))
    require_known(evidence, ("hours", "checked", "sources"), f"{path}: evidence")
    stems = {str(name).partition(".")[0]: each for name, each in healthy.items()}
    require_known(stems, SIGNAL_NAMED, f"{path}: healthy")
    hours = _number(path, "hours", evidence.get("hours"))
    if hours < _SHORTEST_HOURS or not healthy:
        raise InputError(f"{path} has no healthy hours or no values; {_MEND}")
    values = {}
    for name, each in healthy.items():
        if not isinstance(each, dict) or set(each) != {"largest", "typical"}:
            raise InputError(f"{path}: {name} must be {{largest: VALUE, typical: VALUE}}")
        values[name] = HealthyValues(
            *(_number(path, f"{name}.{part}", each[part]) for part in ("largest", "typical"))
        )
    if evidence.get("sources") is None:  # an empty list of sources in YAML
        evidence["sources"] = {}
    sources = {str(name): str(each) for name, each in _mapping(path, evidence, "sources").items()}
    return WatchLimits(values, hours, sources, str(evidence.get("checked", "")))


def _mapping(path: Path, found: dict[str, Any], name: str) -> dict[str, Any]:
    value = found.get(name)
    if not isinstance(value, dict):
        raise InputError(f"{path} has no {name}; {_MEND}")
    return value


def _number(path: Path, name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"{path}: {name} must be a number, not {value!r}")
    if not 0.0 <= value <= LARGEST:
        raise InputError(f"{path}: {name} must be a number from 0 to {LARGEST:g}, not {value!r}")
    return float(value)
