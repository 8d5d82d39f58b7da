"""Reading of a trajectory from a file of text, JSON or numpy, recognised from the content."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError, SettingsError, TrajevalError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import note, warning
from trajeval_ros.geometry.source_info import ASSUMED_COLUMNS, FORMAT, NAMED_COLUMNS, SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.checks import check_rotations, check_stamps
from trajeval_ros.io.text.hints import NO_HINTS, TextHints
from trajeval_ros.io.text.layouts import fits
from trajeval_ros.io.text.lines import HEAD, Advance, head_of
from trajeval_ros.io.text.names import (
    AS_NAMED,
    FRAME,
    FRAME_1,
    IGNORED,
    PARTS,
    RECEIVED,
    Layout,
    layout_of,
)
from trajeval_ros.io.text.numpy_files import load, rows_of
from trajeval_ros.io.text.pose_records import rewritten
from trajeval_ros.io.text.recognise import (
    check_comments,
    check_heights,
    layout_of_table,
    with_dates,
)
from trajeval_ros.io.text.sniff import sniff
from trajeval_ros.io.text.stamps import is_clock
from trajeval_ros.io.text.states import states_of
from trajeval_ros.io.text.table import Rows, TextTable, read_rows
from trajeval_ros.io.text.times import part_of_times, receive_times_of, times_of, with_times


def read_text(
    path: Path,
    advance: Advance | None = None,
    hints: TextHints = NO_HINTS,
    beside: Path | None = None,
) -> Trajectory:
    """Read the trajectory in a file.

    `advance`: progress callback, called with the number of bytes done and their total. `hints`:
    columns and frame rate, as the user states them. `beside`: original of `path` if that is a
    copy. Files with timestamps are next to the original. By default `path`.

    Raises:
        InputError: A file is refused; the message states where, why, and what to do.
    """
    origin = path if beside is None else beside
    try:
        return _read(path, origin, advance, hints)
    except (InputError, SettingsError) as error:
        message = hints.in_message(str(error))
        named = str(path) in message or isinstance(error, SettingsError)
        joint = ", " if message.startswith("line ") else ": "
        raise type(error)(message if named else f"{path}{joint}{message}") from None
    except OverflowError:
        raise InputError(
            f"{path}: a time or a frame number is out of range; correct or remove it"
        ) from None
    except (TrajevalError, OSError):
        raise
    except Exception as error:  # numpy, zipfile, YAML and JSON have types of their own
        raise InputError(
            f"{path} can't be read by the reader of text "
            f"({type(error).__name__}: {str(error)[:100]}); check the file"
        ) from error


def layout_in(path: Path) -> Layout:
    """Return the layout of a file of text, from its first lines.

    Raises:
        InputError: It has none.
    """
    table, layout = _recognised(path, ())
    return with_dates(table, layout)


def array_trajectory(array: NDArray[np.generic], name: str) -> Trajectory:
    """Return the trajectory in an array as in a .npy file; `name` is its name in messages."""
    if array.dtype.kind not in "fiu":
        raise InputError(f"the {name} is an array of {array.dtype}; give numbers")
    try:
        return trajectory_of(Path(name), *rows_of(Path(name), array), NO_HINTS, None)
    except InputError as error:
        problem, _, option = str(error).partition("{option}")
        if option:  # arguments say it in Python
            problem = f"{problem.rpartition(';')[0]}; pass columns to Trajectory.from_positions"
        raise InputError(problem) from None


def _read(path: Path, origin: Path, advance: Advance | None, hints: TextHints) -> Trajectory:
    beginning = b""
    if path.is_file():
        with path.open("rb") as file:
            beginning = file.read(HEAD)
    if b"GGA," in beginning:
        from trajeval_ros.io.text.geographic import has_gga, read_nmea

        if has_gga(beginning):
            return read_nmea(path)
    is_zip = beginning.startswith(b"PK\x03\x04") and b".npy" in beginning
    if is_zip or beginning.startswith(b"\x93NUMPY"):
        array, times = load(path)
        layout, rows = rows_of(path, array, layout_of(hints.columns) if hints.columns else None)
        if layout.time is None and hints.frame_rate_hz is None:
            layout, rows = with_times(layout, rows, origin, times)
        return trajectory_of(path, layout, rows, hints, origin)
    table, layout = _recognised(path, hints.columns)
    layout = with_dates(table, layout)
    rows = read_rows(table, layout, advance)
    if not hints.columns:
        check_comments(table, layout)
        check_heights(layout, rows)
    return trajectory_of(path, layout, rows, hints, origin, table.left_out)


def _recognised(path: Path, columns: tuple[str, ...]) -> tuple[TextTable, Layout]:
    """Return the table in a file and its layout; `columns`: names by the user, or ()."""
    head = ([], True) if path.is_dir() else head_of(path)
    records = rewritten(path, head[0])
    if path.is_dir() and records is None:
        raise InputError(f"{path} is a directory without a bag or poses; give a file")
    known = None if records is None else records.layout
    if known is not None and columns and len(columns) != len(known.columns):
        raise InputError(
            f"{path} is read as {known.name} ({' '.join(known.columns)}); remove {{option}}"
        )
    table = sniff(path, columns or (known.columns if known else ()), records, head)
    if not columns:
        if known is None:
            return table, layout_of_table(table)
        if known.name != "g2o" and not fits(table, known):
            raise InputError(
                f"{path} looks like {known.name}, but its numbers do not; check the file"
            )
        return table, known
    layout = layout_of((*columns, *(IGNORED,) * (table.columns - len(columns))))
    if known is not None:
        layout = dataclasses.replace(layout, up=known.up, inverse=known.inverse)
    for at in range(len(columns), table.columns):
        if layout.time is None and is_clock(table.values[:, at]):
            named = " ".join(layout.columns[:at])
            raise InputError(
                f"column {at + 1} has no name and may be the time: "
                f"{', '.join(row[at] for row in table.sample[:3])} ...; use "
                f"{{option}} '{named} t', or {{option}} '{named} _' to ignore it"
            )
    return table, layout


def trajectory_of(
    path: Path,
    layout: Layout,
    rows: Rows,
    hints: TextHints,
    origin: Path | None,
    left_out: Mapping[str, int] = MappingProxyType({}),
) -> Trajectory:
    """Return the trajectory in the rows of a file; `origin`: times are next to it.

    `left_out`: numbers of records that are no rows, by reason.
    """
    times = times_of(path, layout, rows, hints.frame_rate_hz, origin)
    count, stamps = rows.count, times.stamps
    if times.kept is not None:
        rows = rows.where(times.kept)
    groups, has_times = rows.groups, times.stamped and len(stamps) > 0
    for part in PARTS:
        if part in groups and has_times:
            stamps = stamps + part_of_times(path, groups[part][:, 0], part)
    if has_times:
        check_stamps(stamps, str(path))
    code = NAMED_COLUMNS if layout.name == AS_NAMED else FORMAT
    reading = SourceInfo(
        columns=layout.named(times.name),
        stamped=times.stamped,
        numbered=times.numbered or layout.time_name in (FRAME, FRAME_1),
        dropped={"not_finite": count - len(stamps), **left_out},
        remarks=(
            note(code, f"format: {layout.name}"),
            *([note("layout", layout.note)] if layout.note else ()),
            *([warning(ASSUMED_COLUMNS, hints.in_message(layout.doubt))] if layout.doubt else ()),
            *(
                dataclasses.replace(remark, text=hints.in_message(remark.text))
                for remark in times.remarks
            ),
        ),
    )
    if layout.is_geographic:
        from trajeval_ros.io.text.geographic import fixes_of

        return fixes_of(path, stamps, groups, reading)
    receive_times = None
    if RECEIVED in rows.texts and has_times:
        receive_times = receive_times_of(path, stamps, rows.texts[RECEIVED])
    states = states_of(path, layout, groups, len(stamps))
    quaternions, judgement = check_rotations(states.quaternions)
    trajectory = Trajectory.from_columns(
        stamps, states.positions, quaternions, velocities=states.velocities,
        gyroscope_biases=groups.get("gyroscope_bias"),
        accelerometer_biases=groups.get("accelerometer_bias"),
        covariances=None if quaternions is None else states.covariances,
        up=layout.up, name=path.stem,
        reading=dataclasses.replace(
            reading.remarked(*judgement, *states.remarks), frame_numbers=times.frames,
            matrices=states.matrices, receive_times=receive_times,
        ),
    )  # fmt: skip
    if not len(trajectory):
        raise InputError(
            f"{path}: no valid pose in {counted(count, 'row')} (NaN, zero quaternions, "
            "or positions beyond the limit)"
        )
    return trajectory
