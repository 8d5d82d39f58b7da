"""JSON texts: written without NaN, and read with limits of numbers."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any


def json_text(value: Mapping[str, Any], indent: int | None = None) -> str:
    """Return a mapping as JSON text; with an indent, the text ends in a line break.

    Raises:
        ValueError: The mapping contains NaN or infinity, which JSON does not have. This is a
            defect of the caller.
    """
    return json.dumps(value, indent=indent, allow_nan=False) + ("" if indent is None else "\n")


def mapping_in(text: str | bytes) -> dict[str, Any] | None:
    """Return the mapping in a JSON text; None if the text is damaged or is not a mapping.

    A text with a NaN, or with a number beyond int64 or float64, counts as damaged.
    """
    try:
        found = json.loads(text, parse_float=_float, parse_constant=_float, parse_int=_integer)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def _float(digits: str) -> float:
    if not math.isfinite(number := float(digits)):
        raise ValueError(digits)
    return number


def _integer(digits: str) -> int:
    if not -(2**63) <= (number := int(digits)) < 2**63:
        raise ValueError(digits)
    return number
