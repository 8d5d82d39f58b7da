"""The pose between two frames of recorded transforms."""

from __future__ import annotations

from collections.abc import Mapping

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.io.bags.transform_tree import Edge, EdgeKey, compose, find_chain


def compose_transforms(
    edges: Mapping[EdgeKey, Edge], parent: str, child: str, where: str
) -> tuple[Stamps, Floats, Floats]:
    """Return timestamps, positions and quaternions of `child` in `parent`."""
    way, _, stamps = find_chain(edges, parent, child, where)
    return (stamps, *compose(edges, way, stamps))
