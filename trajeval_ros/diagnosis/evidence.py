"""What a test has seen, before it is said: a cause by name, and the numbers behind it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Value = float | str


@dataclass(frozen=True)
class Seen:
    """A cause that a test accepts.

    Attributes:
        cause: Its name in `CAUSES`.
        explained: Share of what doesn't fit that goes away with it, 0 to 1.
        values: What the cause's sentence and option are filled in with: numbers are evidence.
    """

    cause: str
    explained: float
    values: Mapping[str, Value] = field(default_factory=dict)


@dataclass(frozen=True)
class Examined:
    """What a test looked at, and what it accepts.

    Attributes:
        test: What it is called.
        scores: Its statistics, by name.
        seen: The causes that it accepts.
        why_not: Why it could not be made; "" if it was.
    """

    test: str
    scores: Mapping[str, float] = field(default_factory=dict)
    seen: tuple[Seen, ...] = ()
    why_not: str = ""
