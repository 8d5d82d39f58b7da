"""What every reader checks before it calls its columns a trajectory."""

from __future__ import annotations

import difflib
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.arrays import Booleans, Floats

_UNIT_TOLERANCE = 0.01  # of a quaternion's length; files with few decimals stay within
_EPOCH = 10**17  # ns: stamps above are times since 1970, among which a zero is no time
_MOST_NAMES = 12  # in one sentence


def nearest(wanted: str, names: Collection[str]) -> str:
    """Return the names that exist, those that resemble the wanted one first."""
    near = difflib.get_close_matches(wanted, sorted(names), n=_MOST_NAMES, cutoff=0.0)
    more = f" and {len(names) - len(near)} more" if len(names) > len(near) else ""
    return ", ".join(near) + more if near else "none"


def check_stamps(stamps: NDArray[np.int64], where: str) -> Booleans:
    """Return which of the stamps (N,) are times, as `times` does.

    Raises:
        InputError: All are zero, or all are the same.
    """
    if len(stamps) and not stamps.any():
        raise InputError(f"{where}: all timestamps are zero; record the time of every measurement")
    if len(stamps) > 1 and (stamps == stamps[0]).all():
        raise InputError(
            f"{where}: all timestamps ({len(stamps)}) are equal; record the time of every "
            "measurement"
        )
    return times(stamps)


def times(stamps: NDArray[np.int64]) -> Booleans:
    """Return which of the stamps (N,) are times: a zero among times since 1970 is none."""
    if len(stamps) and np.median(stamps) > _EPOCH:
        return np.asarray(stamps != 0)
    return np.ones(len(stamps), dtype=bool)


def judge_rotations(
    quaternions: Floats | None,
) -> tuple[Floats | None, tuple[str, ...]]:
    """Return the quaternions (N, 4), xyzw, if they say anything, and what to tell about them."""
    if quaternions is None:
        return None, ("no rotations: rotation metrics withheld",)
    if len(quaternions) > 1 and not quaternions[:, :3].any():
        return None, ("all rotations are identity: rotation metrics withheld",)
    squares = np.einsum("ni,ni->n", quaternions, quaternions)
    odd = (np.abs(squares - 1.0) > 2.0 * _UNIT_TOLERANCE) & (squares > 1e-12)
    if not odd.any():
        return quaternions, ()
    lengths = np.sqrt(squares[odd])
    worst = float(lengths[np.abs(lengths - 1.0).argmax()])
    note = (
        f"{counted(len(lengths), 'quaternion')} normalised, largest deviation: length {worst:.3g}"
    )
    return quaternions, (note,)
