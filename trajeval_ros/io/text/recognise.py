"""Recognition of the layout of a table, by its header or by its first rows."""

from __future__ import annotations

import dataclasses
import itertools
import re

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.io.text.header_names import from_header
from trajeval_ros.io.text.header_patterns import UNIT_OF_WORD, count_of_pose, split_header
from trajeval_ros.io.text.layouts import OPENVINS_STATE, by_rows, options_for
from trajeval_ros.io.text.names import CLOCK, DATE, IGNORED, WEEK, Layout
from trajeval_ros.io.text.stamps import is_date, is_time_of_day, moment
from trajeval_ros.io.text.table import MIXED, SEPARATORS, Rows, TextTable, body_of
from trajeval_ros.metrics.statistics import median

_LONGEST_HEADER = 1 << 15  # characters: patterns need quadratic time for longer ones
_STATEMENT = r"(?i)\b(wxyz|[mc]m|(milli|centi)met\w+|deg|degrees?|feet|inch(es)?)\b"
_NUMBER_OF_COLUMN = r"(?i)\A[#%\s]*(?:(?:column|col|field)?\s*\d+\s*[:.)=-]*\s+)?"
_WORD = r"[^\W\d]\S*(?: ?[\[(]\S+[\])])?"  # a name, maybe with a unit
_FEWEST = 4  # names of a pose that make a header of a line of other words
# A path is curved, and angles are its directions, by the lengths of sums of steps, before and
# after they are rotated by the angles, per length of the path.
_CURVED, _PARALLEL = 0.7, 0.9
_WRAPPED = 0.9  # of a turn, between two angles
_FARTHEST = 1e9  # coordinates that are looked at: larger ones are damaged
# Columns of Qualisys, whose header has no units.
_QUALISYS = {
    "time": "t", "x": "x_mm", "y": "y_mm", "z": "z_mm",
    "roll": "roll_deg", "pitch": "pitch_deg", "yaw": "yaw_deg",
}  # fmt: skip


def layout_of_table(table: TextTable) -> Layout:
    """Return the layout of a table by its header, or by its first rows.

    Raises:
        InputError: No layout is certain; the message quotes the first row.
    """
    try:
        return _certain(table)
    except InputError as error:
        if "row" in str(error) or str(error).startswith("line "):
            raise
        raise InputError(f"{error}; its first row is {table.first_line!r}") from None


def _certain(table: TextTable) -> Layout:
    lines, words = table.header[::-1], table.sample[0]
    # Whether a date and a time of the day are the first two columns.
    has_clock = (
        not table.separator and len(words) > 2 and is_date(words[0]) and is_time_of_day(words[1])
    )
    if any(line.startswith("NO_OF_FRAMES") for line in lines):
        names = [_QUALISYS.get(name.lower(), IGNORED) for name in lines[0].split()]
        raise InputError(
            f"it is of Qualisys, with the columns {lines[0].split()}, usually in mm and degrees; "
            f"name them: {{option}} '{' '.join(names[: table.columns])}'"
        )
    lines = [*filter(None, [_listed(table)]), *lines]
    uncommented = [line for line in lines if body_of(line).strip()]
    for at, line in enumerate(lines):
        if at == 0 or line.lstrip().startswith(("#", "%", "FIELDS ")) or not uncommented:
            layout = _titled(table, line, lines[at + 1 :], has_clock)
            if layout is not None:
                return _with_comments(layout, [*lines[:at], *lines[at + 1 :]])
    if uncommented:
        counts = [len(split_header(uncommented[0], separator)) for separator in SEPARATORS]
        is_prose = not has_clock and table.columns not in counts
        if not (is_prose and {"unit", "matrix"} & set(by_rows(table).checks)):
            raise InputError(
                f"line {table.first} does not name {table.columns} known columns: "
                f"{uncommented[0][:80]!r}, above the first row {table.first_line!r}; name the "
                f"columns, as in {options_for(table)}, with {IGNORED} for columns to ignore"
            )
    if has_clock:
        raise InputError(
            f"dates without a header, first row {table.first_line!r}; name the columns: "
            f"{options_for(table)}"
        )
    layout = by_rows(table)
    if layout.name == "smfeval":
        return _smfeval(layout, table.header)
    return _with_comments(layout, lines)


def _listed(table: TextTable) -> str:
    """Return names of columns that stand on lines of their own as one line, "" without."""
    names = [re.sub(_NUMBER_OF_COLUMN, "", line).strip() for line in table.header]
    names = [re.split(r"\s[-–=]\s|[:,;]", name)[0].strip() for name in names]
    for is_word, group in itertools.groupby(names, lambda name: bool(re.fullmatch(_WORD, name))):
        block = list(itertools.dropwhile(lambda name: not count_of_pose([name]), group))
        if is_word and (1 < len(block) == table.columns or count_of_pose(block) >= _FEWEST):
            return "\t".join(block)
    return ""


def _with_comments(layout: Layout, lines: list[str]) -> Layout:
    """Note a comment, of `lines` above the rows, about a unit or an order that is not read."""
    stated = re.search(r"(?i)\blength units\W+(\w+)", "\n".join(lines))  # of Motive
    if stated and layout.unit == "m":
        return dataclasses.replace(layout, unit=UNIT_OF_WORD.get(stated[1].lower(), stated[1]))
    line = next((line for line in lines if re.search(_STATEMENT, line)), "")
    text = f"a comment is not read: {line.strip()[:80]!r}"
    return dataclasses.replace(layout, note="; ".join(filter(None, [layout.note, line and text])))


def _titled(table: TextTable, line: str, above: list[str], has_clock: bool) -> Layout | None:
    """Return the layout that a line above the rows describes, else None."""
    if len(line) > _LONGEST_HEADER:
        return None
    words = " ".join(re.split(r"[\s,;#%]+", re.sub(r"\[[^\]]*\]|\([^)]*\)", "", line).lower()))
    if vectors := re.search(r"\bq p v( bg ba)?\b", words):
        columns = OPENVINS_STATE if vectors[1] else OPENVINS_STATE[:11]
        ignored = table.columns - len(columns)
        if ignored >= 0:
            return Layout("OpenVINS state", (*columns, *(IGNORED,) * ignored))
    width = table.columns - has_clock
    others = [mark for mark in SEPARATORS if mark in line and mark != table.separator]
    for separator in ("" if table.separator == MIXED else table.separator, *others):
        names = split_header(line, separator)
        if len(names) == width + 1 and not names[-1]:
            names.pop()
        if len(names) == width - 1 and names[0] == "GPST":  # of RTKLIB, for two columns
            names[:1] = [WEEK, "tow"]
        count = count_of_pose(names)
        if len(names) > width == count_of_pose(names[:width]) == count:
            del names[width:]  # words after the names
        if len(names) == width:
            break
        if count >= _FEWEST and 2 * count > len(names) and all(names):
            raise InputError(
                f"its header names {counted(len(names), 'column')}, {line.strip()[:80]!r}, and "
                f"its rows have {table.columns}; name the columns, as in {options_for(table)}"
            )
    else:
        return None
    if has_clock:
        names.insert(1, CLOCK)
    if above:
        more = [*split_header(above[0], separator), *[""] * len(names)]
        named = list(filter(None, names))
        if len(set(named)) < len(named):  # of a body of Motive, above the names of its axes
            names = [f"{first} {name}".strip() for first, name in zip(more, names, strict=False)]
        if all(map(_is_unit, names)):  # of Vicon, below the names
            names = [
                f"{name} [{unit}]" if unit else name
                for name, unit in zip(more, names, strict=False)
            ]
    return from_header(names, table)


def _is_unit(word: str) -> bool:
    """Return whether a word is a unit, such as mm or (deg/s), or an empty one."""
    word = re.split("[/^ ]", word.strip("[]()").lower())[0]
    return word in ("", "-", "1", *UNIT_OF_WORD)


def check_comments(table: TextTable, layout: Layout) -> None:
    """Refuse comments between the rows that name the columns in another order, as for other rows.

    `table`: after all rows were read.
    """
    places = {name: at for at, name in enumerate(layout.columns) if name != IGNORED}
    for comment, line in table.comments.items():
        if count_of_pose(re.split(r"[,;\s]+", comment)) < _FEWEST:
            continue
        try:
            other = _titled(table, comment, [], has_clock=False)
        except InputError:
            columns: tuple[str, ...] = ()
        else:
            columns = layout.columns if other is None else other.columns
        if not columns or any(places.get(name, at) != at for at, name in enumerate(columns)):
            raise InputError(
                f"line {line}: a comment names other columns than those above: {comment[:80]!r}; "
                f"read both parts apart: head -n {line - 1} {table.path.name} > first.txt; "
                f"tail -n +{line} {table.path.name} > second.txt"
            )


def check_heights(layout: Layout, rows: Rows) -> None:
    """Refuse heights without a header that are angles.

    They are if they wrap, or if their differences from the direction of travel are nearly equal.
    """
    if not (layout.doubt and "position" in layout.groups and layout.columns[-1] == "z"):
        return
    places = rows.groups["position"]
    places = places[(np.abs(places) < _FARTHEST).all(axis=1)]
    angles, extent = places[:, 2], np.abs(places[:, 2]).max(initial=0.0)
    steps = np.diff(places[:, 0] + 1j * places[:, 1])
    lengths = np.abs(steps)
    total = max(lengths.sum(), np.finfo(np.float64).tiny)
    for name, turn in (("yaw", 2.0 * np.pi), ("yaw_deg", 360.0)):
        turns = np.abs(np.diff(angles)) / turn
        is_wrapped = extent <= turn and (turns > _WRAPPED).any() and median(turns) < 0.1
        along = np.abs((steps * np.exp(-2j * np.pi * angles[:-1] / turn)).sum()) / total
        if is_wrapped or (along > _PARALLEL and np.abs(steps.sum()) < _CURVED * total):
            raise InputError(
                "its fourth column may be the direction of travel; name the columns: {option} "
                f"'t x y {name}', or {{option}} 't x y z' if it is a height"
            )


def with_dates(table: TextTable, layout: Layout) -> Layout:
    """Return the layout with a date as time if the first row has one."""
    at = layout.time
    if at is None:
        return layout
    row = table.sample[0]
    for first in (at - 1, at):
        pair = row[max(first, 0) : first + 2]
        if len(pair) == 2 and is_date(pair[0]) and is_time_of_day(pair[1]):
            before, after = layout.columns[:first], layout.columns[first + 2 :]
            return layout.with_columns((*before, DATE, CLOCK, *after))
    before, after, word = layout.columns[:at], layout.columns[at + 1 :], row[at]
    if layout.time_name in ("t", DATE) and moment(word) is not None:
        return layout.with_columns((*before, DATE, *after))
    if table.texts[at]:
        raise InputError(
            f"line {table.first + 1}: column {at + 1} has {word[:40]!r}, which is not a time; "
            f"to ignore it: {{option}} '{' '.join((*before, IGNORED, *after))}'"
        )
    return layout


def _smfeval(layout: Layout, header: list[str]) -> Layout:
    """Return the layout with the convention of covariances that the header of SQUARE states."""
    stated = " ".join(header).upper()
    if re.search("LEFT_PERTURBATION|ROTATION_TRANSLATION", stated):
        columns = layout.columns[:8] + (IGNORED,) * 21
        dropped = "covariances dropped: their axes or their order are not supported"
        return dataclasses.replace(layout, columns=columns, note=dropped)
    return dataclasses.replace(layout, note="") if "RIGHT_PERTURBATION" in stated else layout
