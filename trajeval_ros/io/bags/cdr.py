"""Serialised messages to columns: CDR of both endiannesses, plain XCDR2, and ROS 1.

`cdr_steps` plans the steps from a type's definition. `cdr_batch` applies them to all messages of a
batch at once. The bytes are untrusted: a message that is shorter or longer than its fields is left
out.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Sequence

import numpy as np

from trajeval_ros.geometry.arrays import Indices
from trajeval_ros.io.bags.blocks import Buffer, are_same, gather
from trajeval_ros.io.bags.cdr_batch import ROS1_ALIGNMENT, XCDR2_ALIGNMENT, MessageBatch
from trajeval_ros.io.bags.cdr_columns import Columns, joined
from trajeval_ros.io.bags.cdr_steps import steps_of
from trajeval_ros.io.bags.message_definitions import STANDARD, Fields, UnplannedError, ros1_fields

# Byte order and largest alignment by encapsulation of CDR (DDS-XTYPES 1.3, 7.6.3.1).
_ENCAPSULATIONS = {0x0000: (">", 8), 0x0001: ("<", 8), 0x0006: (">", 4), 0x0007: ("<", 4)}
_ENCAPSULATION, _ENCAPSULATION_SIZE = np.dtype(">u2"), 4
_PADDING = 3  # bytes; writers may fill up to a multiple of four


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
