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
from trajeval_ros.geometry.receive_times import ReceiveTimes
from trajeval_ros.geometry.source_info import FRAMES_FROM_1
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.io.text.header_words import name_and_unit, split_header
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
    WIDTH,
    are_clock_digits,
    are_parts,
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
    kept = None
    try:
        sample = times[:200].astype(np.float64)
        if not np.isfinite(sample).all():
            raise ValueError
        unit = _unit(layout, sample)
        stamps = to_stamps(times, sample, unit)
    except (ValueError, OverflowError):  # a time is missing or out of range
        values = _floats(path, times)
        kept = np.isfinite(values)
        times = np.char.strip(times[kept]) if times.dtype.kind == "S" else times[kept]
        unit = _unit(layout, values[kept])
        stamps = to_stamps(times, values[kept], unit)
    if _counts_frames(layout, stamps, origin):
        numbered = _of_frames(layout, stamps // NANOSECONDS, (), rate, origin)
        return dataclasses.replace(numbered, kept=kept, numbered=True)
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
    is_noted = unit == 1 or (is_inferred and unit != NANOSECONDS)
    word = next(word for name, word in _WORDS.items() if UNITS[name] == unit)
    remarks = (note("nanoseconds", f"timestamps are in {word}"),) if is_noted else ()
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


def _unit(layout: Layout, values: Floats) -> int:
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
    key = f", but keys of GTSAM ({letters[0]}0, {letters[0]}1 ...)" if len(letters) == 1 else ""
    name = FRAME if key else likely_name(values)
    raise InputError(
        f"its timestamps (up to {largest:.6g}, in steps of {step:.6g}) are neither times since "
        f"1970 nor seconds{key}; name the unit: {{option}} '{layout.named(name)}'"
        + ("" if key else " (or t_ms, t_us, t_ns, t_s)")
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
    whole = (values == np.round(values)) & (values >= 0.0) & (values < 2.0**63)
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
        times = times_of(beside, of_times, column, None, None).stamps
        numbers = frames
        if has_numbers and first >= 1 and frames.max(initial=0) == len(times):
            numbers = frames - 1
            remarks.append(note("frames_counted_from_1", "frame numbers start at 1"))
        elif has_numbers and first == 1 and layout.name != AS_NAMED:
            raise InputError(
                f"its frame numbers start at 1, and {beside} has {counted(len(times), 'time')}: "
                f"{if_first}"
            )
        if numbers.max(initial=0) < len(times) if has_numbers else len(times) == len(frames):
            if of_times is _TIMES:
                _check_unit(beside, times)
            source = note("times_file", f"timestamps read from {beside}")
            return Times(times[numbers], frames, True, None, (*remarks, source))
        counts = f"{counted(len(times), 'row')} for {counted(len(frames), 'pose')}"
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


def _counts_frames(layout: Layout, stamps: Stamps, origin: Path | None) -> bool:
    """Return whether a first column of whole numbers in equal steps counts frames.

    It does so if a file with the times of the frames is next to the file, as for VGGT-SLAM, which
    repeats frames where its submaps meet.
    """
    if layout.time_name != "t" or layout.name not in _NUMBERED or origin is None:
        return False
    if (stamps % NANOSECONDS).any() or stamps.max(initial=0) >= _FRAMES * NANOSECONDS:
        return False
    steps = np.diff(stamps)
    steps = steps[steps != 0]
    return bool(len(steps) and 0 < steps.min() == steps.max() and files_of_times(origin))


def _check_unit(path: Path, stamps: Stamps) -> None:
    """Refuse times without a unit that can be seconds or milliseconds: whole ones, far apart."""
    step_s = median(np.abs(np.diff(stamps))) / NANOSECONDS if len(stamps) > 1 else 0.0
    if step_s > 1.0 and stamps.max() < _FRAMES * NANOSECONDS and not (stamps % NANOSECONDS).any():
        raise InputError(
            f"{path} has whole numbers in steps of {step_s:g}, seconds or milliseconds; write "
            f"their unit above them: sed -i '1i t_ms' {path} (or t_s)"
        )


def _rows_of_times(path: Path) -> tuple[Layout, Rows]:
    """Return the rows of a file with one time per line, or of an array, and their layout."""
    if path.suffix == ".npy":
        times = load(path)[0]
        return _TIMES, Rows(len(times), {"t": times.astype(np.float64)}, {})
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
    source, name = "the same file", "t"
    if times is None:
        source = next(map(str, files_of_times(path)), "")
        if not source:
            return layout, rows
        known, column = _rows_of_times(Path(source))
        times, name = _floats(Path(source), column.texts[known.time_name]), known.time_name
    if times.shape != (rows.count,):
        raise InputError(
            f"{source} has shape {times.shape} for {counted(rows.count, 'pose')}; "
            "give one time per pose, or remove it"
        )
    counts_frames = (times == np.round(times)).all() and np.abs(times).max(initial=0.0) < 1e7
    columns = (FRAME if name == "t" and counts_frames else name, *layout.columns)
    text = "; ".join(filter(None, (layout.note, f"times read from {source}")))
    layout = dataclasses.replace(layout, columns=columns, note=text)
    return layout, dataclasses.replace(rows, texts={**rows.texts, layout.time_name: times})


def part_of_times(path: Path, column: Floats, name: str) -> Stamps:
    """Return a part of times (N,) in nanoseconds, exact: of whole seconds, or the week of GPS.

    `name`: one of `PARTS`. The week is 0 if all rows have the same.
    """
    right = are_parts(column, name)
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
