"""Poses, transforms and GNSS fixes by Foxglove's own schemas, in JSON and protobuf.

The fields have no fixed positions in either encoding. Therefore messages are parsed one by one and
then converted to the same columns as messages of ROS.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.util import find_spec
from itertools import chain
from operator import attrgetter
from types import SimpleNamespace
from typing import Any

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Indices
from trajeval_ros.io.bags.blocks import Buffer, block_of
from trajeval_ros.io.bags.cdr_columns import Columns, StringColumn

POSE_TYPE = "foxglove.PoseInFrame"
TRANSFORM_TYPES = ("foxglove.FrameTransform", "foxglove.FrameTransforms")
FIX_TYPE = "foxglove.LocationFix"
TYPES = (POSE_TYPE, *TRANSFORM_TYPES, FIX_TYPE)
ENCODINGS = ("json", "protobuf")
EXTRA = "foxglove"

_SECONDS = range(-(2**31), 2**32)  # as many as those of either ROS
_NANOSECONDS = range(2**32)
_IN_JSON = attrgetter("timestamp.sec", "timestamp.nsec")
_IN_PROTOBUF = attrgetter("timestamp.seconds", "timestamp.nanos")
_POSE = attrgetter(
    "frame_id",
    *(f"pose.position.{axis}" for axis in "xyz"),
    *(f"pose.orientation.{axis}" for axis in "xyzw"),
)
_TRANSFORM = attrgetter(
    "parent_frame_id",
    "child_frame_id",
    *(f"translation.{axis}" for axis in "xyz"),
    *(f"rotation.{axis}" for axis in "xyzw"),
)
_FIX = attrgetter("frame_id", "latitude", "longitude", "altitude", "position_covariance_type")
_FIX_NUMBERS = 13  # place, type of covariance, covariance
# Stamp (s, ns), frames (only a transform has two), and numbers: seven, or those of a fix.
_Row = tuple[tuple[int, ...], tuple[str, ...], tuple[float, ...]]


def is_decodable(encoding: str) -> bool:
    """Return whether the packages that decode an encoding are installed."""
    return encoding == "json" or (
        encoding == "protobuf" and find_spec("foxglove_schemas_protobuf") is not None
    )


class FoxglovePlan:
    """How messages of one type and encoding become the columns of their counterpart in ROS."""

    def __init__(self, message_type: str, encoding: str) -> None:
        self._parse = _from_json if encoding == "json" else _from_protobuf(message_type)
        self._stamp = _IN_JSON if encoding == "json" else _IN_PROTOBUF
        self._type = message_type

    def decode(self, payloads: Sequence[bytes | memoryview]) -> Columns:
        """Return the columns of messages; those that can't be decoded are left out."""
        block = block_of([], [], payloads)
        return self.decode_at(block.buffer, block.begins, block.sizes)

    def decode_at(self, buffer: Buffer, begins: Indices, sizes: Indices) -> Columns:
        """Return the columns of messages in a buffer; see `CdrPlan.decode_at`."""
        whole = memoryview(buffer.data)
        good: list[int] = []
        parsed: list[list[_Row]] = []
        for row, (begin, size) in enumerate(zip(begins.tolist(), sizes.tolist(), strict=True)):
            try:
                parsed.append(self._rows(self._parse(bytes(whole[begin : begin + size]))))
            except (ValueError, AttributeError, TypeError, OverflowError, RecursionError):
                continue
            good.append(row)
        rows = np.array(good, dtype=np.int64)
        owners = np.repeat(np.arange(len(good)), [len(item) for item in parsed])
        elements = self._columns(owners, list(chain.from_iterable(parsed)))
        if self._type not in TRANSFORM_TYPES:
            return replace(elements, rows=rows)
        return Columns(rows, {}, {}, {"transforms": elements})

    def _rows(self, message: Any) -> list[_Row]:
        """Return the rows of a message; a field can be missing or of the wrong kind."""
        if self._type == POSE_TYPE:
            return [self._row(message, _POSE, 1)]
        if self._type == FIX_TYPE:
            covariance = tuple(message.position_covariance) or (0.0,) * 9
            row = self._row(message, lambda item: (*_FIX(item), *covariance), 1)
            if len(row[2]) != _FIX_NUMBERS:
                raise ValueError("a covariance has a wrong size")
            return [row]
        several = message.transforms if self._type == TRANSFORM_TYPES[1] else [message]
        return [self._row(item, _TRANSFORM, 2) for item in several]

    def _row(self, message: Any, fields: Callable[[Any], tuple[Any, ...]], frames: int) -> _Row:
        stamp, values = self._stamp(message), fields(message)
        names, numbers = values[:frames], values[frames:]
        if not (
            all(type(item) is int for item in stamp)
            and stamp[0] in _SECONDS
            and stamp[1] in _NANOSECONDS
            and all(type(name) is str for name in names)
            and all(type(number) in (int, float) for number in numbers)
        ):
            raise ValueError("a field has a wrong type")
        return stamp, names, tuple(map(float, numbers))

    def _columns(self, owners: Indices, rows: list[_Row]) -> Columns:
        width = _FIX_NUMBERS if self._type == FIX_TYPE else 7
        stamps = np.array([stamp for stamp, _, _ in rows], dtype=np.int64).reshape(-1, 2)
        numbers = np.array([numbers for _, _, numbers in rows], dtype=np.float64)
        numbers = numbers.reshape(-1, width)
        texts = {"header.frame_id": _texts([names[0] for _, names, _ in rows])}
        if self._type in TRANSFORM_TYPES:
            texts["child_frame_id"] = _texts([names[1] for _, names, _ in rows])
        return Columns(
            owners,
            {
                "header.stamp.sec": stamps[:, 0],
                "header.stamp.nanosec": stamps[:, 1],
                **self._numbers(numbers),
            },
            texts,
            {},
        )

    def _numbers(self, numbers: Floats) -> dict[str, Floats]:
        """Return the columns of numbers by the names of their counterparts in ROS."""
        if self._type == FIX_TYPE:
            return {
                **dict(zip(("latitude", "longitude", "altitude"), numbers.T, strict=False)),
                "status.status": np.zeros(len(numbers)),  # the schema has none
                "position_covariance_type": numbers[:, 3],
                "position_covariance": numbers[:, 4:],
            }
        if self._type == POSE_TYPE:
            return {"pose.position": numbers[:, :3], "pose.orientation": numbers[:, 3:]}
        return {"transform.translation": numbers[:, :3], "transform.rotation": numbers[:, 3:]}


def _texts(column: list[str]) -> StringColumn:
    codes: dict[str, int] = {}
    rows = [codes.setdefault(name, len(codes)) for name in column]
    # JSON can contain lone surrogates, which can't be printed.
    names = tuple(name.encode("utf-8", "replace").decode() for name in codes)
    return StringColumn(names, np.array(rows, dtype=np.int64))


def _from_json(payload: bytes) -> Any:
    return json.loads(payload, object_hook=lambda fields: SimpleNamespace(**fields))


def _from_protobuf(message_type: str) -> Callable[[bytes], Any]:
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
    from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
    from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
    from google.protobuf.message import DecodeError

    kinds: tuple[Any, ...] = (PoseInFrame, FrameTransform, FrameTransforms, LocationFix)
    kind = dict(zip(TYPES, kinds, strict=True))[message_type]

    def parse(payload: bytes) -> Any:
        try:
            return kind.FromString(payload)
        except DecodeError as error:
            raise ValueError("it is not a message of this type") from error

    return parse
