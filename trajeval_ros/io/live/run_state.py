"""Validation of the texts in a pair file before its pairs are evaluated."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from trajeval_ros.formatting.remarks import Level, Remark, remark_of
from trajeval_ros.geometry.up_axis import UP_AXES

Check = Callable[[Any], bool]


def require_run_state(description: Mapping[str, Any], state: Mapping[str, Any]) -> None:
    """Check the description and the newest counts of a live run."""
    for values, checks in ((description, _DESCRIPTION), (state, _STATE)):
        for keys, fits in checks.items():
            value: Any = values
            for key in keys.split("."):
                value = value.get(key) if isinstance(value, dict) else None
            if not fits(value):
                raise ValueError(f"{keys} can't be {repr(value)[:60]}")


def _is_amount(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and value >= 0


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and _is_amount(value)


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _are_resets(value: Any) -> bool:
    """Return whether a value has rows of `DeclaredReset`; None is of earlier files."""
    return value is None or (
        isinstance(value, list)
        and all(isinstance(each, list) and len(each) == 3 for each in value)
        and all(_is_count(stamp) and all(map(_is_amount, sizes)) for stamp, *sizes in value)
    )


def _is_mapping(value: Any) -> bool:
    return isinstance(value, dict)


def _is_remark(value: Any) -> bool:
    if isinstance(value, str):  # of schema 3 and before
        return True
    if not isinstance(value, dict) or value.keys() != {"level", "code", "text"}:
        return False
    return all(map(_is_text, value.values())) and value["level"].upper() in Level.__members__


def _are_remarks(value: Any) -> bool:
    return isinstance(value, list) and all(map(_is_remark, value))


def recorded_remarks(values: Sequence[Any], level: Level) -> list[Remark]:
    """Return the remarks of a valid state.

    Pair files of schema 3 and earlier have sentences, whose level is given.
    """
    return [
        Remark(level, "live_run", each) if isinstance(each, str) else remark_of(each)
        for each in values
    ]


def _is_up(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and value.keys() == {"name", "origin"}
        and value["name"] in UP_AXES
        and _is_text(value["origin"])
    )


def _are_counts(value: Any) -> bool:
    return isinstance(value, dict) and all(map(_is_count, value.values()))


_DESCRIPTION: dict[str, Check] = {
    "groundtruth": _is_text,
    "estimate": _is_text,
    "place": _is_count,
}
_STATE: dict[str, Check] = {
    **{
        f"{side}.{key}": fits
        for side in ("groundtruth", "estimate")
        for key, fits in (
            ("poses", _is_count),
            ("states", _is_count),
            ("duration_s", _is_amount),
            ("frame", _is_text),
            ("child_frame", _is_text),
            ("notes", _are_remarks),
            ("up", _is_up),
        )
    },
    "estimate.resets": _are_resets,
    "groundtruth.path_length_m": _is_amount,
    "groundtruth.time_without_gaps_ns": _is_count,
    "groundtruth.dropped": _are_counts,
    "dropped": _are_counts,
    "aligned_by": lambda value: value is None or (_is_count(value) and value > 0),
    "settings": _is_mapping,
    "live": _is_mapping,
    "warnings": _are_remarks,
}
