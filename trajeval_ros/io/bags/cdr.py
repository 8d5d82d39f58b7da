"""Serialised messages to columns: CDR of both endiannesses, plain XCDR2, and ROS 1.

All messages of a batch are walked together, field by field. Where a field begins is a column, one
offset for each message: strings and sequences move what follows them, by another distance in each
message, and the arithmetic is the same for all. So messages of equal size and different layout
need no thought, and only the bytes of wanted fields are touched.

Bytes are never trusted. A message that ends before its fields do, or long after them, is left out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.geometry.arrays import Booleans, Indices
from trajeval_ros.io.bags.byte_buffers import Buffer, are_same, bytes_type, gather
from trajeval_ros.io.bags.cdr_steps import Elements, FixedFields, Span, Step, String, steps_of
from trajeval_ros.io.bags.message_definitions import Fields

Numbers = NDArray[Any]
Offsets = int | Indices  # an int as long as it is the same for all: that saves most of the work

# How CDR says that it is encoded: byte order, and the largest alignment (DDS-XTYPES 1.3, 7.6.3.1).
_ENCAPSULATIONS = {0x0000: (">", 8), 0x0001: ("<", 8), 0x0006: (">", 4), 0x0007: ("<", 4)}
_ENCAPSULATION, _ENCAPSULATION_SIZE = np.dtype(">u2"), 4
_LENGTHS = {order: np.dtype(f"{order}u4") for order in "<>"}
_XCDR2_ALIGNMENT = 4
_PADDING = 3  # bytes; writers may fill up to a multiple of four
_ROS1_ALIGNMENT = 1


@dataclass(frozen=True)
class StringColumn:
    """A column of strings: `names[codes[row]]` is the one of a row."""

    names: tuple[str, ...]
    codes: Indices


@dataclass(frozen=True)
class Columns:
    """Fields by column.

    Attributes:
        rows: (N,) int64, increasing: which payload each row is from; of a sequence's elements,
            which row of the enclosing columns.
        numbers: (N,) or (N, k) by field.
        texts: Strings by field.
        sequences: Columns by field; they have a row for each element, in order. A sequence of
            numbers or strings has one column, with the empty name.
    """

    rows: Indices
    numbers: dict[str, Numbers]
    texts: dict[str, StringColumn]
    sequences: dict[str, Columns]


class CdrPlan:
    """How the wanted fields of one type are found in serialised messages."""

    def __init__(
        self, fields: Fields, wanted: Collection[str] | None = None, *, is_ros1: bool = False
    ) -> None:
        """Prepare to decode.

        Args:
            fields: Of the type.
            wanted: Paths of fields, such as `header.frame_id`. Of a nested message that is made
                of one kind of numbers, such as `pose.position`, its path gives one column (N, k).
                None means every field on its own.
            is_ros1: Whether messages are serialised as by ROS 1.

        Raises:
            UnplannedError: There is no such field, or it is no column.
        """
        self._is_ros1 = is_ros1
        names = None if wanted is None else frozenset(wanted)
        alignments = (_ROS1_ALIGNMENT,) if is_ros1 else (8, _XCDR2_ALIGNMENT)
        self._steps = {limit: steps_of(fields, names, limit) for limit in alignments}

    def decode(self, payloads: Sequence[bytes | memoryview]) -> Columns:
        """Return the columns of serialised messages; those that can't be decoded are left out."""
        sizes = np.fromiter(map(len, payloads), np.int64, len(payloads))
        buffer = np.frombuffer(b"".join(payloads), dtype=np.uint8)
        return self.decode_at(buffer, np.cumsum(sizes) - sizes, sizes)

    def decode_at(self, buffer: Buffer, begins: Indices, sizes: Indices) -> Columns:
        """Return the columns of messages that lie in a buffer.

        Args:
            buffer: (B,) bytes.
            begins: (N,) int64, where each message begins.
            sizes: (N,) int64, bytes; all of them lie within the buffer.
        """
        everything = np.arange(len(begins))
        if self._is_ros1:
            batch = _MessageBatch(buffer, "<", _ROS1_ALIGNMENT, everything, begins, sizes)
            return batch.columns(self._steps[_ROS1_ALIGNMENT], padding=0)
        large = sizes >= _ENCAPSULATION_SIZE
        rows = everything if large.all() else everything[large]
        kinds = gather(buffer, begins[rows], _ENCAPSULATION)
        parts = []
        is_one = len(kinds) > 0 and are_same(kinds)
        for kind in kinds[:1].tolist() if is_one else np.unique(kinds).tolist():
            if kind not in _ENCAPSULATIONS:
                continue
            order, limit = _ENCAPSULATIONS[kind]
            some = rows if is_one else rows[kinds == kind]
            origins = begins[some] + _ENCAPSULATION_SIZE
            batch = _MessageBatch(
                buffer, order, limit, some, origins, sizes[some] - _ENCAPSULATION_SIZE
            )
            parts.append(batch.columns(self._steps[limit], padding=_PADDING))
        if len(parts) == 1:
            return parts[0]
        if parts:
            return joined(parts, in_order=True)
        nothing = everything[:0]
        return _MessageBatch(buffer, "<", 8, nothing, nothing, nothing).columns(
            self._steps[8], padding=0
        )


class _MessageBatch:
    """Messages, or elements of sequences, that are walked together.

    Attributes:
        rows: (N,) what each is from: the number of a payload, or one of `ids` of the enclosing
            batch.
        ids: (N,) their own numbers, from 0 for the first of those at the beginning.
        origins: (N,) where in the buffer the payload's first field lies; alignment counts from it.
        rooms: (N,) bytes of the payload from there to its end.
        least_room: At most the least of them.
        most_room: At least the largest of them.
        at: Where the next field is looked for, from the origin.
    """

    def __init__(
        self,
        buffer: Buffer,
        order: str,
        limit: int,
        rows: Indices,
        origins: Indices,
        rooms: Indices,
        at: Offsets = 0,
    ) -> None:
        self.buffer = buffer
        self.order = order
        self.limit = limit
        self.rows = rows
        self.ids = np.arange(len(rows))
        self.origins = origins
        self.rooms = rooms
        self.least_room, self.most_room = 0, 0
        if len(rooms):
            self.least_room, self.most_room = int(rooms.min()), int(rooms.max())
        self.at = at
        self._numbers: list[tuple[Span, Indices]] = []
        self._texts: dict[str, StringColumn] = {}
        self._sequences: dict[str, list[_MessageBatch]] = {}

    def columns(self, steps: tuple[Step, ...], padding: int) -> Columns:
        """Walk, and return the columns of the messages that end where they should."""
        self.walk(steps)
        if not (isinstance(self.at, int) and self.at + padding >= self.most_room):
            self._keep(self.at + padding >= self.rooms)
        return self._gathered()

    def walk(self, steps: tuple[Step, ...]) -> None:
        """Find where the fields are; messages that end before are left out."""
        for step in steps:
            if isinstance(step, FixedFields):
                self._align(step.alignment)
                self._require(step.size)
                for span in step.spans:
                    self._numbers.append((span, self.origins + (self.at + span.offset)))
                self.at = self.at + step.size
            elif isinstance(step, String):
                self._string(step)
            else:
                self._elements(step)

    def _align(self, alignment: int) -> None:
        alignment = min(alignment, self.limit)
        if alignment > 1:
            self.at = (self.at + (alignment - 1)) & -alignment

    def _require(self, size: Offsets) -> None:
        """Leave out the messages that don't have as many bytes left."""
        end = self.at + size
        if isinstance(end, int) and end <= self.least_room:
            return
        self._keep(end <= self.rooms)

    def _keep(self, good: Booleans) -> None:
        """Leave out the messages that aren't good, and what was found in them."""
        if good.all():
            return
        self.rows, self.ids, self.origins = self.rows[good], self.ids[good], self.origins[good]
        self.rooms, self.at = self.rooms[good], _those(self.at, good)
        self._numbers = [(span, places[good]) for span, places in self._numbers]
        self._texts = {
            path: StringColumn(texts.names, texts.codes[good])
            for path, texts in self._texts.items()
        }

    def _count(self, smallest: int) -> Offsets:
        """Read how long the string or the sequence is that comes next.

        Messages without room for as many, of `smallest` bytes each, are left out.
        """
        self._align(4)
        self._require(4)
        numbers = gather(self.buffer, self.origins + self.at, _LENGTHS[self.order])
        counts: Offsets = numbers.astype(np.int64)
        if len(numbers) and are_same(numbers):
            counts = int(numbers[0])
        self.at = self.at + 4
        end = self.at + counts * smallest
        if not (isinstance(end, int) and end <= self.least_room):
            good = np.broadcast_to(end <= self.rooms, self.rows.shape)
            self._keep(good)
            counts = _those(counts, good)
        return counts

    def _string(self, step: String) -> None:
        lengths = self._count(1)
        places = self.origins + self.at
        self.at = self.at + lengths
        if step.path is not None:
            names, codes = _texts(self.buffer, places, lengths, self.limit != _ROS1_ALIGNMENT)
            if isinstance(codes, int) and codes == 0:
                self._texts[step.path] = StringColumn(
                    names, np.zeros(len(self.rows), dtype=np.int64)
                )
            else:
                column = np.array(np.broadcast_to(codes, self.rows.shape))
                self._texts[step.path] = StringColumn(names, column)
                self._keep(column >= 0)

    def _elements(self, step: Elements) -> None:
        if step.is_delimited and self.limit == _XCDR2_ALIGNMENT:
            self._align(4)
            self._require(4)
            self.at = self.at + 4
        count = self._count(step.smallest) if step.count is None else step.count
        counts = np.broadcast_to(count, self.rows.shape)
        if step.path is not None:
            nothing = self._elements_at(self.ids[:0], self.ids[:0])
            nothing.walk(step.steps)
            self._sequences[step.path] = [nothing]
        if step.stride is not None:
            self._equal_elements(step, counts)
        else:
            self._unequal_elements(step, counts)

    def _equal_elements(self, step: Elements, counts: Indices) -> None:
        """Walk elements that all have the same size."""
        run, stride = step.steps[0], step.stride
        assert isinstance(run, FixedFields)
        assert stride is not None
        some = counts > 0
        alignment = min(run.alignment, self.limit)
        first = np.where(some, (self.at + (alignment - 1)) & -alignment, self.at)
        ends = np.where(some, first + (counts - 1) * stride + run.size, self.at)
        fits = ends <= self.rooms
        if not fits.all():
            self._keep(fits)
            first, ends, counts = first[fits], ends[fits], counts[fits]
        if step.path is not None:
            owners, numbers = _repeated(counts)
            batch = self._elements_at(owners, first[owners] + numbers * stride)
            batch.walk(step.steps)
            self._sequences[step.path].append(batch)
        self.at = ends

    def _unequal_elements(self, step: Elements, counts: Indices) -> None:
        """Walk elements whose strings make them as long as they like.

        Where the next element begins is known at the end of the one before. But mostly elements
        resemble each other: so several are looked for at the distance that the last one had,
        twice as many each time that they were all found. An element that ends where the next one
        was looked for proves that one's place, so that nothing rests on the guess.
        """
        left = counts.copy()
        at = np.array(np.broadcast_to(self.at, counts.shape))
        strides = np.zeros(len(counts), dtype=np.int64)
        good = np.ones(len(counts), dtype=bool)
        leap = 1
        while len(open_ := np.flatnonzero(left)):
            tried = np.minimum(left[open_], leap)
            firsts = np.cumsum(tried) - tried
            owners, numbers = _repeated(tried)
            places = at[open_][owners] + numbers * strides[open_][owners]
            batch = self._elements_at(open_[owners], places)
            batch.walk(step.steps)
            ends = np.full(len(places), -1)  # of those that are no elements
            ends[batch.ids] = batch.at
            proven = ends == places + strides[open_][owners]
            found = np.minimum.reduceat(np.where(proven, len(places), numbers), firsts) + 1
            found = np.minimum(found, tried)
            last = firsts + found - 1
            broken = ends[last] < 0
            batch._keep((numbers < found[owners])[batch.ids])
            if step.path is not None:
                self._sequences[step.path].append(batch)
            good[open_[broken]] = False
            at[open_] = ends[last]
            strides[open_] = ends[last] - places[last]
            left[open_] = np.where(broken, 0, left[open_] - found)
            leap = 2 * leap if (found == tried).all() else 1
        self.at = at
        self._keep(good)

    def _elements_at(self, owners: Indices, places: Indices) -> _MessageBatch:
        """Return a batch of elements of the messages `owners` (M,), that begin at `places`."""
        return _MessageBatch(
            self.buffer,
            self.order,
            self.limit,
            self.ids[owners],
            self.origins[owners],
            self.rooms[owners],
            places,
        )

    def _gathered(self) -> Columns:
        """Return the columns of all that is left."""
        numbers = {}
        for span, places in self._numbers:
            cells = gather(self.buffer, places, span.types[self.order])
            for path in span.columns:
                numbers[path] = _usable(cells[path])
        sequences = {}
        for path, batches in self._sequences.items():
            for batch in batches:
                places = np.minimum(np.searchsorted(self.ids, batch.rows), len(self.ids) - 1)
                batch._keep(self.ids[places] == batch.rows if len(self.ids) else batch.rows < 0)
            parts = [batch._gathered() for batch in batches]
            sequence = joined(parts, in_order=True)
            rows = np.searchsorted(self.ids, sequence.rows)
            sequences[path] = dataclasses.replace(sequence, rows=rows)
        return Columns(self.rows, numbers, self._texts, sequences)


def joined(parts: Sequence[Columns], *, in_order: bool = False) -> Columns:
    """Return the columns of several parts one after the other.

    Args:
        parts: At least one, all of the same fields.
        in_order: Whether to sort the rows by payload; rows of the same payload stay as they are.
    """
    first = parts[0]
    if len(parts) == 1:
        return first
    rows = np.concatenate([part.rows for part in parts])
    order = np.argsort(rows, kind="stable") if in_order else np.arange(len(rows))
    moved = np.empty(len(rows), dtype=np.int64)
    moved[order] = np.arange(len(rows))
    befores = np.cumsum([0, *(len(part.rows) for part in parts)])
    sequences = {}
    for path in first.sequences:
        inner = [
            dataclasses.replace(
                part.sequences[path], rows=moved[before + part.sequences[path].rows]
            )
            for part, before in zip(parts, befores, strict=False)
        ]
        sequences[path] = joined(inner, in_order=True)
    return Columns(
        rows[order],
        {
            path: np.concatenate([part.numbers[path] for part in parts])[order]
            for path in first.numbers
        },
        {path: _joined_texts([part.texts[path] for part in parts], order) for path in first.texts},
        sequences,
    )


def _joined_texts(parts: Sequence[StringColumn], order: Any) -> StringColumn:
    names: dict[str, int] = {}
    codes = []
    for part in parts:
        known = [names.setdefault(name, len(names)) for name in part.names]
        codes.append(np.array(known, dtype=np.int64)[part.codes])
    return StringColumn(tuple(names), np.concatenate(codes)[order])


def _usable(column: Numbers) -> Numbers:
    """Return the column in the machine's byte order; any byte but zero is true."""
    if column.dtype == np.bool_:
        return np.asarray(column.view(np.uint8) != 0)
    return column if column.dtype.isnative else column.astype(column.dtype.newbyteorder("="))


def _texts(
    buffer: Buffer, places: Indices, lengths: Offsets, is_terminated: bool
) -> tuple[tuple[str, ...], Offsets]:
    """Return strings at the places (N,): names, and which one each is; -1 is no string."""
    names: dict[str, int] = {}
    if isinstance(lengths, int):
        code = _texts_of_length(buffer, places, lengths, is_terminated, names)
        return tuple(names), code
    codes = np.empty(len(places), dtype=np.int64)
    for length in np.unique(lengths).tolist():
        rows = np.flatnonzero(lengths == length)
        codes[rows] = _texts_of_length(buffer, places[rows], length, is_terminated, names)
    return tuple(names), codes


def _texts_of_length(
    buffer: Buffer, places: Indices, length: int, is_terminated: bool, names: dict[str, int]
) -> Offsets:
    """Return the codes of strings of one length; new ones are added to the names."""
    if not len(places):
        return np.zeros(0, dtype=np.int64)
    if not length:
        return names.setdefault("", len(names))
    cells = gather(buffer, places, bytes_type(length))
    if are_same(cells):
        return _code(cells[0].tobytes(), is_terminated, names)
    contents, which = np.unique(cells.view(f"S{length}"), return_inverse=True)
    # As strings of numpy they lost their zeros at the end, the terminator among them.
    whole = [content.ljust(length, b"\0") for content in contents.tolist()]
    codes = np.array([_code(each, is_terminated, names) for each in whole], dtype=np.int64)
    return np.asarray(codes[which])


def _code(content: bytes, is_terminated: bool, names: dict[str, int]) -> int:
    """Return the code of a string, -1 if it is none."""
    if is_terminated:
        if content[-1]:
            return -1
        content = content[:-1]
    try:
        return names.setdefault(content.decode(), len(names))
    except UnicodeDecodeError:
        return -1


def _those(offsets: Offsets, good: Booleans) -> Offsets:
    return offsets if isinstance(offsets, int) else offsets[good]


def _repeated(counts: Indices) -> tuple[Indices, Indices]:
    """Return, for each of `counts` things, its owner and its number among the owner's things."""
    owners = np.repeat(np.arange(len(counts)), counts)
    return owners, np.arange(len(owners)) - (np.cumsum(counts) - counts)[owners]
