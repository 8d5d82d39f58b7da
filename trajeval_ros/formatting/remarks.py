"""What is said to the user about data and results: one sentence with a level and a code."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum


class Level(IntEnum):
    """Severity of a remark, in increasing order.

    A note states what was detected or assumed. A warning questions a number. An error means that
    data are missing.
    """

    NOTE = 0
    WARNING = 1
    ERROR = 2


@dataclass(frozen=True)
class Remark:
    """One sentence for the user."""

    level: Level
    code: str  # a stable identifier for programs, such as `low_coverage` or the cause of a finding
    text: str
    subject: str = ""  # distinguishes remarks of one code, such as the quantity of an alarm
    values: Mapping[str, float | int | str] = field(default_factory=dict, hash=False)


def note(code: str, text: str) -> Remark:
    """Return a remark on what was detected or assumed."""
    return Remark(Level.NOTE, code, text)


def warning(
    code: str, text: str, subject: str = "", values: Mapping[str, float | int | str] | None = None
) -> Remark:
    """Return a remark that questions a number."""
    return Remark(Level.WARNING, code, text, subject, values or {})


def damaged(text: str) -> Remark:
    """Return a remark on data that are missing, because a part of a file is not readable."""
    return Remark(Level.ERROR, "damaged", text)


def most_severe_first(remarks: Iterable[Remark]) -> list[Remark]:
    """Return remarks in order of decreasing severity."""
    return sorted(remarks, key=lambda remark: -remark.level)


def remark_json(remark: Remark) -> dict[str, str]:
    """Return a remark as a JSON object."""
    return {"level": remark.level.name.lower(), "code": remark.code, "text": remark.text}


def remark_of(values: Mapping[str, str]) -> Remark:
    """Return the remark of a JSON object.

    Raises:
        KeyError: A value is missing, or the level is unknown.
    """
    return Remark(Level[values["level"].upper()], values["code"], values["text"])
