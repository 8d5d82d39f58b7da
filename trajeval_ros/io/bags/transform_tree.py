"""The TF tree without ROS: the pose of one frame in another over time."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.trajectory import NANOSECONDS
from trajeval_ros.geometry.valid_poses import valid_mask
from trajeval_ros.io.checks import nearest, times

EdgeKey = tuple[str, str]
Way = list[tuple[EdgeKey, bool]]  # edges in order, and whether each points from parent to child

LEADS_BY_S = 2.0  # of transforms, by which the leading edge is known


@dataclass(frozen=True, eq=False)
class Edge:
    """The pose of a child frame in its parent frame over time."""

    stamps: Stamps  # (N,) int64, nanoseconds, increasing
    translations: Floats  # (N, 3), metres
    quaternions: Floats  # (N, 4), xyzw, unit
    is_static: bool  # whether the pose holds for all times; then N = 1

    @classmethod
    def from_columns(cls, stamps: Stamps, numbers: Floats, is_static: bool) -> Edge:
        """Make an edge of transforms as they arrived.

        `stamps`: (N,) int64, nanoseconds. `numbers`: (N, 7): translation, quaternion xyzw.
        `is_static`: whether they are from `/tf_static`; then the last one is used.

        Transforms that are not poses or have no time are left out. Of several transforms with
        the same stamp, the last one is used.
        """
        finite, is_rotation = valid_mask(numbers[:, :3], numbers[:, 3:])
        usable = finite & is_rotation & (is_static | times(stamps))
        stamps, numbers = stamps[usable], numbers[usable]
        lengths = np.linalg.norm(numbers[:, 3:], axis=1)
        everything = cls(stamps, numbers[:, :3], numbers[:, 3:] / lengths[:, None], is_static)
        return everything[np.arange(len(stamps))[-1:] if is_static else _last_of_each(stamps)]

    def __getitem__(self, rows: NDArray[np.intp] | slice) -> Edge:
        """Return the edge with some of its transforms."""
        return Edge(
            self.stamps[rows], self.translations[rows], self.quaternions[rows], self.is_static
        )

    def joined(self, later: Edge) -> Edge:
        """Return this edge with later transforms, which replace those with equal stamps."""
        stamps = np.concatenate([self.stamps, later.stamps])
        translations = np.concatenate([self.translations, later.translations])
        quaternions = np.concatenate([self.quaternions, later.quaternions])
        return Edge(stamps, translations, quaternions, self.is_static)[_last_of_each(stamps)]

    def since(self, stamp: int) -> Edge:
        """Return the transforms from a stamp on, and the one before it."""
        return self[max(int(self.stamps.searchsorted(stamp, side="right")) - 1, 0) :]

    def within(self, begin: int, end: int) -> Stamps:
        """Return its stamps from begin to end, both included."""
        return self.stamps[(self.stamps >= begin) & (self.stamps <= end)]

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


def find_chain(
    edges: Mapping[EdgeKey, Edge], parent: str, child: str, where: str
) -> tuple[Way, EdgeKey, Stamps]:
    """Return the way from `parent` to `child`, its leading edge, and the stamps of the poses.

    The stamps are those of the leading edge between the two frames, within the common time span of
    all edges. The other edges are interpolated there, and never extrapolated. `parent`: a frame,
    without leading slash. `child`: another one. The edges between them can have either direction.
    """
    way = find_way([key for key, edge in edges.items() if len(edge.stamps)], parent, child, where)
    span = common_span(edges, way)
    if span is None:
        raise InputError(
            f"{where}: all transforms between {parent} and {child} are static; choose a moving "
            "frame"
        )
    if span[0] > span[1]:
        raise InputError(
            f"{where}: the transforms between {parent} and {child} have no common time span; "
            "choose two frames closer in the tree"
        )
    leading = leading_edge(edges, way, span)
    return way, leading, edges[leading].within(*span)


def fixed_transform(
    edges: Mapping[EdgeKey, Edge], parent: str, child: str, where: str
) -> tuple[Floats, Floats]:
    """Return the pose of `child` in `parent`, which never changes: position (3,), xyzw (4,).

    `edges`: edges by (parent, child). Moving edges are not used. `parent`: a frame, without
    leading slash. `child`: another one. The edges between them can have either direction.
    """
    way = find_way([key for key, edge in edges.items() if edge.is_static], parent, child, where)
    position, quaternion = compose(edges, way, np.zeros(1, dtype=np.int64))
    return position[0], quaternion[0]


def common_span(edges: Mapping[EdgeKey, Edge], way: Way) -> tuple[int, int] | None:
    """Return the first and last stamp common to all moving edges; None if none moves.

    The first is after the last if the edges have no common time span.
    """
    moving = [edges[key].stamps for key, _ in way if not edges[key].is_static]
    if not moving:
        return None
    return max(int(item[0]) for item in moving), min(int(item[-1]) for item in moving)


def leading_edge(edges: Mapping[EdgeKey, Edge], way: Way, span: tuple[int, int]) -> EdgeKey:
    """Return the moving edge whose stamps the poses have.

    It is the most frequent one in the first `LEADS_BY_S` of the span. Thus it is the same in live
    and recorded evaluations.
    """
    begin, end = span
    end = min(end, begin + round(LEADS_BY_S * NANOSECONDS))
    moving = [key for key, _ in way if not edges[key].is_static]
    return max(moving, key=lambda key: len(edges[key].within(begin, end)))


def compose(edges: Mapping[EdgeKey, Edge], way: Way, stamps: Stamps) -> tuple[Floats, Floats]:
    """Return positions (N, 3) and quaternions (N, 4) along a way, at stamps (N,) in its span."""
    translation = np.zeros((len(stamps), 3))
    quaternion = np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps), 1))
    for key, forwards in way:
        next_translation, next_quaternion = edges[key].at(stamps)
        if not forwards:
            next_quaternion = lie.conjugate(next_quaternion)
            next_translation = -lie.rotate(next_quaternion, next_translation)
        translation = translation + lie.rotate(quaternion, next_translation)
        quaternion = lie.multiply(quaternion, next_quaternion)
    return translation, quaternion


def find_way(keys: Iterable[EdgeKey], parent: str, child: str, where: str) -> Way:
    """Return the shortest way from parent to child."""
    neighbours: dict[str, list[tuple[str, EdgeKey, bool]]] = {}
    for key in keys:
        neighbours.setdefault(key[0], []).append((key[1], key, True))
        neighbours.setdefault(key[1], []).append((key[0], key, False))
    for frame in (parent, child):
        if frame not in neighbours:
            known = nearest(frame, neighbours)
            raise InputError(f"{where}: unknown frame {frame}; use one of {known}")
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
        raise InputError(f"{where}: {child} is not connected to {parent}; use one of {connected}")
    way = []
    step = came_by[child]
    while step is not None:
        frame, key, forwards = step
        way.append((key, forwards))
        step = came_by[frame]
    return way[::-1]


def _last_of_each(stamps: Stamps) -> NDArray[np.intp]:
    """Return the last row of every different stamp, in order of the stamps."""
    _, from_the_end = np.unique(stamps[::-1], return_index=True)
    return len(stamps) - 1 - from_the_end
