"""Results of tests: causes by name, and their numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Value = float | str


@dataclass(frozen=True)
class Seen:
    """A cause that a test detected.

    Attributes:
        cause: Its name in `CAUSES`.
        explained: Fraction of the mismatch that the correction removes, 0 to 1.
        values: Values of the format strings of the cause; numbers are evidence.
    """

    cause: str
    explained: float
    values: Mapping[str, Value] = field(default_factory=dict)


@dataclass(frozen=True)
class Examined:
    """A test and its results.

    Attributes:
        test: Name of the test.
        scores: Statistics by name.
        seen: Detected causes.
        why_not: Reason why the test is not applicable; "" if it is.
    """

    test: str
    scores: Mapping[str, float] = field(default_factory=dict)
    seen: tuple[Seen, ...] = ()
    why_not: str = ""
