"""JSON as the package writes it, and reads it again."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any


def json_text(value: Mapping[str, Any], indent: int | None = None) -> str:
    """Return a mapping as text, which ends its lines if it has several.

    Raises:
        ValueError: There is a NaN or an infinity in it, which JSON can't say: a defect.
    """
    return json.dumps(value, indent=indent, allow_nan=False) + ("" if indent is None else "\n")


def mapping_in(text: str | bytes) -> dict[str, Any] | None:
    """Return the mapping that a text holds, None if it is damaged or holds something else.

    That is also a number that no int64 or float64 holds, or a NaN.
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
