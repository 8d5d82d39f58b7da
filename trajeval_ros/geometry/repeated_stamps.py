"""Repeated timestamps with contradicting positions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Floats

_STEPS = 3.0  # multiple of the median step that noise explains for a body nearly at rest


class Conflicts(NamedTuple):
    """States that share a timestamp with another state at a different position.

    Attributes:
        number: Number of such states.
        largest_m: Their largest distance from the first state of the timestamp, metres.
    """

    number: int
    largest_m: float


def conflicts_of(stamps: NDArray[np.int64], positions: Floats) -> Conflicts:
    """Compare states of equal timestamps with the first one of that timestamp.

    Rounded timestamps repeat, too, but their positions are between those of the neighbouring
    states. Positions conflict if they are farther apart than the neighbours are, and than three
    median steps, which allows for the noise of a body at rest.

    Args:
        stamps: (N,) sorted, nanoseconds.
        positions: (N, 3), metres.
    """
    is_first = np.concatenate([[True], np.diff(stamps) > 0])
    repeats = np.flatnonzero(~is_first)
    firsts = np.flatnonzero(is_first)
    if not len(repeats):
        return Conflicts(0, 0.0)
    distinct = positions[firsts]
    group = np.cumsum(is_first)[repeats] - 1
    apart_m = _lengths(positions[repeats] - distinct[group])
    before, after = np.maximum(group - 1, 0), np.minimum(group + 1, len(firsts) - 1)
    steps_m = _lengths(np.diff(distinct, axis=0))
    usual_m = float(np.median(steps_m)) if len(steps_m) else 0.0
    passed_m = _lengths(distinct[after] - distinct[before])
    conflict = apart_m > np.maximum(passed_m, _STEPS * usual_m)
    return Conflicts(int(np.count_nonzero(conflict)), float(apart_m[conflict].max(initial=0.0)))


def _lengths(vectors: Floats) -> Floats:
    # Positions that are not finite are refused later, where the states are used.
    with np.errstate(over="ignore", invalid="ignore"):
        lengths: Floats = np.sqrt(np.einsum("ni,ni->n", vectors, vectors))
    return lengths
