"""Counts of dropped states by reason."""

from __future__ import annotations

from collections.abc import Mapping

# Reasons for dropping what is no state of its own; coverage does not count it.
NO_STATE = (
    "duplicate_stamp",
    "lone_stamp",
    "not_finite",
    "undecodable",
    "zero_quaternion",
    "zero_stamp",
)


def count_up(counts: dict[str, int], reason: str, count: int) -> None:
    """Add to the count of a reason; a count of zero adds no key."""
    if count:
        counts[reason] = counts.get(reason, 0) + count


def add_counts(*counts: Mapping[str, int]) -> dict[str, int]:
    """Return the sums of counts by reason, without zeros."""
    total: dict[str, int] = {}
    for part in counts:
        for reason, count in part.items():
            count_up(total, reason, count)
    return total
