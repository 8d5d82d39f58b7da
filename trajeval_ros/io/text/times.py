"""Times of the rows of a file: of a column, of a file next to it, or by a frame rate."""

from __future__ import annotations

import contextlib
import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.formatting.remarks import Remark, note, warning
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.source_info import ASSUMED_COLUMNS, FRAMES_FROM_1, ReceiveTimes
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.io.text.header_patterns import name_and_unit, split_header
from trajeval_ros.io.text.names import (
    AS_NAMED,
    CLOCK,
    DATE,
    FRAME,
    FRAME_1,
    PARTS,
    RECEIVED,
    TIME_UNITS,
    UNITS,
    UNPADDED,
    WEEK,
    Layout,
)
from trajeval_ros.io.text.numpy_files import files_of_times, load
from trajeval_ros.io.text.sniff import sniff
from trajeval_ros.io.text.stamps import (
    SHORTEST_STEP_S,
    WIDTH,
    are_clock_digits,
    are_whole,
    dates,
    exact,
    likely_name,
    to_stamps,
    unit_of,
    unpadded,
)
from trajeval_ros.io.text.table import Rows, number, read_rows
from trajeval_ros.metrics.statistics import median

ROW_TIMES = "row_times"  # code of the remark on a frame rate that was used
_SAMPLE = 200  # rows that show the unit of the times
_LONGEST_USUAL_S = 10.0  # usual median step of seconds from zero
_LARGEST_FRAME = 1e7  # of an array next to poses; larger whole numbers are times
_FRAMES = 10**8  # limit of frame numbers, and of times that count from zero
_TIMES = Layout("times", ("t",))  # of a file next to the poses
# Names of columns of times and their units, as messages name them.
_WORDS = {
    "t_s": "seconds", "t_ms": "milliseconds", "t_us": "microseconds", "t_ns": "nanoseconds"
}  # fmt: skip
_NUMBERED = ("TUM", "numpy (N, 7)", AS_NAMED)  # layouts whose first column can count frames


@dataclass(frozen=True, eq=False)
class Times:
    """The times of the rows of a file."""

    stamps: Stamps  # (N,) nanoseconds
    frames: NDArray[np.int64] | None  # (N,) frame numbers, None if rows have timestamps
    stamped: bool  # whether `stamps` are times
    kept: NDArray[np.bool_] | None = None  # rows that have a time; None if all do
    remarks: tuple[Remark, ...] = ()
    numbered: bool = False  # whether a column counts frames
    name: str = ""  # name of the column of times, with its unit


def times_of(
    path: Path, layout: Layout, rows: Rows, rate: float | None, origin: Path | None
) -> Times:
    """Return the timestamps of rows, from their column or from a file next to it, or by a rate."""
    if layout.time is None:
        return _of_frames(layout, np.arange(rows.count), (), rate, origin)
    if layout.time_name == DATE:
        return _of_dates(path, rows)
    times: Any = rows.texts[layout.time_name]
    if layout.time_name in (FRAME, FRAME_1):
        return _of_frames(layout, *_frames(path, layout, times), rate, origin)
    if _may_count_frames(layout, origin):
        values = _floats(path, times)
        finite = np.isfinite(values)
        if _are_frames(values[finite]):
            frames = values[finite].astype(np.int64)
            numbered = _of_frames(layout, frames, (), rate, origin)
            return dataclasses.replace(numbered, kept=finite, numbered=True)
    kept = None
    try:
        sample = times[:_SAMPLE].astype(np.float64)
        if not np.isfinite(sample).all():
            raise ValueError
        unit = _unit(path, layout, sample)
        stamps = to_stamps(times, sample, unit)
    except (ValueError, OverflowError):  # a time is missing or out of range
        values = _floats(path, times)
        kept = np.isfinite(values)
        times = np.char.strip(times[kept]) if times.dtype.kind == "S" else times[kept]
        unit = _unit(path, layout, values[kept])
        stamps = to_stamps(times, values[kept], unit)
    if layout.time_name == UNPADDED:
        stamps = unpadded(times)
    elif layout.name != AS_NAMED and _is_unpadded(stamps, times):
        raise InputError(
            "its times go forward and back, and do not if nanoseconds were written without "
            f"leading zeros (secs.nsecs); use {{option}} '{layout.named(UNPADDED)}', or "
            f"{{option}} '{layout.named()}' if not"
        )
    name, is_inferred = layout.time_name, UNITS[layout.time_name] is None
    if is_inferred:
        name = next(name for name in _WORDS if UNITS[name] == unit)
        if are_clock_digits(stamps, unit):
            raise InputError(
                "its times are followed by those of the next minute as hhmmss are: the last two "
                f"digits before the point are below 60; if so, use {{option}} "
                f"'{layout.named(DATE)}', or {{option}} '{layout.named(name)}' if not"
            )
    remarks: tuple[Remark, ...] = ()
    if unit == 1 or (is_inferred and unit != NANOSECONDS):
        remarks = (note("nanoseconds", f"timestamps are in {_WORDS[name]}"),)
    elif is_inferred and (step := _step_of_doubt(stamps)):
        assumed = (
            f"its timestamps, in steps of {step:.2g}, are assumed to be seconds; if they are not, "
            f"use {{option}} '{layout.named('t_ms')}' (or frame, t_us, t_ns), or convert days"
        )
        remarks = (warning(ASSUMED_COLUMNS, assumed),)
    return Times(stamps, None, True, kept, remarks, name=name)


def _of_dates(path: Path, rows: Rows) -> Times:
    columns: Any = [rows.texts[name].tolist() for name in (DATE, CLOCK) if name in rows.texts]
    words = [b" ".join(row).decode("latin-1").strip() for row in zip(*columns, strict=True)]
    kept = np.array([word not in ("", "nan") for word in words])
    try:
        stamps, zone = dates([word for word in words if word not in ("", "nan")])
    except ValueError as error:
        row = words.index(str(error)) + 1
        raise InputError(
            f"{path}: {str(error)[:40]!r} in row {row} is not a date (UTC); correct or remove "
            "the row"
        ) from None
    return Times(stamps, None, True, None if kept.all() else kept, (note("dates", zone),))


def _floats(path: Path, times: Any) -> Floats:
    """Return times as float64; an empty word is NaN."""
    if times.dtype.kind != "S":
        return np.asarray(times)
    values = np.full(len(times), np.nan)
    for row, word in enumerate(times.tolist()):
        value = number(word.strip().decode("latin-1"))
        if value is None or len(word) >= WIDTH:
            shown = word.decode("latin-1")[:40]
            raise InputError(
                f"{path}: row {row + 1} has {shown!r}, which is not a time; "
                "correct or remove the row"
            )
        values[row] = value
    return values


def _unit(path: Path, layout: Layout, values: Floats) -> int:
    """Return the nanoseconds per unit of time that the name has or the values show."""
    unit = UNITS.get(layout.time_name, NANOSECONDS) or unit_of(values)
    if unit is not None:
        return unit
    largest, letters = np.abs(values).max(), _letters(values)
    step = median(np.abs(np.diff(values))) if len(values) > 1 else 0.0
    if step < 1.0 and largest < _FRAMES:
        raise InputError(
            f"its timestamps have steps of {step:.1g}, too short for seconds, as those of days "
            "(MATLAB, Excel) have; convert them to seconds, or use "
            f"{{option}} '{layout.named('t_s')}' if they are"
        )
    if layout.name == _TIMES.name:
        raise InputError(
            f"its numbers have steps of {step:g}, seconds or milliseconds; write their unit "
            f"above them: sed -i '1i t_ms' {path} (or t_s)"
        )
    key = f", but keys of GTSAM ({letters[0]}0, {letters[0]}1 ...)" if len(letters) == 1 else ""
    name = FRAME if key else likely_name(values)
    frame = ", frame" if are_whole(values, _FRAMES).all() else ""
    raise InputError(
        f"its timestamps (up to {largest:.6g}, in steps of {step:.6g}) are neither times since "
        f"1970 nor seconds{key}; name the unit: {{option}} '{layout.named(name)}'"
        + ("" if key else f" (or t_ms, t_us, t_ns, t_s{frame})")
    )


def _is_unpadded(stamps: Stamps, times: Any) -> bool:
    """Return whether times go forward only if their decimals are numbers of nanoseconds."""
    if times.dtype.kind != "S" or not (np.diff(stamps) < 0).any():
        return False
    with contextlib.suppress(ValueError):  # of words with other letters
        return bool((np.diff(unpadded(times)) > 0).all())
    return False


def _letters(keys: Floats) -> list[str]:
    """Return the letters that precede the numbers in keys of GTSAM; [] if they are no keys."""
    shift = 56 if keys.max(initial=0.0) >= 2.0**56 else 48
    letters = sorted(set(np.floor(keys / 2.0**shift).tolist()))
    are_letters = letters and letters[0] >= ord("A") and letters[-1] <= ord("z")
    return [chr(int(letter)) for letter in letters] if are_letters else []


def _frames(path: Path, layout: Layout, times: Any) -> tuple[Stamps, tuple[Remark, ...]]:
    """Return frame numbers (N,), which keys of GTSAM have after a letter, and remarks."""
    values = _floats(path, times)
    whole = are_whole(values, 2.0**63)
    frames = np.full(len(values), -1)
    frames[whole] = exact(times[whole], 0) if times.dtype.kind == "S" else values[whole]
    letters = _letters(values)
    remarks: tuple[Remark, ...] = ()
    if len(letters) == 1:
        frames = frames & (2**48 - 1)
        keys = f"frame numbers from keys of GTSAM, {letters[0]}0 ..."
        remarks = (note("gtsam_keys", keys),)
    right = whole & (frames >= 0) & (frames < _FRAMES)
    if not right.all():
        several = f" (keys of GTSAM of {len(letters)} robots)" if letters else ""
        raise InputError(
            f"{path}: row {int(np.argmin(right)) + 1} has no frame number in column "
            f"{(layout.time or 0) + 1}{several}; correct or remove the row"
        )
    return frames - (layout.time_name == FRAME_1), remarks


def _of_frames(
    layout: Layout,
    frames: Any,
    known: tuple[Remark, ...],
    rate: float | None,
    origin: Path | None,
) -> Times:
    """Return the times of frame numbers: of a file next to it, or by a rate."""
    remarks = list(known)
    has_numbers = layout.time is not None
    first = frames.min(initial=_FRAMES)
    if_first = (
        f"if 1 is the first frame, use {{option}} '{layout.named(FRAME_1)}', or {{option}} "
        f"'{layout.named(FRAME)}' if 0 is"
    )
    can_have_times = "matrix" in layout.groups or layout.name in _NUMBERED
    for beside in files_of_times(origin) if origin is not None and can_have_times else ():
        of_times, column = _rows_of_times(beside)
        numbers = frames
        if has_numbers and first >= 1 and frames.max(initial=0) == column.count:
            numbers = frames - 1
            remarks.append(note("frames_counted_from_1", "frame numbers start at 1"))
        elif has_numbers and first == 1 and layout.name != AS_NAMED:
            raise InputError(
                f"its frame numbers start at 1, and {beside} has {counted(column.count, 'time')}: "
                f"{if_first}"
            )
        if numbers.max(initial=0) < column.count if has_numbers else column.count == len(frames):
            times = times_of(beside, of_times, column, None, None)
            if times.kept is not None and not times.kept.all():
                raise InputError(f"{beside} has a row without a time; correct it")
            source = note("times_file", f"timestamps read from {beside}")
            return Times(times.stamps[numbers], frames, True, None, (*remarks, source))
        counts = f"{counted(column.count, 'row')} for {counted(len(frames), 'pose')}"
        remarks.append(note("times_file_ignored", f"{beside} ignored: it has {counts}"))
    if layout.time_name == FRAME and layout.name != AS_NAMED and first == 1:
        remarks.append(warning(FRAMES_FROM_1, f"its frame numbers start at 1: {if_first}"))
    if rate is not None:
        stamps = np.round(frames * (NANOSECONDS / rate)).astype(np.int64)
        remarks.append(note(ROW_TIMES, f"timestamps counted at {rate:g} Hz"))
        return Times(stamps, frames, True, None, tuple(remarks))
    unknown = "no timestamps: frames counted, 1 s apart; set their rate with --frame-rate"
    remarks.append(note("no_timestamps", unknown))
    return Times(frames * NANOSECONDS, frames, False, None, tuple(remarks))


def _may_count_frames(layout: Layout, origin: Path | None) -> bool:
    """Return whether the times of frames are in a file next to the file.

    A first column of whole numbers in equal steps counts them, as for VGGT-SLAM, which repeats
    frames where its submaps meet.
    """
    is_first = layout.time_name == "t" and layout.name in _NUMBERED
    return is_first and origin is not None and bool(files_of_times(origin))


def _are_frames(values: Floats) -> bool:
    """Return whether N finite values are whole numbers in equal steps, which may be repeated."""
    steps = np.diff(values)
    steps = steps[steps != 0]
    is_equal = len(steps) > 0 and 0 < steps.min() == steps.max()
    return bool(is_equal and are_whole(values, _FRAMES).all())


def _step_of_doubt(stamps: Stamps) -> float:
    """Return the step of times from zero, seconds, if another unit is as likely, else 0."""
    first = stamps[:_SAMPLE]
    if len(first) < 2 or first.max() >= _FRAMES * NANOSECONDS:
        return 0.0
    step = median(np.abs(np.diff(first))) / NANOSECONDS
    counts = step == 1.0 and not (first % NANOSECONDS).any()
    is_usual = step == 0.0 or SHORTEST_STEP_S <= step <= _LONGEST_USUAL_S
    return step if counts or not is_usual else 0.0


def _rows_of_times(path: Path, times: Floats | None = None) -> tuple[Layout, Rows]:
    """Return the rows of a file with one time per line, or of an array, and their layout."""
    if times is not None or path.suffix == ".npy":
        column = np.asarray(load(path)[0] if times is None else times, np.float64)
        return _TIMES, Rows(len(column), {"t": column}, {})
    table = sniff(path)
    if table.columns != 1:
        raise InputError(f"{path} has {table.columns} columns, expected one time per line")
    header = "_".join(split_header(" ".join(table.header[-1:]), ""))
    unit = name_and_unit(header)[1]
    layout = _TIMES.with_columns([f"t_{unit}"]) if unit in TIME_UNITS else _TIMES
    return layout, read_rows(table, layout)


def with_times(
    layout: Layout, rows: Rows, path: Path, times: Floats | None
) -> tuple[Layout, Rows]:
    """Add the column of times, or of frame numbers, that an array or a file next to it has."""
    source = path if times is not None else next(iter(files_of_times(path)), None)
    if source is None:
        return layout, rows
    of_times, column = _rows_of_times(source, times)
    [words] = column.texts.values()
    if words.shape != (rows.count,):
        raise InputError(
            f"{source} has times of shape {words.shape} for {counted(rows.count, 'pose')}; "
            "give one time per pose, or remove it"
        )
    counts_frames = of_times is _TIMES and are_whole(_floats(source, words), _LARGEST_FRAME).all()
    columns = (FRAME if counts_frames else of_times.time_name, *layout.columns)
    text = "; ".join(filter(None, (layout.note, f"times read from {source}")))
    layout = dataclasses.replace(layout, columns=columns, note=text)
    return layout, dataclasses.replace(rows, texts={**rows.texts, layout.time_name: words})


def part_of_times(path: Path, column: Floats, name: str) -> Stamps:
    """Return a part of times (N,) in nanoseconds, exact: of whole seconds, or the week of GPS.

    `name`: one of `PARTS`. The week is 0 if all rows have the same.
    """
    right = are_whole(column, PARTS[name][1])
    if not right.all():
        row = int(np.argmin(right))
        raise InputError(
            f"{path}: row {row + 1} has {column[row]:g} in column {name}, expected 0 to "
            f"{PARTS[name][1] - 1}; correct or remove the row"
        )
    parts = column.astype(np.int64) * PARTS[name][0]
    return parts * (name != WEEK or (parts != parts[:1]).any())


def receive_times_of(path: Path, stamps: Stamps, column: Any) -> ReceiveTimes:
    """Return the times in the column `received`, exact to the nanosecond.

    `stamps`: (N,), nanoseconds. `column`: (N,), words or float64, in a unit of timestamps: the one
    in which they are nearest to `stamps`.
    """
    values = _floats(path, column)
    usable = np.isfinite(values)
    reason = "no number"
    if usable.all():
        units = [unit for unit in UNITS.values() if unit is not None]
        unit = min(units, key=lambda unit: abs(median(values * unit - stamps)))
        usable = np.abs(values) * unit < 2.0**63
        reason = "a time after the year 2262"
    if not usable.all():
        raise InputError(
            f"row {int(np.argmin(usable)) + 1} has {reason} in column {RECEIVED}; correct or "
            "remove the row"
        )
    return ReceiveTimes(to_stamps(column, values, unit))
