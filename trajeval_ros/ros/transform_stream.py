"""The pose of one frame in another out of live transforms, as `/tf` carries them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.messages import decode_transforms
from trajeval_ros.io.transforms import Edge, EdgeKey, chain
from trajeval_ros.online.pairing import states
from trajeval_ros.ros.poses import PoseStream, States
from trajeval_ros.trajectory import NANOSECONDS

Stamps = NDArray[np.int64]
Floats = NDArray[np.float64]

_MEMORY_S = 10.0  # for edges that lag behind the others
_MOST_EDGES = 1000  # of trees that are not ours


class TransformStream(PoseStream):
    """Chains the edges between two frames at the stamps of the most frequent one.

    A pose is known when all edges have reached its stamp, as offline.
    """

    def __init__(self, source: str, parent: str, child: str) -> None:
        """Begin, for the pose of `child` in `parent`."""
        super().__init__(source)
        self.told.frame, self.told.child_frame = parent, child
        self.told.note("format: TF")
        self._source, self._parent, self._child = source, parent, child
        self._moving: dict[EdgeKey, tuple[Stamps, Floats]] = {}
        self._static: dict[EdgeKey, Edge] = {}
        self._until = np.iinfo(np.int64).min

    def poses(self, message_type: str, payloads: Sequence[bytes], arrived_ns: Stamps) -> States:
        """Return the states that have become known with new messages."""
        del message_type
        edges, undecodable = decode_transforms(payloads)
        self.told.drop("undecodable", undecodable)
        for key, columns in edges.items():
            if len(self._moving) < _MOST_EDGES or key in self._moving:
                self._extend(key, columns.stamps, columns.numbers)
        found = self._chained()
        if len(found.stamps):
            self.arrivals.see(found.stamps[-1:], arrived_ns[-1:])
        self._count(found)
        return found

    def hold(self, payloads: Sequence[bytes]) -> None:
        """Take static transforms."""
        edges, undecodable = decode_transforms(payloads)
        self.told.drop("undecodable", undecodable)
        for key, columns in edges.items():
            if len(self._static) < _MOST_EDGES or key in self._static:
                self._static[key] = Edge.from_columns(columns.stamps, columns.numbers, True)

    def _extend(self, key: EdgeKey, stamps: Stamps, numbers: Floats) -> None:
        """Add transforms to an edge, and forget those of long ago."""
        if key in self._moving:
            held_stamps, held = self._moving[key]
            stamps, numbers = np.concatenate([held_stamps, stamps]), np.vstack([held, numbers])
        recent = stamps > stamps.max() - round(_MEMORY_S * NANOSECONDS)
        self._moving[key] = stamps[recent], numbers[recent]

    def _chained(self) -> States:
        edges = {
            key: Edge.from_columns(*columns, is_static=False)
            for key, columns in self._moving.items()
        }
        none = np.empty(0, dtype=np.int64)
        try:
            stamps, positions, quaternions = chain(
                {**self._static, **edges}, self._parent, self._child, self._source
            )
        except InputError as error:
            self.trouble = str(error)
            return States(none, states(np.empty((0, 3))), none)
        self.trouble = ""
        new = stamps > self._until
        if new.any():
            self._until = int(stamps[new][-1])
        found = states(positions[new], quaternions[new])
        return States(stamps[new], found, np.zeros(len(found), dtype=np.int64))
