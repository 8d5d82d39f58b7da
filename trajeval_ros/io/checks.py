"""Checks of names, timestamps and quaternions, shared by all readers."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Remark, note
from trajeval_ros.geometry.arrays import Booleans, Floats

_UNIT_TOLERANCE = 0.01  # of a quaternion's length; rounded decimals deviate less
_EPOCH = 10**17  # ns; larger timestamps count from 1970, where zero means "not set"
_MOST_NAMES = 12  # listed in a message


def nearest(name: str, names: Collection[str]) -> str:
    """Return up to `_MOST_NAMES` existing names as text, the most similar to `name` first."""
    near = difflib.get_close_matches(name, sorted(names), n=_MOST_NAMES, cutoff=0.0)
    more = f" and {len(names) - len(near)} more" if len(names) > len(near) else ""
    return ", ".join(near) + more if near else "none"


def require_known(
    given: Iterable[str], known: Iterable[str], where: str, what: str = "key"
) -> None:
    """Check that all names are valid."""
    known = list(known)
    for name in given:
        if name not in known:
            near = difflib.get_close_matches(str(name), known, n=1, cutoff=0.65)
            hint = f"did you mean {near[0]}?" if near else f"use one of {', '.join(known)}"
            raise InputError(f"{where} has an unknown {what} {name!r}; {hint}")


def check_stamps(stamps: NDArray[np.int64], where: str) -> Booleans:
    """Return the mask (N,) of valid timestamps, as `times` does.

    `stamps`: (N,), nanoseconds.
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
    """Return the mask (N,) of valid timestamps, given in nanoseconds (N,).

    If the median timestamp counts from 1970, a zero is not valid.
    """
    if len(stamps) and np.median(stamps) > _EPOCH:
        return np.asarray(stamps != 0)
    return np.ones(len(stamps), dtype=bool)


def check_rotations(quaternions: Floats | None) -> tuple[Floats | None, tuple[Remark, ...]]:
    """Return the quaternions (N, 4), xyzw, and remarks on them.

    The quaternions are None if the input is None, all zeros, or the identity everywhere. They are
    returned as given: the remark reports quaternions that are not of unit length.
    """
    if quaternions is None:
        return None, (note("no_rotations", "no rotations: rotation metrics withheld"),)
    if len(quaternions) > 1 and not quaternions[:, :3].any():
        value = "are the identity" if quaternions.any() else "have zero quaternions"
        text = f"all rotations {value}: rotation metrics withheld"
        return None, (note("identity_rotations", text),)
    squares = np.einsum("ni,ni->n", quaternions, quaternions)
    odd = (np.abs(squares - 1.0) > 2.0 * _UNIT_TOLERANCE) & (squares > 1e-12)
    if not odd.any():
        return quaternions, ()
    lengths = np.sqrt(squares[odd])
    worst = float(lengths[np.abs(lengths - 1.0).argmax()])
    text = (
        f"{counted(len(lengths), 'quaternion')} normalised, largest deviation: length {worst:.3g}"
    )
    return quaternions, (note("normalised", text),)
