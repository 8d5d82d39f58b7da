"""JSON as the package writes it, and reads it again."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any


def json_text(value: Mapping[str, Any], indent: int | None = None) -> str:
    """Return a mapping as text, which ends its lines if it has several.

    Raises:
        ValueError: There is a NaN or an infinity in it, which JSON can't say: a defect.
    """
    return json.dumps(value, indent=indent, allow_nan=False) + ("" if indent is None else "\n")


def mapping_in(text: str | bytes) -> dict[str, Any] | None:
    """Return the mapping that a text holds, None if it is damaged or holds something else."""
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None
