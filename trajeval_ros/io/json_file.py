"""JSON texts without NaN, read with limits of numbers, and the schemas that files name.

The number in a schema, such as `trajeval-runs/1`, is the version. It is raised when a field is
removed or changes its meaning, and not when a field is added.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trajeval_ros.exceptions import InputError

_LARGEST_FILE = 1 << 25  # bytes; JSON takes up to 20 times of them in memory


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
        content = json.loads(text, parse_float=_float, parse_constant=_float, parse_int=_integer)
    except (ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None


def mapping_in_file(path: Path) -> dict[str, Any] | None:
    """Return the mapping in a file; None as for `mapping_in`, and if it has more than 32 MiB."""
    with path.open("rb") as file:
        return mapping_in(file.read(_LARGEST_FILE))


def _float(digits: str) -> float:
    if not math.isfinite(number := float(digits)):
        raise ValueError(digits)
    return number


def _integer(digits: str) -> int:
    if not -(2**63) <= (number := int(digits)) < 2**63:
        raise ValueError(digits)
    return number


def require_schema(path: Path, schema: object, known: str, what: str, advice: str) -> None:
    """Check that a file has the supported schema."""
    if schema == known:
        return
    family = known.rpartition("/")[0]
    if isinstance(schema, str) and schema.startswith(f"{family}/"):
        raise InputError(
            f"{path} has schema {schema}, and this version reads {known}; {advice}, or use the "
            "version that wrote it"
        )
    raise InputError(f"{path} is not a {what} ({known}); {advice}")
