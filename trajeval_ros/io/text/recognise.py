"""Recognition of the layout of a table, by its header or by its first rows."""

from __future__ import annotations

import dataclasses
import re

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.text.header_names import from_header, plain_of, split_header
from trajeval_ros.io.text.layouts import OPENVINS_STATE, by_rows, example_for
from trajeval_ros.io.text.names import CLOCK, DATE, IGNORED, Layout
from trajeval_ros.io.text.stamps import is_date, is_time_of_day, moment
from trajeval_ros.io.text.table import TextTable

_LONGEST_HEADER = 1 << 15  # characters: patterns need quadratic time for longer ones
# Columns of Qualisys, whose header has no units.
_QUALISYS = {"time": "t"}
_QUALISYS |= {axis: f"{axis}_mm" for axis in "xyz"}
_QUALISYS |= {angle: f"{angle}_deg" for angle in ("roll", "pitch", "yaw")}


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
    clock = _has_clock(table)
    lines = table.header[::-1]
    if any(line.startswith("NO_OF_FRAMES") for line in lines):
        names = [_QUALISYS.get(name.lower(), IGNORED) for name in lines[0].split()]
        raise InputError(
            f"it is of Qualisys, with the columns {lines[0].split()}, usually in mm and degrees; "
            f"name them: {{option}} '{' '.join(names[: table.columns])}'"
        )
    for at, line in enumerate(lines):
        by_comment = line.lstrip().startswith(("#", "%"))
        if by_comment or at == 0 or not table.named:
            layout = _titled(table, line, lines[at + 1 :], clock)
            if layout is not None:
                return layout
    above = _uncommented(table)
    is_prose = above and not clock and table.columns not in _counts(above)
    if above and not (is_prose and {"unit", "matrix"} & set(by_rows(table).checks)):
        raise InputError(
            f"line {table.first} does not name {table.columns} known columns: {above[:80]!r}, "
            f"above the first row {table.first_line!r}; name the columns, as in "
            f"{{option}} '{example_for(table)}', with {IGNORED} for columns to ignore"
        )
    if clock:
        raise InputError(
            f"dates without a header, first row {table.first_line!r}; name the columns: "
            f"{{option}} '{example_for(table)}'"
        )
    layout = by_rows(table)
    return _smfeval(layout, table.header) if layout.name == "smfeval" else layout


def _counts(line: str) -> set[int]:
    return {len(split_header(line, separator)) for separator in (",", ";", "\t", "")}


def _uncommented(table: TextTable) -> str:
    return next(
        (line for line in table.header[::-1] if not line.lstrip().startswith(("#", "%"))), ""
    )


def _titled(table: TextTable, line: str, above: list[str], clock: bool) -> Layout | None:
    """Return the layout that a line above the rows describes, else None."""
    if len(line) > _LONGEST_HEADER:
        return None
    plain = re.sub(r"\[[^\]]*\]|\([^)]*\)", "", line).lower()
    plain = " ".join(re.split(r"[\s,;#%]+", plain))
    if vectors := re.search(r"\bq p v( bg ba)?\b", plain):
        columns = OPENVINS_STATE if vectors[1] else OPENVINS_STATE[:11]
        if table.columns >= len(columns):
            return Layout(
                "OpenVINS state", (*columns, *(IGNORED,) * (table.columns - len(columns)))
            )
    separators = [mark for mark in (",", ";", "\t") if mark in line and table.separator != mark]
    for separator in (table.separator if table.separator in ",;\t" else "", *separators, ""):
        names = split_header(line, separator)
        if (
            separator
            and line.rstrip("\r\n").endswith(separator)
            and len(names) == table.columns - 1
        ):
            names.append("")
        if len(names) == table.columns - clock:
            break
    else:
        return None
    if clock:
        names.insert(1, CLOCK)
    if len({name for name in names if name}) < sum(map(bool, names)) and above:  # Motive
        more = split_header(above[0], separator)
        names = [
            f"{first} {name}".strip() if first else name
            for first, name in zip([*more, *[""] * len(names)], names, strict=False)
        ]
    if above and all(re.fullmatch(r"|m/?s?|mm|cm|km|deg|rad|s|ms|us|ns", name) for name in names):
        units = names  # of a Vicon export, below the names
        names = [
            f"{name} [{unit}]" if unit else name
            for name, unit in zip(
                split_header(above[0], separator), [*units, *[""] * 99], strict=False
            )
        ]
        names += [""] * (table.columns - len(names))
    known = [plain_of(name) for name in names]
    layout = from_header(names, table)
    if layout is None:
        return None
    twice = [
        name
        for at, name in enumerate(names)
        if known.count(known[at]) > 1 and known[at] and layout.columns[at] != IGNORED
    ]
    if twice:
        raise InputError(
            f"its header names {twice[0]!r} twice, as for several bodies; name the columns "
            f"of one: {{option}} '{' '.join(layout.columns)}'"
        )
    if clock and layout.time == 0:
        layout = dataclasses.replace(layout, columns=(DATE, CLOCK, *layout.columns[2:]))
    if line.lstrip("# ").startswith("fields "):
        layout = dataclasses.replace(layout, name="trajectopy")
    return layout


def _has_clock(table: TextTable) -> bool:
    """Return whether a date and a time of the day are the first two columns."""
    first = table.sample[0]
    if table.separator or len(first) < 3:
        return False
    return is_date(first[0]) and is_time_of_day(first[1])


def with_dates(table: TextTable, layout: Layout) -> Layout:
    """Return the layout with a date as time if the first row has one."""
    at = layout.time
    if at is None:
        return layout
    word = table.sample[0][at] if table.sample else ""
    if layout.time_name in ("t", DATE) and moment(word) is not None:
        columns = tuple(DATE if place == at else name for place, name in enumerate(layout.columns))
        return dataclasses.replace(layout, columns=columns)
    if table.texts[at]:
        raise InputError(
            f"line {table.first + 1}: column {at + 1} has {word[:40]!r}, which is not a time; "
            f"to ignore it: {{option}} '{' '.join([*layout.columns[:at], IGNORED])}"
            f" {' '.join(layout.columns[at + 1 :])}'"
        )
    return layout


def _smfeval(layout: Layout, header: list[str]) -> Layout:
    """Return the layout with the convention of covariances that the header of SQUARE states."""
    stated = " ".join(header).upper()
    if re.search("LEFT_PERTURBATION|ROTATION_TRANSLATION", stated):
        dropped = "covariances dropped: their axes or their order are not supported"
        return dataclasses.replace(
            layout, columns=layout.columns[:8] + (IGNORED,) * 21, note=dropped
        )
    return dataclasses.replace(layout, note="") if "RIGHT_PERTURBATION" in stated else layout
