"""Serialised messages to columns: CDR of both endiannesses, plain XCDR2, and ROS 1.

`cdr_steps` plans the steps from a type's definition, which are applied to all messages of a batch
at once, field by field. The position where a field starts is a column with one offset per message.
Strings and sequences move the fields after them by another distance in every message, and the
arithmetic is the same for all. Therefore messages of equal size and different layout need no
special case, and only the bytes of requested fields are read. The bytes are untrusted: a message
that is shorter or longer than its fields is left out.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Collection, Sequence

import numpy as np

from trajeval_ros.geometry.arrays import Booleans, Indices
from trajeval_ros.io.bags.blocks import Buffer, are_same, gather
from trajeval_ros.io.bags.cdr_columns import (
    Columns,
    Numbers,
    Offsets,
    StringColumn,
    joined,
    texts_at,
)
from trajeval_ros.io.bags.cdr_steps import Elements, FixedFields, Span, Step, String, steps_of
from trajeval_ros.io.bags.message_definitions import STANDARD, Fields, UnplannedError, ros1_fields

XCDR2_ALIGNMENT = 4  # bytes, the largest of a field
ROS1_ALIGNMENT = 1
_LENGTHS = {order: np.dtype(f"{order}u4") for order in "<>"}
# Byte order and largest alignment by encapsulation of CDR (DDS-XTYPES 1.3, 7.6.3.1).
_ENCAPSULATIONS = {0x0000: (">", 8), 0x0001: ("<", 8), 0x0006: (">", 4), 0x0007: ("<", 4)}
_ENCAPSULATION, _ENCAPSULATION_SIZE = np.dtype(">u2"), 4
_PADDING = 3  # bytes; writers may fill up to a multiple of four


class MessageBatch:
    """Messages, or elements of sequences, that are decoded together."""

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
        self.rows = rows  # (N,) the payload's number, or an id of the enclosing batch for elements
        # (N,) numbers of the messages in this batch, counted before any is left out.
        self.ids = np.arange(len(rows))
        # (N,) offsets of the first fields in the buffer. Alignment counts from there.
        self.origins = origins
        self.rooms = rooms  # (N,) bytes from the origin to the end of the payload
        self.least_room, self.most_room = 0, 0  # bounds of `rooms`
        if len(rooms):
            self.least_room, self.most_room = int(rooms.min()), int(rooms.max())
        self.at = at  # position of the next field, counted from the origin
        self._numbers: list[tuple[Span, Indices]] = []
        self._texts: dict[str, StringColumn] = {}
        self._sequences: dict[str, list[MessageBatch]] = {}

    def columns(self, steps: tuple[Step, ...], padding: int) -> Columns:
        """Decode, and return the columns of the messages that have the expected size."""
        self.walk(steps)
        if not (isinstance(self.at, int) and self.at + padding >= self.most_room):
            self._keep(self.at + padding >= self.rooms)
        return self._gathered()

    def walk(self, steps: tuple[Step, ...]) -> None:
        """Find the positions of the fields. Messages that are too short are left out."""
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
        """Leave out the messages with fewer than `size` bytes left."""
        end = self.at + size
        if isinstance(end, int) and end <= self.least_room:
            return
        self._keep(end <= self.rooms)

    def _keep(self, good: Booleans) -> None:
        """Leave out the other messages, and the fields found in them."""
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
        """Read the length of the string or sequence at the current position.

        Messages with less room than `smallest` bytes per element are left out.
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
            names, codes = texts_at(self.buffer, places, lengths, self.limit != ROS1_ALIGNMENT)
            if isinstance(codes, int) and codes == 0:
                self._texts[step.path] = StringColumn(
                    names, np.zeros(len(self.rows), dtype=np.int64)
                )
            else:
                column = np.array(np.broadcast_to(codes, self.rows.shape))
                self._texts[step.path] = StringColumn(names, column)
                self._keep(column >= 0)

    def _elements(self, step: Elements) -> None:
        if step.is_delimited and self.limit == XCDR2_ALIGNMENT:
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
        """Decode elements of equal size."""
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
        """Decode elements of different sizes, because they contain strings.

        The position of an element is the end of the previous one. Most elements have the same
        size. Therefore several elements are tried at the distance of the last one, twice as many
        after every complete success. A tried position is accepted only if the previous element
        ends there.
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
            ends = np.full(len(places), -1)  # -1: not an element
            ends[batch.ids] = batch.at
            proven = ends == places + strides[open_][owners]
            element_counts = (
                np.minimum.reduceat(np.where(proven, len(places), numbers), firsts) + 1
            )
            element_counts = np.minimum(element_counts, tried)
            last = firsts + element_counts - 1
            broken = ends[last] < 0
            batch._keep((numbers < element_counts[owners])[batch.ids])
            if step.path is not None:
                self._sequences[step.path].append(batch)
            good[open_[broken]] = False
            at[open_] = ends[last]
            strides[open_] = ends[last] - places[last]
            left[open_] = np.where(broken, 0, left[open_] - element_counts)
            leap = 2 * leap if (element_counts == tried).all() else 1
        self.at = at
        self._keep(good)

    def _elements_at(self, owners: Indices, places: Indices) -> MessageBatch:
        """Return a batch of elements (M,) of the messages `owners`, that start at `places`."""
        return MessageBatch(
            self.buffer,
            self.order,
            self.limit,
            self.ids[owners],
            self.origins[owners],
            self.rooms[owners],
            places,
        )

    def _gathered(self) -> Columns:
        """Return the columns of the remaining messages."""
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


def _usable(column: Numbers) -> Numbers:
    """Return the column in the machine's byte order. Nonzero bytes of booleans are true."""
    if column.dtype == np.bool_:
        return np.asarray(column.view(np.uint8) != 0)
    return column if column.dtype.isnative else column.astype(column.dtype.newbyteorder("="))


def _those(offsets: Offsets, good: Booleans) -> Offsets:
    return offsets if isinstance(offsets, int) else offsets[good]


def _repeated(counts: Indices) -> tuple[Indices, Indices]:
    """Return the owner of every element, and its number among the owner's elements."""
    owners = np.repeat(np.arange(len(counts)), counts)
    return owners, np.arange(len(owners)) - (np.cumsum(counts) - counts)[owners]


class CdrPlan:
    """How the requested fields of one type are decoded from serialised messages."""

    def __init__(
        self, fields: Fields, requested: Collection[str] | None = None, *, is_ros1: bool = False
    ) -> None:
        """Prepare to decode.

        `requested`: paths of fields, such as `header.frame_id`. The path of a nested message with
        numbers of one type, such as `pose.position`, gives one column (N, k). None means one
        column per field.

        Raises:
            UnplannedError: A field does not exist, or is not one column.
        """
        self._is_ros1 = is_ros1
        names = None if requested is None else frozenset(requested)
        alignments = (ROS1_ALIGNMENT,) if is_ros1 else (8, XCDR2_ALIGNMENT)
        self._steps = {limit: steps_of(fields, names, limit) for limit in alignments}

    def decode(self, payloads: Sequence[bytes | memoryview]) -> Columns:
        """Return the columns of serialised messages; those that can't be decoded are left out."""
        sizes = np.fromiter(map(len, payloads), np.int64, len(payloads))
        buffer = np.frombuffer(b"".join(payloads), dtype=np.uint8)
        return self.decode_at(buffer, np.cumsum(sizes) - sizes, sizes)

    def decode_at(self, buffer: Buffer, begins: Indices, sizes: Indices) -> Columns:
        """Return the columns of messages that lie in a buffer.

        `buffer`: (B,) bytes. `begins`: (N,) int64, offsets of the messages. `sizes`: (N,) int64,
        bytes. All messages end within the buffer.
        """
        everything = np.arange(len(begins))
        if self._is_ros1:
            batch = MessageBatch(buffer, "<", ROS1_ALIGNMENT, everything, begins, sizes)
            return batch.columns(self._steps[ROS1_ALIGNMENT], padding=0)
        large = sizes >= _ENCAPSULATION_SIZE
        rows = everything if large.all() else everything[large]
        kinds = gather(buffer, begins[rows], _ENCAPSULATION)
        parts = []
        is_one = len(kinds) > 0 and are_same(kinds)
        for kind in kinds[:1].tolist() if is_one else sorted(set(kinds.tolist())):
            if kind not in _ENCAPSULATIONS:
                continue
            order, limit = _ENCAPSULATIONS[kind]
            some = rows if is_one else rows[kinds == kind]
            origins = begins[some] + _ENCAPSULATION_SIZE
            batch = MessageBatch(
                buffer, order, limit, some, origins, sizes[some] - _ENCAPSULATION_SIZE
            )
            parts.append(batch.columns(self._steps[limit], padding=_PADDING))
        if len(parts) == 1:
            return parts[0]
        if parts:
            return joined(parts, in_order=True)
        nothing = everything[:0]
        return MessageBatch(buffer, "<", 8, nothing, nothing, nothing).columns(
            self._steps[8], padding=0
        )


def plan_with(
    fields: Fields | None, standard: str, requested: Collection[str], *, is_ros1: bool
) -> CdrPlan:
    """Return how a type is decoded, by its own definition if that has the required fields.

    `fields`: of the type, as a bag defines it. `standard`: name of the type in `STANDARD`.
    """
    if fields is not None:
        with contextlib.suppress(UnplannedError):
            return CdrPlan(fields, requested, is_ros1=is_ros1)
    known = STANDARD[standard]
    return CdrPlan(ros1_fields(known) if is_ros1 else known, requested, is_ros1=is_ros1)
