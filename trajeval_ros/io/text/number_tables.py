"""Tables without a text layout: arrays of numpy (.npy) and JSON lines.

Layouts of numpy are those of DROID-SLAM (N, 7), DPVO (N, 7) and KISS-ICP (N, 4, 4); JSON lines are
those of Spectacular AI. No vertical axis is assumed except z. Poses of the world in the camera are
not detected here: the diagnosis names them.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry.array_input import require_poses
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.io.text.header_names import from_header
from trajeval_ros.io.text.layouts import EXAMPLE, FRAME, NO_HINTS, Layout, TextHints, layout_of
from trajeval_ros.io.text.stamps import ExactNumbers
from trajeval_ros.io.text.states import FileColumns

Table = tuple[Layout, FileColumns]

_NUMPY, _JSON = b"\x93NUMPY", b"{"
_MATRIX = " ".join(f"m{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3, 4))
_POSE = "x y z qx qy qz qw"
# FileColumns by the shape of a row.
_LAYOUTS = {
    (4, 4): f"{_MATRIX} _ _ _ _",
    (16,): f"{_MATRIX} _ _ _ _",
    (3, 4): _MATRIX,
    (12,): _MATRIX,
    (8,): f"t {_POSE}",
    (7,): _POSE,
    (4,): "t x y z",
    (3,): "x y z",
}
_SHAPES = "(N, 4, 4), (N, 3, 4), (N, 16), (N, 12), (N, 8), (N, 7), (N, 4) and (N, 3)"
_UNIT = 1e-2  # largest deviation of a quaternion's length
_TIMES = ("tstamps", "timestamps", "times")
_FRAMES = 1e7  # limit of frame numbers
_STATUS = ("status", "trackingStatus")
_TRACKING = "TRACKING"


def read_table(path: Path, origin: Path, hints: TextHints) -> Table | None:
    """Return the layout and the columns of a file of numpy or of JSON lines, else None.

    `origin`: original of `path` if that is a copy; files with times are next to it.
    """
    with path.open("rb") as file:
        beginning = file.read(len(_NUMPY))
    if beginning == _NUMPY:
        layout, rows = _rows(_loaded(path), origin, hints)
        if layout.time is None and hints.frame_rate_hz is None:
            layout, rows = _with_times(layout, rows, origin)
        return layout, _columns(layout, rows)
    if beginning.lstrip().startswith(_JSON):
        return _of_json_lines(path, hints)
    return None


def _loaded(path: Path) -> Any:
    try:
        array = np.load(path, allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise InputError(f"{path} is not a readable array of numpy ({error})") from error
    if array.dtype.kind not in "fiu":
        raise InputError(f"{path} has values of type {array.dtype}; save an array of numbers")
    return array


def array_table(array: Any, path: Path) -> Table:
    """Return the layout and the columns of an array, which messages name `path`.

    Raises:
        InputError: Its shape is unknown, or its rows are no poses.
    """
    layout, rows = _rows(array, path)
    return layout, _columns(layout, rows)


def _rows(array: Any, path: Path, hints: TextHints = NO_HINTS) -> tuple[Layout, Floats]:
    """Return the layout of an array, and its rows (N, C)."""
    if array.ndim < 2 or not len(array):
        raise InputError(f"{path} has shape {array.shape}; supported: {_SHAPES}")
    rows = array.reshape(len(array), -1).astype(np.float64)
    if hints.columns:
        layout = layout_of(hints.columns)
        if len(layout.columns) != rows.shape[1]:
            raise InputError(
                f"{path} has shape {array.shape}, and --columns names "
                f"{counted(len(layout.columns), 'column')}; name all"
            )
    else:
        names = _LAYOUTS.get(array.shape[1:])
        if names is None:
            raise InputError(
                f"{path} has shape {array.shape}; supported: {_SHAPES}; for other columns, use "
                f"{EXAMPLE}"
            )
        title = ", ".join(["N", *map(str, array.shape[1:])])
        layout = Layout(f"numpy ({title})", tuple(names.split()))
        _check(path, layout, rows)
    if array.dtype == np.float32:
        layout = dataclasses.replace(layout, note="float32: 7 digits")
    return layout, rows


def _check(path: Path, layout: Layout, rows: Floats) -> None:
    """Refuse rows that are not the poses of their layout."""
    try:
        if "matrix" in layout.groups:
            require_poses(rows.reshape(len(rows), -1, 4))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    if "quaternion" not in layout.groups:
        return
    usable = rows[np.isfinite(rows).all(axis=1)]
    other = [0, 1, 2, 3] if layout.time is None else [1, 2, 3, 4]
    unit, first = (
        bool((np.abs(np.linalg.norm(usable[:, places], axis=1) - 1.0) < _UNIT).all())
        for places in (list(layout.groups["quaternion"]), other)
    )
    if not unit or first:
        raise InputError(
            f"{path}: it is unclear which of the {rows.shape[1]} columns are the quaternion; name "
            f"them, as in {EXAMPLE}"
        )


def files_of_times(path: Path, *, is_text: bool = False) -> list[Path]:
    """Return the files next to an array or a text that may have the times of its rows."""
    names = [f"{path.stem}_times.txt", "times.txt"]
    if path.suffix == ".npy" and not is_text:
        stems = [path.stem.replace("poses", word) for word in _TIMES if "poses" in path.stem]
        stems += [f"{path.stem}_{word}" for word in _TIMES] + list(_TIMES)
        names = [f"{stem}{suffix}" for stem in stems for suffix in (".npy", ".txt")]
    paths = [path.with_name(name) for name in names]
    return [each for each in paths if each.is_file() and each != path]


def _with_times(layout: Layout, rows: Floats, path: Path) -> tuple[Layout, Floats]:
    """Add the column of times, or of frame numbers, that a file next to the array has."""
    for beside in files_of_times(path):
        try:
            times = _loaded(beside) if beside.suffix == ".npy" else np.loadtxt(beside, ndmin=1)
        except ValueError as error:
            raise InputError(f"{beside} has no time per line ({error})") from error
        times = np.asarray(times, dtype=np.float64)
        if times.shape != (len(rows),):
            raise InputError(
                f"{beside} has shape {times.shape} for {counted(len(rows), 'pose')}; give one "
                "time per pose, or remove it"
            )
        is_number = (times == np.round(times)).all() and np.abs(times).max() < _FRAMES
        columns = (FRAME if is_number else "t", *layout.columns)
        said = "; ".join(filter(None, (layout.note, f"times read from {beside}")))
        layout = Layout(layout.name, columns, said)
        return layout, np.column_stack([times, rows])
    return layout, rows


def _columns(layout: Layout, rows: Floats) -> FileColumns:
    """Return the columns of rows (N, C); rows without a time are dropped."""
    stamps, untimed = None, 0
    if layout.time is not None:
        timed = np.isfinite(rows[:, layout.time])
        untimed = int(np.count_nonzero(~timed))
        rows = rows[timed]
        stamps = ExactNumbers.of_floats(rows[:, layout.time])
    groups = {
        name: np.ascontiguousarray(rows[:, list(places)]) for name, places in layout.groups.items()
    }
    return FileColumns(stamps, groups, len(rows), untimed)


def _of_json_lines(path: Path, hints: TextHints) -> Table:
    """Return the columns of one JSON object per line, named by its keys.

    Lines without a position, and lines whose status is the text of another state than tracking,
    such as LOST_TRACKING, are left out.
    """
    if hints.columns:
        raise InputError(f"{path} has JSON lines, whose keys name the columns; remove --columns")
    found: list[dict[str, float]] = []
    left_out = 0
    for number, line in enumerate(path.read_text("utf-8", "replace").splitlines(), 1):
        if not line.strip():
            continue
        try:
            record = json.loads(line)
        except ValueError:
            raise InputError(
                f"{path}, line {number}: no JSON object; write one object per line"
            ) from None
        status = [record.get(each) for each in _STATUS] if isinstance(record, dict) else []
        is_tracked = all(each.upper() == _TRACKING for each in status if isinstance(each, str))
        values = dict(_flat(record)) if is_tracked else {}
        if {"x", "y", "z"} <= {key.rpartition(".")[2] for key in values}:
            found.append(values)
        else:
            left_out += 1
    names = list(found[0]) if found else []
    layout = from_header(",".join(names), len(names)) if names else None
    if layout is None or layout.time is None:
        raise InputError(
            f"{path} has JSON lines without time and position; write keys such as time, "
            "position.x and orientation.w"
        )
    rows = np.array([[each.get(name, np.nan) for name in names] for each in found])
    said = f"{counted(left_out, 'line')} without a position or not tracking" if left_out else ""
    layout = Layout("JSON lines", layout.columns, said)
    return layout, _columns(layout, rows)


def _flat(record: object, before: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers of an object, with keys joined by dots."""
    if isinstance(record, Mapping):
        for key, value in record.items():
            yield from _flat(value, f"{before}.{key}" if before else str(key))
    elif isinstance(record, list):
        names = "xyzw" if len(record) in (3, 4) else map(str, range(len(record)))
        for key, value in zip(names, record, strict=False):
            yield from _flat(value, f"{before}.{key}")
    elif isinstance(record, int | float) and not isinstance(record, bool):
        yield before, float(record)
