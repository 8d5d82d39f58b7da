"""Reading of trajectories from text files: TUM, KITTI, EuRoC/ASL, OpenVINS, GNSS fixes, others."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from io import FileIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Remark, note
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.reading import FORMAT, NAMED_COLUMNS, Reading
from trajeval_ros.geometry.receptions import Receptions
from trajeval_ros.geometry.trajectory import NANOSECONDS, Trajectory
from trajeval_ros.io.checks import check_stamps, judge_rotations
from trajeval_ros.io.growing_rows import GrowingRows
from trajeval_ros.io.text.decimals import ParsedRows, RowFormat, parse_rows
from trajeval_ros.io.text.geographic import fixes_of, read_nmea
from trajeval_ros.io.text.head import COMMENT, TextFormat, holds_nmea, read_head, recognise_text
from trajeval_ros.io.text.layouts import (
    AS_NAMED,
    DATE,
    FRAME,
    NANOSEC,
    NO_HINTS,
    RECEIVED,
    UNITS,
    Layout,
    TextHints,
)
from trajeval_ros.io.text.number_tables import array_table, files_of_times, read_table
from trajeval_ros.io.text.stamps import ExactNumbers, to_nanoseconds
from trajeval_ros.io.text.states import FileColumns, states_of
from trajeval_ros.io.text.tokens import RowError

ROW_TIMES = "row_times"  # code of the remark on a frame rate that was used
Advance = Callable[[int, int], None]

# Bytes that are allocated and freed once. After that, glibc's malloc keeps as much memory for the
# next block. Otherwise it returns the arrays of every block to the kernel, which takes as long as
# parsing.
_WORKING_MEMORY = 16 << 20
_FRAMES = 10**8  # limit of frame numbers
# Layouts whose first column can count the frames of an image sequence.
_NUMBERED = ("TUM", "numpy (N, 7)", AS_NAMED)
_BLOCK = 1 << 19  # bytes that are parsed at once; their arrays fit into the processor's cache


def read_text(
    path: Path,
    advance: Advance | None = None,
    hints: TextHints = NO_HINTS,
    beside: Path | None = None,
) -> Trajectory:
    """Read a trajectory from a file of text, JSON lines or numpy, recognised from the content.

    `advance`: progress callback, called with the number of bytes done and their total. `hints`:
    columns and frame rate, as the user states them. `beside`: original of `path` if that is a
    copy. Files with timestamps are next to the original. By default `path`.
    """
    origin = path if beside is None else beside
    table = read_table(path, origin, hints)
    if table is not None:
        return trajectory_of(origin, *table, hints, origin)
    if holds_nmea(path):
        return read_nmea(path)
    text = recognise_text(path, hints.columns)
    return trajectory_of(path, text.layout, _read_columns(path, text, advance), hints, origin)


def trajectory_of(
    path: Path,
    layout: Layout,
    columns: FileColumns,
    hints: TextHints = NO_HINTS,
    origin: Path | None = None,
) -> Trajectory:
    """Return the trajectory in the columns of a file.

    `path`: named in messages. `origin`: the file next to which files with times are; None to
    search for none.
    """
    if origin is not None and _counts_frames(layout, columns, origin):
        renamed = (FRAME if each == "t" else each for each in layout.columns)
        layout = dataclasses.replace(layout, columns=tuple(renamed))
    frames = _frames_of(path, layout, columns)
    stamps, stamped, timing = _stamps_of(path, layout, columns, frames, hints, origin)
    if stamped:
        check_stamps(stamps, str(path))
    named = NAMED_COLUMNS if layout.name == AS_NAMED else FORMAT
    remarks = [note(named, f"format: {layout.name}")]
    if layout.note:
        remarks.append(note("layout", layout.note))
    reading = Reading(
        stamped=stamped,
        numbered=layout.time_name == FRAME,
        dropped={"not_finite": columns.untimed},
        remarks=(*remarks, *timing),
    )
    if layout.is_geographic:
        return fixes_of(path, stamps, columns.groups, reading)
    states = states_of(path, layout, columns.groups, columns.count)
    quaternions, judgement = judge_rotations(states.quaternions)
    trajectory = Trajectory.from_columns(
        stamps,
        states.positions,
        quaternions,
        velocities=states.velocities,
        gyroscope_biases=columns.groups.get("gyroscope_bias"),
        accelerometer_biases=columns.groups.get("accelerometer_bias"),
        covariances=None if quaternions is None else states.covariances,
        up=layout.up,
        name=path.stem,
        reading=dataclasses.replace(
            reading.remarked(*judgement, *states.remarks),
            frame_numbers=frames,
            matrices=states.matrices,
            receptions=_receptions(stamps, columns.groups) if stamped else None,
        ),
    )
    if not len(trajectory):
        count = columns.untimed + len(stamps)
        raise InputError(
            f"{path}: no valid pose in {counted(count, 'row')} (NaN, zero quaternions, or "
            "positions beyond the limit)"
        )
    return trajectory


def array_trajectory(array: NDArray[np.generic], name: str) -> Trajectory:
    """Return the trajectory in an array as in a .npy file; `name` is its name in messages."""
    if array.dtype.kind not in "fiu":
        raise InputError(f"the {name} is an array of {array.dtype}; give numbers")
    return trajectory_of(Path(name), *array_table(array, Path(name)))


def _read_columns(path: Path, text: TextFormat, advance: Advance | None) -> FileColumns:
    """Read all rows of a file by blocks."""
    total = path.stat().st_size
    values_at = _values_of(text.layout)
    picks = {
        group: [values_at.index(at) for at in places]
        for group, places in text.layout.groups.items()
    }
    groups = {group: GrowingRows() for group in picks}
    stamps: list[ExactNumbers] = []
    count = untimed = 0
    for end, rows in _parse_blocks(path, text):
        values = rows.values
        if rows.stamps is not None:
            every = bool(rows.timed.all())
            stamps.append(rows.stamps if every else rows.stamps[rows.timed])
            values = values if every else values[rows.timed]
            untimed += len(rows.timed) - len(values)
        for group, pick in picks.items():
            groups[group].extend(values[:, pick])
        count += len(values)
        if advance is not None:
            advance(end, total)
    return FileColumns(
        ExactNumbers.concatenate(stamps) if stamps else None,
        {group: column.done() for group, column in groups.items()},
        count,
        untimed,
    )


def _values_of(layout: Layout) -> tuple[int, ...]:
    """Return the indices of the columns that are read as numbers, in increasing order."""
    return tuple(sorted({place for places in layout.groups.values() for place in places}))


def _parse_blocks(path: Path, text: TextFormat) -> Iterator[tuple[int, ParsedRows]]:
    """Yield (offset of the end in bytes, rows) for every block of complete lines of a file."""
    layout, done = text.layout, text.start
    row_format = RowFormat(
        columns=len(layout.columns),
        time=layout.time,
        values=_values_of(layout),
        separator=layout.separator,
        dates=layout.time_name == DATE,
        names=layout.columns,
    )
    np.empty(_WORKING_MEMORY, dtype=np.uint8)
    with path.open("rb", buffering=0) as file:
        file.seek(text.start)
        for block in _line_blocks(path, file):
            size = len(block)
            try:
                if text.no_row is not COMMENT or b"#" in block or b"%" in block:
                    block = text.no_row.sub(b"", block)
                rows = parse_rows(block, row_format)
            except RowError as error:
                line = _lines_before(path, done) + error.line + 1
                raise InputError(
                    f"{path}, line {line}: {error.reason}; correct or remove the line"
                ) from None
            done += size
            yield done, rows


def _line_blocks(path: Path, file: FileIO) -> Iterator[bytes]:
    """Yield the rest of a file in blocks of complete lines."""
    rest = b""
    while part := file.read(_BLOCK):
        end = part.rfind(b"\n") + 1
        if end:
            yield rest + part[:end]
            rest = part[end:]
        else:
            rest += part
        if len(rest) > _BLOCK:
            raise InputError(f"{path} is not a trajectory: a line has more than {_BLOCK} bytes")
    if rest:
        yield rest


def _lines_before(path: Path, offset: int) -> int:
    """Return the number of lines of a file that end before an offset in bytes."""
    with path.open("rb") as file:
        return sum(
            file.read(min(_BLOCK, offset - at)).count(b"\n") for at in range(0, offset, _BLOCK)
        )


def _frames_of(path: Path, layout: Layout, rows: FileColumns) -> NDArray[np.int64] | None:
    """Return the frame numbers (N,); None if the rows have timestamps."""
    if rows.stamps is None:
        return np.arange(rows.count)
    if layout.time_name != FRAME:
        return None
    wrong = rows.stamps.negative | (rows.stamps.billionths > 0) | (rows.stamps.whole >= _FRAMES)
    if wrong.any():
        assert layout.time is not None
        raise InputError(
            f"{path}: row {int(np.argmax(wrong)) + 1} has no frame number in column "
            f"{layout.time + 1}; correct or remove the row"
        )
    return rows.stamps.whole.astype(np.int64)


def _stamps_of(
    path: Path,
    layout: Layout,
    rows: FileColumns,
    frames: NDArray[np.int64] | None,
    hints: TextHints,
    origin: Path | None,
) -> tuple[NDArray[np.int64], bool, list[Remark]]:
    """Return timestamps (N,) in nanoseconds, whether they are times, and remarks on them."""
    if frames is None:
        assert rows.stamps is not None
        if not rows.count:
            return np.zeros(0, dtype=np.int64), True, []
        try:
            stamps, in_nanoseconds = to_nanoseconds(
                rows.stamps, UNITS[layout.time_name], far_apart_is_ns=layout.separator == ","
            )
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        if NANOSEC in rows.groups:
            stamps = stamps + _nanosecond_parts(path, rows.groups[NANOSEC][:, 0])
        if in_nanoseconds:
            return stamps, True, [note("nanoseconds", "timestamps are in nanoseconds")]
        is_date = layout.time_name == DATE
        return stamps, True, [note("dates", "dates read as UTC")] if is_date else []
    remarks = []
    for times_path in () if origin is None else files_of_times(origin, is_text=True):
        if "matrix" not in layout.groups and layout.name not in _NUMBERED:
            continue
        times = _read_times(times_path)
        matches = (
            frames.max(initial=0) < len(times)
            if layout.time_name == FRAME
            else len(times) == rows.count
        )
        if matches:
            return times[frames], True, [note("times_file", f"timestamps read from {times_path}")]
        said = (
            f"{times_path} ignored: it has {counted(len(times), 'row')} for "
            f"{counted(rows.count, 'pose')}"
        )
        remarks.append(note("times_file_ignored", said))
    rate = hints.frame_rate_hz
    if rate is not None:
        stamps = np.round(frames * (NANOSECONDS / rate)).astype(np.int64)
        return stamps, True, [*remarks, note(ROW_TIMES, f"timestamps counted at {rate:g} Hz")]
    said = "no timestamps: frames counted, 1 s apart; set their rate with --frame-rate"
    return frames * NANOSECONDS, False, [*remarks, note("no_timestamps", said)]


def _nanosecond_parts(path: Path, column: Floats) -> NDArray[np.int64]:
    """Return the nanoseconds (N,) of timestamps in two columns; float64 has them exactly."""
    right = (column >= 0.0) & (column < NANOSECONDS) & (column == np.round(column))
    if not right.all():
        row = int(np.argmin(right))
        raise InputError(
            f"{path}: row {row + 1} has {column[row]:g} nanoseconds after its seconds, expected "
            "0 to 999999999; correct or remove the row"
        )
    return column.astype(np.int64)


def _counts_frames(layout: Layout, rows: FileColumns, origin: Path) -> bool:
    """Return whether a first column of whole numbers in equal steps counts frames.

    It does so if a file with the times of the frames is next to the file, as for VGGT-SLAM.
    """
    if layout.time_name != "t" or layout.name not in _NUMBERED or rows.stamps is None:
        return False
    whole = rows.stamps.whole
    steps = np.diff(whole.astype(np.int64))
    is_counted = (
        not rows.stamps.billionths.any() and len(steps) > 0 and 0 < steps.min() == steps.max()
    )
    return is_counted and int(whole.max()) < _FRAMES and bool(files_of_times(origin, is_text=True))


def _receptions(stamps: NDArray[np.int64], groups: Mapping[str, Floats]) -> Receptions | None:
    """Return the times in the column `received`, if there is one, to a microsecond.

    They are in a unit of timestamps: the one in which they are nearest to the timestamps (N,). As
    float64, times since 1970 have errors of 0.1 us.
    """
    if RECEIVED not in groups or not len(stamps):
        return None
    column = groups[RECEIVED][:, 0]
    known = np.isfinite(column)
    if not known.all():
        raise InputError(
            f"row {int(np.argmin(known)) + 1} has no number in column {RECEIVED}; correct or "
            "remove the row"
        )
    units = [unit for unit in UNITS.values() if unit is not None]
    apart = [np.abs(np.median(column * unit - stamps)) for unit in units]
    unit = units[int(np.argmin(apart))]
    if (np.abs(column) * unit >= 2.0**63).any():
        raise InputError(f"column {RECEIVED} has times after the year 2262; correct it")
    return Receptions(np.round(column * (unit / 1000)).astype(np.int64) * 1000)


def _read_times(path: Path) -> NDArray[np.int64]:
    """Return the timestamps (N,), nanoseconds, of a file with one time per line."""
    head = read_head(path)
    if len(head.sample[0]) != 1:
        raise InputError(
            f"{path} has {counted(len(head.sample[0]), 'column')}, expected one time per line"
        )
    stamps = _read_columns(path, TextFormat(Layout("times", ("t",)), head.start), None).stamps
    assert stamps is not None
    return to_nanoseconds(stamps)[0]
