"""The TF tree without ROS: the pose of one frame in another over time."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros import lie
from trajeval_ros.exceptions import InputError
from trajeval_ros.io.checks import nearest

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]
EdgeKey = tuple[str, str]


@dataclass(frozen=True)
class Edge:
    """The pose of a child frame in its parent frame over time.

    Attributes:
        stamps: (N,) int64, nanoseconds, increasing.
        translations: (N, 3), metres.
        quaternions: (N, 4), xyzw, unit.
        is_static: Whether the pose holds for all times; then N = 1.
    """

    stamps: Stamps
    translations: Floats
    quaternions: Floats
    is_static: bool

    @classmethod
    def from_columns(cls, stamps: Stamps, numbers: Floats, is_static: bool) -> Edge:
        """Make an edge of transforms as they arrived.

        Args:
            stamps: (N,) int64, nanoseconds.
            numbers: (N, 7): translation, quaternion xyzw.
            is_static: Whether they came by `/tf_static`; then the last one holds.

        Transforms that aren't poses are left out, of several with the same stamp all but the
        last.
        """
        lengths = np.linalg.norm(numbers[:, 3:], axis=1)
        usable = np.isfinite(numbers).all(axis=1) & (lengths > 1e-6)
        stamps, numbers, lengths = stamps[usable], numbers[usable], lengths[usable]
        if is_static:
            rows = np.arange(len(stamps))[-1:]
        else:
            _, from_the_end = np.unique(stamps[::-1], return_index=True)
            rows = len(stamps) - 1 - from_the_end
        return cls(
            stamps[rows],
            numbers[rows, :3],
            numbers[rows, 3:] / lengths[rows, None],
            is_static,
        )

    def at(self, stamps: Stamps) -> tuple[Floats, Floats]:
        """Return translations (M, 3) and quaternions (M, 4) at stamps (M,) within its span."""
        if self.is_static:
            shape = (len(stamps), 1)
            return np.tile(self.translations, shape), np.tile(self.quaternions, shape)
        after = np.searchsorted(self.stamps, stamps, side="left")
        before = np.where(self.stamps[after] == stamps, after, after - 1)
        step = np.where(after > before, self.stamps[after] - self.stamps[before], 1)
        fraction = (stamps - self.stamps[before]) / step
        start, end = self.translations[before], self.translations[after]
        return (
            start + fraction[:, None] * (end - start),
            lie.slerp(self.quaternions[before], self.quaternions[after], fraction),
        )


def chain(
    edges: Mapping[EdgeKey, Edge], parent: str, child: str, where: str
) -> tuple[Stamps, Floats, Floats]:
    """Return the pose of `child` in `parent` over time: stamps, positions and quaternions xyzw.

    The stamps are those of the most frequent edge between the two frames, as far as all edges
    reach; the other edges are interpolated there, and never extrapolated.

    Args:
        edges: Edges by (parent, child).
        parent: A frame, without leading slash.
        child: Another one; the edges between them may point either way.
        where: What to call the source in an error.

    Raises:
        InputError: A frame is unknown, they aren't connected, or the edges don't overlap in time.
    """
    path = _path(edges, parent, child, where)
    moving = [edges[key] for key, _ in path if not edges[key].is_static]
    if not moving:
        raise InputError(
            f"{where}: {child} never moves in {parent}, all transforms between them are static; "
            "name a frame that moves"
        )
    begin = max(int(edge.stamps[0]) for edge in moving)
    end = min(int(edge.stamps[-1]) for edge in moving)
    within = [edge.stamps[(edge.stamps >= begin) & (edge.stamps <= end)] for edge in moving]
    stamps = max(within, key=len)
    if not len(stamps):
        raise InputError(
            f"{where}: the transforms between {parent} and {child} were never known at the same "
            "time; name two frames closer to each other"
        )
    translation = np.zeros((len(stamps), 3))
    quaternion = np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps), 1))
    for key, forwards in path:
        next_translation, next_quaternion = edges[key].at(stamps)
        if not forwards:
            next_quaternion = lie.conjugate(next_quaternion)
            next_translation = -lie.rotate(next_quaternion, next_translation)
        translation = translation + lie.rotate(quaternion, next_translation)
        quaternion = lie.multiply(quaternion, next_quaternion)
    return stamps, translation, quaternion


def _path(
    edges: Mapping[EdgeKey, Edge], parent: str, child: str, where: str
) -> list[tuple[EdgeKey, bool]]:
    """Return the shortest way from parent to child: edges, and whether each points that way."""
    neighbours: dict[str, list[tuple[str, EdgeKey, bool]]] = {}
    for key, edge in edges.items():
        if len(edge.stamps):
            neighbours.setdefault(key[0], []).append((key[1], key, True))
            neighbours.setdefault(key[1], []).append((key[0], key, False))
    for frame in (parent, child):
        if frame not in neighbours:
            known = nearest(frame, neighbours)
            raise InputError(f"{where}: there is no frame {frame}; there are {known}")
    came_by: dict[str, tuple[str, EdgeKey, bool] | None] = {parent: None}
    waiting = deque([parent])
    while waiting:
        frame = waiting.popleft()
        for neighbour, key, forwards in neighbours[frame]:
            if neighbour not in came_by:
                came_by[neighbour] = (frame, key, forwards)
                waiting.append(neighbour)
    if child not in came_by:
        connected = ", ".join(sorted(set(came_by) - {parent}))
        raise InputError(
            f"{where}: {child} is not connected to {parent}; connected to {parent} are {connected}"
        )
    path = []
    step = came_by[child]
    while step is not None:
        frame, key, forwards = step
        path.append((key, forwards))
        step = came_by[frame]
    return path[::-1]
