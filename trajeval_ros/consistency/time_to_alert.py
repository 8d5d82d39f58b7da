"""How long a user is misled: from an error beyond the alert limit until something says so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS


@dataclass(frozen=True)
class TimeToAlert:
    """Times from the start of each episode of errors beyond the alert limit to an alert.

    Attributes:
        seconds: Of the episodes that were alerted; negative where the alert came first.
        missed: How many episodes ended without one.
    """

    seconds: tuple[float, ...]
    missed: int

    @property
    def median(self) -> float | None:
        """Median of the episodes that were alerted; None if there is none."""
        return float(np.median(self.seconds)) if self.seconds else None

    @property
    def worst(self) -> float | None:
        """The longest of them; None if there is none."""
        return max(self.seconds, default=None)


def times_to_alert(
    stamps: Stamps,
    errors: Floats,
    levels: Floats,
    limit: float,
    warnings: Sequence[tuple[int, int]] = (),
) -> TimeToAlert:
    """Return how long after each start of errors beyond a limit there was an alert.

    An alert is a protection level beyond the limit, or a warning from elsewhere. One that stands
    when the errors start counts from its own start on.

    Args:
        stamps: (N,), ns, rising.
        errors: (N,), sizes.
        levels: (N,), protection levels.
        limit: What the user can bear, in their unit.
        warnings: First and last stamps of warnings from elsewhere, ns.
    """
    alerts = np.array([*_spans(stamps, levels > limit), *warnings], np.int64).reshape(-1, 2)
    found = []
    missed = 0
    for begin, end in _spans(stamps, errors > limit):
        during = (alerts[:, 0] <= end) & (alerts[:, 1] >= begin)
        if during.any():
            found.append(int(alerts[during, 0].min() - begin) / NANOSECONDS)
        else:
            missed += 1
    return TimeToAlert(tuple(found), missed)


def _spans(stamps: Stamps, holds: Booleans) -> list[tuple[int, int]]:
    """Return the first and the last stamp of each time that something held without a break."""
    edges = np.diff(holds.astype(np.int8), prepend=0, append=0)
    begins, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    return list(zip(stamps[begins].tolist(), stamps[ends].tolist(), strict=True))
