"""Merging of trajectories: separately recorded parts of a run as one."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.dropped_counts import add_counts
from trajeval_ros.geometry.trajectory import Trajectory

_ROWS = (
    "positions", "quaternions", "velocities", "gyroscope_biases", "accelerometer_biases",
    "covariances",
)  # fmt: skip


def merged(parts: Sequence[Trajectory]) -> Trajectory:
    """Return all states in order of time, with the columns that all parts have.

    Args:
        parts: Trajectories in one frame, with timestamps. Of equal timestamps, the state of the
            first part is kept.

    Raises:
        InputError: A part has no timestamps, or the names of frames differ.
    """
    first = parts[0]
    for part in parts:
        if not part.stamped:
            raise InputError(f"{part.name} has no timestamps, which --merge needs")
        for word in ("frame", "child_frame"):
            one, other = getattr(first, word), getattr(part, word)
            if one and other and one != other:
                raise InputError(
                    f"{first.name} and {part.name} can't be merged: their {word} differs, {one} "
                    f"and {other}"
                )
        if part.up.name != first.up.name:
            raise InputError(
                f"{first.name} and {part.name} can't be merged: the vertical axis is {first.up} "
                f"in one and {part.up} in the other; convert one with --world-axes first"
            )
    columns: dict[str, Any] = {}
    for name in _ROWS:
        available = [column for part in parts if (column := getattr(part, name)) is not None]
        columns[name] = np.concatenate(available) if len(available) == len(parts) else None
    return dataclasses.replace(
        first,
        stamps=np.concatenate([part.stamps for part in parts]),
        frames=None,
        matrices=None,
        fixes=None,
        dropped=add_counts(*(part.dropped for part in parts)),
        notes=(
            f"merged from {', '.join(part.name for part in parts)}",
            *dict.fromkeys(note for part in parts for note in part.notes),
        ),
        damage=tuple(dict.fromkeys(line for part in parts for line in part.damage)),
        conflicts=tuple(dict.fromkeys(line for part in parts for line in part.conflicts)),
        **columns,
    ).in_order()
