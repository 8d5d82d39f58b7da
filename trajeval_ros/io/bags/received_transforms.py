"""The pose between two frames as a receiver knows it.

Every transform holds from its reception on. Corrections such as map to odom may be dated into the
future or the past; a receiver uses the newest one that it has, whatever its timestamp.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.geometry.reading import Reading
from trajeval_ros.geometry.receptions import Receptions
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.transform_tree import (
    Edge,
    EdgeKey,
    common_span,
    compose,
    find_way,
    leading_edge,
)


class ReceivedEdge(NamedTuple):
    """The transforms of a moving edge in the order of their reception."""

    stamps: Stamps  # (N,) nanoseconds
    numbers: Floats  # (N, 7): translation, quaternion xyzw
    receptions: Receptions  # of N


def compose_received(
    edges: Mapping[EdgeKey, Edge],
    received: Mapping[EdgeKey, ReceivedEdge],
    parent: str,
    child: str,
) -> Trajectory:
    """Return the pose of `child` in `parent` at every reception of one of its transforms.

    Timestamps are of the newest transform of the leading edge; one repeats if only a correction is
    new.
    """
    way = find_way([key for key, edge in edges.items() if len(edge.stamps)], parent, child, "")
    span = common_span(edges, way)
    assert span is not None
    leading = leading_edge(edges, way, span)
    moving = [key for key, _ in way if not edges[key].is_static]
    times = np.unique(np.concatenate([received[key].receptions.times for key in moving]))
    begin = max(int(received[key].receptions.times.min()) for key in moving)
    times = times[times >= begin]
    held, stamps = dict(edges), times
    corrected = None
    for key in moving:
        arrived = received[key]
        order = np.argsort(arrived.receptions.times, kind="stable")
        if key == leading:  # late messages are never in use
            newest = np.maximum.accumulate(arrived.stamps[order])
            order = order[np.diff(newest, prepend=newest[0] - 1) > 0]
        row = order[arrived.receptions.times[order].searchsorted(times, side="right") - 1]
        if key == leading:
            stamps = arrived.stamps[row]
        else:
            since = arrived.receptions.times[row]
            corrected = since if corrected is None else np.maximum(corrected, since)
        # An edge over the number of the event instead of time: nothing is interpolated.
        events = np.arange(len(times))
        held[key] = Edge.from_columns(events + 1, arrived.numbers[row], is_static=False)
    positions, quaternions = compose(held, way, np.arange(len(times)) + 1)
    by = received[leading].receptions
    receptions = replace(by, times=times, corrected=corrected)
    return Trajectory.from_columns(stamps, positions, quaternions, Reading(receptions=receptions))
