"""Names in header lines, translated to those of `names.NAMES`."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.io.text.header_patterns import (
    ANGLES,
    COMPASS,
    EXACT_TIME,
    FRAME_NAMES,
    LABEL,
    LENGTHS,
    NO_UNITS_OF_TIME,
    OF_ANOTHER,
    OF_MATRIX,
    OF_WEEK,
    OTHER_SPEED,
    PART_OF_UNIT,
    PATTERNS,
    POSE,
    POSITION,
    POSSIBLE,
    QUANTITY,
    SETS,
    TIME_NAME,
    UNIT_OF_WORD,
    WEEK_NAMES,
    entries,
    name_and_unit,
)
from trajeval_ros.io.text.layouts import ORDERS, examples, quaternion_in, with_names
from trajeval_ros.io.text.names import (
    CLOCK,
    FRAME,
    IGNORED,
    PARTS,
    RECEIVED,
    ROTATIONS,
    TIME_UNITS,
    TIMES,
    WEEK,
    WEEK_S,
    Layout,
)
from trajeval_ros.io.text.stamps import are_whole, goes_back, goes_forward, is_clock, likely_name
from trajeval_ros.io.text.table import TextTable


@dataclass(frozen=True)
class _Header:
    """The names of the columns of a table."""

    names: Sequence[str]  # as written
    plain: Sequence[str]  # in lower case, without units
    units: Sequence[str]  # "" for columns without
    table: TextTable

    def places(self, pattern: str) -> list[int]:
        """Return the columns whose names a pattern matches."""
        return [at for at, word in enumerate(self.plain) if re.fullmatch(pattern, word)]


def from_header(names: Sequence[str], table: TextTable) -> Layout | None:
    """Return the layout that the names of all columns describe; None if they are no names.

    Raises:
        InputError: A quantity is missing that a column with an unknown name may be.
    """
    plain, units = map(list, zip(*map(name_and_unit, names), strict=True))
    header = _Header(names, plain, units, table)
    columns, rivals = _columns(header)
    layout = Layout("", tuple(columns))
    places = [at for at, name in enumerate(columns) if name in (*OF_MATRIX, *OF_MATRIX.values())]
    layout = dataclasses.replace(
        layout, unit=" and ".join(dict.fromkeys(units[place] or "m" for place in places)) or "m"
    )
    known = [
        name != IGNORED or re.fullmatch(f"{QUANTITY}|{LABEL}|{COMPASS}|", word) is not None
        for name, word in zip(columns, plain, strict=True)
    ]
    if set(columns) == {IGNORED} and 2 * sum(known) < len(names):
        return None
    _check(header, columns)
    if rivals:
        place, quantity = next(iter(rivals.items()))
        swapped = [
            rivals.get(at, IGNORED if name in rivals.values() else name)
            for at, name in enumerate(columns)
        ]
        raise InputError(
            f"its header names {names[columns.index(quantity)]!r} and {names[place]!r}, as for "
            f"several bodies; name the columns of one: {{option}} '{layout.named()}' or "
            f"{{option}} '{layout.with_columns(swapped).named()}'"
        )
    unknown = [
        at
        for at, column in enumerate(table.values.T)
        if not known[at] and not _is_constant(column)
    ]
    quantity, complete = _missing(header, layout, unknown)
    if quantity:
        words = ", ".join(repr(names[at][:40]) for at in unknown[:6])
        doubt = f", and the meaning of {words} is unknown" if unknown else ""
        time = likely_name(table.values[:, layout.time or 0]) if layout.time_name == "t" else ""
        options = " or ".join(
            f"{{option}} '{layout.with_columns(example).named(time)[:300]}'"
            for example in complete
        )
        raise InputError(
            f"no column has a name of a {quantity} ({', '.join(names)[:200]}){doubt}; if one is "
            f"there, name the columns: {options}"
        )
    used = {place for places in layout.groups.values() for place in places} | {layout.time}
    ignored = [
        name or f"column {at + 1}"
        for at, name in enumerate(names)
        if at not in used and name != CLOCK
    ]
    note = f"ignored columns: {', '.join(ignored)}" if ignored else ""
    compass = [at for at, word in enumerate(plain) if re.fullmatch(COMPASS, word)]
    if compass and not layout.is_geographic and set(ROTATIONS).isdisjoint(layout.groups):
        name = names[compass[0]]
        note += f"; {name} may count from north: no rotations are read; name it yaw if not"
    return dataclasses.replace(layout, name=_title(layout), note=note)


def _check(header: _Header, columns: Sequence[str]) -> None:
    """Refuse a unit that a quantity can't have, and text in the place of a position."""
    for name, column, unit in zip(header.names, columns, header.units, strict=True):
        possible = tuple(TIME_UNITS) if column in TIMES else POSSIBLE.get(column, ())
        is_unit = column not in TIMES or re.fullmatch(NO_UNITS_OF_TIME, unit)
        if unit and possible and unit not in possible and is_unit:
            raise InputError(
                f"the unit of {name[:40]!r}, {unit!r}, is unknown; convert it to "
                f"{' or '.join(possible)}, and write that unit in the header"
            )
    table = header.table
    for at in np.flatnonzero(table.texts).tolist():
        match = re.fullmatch(POSITION, header.plain[at])
        if match and match[1] not in columns:
            raise InputError(
                f"line {table.first + 1}, column {at + 1} ({header.names[at][:40]}): "
                f"{table.sample[0][at][:40]!r} is not a number; correct the column"
            )


def _missing(
    header: _Header, layout: Layout, unknown: Sequence[int]
) -> tuple[str, list[list[str]]]:
    """Return the quantity that a column with an unknown name may be, "" if all is known.

    With it, names of all columns as examples, the quantity included.
    """
    columns, plain, units, table = list(layout.columns), header.plain, header.units, header.table
    if not layout.has_places:
        return "position", examples(table, columns)
    is_unpaired = layout.time_name in ("", FRAME)
    clocks = [
        at
        for at, column in enumerate(table.values.T)
        if is_unpaired
        and columns[at] == IGNORED
        and units[at] in ("", *TIME_UNITS)
        and not re.fullmatch(QUANTITY, plain[at])
        and is_clock(column)
    ]
    if clocks:
        columns = [IGNORED if name == FRAME else name for name in columns]
        words = [
            units[clocks[0]],
            *(UNIT_OF_WORD.get(word) for word in plain[clocks[0]].split("_")),
        ]
        unit = next((word for word in words if word in TIME_UNITS), "")
        columns[clocks[0]] = f"t_{unit}".rstrip("_")
        return "time", [columns]
    if "planar" in layout.groups and unknown:
        columns[unknown[0]] = "z"
        return "height", [columns]
    has_rotation = not {"matrix", *ROTATIONS}.isdisjoint(layout.groups)
    four = quaternion_in(table.values, range(len(columns)))
    if four and not layout.is_geographic and not has_rotation:
        return "rotation", [with_names(columns, four, order) for order in ORDERS]
    return "", []


def _is_constant(column: Floats) -> bool:
    finite = column[np.isfinite(column)]
    return len(column) > 1 and bool((finite == finite[:1]).all())


def _columns(header: _Header) -> tuple[list[str], dict[int, str]]:
    """Return the name in `NAMES` of every column, `_` if unknown or used before.

    With it, columns that have an equal claim to the name of another, by index. The shortest name
    wins: `x` is no rival of `target_x`, but `a_x` is one of `b_x`.
    """
    plain, units, places = header.plain, header.units, header.places
    columns = [IGNORED] * len(plain)
    rivals: dict[int, str] = {}

    def name(place: int, word: str) -> None:
        if word not in columns and columns[place] == IGNORED:
            columns[place] = word

    for place in places("received"):
        name(place, RECEIVED)
    _name_time(header, name)
    for place, word in entries(plain).items():
        name(place, word)
    theta_is_yaw = not places("phi|psi")
    is_global = ["ecef" in word for word in plain]  # next to the same in a local frame (Aria)
    by_length = sorted(range(len(plain)), key=lambda at: (is_global[at], len(plain[at])))
    for pattern, template in PATTERNS:
        for place in by_length:
            word = re.sub(r"\Atheta", "yaw", plain[place]) if theta_is_yaw else plain[place]
            match = re.fullmatch(pattern, word)
            if match is None or header.table.texts[place]:
                continue
            quantity = template.format(*match.groups())
            if quantity in ANGLES and units[place] == "deg":
                quantity += "_deg"
            if quantity in POSE and re.fullmatch(OF_ANOTHER, word):
                continue
            if "v" in quantity and (
                units[place] in (*TIME_UNITS, *LENGTHS)
                or re.search(OTHER_SPEED, header.names[place].lower())
            ):
                continue
            name(place, quantity)
            if columns[place] == IGNORED and quantity in POSE and quantity not in rivals.values():
                chosen = columns.index(quantity)
                is_same = plain[chosen] == plain[place] and units[chosen] != units[place]
                is_longer = plain[place].endswith(f"_{plain[chosen]}")
                if not (is_same or is_longer or is_global[chosen] != is_global[place]):
                    rivals[place] = quantity
    for patterns, needed in SETS:
        if "latitude" in columns and "latitude" not in needed:
            return columns, {}
        at = {word: places(pattern) for word, pattern in patterns.items()}
        if all(at.values()) and not set(patterns) & set(columns) and needed <= set(columns):
            for word, all_at in at.items():
                name(all_at[0], word)
    if "m33" in columns and "m34" not in columns and not rivals:  # with a position of its own
        columns = [OF_MATRIX.get(word, word) for word in columns]
    return columns, rivals


def _name_time(header: _Header, name: Callable[[int, str], None]) -> None:
    """Name the column of timestamps, preferably of the header; without one, frame numbers."""
    plain, units, sample = header.plain, header.units, header.table.values
    clocks = list(map(goes_forward, sample.T))
    times = [
        at
        for at in header.places(TIME_NAME)
        if header.table.texts[at]
        or "header_stamp" in plain[at]
        or re.fullmatch(EXACT_TIME, plain[at])
        or not goes_back(sample[:, at])  # as time differences do
    ]
    times += [
        at for at, word in enumerate(plain) if clocks[at] and UNIT_OF_WORD.get(word) in TIME_UNITS
    ]
    stems = ["" if word in UNIT_OF_WORD else word for word in plain]
    seconds = {
        stems[at]: at
        for at, column in enumerate(sample.T)
        if units[at] == "s" and 2 * np.sum(column == np.round(column)) >= len(column)
    }
    joined = {  # columns of the parts of whole seconds, by that of the seconds
        seconds[stems[at]]: at
        for at, column in enumerate(sample.T)
        if units[at] in PART_OF_UNIT
        and stems[at] in seconds
        and 2 * np.sum(are_whole(column, PARTS[PART_OF_UNIT[units[at]]][1])) >= len(column)
    }
    times = sorted(
        {*times, *joined} - {*joined.values()},
        key=lambda at: (
            "header_stamp" not in plain[at],
            at not in joined,
            not (clocks[at] or header.table.texts[at]),
            not re.fullmatch(EXACT_TIME, plain[at]),
            at,
        ),
    )
    for place in times[:1]:
        unit = _unit_of_time(header, place, name)
        name(place, f"t_{unit}" if unit in TIME_UNITS else "t")
        if place in joined:
            name(joined[place], PART_OF_UNIT[units[joined[place]]])
    for place in times[1:]:
        if plain[place] == "receive_time":  # of Foxglove's tables
            name(place, RECEIVED)
    for place in header.places(FRAME_NAMES) if not times else ():
        if np.isfinite(sample[:, place]).all() and not _is_constant(sample[:, place]):
            name(place, "t" if len(sample) and sample[0, place] > 1e8 else FRAME)
            break


def _unit_of_time(header: _Header, place: int, name: Callable[[int, str], None]) -> str:
    """Return the unit of a time, "" if unknown; if it is of the week of GPS, name the week."""
    unit, weeks = header.units[place], header.places(WEEK_NAMES)
    if weeks or re.fullmatch(OF_WEEK, header.plain[place]):
        latest = np.nanmax(header.table.values[:, place], initial=0.0)
        unit = unit or ("s" if latest <= WEEK_S else "ms")
        if unit in TIME_UNITS and latest * TIME_UNITS[unit] <= WEEK_S * TIME_UNITS["s"]:
            for week in weeks:
                name(week, WEEK)
        else:
            unit = header.units[place]
    return unit


def _title(layout: Layout) -> str:
    """Return the name of the format that has these columns."""
    groups = layout.groups
    if "rotation_covariance" in groups:
        return "OpenVINS with covariance"
    if "gyroscope_bias" in groups:
        return "EuRoC/ASL"
    if layout.is_geographic:
        return "latitude, longitude" + (", height" if "place" in groups else "")
    if layout.columns[1:] == ("x", "y", "z", "qx", "qy", "qz", "qw"):
        return "TUM"
    return "columns named by the header"
