"""Users' arrays as columns of a trajectory: shapes, times and rotation matrices."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps

_NANOSECONDS = 1_000_000_000
_ORTHONORMAL = 1e-3  # largest entry of R R^T - 1: rounded digits deviate less
_LAST_ROW = 1e-6
_LARGEST_S = 9.2e9  # int64 nanoseconds end in the year 2262
_LEAST_STEP_NS = 1e5  # mean step of timestamps; smaller ones are of another unit


def numbers(values: ArrayLike, what: str) -> Floats:
    """Return values as an array of float64.

    Raises:
        InputError: They are not numbers, or their rows have different lengths.
    """
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "fiu":
            raise TypeError(array.dtype)
        return np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{what} are not an array of real numbers; convert them") from None


def require_shape(array: Any, what: str, *shapes: tuple[int | None, ...]) -> None:
    """Check that an array has one of some shapes; None in a shape is any number.

    Raises:
        InputError: It has another shape.
    """
    for shape in shapes:
        if len(shape) == array.ndim and all(
            required in (None, length) for required, length in zip(shape, array.shape, strict=True)
        ):
            return
    required = " or ".join(map(str, shapes)).replace("None", "N")
    raise InputError(f"{what} have shape {array.shape}, expected {required}")


def stamps_of(seconds: ArrayLike | None, stamps: ArrayLike | None, count: int) -> Stamps | None:
    """Return the timestamps (N,) of N rows in nanoseconds; None if neither is given.

    `seconds`: (N,). `stamps`: (N,), nanoseconds.

    Raises:
        InputError: Both are given, a shape is wrong, or the numbers have another unit.
    """
    if seconds is None and stamps is None:
        return None
    if seconds is not None and stamps is not None:
        raise InputError("times are given twice; give either seconds= or stamps=")
    if stamps is not None:
        given = np.asarray(stamps)
        require_shape(given, "stamps", (count,))
        if given.dtype.kind not in "iu":
            raise InputError(
                f"timestamps of stamps= must be integer nanoseconds, not {given.dtype}; give "
                "times in seconds as seconds="
            )
        as_integers: Stamps = given.astype(np.int64)
        whole_ns = int(np.ptp(as_integers)) if count else 0
        if whole_ns < (count - 1) * _LEAST_STEP_NS:
            raise InputError(
                f"stamps= has {count} values within {whole_ns} ns, which are probably not "
                "nanoseconds; give times in seconds as seconds="
            )
        return as_integers
    times = numbers(seconds, "seconds") if seconds is not None else np.zeros(0)
    require_shape(times, "seconds", (count,))
    if not np.isfinite(times).all():
        raise InputError(
            f"seconds are not finite in row {int(np.argmin(np.isfinite(times)))}; remove the row"
        )
    if np.abs(times).max(initial=0.0) > _LARGEST_S:
        largest = np.abs(times).max()
        unit = "milli" if largest < 1e14 else "micro" if largest < 1e17 else "nano"
        raise InputError(
            f"seconds= has values up to {largest:.3g}, which are probably {unit}seconds; convert "
            "them to seconds, or give integer nanoseconds with stamps="
        )
    # In two parts: the product of a time since 1970 and 1e9 has no digits for nanoseconds.
    whole = np.floor(times)
    parts = np.round((times - whole) * _NANOSECONDS).astype(np.int64)
    return whole.astype(np.int64) * _NANOSECONDS + parts


def split_matrices(matrices: ArrayLike) -> tuple[Floats, Floats]:
    """Return positions (N, 3) and quaternions (N, 4) of pose matrices (N, 4, 4) or (N, 3, 4).

    Raises:
        InputError: The shape is wrong, or a matrix is not a pose.
    """
    array = numbers(matrices, "matrices")
    require_shape(array, "matrices", (None, 4, 4), (None, 3, 4))
    require_poses(array)
    return np.ascontiguousarray(array[:, :3, 3]), quaternions_of(array[:, :3, :3])


def require_poses(matrices: Floats) -> None:
    """Check the rotations, and the last rows, of matrices (N, 3 or 4, 4); rows of NaN are left.

    Raises:
        InputError: A matrix is not a pose; the message names the first one.
    """
    finite = np.asarray(np.isfinite(matrices).all(axis=(1, 2)))
    rotations = np.where(finite[:, None, None], matrices[:, :3, :3], np.eye(3))
    with np.errstate(over="ignore", invalid="ignore"):  # numbers may be of any size
        squares = rotations @ np.swapaxes(rotations, 1, 2) - np.eye(3)
        wrong = ~(np.abs(squares).max(axis=(1, 2), initial=0.0) < _ORTHONORMAL)
        wrong |= ~(np.linalg.det(rotations) > 0.0)
    if wrong.any():
        raise InputError(
            f"matrix {int(np.argmax(wrong))} has no rotation in its first 3 x 3 entries; give "
            "poses as [R t]"
        )
    if matrices.shape[1] == 4:
        apart = np.abs(matrices[finite, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1, initial=0.0)
        if (apart > _LAST_ROW).any():
            row = int(np.flatnonzero(finite)[np.argmax(apart > _LAST_ROW)])
            raise InputError(
                f"matrix {row} has the last row {matrices[row, 3].tolist()}, expected 0 0 0 1; "
                "transpose the matrices if they are in column order"
            )


def quaternions_of(rotations: Floats) -> Floats:
    """Return the quaternions (N, 4) of matrices (N, 3, 3); NaN if one is not a rotation."""
    valid = np.asarray(np.isfinite(rotations).all(axis=(1, 2)))
    valid[valid] = np.linalg.det(rotations[valid]) > 0.0
    quaternions = np.full((len(rotations), 4), np.nan)
    if valid.any():
        quaternions[valid] = lie.from_matrices(_nearest_rotations(rotations[valid]))
    return quaternions


def _nearest_rotations(matrices: Floats) -> Floats:
    """Return the rotations (N, 3, 3) nearest to matrices (N, 3, 3) with rounded digits.

    scipy also projects such matrices, but its result depends on the version: errors differ by up
    to 5e-7 of their value.
    """
    u, _, vt = np.linalg.svd(matrices)
    nearest: Floats = u @ vt
    return nearest


_TIMES = ("seconds", "stamps", "timestamps", "timestamp", "time", "t")


def columns_of_frame(frame: Any) -> dict[str, Any]:
    """Return the arguments of `Trajectory.from_positions` from a pandas.DataFrame.

    Raises:
        InputError: A column is missing.
    """
    names = {str(name).lower(): name for name in frame.columns}
    if not {"x", "y", "z"} <= names.keys():
        raise InputError(
            f"the table has the columns {', '.join(map(str, frame.columns))}; name the positions "
            "x, y and z"
        )
    places = frame[[names[item] for item in "xyz"]].to_numpy()
    rotations = None
    known = [names[item] for item in ("qx", "qy", "qz", "qw") if item in names]
    if known:
        if len(known) < 4:
            raise InputError(
                f"the table has only {', '.join(map(str, known))} of qx, qy, qz and qw; name all"
            )
        rotations = frame[known].to_numpy()
    time = next((names[item] for item in _TIMES if item in names), None)
    times = np.asarray(frame.index if time is None else frame[time])
    given: dict[str, Any] = {"positions": places, "quaternions": rotations}
    if times.dtype.kind == "M":
        given["stamps"] = times.astype("datetime64[ns]").astype(np.int64)
    elif times.dtype.kind in "iu" and (time is not None or np.abs(times).max(initial=0) > 1e12):
        given["stamps"] = times
    elif times.dtype.kind == "f":
        given["seconds"] = times
    return given
