"""The steps of decoding a message, planned from a type's definition.

Consecutive numbers have constant distances if none of them has a larger alignment than the first.
All of them are one step.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from trajeval_ros.io.bags.message_definitions import TEXT, Fields, Kind, Repeated, UnplannedError

_CLOSE = 64  # bytes between columns that are copied at once


@dataclass(frozen=True)
class Column:
    """A column of numbers in a run."""

    path: str
    offset: int
    type: str
    shape: tuple[int, ...]

    @property
    def end(self) -> int:
        """Where it ends, from the beginning of the run."""
        return self.offset + np.dtype(self.type).itemsize * math.prod(self.shape)


@dataclass(frozen=True)
class FixedFields:
    """Consecutive numbers at fixed distances from the first."""

    alignment: int  # of the first number, which is the largest one
    size: int  # bytes
    # The requested columns. Columns close to each other are copied at once.
    spans: tuple[Span, ...]


@dataclass(frozen=True)
class Span:
    """Columns of a run that are copied at once."""

    offset: int  # from the beginning of the run
    columns: tuple[str, ...]
    # The numpy type of a row by byte order, with a field for each column.
    types: dict[str, np.dtype[Any]]


@dataclass(frozen=True)
class String:
    """A string. Without path it is skipped."""

    path: str | None


@dataclass(frozen=True)
class Elements:
    """Several values of one type. Without path they are skipped."""

    path: str | None
    steps: tuple[Step, ...]
    count: int | None
    is_delimited: bool
    smallest: int

    @property
    def stride(self) -> int | None:
        """The distance between elements of equal size; None if sizes can differ."""
        if len(self.steps) == 1 and isinstance(run := self.steps[0], FixedFields):
            return -(-run.size // run.alignment) * run.alignment
        return None


Step = FixedFields | String | Elements


@dataclass
class _Leaves:
    """The numbers of a run while it grows."""

    alignment: int
    size: int = 0
    leaves: list[Column] = field(default_factory=list)

    def add(self, path: str, kind: str, count: int | None, alignment: int) -> None:
        offset = -(-self.size // alignment) * alignment
        self.leaves.append(Column(path, offset, kind, () if count is None else (count,)))
        self.size = self.leaves[-1].end


@functools.lru_cache(maxsize=256)
def steps_of(fields: Fields, requested: frozenset[str] | None, limit: int) -> tuple[Step, ...]:
    """Return the steps that decode the fields."""
    steps: list[Step] = []
    run: _Leaves | None = None
    for path, kind in _leaves(fields, ""):
        count = kind.count if isinstance(kind, Repeated) else None
        inner = kind.kind if isinstance(kind, Repeated) and count is not None else kind
        if isinstance(inner, str) and inner != TEXT:
            alignment = min(np.dtype(inner).itemsize, limit)
            # The distances in a run are constant if the first alignment is the largest.
            if run is None or alignment > run.alignment:
                steps += _finished(run, requested)
                run = _Leaves(alignment)
            run.add(path, inner, count, alignment)
            continue
        steps += _finished(run, requested)
        run = None
        is_requested = requested is None or path in requested
        if kind == TEXT:
            steps.append(String(path if is_requested else None))
        else:
            assert isinstance(kind, Repeated)
            steps.append(_elements(path, kind, requested, limit))
    steps += _finished(run, requested)
    missing = (requested or frozenset()) - {
        name for step in steps for name in _provided(step, requested or frozenset())
    }
    if missing:
        raise UnplannedError(f"no field {', '.join(sorted(missing))} of a single type")
    return tuple(steps)


def _leaves(fields: Fields, prefix: str) -> list[tuple[str, Kind]]:
    """Return the paths and kinds of all fields, with the fields of nested messages."""
    leaves: list[tuple[str, Kind]] = []
    for name, kind in fields:
        if isinstance(kind, tuple):
            leaves += _leaves(kind, f"{prefix}{name}.")
        else:
            leaves.append((prefix + name, kind))
    return leaves


def _elements(path: str, kind: Repeated, requested: frozenset[str] | None, limit: int) -> Elements:
    inside: frozenset[str] | None
    if requested is None or path in requested:
        inside = None
    else:
        inside = frozenset(
            name[len(path) + 1 :] for name in requested if name.startswith(f"{path}.")
        )
    fields = kind.kind if isinstance(kind.kind, tuple) else (("", kind.kind),)
    steps = steps_of(fields, inside, limit)
    is_delimited = isinstance(kind.kind, tuple) or kind.kind == TEXT
    smallest = sum(_smallest(step) for step in steps)
    if not smallest:
        raise UnplannedError(f"{path} has no fields")
    is_requested = inside is None or bool(inside)
    return Elements(path if is_requested else None, steps, kind.count, is_delimited, smallest)


def _smallest(step: Step) -> int:
    """Return the least number of bytes that a step takes."""
    if isinstance(step, FixedFields):
        return step.size
    if isinstance(step, Elements) and step.count is not None:
        return step.count * step.smallest
    return 4


def _finished(run: _Leaves | None, requested: frozenset[str] | None) -> list[Step]:
    """Return a run as a step, with its required columns."""
    if run is None:
        return []
    names = [leaf.path for leaf in run.leaves] if requested is None else requested
    candidates = (_column(run, name) for name in names)
    columns = sorted(
        (item for item in candidates if item is not None), key=lambda item: item.offset
    )
    spans: list[list[Column]] = []
    for column in columns:
        if spans and column.offset - spans[-1][-1].end <= _CLOSE:
            spans[-1].append(column)
        else:
            spans.append([column])
    return [FixedFields(run.alignment, run.size, tuple(_span(span) for span in spans))]


def _column(run: _Leaves, name: str) -> Column | None:
    """Return the column of that name in a run: a leaf, or leaves of one kind in a row."""
    leaves = [leaf for leaf in run.leaves if leaf.path == name or leaf.path.startswith(f"{name}.")]
    if not leaves:
        return None
    if leaves[0].path == name:
        return leaves[0]
    size = np.dtype(leaves[0].type).itemsize
    in_a_row = [
        dataclasses.replace(leaves[0], path=leaf.path, offset=leaves[0].offset + number * size)
        for number, leaf in enumerate(leaves)
    ]
    if leaves != in_a_row or leaves[0].shape:
        return None
    return Column(name, leaves[0].offset, leaves[0].type, (len(leaves),))


def _span(columns: list[Column]) -> Span:
    begin = columns[0].offset
    types = {
        order: np.dtype(
            {
                "names": [column.path for column in columns],
                "formats": [(f"{order}{column.type}", column.shape) for column in columns],
                "offsets": [column.offset - begin for column in columns],
                "itemsize": max(column.end for column in columns) - begin,
            }
        )
        for order in "<>"
    }
    return Span(begin, tuple(column.path for column in columns), types)


def _provided(step: Step, requested: frozenset[str]) -> set[str]:
    """Return the requested paths that a step decodes."""
    if isinstance(step, FixedFields):
        return {path for span in step.spans for path in span.columns}
    if step.path is None:
        return set()
    if isinstance(step, String):
        return {step.path}
    return {name for name in requested if name == step.path or name.startswith(f"{step.path}.")}
